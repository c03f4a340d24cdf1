//! What a stage is given to do its work: inputs by role, parameters, an empty folder, a seed, and items.

use super::executor::{Ensemble, Permits, ShardRun, Slurm, Submission};
use super::parameters::lookup;
use super::{Address, ItemRecord, Outputs, Store};
use crate::error::{Context, Error, Result};
use crate::progress::Progress;
use serde::de::DeserializeOwned;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use toml::Table;

/// A kind of items.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ItemKind {
    /// Folder of the cache, with the version.
    name: &'static str,
    version: u32,
    /// Whether they are part of the output of their stage.
    is_output: bool,
}

impl ItemKind {
    /// Items that are part of the output of their stage. Bump `version` when the same parameters would give other numbers.
    pub const fn of_output(name: &'static str, version: u32) -> Self {
        Self { name, version, is_output: true }
    }

    /// Items that are there for their stage to go on, or to be repeated with other settings, until `gc` takes them.
    pub const fn passing(name: &'static str, version: u32) -> Self {
        Self { name, version, is_output: false }
    }
}

/// One item of an ensemble: its parameters are its key, with kind and version.
#[derive(Debug, Clone, PartialEq)]
pub struct Item {
    /// Name within the ensemble ("017"); not part of the key.
    pub id: String,
    /// Everything that can change its output; stands for data by [`content_hash`](super::content_hash).
    pub parameters: Table,
}

/// What became of one item.
#[derive(Debug, Clone, PartialEq)]
pub struct ItemOutcome {
    /// Name within the ensemble.
    pub id: String,
    /// Its folder, or why there is none.
    pub output: std::result::Result<PathBuf, String>,
    /// Wall time of its computation, whenever that was.
    pub seconds: Option<f64>,
}

/// The surroundings of one stage at work.
pub struct Task<'a> {
    pub(super) name: &'a str,
    pub(super) instance: Option<&'a str>,
    pub(super) parameters: Table,
    pub(super) manifest_dir: &'a Path,
    pub(super) inputs: BTreeMap<String, Vec<(Option<String>, PathBuf)>>,
    pub(super) output_dir: PathBuf,
    pub(super) checkpoint_dir: PathBuf,
    pub(super) store: &'a Store,
    pub(super) permits: &'a Permits,
    pub(super) is_forced: bool,
    pub(super) progress: &'a dyn Progress,
    /// Who computes ensembles, if not this process, and where its output will lie.
    pub(super) slurm: Option<&'a Slurm>,
    pub(super) address: &'a Address,
    /// What of an ensemble this process computes, if it is not all.
    pub(super) shard: Option<&'a ShardRun>,
    /// By ensemble; sorted, since several may be computed at once and end in any order.
    pub(super) records: Mutex<BTreeSet<Vec<ItemRecord>>>,
}

impl Task<'_> {
    /// Name of the stage in the pipeline ("calibrate.EW"), for messages only: it is not in the key.
    pub fn name(&self) -> &str {
        self.name
    }

    /// Which instance this is, where the pipeline says `each`.
    pub fn each(&self) -> Option<&str> {
        self.instance
    }

    /// Folder of the one output that plays `role`.
    ///
    /// # Errors
    /// When the pipeline gives the role to none or to several.
    pub fn input(&self, role: &str) -> Result<&Path> {
        match self.played(role)?.as_slice() {
            [(_, path)] => Ok(path),
            several => Err(Error::new(format!("input `{role}` must be one output, got {} instances", several.len()))
                .hint("name one instance in the pipeline: `stage.instance`")),
        }
    }

    /// All outputs that play `role` with the name of their instance; that of a stage without instances is empty.
    ///
    /// # Errors
    /// When the pipeline gives the role to none.
    pub fn inputs(&self, role: &str) -> Result<impl Iterator<Item = (&str, &Path)>> {
        Ok(self.played(role)?.iter().map(|(instance, path)| (instance.as_deref().unwrap_or_default(), path.as_path())))
    }

    /// Whether the pipeline gives `role` to anybody.
    pub fn has_input(&self, role: &str) -> bool {
        self.inputs.contains_key(role)
    }

    fn played(&self, role: &str) -> Result<&Vec<(Option<String>, PathBuf)>> {
        self.inputs.get(role).ok_or_else(|| {
            Error::new(format!("no input plays the role `{role}`"))
                .hint(format!("add `inputs = {{ {role} = \"…\" }}` to the stage in the pipeline file"))
                .usage()
        })
    }

    /// The items of the one output that plays `role`, as the stage that made it left them.
    ///
    /// # Errors
    /// As [`Task::input`], or when the list of items cannot be read.
    pub fn input_items(&self, role: &str) -> Result<Vec<ItemOutcome>> {
        let outputs = Outputs::read(self.input(role)?)?;
        Ok(outputs.items.into_iter().map(|record| outcome(self.store, record)).collect())
    }

    /// An empty folder for the output. It is renamed afterwards: write no absolute path of it anywhere.
    pub fn output_dir(&self) -> &Path {
        &self.output_dir
    }

    /// A folder that survives a kill and is there again when the same work is taken up; removed when the work is done.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn checkpoint_dir(&self) -> Result<&Path> {
        super::files::make_dirs(&self.checkpoint_dir)
            .context(|| format!("cannot make `{}`", self.checkpoint_dir.display()))?;
        Ok(&self.checkpoint_dir)
    }

    /// Folder that relative paths in the parameters start from.
    pub fn manifest_dir(&self) -> &Path {
        self.manifest_dir
    }

    /// The sections the stage reads, nested as in the manifest.
    pub fn parameters(&self) -> &Table {
        &self.parameters
    }

    /// One section (or leaf) as a typed value.
    ///
    /// # Errors
    /// When the stage does not read it, the manifest does not have it, or it is of another type.
    pub fn section<T: DeserializeOwned>(&self, dotted: &str) -> Result<T> {
        let value = lookup(&self.parameters, dotted).ok_or_else(|| {
            Error::new(format!("no parameter `{dotted}`")).hint("it must be in the manifest and read by the stage")
        })?;
        T::deserialize(value.clone()).map_err(|e: toml::de::Error| {
            Error::new(e.message().trim().to_string()).at(format!("parameter `{dotted}`"))
        })
    }

    /// One section (or leaf) as a typed value, if the manifest has it.
    ///
    /// # Errors
    /// When it is of another type.
    pub fn optional<T: DeserializeOwned>(&self, dotted: &str) -> Result<Option<T>> {
        lookup(&self.parameters, dotted).is_some().then(|| self.section(dotted)).transpose()
    }

    /// A seed from the parameter `seed` (0 without one) and the instance: instances differ, everything else leaves it alone.
    pub fn seed(&self) -> u64 {
        let seed = lookup(&self.parameters, "seed").and_then(toml::Value::as_integer).unwrap_or(0);
        let mut hash = blake3::Hasher::new_derive_key("flare-pipe stage seed v1");
        hash.update(&seed.to_le_bytes());
        hash.update(self.instance.unwrap_or_default().as_bytes());
        let mut bytes = [0; 8];
        hash.finalize_xof().fill(&mut bytes);
        u64::from_le_bytes(bytes)
    }

    /// Where to tell of long work.
    pub fn progress(&self) -> &dyn Progress {
        self.progress
    }

    /// Computes an ensemble, several items at a time, each with a cache entry of its own that appears when it is done: a
    /// killed ensemble goes on where it was, and one that grew computes what is new. `compute` gets the index of the item and
    /// an empty folder. An item for which the model has no result ([`Error::of_model`]) is recorded as failed and stops no other.
    /// Outcomes are in the order of `items`.
    ///
    /// # Errors
    /// When the cache cannot be written, or an item ends in another error.
    pub fn items(
        &self,
        kind: &ItemKind,
        items: &[Item],
        compute: impl Fn(usize, &Path) -> Result<()> + Sync,
    ) -> Result<Vec<ItemOutcome>> {
        let ensemble = Ensemble {
            store: self.store,
            permits: self.permits,
            progress: self.progress,
            is_forced: self.is_forced,
            compute: &compute,
            submission: self.slurm.map(|slurm| Submission {
                slurm,
                stage: self.name,
                folder: self.store.shards_dir(self.address),
            }),
            shard: self.shard,
        };
        let records = ensemble.run(kind.name, kind.version, items)?;
        if kind.is_output {
            self.records.lock().unwrap_or_else(PoisonError::into_inner).insert(records.clone());
        }
        Ok(records.into_iter().map(|record| outcome(self.store, record)).collect())
    }
}

fn outcome(store: &Store, record: ItemRecord) -> ItemOutcome {
    let address = Address::parse(&record.entry);
    let seconds = address.as_ref().and_then(|a| store.seconds(a));
    let output = match (record.failure, address) {
        (Some(failure), _) => Err(failure),
        (None, Some(address)) => Ok(store.dir(&address)),
        (None, None) => Err(format!("`{}` is no address of the cache", record.entry)),
    };
    ItemOutcome { id: record.id, output, seconds }
}
