//! Settings of the time stepping.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Time stepping of the column: the manifest's `[analysis]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Analysis {
    /// First time step, s.
    pub initial_step_s: f64,
    /// Largest time step, s.
    pub max_step_s: f64,
    /// Smallest time step before the column gives up, s.
    pub min_step_s: f64,
    /// Time between outputs, s.
    pub output_step_s: f64,
    /// α of the Hilber–Hughes–Taylor method, −1/3…0.
    pub hht_alpha: f64,
    /// Largest out-of-balance force, as a fraction of the largest inertia force so far.
    pub force_tolerance: f64,
    /// Newton iterations before a step is cut.
    pub max_iterations: u32,
}

impl Default for Analysis {
    fn default() -> Self {
        Self {
            initial_step_s: 0.001,
            max_step_s: 0.005,
            min_step_s: 1e-6,
            output_step_s: 0.005,
            hht_alpha: -0.05,
            force_tolerance: 1e-5,
            max_iterations: 12,
        }
    }
}

impl Analysis {
    /// Every value out of range: key and what is wrong.
    pub fn problems(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        let mut range = |key: &str, value: f64, lowest: f64, highest: f64, unit: &str| {
            if !(lowest..=highest).contains(&value) {
                found.push((key.to_string(), format!("`{key}` must be in {lowest}…{highest}{unit}, got {value}")));
            }
        };
        range("max_step_s", self.max_step_s, 1e-5, 0.05, " s");
        range("initial_step_s", self.initial_step_s, 1e-6, self.max_step_s, " s");
        range("min_step_s", self.min_step_s, 1e-9, self.initial_step_s, " s");
        range("output_step_s", self.output_step_s, 1e-4, 0.1, " s");
        range("hht_alpha", self.hht_alpha, -1.0 / 3.0, 0.0, "");
        range("force_tolerance", self.force_tolerance, 1e-12, 1e-2, "");
        range("max_iterations", f64::from(self.max_iterations), 2.0, 100.0, "");
        found
    }
}
