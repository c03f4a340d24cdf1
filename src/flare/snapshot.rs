//! Named arrays of a training on disk, under a fingerprint of all it learns from, so that a killed training goes on where
//! it was and any other starts afresh.

use super::case::{Case, Event};
use super::history::History;
use crate::error::{Context, Result};
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use std::collections::HashMap;
use std::path::Path;

/// Safetensors, followed by the BLAKE3 of all before it.
const FILE: &str = "training.state";

/// Where a training keeps its state, and under which fingerprint.
pub type Checkpoint<'a> = Option<(&'a Path, String)>;

/// The state of a training as plain arrays and texts.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Snapshot {
    arrays: HashMap<String, Vec<u8>>,
    kinds: Vec<(String, Dtype)>,
    texts: HashMap<String, String>,
}

impl Snapshot {
    /// Adds single-precision numbers.
    pub fn floats(&mut self, name: &str, values: &[f32]) {
        self.put(name, Dtype::F32, bytes_f32(values));
    }

    /// Adds double-precision numbers.
    pub fn doubles(&mut self, name: &str, values: &[f64]) {
        self.put(name, Dtype::F64, bytes_f64(values));
    }

    /// Adds a mask.
    pub fn mask(&mut self, name: &str, mask: &[bool]) {
        self.put(name, Dtype::U8, bytes_mask(mask));
    }

    /// Adds a text.
    pub fn text(&mut self, name: &str, text: String) {
        self.texts.insert(name.to_string(), text);
    }

    /// Adds a loss history.
    pub fn history(&mut self, history: &History) {
        self.doubles("history", &history.rows.concat());
        self.text("columns", history.columns.join(","));
    }

    fn put(&mut self, name: &str, kind: Dtype, bytes: Vec<u8>) {
        self.kinds.push((name.to_string(), kind));
        self.arrays.insert(name.to_string(), bytes);
    }

    /// Single-precision numbers by name.
    pub fn get_floats(&self, name: &str) -> Option<Vec<f32>> {
        Some(floats(self.arrays.get(name)?))
    }

    /// Double-precision numbers by name.
    pub fn get_doubles(&self, name: &str) -> Option<Vec<f64>> {
        let words = self.arrays.get(name)?.as_chunks::<8>().0;
        Some(words.iter().map(|b| f64::from_le_bytes(*b)).collect())
    }

    /// A mask by name.
    pub fn get_mask(&self, name: &str) -> Option<Vec<bool>> {
        Some(self.arrays.get(name)?.iter().map(|b| *b != 0).collect())
    }

    /// A text by name.
    pub fn get_text(&self, name: &str) -> Option<&str> {
        self.texts.get(name).map(String::as_str)
    }

    /// The loss history.
    pub fn get_history(&self) -> Option<History> {
        let columns: Vec<String> = self.get_text("columns")?.split(',').map(String::from).collect();
        let rows = self.get_doubles("history")?.chunks_exact(columns.len()).map(<[f64]>::to_vec).collect();
        Some(History { columns, rows })
    }

    /// Writes the snapshot beside the last one and renames it into place.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, dir: &Path, fingerprint: &str) -> Result<()> {
        let describe = || format!("cannot write `{}`", dir.join(FILE).display());
        let views: Vec<(&str, TensorView<'_>)> = self
            .kinds
            .iter()
            .map(|(name, kind)| {
                let data = &self.arrays[name];
                TensorView::new(*kind, vec![data.len() * 8 / kind.bitsize()], data).map(|view| (name.as_str(), view))
            })
            .collect::<std::result::Result<_, _>>()
            .context(describe)?;
        let mut card = self.texts.clone();
        card.insert("fingerprint".into(), fingerprint.into());
        let mut bytes = serialize(views, Some(card)).context(describe)?;
        bytes.extend(blake3::hash(&bytes).as_bytes());
        std::fs::create_dir_all(dir).context(describe)?;
        super::checkpoint::publish(&dir.join(FILE), &bytes)
    }

    /// The snapshot of the same training (`fingerprint`) if there is a sound one in `dir`.
    pub fn load(dir: &Path, fingerprint: &str) -> Option<Self> {
        let stored = std::fs::read(dir.join(FILE)).ok()?;
        let (bytes, hash) = stored.split_last_chunk::<{ blake3::OUT_LEN }>()?;
        if blake3::hash(bytes) != *hash {
            return None;
        }
        let (_, metadata) = SafeTensors::read_metadata(bytes).ok()?;
        let texts = metadata.metadata().clone()?;
        if texts.get("fingerprint")? != fingerprint {
            return None;
        }
        let tensors = SafeTensors::deserialize(bytes).ok()?;
        let mut snapshot = Self { texts, ..Self::default() };
        tensors.iter().for_each(|(name, tensor)| snapshot.put(name, tensor.dtype(), tensor.data().to_vec()));
        Some(snapshot)
    }
}

/// Identifies a training by everything it depends on, told one after the other.
pub struct Fingerprint(blake3::Hasher);

impl Fingerprint {
    /// Of a training of some kind; the kind carries a version.
    pub fn new(kind: &str) -> Self {
        Self(blake3::Hasher::new_derive_key(kind))
    }

    /// Adds settings or names.
    #[must_use]
    pub fn text(mut self, text: &str) -> Self {
        self.0.update(text.as_bytes());
        self
    }

    /// Adds numbers.
    #[must_use]
    pub fn floats(mut self, values: &[f32]) -> Self {
        self.0.update(&bytes_f32(values));
        self
    }

    /// Adds simulated cases.
    #[must_use]
    pub fn cases<'a>(self, cases: impl Iterator<Item = &'a Case>) -> Self {
        cases.fold(self, |f, c| f.text(&c.id).floats(&c.u).floats(&c.u_half).floats(&c.dense))
    }

    /// Adds the sensors of simulated cases.
    #[must_use]
    pub fn sensors<'a>(self, cases: impl Iterator<Item = &'a Case>) -> Self {
        cases.fold(self, |f, c| f.floats(&c.sparse))
    }

    /// Adds events.
    #[must_use]
    pub fn events<'a>(self, events: impl Iterator<Item = &'a Event>) -> Self {
        events.fold(self, |f, e| f.text(&e.id).floats(&e.u).floats(&e.u_half).floats(&e.sparse))
    }

    /// The fingerprint.
    pub fn finish(self) -> String {
        self.0.finalize().to_string()
    }
}

pub(super) fn bytes_f32(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn bytes_f64(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

pub(super) fn bytes_mask(mask: &[bool]) -> Vec<u8> {
    mask.iter().map(|k| u8::from(*k)).collect()
}

pub(super) fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_changed_byte_or_another_training_starts_afresh() {
        let dir = tempfile::tempdir().unwrap();
        let mut snapshot = Snapshot::default();
        snapshot.floats("weights", &[0.5, -1.5]);
        snapshot.text("shape", "wide".into());
        snapshot.save(dir.path(), "this").unwrap();
        let back = Snapshot::load(dir.path(), "this").unwrap();
        assert_eq!(back.get_floats("weights"), Some(vec![0.5, -1.5]));
        assert!(Snapshot::load(dir.path(), "that").is_none());
        let path = dir.path().join(FILE);
        let sound = std::fs::read(&path).unwrap();
        for i in 0..sound.len() {
            let mut changed = sound.clone();
            changed[i] ^= 4;
            std::fs::write(&path, &changed).unwrap();
            assert!(Snapshot::load(dir.path(), "this").is_none(), "byte {i}");
        }
        for length in 0..sound.len() {
            std::fs::write(&path, &sound[..length]).unwrap();
            assert!(Snapshot::load(dir.path(), "this").is_none(), "{length} bytes");
        }
    }
}
