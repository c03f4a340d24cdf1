//! What the section "Closing the loop" shows, as plain data.

use crate::diagnosis::Hidden;
use crate::metrics::Claimed;
use serde::{Deserialize, Serialize};

/// The diagnosis, the correction and what they were worth.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Closing {
    /// `none`, `known`, `ambiguous` or `unknown`.
    pub verdict: String,
    /// Effects that were named, in the order they were found.
    pub effects: Vec<NamedEffect>,
    /// Kinds that explain the records about as well, each with what would tell it from the others.
    pub ambiguity: Vec<(String, String)>,
    /// Models that were fitted, most probable first.
    pub candidates: Vec<Candidate>,
    /// Share of the power of the recalibrated model's residual that the named effects explain.
    pub explained_share: Option<f64>,
    /// Names of the six predictions and of the ceiling, their medians and means over held-out events, in order.
    pub models: Vec<Model>,
    /// Errors of the six predictions at each sensor, held-out events first as given.
    pub errors: Vec<ErrorRow>,
    /// Median with the simulations as declared and the calibration alone on the corrected site, %.
    pub ablation_percent: Option<f64>,
    /// Paired differences over held-out events.
    pub changes: Vec<Change>,
    /// The field's measures over held-out events.
    pub field: Option<Field>,
    /// Transfer functions of weak events, one row a component, sensor and model.
    pub transfer: Vec<TransferRow>,
    /// What the records say of what is declared.
    pub declared: Vec<DeclaredRow>,
    /// What could be there unnoticed, the best hidden first.
    pub hidden: Vec<Hidden>,
    /// What remains beside the answer.
    pub rest: Option<Rest>,
    /// Corrections without physical meaning, where nothing named explains the records.
    pub generic: Option<Generic>,
    /// Remarks.
    pub notes: Vec<String>,
}

/// A number with its 95 % interval.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Interval {
    /// Value.
    pub value: f64,
    /// Unit; empty where there is none.
    pub unit: String,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// The value were every prior half and twice as wide.
    pub by_prior: Option<[f64; 2]>,
}

/// A declared value that may be off.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DeclaredRow {
    /// What it is.
    pub kind: String,
    /// Where it sits; empty for the whole column.
    pub target: String,
    /// Parameter of the effect that moves it.
    pub parameter: String,
    /// Whether it is at the end of its tolerance.
    pub is_at_end: bool,
    /// By the records and its tolerance.
    pub estimate: Interval,
    /// By the records without its tolerance, where they tell it.
    pub by_records: Option<Interval>,
}

/// An effect that was named.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NamedEffect {
    /// Name of the effect.
    pub kind: String,
    /// What it is, in a line.
    pub about: String,
    /// What is said of it, one for each of its forms; see `Entry::phrases` of the effects.
    pub phrases: Vec<String>,
    /// Where it sits; empty for the whole column.
    pub target: String,
    /// `soil`, `boundary` or `sensor`.
    pub class: String,
    /// Its parameters.
    pub parameters: Vec<(String, Interval)>,
    /// Probability that chance brings as much.
    pub p_value: Option<f64>,
}

/// A model that was fitted.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Candidate {
    /// Name of the effect.
    pub kind: String,
    /// Where it would sit.
    pub target: String,
    /// `soil`, `boundary` or `sensor`.
    pub class: String,
    /// Number of effects of the model.
    pub round: usize,
    /// ln of the odds against what is declared.
    pub gain: f64,
    /// Fall of the cost on validation events alone.
    pub validation_gain: f64,
    /// Share of the residual power that it explains.
    pub explained_share: f64,
}

/// One of the six predictions, or the ceiling.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Model {
    /// For people: `FE declared`.
    pub name: String,
    /// Median NRMSE over held-out events, %.
    pub median_percent: Option<f64>,
    /// Mean over these events, %.
    pub mean_percent: Option<f64>,
    /// 95 % interval of the mean after Student.
    pub ci95_percent: Option<[f64; 2]>,
}

/// Errors at one sensor of one event and component, in the order of the models.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ErrorRow {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// Sensor.
    pub sensor: String,
    /// Whether nothing was chosen by this event.
    pub is_held_out: bool,
    /// NRMSE, %.
    pub nrmse_percent: Vec<Option<f64>>,
}

/// A paired difference of two predictions.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Change {
    /// What is compared.
    pub measure: Claimed,
    /// The prediction compared with.
    pub from: String,
    /// The prediction that should be better.
    pub to: String,
    /// Mean difference over events in the unit of the measure; negative is better.
    pub mean: f64,
    /// Its 95 % interval after Student; `None` for one event.
    pub ci95: Option<[f64; 2]>,
    /// Two-sided p of the sign test.
    pub sign_test_p: f64,
    /// Whether the interval lies below zero, with events enough behind it.
    pub is_improved: bool,
    /// Events behind it.
    pub n_event: usize,
}

/// The field's measures, one row a model.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Field {
    /// Edges of the bands of the Fourier amplitude, Hz.
    pub fourier_bands_hz: Vec<[f64; 2]>,
    /// Edges of the bands of the response spectrum, s.
    pub psa_bands_s: Vec<[f64; 2]>,
    /// One a model.
    pub rows: Vec<FieldRow>,
}

/// One model; pairs are bias and scatter of ln ratios of prediction over record.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FieldRow {
    /// For people: `FE declared`.
    pub model: String,
    /// Root mean square of the bias of the ln Fourier amplitude in ten bands.
    pub fourier_rms: Option<f64>,
    /// Root mean square of the ln ratio of response spectra.
    pub psa_rms: Option<f64>,
    /// Peak acceleration, peak velocity, Arias intensity, time from 5 to 75 % and to 95 % of it.
    pub ratios: Vec<Option<[f64; 2]>>,
    /// Median of Anderson's score, 0 … 10.
    pub anderson: Option<f64>,
    /// Fourier amplitude by band.
    pub fourier: Vec<Option<[f64; 2]>>,
    /// Response spectrum by band.
    pub psa: Vec<Option<[f64; 2]>>,
}

/// How well a model's transfer function fits, and how much the recorded one varies.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TransferRow {
    /// Component.
    pub component: String,
    /// Sensor.
    pub sensor: String,
    /// For people: `FE declared`.
    pub model: String,
    /// `LG`, `LP`, `HG` or `HP`.
    pub letters: String,
    /// Pearson's r of ln amplitudes.
    pub r: f64,
    /// Scatter of the recorded ln amplitude between events.
    pub sigma: f64,
    /// Events behind it.
    pub n_event: usize,
}

/// What remains beside the answer.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Rest {
    /// In a sentence.
    pub sentence: String,
    /// Its power over that of the records, noise of sensors taken off.
    pub share: f64,
    /// The part of it that is the same in all events.
    pub repeatable_share: f64,
    /// Coherence of each output sensor with the prediction: frequency (Hz) and c.
    pub coherence: Vec<(String, Vec<[f64; 2]>)>,
}

/// Corrections without physical meaning.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Generic {
    /// Names of the models with their medians over held-out events without and with the correction, %.
    pub models: Vec<(String, [Option<f64>; 2])>,
    /// Paired differences over held-out events.
    pub changes: Vec<Change>,
    /// What was and was not found.
    pub notes: Vec<String>,
}
