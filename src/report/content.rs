//! What the report shows, as plain data: a stage fills [`Content`] from files and [`crate::report::render`] turns it into HTML.
//!
//! Everything but the site name is optional; an absent part disappears together with its entry in the table of contents.
//! Arrays are whole: the report thins them itself. Non-finite samples are allowed where a model may have diverged; they
//! leave gaps in lines and dashes in tables, and the reader is told.

use serde::{Deserialize, Serialize};

pub use super::closing_content::{
    Candidate, Change, Closing, DeclaredRow, ErrorRow, Field, FieldRow, Generic, Interval, Model, NamedEffect, Rest,
    TransferRow,
};

pub use super::site_content::{
    DepthModel, DepthView, EventRow, EventView, LayerView, ModelView, ProfileView, ResidualView, SensorPlace,
    SensorView, SiteView, SoilCurve, TransferView, VelocityBand,
};

/// The whole report of one site.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Content {
    /// Name of the site, as in the manifest.
    pub site: String,
    /// What was modelled, in paragraphs for people.
    pub description: Vec<String>,
    /// What a reader must know before trusting a number ("the records are synthetic twins"); shown first, framed.
    pub notices: Vec<String>,
    /// The ensemble of base motions.
    pub motions: Option<Motions>,
    /// Stage 1, simulation pretraining.
    pub pretrain: Option<Pretrain>,
    /// Stage 2, sparse distillation.
    pub distill: Option<Distill>,
    /// Stage 3, calibration on records, one per component.
    pub calibrate: Vec<Calibration>,
    /// What the model lacked and what correcting it was worth.
    pub closing: Option<Closing>,
    /// The column and its array.
    pub site_view: Option<SiteView>,
    /// Held-out events with all models of a closed loop, one per event and component; they stand in for `held_out`.
    pub events: Vec<EventView>,
    /// Transfer functions, one per component and sensor.
    pub transfers: Vec<TransferView>,
    /// Modulus reduction and damping of the soil.
    pub soil_curves: Vec<SoilCurve>,
    /// What the strongest held-out motion does over depth.
    pub depth: Option<DepthView>,
    /// What remains of response spectra, one per sensor.
    pub residuals: Vec<ResidualView>,
    /// Predictions of the held-out events, one per event and component, in the order shown.
    pub held_out: Vec<Prediction>,
    /// Errors on the held-out events, one per event, component and sensor, in the order shown.
    pub scores: Vec<Score>,
    /// Two source models side by side.
    pub study: Option<Study>,
    /// Where all of this comes from.
    pub provenance: Provenance,
}

/// Held-out accuracy with two source models.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Study {
    /// Names of the source models; the pairs below are in their order.
    pub sources: [String; 2],
    /// One for each held-out event and component.
    pub rows: Vec<StudyRow>,
    /// Median R² over the rows.
    pub median_r2: [Pair; 2],
    /// Median NRMSE over held-out events, components and sensors, %.
    pub median_nrmse_percent: [Pair; 2],
}

/// One held-out event and component with two source models.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StudyRow {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// R² over all sensors.
    pub r2: [Pair; 2],
}

/// A uniformly sampled series.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Series {
    /// Time of the first sample, s.
    #[serde(default)]
    pub start_s: f64,
    /// Time step, s.
    pub step_s: f64,
    /// Values; for accelerations m/s².
    pub values: Vec<f64>,
}

/// Numbers of which the report draws a box (median, quartiles, whiskers).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sample {
    /// Case, sensor or group.
    pub label: String,
    /// Values, in the unit of the figure.
    pub values: Vec<f64>,
}

/// The ensemble of base motions.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Motions {
    /// Duration of each motion, s.
    pub duration_s: f64,
    /// Time step, s.
    pub step_s: f64,
    /// Every motion in order of its case number.
    pub cases: Vec<MotionCase>,
    /// A few motions to look at (acceleration, m/s²), each with its label.
    pub examples: Vec<(String, Series)>,
}

/// One base motion of the ensemble.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionCase {
    /// Case name, `"081"`.
    pub case: String,
    /// Peak ground acceleration, g.
    pub pga_g: f64,
    /// Whether the case belongs to the validation set.
    pub validation: bool,
}

/// Stage 1: the rollout of the latent model against the finite-element field.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pretrain {
    /// One validation case over depth and time.
    pub field: Option<FieldPair>,
    /// Depthwise NRMSE of each validation case, %.
    pub cases: Vec<Sample>,
    /// Rollouts beyond the training.
    pub guards: Vec<Guard>,
    /// Range of case medians in the published application, %, drawn as a band.
    pub published_range_percent: Option<(f64, f64)>,
    /// Loss terms over training.
    pub losses: Option<Losses>,
}

/// Rollouts of the validation cases beyond the training, of one kind.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Guard {
    /// `"doubled"` (motion twice as strong) or `"tenfold"` (motion ten times in a row).
    pub what: String,
    /// Cases that stay finite.
    pub finite: usize,
    /// All cases.
    pub of: usize,
    /// Size of the response against the plain rollout, increasing: peaks (doubled), last repetition to first (tenfold).
    pub ratios: Vec<f64>,
    /// Largest share of the samples at which a state is limited.
    pub limited_share: f64,
}

/// An acceleration field of the finite-element model and its prediction, on one grid.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FieldPair {
    /// Case shown.
    pub case: String,
    /// Time step, s.
    pub step_s: f64,
    /// Depth of each channel, m, surface down.
    pub depth_m: Vec<f64>,
    /// Finite-element acceleration, m/s², row-major `[n_step][n_depth]`.
    pub fe_m_s2: Vec<f32>,
    /// Predicted acceleration, m/s², same shape.
    pub model_m_s2: Vec<f32>,
}

/// Stage 2: reconstruction of the sensors from the sparse encoder.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Distill {
    /// NRMSE over the validation cases at each sensor, %.
    pub sensors: Vec<Sample>,
    /// Range of the published medians, %, drawn as a band.
    pub published_range_percent: Option<(f64, f64)>,
    /// Validation case of `traces`.
    pub case: String,
    /// Histories and spectra of that case, one per sensor.
    pub traces: Vec<Trace>,
    /// Loss terms over training.
    pub losses: Option<Losses>,
}

/// Stage 3 for one horizontal component: what the records changed in the latent dynamics.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Calibration {
    /// Component, `"EW"`.
    pub component: String,
    /// Names of the library terms (columns of the matrices).
    pub terms: Vec<String>,
    /// Coefficients before calibration, row-major `[n_equation][n_term]`.
    pub before: Vec<Vec<f64>>,
    /// Coefficients after calibration, same shape.
    pub after: Vec<Vec<f64>>,
    /// Cosine similarity between the two.
    pub cosine_similarity: Option<f64>,
    /// Loss terms over training.
    pub losses: Option<Losses>,
}

/// The curves of one training run, drawn on a logarithmic axis.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Losses {
    /// What the horizontal axis counts, `"epoch"`.
    pub counter: String,
    /// Loss terms and selection measures.
    pub terms: Vec<LossTerm>,
    /// Counter value of the state that was kept.
    pub selected_at: Option<f64>,
}

/// One loss term over training.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LossTerm {
    /// Name, `"reconstruction"`.
    pub name: String,
    /// `(counter, value)`; values that are not positive are left out of the figure.
    pub points: Vec<(f64, f64)>,
}

/// One held-out event and component.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Prediction {
    /// Event name.
    pub event: String,
    /// Component, `"EW"`.
    pub component: String,
    /// Histories and spectra, one per sensor.
    pub traces: Vec<Trace>,
    /// Timewise error of both models at each sensor, %.
    pub timewise_percent: Vec<TimewiseError>,
}

/// Record, finite elements and FLARE-T at one sensor. In stage 2 there is no record: the finite-element response is the target.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Trace {
    /// Sensor name.
    pub sensor: String,
    /// Depth of the sensor, m.
    pub depth_m: Option<f64>,
    /// Measured acceleration.
    pub record: Option<Series>,
    /// Finite-element acceleration.
    pub fe: Option<Series>,
    /// Acceleration predicted by FLARE-T.
    pub flare_t: Option<Series>,
    /// 5 % damped pseudo-acceleration spectra on one list of periods.
    pub spectrum: Option<Spectrum>,
}

/// Pseudo-acceleration spectra, m/s², on a common list of periods.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Spectrum {
    /// Periods, s, increasing.
    pub period_s: Vec<f64>,
    /// Of the record; empty if there is none.
    pub record_m_s2: Vec<f64>,
    /// Of the finite-element response; empty if there is none.
    pub fe_m_s2: Vec<f64>,
    /// Of the FLARE-T prediction; empty if there is none.
    pub flare_t_m_s2: Vec<f64>,
}

/// Distribution over time of the error of both models at one sensor.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TimewiseError {
    /// Sensor name.
    pub sensor: String,
    /// Finite elements, % per time sample.
    pub fe: Vec<f64>,
    /// FLARE-T, % per time sample.
    pub flare_t: Vec<f64>,
}

/// Errors of both models at one sensor of one event and component.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Score {
    /// Event name.
    pub event: String,
    /// Component.
    pub component: String,
    /// Sensor name.
    pub sensor: String,
    /// NRMSE, %; lower is better.
    pub nrmse_percent: Pair,
    /// That of a filter fitted to training events, or of nothing, %: no model that is the same in all events is expected below it.
    #[serde(default)]
    pub ceiling_nrmse_percent: Option<f64>,
    /// Coefficient of determination; higher is better.
    pub r2: Pair,
    /// Root-mean-square difference of the natural logarithms of the 5 % spectra; lower is better.
    pub psa_ln_rmse: Pair,
}

/// A measure of both models; `None` where a model gave no finite answer.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pair {
    /// Finite elements.
    pub fe: Option<f64>,
    /// FLARE-T.
    pub flare_t: Option<f64>,
}

/// Where the numbers come from.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Provenance {
    /// Program and version, `"flare-pipe 0.1.0"`.
    pub program: String,
    /// Manifest as it was run, TOML.
    pub manifest: String,
    /// Cached outputs used, in the order of the pipeline.
    pub stages: Vec<StageOrigin>,
    /// Random seeds by purpose.
    pub seeds: Vec<(String, u64)>,
    /// Further facts by name (record files and their hashes, crate versions).
    pub facts: Vec<(String, String)>,
}

/// The cached output of one stage.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageOrigin {
    /// Stage name.
    pub stage: String,
    /// Stage version.
    pub version: u32,
    /// Content key.
    pub key: String,
}
