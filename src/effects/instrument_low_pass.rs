//! An instrument does not pass high frequencies.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Operator, Parameter, Place, Scale};
use crate::error::Result;
use crate::registry;
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "instrument_low_pass",
    about: "one sensor does not pass high frequencies",
    phrases: &["{place} records nothing above {corner_hz}"],
    build: |table| Ok(Box::new(registry::params::<InstrumentLowPass>(table)?.checked()?)),
    schema: || schemars::schema_for!(InstrumentLowPass),
    catalogue: Catalogue {
        number: 18,
        class: Class::Sensor,
        parameters: PARAMETERS,
        instances,
        confused_with: &["frequency_dependent_damping", "clock_offset", "small_strain_damping"],
        key: "one channel only, whatever its depth",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "corner_hz",
    unit: "Hz",
    zero: Some(f64::INFINITY),
    low: 2.0,
    high: f64::INFINITY,
    scale: Scale::Inverse,
    prior_sd: 0.06,
    draw: [4.0, 12.0],
    is_signed: false,
}];

/// One instance a sensor, the input sensor too.
fn instances(array: &Array) -> Vec<Instance> {
    array.one_each(ENTRY.name, &[Free::new(&PARAMETERS[0], f64::INFINITY)])
}

/// A causal low-pass of first order.
///
/// ```text
/// Y(f) = X(f) / (1 + i f/f_c)                                           (1)
/// ```
///
/// | symbol | field       | unit | range |
/// |--------|-------------|------|-------|
/// | f_c    | `corner_hz` | Hz   | 0.5…∞ |
///
/// Limits: 0.71 of the amplitude is left at the corner; anti-alias filters are steeper.
/// Check:  `the_corner_passes_0_71_and_delays_the_phase`.
/// Source: one first-order RC stage.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct InstrumentLowPass {
    /// Name of the sensor.
    sensor: String,
    /// Corner, Hz; `inf` passes everything.
    corner_hz: f64,
}

impl InstrumentLowPass {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("corner_hz", self.corner_hz, 0.5, f64::INFINITY, "Hz")])?;
        Ok(self)
    }
}

impl Effect for InstrumentLowPass {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn response(&self, place: &Place<'_>, frequency_hz: f64) -> Option<Operator> {
        let acts = self.corner_hz.is_finite() && place.sensor == self.sensor;
        acts.then(|| Operator::scalar(Complex::new(1.0, frequency_hz / self.corner_hz).inv())) // (1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corner_passes_0_71_and_delays_the_phase() {
        let effect = InstrumentLowPass { sensor: "top".into(), corner_hz: 6.0 };
        let place = Place { sensor: "top", components: &[] };
        let at = |f| effect.response(&place, f).unwrap().0[0][0];
        assert!((at(6.0).norm() - 0.5f64.sqrt()).abs() < 1e-12);
        assert!((at(6.0).arg() + 0.125 * std::f64::consts::TAU).abs() < 1e-12);
        assert_eq!(at(0.0), Complex::new(1.0, 0.0));
    }
}
