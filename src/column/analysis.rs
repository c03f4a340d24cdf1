//! How the column is stepped through time: the manifest's `[analysis]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Time stepping of the column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Analysis {
    /// First time increment, s.
    pub initial_step_s: f64,
    /// Largest time increment, s.
    pub max_step_s: f64,
    /// Smallest time increment before the run is given up, s.
    pub min_step_s: f64,
    /// Output interval, s.
    pub output_step_s: f64,
    /// Numerical damping α of the HHT method, −1/3…0.
    pub hht_alpha: f64,
    /// Largest unbalanced nodal traction, as a share of the largest dynamic stress so far.
    pub tolerance: f64,
    /// Newton iterations allowed per increment before it is halved.
    pub max_iterations: u32,
    /// Largest change of a nodal acceleration within an increment, as a share of the largest acceleration so far; a
    /// larger one is taken in shorter increments, down to an eighth of `max_step_s`.
    pub max_jump: f64,
}

impl Default for Analysis {
    fn default() -> Self {
        Self {
            initial_step_s: 0.001,
            max_step_s: 0.005,
            min_step_s: 1e-7,
            output_step_s: 0.005,
            hht_alpha: -0.05,
            tolerance: 1e-4,
            max_iterations: 12,
            max_jump: 0.2,
        }
    }
}

impl Analysis {
    /// What is out of range, as (key, sentence).
    pub fn problems(&self) -> Vec<(String, String)> {
        let mut problems = Vec::new();
        let mut check = |key: &str, value: f64, unit: &str, low: f64, high: f64| {
            if !(value >= low && value <= high) {
                problems.push((key.to_string(), format!("must be in {low}…{high}{unit}, got {value}")));
            }
        };
        check("max_step_s", self.max_step_s, " s", 1e-6, 1.0);
        check("initial_step_s", self.initial_step_s, " s", 1e-6, self.max_step_s.max(1e-6));
        check("min_step_s", self.min_step_s, " s", 1e-12, self.initial_step_s.max(1e-12));
        check("output_step_s", self.output_step_s, " s", 1e-6, 1.0);
        check("hht_alpha", self.hht_alpha, "", -1.0 / 3.0, 0.0);
        check("tolerance", self.tolerance, "", 1e-12, 0.05);
        check("max_jump", self.max_jump, "", 0.01, f64::INFINITY);
        check("max_iterations", f64::from(self.max_iterations), "", 2.0, 1000.0);
        problems
    }
}
