//! What each training needs to go on where it was killed, to and from its [`Snapshot`].

use super::adam::Adam;
use super::calibrate::Candidate;
use super::case::Case;
use super::descent::Descent;
use super::distill::DistillState;
use super::gauss_newton::Search;
use super::history::History;
use super::model::SourceModel;
use super::settings::PretrainSettings;
use super::snapshot::{Fingerprint, Snapshot};
use crate::error::{Context, Result};
use std::path::Path;

/// The best candidate so far.
#[derive(Debug, Clone, PartialEq)]
pub struct Best {
    /// Its validation score.
    pub score: f64,
    /// The candidate.
    pub model: SourceModel,
}

/// All that the next epoch of stage 1 depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingState {
    /// Epochs done.
    pub epoch: usize,
    /// The model as it stands.
    pub model: SourceModel,
    /// The optimiser.
    pub adam: Adam,
    /// The best candidate so far.
    pub best: Option<Best>,
    /// Losses so far.
    pub history: History,
}

impl TrainingState {
    /// Before the first epoch.
    pub fn new(model: SourceModel, history: History) -> Self {
        let adam = Adam::new(model.parameters.len());
        Self { epoch: 0, model, adam, best: None, history }
    }

    /// Keeps the model as it stands if `score` is the lowest so far.
    pub fn consider(&mut self, score: f64) {
        if score < self.best.as_ref().map_or(f64::INFINITY, |b| b.score) {
            self.best = Some(Best { score, model: self.model.clone() });
        }
    }

    /// Writes the state beside the last one and renames it into place.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, dir: &Path, fingerprint: &str) -> Result<()> {
        let best = self.best.as_ref();
        let best_model = best.map_or(&self.model, |b| &b.model);
        let shape = serde_json::to_string(&self.model.shape).context(|| "cannot describe the model".into())?;
        let mut snapshot = Snapshot::default();
        snapshot.doubles("counters", &[self.epoch as f64, best.map_or(f64::INFINITY, |b| b.score)]);
        snapshot.history(&self.history);
        snapshot.floats("parameters", &self.model.parameters);
        snapshot.mask("mask", &self.model.mask);
        snapshot.floats("best.parameters", &best_model.parameters);
        snapshot.mask("best.mask", &best_model.mask);
        self.adam.put(&mut snapshot);
        snapshot.text("shape", shape);
        snapshot.save(dir, fingerprint)
    }

    /// The state of the same training (`fingerprint`) if there is a sound one in `dir`; anything else starts afresh.
    pub fn load(dir: &Path, fingerprint: &str) -> Option<Self> {
        let snapshot = Snapshot::load(dir, fingerprint)?;
        let shape: super::model::Shape = serde_json::from_str(snapshot.get_text("shape")?).ok()?;
        let model = |prefix: &str| {
            Some(SourceModel {
                shape: shape.clone(),
                parameters: snapshot.get_floats(&format!("{prefix}parameters"))?,
                mask: snapshot.get_mask(&format!("{prefix}mask"))?,
            })
        };
        let [epoch, score] = *snapshot.get_doubles("counters")?.as_array()?;
        Some(Self {
            epoch: epoch as usize,
            model: model("")?,
            adam: Adam::get(&snapshot)?,
            best: if score.is_finite() { Some(Best { score, model: model("best.")? }) } else { None },
            history: snapshot.get_history()?,
        })
    }
}

/// Identifies a training of stage 1: settings, seed and every number it learns from.
pub fn fingerprint<'a>(settings: &PretrainSettings, seed: u64, cases: impl Iterator<Item = &'a Case>) -> String {
    Fingerprint::new("flare-pipe pretraining v2").text(&format!("{settings:?} {seed}")).cases(cases).finish()
}

impl DistillState {
    /// As [`TrainingState::save`].
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, dir: &Path, fingerprint: &str) -> Result<()> {
        let mut snapshot = Snapshot::default();
        snapshot.doubles("counters", &[self.epoch as f64, self.best.0]);
        snapshot.history(&self.history);
        snapshot.floats("parameters", &self.parameters);
        snapshot.floats("best.parameters", &self.best.1);
        self.adam.put(&mut snapshot);
        snapshot.save(dir, fingerprint)
    }

    /// As [`TrainingState::load`].
    pub fn load(dir: &Path, fingerprint: &str) -> Option<Self> {
        let snapshot = Snapshot::load(dir, fingerprint)?;
        let [epoch, error] = *snapshot.get_doubles("counters")?.as_array()?;
        Some(Self {
            epoch: epoch as usize,
            parameters: snapshot.get_floats("parameters")?,
            adam: Adam::get(&snapshot)?,
            best: (error, snapshot.get_floats("best.parameters")?),
            history: snapshot.get_history()?,
        })
    }
}

impl Descent {
    /// As [`TrainingState::save`].
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, dir: &Path, fingerprint: &str) -> Result<()> {
        let mut snapshot = Snapshot::default();
        snapshot.doubles("counters", &[self.epoch as f64]);
        snapshot.history(&self.history);
        self.at.put("at", &mut snapshot);
        self.best.put("best", &mut snapshot);
        self.adam.put(&mut snapshot);
        snapshot.save(dir, fingerprint)
    }

    /// As [`TrainingState::load`].
    pub fn load(dir: &Path, fingerprint: &str) -> Option<Self> {
        let snapshot = Snapshot::load(dir, fingerprint)?;
        Some(Self {
            epoch: *snapshot.get_doubles("counters")?.first()? as usize,
            at: Candidate::get("at", &snapshot)?,
            best: Candidate::get("best", &snapshot)?,
            adam: Adam::get(&snapshot)?,
            history: snapshot.get_history()?,
        })
    }
}

impl Search {
    /// As [`TrainingState::save`].
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, dir: &Path, fingerprint: &str) -> Result<()> {
        let mut snapshot = Snapshot::default();
        let counts = [self.walk, self.rung, self.step, self.idle];
        snapshot.doubles("counters", &counts.map(|n| n as f64));
        snapshot.doubles("levels", &[self.lowest, self.before, self.damping]);
        snapshot.history(&self.history);
        self.at.put("at", &mut snapshot);
        self.best.put("best", &mut snapshot);
        snapshot.save(dir, fingerprint)
    }

    /// As [`TrainingState::load`].
    pub fn load(dir: &Path, fingerprint: &str) -> Option<Self> {
        let snapshot = Snapshot::load(dir, fingerprint)?;
        let counters: Vec<usize> = snapshot.get_doubles("counters")?.into_iter().map(|n| n as usize).collect();
        let [walk, rung, step, idle] = *counters.as_array()?;
        let [lowest, before, damping] = *snapshot.get_doubles("levels")?.as_array()?;
        Some(Self {
            walk,
            rung,
            step,
            idle,
            lowest,
            before,
            damping,
            at: Candidate::get("at", &snapshot)?,
            best: Candidate::get("best", &snapshot)?,
            history: snapshot.get_history()?,
        })
    }
}

impl Adam {
    fn put(&self, snapshot: &mut Snapshot) {
        snapshot.floats("adam.first", &self.first);
        snapshot.floats("adam.second", &self.second);
        snapshot.doubles("adam.step", &[f64::from(self.step)]);
    }

    fn get(snapshot: &Snapshot) -> Option<Self> {
        Some(Self {
            first: snapshot.get_floats("adam.first")?,
            second: snapshot.get_floats("adam.second")?,
            step: *snapshot.get_doubles("adam.step")?.first()? as u32,
        })
    }
}

impl Candidate {
    fn put(&self, name: &str, snapshot: &mut Snapshot) {
        snapshot.floats(&format!("{name}.xi"), &self.xi);
        snapshot.mask(&format!("{name}.mask"), &self.mask);
        snapshot.doubles(&format!("{name}.validation"), &[self.validation]);
    }

    fn get(name: &str, snapshot: &Snapshot) -> Option<Self> {
        Some(Self {
            xi: snapshot.get_floats(&format!("{name}.xi"))?,
            mask: snapshot.get_mask(&format!("{name}.mask"))?,
            validation: *snapshot.get_doubles(&format!("{name}.validation"))?.first()?,
        })
    }
}
