//! From a diagnosis to manifests: the declared one with its values recalibrated, and the corrected one.
//!
//! Both are the declared manifest with more `[[effects]]` behind its own, which is all that is written. Without a named
//! effect the corrected manifest is the declared one: a second pass on it then finds everything in the cache.

use super::diagnose;
use crate::diagnosis::{Diagnosis, Found, Verdict};
use crate::error::{Context, Result};
use crate::pipeline::{Stage, Task};
use std::fs;
use toml::{Table, Value};

/// Writes the manifest with declared values recalibrated within their tolerances.
pub struct Recalibrate;

/// Writes the manifest with the named effects and the values recalibrated beside them.
pub struct Correct;

/// Name of the manifest in the output, where the pipeline looks for it.
pub const FILE: &str = "manifest.toml";

impl Stage for Recalibrate {
    fn kind(&self) -> &'static str {
        "recalibrate"
    }

    fn about(&self) -> &'static str {
        "the manifest with its declared values recalibrated and no effect added"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        &["effects"]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let diagnosis = diagnose::read(task.input("diagnose")?)?;
        write(task, &diagnosis.nuisances)
    }
}

impl Stage for Correct {
    fn kind(&self) -> &'static str {
        "correct"
    }

    fn about(&self) -> &'static str {
        "the manifest with the effects that were named; the declared one if there are none"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        &["effects"]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let diagnosis = diagnose::read(task.input("diagnose")?)?;
        write(task, &correction(&diagnosis))
    }
}

/// The `[[effects]]` that a diagnosis adds. Where structure remains that has no name, only those effects are trusted that
/// hold whatever the profile; without any there is nothing to correct. Values are
/// recalibrated before effects are added, as they were when they were fitted: a damping multiplier scales what is declared.
pub fn correction(diagnosis: &Diagnosis) -> Vec<Table> {
    let (named, nuisances) = match diagnosis.verdict {
        Verdict::Known | Verdict::Ambiguous => (diagnosis.effects.iter().collect(), &diagnosis.corrected_nuisances),
        Verdict::None | Verdict::Unknown => {
            let standing: Vec<&Found> = diagnosis.effects.iter().filter(|e| e.is_standing).collect();
            (standing, &diagnosis.nuisances)
        }
    };
    if named.is_empty() {
        return Vec::new();
    }
    nuisances.iter().chain(named.into_iter().map(|e| &e.table)).cloned().collect()
}

/// Writes the section `effects`: those of the manifest, then those `added`.
fn write(task: &Task<'_>, added: &[Table]) -> Result<()> {
    let mut effects: Vec<Table> = task.optional("effects")?.unwrap_or_default();
    effects.extend(added.iter().cloned());
    let mut manifest = Table::new();
    if !effects.is_empty() {
        manifest.insert("effects".into(), Value::Array(effects.into_iter().map(Value::Table).collect()));
    }
    let path = task.output_dir().join(FILE);
    fs::write(&path, manifest.to_string()).context(|| format!("cannot write `{}`", path.display()))
}
