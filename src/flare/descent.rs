//! Stage 3 by gradient descent with Adam, as published: one step an epoch along the exact gradient of all training events.

use super::adam::{Adam, cosine};
use super::calibrate::Candidate;
use super::gauss_newton::Problem;
use super::history::History;
use super::pretrain::thresholds_after;
use crate::progress::Progress;

/// Longest gradient an optimiser step may follow.
const CLIP: f64 = 10.0;

/// Trains from `start` and returns the candidate best on the validation events, with the loss history.
pub fn descend(problem: &Problem<'_>, start: Candidate, progress: &dyn Progress) -> (Candidate, History) {
    let Problem { train, validation, penalty, settings, .. } = *problem;
    let mut history = History::new(&["epoch", "total", "observation", "penalty", "terms", "validation"]);
    let row = |epoch: usize, total: f64, observation: f64, penalty: f64, at: &Candidate, judged: f64| {
        let judged = if judged.is_finite() { judged } else { f64::NAN };
        vec![epoch as f64, total, observation, penalty, at.terms(), judged]
    };
    history.rows.push(row(0, f64::NAN, train.error(&start.xi, None), 0.0, &start, start.validation));
    let mut best = start.clone();
    let mut at = start;
    let mut adam = Adam::new(at.xi.len());
    let mut gradient = vec![0.0; at.xi.len()];
    progress.start("calibrate", settings.epochs as u64);
    for done in 1..=settings.epochs {
        let error = train.error(&at.xi, Some(&mut gradient));
        let cost = penalty.value(&at.xi);
        let pull = penalty.half_gradient(&at.xi);
        gradient.iter_mut().zip(&pull).for_each(|(g, p)| *g += (2.0 * settings.penalty * p) as f32);
        gradient.iter_mut().zip(&at.mask).filter(|(_, keep)| !**keep).for_each(|(g, _)| *g = 0.0);
        let share = (done - 1) as f64 / settings.epochs as f64;
        let rate = settings.learning_rate * cosine(share, settings.final_rate_share);
        adam.update(&mut at.xi, &gradient, &[(0..pull.len(), rate)], CLIP);
        if thresholds_after(done, settings.epochs, settings.threshold_every) {
            at.threshold(settings.threshold);
            adam.restart();
        }
        let is_judged = done == settings.epochs || done.is_multiple_of(settings.validate_every);
        at.validation = if is_judged { validation.error(&at.xi, None) } else { f64::INFINITY };
        if at.validation < best.validation {
            best = at.clone();
        }
        let total = error + settings.penalty * cost;
        history.rows.push(row(done, total, error, cost, &at, at.validation));
        progress.advance(1);
    }
    (best, history)
}
