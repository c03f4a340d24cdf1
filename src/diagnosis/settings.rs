//! What a diagnosis compares and how much it may name: the manifest's `[diagnose]`.

use crate::ranges::{Range, Ranged, range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Least width of the band, Hz.
const LEAST_BAND_HZ: f64 = 0.1;

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
        let mut problems = self.beyond();
        let [low, high] = self.band_hz;
        if low + LEAST_BAND_HZ > high {
            problems.push(("band_hz".into(), format!("must be {LEAST_BAND_HZ} Hz wide or more, got [{low}, {high}]")));
        }
        problems
    }
}

impl Ranged for DiagnoseSettings {
    const RANGES: &'static [Range<Self>] =
        &[range!(each band_hz, "Hz", 0.01, 100.0), range!(max_effects, "", 1.0, 5.0)];
}
