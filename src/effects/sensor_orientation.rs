//! A sensor's azimuth differs from the declared one.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Operator, Parameter, Place, Scale};
use crate::error::Result;
use crate::registry;
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "sensor_orientation",
    about: "one sensor is turned about the vertical",
    phrases: &["{place} is turned by {azimuth_deg}"],
    build: |table| Ok(Box::new(registry::params::<SensorOrientation>(table)?.checked()?)),
    schema: || schemars::schema_for!(SensorOrientation),
    catalogue: Catalogue {
        number: 14,
        class: Class::Sensor,
        parameters: PARAMETERS,
        instances,
        confused_with: &["directional_anisotropy"],
        key: "coherence with the other component of the same sensor, antisymmetric, down to the lowest frequencies",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "azimuth_deg",
    unit: "°",
    zero: Some(0.0),
    low: -60.0,
    high: 60.0,
    scale: Scale::Linear,
    prior_sd: 15.0,
    draw: [8.0, 25.0],
    is_signed: true,
}];

/// One instance a sensor, the input sensor too, where two components are recorded.
fn instances(array: &Array) -> Vec<Instance> {
    if array.components.len() < 2 { Vec::new() } else { array.one_each(ENTRY.name, &[Free::new(&PARAMETERS[0], 0.0)]) }
}

/// Turns the first two components of a sensor.
///
/// ```text
/// y₁ =  cos φ x₁ + sin φ x₂
/// y₂ = −sin φ x₁ + cos φ x₂                                             (1)
/// ```
///
/// | symbol | field         | unit | range    |
/// |--------|---------------|------|----------|
/// | φ      | `azimuth_deg` | °    | −180…180 |
///
/// φ turns from the first towards the second component of `records.components`.
///
/// Limits: a single component only loses the cosine.
/// Check:  `a_quarter_turn_exchanges_the_components`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SensorOrientation {
    /// Name of the sensor.
    sensor: String,
    /// Azimuth error from the first towards the second component, °.
    azimuth_deg: f64,
}

impl SensorOrientation {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("azimuth_deg", self.azimuth_deg, -180.0, 180.0, "°")])?;
        Ok(self)
    }
}

impl Effect for SensorOrientation {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn response(&self, place: &Place<'_>, _: f64) -> Option<Operator> {
        let acts = self.azimuth_deg != 0.0 && place.sensor == self.sensor;
        let (sin, cos) = self.azimuth_deg.to_radians().sin_cos();
        let real = |x| Complex::new(x, 0.0);
        acts.then(|| Operator([[real(cos), real(sin)], [real(-sin), real(cos)]])) // (1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_turn_exchanges_the_components() {
        let effect = SensorOrientation { sensor: "top".into(), azimuth_deg: 90.0 };
        let operator = effect.response(&Place { sensor: "top", components: &[] }, 1.0).unwrap();
        let [a, b] = operator.apply([Complex::new(1.0, 0.0), Complex::new(0.0, 2.0)]);
        assert!((a - Complex::new(0.0, 2.0)).norm() < 1e-12 && (b + 1.0).norm() < 1e-12);
    }
}
