//! Stage 3 by Gauss–Newton steps: few unknowns, so the exact second-order model of all records is cheap.
//!
//! ```text
//! (JᵀJ + (λ + μ) P) δ = −(Jᵀρ + λ P ΔΞ)                                                                    (1)
//! ```
//!
//! `λ` is the weight of the penalty and `P` its matrix, `μ` the damping of Levenberg and Marquardt in the same metric: a step
//! is taken if it lowers the objective and no rollout of a training event leaves its bound, and shortened (larger μ) until it
//! does. A walk goes down a ladder of falling penalties, each rung from where the last one ended and with what it left after
//! thresholding. There is one walk from Ξ₀ for each choice of free terms. Every step is judged on the validation events, which thereby
//! choose penalty and terms; a walk ends when some rungs in a row bring nothing there.

use super::calibrate::Candidate;
use super::events::Records;
use super::history::History;
use super::library::Library;
use super::normal::Normal;
use super::penalty::Penalty;
use super::settings::{CalibrateSettings, FreeTerms};
use super::snapshot::Checkpoint;
use crate::error::Result;
use crate::progress::Progress;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

/// Where the damping starts and how far it may go.
pub(super) const FIRST_DAMPING: f64 = 1.0;
const DAMPING: (f64, f64) = (1e-6, 1e8);
/// A rung ends when a step lowers the objective by less than this share.
pub(super) const SMALLEST_GAIN: f64 = 5e-3;
/// Rungs in a row without a better validation that end a walk.
pub(super) const PATIENCE: usize = 3;

/// Columns of the history.
const COLUMNS: [&str; 8] = ["step", "total", "observation", "penalty", "terms", "validation", "weight", "free"];

/// What is minimised, and what judges.
pub struct Problem<'a> {
    /// Events fitted.
    pub train: &'a Records<'a>,
    /// Events judged on.
    pub validation: &'a Records<'a>,
    /// What a correction costs.
    pub penalty: &'a Penalty,
    /// Terms of the equations.
    pub library: Library,
    /// Settings of the stage.
    pub settings: &'a CalibrateSettings,
}

/// All walks: what the next step depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct Search {
    /// Which walk, an index into the choices of free terms.
    pub walk: usize,
    /// Rung of the ladder.
    pub rung: usize,
    /// Steps taken since the rung began.
    pub step: usize,
    /// Rungs since the walk last bettered its own validation error.
    pub idle: usize,
    /// The lowest validation error of this walk.
    pub lowest: f64,
    /// The lowest validation error of this walk before this rung.
    pub before: f64,
    /// Damping μ.
    pub damping: f64,
    /// Where the walk is.
    pub at: Candidate,
    /// The best candidate of all so far.
    pub best: Candidate,
    /// What was tried so far.
    pub history: History,
}

impl Search {
    /// Before the first step.
    pub fn new(start: Candidate) -> Self {
        Self {
            walk: 0,
            rung: 0,
            step: 0,
            idle: 0,
            lowest: start.validation,
            before: start.validation,
            damping: FIRST_DAMPING,
            at: start.clone(),
            best: start,
            history: History::new(&COLUMNS),
        }
    }

    /// Whether all walks are at their ends.
    pub fn is_done(&self, settings: &CalibrateSettings) -> bool {
        self.walk >= settings.free_terms.len()
    }

    /// Rungs behind it, those of ended walks counted in full.
    pub fn rungs_done(&self, settings: &CalibrateSettings) -> usize {
        self.walk * settings.penalty_ladder.len() + self.rung
    }

    /// Takes one step; where the steps have come to an end, thresholds and goes on to the next rung or, from `start`, to the
    /// next walk.
    pub fn advance(&mut self, problem: &Problem<'_>, start: &Candidate) {
        let settings = problem.settings;
        let goes_on = self.step_down(problem);
        self.step += 1;
        if goes_on && self.step < settings.steps {
            return;
        }
        self.step = 0;
        if self.at.threshold(settings.threshold) {
            self.judge(problem);
        }
        self.idle = if self.lowest < self.before { 0 } else { self.idle + 1 };
        self.before = self.lowest;
        self.rung += 1;
        if self.idle >= PATIENCE || self.rung >= settings.penalty_ladder.len() {
            let next = Self::new(start.clone());
            let (walk, best, history) = (self.walk + 1, self.best.clone(), std::mem::take(&mut self.history));
            *self = Self { walk, best, history, ..next };
        }
    }

    /// Judges where the walk is on the validation events; one that diverges there can never be the best.
    fn judge(&mut self, problem: &Problem<'_>) {
        self.at.validation = problem.validation.error(&self.at.xi, None);
        self.lowest = self.lowest.min(self.at.validation);
        if self.at.validation < self.best.validation {
            self.best = self.at.clone();
        }
    }

    /// One step of (1), judged; whether another one promises anything.
    fn step_down(&mut self, problem: &Problem<'_>) -> bool {
        let weight = problem.settings.penalty_ladder[self.rung];
        let free = problem.free(&self.at, problem.settings.free_terms[self.walk]);
        let old = problem.objective(&self.at.xi, weight);
        let normal = problem.train.normal(&self.at.xi, &free);
        let descent = Descent { train: problem.train, penalty: problem.penalty, weight, free: &free };
        let Some((xi, observation)) = descent.step(&normal, &self.at.xi, old, &mut self.damping) else {
            return false;
        };
        self.at.xi = xi;
        self.judge(problem);
        let penalty = problem.penalty.value(&self.at.xi);
        let new = observation + weight * penalty;
        let judged = if self.at.validation.is_finite() { self.at.validation } else { f64::NAN };
        let number = 1.0 + self.history.rows.len() as f64;
        let row = vec![number, new, observation, penalty, self.at.terms(), judged, weight, free.len() as f64];
        self.history.rows.push(row);
        new < (1.0 - SMALLEST_GAIN) * old
    }
}

/// Walks every walk from `start`, and returns the candidate best on the validation events.
///
/// # Errors
/// When a checkpoint cannot be written.
pub fn search(
    problem: &Problem<'_>,
    start: &Candidate,
    checkpoint: &Checkpoint<'_>,
    progress: &dyn Progress,
) -> Result<(Candidate, History)> {
    let settings = problem.settings;
    let kept = checkpoint.as_ref().and_then(|(dir, print)| Search::load(dir, print));
    let mut search = kept.unwrap_or_else(|| Search::new(start.clone()));
    progress.start("calibrate", (settings.free_terms.len() * settings.penalty_ladder.len()) as u64);
    progress.advance(search.rungs_done(settings) as u64);
    while !search.is_done(settings) {
        let before = search.rungs_done(settings);
        search.advance(problem, start);
        if let Some((dir, print)) = checkpoint {
            search.save(dir, print)?;
        }
        progress.advance((search.rungs_done(settings) - before) as u64);
    }
    Ok((search.best, search.history))
}

impl Problem<'_> {
    /// Indices of the coefficients that may move.
    fn free(&self, at: &Candidate, terms: FreeTerms) -> Vec<usize> {
        let r = self.library.latent;
        let quadratic = self.library.linear_row(r)..self.library.input_row();
        let is_free = |i: &usize| terms == FreeTerms::All || !quadratic.contains(&(i / r));
        (0..at.mask.len()).filter(|i| at.mask[*i]).filter(is_free).collect()
    }

    /// Error of the training events and relative penalty.
    fn parts(&self, xi: &[f32]) -> (f64, f64) {
        (self.train.misfit(xi).0, self.penalty.value(xi))
    }

    fn objective(&self, xi: &[f32], weight: f64) -> f64 {
        let (observation, penalty) = self.parts(xi);
        observation + weight * penalty
    }
}

/// What a step of (1) lowers, and over which coefficients.
pub(super) struct Descent<'a> {
    /// Events fitted.
    pub train: &'a Records<'a>,
    /// What a correction costs, and the metric of the damping.
    pub penalty: &'a Penalty,
    /// λ.
    pub weight: f64,
    /// Coefficients that may move.
    pub free: &'a [usize],
}

impl Descent<'_> {
    /// The first step from `xi` that lowers the objective below `old`, with its error of the training events; the damping is left
    /// ready for the step after it.
    pub fn step(&self, normal: &Normal, xi: &[f32], old: f64, damping: &mut f64) -> Option<(Vec<f32>, f64)> {
        let was_bounded = self.train.misfit(xi).1;
        while *damping <= DAMPING.1 {
            if let Some(step) = self.solve(normal, xi, *damping) {
                let mut moved = xi.to_vec();
                self.free.iter().zip(&step).for_each(|(i, d)| moved[*i] = (f64::from(xi[*i]) + d) as f32);
                let (observation, is_bounded) = self.train.misfit(&moved);
                let new = observation + self.weight * self.penalty.value(&moved);
                if new < old && (is_bounded || !was_bounded) {
                    *damping = (*damping * 0.2).max(DAMPING.0);
                    return Some((moved, observation));
                }
            }
            *damping *= 5.0;
        }
        *damping = FIRST_DAMPING;
        None
    }

    /// δ of equation (1), nothing where the matrix is not positive.
    fn solve(&self, normal: &Normal, xi: &[f32], damping: f64) -> Option<Vec<f64>> {
        let Self { penalty, weight, free, .. } = self;
        let matrix = Mat::from_fn(free.len(), free.len(), |i, j| {
            normal.curvature(i, j) + (weight + damping) * penalty.curvature(free[i], free[j])
        });
        let pull = penalty.half_gradient(xi);
        let right = Mat::from_fn(free.len(), 1, |i, _| -normal.slope(i) - weight * pull[free[i]]);
        let step = matrix.llt(Side::Lower).ok()?.solve(&right);
        let step: Vec<f64> = (0..free.len()).map(|i| step[(i, 0)]).collect();
        step.iter().all(|d| d.is_finite()).then_some(step)
    }
}
