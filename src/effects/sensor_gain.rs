//! A sensor records too much or too little at every frequency.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Operator, Parameter, Place, Scale};
use crate::error::Result;
use crate::registry;
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "sensor_gain",
    about: "one sensor records too much or too little, alike at every frequency",
    phrases: &["{place} records {ln_gain|too little|too much}"],
    build: |table| Ok(Box::new(registry::params::<SensorGain>(table)?.checked()?)),
    schema: || schemars::schema_for!(SensorGain),
    catalogue: Catalogue {
        number: 11,
        class: Class::Sensor,
        parameters: PARAMETERS,
        instances,
        confused_with: &["small_strain_damping", "compliant_base"],
        key: "a flat ratio of spectra with zero phase, on one channel, in all events",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "ln_gain",
    unit: "",
    zero: Some(0.0),
    low: -1.5,
    high: 1.5,
    scale: Scale::Linear,
    prior_sd: 0.2,
    draw: [0.08, 0.25],
    is_signed: true,
}];

/// One instance a sensor, the input sensor too.
fn instances(array: &Array) -> Vec<Instance> {
    array.one_each(ENTRY.name, &[Free::new(&PARAMETERS[0], 0.0)])
}

/// Multiplies what a sensor records by a constant.
///
/// ```text
/// y(t) = exp(ln_gain) · x(t)                                            (1)
/// ```
///
/// | symbol  | field     | unit | range |
/// |---------|-----------|------|-------|
/// | ln_gain | `ln_gain` | –    | −5…5  |
///
/// Limits: the same for every component of the sensor.
/// Check:  `every_effect_of_zero_strength_leaves_everything_bit_identical`, `what_a_sensor_does_is_undone`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SensorGain {
    /// Name of the sensor.
    sensor: String,
    /// ln of the factor on what is recorded.
    ln_gain: f64,
}

impl SensorGain {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("ln_gain", self.ln_gain, -5.0, 5.0, "")])?;
        Ok(self)
    }
}

impl Effect for SensorGain {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn response(&self, place: &Place<'_>, _: f64) -> Option<Operator> {
        let acts = self.ln_gain != 0.0 && place.sensor == self.sensor;
        acts.then(|| Operator::scalar(Complex::new(self.ln_gain.exp(), 0.0))) // (1)
    }
}
