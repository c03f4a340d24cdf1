//! Stage 1: encoder, latent equations and decoder from the dense simulations.

use super::artifact::{read_json, write_json};
use super::{budget, dataset};
use crate::error::Result;
use crate::flare::{Case, Guard, PretrainSettings, SourceModel, pretrain};
use crate::metrics::nrmse_percent;
use crate::pipeline::{Stage, Task};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Trains the source model.
pub struct Pretrain;

/// Errors of the rollout of one validation motion.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct ValidationCase {
    /// Case number as text.
    pub case: String,
    /// NRMSE at each dense channel over the whole motion after the first window, %.
    pub nrmse_percent: Vec<f64>,
    /// The motion twice as strong.
    pub doubled: Guard,
    /// The motion ten times in a row.
    pub tenfold: Guard,
}

impl Stage for Pretrain {
    fn kind(&self) -> &'static str {
        "pretrain"
    }

    fn about(&self) -> &'static str {
        "stage 1: encoder, latent equations and decoder from the simulations"
    }

    fn version(&self) -> u32 {
        4
    }

    fn reads(&self) -> &'static [&'static str] {
        &["pretrain", "motions.seed"]
    }

    fn unkeyed(&self) -> &'static [&'static str] {
        budget::UNKEYED
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let settings: PretrainSettings = task.section("pretrain")?;
        let folder = task.input("dataset")?;
        let card = dataset::card(folder)?;
        let training = budget::training(task)?;
        let train = dataset::cases(folder, &card.train, &training.spill)?;
        let validation = dataset::cases(folder, &card.validation, &training.spill)?;
        let seed: u64 = task.section("motions.seed")?;
        let (mut model, history) = pretrain(&train, &validation, &settings, seed, &training)?;
        model.limit_softly(&train, settings.limit_factor);
        model.save(task.output_dir(), &card.source_normalisation())?;
        history.save(&task.output_dir().join("history.csv"))?;
        let errors: Vec<ValidationCase> =
            validation.par_iter().map(|case| validate(&model, case)).collect::<Result<_>>()?;
        write_json(&task.output_dir().join("validation.json"), &errors)
    }
}

fn validate(model: &SourceModel, case: &Case) -> Result<ValidationCase> {
    let n = model.shape.channels;
    let predicted = model.roll_out(case)?;
    let target = &case.dense[(model.shape.window - 1) * n..];
    // The first sample is what the encoder saw: the rollout is judged from the next one on.
    let column =
        |field: &[f32], j: usize| field.iter().skip(n + j).step_by(n).map(|v| f64::from(*v)).collect::<Vec<_>>();
    let nrmse = (0..n).map(|j| nrmse_percent(&column(&predicted, j), &column(target, j))).collect();
    Ok(ValidationCase {
        case: case.id.clone(),
        nrmse_percent: nrmse,
        doubled: model.guard_doubled(case),
        tenfold: model.guard_tenfold(case),
    })
}

/// The validation errors that stage left in `folder`.
///
/// # Errors
/// When they are not there.
pub fn validation(folder: &Path) -> Result<Vec<ValidationCase>> {
    read_json(&folder.join("validation.json"))
}
