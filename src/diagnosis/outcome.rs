//! What a diagnosis says: verdict, named effects, what else was considered, and what could still hide.

use super::evidence::Evidence;
use crate::effects::Class;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The answer in a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Nothing beyond the declared tolerances.
    None,
    /// Named effects explain what was there.
    Known,
    /// Effects of several kinds explain it alike.
    Ambiguous,
    /// There is structure that no named effect explains.
    Unknown,
}

/// A parameter with its 95 % interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Value.
    pub value: f64,
    /// Unit; empty where there is none.
    pub unit: String,
    /// 95 % interval.
    pub ci95: [f64; 2],
}

/// A named effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Name of the effect.
    pub kind: String,
    /// Where it sits, for people; empty for the whole column.
    pub target: String,
    /// What it acts on.
    pub class: Class,
    /// The `[[effects]]` table of the corrected manifest.
    pub table: toml::Table,
    /// Its parameters by name.
    pub parameters: BTreeMap<String, Estimate>,
    /// Fall of the cost on training and validation events less the charge, when it was added.
    pub gain: f64,
    /// Fall of the cost on the validation events alone.
    pub validation_gain: f64,
    /// Whether it holds whatever the profile: found at the frequencies that every column passes alike, its gain the squared
    /// distance from what is declared in standard deviations.
    #[serde(default)]
    pub is_standing: bool,
}

/// An effect that was tried.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Name of the effect.
    pub kind: String,
    /// Where it sits.
    pub target: String,
    /// What it acts on.
    pub class: Class,
    /// Fall of the cost on training and validation events less the charge.
    pub gain: f64,
    /// Fall of the cost on the validation events alone.
    pub validation_gain: f64,
    /// Share of the recalibrated model's excess cost that it explains.
    pub explained_share: f64,
    /// The round of the forward search, from 1.
    pub round: usize,
    /// Whether the nonlinear column confirmed the number.
    pub is_confirmed: bool,
    /// Its `[[effects]]` table.
    pub table: toml::Table,
}

/// A declared value that the records put outside its tolerance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ToleranceAlarm {
    /// What is out of tolerance, for people.
    pub what: String,
    /// Distance from the declared value in prior standard deviations.
    pub deviations: f64,
    /// The estimate.
    pub estimate: Estimate,
}

/// What of an effect could still hide below the alarm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UpperBound {
    /// Name of the effect.
    pub kind: String,
    /// Where it would sit.
    pub target: String,
    /// Largest strength, in the unit of the parameter, that 95 % certainty leaves open.
    pub parameter: String,
    /// The bound.
    pub value: f64,
    /// Its unit.
    pub unit: String,
}

/// Where structure remains: mean squared whitened residual, 1 where there is only noise.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Remainder {
    /// Edges of the frequency bands, Hz.
    pub edges_hz: Vec<f64>,
    /// `[sensor][band]` over all events.
    pub sensor_band: BTreeMap<String, Vec<f64>>,
    /// `[sensor][phase]` over all events; phases end where the input has brought 5, 75, 95 and 100 % of its energy.
    #[serde(default)]
    pub sensor_phase: BTreeMap<String, Vec<f64>>,
    /// By event and component, with the peak input acceleration in m/s².
    pub event: Vec<EventRemainder>,
}

/// Shares of the energy of the recorded input at which the phases of an event end: its beginning, its strong phase, what follows, and
/// the coda.
pub const PHASES: [f64; 4] = [0.05, 0.75, 0.95, 1.0];

/// Remaining structure of one record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EventRemainder {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// Peak acceleration of the input sensor, m/s².
    pub input_pga_m_s2: f64,
    /// Mean squared whitened residual.
    pub level: f64,
}

/// Excess of the cost over its expectation, in standard deviations of a χ² of as many numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Excess {
    /// Training events.
    pub train: f64,
    /// Validation events, beyond what the training events have left open.
    pub validation: f64,
}

/// What remains beside the answer, in a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RestVerdict {
    /// No more than noise of sensors and the declared error of the model itself.
    Noise,
    /// Motion that does not follow the base in the same way in all events.
    Incoherent,
    /// Something that is the same in all events and has no name.
    Unnamed,
}

/// What remains beside the answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rest {
    /// In a word.
    pub verdict: RestVerdict,
    /// Its power over that of the records, noise of sensors taken off.
    pub share: f64,
    /// The part of it that is the same in all events.
    pub repeatable_share: f64,
    /// Coherence of each output sensor with the prediction: frequency in Hz, and c.
    pub coherence: BTreeMap<String, Vec<[f64; 2]>>,
    /// What is the same in all events of each output sensor, as a share of what the column adds to its base: frequency in Hz, real and
    /// imaginary part.
    #[serde(rename = "where")]
    pub place: BTreeMap<String, Vec<[f64; 3]>>,
    /// Error of the column over the declared one, at least 1.
    pub level: f64,
}

/// `diagnosis.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Diagnosis {
    /// The answer.
    pub verdict: Verdict,
    /// Effects that the records ask for, in the order they were found; empty without an alarm.
    pub effects: Vec<Found>,
    /// Kinds that explain the records about as well as what was named, the named ones included.
    pub ambiguity: Vec<String>,
    /// Recalibrated declared values as `[[effects]]`, without any new effect.
    pub nuisances: Vec<toml::Table>,
    /// The same, fitted together with the named effects.
    pub corrected_nuisances: Vec<toml::Table>,
    /// Effects that were fitted, best first within each round.
    pub candidates: Vec<Candidate>,
    /// Share of the recalibrated model's excess cost that the named effects explain.
    pub explained_share: Option<f64>,
    /// Share of the recalibrated model's residual that is coherent with the recorded input.
    pub input_coherent_share: Option<f64>,
    /// Excess of the declared, the recalibrated and the corrected model.
    pub declared: Excess,
    /// Excess of the recalibrated model.
    pub recalibrated: Excess,
    /// Excess of the corrected model.
    pub corrected: Excess,
    /// Declared values outside their tolerance.
    pub tolerance_alarms: Vec<ToleranceAlarm>,
    /// What could still hide, when nothing was found.
    pub upper_bounds: Vec<UpperBound>,
    /// Structure that remains after the correction.
    pub remainder: Remainder,
    /// What the residuals of the corrected model say by themselves.
    #[serde(default)]
    pub evidence: Evidence,
    /// What remains beside the answer, where the diagnosis says it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rest: Option<Rest>,
    /// Remarks for people.
    pub notes: Vec<String>,
}

/// Alarm thresholds of one array, from null twins of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Thresholds {
    /// Gain (after the charge) above which an effect is an alarm.
    pub gain: f64,
    /// Fall of the validation cost that an alarm needs as well.
    pub validation_gain: f64,
    /// Excess of the validation events above which structure remains.
    pub excess: f64,
    /// Prior standard deviations beyond which a declared value is out of tolerance.
    pub deviations: f64,
    /// Null twins behind these numbers.
    pub twins: usize,
    /// Gains of the best effect of each null twin, rising.
    pub null_gains: Vec<f64>,
}

#[cfg(test)]
impl Diagnosis {
    /// One that found nothing and leaves nothing, but for the `given` keys.
    pub(crate) fn made_up(given: serde_json::Value) -> Self {
        let none = serde_json::json!({ "train": 0.0, "validation": 0.0 });
        let mut all = serde_json::json!({
            "verdict": "none", "effects": [], "ambiguity": [], "nuisances": [], "corrected_nuisances": [],
            "candidates": [], "explained_share": null, "input_coherent_share": null, "declared": none,
            "recalibrated": none, "corrected": none, "tolerance_alarms": [], "upper_bounds": [], "notes": [],
            "remainder": { "edges_hz": [], "sensor_band": {}, "event": [] },
        });
        given.as_object().into_iter().flatten().for_each(|(key, value)| all[key] = value.clone());
        serde_json::from_value(all).expect("a diagnosis")
    }
}
