//! Joint estimates of nuisances and effects: bounded Levenberg–Marquardt on whitened residuals and priors.

use super::anchor::Anchor;
use super::bounded::{bounded_step, damped};
use super::cost::{changes, whitened};
use super::followed::scaled;
use super::responses::{Responses, Scene};
use super::unknowns::{Placed, Unknowns};
use crate::error::Result;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use rayon::prelude::*;

/// A point in the space of unknowns and all that was computed there.
#[derive(Clone)]
pub struct Point {
    /// The unknowns.
    pub x: Vec<f64>,
    /// Responses of the groups asked for.
    pub responses: Responses,
    /// Whitened residuals of those groups.
    pub residual: Vec<f64>,
    /// Σ|ρ|² plus the priors of the nuisances.
    pub cost: f64,
}

impl Point {
    /// Σ|ρ|² over its number, no less than one.
    pub fn level(&self) -> f64 {
        let square: f64 = self.residual.iter().map(|r| r * r).sum();
        (square / self.residual.len().max(1) as f64).max(1.0)
    }

    /// The cost with priors and what `leash` adds weighted by `level`.
    fn tempered(&self, level: f64, leash: &Leash) -> f64 {
        let square: f64 = self.residual.iter().map(|r| r * r).sum();
        let far: f64 = self.x.iter().zip(&leash.from).zip(&leash.weights).map(|((x, a), w)| w * (x - a).powi(2)).sum();
        let tempered = square + level * (self.cost - square + far);
        if tempered.is_finite() { tempered } else { f64::INFINITY }
    }
}

/// What holds a fit near the place where it starts.
struct Leash {
    from: Vec<f64>,
    /// By unknown.
    weights: Vec<f64>,
}

/// Evaluates and fits against one anchor on some of the groups.
#[derive(Clone, Copy)]
pub struct Fitter<'a> {
    /// The problem in the frequency domain.
    pub scene: &'a Scene<'a>,
    /// Where the nonlinear column was run.
    pub anchor: &'a Anchor,
    /// Groups that count.
    pub groups: &'a [usize],
    /// Weight of the prior of each nuisance.
    pub stiffness: &'a [f64],
}

impl Fitter<'_> {
    /// Everything at `x`.
    ///
    /// # Errors
    /// When the edited column cannot be built.
    pub fn at(&self, unknowns: &Unknowns<'_>, x: &[f64], near: Option<&Responses>) -> Result<Point> {
        let effects = unknowns.build(&self.scene.problem.declared, x)?;
        let responses = self.scene.responses(&effects, self.groups, near)?;
        let scaled = scaled(self.scene, unknowns, x)?;
        let residual = whitened(self.scene, &effects, &responses, (self.anchor, &scaled), self.groups);
        let prior: f64 = x.iter().zip(self.stiffness).map(|(n, w)| w * n * n).sum();
        let mut cost = residual.iter().map(|r| r * r).sum::<f64>() + prior;
        if !cost.is_finite() {
            cost = f64::INFINITY;
        }
        Ok(Point { x: x.to_vec(), responses, residual, cost })
    }

    /// ∂ρ/∂x at `point` for the unknowns in `which`, column by column.
    pub fn jacobian(&self, unknowns: &Unknowns<'_>, point: &Point, which: &[usize]) -> Mat<f64> {
        let steps = unknowns.steps();
        let followed = self.followed(unknowns, point, which, &steps);
        let columns: Vec<Vec<f64>> = which
            .par_iter()
            .map(|&i| {
                if let Some((_, column)) = followed.iter().find(|(j, _)| *j == i) {
                    return column.clone();
                }
                let column = |(x, step): (Vec<f64>, f64)| {
                    let moved = self.at(unknowns, &x, Some(&point.responses)).ok()?;
                    moved.cost.is_finite().then(|| difference(&moved, point, step))
                };
                let column = stepped(unknowns, &point.x, i, steps[i]).find_map(column);
                column.unwrap_or_else(|| vec![0.0; point.residual.len()])
            })
            .collect();
        Mat::from_fn(point.residual.len(), which.len(), |i, j| columns[j][i])
    }

    /// Those of [`Self::jacobian`] that neighbours follow and nothing else does: all in one go.
    fn followed(
        &self,
        unknowns: &Unknowns<'_>,
        point: &Point,
        which: &[usize],
        steps: &[f64],
    ) -> Vec<(usize, Vec<f64>)> {
        let of = |x: &[f64]| scaled(self.scene, unknowns, x).ok();
        let moved = |&i: &usize| {
            let (x, step) = stepped(unknowns, &point.x, i, steps[i]).next()?;
            Some((i, step, of(&x)?))
        };
        let moved: Vec<_> = which.iter().filter(|i| unknowns.is_followed(**i)).filter_map(moved).collect();
        let effects = unknowns.build(&self.scene.problem.declared, &point.x).ok();
        let Some((effects, here)) = effects.zip(of(&point.x)).filter(|_| !moved.is_empty()) else { return Vec::new() };
        let places: Vec<Placed> = moved.iter().map(|(_, _, place)| place.clone()).collect();
        let all = changes(self.scene, &effects, &point.responses, (self.anchor, &here), (&places, self.groups));
        let column =
            |((i, step, _), change): (&(usize, f64, _), Vec<f64>)| (*i, change.into_iter().map(|c| c / step).collect());
        moved.iter().zip(all).map(column).collect()
    }

    /// Minimises the cost from `start`, at most `steps` accepted steps.
    ///
    /// Where residuals are larger than noise, the model is not yet what it should be, and they say as much less of the
    /// nuisances:
    ///
    /// ```text
    /// |ρ|² + λ (|n|² + μ |x − x₀|²),   λ = max(1, |ρ|²/N) where the step starts
    /// ```
    ///
    /// μ, the `hold`, keeps the fit near its start x₀, in prior standard deviations, where a replay has not confirmed a longer
    /// step: Levenberg–Marquardt with replays for its trial points.
    ///
    /// What would leave its bounds stops there, and the others make the best of it. Of a nuisance and an effect that are the same
    /// thing, the effect moves: it takes what the nuisance had.
    ///
    /// # Errors
    /// When the start cannot be evaluated.
    pub fn fit(&self, unknowns: &Unknowns<'_>, start: Point, steps: usize, hold: f64) -> Result<Point> {
        let all: Vec<usize> = (0..unknowns.len()).collect();
        let weights = unknowns.deviations().into_iter().map(|d| hold / (d * d)).collect();
        let mut point = start;
        let mut x = point.x.clone();
        unknowns.gather(&mut x);
        if steps > 0 && x != point.x {
            point = self.at(unknowns, &x, Some(&point.responses))?;
        }
        let leash = Leash { from: point.x.clone(), weights };
        let mut bounds = unknowns.bounds();
        for [nuisance, _] in unknowns.twice() {
            bounds[nuisance] = [point.x[nuisance]; 2];
        }
        let mut lambda = 1e-3;
        for _ in 0..steps {
            let jacobian = self.jacobian(unknowns, &point, &all);
            let level = point.level();
            let (mut normal, mut gradient) = normal_equations(self.stiffness, &jacobian, &point, level);
            for (i, weight) in leash.weights.iter().enumerate() {
                normal[(i, i)] += level * weight;
                gradient[i] -= level * weight * (point.x[i] - leash.from[i]);
            }
            let mut best: Option<Point> = None;
            for _ in 0..6 {
                let Some(step) = bounded_step(damped(&normal, lambda), &gradient, &point.x, &bounds) else { break };
                let mut x: Vec<f64> = point.x.iter().zip(&step).map(|(x, d)| x + d).collect();
                unknowns.clip(&mut x);
                let trial = self.at(unknowns, &x, Some(&point.responses));
                if let Ok(trial) = trial
                    && trial.tempered(level, &leash) < point.tempered(level, &leash)
                {
                    best = Some(trial);
                    break;
                }
                lambda = (lambda * 10.0f64).max(1e-3);
            }
            let Some(next) = best else { break };
            let gain = point.tempered(level, &leash) - next.tempered(level, &leash);
            point = next;
            lambda = (lambda * 0.1f64).max(1e-7);
            if gain < 0.3 + 1e-5 * point.cost {
                break;
            }
        }
        Ok(point)
    }

    /// Σ|ρ|² of other events, this being fitted at `point` and they being seen at `other`, as far as it is not what the fit has
    /// left open:
    ///
    /// ```text
    /// ρᵀ (I + J C Jᵀ)⁻¹ ρ,   C = λ (J₀ᵀJ₀ + λ P)⁻¹                          (1)
    /// ```
    ///
    /// J and J₀ are the derivatives of the others' and of one's own residuals, C the covariance of the unknowns after the fit,
    /// λ as in [`Self::fit`]. Where the model is right, (1) is a χ² with as many degrees of freedom as there are residuals.
    ///
    /// Source: Gelman et al. (2013), Bayesian Data Analysis, 3rd ed., section 6.3: posterior predictive distribution.
    pub fn predictive(&self, unknowns: &Unknowns<'_>, point: &Point, (judge, other): (&Self, &Point)) -> f64 {
        let all: Vec<usize> = (0..unknowns.len()).collect();
        let level = point.level();
        let (own, _) = normal_equations(self.stiffness, &self.jacobian(unknowns, point, &all), point, level);
        let precision = faer::Scale(1.0 / level) * &own;
        beyond(&precision, &judge.jacobian(unknowns, other, &all), &other.residual)
    }

    /// Posterior standard deviations at `point`, widened where the fit is worse than its noise, `level` times its cost, and where
    /// events disagree by more than noise lets them:
    ///
    /// ```text
    /// σ² = max(diag C, diag C S C),   S = E/(E−1) Σ_e (g_e − ḡ)(g_e − ḡ)ᵀ + λ P,   g_e = J_eᵀ ρ_e        (1)
    /// ```
    ///
    /// What the model has wrong is alike at neighbouring frequencies and differs from event to event: counted as independent noise it
    /// would promise too much.
    ///
    /// Check:  `events_that_disagree_widen_the_interval`.
    /// Source: Liang and Zeger (1986), doi 10.1093/biomet/73.1.13: the covariance of clustered data.
    pub fn deviations(&self, unknowns: &Unknowns<'_>, point: &Point, level: f64) -> Vec<f64> {
        let level = level.max(1.0);
        let all: Vec<usize> = (0..unknowns.len()).collect();
        let jacobian = self.jacobian(unknowns, point, &all);
        let (normal, _) = normal_equations(self.stiffness, &jacobian, point, level);
        let Ok(factor) = normal.llt(Side::Lower) else { return vec![f64::INFINITY; normal.nrows()] };
        let inverse = factor.solve(Mat::<f64>::identity(normal.nrows(), normal.nrows()));
        let priors: Vec<f64> = self.stiffness.iter().map(|w| level * w).collect();
        let sizes: Vec<usize> = self.groups.iter().map(|g| self.scene.groups[*g].n_residual()).collect();
        let clustered = clustered(&inverse, &priors, &scores(&jacobian, &point.residual, &sizes));
        let variance = |i: usize| (level * inverse[(i, i)]).max(clustered[i]).max(0.0);
        (0..normal.nrows()).map(|i| variance(i).sqrt()).collect()
    }
}

/// Jᵀρ of each of the stretches of rows of these `sizes`.
fn scores(jacobian: &Mat<f64>, residual: &[f64], sizes: &[usize]) -> Vec<Vec<f64>> {
    let mut at = 0;
    let score = |size: &usize| {
        let own = at..at + size;
        at = own.end;
        (0..jacobian.ncols()).map(|j| own.clone().map(|i| jacobian[(i, j)] * residual[i]).sum()).collect()
    };
    sizes.iter().map(score).collect()
}

/// diag C S C of (1) of [`Fitter::deviations`]; nothing for a single event.
fn clustered(inverse: &Mat<f64>, priors: &[f64], scores: &[Vec<f64>]) -> Vec<f64> {
    let (n, count) = (inverse.nrows(), scores.len() as f64);
    if scores.len() < 2 {
        return vec![0.0; n];
    }
    let mean: Vec<f64> = (0..n).map(|i| scores.iter().map(|g| g[i]).sum::<f64>() / count).collect();
    let variance = |i: usize| {
        let along = |g: &Vec<f64>| (0..n).map(|j| inverse[(i, j)] * (g[j] - mean[j])).sum::<f64>();
        let of_events = scores.iter().map(|g| along(g).powi(2)).sum::<f64>() * count / (count - 1.0);
        of_events + priors.iter().enumerate().map(|(j, prior)| inverse[(i, j)].powi(2) * prior).sum::<f64>()
    };
    (0..n).map(variance).collect()
}

/// ρᵀ (I + J C Jᵀ)⁻¹ ρ with C⁻¹ the `precision`: |ρ|² − bᵀ (C⁻¹ + JᵀJ)⁻¹ b, b = Jᵀρ.
fn beyond(precision: &Mat<f64>, jacobian: &Mat<f64>, residual: &[f64]) -> f64 {
    let open = project(jacobian, residual);
    let square: f64 = residual.iter().map(|r| r * r).sum();
    let explained = solved(&(gram(jacobian, jacobian) + precision), &open);
    square - explained.map_or(0.0, |x| x.iter().zip(&open).map(|(x, b)| x * b).sum())
}

/// `from` with unknown `i` a `step` up and then down, as far as the bounds leave at least half of it, and what is left of it.
fn stepped(unknowns: &Unknowns<'_>, from: &[f64], i: usize, step: f64) -> impl Iterator<Item = (Vec<f64>, f64)> {
    [step, -step].into_iter().filter_map(move |signed| {
        let mut x = from.to_vec();
        x[i] += signed;
        unknowns.clip(&mut x);
        let taken = x[i] - from[i];
        (taken.abs() >= 0.5 * step).then_some((x, taken))
    })
}

/// Derivative of the residuals from `point` to `moved`.
pub(super) fn difference(moved: &Point, point: &Point, step: f64) -> Vec<f64> {
    moved.residual.iter().zip(&point.residual).map(|(a, b)| (a - b) / step).collect()
}

/// JᵀJ + P and −(Jᵀρ + P x), P the prior precision of the nuisances times their `stiffness` and the `level`.
fn normal_equations(stiffness: &[f64], jacobian: &Mat<f64>, point: &Point, level: f64) -> (Mat<f64>, Vec<f64>) {
    let mut normal = gram(jacobian, jacobian);
    let mut gradient = project(jacobian, &point.residual);
    for i in 0..point.x.len() {
        // An effect that has no influence here must not make the matrix singular.
        let weight = stiffness.get(i).map_or(1e-9, |w| level * w);
        normal[(i, i)] += weight;
        if i < stiffness.len() {
            gradient[i] += weight * point.x[i];
        }
    }
    (normal, gradient.iter().map(|g| -g).collect())
}

/// AᵀB on one thread, so that the order of summation is fixed.
pub(super) fn gram(a: &Mat<f64>, b: &Mat<f64>) -> Mat<f64> {
    let mut out = Mat::zeros(a.ncols(), b.ncols());
    faer::linalg::matmul::matmul(out.as_mut(), faer::Accum::Replace, a.transpose(), b.as_ref(), 1.0, faer::Par::Seq);
    out
}

/// Aᵀr.
pub(super) fn project(a: &Mat<f64>, r: &[f64]) -> Vec<f64> {
    (0..a.ncols()).map(|j| a.col(j).iter().zip(r).map(|(a, r)| a * r).sum()).collect()
}

/// x of A x = b for a positive definite A.
pub(super) fn solved(a: &Mat<f64>, b: &[f64]) -> Option<Vec<f64>> {
    let solution = a.llt(Side::Lower).ok()?.solve(Mat::from_fn(b.len(), 1, |i, _| b[i]));
    let solution: Vec<f64> = (0..b.len()).map(|i| solution[(i, 0)]).collect();
    solution.iter().all(|x| x.is_finite()).then_some(solution)
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Uniform, judged};
    use super::super::search::Search;
    use super::super::settings::DiagnoseSettings;
    use super::super::unknowns::nuisances;
    use super::*;
    use crate::progress::Quiet;

    #[test]
    fn derivatives_of_what_neighbours_follow_are_those_of_residuals() {
        let problem = judged("");
        let (settings, replay) = (DiagnoseSettings::default(), Uniform(&problem));
        let mut scene = Scene::new(&problem, &settings).unwrap();
        let n = nuisances(&problem).unwrap();
        let x: Vec<f64> = n.iter().map(|n| if n.is_shaken { 0.3 } else { -0.2 }).collect();
        let anchor = scene.look_around(&replay, &settings, (&[], &vec![0.0; n.len()]), &Quiet).unwrap();
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        // A second replay, so that the errors over a step count too.
        let anchor = search.anchored(&[], &x, Some(&anchor)).unwrap();
        let (unknowns, fitter) = (search.unknowns(&[]), search.fitter(&anchor));
        let here: Vec<f64> = x.iter().map(|x| x + 0.4).collect();
        let point = fitter.at(&unknowns, &here, None).unwrap();
        let which: Vec<usize> = (0..n.len()).filter(|i| unknowns.is_followed(*i)).collect();
        let jacobian = fitter.jacobian(&unknowns, &point, &which);
        let mut moving = 0;
        for (j, &i) in which.iter().enumerate() {
            let mut there = here.clone();
            there[i] += 1e-3;
            let expected = difference(&fitter.at(&unknowns, &there, None).unwrap(), &point, 1e-3);
            let size = expected.iter().map(|v| v * v).sum::<f64>().sqrt();
            let miss = jacobian.col(j).iter().zip(&expected).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            // What moves nothing here moves by rounding.
            assert!(miss <= 1e-6 * size.max(1e-2), "{}: {miss} of {size}", n[i].what());
            moving += usize::from(size > 1.0);
        }
        assert!(moving >= 3, "velocity, all velocities, damping: {moving}");
    }

    #[test]
    fn what_a_fit_has_left_open_is_no_surprise() {
        let jacobian = Mat::from_fn(4, 2, |i, j| (1.0 + i as f64).powi(j as i32) * if i == 2 { -1.0 } else { 0.5 });
        let precision = Mat::from_fn(2, 2, |i, j| if i == j { 0.7 + i as f64 } else { 0.2 });
        let residual = [0.3, -1.2, 2.0, 0.8];
        let covariance = precision.llt(Side::Lower).unwrap().solve(Mat::<f64>::identity(2, 2));
        let spread = &jacobian * &covariance * jacobian.transpose() + Mat::<f64>::identity(4, 4);
        let x = solved(&spread, &residual).unwrap();
        let expected: f64 = x.iter().zip(&residual).map(|(x, r)| x * r).sum();
        let square: f64 = residual.iter().map(|r| r * r).sum();
        let found = beyond(&precision, &jacobian, &residual);
        assert!((found - expected).abs() < 1e-12 * square && found < 0.9 * square, "{found} {expected} {square}");
        let firm = faer::Scale(1e9) * &precision;
        assert!((beyond(&firm, &jacobian, &residual) / square - 1.0).abs() < 1e-6, "nothing was left open");
    }

    #[test]
    fn events_that_disagree_widen_the_interval() {
        // One unknown, seen by two events with residuals of their own that the mean takes away.
        let jacobian = Mat::from_fn(4, 1, |_, _| 1.0);
        let of = |apart: f64| {
            let residual = [apart, apart, -apart, -apart];
            let inverse = Mat::from_fn(1, 1, |_, _| 1.0 / 5.0);
            clustered(&inverse, &[1.0], &scores(&jacobian, &residual, &[2, 2]))[0]
        };
        // (2/1 · 2 · (2 a)² + 1) / 25
        assert!((of(0.0) - 1.0 / 25.0).abs() < 1e-12 && (of(3.0) - (16.0 * 9.0 + 1.0) / 25.0).abs() < 1e-12);
        assert_eq!(clustered(&Mat::from_fn(1, 1, |_, _| 1.0), &[0.0], &[vec![2.0]]), [0.0], "one event");
    }

    #[test]
    fn a_leash_costs_by_the_square_of_the_way() {
        let point = Point { x: vec![1.0, 3.0], responses: Responses::default(), residual: vec![2.0], cost: 5.0 };
        let leash = |hold: f64| Leash { from: vec![1.0, 1.0], weights: vec![hold, hold / 4.0] };
        assert_eq!(point.tempered(2.0, &leash(0.0)), 4.0 + 2.0);
        assert_eq!(point.tempered(2.0, &leash(10.0)), 4.0 + 2.0 * (1.0 + 10.0));
    }
}
