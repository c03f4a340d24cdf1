//! What a twin site and its sensors really are: the declared values moved within their tolerances.

use crate::column::Profile;
use crate::manifest::Tolerances;
use crate::numerics::random;
use rand_distr::{Distribution, StandardNormal};

/// Draws of one twin site.
#[derive(Debug, Clone, PartialEq)]
pub struct Draw {
    /// ln factor on the shear-wave velocity, one a layer.
    pub vs_ln: Vec<f64>,
    /// ln factor on the Rayleigh damping.
    pub damping_ln: f64,
    /// Draws of the sensors, the input sensor first.
    pub sensors: Vec<SensorDraw>,
}

/// Draws of one sensor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SensorDraw {
    /// ln of the gain.
    pub gain_ln: f64,
    /// Clock offset in s; positive is late.
    pub clock_s: f64,
    /// Azimuth error in rad, from the first towards the second component.
    pub azimuth_rad: f64,
}

impl Draw {
    /// Draws for `n_layer` layers and `n_sensor` sensors (input included) under `seed`.
    pub fn new(tolerances: &Tolerances, n_layer: usize, n_sensor: usize, seed: u64) -> Self {
        let mut random = random::stream(seed, "twin draws");
        let mut normal =
            |sd: f64| -> f64 { sd * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut random) };
        let vs_ln = (0..n_layer).map(|_| normal(tolerances.vs_ln)).collect();
        let damping_ln = normal(tolerances.damping_ln);
        let sensors = (0..n_sensor)
            .map(|_| SensorDraw {
                gain_ln: normal(tolerances.gain_ln),
                clock_s: normal(tolerances.clock_s),
                azimuth_rad: normal(tolerances.orientation_deg).to_radians(),
            })
            .collect();
        Self { vs_ln, damping_ln, sensors }
    }

    /// Moves the declared column to the drawn one.
    pub fn apply(&self, profile: &mut Profile) {
        for (layer, ln) in profile.layers.iter_mut().zip(&self.vs_ln) {
            layer.vs_m_s *= ln.exp();
        }
        profile.rayleigh.alpha_1_s *= self.damping_ln.exp();
        profile.rayleigh.beta_s *= self.damping_ln.exp();
    }
}
