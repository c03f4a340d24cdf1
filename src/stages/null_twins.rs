//! How much an array without any missing effect seems to lack: the alarm thresholds of its diagnosis.

use super::artifact::{read_json, write_json};
use super::problem::{Bench, READS};
use crate::diagnosis::{DiagnoseSettings, Method, Thresholds, thresholds};
use crate::error::Result;
use crate::pipeline::{Stage, Task};
use std::path::Path;

/// Takes alarm thresholds from null twins.
pub struct NullTwins;

const FILE: &str = "thresholds.json";

impl Stage for NullTwins {
    fn kind(&self) -> &'static str {
        "null-twins"
    }

    fn about(&self) -> &'static str {
        "alarm thresholds of the diagnosis, from twins of this array that lack nothing"
    }

    fn version(&self) -> u32 {
        18
    }

    fn reads(&self) -> &'static [&'static str] {
        READS
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let settings: DiagnoseSettings = task.section("diagnose")?;
        // Evidence has its own charge for what is tried.
        if settings.method == Method::Competition {
            return write(task.output_dir(), &Thresholds::default());
        }
        let bench = Bench::of(task)?;
        write(task.output_dir(), &thresholds(&bench.problem, Some(&bench), &settings, task.progress())?)
    }
}

/// Writes thresholds as that stage does.
///
/// # Errors
/// When the file cannot be written.
pub fn write(folder: &Path, thresholds: &Thresholds) -> Result<()> {
    write_json(&folder.join(FILE), thresholds)
}

/// The thresholds that stage left in `folder`.
///
/// # Errors
/// When they are not there.
pub fn read(folder: &Path) -> Result<Thresholds> {
    read_json(&folder.join(FILE))
}
