//! How a diagnosis searches and decides: the manifest's `[diagnose]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How it is decided what the declared model lacks.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// A forward search with alarm thresholds from null twins; whatever is unexplained counts as noise of the sensors. For twins that this
    /// program makes.
    Search,
    /// A competition of models by their evidence; the field may be partly incoherent, and the column may be wrong within
    /// `tolerances.model`. For measured records and those of other programs.
    #[default]
    Competition,
}

/// Search and decision of the diagnosis (manifest section `[diagnose]`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DiagnoseSettings {
    /// How it is decided what is missing.
    pub method: Method,
    /// Seed of the null twins.
    pub seed: u64,
    /// Lowest and highest frequency compared, Hz; the record's own time step may lower the upper one.
    pub band_hz: [f64; 2],
    /// Null twins from which the alarm thresholds are taken.
    pub null_twins: usize,
    /// Share of null twins that may raise an alarm.
    pub false_alarm_share: f64,
    /// Most effects named at once.
    pub max_effects: usize,
    /// Effects of each round fitted together with the nuisances.
    pub finalists: usize,
    /// Effects of each round confirmed with the finite-element column.
    pub confirmed: usize,
    /// Error of the column itself, as a share of its smoothed spectrum.
    pub model_error: f64,
    /// Largest time step of the replays that the diagnosis compares with, s: the error of a longer one looks like damping.
    pub max_step_s: f64,
    /// Explained share of the residual above which a verdict may be `known` although structure remains. In twins,
    /// right names explained 0.96 and more; wrong or missing ones that left twice the error of the floor, 0.82 to 0.93.
    pub known_share: f64,
    /// Explained share of the residual below which a verdict is `unknown`.
    pub unknown_share: f64,
    /// Gain within which two effects count as indistinguishable.
    pub ambiguity: f64,
}

impl Default for DiagnoseSettings {
    fn default() -> Self {
        Self {
            method: Method::Competition,
            seed: 1,
            band_hz: [0.2, 9.5],
            null_twins: 60,
            false_alarm_share: 0.025,
            max_effects: 3,
            finalists: 8,
            confirmed: 2,
            model_error: 0.01,
            max_step_s: 0.0025,
            known_share: 0.95,
            unknown_share: 0.5,
            ambiguity: 10.0,
        }
    }
}

impl DiagnoseSettings {
    /// What is out of range, as (key, sentence).
    pub fn problems(&self) -> Vec<(String, String)> {
        let mut problems = Vec::new();
        let mut check = |key: &str, value: f64, unit: &str, low: f64, high: f64| {
            if !(value >= low && value <= high) {
                problems.push((key.to_string(), format!("must be in {low}…{high}{unit}, got {value}")));
            }
        };
        check("band_hz", self.band_hz[0], " Hz", 0.01, 100.0);
        check("band_hz", self.band_hz[1], " Hz", self.band_hz[0] + 0.1, 100.0);
        check("null_twins", self.null_twins as f64, "", 10.0, 10_000.0);
        check("false_alarm_share", self.false_alarm_share, "", 0.001, 0.5);
        check("max_effects", self.max_effects as f64, "", 1.0, 5.0);
        check("finalists", self.finalists as f64, "", 1.0, 100.0);
        check("confirmed", self.confirmed as f64, "", 1.0, 10.0);
        check("model_error", self.model_error, "", 0.0, 1.0);
        check("max_step_s", self.max_step_s, " s", 1e-5, 0.1);
        check("known_share", self.known_share, "", 0.0, 1.0);
        check("unknown_share", self.unknown_share, "", 0.0, self.known_share);
        check("ambiguity", self.ambiguity, "", 0.0, 1e6);
        problems
    }
}
