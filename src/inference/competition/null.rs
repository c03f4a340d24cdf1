//! What chance alone would bring: draws from what a model itself predicts, through the same linear competition.

use super::proposals::{Linear, is_linear};
use super::{Competition, is_same_set};
use crate::effects::Instance;
use crate::inference::posterior::Fit;
use crate::numerics::random;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Draws: p-values down to one in so many.
const DRAWS: usize = 2000;
/// Share of what is known of a strength that is rounding.
const ROUNDING: f64 = 1e-9;

/// ln of the odds of the best candidate in each draw of a model that lacks nothing, ascending.
///
/// ```text
/// b ~ N(0, C),   C = Dᵀ D − Dᵀ J (Jᵀ J + Λ)⁻¹ Jᵀ D                          (1)
/// ln p = b d − ½ (C_ii + λ_i) d² − ½ ln(1 + C_ii/λ_i) + ln prior             (2)
/// ```
///
/// b are the scores of all candidates: how much the records lead along each. J are the slopes of the coordinates of the model, Λ is what
/// the prior knows of them, D are the directions of candidates and λ_i is what the prior knows of their strength. In each draw the largest
/// of (2), with the strength d of its mode within bounds, is what a search among so many brings by chance.
///
/// Source: Davison and Hinkley (1997), Bootstrap Methods and their Application, section 4.2, for p-values by draws.
/// Check:  `p_values_of_what_chance_brings_are_uniform` in `linear_gaussian`.
pub struct Null(Vec<f64>);

impl Null {
    /// That of candidates of which the `linear` problem knows, `ln_prior` of each direction.
    pub(super) fn of(linear: &Linear<'_, '_>, ln_prior: &[f64]) -> Option<Self> {
        let (n, count) = (linear.base.x.len(), linear.directions.len());
        let density = &linear.density;
        let known = |i: usize| density.size[n + i].powi(-2);
        let cross = Mat::from_fn(linear.beside.len(), count, |i, j| density.a[(linear.beside[i], n + j)]);
        let taken_up = cross.transpose() * density.of(&linear.beside).a.llt(Side::Lower).ok()?.solve(&cross);
        let own =
            |i: usize, j: usize| density.a[(n + i, n + j)] - taken_up[(i, j)] - if i == j { known(i) } else { 0.0 };
        // Records tell nothing of what changes them by no more than rounding.
        let is_told = |i: usize| own(i, i) > ROUNDING * density.a[(n + i, n + i)];
        let variance: Vec<f64> = (0..count).map(|i| if is_told(i) { own(i, i) } else { 0.0 }).collect();
        // Candidates that do the same have one score: what is left of the difference of theirs is rounding.
        let alike = |i: usize, j: usize| {
            let scale = (variance[i] * variance[j]).sqrt();
            if scale > 0.0 { own(i, j) / scale } else { 0.0 }
        };
        let alike = Mat::from_fn(count, count, alike);
        let axes = alike.self_adjoint_eigen(Side::Lower).ok()?;
        let entry = |i: usize, k: usize| axes.U()[(i, k)] * (axes.S()[k].max(0.0) * variance[i]).sqrt();
        let root: Vec<Vec<f64>> = (0..count).map(|i| (0..count).map(|k| entry(i, k)).collect()).collect();
        let ln_odds = |i: usize, score: f64| {
            let curvature = variance[i] + known(i);
            let [low, high] = density.bounds[n + i];
            let strength = (score / curvature).clamp(low, high);
            let occam = -0.5 * (variance[i] / known(i)).ln_1p();
            score * strength - 0.5 * curvature * strength * strength + occam + ln_prior[i]
        };
        let draw = |number: usize| {
            let normal = StandardNormal.sample_iter(random::stream(number as u64, "null of a competition"));
            let z: Vec<f64> = normal.take(count).collect();
            let score = |i: usize| root[i].iter().zip(&z).map(|(r, z)| r * z).sum::<f64>();
            (0..count).map(|i| ln_odds(i, score(i))).fold(f64::NEG_INFINITY, f64::max)
        };
        let mut largest: Vec<f64> = (0..DRAWS).into_par_iter().map(draw).collect();
        largest.sort_by(f64::total_cmp);
        Some(Self(largest))
    }

    /// Probability that chance brings these `ln_odds` or more.
    pub fn p_value(&self, ln_odds: f64) -> f64 {
        // Where no candidate gains, what is left is the prior of one of which records tell nothing, whatever they are.
        let fewer = self.0.partition_point(|chance| *chance < ln_odds - ROUNDING.sqrt());
        (self.0.len() - fewer + 1) as f64 / (self.0.len() + 1) as f64
    }
}

impl<'a> Competition<'a> {
    /// Probability that chance brings as much to `fit` without its effect `index` as that does; none where the model without it was not
    /// looked around, and where the linear problem says nothing of the effect.
    pub fn p_value(&self, fit: &Fit<'a>, index: usize) -> Option<f64> {
        let effects = &fit.model.effects;
        if !is_linear(&effects[index]) {
            return None;
        }
        let without: Vec<Instance> = [&effects[..index], &effects[index + 1..]].concat();
        let part = &self.fits[self.known(&without)?];
        let (_, null) = self.nulls.iter().find(|(set, _)| is_same_set(set, &without))?;
        Some(null.p_value(self.log_posterior(fit) - self.log_posterior(part)))
    }
}
