//! Stages: glue only. Each reads its inputs, calls the domain, and writes its outputs; the mathematics lives elsewhere.

mod artifact;
mod calibrate;
mod dataset;
mod distill;
mod evaluate;
mod instrument;
mod motions;
pub mod predict;
mod pretrain;
mod records;
mod replay;
mod report;
mod shake;
mod simulate;

pub use evaluate::Evaluation;

use crate::pipeline::Stage;

/// All stages, by the `kind` a pipeline file names.
pub const STAGES: &[&dyn Stage] = &[
    &motions::Motions,
    &simulate::Simulate,
    &dataset::Dataset,
    &records::Records,
    &replay::Replay,
    &pretrain::Pretrain,
    &distill::Distill,
    &calibrate::Calibrate,
    &evaluate::Evaluate,
    &report::Report,
];
