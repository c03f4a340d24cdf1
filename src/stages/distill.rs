//! Stage 2: the sparse-sensor encoder.

use super::artifact::{read_json, write_json};
use super::{budget, dataset};
use crate::error::Result;
use crate::flare::{Case, DistillSettings, Observation, SourceModel, SparseEncoder, distill, reconstruct};
use crate::metrics::nrmse_percent;
use crate::pipeline::{Stage, Task};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Trains the sparse encoder.
pub struct Distill;

/// Reconstruction of one validation motion from its sensors.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Reconstruction {
    /// Case number as text.
    pub case: String,
    /// NRMSE at each sensor, %.
    pub nrmse_percent: Vec<f64>,
}

impl Stage for Distill {
    fn kind(&self) -> &'static str {
        "distill"
    }

    fn about(&self) -> &'static str {
        "stage 2: an encoder for the sensors of the site, by latent matching"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        &["distill", "motions.seed"]
    }

    fn unkeyed(&self) -> &'static [&'static str] {
        budget::UNKEYED
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let settings: DistillSettings = task.section("distill")?;
        let folder = task.input("dataset")?;
        let card = dataset::card(folder)?;
        let (model, _) = SourceModel::load(task.input("pretrain")?)?;
        let training = budget::training(task)?;
        let train = dataset::cases(folder, &card.train, &training.spill)?;
        let validation = dataset::cases(folder, &card.validation, &training.spill)?;
        let seed: u64 = task.section("motions.seed")?;
        let (encoder, history) = distill(&model, &train, &validation, &settings, seed, &training)?;
        let observation = card.observation();
        encoder.save(task.output_dir(), &observation)?;
        history.save(&task.output_dir().join("history.csv"))?;
        let errors: Vec<Reconstruction> =
            validation.par_iter().map(|case| judge(&model, &encoder, &observation, case)).collect();
        write_json(&task.output_dir().join("validation.json"), &errors)
    }
}

fn judge(model: &SourceModel, encoder: &SparseEncoder, observation: &Observation, case: &Case) -> Reconstruction {
    let n = encoder.n_sensor;
    let seen = reconstruct(model, encoder, observation, &case.sparse);
    let target = &case.sparse[(encoder.window - 1) * n..];
    let column = |field: &[f32], j: usize| field.iter().skip(j).step_by(n).map(|v| f64::from(*v)).collect::<Vec<_>>();
    let nrmse = (0..n).map(|j| nrmse_percent(&column(&seen, j), &column(target, j))).collect();
    Reconstruction { case: case.id.clone(), nrmse_percent: nrmse }
}

/// The validation errors that stage left in `folder`.
///
/// # Errors
/// When they are not there.
pub fn validation(folder: &Path) -> Result<Vec<Reconstruction>> {
    read_json(&folder.join("validation.json"))
}
