//! What the declared model lacks, by the records of training and validation events.

use super::artifact::{read_toml, write_json, write_toml};
use super::null_twins;
use super::problem::{Bench, READS};
use crate::diagnosis::{self, DiagnoseSettings, Diagnosis, Method, Problem, Replay, Thresholds};
use crate::error::Result;
use crate::inference;
use crate::pipeline::{Stage, Task};
use crate::progress::Progress;
use std::path::Path;

/// Diagnoses the declared model.
pub struct Diagnose;

/// For stages; the same is beside it as JSON, where what is open upwards is `null`.
const FILE: &str = "diagnosis.toml";

impl Stage for Diagnose {
    fn kind(&self) -> &'static str {
        "diagnose"
    }

    fn about(&self) -> &'static str {
        "the effect that the declared model lacks, if any; held-out events stay closed"
    }

    fn version(&self) -> u32 {
        40
    }

    fn reads(&self) -> &'static [&'static str] {
        READS
    }

    fn publishes(&self) -> &'static [&'static str] {
        &["diagnosis.json"]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let bench = Bench::of(task)?;
        let settings: DiagnoseSettings = task.section("diagnose")?;
        let thresholds = null_twins::read(task.input("thresholds")?)?;
        let found = diagnosed(&bench.problem, &bench, &settings, &thresholds, task.progress())?;
        write_json(&task.output_dir().join("diagnosis.json"), &found)?;
        write_toml(&task.output_dir().join(FILE), &found)
    }
}

/// The diagnosis of `problem` by the method of `settings`.
///
/// # Errors
/// When an event is unusable, the column cannot be built or replayed.
pub fn diagnosed(
    problem: &Problem,
    replay: &dyn Replay,
    settings: &DiagnoseSettings,
    thresholds: &Thresholds,
    progress: &dyn Progress,
) -> Result<Diagnosis> {
    match settings.method {
        Method::Search => diagnosis::diagnose(problem, replay, settings, thresholds, progress),
        Method::Competition => inference::diagnose(problem, replay, settings, progress),
    }
}

/// The diagnosis that stage left in `folder`.
///
/// # Errors
/// When it is not there.
pub fn read(folder: &Path) -> Result<Diagnosis> {
    read_toml(&folder.join(FILE))
}
