//! A sensor tilts during the strong shaking and then records a share of gravity.

use super::{Array, Catalogue, Channel, Class, Effect, Entry, Free, Instance, Parameter, Scale};
use crate::error::Result;
use crate::numerics::filter;
use crate::registry;
use crate::units::G_M_S2;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "baseline_tilt",
    about: "one sensor tilts during the strong shaking and records a share of gravity from then on",
    phrases: &["{place} tilts by {tilt_deg} in the strong shaking"],
    build: |table| Ok(Box::new(registry::params::<BaselineTilt>(table)?.checked()?)),
    schema: || schemars::schema_for!(BaselineTilt),
    catalogue: Catalogue {
        number: 19,
        class: Class::Sensor,
        parameters: PARAMETERS,
        instances,
        confused_with: &["instrument_high_pass"],
        key: "a ramp of the integrated velocity after the strong phase, incoherent with the input",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "tilt_deg",
    unit: "°",
    zero: Some(0.0),
    low: -5.0,
    high: 5.0,
    scale: Scale::Linear,
    prior_sd: 0.3,
    draw: [0.05, 0.3],
    is_signed: true,
}];

/// One instance a sensor, the input sensor too.
fn instances(array: &Array) -> Vec<Instance> {
    array.one_each(ENTRY.name, &[Free::new(&PARAMETERS[0], 0.0)])
}

/// Lets the baseline of a sensor follow a tilt that grows with the energy of the shaking.
///
/// ```text
/// y(t) = x(t) + g sin(θ h(t)),   h(t) = ∫₀ᵗ x_b² / ∫ x_b²                (1)
/// ```
///
/// | symbol | field      | unit | range   |
/// |--------|------------|------|---------|
/// | θ      | `tilt_deg` | °    | −45…45  |
/// | x_b    |            | m/s² | x above [`LOW_HZ`], which is blind to the tilt itself |
///
/// Limits: the same tilt in all events and components of the sensor.
/// Check:  `a_tilt_is_taken_out_of_the_record_that_carries_it`.
/// Source: Graizer (2005), Effect of tilt on strong motion data processing, doi 10.1016/j.soildyn.2004.10.008.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct BaselineTilt {
    /// Name of the sensor.
    sensor: String,
    /// Final tilt, °.
    tilt_deg: f64,
}

/// Lower corner of the motion that counts as shaking, Hz.
const LOW_HZ: f64 = 0.7;

impl BaselineTilt {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("tilt_deg", self.tilt_deg, -45.0, 45.0, "°")])?;
        Ok(self)
    }

    /// (1) without x.
    fn drift(&self, channel: &Channel<'_>) -> Option<Vec<f64>> {
        if self.tilt_deg == 0.0 || channel.sensor != self.sensor {
            return None;
        }
        let gain = |f: f64| 1.0 - 1.0 / (1.0 + (f / LOW_HZ).powi(8));
        let shaking = filter::zero_phase(channel.acceleration_m_s2, channel.dt_s, gain);
        let total: f64 = shaking.iter().map(|a| a * a).sum();
        let mut sum = 0.0;
        let drift = shaking.iter().map(|a| {
            sum += a * a;
            G_M_S2 * (self.tilt_deg.to_radians() * sum / total.max(f64::MIN_POSITIVE)).sin()
        });
        Some(drift.collect())
    }
}

impl Effect for BaselineTilt {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn interference(&self, channel: &Channel<'_>) -> Option<Vec<f64>> {
        self.drift(channel)
    }

    fn estimated_interference(&self, channel: &Channel<'_>) -> Option<Vec<f64>> {
        self.drift(channel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilt_is_taken_out_of_the_record_that_carries_it() {
        let effect = BaselineTilt { sensor: "top".into(), tilt_deg: 0.2 };
        let motion: Vec<f64> =
            (0..3000).map(|i| 0.5 * (-((i as f64 - 900.0) / 200.0).powi(2)).exp() * (0.2 * i as f64).sin()).collect();
        let channel = |x| Channel { sensor: "top", component: "EW", event: "E1", dt_s: 0.01, acceleration_m_s2: x };
        let drift = effect.interference(&channel(&motion)).unwrap();
        assert!((drift[2999] - G_M_S2 * 0.2f64.to_radians().sin()).abs() < 1e-9);
        let record: Vec<f64> = motion.iter().zip(&drift).map(|(x, d)| x + d).collect();
        let found = effect.estimated_interference(&channel(&record)).unwrap();
        let worst = found.iter().zip(&drift).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 0.05 * drift[2999], "{worst}");
    }
}
