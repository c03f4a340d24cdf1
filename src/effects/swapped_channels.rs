//! Two sensors, or the two components of one, carry each other's label.

use super::{Array, Catalogue, Class, Effect, Entry, Instance, Operator, Place};
use crate::error::{Error, Result};
use crate::registry;
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "swapped_channels",
    about: "two sensors, or the two components of one, carry each other's label",
    phrases: &["{place} carry each other's label"],
    build: |table| Ok(Box::new(registry::params::<SwappedChannels>(table)?.checked()?)),
    schema: || schemars::schema_for!(SwappedChannels),
    catalogue: Catalogue {
        number: 16,
        class: Class::Sensor,
        parameters: &[],
        instances,
        confused_with: &[],
        key: "arrival times out of the order of depths: tried before anything else",
    },
};

/// Each pair of sensors, and the components of each sensor.
fn instances(array: &Array) -> Vec<Instance> {
    let names: Vec<&str> = array.sensors().collect();
    let pair = |a: &str, b: &str| Instance::new(ENTRY.name, [("sensor", a.into()), ("with", b.into())], Vec::new());
    let mut found: Vec<Instance> = (0..names.len())
        .flat_map(|i| names[i + 1..].iter().map(move |b| (i, b)))
        .map(|(i, b)| pair(names[i], b))
        .collect();
    if array.components.len() > 1 {
        found.extend(names.iter().map(|s| Instance::new(ENTRY.name, [("sensor", (*s).into())], Vec::new())));
    }
    found
}

/// Exchanges the records of two sensors, or the first two components of one.
///
/// ```text
/// y_a = x_b,  y_b = x_a                                                 (1)
/// ```
///
/// | field    | meaning                                                              |
/// |----------|----------------------------------------------------------------------|
/// | `sensor` | one sensor                                                           |
/// | `with`   | the other; where it is absent, the components of `sensor` are swapped |
///
/// Limits: has no strength; it holds or it does not.
/// Check:  `swapping_twice_is_the_declared_order`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SwappedChannels {
    /// Name of one sensor.
    sensor: String,
    /// Name of the other.
    #[serde(default)]
    with: Option<String>,
}

impl SwappedChannels {
    fn checked(self) -> Result<Self> {
        if self.with.as_ref() == Some(&self.sensor) {
            let what = format!("`with` must name another sensor than `sensor`, got `{}` twice", self.sensor);
            return Err(Error::new(what).hint("leave `with` out to swap the components of one sensor").usage());
        }
        Ok(self)
    }
}

impl Effect for SwappedChannels {
    fn sensors(&self) -> Vec<&str> {
        std::iter::once(self.sensor.as_str()).chain(self.with.as_deref()).collect()
    }

    fn response(&self, place: &Place<'_>, _: f64) -> Option<Operator> {
        let [zero, one] = [0.0, 1.0].map(|x| Complex::new(x, 0.0));
        (self.with.is_none() && place.sensor == self.sensor).then_some(Operator([[zero, one], [one, zero]]))
    }

    fn exchange(&self) -> Option<(&str, &str)> {
        Some((&self.sensor, self.with.as_ref().unwrap_or(&self.sensor))) // (1)
    }
}
