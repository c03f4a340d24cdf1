//! A channel of a sensor is wired the wrong way round.

use super::{Array, Catalogue, Class, Effect, Entry, Instance, Operator, Place};
use crate::registry;
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "sensor_polarity",
    about: "one channel of a sensor has the wrong sign",
    phrases: &["a channel of {place} has the wrong sign"],
    build: |table| Ok(Box::new(registry::params::<SensorPolarity>(table)?)),
    schema: || schemars::schema_for!(SensorPolarity),
    catalogue: Catalogue {
        number: 12,
        class: Class::Sensor,
        parameters: &[],
        instances,
        confused_with: &[],
        key: "the residual is twice the signal on one channel: tried before anything else",
    },
};

/// One instance a channel.
fn instances(array: &Array) -> Vec<Instance> {
    let at = |s: &str, c: &String| {
        Instance::new(ENTRY.name, [("sensor", s.into()), ("component", c.as_str().into())], Vec::new())
    };
    array.sensors().flat_map(|s| array.components.iter().map(move |c| at(s, c))).collect()
}

/// Reverses the sign of what a sensor records.
///
/// ```text
/// y(t) = −x(t)                                                          (1)
/// ```
///
/// | field       | meaning                                |
/// |-------------|----------------------------------------|
/// | `component` | the channel; both where it is absent    |
///
/// Limits: has no strength; it holds or it does not.
/// Check:  `only_the_named_channel_changes_its_sign`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SensorPolarity {
    /// Name of the sensor.
    sensor: String,
    /// Name of the component.
    #[serde(default)]
    component: Option<String>,
}

impl Effect for SensorPolarity {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn component(&self) -> Option<&str> {
        self.component.as_deref()
    }

    fn response(&self, place: &Place<'_>, _: f64) -> Option<Operator> {
        let sign = |i: usize| {
            let is_other = self.component.as_ref().is_some_and(|c| place.components.get(i) != Some(c));
            Complex::new(if is_other { 1.0 } else { -1.0 }, 0.0)
        };
        let mut operator = Operator::IDENTITY;
        (operator.0[0][0], operator.0[1][1]) = (sign(0), sign(1)); // (1)
        (place.sensor == self.sensor).then_some(operator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_named_channel_changes_its_sign() {
        let components = ["EW".to_string(), "NS".to_string()];
        let place = Place { sensor: "top", components: &components };
        let diagonal = |component: Option<&str>| {
            let effect = SensorPolarity { sensor: "top".into(), component: component.map(String::from) };
            let o = effect.response(&place, 1.0).unwrap().0;
            [o[0][0].re, o[1][1].re]
        };
        assert_eq!(diagonal(Some("NS")), [1.0, -1.0]);
        assert_eq!(diagonal(Some("EW")), [-1.0, 1.0]);
        assert_eq!(diagonal(None), [-1.0, -1.0]);
    }
}
