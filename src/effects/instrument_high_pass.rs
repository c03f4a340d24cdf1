//! An instrument does not pass low frequencies.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Operator, Parameter, Place, Scale};
use crate::error::Result;
use crate::registry;
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "instrument_high_pass",
    about: "one sensor does not pass low frequencies",
    phrases: &["{place} records nothing below {corner_hz}"],
    build: |table| Ok(Box::new(registry::params::<InstrumentHighPass>(table)?.checked()?)),
    schema: || schemars::schema_for!(InstrumentHighPass),
    catalogue: Catalogue {
        number: 17,
        class: Class::Sensor,
        parameters: PARAMETERS,
        instances,
        confused_with: &["baseline_tilt", "surface_wave"],
        key: "phase advance at low frequencies against the other sensors",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "corner_hz",
    unit: "Hz",
    zero: Some(0.0),
    low: 0.0,
    high: 1.0,
    scale: Scale::Linear,
    prior_sd: 0.2,
    draw: [0.1, 0.5],
    is_signed: false,
}];

/// One instance a sensor, the input sensor too.
fn instances(array: &Array) -> Vec<Instance> {
    array.one_each(ENTRY.name, &[Free::new(&PARAMETERS[0], 0.0)])
}

/// A causal high-pass of second order.
///
/// ```text
/// Y(f) = X(f) / (1 − i f_c/f)²                                          (1)
/// ```
///
/// | symbol | field       | unit | range |
/// |--------|-------------|------|-------|
/// | f_c    | `corner_hz` | Hz   | 0…20  |
///
/// Limits: half the amplitude is left at the corner; other instruments roll off differently. What lies far below
/// the corner is not brought back by undoing.
/// Check:  `the_corner_passes_half_and_advances_the_phase`.
/// Source: two first-order RC stages.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct InstrumentHighPass {
    /// Name of the sensor.
    sensor: String,
    /// Corner, Hz; 0 passes everything.
    corner_hz: f64,
}

impl InstrumentHighPass {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("corner_hz", self.corner_hz, 0.0, 20.0, "Hz")])?;
        Ok(self)
    }
}

impl Effect for InstrumentHighPass {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn response(&self, place: &Place<'_>, frequency_hz: f64) -> Option<Operator> {
        let acts = self.corner_hz > 0.0 && place.sensor == self.sensor;
        // (1) times (f/f)², which is finite at f = 0.
        let stage = || Complex::new(frequency_hz, 0.0) / Complex::new(frequency_hz, -self.corner_hz);
        acts.then(|| Operator::scalar(stage() * stage()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corner_passes_half_and_advances_the_phase() {
        let effect = InstrumentHighPass { sensor: "top".into(), corner_hz: 0.3 };
        let place = Place { sensor: "top", components: &[] };
        let at = |f| effect.response(&place, f).unwrap().0[0][0];
        assert!((at(0.3).norm() - 0.5).abs() < 1e-12);
        assert!((at(0.3).arg() - 0.25 * std::f64::consts::TAU).abs() < 1e-12);
        assert_eq!(at(0.0).norm(), 0.0);
        assert!((at(300.0) - 1.0).norm() < 3e-3);
        assert!(effect.response(&Place { sensor: "base", components: &[] }, 1.0).is_none());
    }
}
