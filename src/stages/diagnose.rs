//! What the declared model lacks, by the records of training and validation events.

use super::artifact::{read_toml, write_json, write_toml};
use super::problem::{Bench, READS};
use crate::diagnosis::{DiagnoseSettings, Diagnosis};
use crate::error::Result;
use crate::inference;
use crate::pipeline::{Stage, Task};
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
        90
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
        let found = inference::diagnose(&bench.problem, &bench, &settings, task.progress())?;
        write_json(&task.output_dir().join("diagnosis.json"), &found)?;
        write_toml(&task.output_dir().join(FILE), &found)
    }
}

/// The diagnosis that stage left in `folder`.
///
/// # Errors
/// When it is not there.
pub fn read(folder: &Path) -> Result<Diagnosis> {
    read_toml(&folder.join(FILE))
}
