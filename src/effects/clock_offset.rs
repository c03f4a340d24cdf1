//! A sensor's clock is late or early.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Operator, Parameter, Place, Scale};
use crate::error::Result;
use crate::registry;
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

pub(super) const ENTRY: Entry = Entry {
    name: "clock_offset",
    about: "one sensor's clock is late or early",
    phrases: &["the clock of {place} is {offset_s|early|late}"],
    build: |table| Ok(Box::new(registry::params::<ClockOffset>(table)?.checked()?)),
    schema: || schemars::schema_for!(ClockOffset),
    catalogue: Catalogue {
        number: 13,
        class: Class::Sensor,
        parameters: PARAMETERS,
        instances,
        confused_with: &["layer_velocity", "sensor_depth", "instrument_low_pass"],
        key: "phase exactly linear in frequency at unit modulus; at the input sensor all outputs shift alike",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "offset_s",
    unit: "s",
    zero: Some(0.0),
    low: -0.2,
    high: 0.2,
    scale: Scale::Linear,
    prior_sd: 0.02,
    draw: [0.01, 0.04],
    is_signed: true,
}];

/// One instance a sensor, the input sensor too.
fn instances(array: &Array) -> Vec<Instance> {
    array.one_each(ENTRY.name, &[Free::new(&PARAMETERS[0], 0.0)])
}

/// Delays what a sensor records.
///
/// ```text
/// Y(f) = X(f) · exp(−i 2π f τ)                                          (1)
/// ```
///
/// | symbol | field      | unit | range |
/// |--------|------------|------|-------|
/// | τ      | `offset_s` | s    | −5…5  |
///
/// Limits: one offset for all events; no drift.
/// Check:  `numerics/spectrum.rs`: `a_delay_moves_a_pulse_and_nothing_wraps_around`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct ClockOffset {
    /// Name of the sensor.
    sensor: String,
    /// How late the record is, s.
    offset_s: f64,
}

impl ClockOffset {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("offset_s", self.offset_s, -5.0, 5.0, "s")])?;
        Ok(self)
    }
}

impl Effect for ClockOffset {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn response(&self, place: &Place<'_>, frequency_hz: f64) -> Option<Operator> {
        let acts = self.offset_s != 0.0 && place.sensor == self.sensor;
        acts.then(|| Operator::scalar(Complex::from_polar(1.0, -TAU * frequency_hz * self.offset_s))) // (1)
    }
}
