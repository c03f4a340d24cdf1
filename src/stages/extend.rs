//! Where no named effect explains the records: more terms in the calibrated latent equations of one component, without a name.

use super::artifact::{read_json, write_json};
use super::calibrate::Bench;
use super::diagnose;
use super::instrument::{Concern, narrow};
use crate::diagnosis::Verdict;
use crate::error::{Context, Result};
use crate::flare::{Calibration, Extension, Tried, extend};
use crate::pipeline::{Stage, Task};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;

/// Extends one component.
pub struct Extend;

/// Folder of the source model that has room for the terms.
pub const SOURCE: &str = "source";
const FILE: &str = "extension.json";

/// `extension.json`: terms of the latent equations that are no physics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Whether the verdict asked for it.
    pub is_asked: bool,
    /// The terms that were taken; none where none held up.
    pub taken: Option<String>,
    /// Error of the validation events without and with them (mean squared, sensors in units of σ_s).
    pub validation: [f64; 2],
    /// All that was tried.
    pub tried: Vec<Tried>,
}

impl Stage for Extend {
    fn kind(&self) -> &'static str {
        "extend"
    }

    fn about(&self) -> &'static str {
        "where the verdict is unknown: more terms in the latent equations, without a name"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        // As the calibration: what is held out is not even opened here.
        super::calibrate::READS
    }

    fn unkeyed(&self) -> &'static [&'static str] {
        super::budget::UNKEYED
    }

    fn narrow(&self, parameters: &mut toml::Table) {
        narrow(parameters, Concern::Sensors);
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let verdict = diagnose::read(task.input("diagnose")?)?.verdict;
        let bench = Bench::of(task)?;
        let calibration = Calibration::load(task.input("calibrate")?, &bench.model.shape)?;
        let before = calibration.validation_error;
        let is_asked = verdict == Verdict::Unknown;
        let found = if is_asked {
            let sight = (&bench.encoder, &bench.observation);
            extend(&bench.model, &calibration, sight, &bench.data(), &bench.settings, task.progress())
        } else {
            Extension::none(&bench.model, &calibration, Vec::new())
        };
        let source = task.output_dir().join(SOURCE);
        fs::create_dir_all(&source).context(|| format!("cannot make `{}`", source.display()))?;
        found.source.save(&source, &bench.normalisation)?;
        found.calibration.save(task.output_dir(), &found.source.shape)?;
        let validation = [before, found.calibration.validation_error];
        let outcome = Outcome { is_asked, taken: found.taken, validation, tried: found.tried };
        write_json(&task.output_dir().join(FILE), &outcome)
    }
}

/// What that stage left in `folder`.
///
/// # Errors
/// When it is not there.
pub fn read(folder: &Path) -> Result<Outcome> {
    read_json(&folder.join(FILE))
}
