//! Stage 3 by Gauss–Newton steps: few unknowns, so the exact second-order model of all records is cheap.
//!
//! ```text
//! (JᵀJ + (λ + μ) P) δ = −(Jᵀρ + λ P ΔΞ),   P = diag 1/(r |ξ₀_k|²)                                          (1)
//! ```
//!
//! `λ` is the weight of the relative penalty, `μ` the damping of Levenberg and Marquardt, measured by the same relative size of
//! a change: a step is taken if it lowers the objective and no rollout of a training event leaves its bound, and shortened
//! (larger μ) until it does. A ladder of falling penalties is walked down, each rung from where the last one ended: fit,
//! threshold, fit what is left. Every step is judged on the validation events, and the walk ends when two rungs in a row
//! bring nothing there.

use super::calibrate::{Candidate, relative_penalty};
use super::events::Records;
use super::history::History;
use super::normal::Normal;
use super::settings::CalibrateSettings;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

/// Where the damping starts and how far it may go.
const FIRST_DAMPING: f64 = 1.0;
const DAMPING: (f64, f64) = (1e-6, 1e8);
/// A rung ends when a step lowers the objective by less than this share.
const SMALLEST_GAIN: f64 = 1e-3;
/// Rungs in a row without a better validation that end the walk.
const PATIENCE: usize = 2;

/// Columns of the history.
pub const COLUMNS: [&str; 7] = ["step", "total", "observation", "penalty", "terms", "validation", "weight"];

/// The way down the ladder: all that the next step depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct Walk {
    /// Rung of the ladder.
    pub rung: usize,
    /// Whether the rung was thresholded already.
    pub is_thresholded: bool,
    /// Steps taken since the rung began or was thresholded.
    pub step: usize,
    /// Rungs since the last better validation.
    pub idle: usize,
    /// Damping μ.
    pub damping: f64,
    /// Where the walk is.
    pub at: Candidate,
    /// The best candidate so far.
    pub best: Candidate,
    /// The lowest validation error before this rung.
    pub before: f64,
    /// What was tried so far.
    pub history: History,
}

impl Walk {
    /// At the top of the ladder.
    pub fn new(start: Candidate) -> Self {
        let before = start.validation;
        Self {
            rung: 0,
            is_thresholded: false,
            step: 0,
            idle: 0,
            damping: FIRST_DAMPING,
            at: start.clone(),
            best: start,
            before,
            history: History::new(&COLUMNS),
        }
    }

    /// Whether the walk is at its end.
    pub fn is_done(&self, settings: &CalibrateSettings) -> bool {
        self.rung >= settings.penalty_ladder.len() || self.idle >= PATIENCE
    }

    /// Takes one step, and goes on to thresholding or the next rung where the steps have come to an end.
    pub fn advance(&mut self, problem: &Problem<'_>) {
        let settings = problem.settings;
        let weight = settings.penalty_ladder[self.rung];
        let goes_on = self.step_down(problem, weight);
        self.step += 1;
        if goes_on && self.step < settings.steps {
            return;
        }
        self.step = 0;
        if !self.is_thresholded && self.at.threshold(settings.threshold) {
            self.is_thresholded = true;
            return;
        }
        self.is_thresholded = false;
        self.idle = if self.best.validation < self.before { 0 } else { self.idle + 1 };
        self.before = self.best.validation;
        self.rung += 1;
    }

    /// One step of (1), judged; whether another one promises anything.
    fn step_down(&mut self, problem: &Problem<'_>, weight: f64) -> bool {
        let kept = self.at.kept();
        let old = problem.objective(&self.at.xi, weight);
        let normal = problem.train.normal(&self.at.xi, &kept);
        let Some(xi) = problem.descend(&normal, &kept, &self.at.xi, weight, old, &mut self.damping) else {
            return false;
        };
        self.at.xi = xi;
        self.at.validation = problem.validation.error(&self.at.xi, None);
        if self.at.validation < self.best.validation {
            self.best = self.at.clone();
        }
        let (observation, penalty) = problem.parts(&self.at.xi);
        let new = observation + weight * penalty;
        let judged = if self.at.validation.is_finite() { self.at.validation } else { f64::NAN };
        let number = self.history.rows.len() as f64;
        self.history.rows.push(vec![number, new, observation, penalty, self.at.terms(), judged, weight]);
        new < (1.0 - SMALLEST_GAIN) * old
    }
}

/// What is minimised, and what judges.
pub struct Problem<'a> {
    /// Events fitted.
    pub train: &'a Records<'a>,
    /// Events judged on.
    pub validation: &'a Records<'a>,
    /// Ξ₀.
    pub origin: &'a [f32],
    /// Latent dimension.
    pub latent: usize,
    /// Settings of the stage.
    pub settings: &'a CalibrateSettings,
}

impl Problem<'_> {
    /// Error of the training events and relative penalty.
    fn parts(&self, xi: &[f32]) -> (f64, f64) {
        let penalty = relative_penalty(self.origin, xi, self.latent, 0.0, &mut []);
        (self.train.misfit(xi).0, penalty)
    }

    fn objective(&self, xi: &[f32], weight: f64) -> f64 {
        let (observation, penalty) = self.parts(xi);
        observation + weight * penalty
    }

    /// The first step that lowers the objective below `old`; the damping is left ready for the step after it.
    fn descend(
        &self,
        normal: &Normal,
        kept: &[usize],
        xi: &[f32],
        weight: f64,
        old: f64,
        damping: &mut f64,
    ) -> Option<Vec<f32>> {
        let was_bounded = self.train.misfit(xi).1;
        while *damping <= DAMPING.1 {
            if let Some(step) = self.step(normal, kept, xi, weight, *damping) {
                let mut moved = xi.to_vec();
                kept.iter().zip(&step).for_each(|(i, d)| moved[*i] = (f64::from(xi[*i]) + d) as f32);
                let (observation, is_bounded) = self.train.misfit(&moved);
                let new = observation + weight * relative_penalty(self.origin, &moved, self.latent, 0.0, &mut []);
                if new < old && (is_bounded || !was_bounded) {
                    *damping = (*damping * 0.2).max(DAMPING.0);
                    return Some(moved);
                }
            }
            *damping *= 5.0;
        }
        *damping = FIRST_DAMPING;
        None
    }

    /// δ of equation (1), nothing where the matrix is not positive.
    fn step(&self, normal: &Normal, kept: &[usize], xi: &[f32], weight: f64, damping: f64) -> Option<Vec<f64>> {
        let r = self.latent;
        let size: Vec<f64> = (0..r)
            .map(|k| self.origin.iter().skip(k).step_by(r).map(|c| f64::from(*c).powi(2)).sum::<f64>().max(1e-12))
            .collect();
        let stiffness = |i: usize| 1.0 / (size[kept[i] % r] * r as f64);
        let matrix = Mat::from_fn(kept.len(), kept.len(), |i, j| {
            normal.curvature(i, j) + if i == j { (weight + damping) * stiffness(i) } else { 0.0 }
        });
        let change = |i: usize| f64::from(xi[kept[i]] - self.origin[kept[i]]);
        let right = Mat::from_fn(kept.len(), 1, |i, _| -normal.slope(i) - weight * stiffness(i) * change(i));
        let step = matrix.llt(Side::Lower).ok()?.solve(&right);
        let step: Vec<f64> = (0..kept.len()).map(|i| step[(i, 0)]).collect();
        step.iter().all(|d| d.is_finite()).then_some(step)
    }
}
