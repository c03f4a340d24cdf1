//! How residuals change with the coordinates of a model: by coordinate, along the principal axes of the posterior, and by what steps did.

use super::search::JITTER;
use super::{Fitter, Point, combined, information};
use crate::inference::algebra::inverse;
use crate::inference::parameters::Model;
use crate::inference::weights::Rows;
use crate::numerics::threads::on_threads;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use std::sync::Arc;

/// Length of the displacements along which slopes are taken, posterior standard deviations.
const SHARE: f64 = 1.0;
/// Posterior over prior variance along a principal axis above which the records tell so little of it (½ ln of it of the evidence) that no
/// replay of its slope is worth its time.
const UNTOLD: f64 = 0.8;

/// Displacements of all coordinates along which slopes are taken, column by column.
#[derive(Clone)]
pub struct Axes {
    pub(super) along: Mat<f64>,
    /// Whether the records tell something along each.
    is_told: Vec<bool>,
}

/// Coordinates that do what declared values do, each with these and how far they go for one unit of it.
type Same = [(usize, Vec<(usize, f64)>)];

impl<'a> Fitter<'a> {
    /// How residuals change with coordinate `i`; `None` where the column does not finish beside it.
    pub(super) fn slope(&self, model: &Model<'a>, at: &Point, i: usize) -> Option<Arc<Rows>> {
        let step = model.step(&at.x, i);
        let mut beside = at.x.clone();
        beside[i] += step;
        Some(Arc::new(combined(&self.point(model, beside).ok()?.rows, &at.rows, 1.0 / step, -1.0 / step)))
    }

    /// Slopes by coordinate, those apart that are `known` and would need a replay.
    pub(super) fn slopes(&self, model: &Model<'a>, at: &Point, known: &[Option<Arc<Rows>>]) -> Vec<Arc<Rows>> {
        let same = model.same(&at.x);
        let nothing = || Arc::new(combined(&at.rows, &at.rows, 0.0, 0.0));
        let of = |i: usize| {
            if same.iter().any(|(effect, _)| *effect == i) {
                return nothing();
            }
            let own = known.get(i).cloned().flatten().filter(|_| model.is_replayed(i));
            own.or_else(|| self.slope(model, at, i)).unwrap_or_else(nothing)
        };
        let mut slopes = on_threads(model.len(), of);
        Self::join(&same, &mut slopes);
        slopes
    }

    /// Displacements along which slopes are taken where `slopes` are known to be about right.
    ///
    /// ```text
    /// A⁻¹ restricted to what is replayed = D U Λ Uᵀ D,   δ_k = s √λ_k A⁻¹ [A⁻¹]⁻¹ D u_k                  (1)
    /// ```
    ///
    /// D are the prior standard deviations, s is [`SHARE`], what is not replayed goes along as the records ask, and what is at an end of
    /// its range stays there. A difference is wrong by a share of its own size. Taken coordinate by coordinate, the difference of two that
    /// do nearly the same is lost in that; taken along the principal axes of the posterior, what changes records little is known as well
    /// as what changes them much.
    pub(super) fn principal(&self, model: &Model<'a>, at: &Point, slopes: &[Arc<Rows>]) -> Option<Axes> {
        let (prior, bounds, n) = (model.prior(), model.bounds(), model.len());
        let same = model.same(&at.x);
        let replayed = turned(model, &same, &at.x);
        let a = information(model, &self.normal(slopes, &at.rows));
        let held: Vec<bool> = (0..n).map(|i| is_held(model, &same, &at.x, i)).collect();
        let free = |i: usize, j: usize| if held[i] || held[j] { f64::from(u8::from(i == j)) } else { a[(i, j)] };
        let c = inverse(&Mat::from_fn(n, n, free))?;
        let p = replayed.len();
        let deviation = |k: usize| prior[replayed[k]][1];
        let scaled = Mat::from_fn(p, p, |i, j| c[(replayed[i], replayed[j])] / (deviation(i) * deviation(j)));
        let axes = scaled.self_adjoint_eigen(Side::Lower).ok()?;
        let mut along = Mat::zeros(n, p);
        let is_told = (0..p).map(|k| axes.S()[k] < UNTOLD).collect();
        for k in 0..p {
            let lambda = axes.S()[k].max(f64::MIN_POSITIVE);
            let pulled: Vec<f64> = (0..p).map(|i| axes.U()[(i, k)] / (deviation(i) * lambda.sqrt())).collect();
            let moved: Vec<f64> =
                (0..n).map(|i| SHARE * (0..p).map(|j| c[(i, replayed[j])] * pulled[j]).sum::<f64>()).collect();
            // To the side on which bounds leave more room.
            let room = |sign: f64| {
                let of = |(i, d): (usize, &f64)| {
                    let end = if sign * d > 0.0 { bounds[i][1] } else { bounds[i][0] };
                    if *d == 0.0 { 1.0 } else { ((end - at.x[i]) / (sign * d)).max(0.0) }
                };
                moved.iter().enumerate().map(of).fold(1.0, f64::min)
            };
            let [up, down] = [room(1.0), room(-1.0)];
            let share = if up >= down { up } else { -down };
            moved.iter().enumerate().for_each(|(i, d)| along[(i, k)] = share * d);
        }
        Some(Axes { along, is_told })
    }

    /// Slopes by replays along the `axes` of what is replayed, and by each of the other coordinates. Where the records tell nothing along
    /// an axis, what is `known` of it will do.
    pub(super) fn slopes_along(
        &self,
        model: &Model<'a>,
        at: &Point,
        Axes { along, is_told }: &Axes,
        known: Option<&[Arc<Rows>]>,
    ) -> Option<Vec<Arc<Rows>>> {
        let same = model.same(&at.x);
        let replayed = turned(model, &same, &at.x);
        let p = replayed.len();
        if along.ncols() != p {
            return None;
        }
        let moved = Mat::from_fn(p, p, |i, k| along[(replayed[i], k)]);
        let back = moved.partial_piv_lu().solve(Mat::<f64>::identity(p, p));
        if !(0..p).all(|i| (0..p).all(|j| back[(i, j)].is_finite())) {
            return None;
        }
        let nothing = Arc::new(combined(&at.rows, &at.rows, 0.0, 0.0));
        let apart: Vec<_> = (0..model.len()).map(|i| replayed.contains(&i).then(|| nothing.clone())).collect();
        let mut slopes = self.slopes(model, at, &apart);
        let change = |k: usize| -> Option<Rows> {
            if let Some(known) = known.filter(|_| !is_told[k]) {
                let sum = |sum: Rows, i: &usize| combined(&sum, &known[*i], 1.0, along[(*i, k)]);
                return Some(replayed.iter().fold(nothing.to_vec(), sum));
            }
            let beside: Vec<f64> = (0..model.len()).map(|i| at.x[i] + along[(i, k)]).collect();
            let mut change = combined(&self.point(model, beside).ok()?.rows, &at.rows, 1.0, -1.0);
            for i in (0..model.len()).filter(|i| !replayed.contains(i) && along[(*i, k)] != 0.0) {
                change = combined(&change, &slopes[i], 1.0, -along[(i, k)]);
            }
            Some(change)
        };
        let changes: Vec<Rows> = on_threads(p, change).into_iter().collect::<Option<_>>()?;
        for (j, i) in replayed.iter().enumerate() {
            let sum = |sum: Rows, (k, r): (usize, &Rows)| combined(&sum, r, 1.0, back[(k, j)]);
            slopes[*i] = Arc::new(changes.iter().enumerate().fold(nothing.to_vec(), sum));
        }
        Self::join(&same, &mut slopes);
        Some(slopes)
    }

    /// Gives effects that do what declared values do the slopes of those: data cannot tell the two, and no error of a finite difference
    /// may.
    fn join(same: &Same, slopes: &mut [Arc<Rows>]) {
        for (effect, parts) in same {
            let nothing = combined(&slopes[*effect], &slopes[*effect], 0.0, 0.0);
            let sum = parts.iter().fold(nothing, |sum, (i, share)| combined(&sum, &slopes[*i], 1.0, *share));
            slopes[*effect] = Arc::new(sum);
        }
    }

    /// Corrects slopes by what a step did beyond what they said of it, along it alone.
    ///
    /// ```text
    /// J ← J + (Δr − J δ) δᵀ/(δᵀ δ + τ²)                                      (1)
    /// ```
    ///
    /// τ is [`JITTER`], so that what a short step does by chance is not taken for a slope; δ in prior standard deviations, over the
    /// coordinates whose slopes are replays; those of sensors are taken anew.
    ///
    /// Source: (1) Broyden (1965), doi 10.1090/S0025-5718-1965-0198670-6.
    pub(super) fn learn(model: &Model<'a>, slopes: &mut [Arc<Rows>], [from, to]: [&Point; 2]) {
        let back = from.x.iter().zip(&to.x).map(|(from, to)| from - to);
        let change = combined(&to.rows, &from.rows, 1.0, -1.0);
        let missed = slopes.iter().zip(back).fold(change, |missed, (slope, back)| combined(&missed, slope, 1.0, back));
        let prior = model.prior();
        let same = model.same(&from.x);
        let mut moved: Vec<f64> = to.x.iter().zip(&from.x).map(|(to, from)| to - from).collect();
        for (effect, parts) in &same {
            let own = std::mem::take(&mut moved[*effect]);
            parts.iter().for_each(|(i, share)| moved[*i] += share * own);
        }
        let delta: Vec<f64> = (0..model.len()).map(|i| moved[i] / prior[i][1]).collect();
        let square: f64 = (0..model.len()).filter(|i| model.is_replayed(*i)).map(|i| delta[i] * delta[i]).sum();
        if square < 1e-12 {
            return;
        }
        for (i, slope) in slopes.iter_mut().enumerate() {
            let factor = delta[i] / ((square + JITTER * JITTER) * prior[i][1]);
            if model.is_replayed(i) && factor != 0.0 {
                *slope = Arc::new(combined(slope, &missed, 1.0, factor));
            }
        }
        Self::join(&same, slopes);
    }
}

/// Coordinates whose slopes are taken along displacements of all of them: what is replayed and free to go to either side.
fn turned(model: &Model<'_>, same: &Same, x: &[f64]) -> Vec<usize> {
    (0..model.len()).filter(|i| model.is_replayed(*i) && !is_held(model, same, x, *i)).collect()
}

/// Whether coordinate `i` stays where it is: at an end of its range, or doing what a declared value does.
fn is_held(model: &Model<'_>, same: &Same, x: &[f64], i: usize) -> bool {
    model.is_at_end(x, i) || same.iter().any(|(effect, _)| *effect == i)
}
