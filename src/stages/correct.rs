//! From a diagnosis to manifests: the declared one with its values recalibrated, and the corrected one.
//!
//! Both are the declared manifest with more `[[effects]]` behind its own, which is all that is written. Without a named
//! effect the corrected manifest is the declared one: a second pass on it then finds everything in the cache.

use super::diagnose;
use crate::diagnosis::{Diagnosis, Verdict};
use crate::effects;
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
        2
    }

    fn reads(&self) -> &'static [&'static str] {
        &["site", "law", "effects", "sensors", "analysis"]
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
        3
    }

    fn reads(&self) -> &'static [&'static str] {
        &["site", "law", "effects", "sensors", "analysis"]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let diagnosis = diagnose::read(task.input("diagnose")?)?;
        write(task, &correction(&diagnosis))
    }
}

/// The `[[effects]]` that a diagnosis adds: the named ones, whatever remains beside them; without any there is nothing to correct.
///
/// Recalibrated values come first, as they were fitted: a damping multiplier scales what is declared, and a turn before a reflection is
/// not the same turn after it.
pub fn correction(diagnosis: &Diagnosis) -> Vec<Table> {
    if diagnosis.effects.is_empty() || matches!(diagnosis.verdict, Verdict::None | Verdict::Unknown) {
        return Vec::new();
    }
    let found = diagnosis.effects.iter().map(|e| &e.table);
    diagnosis.corrected_nuisances.iter().chain(found).cloned().collect()
}

/// Writes the section `effects`: those of the manifest, then those `added` that have something to act on.
fn write(task: &Task<'_>, added: &[Table]) -> Result<()> {
    let mut effects: Vec<Table> = task.optional("effects")?.unwrap_or_default();
    effects.extend(effects::acting(added, &super::records::column(task)?.declared_profile()?)?);
    let mut manifest = Table::new();
    if !effects.is_empty() {
        manifest.insert("effects".into(), Value::Array(effects.into_iter().map(Value::Table).collect()));
    }
    let path = task.output_dir().join(FILE);
    fs::write(&path, manifest.to_string()).context(|| format!("cannot write `{}`", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_correction_comes_in_the_order_in_which_it_was_fitted() {
        let kinds = |verdict: &str, effects: &[&str]| -> Vec<String> {
            let found = |kind: &&str| {
                json!({ "kind": kind, "target": "", "class": "sensor", "table": { "kind": kind }, "parameters": {},
                    "gain": 1.0, "validation_gain": 1.0 })
            };
            let tables = correction(&Diagnosis::made_up(json!({
                "verdict": verdict, "effects": effects.iter().map(found).collect::<Vec<_>>(),
                "nuisances": [{ "kind": "alone" }], "corrected_nuisances": [{ "kind": "beside" }],
            })));
            tables.iter().filter_map(|t| Some(t.get("kind")?.as_str()?.to_string())).collect()
        };
        assert_eq!(kinds("known", &["one", "other"]), ["beside", "one", "other"]);
        assert_eq!(kinds("ambiguous", &["one"]), ["beside", "one"]);
        assert!(kinds("unknown", &[]).is_empty() && kinds("none", &[]).is_empty());
    }
}
