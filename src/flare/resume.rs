//! The training state on disk, so that a killed training goes on where it was.

use super::adam::Adam;
use super::case::Case;
use super::history::History;
use super::model::SourceModel;
use super::settings::PretrainSettings;
use crate::error::{Context, Result};
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use std::collections::HashMap;
use std::path::Path;

const FILE: &str = "training.safetensors";

/// The best candidate so far.
#[derive(Debug, Clone, PartialEq)]
pub struct Best {
    /// Its validation score.
    pub score: f64,
    /// The candidate.
    pub model: SourceModel,
}

/// All that the next epoch depends on.
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

    /// Writes the state beside and renames it into place.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, dir: &Path, fingerprint: &str) -> Result<()> {
        let best = self.best.as_ref();
        let best_model = best.map_or(&self.model, |b| &b.model);
        let counters = [self.epoch as f64, f64::from(self.adam.step), best.map_or(f64::INFINITY, |b| b.score)];
        let rows: Vec<f64> = self.history.rows.concat();
        let entries = [
            ("counters", Dtype::F64, bytes_f64(&counters)),
            ("history", Dtype::F64, bytes_f64(&rows)),
            ("parameters", Dtype::F32, bytes_f32(&self.model.parameters)),
            ("mask", Dtype::U8, bytes_mask(&self.model.mask)),
            ("adam.first", Dtype::F32, bytes_f32(&self.adam.first)),
            ("adam.second", Dtype::F32, bytes_f32(&self.adam.second)),
            ("best.parameters", Dtype::F32, bytes_f32(&best_model.parameters)),
            ("best.mask", Dtype::U8, bytes_mask(&best_model.mask)),
        ];
        let describe = || format!("cannot write `{}`", dir.join(FILE).display());
        let views: Vec<(&str, TensorView<'_>)> = entries
            .iter()
            .map(|(name, dtype, data)| {
                TensorView::new(*dtype, vec![data.len() * 8 / dtype.bitsize()], data).map(|view| (*name, view))
            })
            .collect::<std::result::Result<_, _>>()
            .context(describe)?;
        let shape = serde_json::to_string(&self.model.shape).context(describe)?;
        let card =
            [("fingerprint", fingerprint.to_string()), ("shape", shape), ("columns", self.history.columns.join(","))];
        let card = HashMap::from(card.map(|(key, value)| (key.to_string(), value)));
        let bytes = serialize(views, Some(card)).context(describe)?;
        std::fs::create_dir_all(dir).context(describe)?;
        super::checkpoint::publish(&dir.join(FILE), &bytes)
    }

    /// The state of the same training (`fingerprint`) if there is a sound one in `dir`; anything else starts afresh.
    pub fn load(dir: &Path, fingerprint: &str) -> Option<Self> {
        let bytes = std::fs::read(dir.join(FILE)).ok()?;
        let (_, metadata) = SafeTensors::read_metadata(&bytes).ok()?;
        if metadata.metadata().as_ref()?.get("fingerprint")? != fingerprint {
            return None;
        }
        let tensors = SafeTensors::deserialize(&bytes).ok()?;
        let f32s = |name: &str| Some(floats(tensors.tensor(name).ok()?.data()));
        let f64s = |name: &str| Some(doubles(tensors.tensor(name).ok()?.data()));
        let mask = |name: &str| Some(tensors.tensor(name).ok()?.data().iter().map(|b| *b != 0).collect::<Vec<bool>>());
        let shape: super::model::Shape = serde_json::from_str(metadata.metadata().as_ref()?.get("shape")?).ok()?;
        let counters = f64s("counters")?;
        let columns = metadata.metadata().as_ref()?.get("columns")?.split(',').map(String::from).collect::<Vec<_>>();
        let rows = f64s("history")?.chunks_exact(columns.len()).map(<[f64]>::to_vec).collect();
        let model = |prefix: &str| {
            Some(SourceModel {
                shape: shape.clone(),
                parameters: f32s(&format!("{prefix}parameters"))?,
                mask: mask(&format!("{prefix}mask"))?,
            })
        };
        let best_score = *counters.get(2)?;
        let best = if best_score.is_finite() { Some(Best { score: best_score, model: model("best.")? }) } else { None };
        Some(Self {
            epoch: *counters.first()? as usize,
            model: model("")?,
            adam: Adam { first: f32s("adam.first")?, second: f32s("adam.second")?, step: *counters.get(1)? as u32 },
            best,
            history: History { columns, rows },
        })
    }
}

/// Identifies a training: settings, seed and every number it learns from.
pub fn fingerprint<'a>(settings: &PretrainSettings, seed: u64, cases: impl Iterator<Item = &'a Case>) -> String {
    let mut hash = blake3::Hasher::new_derive_key("flare-pipe pretraining v1");
    hash.update(format!("{settings:?} {seed}").as_bytes());
    for case in cases {
        hash.update(case.id.as_bytes());
        [&case.u, &case.u_half, &case.dense].into_iter().for_each(|x| {
            hash.update(&bytes_f32(x));
        });
    }
    hash.finalize().to_string()
}

pub(super) fn bytes_f32(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

pub(super) fn bytes_f64(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

pub(super) fn bytes_mask(mask: &[bool]) -> Vec<u8> {
    mask.iter().map(|k| u8::from(*k)).collect()
}

pub(super) fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

fn doubles(bytes: &[u8]) -> Vec<f64> {
    bytes.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
}
