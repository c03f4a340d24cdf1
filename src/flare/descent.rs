//! Stage 3 by gradient descent with Adam, as published: one step an epoch along the exact gradient of all training events.

use super::adam::{Adam, cosine};
use super::calibrate::Candidate;
use super::gauss_newton::Problem;
use super::history::History;
use super::pretrain::thresholds_after;
use super::snapshot::Checkpoint;
use crate::error::Result;
use crate::progress::Progress;

/// Longest gradient an optimiser step may follow.
const CLIP: f64 = 10.0;
/// Epochs between checkpoints.
const CHECKPOINT_EVERY: usize = 25;

/// All that the next epoch depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct Descent {
    /// Epochs done.
    pub epoch: usize,
    /// Where it is.
    pub at: Candidate,
    /// The candidate best on the validation events.
    pub best: Candidate,
    /// The optimiser.
    pub adam: Adam,
    /// Losses so far.
    pub history: History,
}

impl Descent {
    /// Before the first epoch.
    pub fn new(problem: &Problem<'_>, start: Candidate) -> Self {
        let adam = Adam::new(start.xi.len());
        let history = History::new(&["epoch", "total", "observation", "penalty", "terms", "validation"]);
        let mut descent = Self { epoch: 0, at: start.clone(), best: start, adam, history };
        descent.tell(f64::NAN, problem.train.error(&descent.at.xi, None), 0.0);
        descent
    }

    /// One epoch.
    pub fn advance(&mut self, problem: &Problem<'_>) {
        let Problem { train, validation, penalty, settings, .. } = *problem;
        let mut gradient = vec![0.0; self.at.xi.len()];
        let error = train.error(&self.at.xi, Some(&mut gradient));
        let cost = penalty.value(&self.at.xi);
        let pull = penalty.half_gradient(&self.at.xi);
        gradient.iter_mut().zip(&pull).for_each(|(g, p)| *g += (2.0 * settings.penalty * p) as f32);
        gradient.iter_mut().zip(&self.at.mask).filter(|(_, keep)| !**keep).for_each(|(g, _)| *g = 0.0);
        let share = self.epoch as f64 / settings.epochs as f64;
        let rate = settings.learning_rate * cosine(share, settings.final_rate_share);
        self.adam.update(&mut self.at.xi, &gradient, &[(0..pull.len(), rate)], CLIP);
        self.epoch += 1;
        if thresholds_after(self.epoch, settings.epochs, settings.threshold_every) {
            self.at.threshold(settings.threshold);
            self.adam.restart();
        }
        let is_judged = self.epoch == settings.epochs || self.epoch.is_multiple_of(settings.validate_every);
        self.at.validation = if is_judged { validation.error(&self.at.xi, None) } else { f64::INFINITY };
        if self.at.validation < self.best.validation {
            self.best = self.at.clone();
        }
        self.tell(error + settings.penalty * cost, error, cost);
    }

    fn tell(&mut self, total: f64, error: f64, cost: f64) {
        let judged = if self.at.validation.is_finite() { self.at.validation } else { f64::NAN };
        self.history.rows.push(vec![self.epoch as f64, total, error, cost, self.at.terms(), judged]);
    }
}

/// Trains from `start` and returns the candidate best on the validation events.
///
/// # Errors
/// When a checkpoint cannot be written.
pub fn descend(
    problem: &Problem<'_>,
    start: &Candidate,
    checkpoint: &Checkpoint<'_>,
    progress: &dyn Progress,
) -> Result<(Candidate, History)> {
    let settings = problem.settings;
    let kept = checkpoint.as_ref().and_then(|(dir, print)| Descent::load(dir, print));
    let mut descent = kept.unwrap_or_else(|| Descent::new(problem, start.clone()));
    progress.start("calibrate", settings.epochs as u64);
    progress.advance(descent.epoch as u64);
    while descent.epoch < settings.epochs {
        descent.advance(problem);
        if let Some((dir, print)) = checkpoint
            && descent.epoch.is_multiple_of(CHECKPOINT_EVERY)
        {
            descent.save(dir, print)?;
        }
        progress.advance(1);
    }
    Ok((descent.best, descent.history))
}
