//! Fits and replays in turn, until a replay finds what the fit before has promised.

use super::anchor::Anchor;
use super::problem::Replay;
use super::responses::Scene;
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use crate::effects::Instance;
use crate::error::Result;
use crate::progress::Progress;

/// Most steps of a fit, and after a new anchor.
const STEPS: [usize; 2] = [12, 6];
/// Replays that are enough for a model to settle.
pub(super) const MAX_ANCHORS: usize = 10;
/// Replays in a row that end it by being no better than the best one.
const MAX_FAILURES: usize = 3;
/// Hold on a fit after the first replay that did not keep what the fit promised, and its growth with each more.
const HOLD: [f64; 2] = [10.0, 10.0];

impl Scene<'_> {
    /// The model with `effects` settled from `x` with replays around it, which are followed from then on, and `most` replays more.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn settled_around(
        &mut self,
        (effects, x): (&[Instance], &[f64]),
        (replay, most): (&dyn Replay, usize),
        settings: &DiagnoseSettings,
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let anchor = self.look_around(replay, settings, (effects, x), progress)?;
        Search::new(self, settings, Some(replay))?.settled(effects, x, (anchor, most), progress)
    }
}

impl Search<'_> {
    /// Fits from `x` and its `anchor`, replays, and fits again as long as that helps, `most` times at most.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn settled(
        &self,
        effects: &[Instance],
        x: &[f64],
        (anchor, most): (Anchor, usize),
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let start = self.settle(effects, x, &anchor, None, 0)?;
        let fitted = self.settle(effects, x, &anchor, Some(&start), STEPS[0])?;
        let best = Some((start, anchor.clone()));
        self.replayed_until_settled(fitted, (best, &anchor), (most, f64::INFINITY), progress)
    }

    /// Replays `start`, fits from there, and again as long as that helps, at most `most` times; gives up where a replay still
    /// costs more than twice what is at stake and half of the one before. `best` is what is known already, `from` the anchor of
    /// `start`.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn replayed_until_settled(
        &self,
        start: Model,
        (best, from): (Option<(Model, Anchor)>, &Anchor),
        (most, at_stake): (usize, f64),
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let (seen, anchor) = self.replayed(start, (best, from), (most, at_stake), progress)?;
        Ok((self.settle(&seen.effects, seen.x(), &anchor, Some(&seen), STEPS[1])?, anchor))
    }

    /// The same without the last fit: the best that a replay has found.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn replayed(
        &self,
        start: Model,
        (mut best, from): (Option<(Model, Anchor)>, &Anchor),
        (most, at_stake): (usize, f64),
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let effects = start.effects.clone();
        let (mut x, mut expected) = (start.x().to_vec(), start.train.cost);
        let mut failures = 0;
        let mut hold = 0.0;
        for number in 1..=most {
            let next = self.anchored(&effects, &x, Some(best.as_ref().map_or(from, |b| &b.1)))?;
            let seen = self.settle(&effects, &x, &next, Some(&start), 0)?;
            let name = effects.last().map_or("recalibration", |e| e.kind);
            progress.note(&format!(
                "{name}: cost {expected:.0} expected, {:.0} + {:.0} found, {:.0} + {:.0} noise",
                seen.train.cost,
                seen.validation_cost(),
                seen.expected[0],
                seen.expected[1]
            ));
            let before = best.as_ref().map_or(f64::INFINITY, |b| b.0.cost());
            let mut is_done = number == most;
            if seen.cost() < before {
                is_done |=
                    seen.cost() > 0.995 * before || (number > 1 && seen.cost() > (2.0 * at_stake).max(0.5 * before));
                hold = loosened(hold);
                best = Some((seen, next));
                failures = 0;
            } else if let Some((_, anchor)) = &mut best {
                // Not what was promised: what this replay has told keeps the next step from going there.
                anchor.secants.learn(&next.secants);
                hold = tightened(hold);
                failures += 1;
                is_done |= failures == MAX_FAILURES;
            }
            if is_done {
                break;
            }
            if let Some((best, anchor)) = &best {
                let wanted = self.fitted(&effects, best.x(), (anchor, Some(best)), (STEPS[1], hold))?;
                (x, expected) = (wanted.x, wanted.cost);
            }
        }
        Ok(best.unwrap_or_else(|| (start, Anchor::fast(self.scene))))
    }
}

/// The hold on the next fit after a replay that kept its promise.
fn loosened(hold: f64) -> f64 {
    if hold > HOLD[0] { 0.3 * hold } else { 0.0 }
}

/// The same after one that did not.
fn tightened(hold: f64) -> f64 {
    (HOLD[1] * hold).max(HOLD[0])
}
