//! How far declared values may be off: the manifest's `[tolerances]`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Prior standard deviations of what is declared, normal up to [`Tolerances::FARTHEST`]: the nuisances of a diagnosis and the draws of a
/// twin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Tolerances {
    /// ln of the shear-wave velocity of a layer.
    pub vs_ln: f64,
    /// ln of the small-strain damping.
    pub damping_ln: f64,
    /// ln of a sensor's gain.
    pub gain_ln: f64,
    /// Clock of a sensor, s.
    pub clock_s: f64,
    /// Azimuth of a sensor, degrees.
    pub orientation_deg: f64,
    /// Depth of an output sensor, m.
    pub depth_m: f64,
    /// Error of the column itself that is no parameter's, as a share of what the column adds to its base motion: what another program's
    /// column of the same site would differ by.
    pub model: f64,
}

impl Tolerances {
    /// Farthest that a declared value is within its tolerance, standard deviations: what is farther off is an effect.
    pub const FARTHEST: f64 = 2.5;
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            vs_ln: 0.05,
            damping_ln: 0.3,
            gain_ln: 0.01,
            clock_s: 0.001,
            orientation_deg: 1.0,
            depth_m: 0.1,
            model: 0.05,
        }
    }
}
