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
/// What is added to the variance of a score, as a share of it: candidates that do the same are told apart by nothing.
const ALIKE: f64 = 1e-9;

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
/// Check:  `p_values_of_what_chance_brings_are_uniform`.
#[derive(Clone)]
pub struct Null(Vec<f64>);

impl Null {
    /// That of candidates of which the `linear` problem knows, `ln_prior` of each direction.
    pub(super) fn of(linear: &Linear<'_, '_>, ln_prior: &[f64]) -> Option<Self> {
        let (n, count) = (linear.base.x.len(), linear.directions.len());
        let density = &linear.density;
        let known = |i: usize| density.size[n + i].powi(-2);
        let cross = Mat::from_fn(linear.beside.len(), count, |i, j| density.a[(linear.beside[i], n + j)]);
        let taken_up = cross.transpose() * density.of(&linear.beside).a.llt(Side::Lower).ok()?.solve(&cross);
        let own = |i: usize, j: usize| {
            let whole = density.a[(n + i, n + j)] - taken_up[(i, j)];
            if i == j { (whole - known(i)).max(0.0) * (1.0 + ALIKE) + f64::MIN_POSITIVE } else { whole }
        };
        let covariance = Mat::from_fn(count, count, own);
        let factor = covariance.llt(Side::Lower).ok()?;
        let root = factor.L();
        let ln_odds = |i: usize, score: f64| {
            let curvature = covariance[(i, i)] + known(i);
            let [low, high] = density.bounds[n + i];
            let strength = (score / curvature).clamp(low, high);
            let occam = -0.5 * (covariance[(i, i)] / known(i)).ln_1p();
            score * strength - 0.5 * curvature * strength * strength + occam + ln_prior[i]
        };
        let draw = |number: usize| {
            let normal = StandardNormal.sample_iter(random::stream(number as u64, "null of a competition"));
            let z: Vec<f64> = normal.take(count).collect();
            let score = |i: usize| (0..=i).map(|j| root[(i, j)] * z[j]).sum::<f64>();
            (0..count).map(|i| ln_odds(i, score(i))).fold(f64::NEG_INFINITY, f64::max)
        };
        let mut largest: Vec<f64> = (0..DRAWS).into_par_iter().map(draw).collect();
        largest.sort_by(f64::total_cmp);
        Some(Self(largest))
    }

    /// Probability that chance brings these `ln_odds` or more.
    pub fn p_value(&self, ln_odds: f64) -> f64 {
        let fewer = self.0.partition_point(|chance| *chance < ln_odds);
        (self.0.len() - fewer + 1) as f64 / (self.0.len() + 1) as f64
    }
}

impl<'a> Competition<'a> {
    /// Probability that chance brings as much to `fit` without its effect `index` as that does; none where the model without it was not
    /// looked around, and where the linear problem says nothing of the effect.
    pub fn p_value(&self, fit: &Fit<'a>, index: usize) -> Option<f64> {
        let effects = &fit.model.effects;
        let _ = Some(&effects[index]).filter(|effect| is_linear(effect))?;
        let without: Vec<Instance> = [&effects[..index], &effects[index + 1..]].concat();
        let part = &self.fits[self.known(&without)?];
        let (_, null) = self.nulls.iter().find(|(set, _)| is_same_set(set, &without))?;
        Some(null.p_value(self.log_posterior(fit) - self.log_posterior(part)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::few::{self, Few};
    use super::super::super::forward::Forward;
    use super::super::super::made_up::{Truth, Uniform, problem};
    use super::super::super::parameters::{Declared, Model};
    use super::super::super::posterior::{Fitter, Start, Stop, combined};
    use super::super::super::weights::Expected;
    use super::*;
    use crate::diagnosis::DiagnoseSettings;
    use std::sync::Arc;

    #[test]
    fn p_values_of_what_chance_brings_are_uniform() {
        let problem = problem(&Truth { events: 3, ..Truth::default() });
        let replay = Uniform(&problem);
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        let declared = Declared::new(&problem).unwrap();
        forward.anchor(&[]).unwrap();
        let prediction = Arc::new(forward.predict(&[]).unwrap());
        let fitter = Fitter::new(&forward, Expected::of(&forward, prediction));
        let model = Model { declared: &declared, effects: Vec::new() };
        let fit = fitter.fit(Start::at(model, vec![0.0; declared.len()]), Stop::WHERE_IT_IS).unwrap();
        let in_few = forward.in_groups(&few::groups(&forward));
        let few = Few { forward: &in_few, declared: &declared.in_events(&in_few) };
        let competition = Competition::new(fitter, fit.clone(), few, 4);
        let directions = competition.directions(&competition.fitter, &fit);
        let times = 400;
        let p_values: Vec<f64> = (0..times)
            .map(|seed| {
                let mut normal = StandardNormal.sample_iter(random::stream(seed, "records of the model"));
                let mut next = || -> f64 { normal.next().unwrap() };
                let mut rows = (*fit.rows).clone();
                rows.iter_mut().flatten().for_each(|r| *r = next());
                for (slope, [_, sd]) in fit.slopes.iter().zip(fit.model.prior()) {
                    rows = combined(&rows, slope, 1.0, sd * next());
                }
                let drawn = Fit { rows: Arc::new(rows), ..fit.clone() };
                let linear = Linear::new(&competition.fitter, &drawn, &directions).unwrap();
                let prior = competition.ln_priors(&linear);
                let none = linear.proposal(&[]).unwrap().log_posterior;
                let best = (0..directions.len()).filter_map(|i| Some(linear.proposal(&[i])?.log_posterior + prior[i]));
                let null = Null::of(&linear, &prior).unwrap();
                null.p_value(best.fold(f64::NEG_INFINITY, f64::max) - none)
            })
            .collect();
        // Within three standard deviations of the share of uniform numbers.
        for level in [0.02, 0.05, 0.1, 0.25, 0.5, 0.75] {
            let share = p_values.iter().filter(|p| **p <= level).count() as f64 / times as f64;
            let deviation = (level * (1.0 - level) / times as f64).sqrt();
            assert!((share - level).abs() < 3.0 * deviation, "{level}: {share}");
        }
    }
}
