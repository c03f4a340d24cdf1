//! Joint estimates of nuisances and effects: bounded Levenberg–Marquardt on whitened residuals and priors.

use super::anchor::Anchor;
use super::cost::whitened;
use super::followed::scaled;
use super::responses::{Responses, Scene};
use super::unknowns::Unknowns;
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

    /// The cost with priors weighted by `level`.
    fn tempered(&self, level: f64) -> f64 {
        let square: f64 = self.residual.iter().map(|r| r * r).sum();
        let tempered = square + level * (self.cost - square);
        if tempered.is_finite() { tempered } else { f64::INFINITY }
    }
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
        let prior: f64 = x[..unknowns.nuisances.len()].iter().map(|n| n * n).sum();
        let mut cost = residual.iter().map(|r| r * r).sum::<f64>() + prior;
        if !cost.is_finite() {
            cost = f64::INFINITY;
        }
        Ok(Point { x: x.to_vec(), responses, residual, cost })
    }

    /// ∂ρ/∂x at `point` for the unknowns in `which`, column by column.
    pub fn jacobian(&self, unknowns: &Unknowns<'_>, point: &Point, which: &[usize]) -> Mat<f64> {
        let steps = unknowns.steps();
        let columns: Vec<Vec<f64>> = which
            .par_iter()
            .map(|&i| {
                for sign in [1.0, -1.0] {
                    let mut x = point.x.clone();
                    x[i] += sign * steps[i];
                    unknowns.clip(&mut x);
                    let step = x[i] - point.x[i];
                    if step.abs() < 0.5 * steps[i] {
                        continue;
                    }
                    let Ok(moved) = self.at(unknowns, &x, Some(&point.responses)) else { continue };
                    if moved.cost.is_finite() {
                        return difference(&moved, point, step);
                    }
                }
                vec![0.0; point.residual.len()]
            })
            .collect();
        Mat::from_fn(point.residual.len(), which.len(), |i, j| columns[j][i])
    }

    /// Minimises the cost from `start`, at most `steps` accepted steps.
    ///
    /// Where residuals are larger than noise, the model is not yet what it should be, and they say as much less of the
    /// nuisances:
    ///
    /// ```text
    /// |ρ|² + λ |n|²,   λ = max(1, |ρ|²/N) where the step starts
    /// ```
    ///
    /// # Errors
    /// When the start cannot be evaluated.
    pub fn fit(&self, unknowns: &Unknowns<'_>, start: Point, steps: usize) -> Result<Point> {
        let all: Vec<usize> = (0..unknowns.len()).collect();
        let mut point = start;
        let mut lambda = 1e-3;
        for _ in 0..steps {
            let jacobian = self.jacobian(unknowns, &point, &all);
            let level = point.level();
            let (normal, gradient) = normal_equations(unknowns, &jacobian, &point, level);
            let mut best: Option<Point> = None;
            for _ in 0..6 {
                let Some(step) = damped_step(&normal, &gradient, lambda) else { break };
                let mut x: Vec<f64> = point.x.iter().zip(&step).map(|(x, d)| x + d).collect();
                unknowns.clip(&mut x);
                let trial = self.at(unknowns, &x, Some(&point.responses));
                if let Ok(trial) = trial
                    && trial.tempered(level) < point.tempered(level)
                {
                    best = Some(trial);
                    break;
                }
                lambda = (lambda * 10.0f64).max(1e-3);
            }
            let Some(next) = best else { break };
            let gain = point.tempered(level) - next.tempered(level);
            point = next;
            lambda = (lambda * 0.1f64).max(1e-7);
            if gain < 0.3 + 1e-5 * point.cost {
                break;
            }
        }
        Ok(point)
    }

    /// Posterior standard deviations at `point`, widened where the fit is worse than its noise: `level` times its cost.
    pub fn deviations(&self, unknowns: &Unknowns<'_>, point: &Point, level: f64) -> Vec<f64> {
        let widened = level.max(1.0).sqrt();
        let all: Vec<usize> = (0..unknowns.len()).collect();
        let jacobian = self.jacobian(unknowns, point, &all);
        let (normal, _) = normal_equations(unknowns, &jacobian, point, level.max(1.0));
        match normal.llt(Side::Lower) {
            Ok(factor) => {
                let inverse = factor.solve(Mat::<f64>::identity(normal.nrows(), normal.nrows()));
                (0..normal.nrows()).map(|i| widened * inverse[(i, i)].max(0.0).sqrt()).collect()
            }
            Err(_) => vec![f64::INFINITY; normal.nrows()],
        }
    }
}

/// Derivative of the residuals from `point` to `moved`.
pub(super) fn difference(moved: &Point, point: &Point, step: f64) -> Vec<f64> {
    moved.residual.iter().zip(&point.residual).map(|(a, b)| (a - b) / step).collect()
}

/// JᵀJ + P and −(Jᵀρ + P x), P the prior precision of the nuisances times `level`.
fn normal_equations(unknowns: &Unknowns<'_>, jacobian: &Mat<f64>, point: &Point, level: f64) -> (Mat<f64>, Vec<f64>) {
    let mut normal = gram(jacobian, jacobian);
    let mut gradient = project(jacobian, &point.residual);
    for i in 0..unknowns.len() {
        if i < unknowns.nuisances.len() {
            normal[(i, i)] += level;
            gradient[i] += level * point.x[i];
        } else {
            // An effect that has no influence here must not make the matrix singular.
            normal[(i, i)] += 1e-9;
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

fn damped_step(normal: &Mat<f64>, gradient: &[f64], lambda: f64) -> Option<Vec<f64>> {
    let mut damped = normal.clone();
    for i in 0..damped.nrows() {
        damped[(i, i)] *= 1.0 + lambda;
    }
    solved(&damped, gradient)
}

/// x of A x = b for a positive definite A.
pub(super) fn solved(a: &Mat<f64>, b: &[f64]) -> Option<Vec<f64>> {
    let solution = a.llt(Side::Lower).ok()?.solve(Mat::from_fn(b.len(), 1, |i, _| b[i]));
    let solution: Vec<f64> = (0..b.len()).map(|i| solution[(i, 0)]).collect();
    solution.iter().all(|x| x.is_finite()).then_some(solution)
}
