//! What a diagnosis goes through, from the declared model to the corrected one.

use super::anchor::Anchor;
use super::outcome::{Candidate, Thresholds};
use super::problem::Replay;
use super::responses::Scene;
use super::round::Fitted;
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use crate::error::Result;
use crate::progress::Progress;

/// Most replays of an answer.
const REPLAYS: usize = 4;

/// What a diagnosis went through.
pub(super) struct Path {
    /// The model as declared.
    pub declared: Model,
    /// Recalibrated within the tolerances, restarted from better nuisances where a fit found them.
    pub recalibrated: Model,
    /// With every accepted effect.
    pub corrected: Model,
    /// Accepted effects as they were when accepted.
    pub accepted: Vec<Fitted>,
    /// Everything fitted, round by round.
    pub candidates: Vec<Candidate>,
    /// The first round, best first.
    pub first: Vec<Fitted>,
    /// What the corrected model was settled against.
    pub anchor: Anchor,
    /// Declared nuisances but for the damping: an effect that is strong is seen from there, before nuisances have taken its
    /// place.
    pub plain: Vec<f64>,
    /// Estimates of other models that leave nothing either, each unknown with its standard deviation.
    pub alternatives: Vec<Vec<[f64; 2]>>,
    /// Anchor of the best effect of the last round.
    pub confirmed: Option<Anchor>,
    /// The same effect at another place, where that was confirmed too.
    pub rival: Option<Model>,
    /// Kinds that say the same in place of an effect of the corrected model.
    pub stand_ins: Vec<String>,
}

impl Path {
    /// Gives the priors this weight from now on.
    pub fn stiffen(
        &mut self,
        scene: &mut Scene<'_>,
        (stiffness, settings): (f64, &DiagnoseSettings),
        replay: &dyn Replay,
    ) -> Result<()> {
        if scene.stiffness != stiffness {
            scene.stiffness = stiffness;
            let search = Search::new(scene, settings, Some(replay))?;
            self.corrected = search.settle(&self.corrected.effects, self.corrected.x(), &self.anchor, None, 0)?;
        }
        Ok(())
    }

    /// Writes down what a round fitted.
    pub fn note(&mut self, fitted: &[Fitted], round: usize) {
        let excess = self.recalibrated.excess().max(1.0);
        self.candidates.extend(fitted.iter().map(|f| {
            let x = f.model.x();
            let own = &x[x.len() - f.instance.free.len()..];
            Candidate {
                kind: f.instance.kind.to_string(),
                target: f.instance.place(),
                class: f.instance.class(),
                gain: f.gain,
                validation_gain: f.validation_gain,
                explained_share: ((self.recalibrated.cost() - f.model.cost()) / excess).clamp(0.0, 1.0),
                round,
                is_confirmed: f.is_confirmed,
                table: f.instance.at(own),
            }
        }));
    }

    /// Goes back to what was `settled` before a round that found nothing, where a replay finds the base that it moved to worse.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub fn stay(&mut self, search: &Search<'_>, settled: (Model, Anchor), progress: &dyn Progress) -> Result<()> {
        self.replay(search, progress)?;
        if self.corrected.cost() > settled.0.cost() {
            (self.corrected, self.anchor) = settled;
            if self.accepted.is_empty() {
                self.recalibrated = self.corrected.clone();
            }
        }
        Ok(())
    }

    /// Replays what is about to be said, so that the verdict is on what the finite-element column leaves, and fits again where that
    /// is not what was expected.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub fn replay(&mut self, search: &Search<'_>, progress: &dyn Progress) -> Result<()> {
        let before = self.corrected.cost();
        (self.corrected, self.anchor) =
            search.replayed(self.corrected.clone(), (None, &self.anchor), (REPLAYS, before), progress)?;
        progress.note(&format!("answer: cost {before:.0} before its replay, {:.0} now", self.corrected.cost()));
        Ok(())
    }

    /// Settles the answer with derivatives right where it is, which `scene` has from then on, and takes out what then is in doubt and
    /// needless.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub fn look_closely(
        &mut self,
        scene: &mut Scene<'_>,
        (replay, settings): (&dyn Replay, &DiagnoseSettings),
        thresholds: &Thresholds,
        progress: &dyn Progress,
    ) -> Result<()> {
        let around = scene.clone();
        let here = (self.corrected.clone(), self.anchor.clone());
        (self.corrected, self.anchor) = scene.settled_closely(here, replay, settings, progress)?;
        let n_accepted = self.accepted.len();
        Search::new(scene, settings, Some(replay))?.drop_doubtful(self, thresholds, progress)?;
        let is_replaced = self.try_stand_ins(scene, (replay, settings), progress)?;
        if is_replaced {
            Search::new(scene, settings, Some(replay))?.drop_doubtful(self, thresholds, progress)?;
        }
        if !is_replaced && self.accepted.len() == n_accepted {
            return Ok(());
        }
        if self.accepted.is_empty() && self.corrected.cost() < self.recalibrated.cost() {
            self.recalibrated = self.corrected.clone();
        }
        let search = Search::new(&around, settings, Some(replay))?;
        let anchor = search.anchored(&self.corrected.effects, self.corrected.x(), None)?;
        self.alternatives = around.alternatives((&self.corrected, &anchor), replay, settings, progress)?;
        Ok(())
    }
}
