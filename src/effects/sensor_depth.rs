//! A sensor sits deeper or shallower than declared.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale};
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "sensor_depth",
    about: "one buried sensor sits deeper or shallower than declared",
    phrases: &["{place} sits {offset_m|shallower|deeper} than declared"],
    build: |table| Ok(Box::new(registry::params::<SensorDepth>(table)?.checked()?)),
    schema: || schemars::schema_for!(SensorDepth),
    catalogue: Catalogue {
        number: 15,
        class: Class::Sensor,
        parameters: PARAMETERS,
        instances,
        confused_with: &["clock_offset", "layer_velocity", "thin_seam"],
        key: "the frequency of the node in the sensor's transfer function",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "offset_m",
    unit: "m",
    zero: Some(0.0),
    low: -3.0,
    high: 3.0,
    scale: Scale::Linear,
    prior_sd: 1.0,
    draw: [0.7, 2.0],
    is_signed: true,
}];

/// One instance a buried output sensor; the depth of the input sensor is that of the column.
fn instances(array: &Array) -> Vec<Instance> {
    let buried = array.outputs.iter().zip(&array.depths_m).filter(|(_, z)| **z > 0.0);
    let at =
        |s: &String| Instance::new(ENTRY.name, [("sensor", s.as_str().into())], vec![Free::new(&PARAMETERS[0], 0.0)]);
    buried.map(|(s, _)| at(s)).collect()
}

/// Observes the column at another depth.
///
/// ```text
/// z → z + Δz, within the column                                         (1)
/// ```
///
/// | symbol | field      | unit | range   |
/// |--------|------------|------|---------|
/// | Δz     | `offset_m` | m    | −50…50  |
///
/// Limits: output sensors only: the column ends at the input sensor, wherever that is.
/// Check:  `a_sensor_moves_and_stays_in_the_column`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SensorDepth {
    /// Name of the sensor.
    sensor: String,
    /// How much deeper it sits, m.
    offset_m: f64,
}

impl SensorDepth {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("offset_m", self.offset_m, -50.0, 50.0, "m")])?;
        Ok(self)
    }
}

impl Effect for SensorDepth {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn moves_sensor(&self) -> bool {
        true
    }

    fn depth_m(&self, sensor: &str, depth_m: f64) -> f64 {
        if sensor == self.sensor { depth_m + self.offset_m } else { depth_m } // (1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_moves_and_stays_in_the_column() {
        let moved = |offset_m| {
            let effect: Box<dyn Effect> = Box::new(SensorDepth { sensor: "mid".into(), offset_m });
            let at = |sensor| crate::effects::depth_m(std::slice::from_ref(&effect), sensor, 6.0, 17.0);
            [at("mid"), at("surface")]
        };
        assert_eq!(moved(1.5), [7.5, 6.0]);
        assert_eq!(moved(-9.0), [0.0, 6.0]);
        assert_eq!(moved(20.0), [17.0, 6.0]);
    }
}
