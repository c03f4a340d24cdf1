//! What the declared model lacks by the competition of all models on one likelihood, by the records of training and validation events.

use super::artifact::write_json;
use super::problem::{Bench, READS};
use crate::diagnosis::DiagnoseSettings;
use crate::error::Result;
use crate::inference::compete;
use crate::pipeline::{Stage, Task};

/// Lets models compete.
pub struct Compete;

const FILE: &str = "competition.json";

impl Stage for Compete {
    fn kind(&self) -> &'static str {
        "compete"
    }

    fn about(&self) -> &'static str {
        "effects by the evidence of models on a likelihood that knows incoherence and errors of the column: competition.json"
    }

    fn version(&self) -> u32 {
        2
    }

    fn reads(&self) -> &'static [&'static str] {
        READS
    }

    fn publishes(&self) -> &'static [&'static str] {
        &[FILE]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let bench = Bench::of(task)?;
        let settings: DiagnoseSettings = task.section("diagnose")?;
        write_json(&task.output_dir().join(FILE), &compete(&bench.problem, &bench, &settings, task.progress())?)
    }
}
