//! What a diagnosis compares and how much it may name: the manifest's `[diagnose]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the diagnosis (manifest section `[diagnose]`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DiagnoseSettings {
    /// Lowest and highest frequency compared, Hz; the record's own time step may lower the upper one.
    pub band_hz: [f64; 2],
    /// Most effects named at once.
    pub max_effects: usize,
}

impl Default for DiagnoseSettings {
    fn default() -> Self {
        Self { band_hz: [0.2, 9.5], max_effects: 5 }
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
        check("max_effects", self.max_effects as f64, "", 1.0, 5.0);
        problems
    }
}
