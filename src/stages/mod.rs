//! Stages: glue only. Each reads its inputs, calls the domain, and writes its outputs; the mathematics lives elsewhere.

mod artifact;
mod budget;
mod calibrate;
mod ceiling;
mod closed;
mod compare;
pub mod correct;
pub mod cost;
mod dataset;
mod diagnose;
mod distill;
mod evaluate;
mod export;
mod extend;
mod generic;
mod histories;
mod instrument;
mod motions;
mod other_source;
mod pipelines;
pub mod predict;
mod pretrain;
mod problem;
mod records;
mod replay;
mod report;
mod report_closing;
mod report_events;
mod shake;
mod side_by_side;
mod simulate;
mod source_study;
pub mod twins;

pub use closed::Closed;
pub use evaluate::Evaluation;
pub use export::export;
pub use pipelines::PIPELINES;
pub use problem::Bench;
pub use records::measured;

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
    &diagnose::Diagnose,
    &correct::Recalibrate,
    &correct::Correct,
    &extend::Extend,
    &compare::Compare,
    &twins::Twins,
    &other_source::OtherSource,
    &source_study::SourceStudy,
    &report::Report,
];
