//! Shear-wave velocity of a depth range differs from the declared one.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation, layers};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "layer_velocity",
    about: "shear-wave velocity of a depth range is faster or slower than declared",
    phrases: &["Vs of {place} is {ln_factor|lower|higher}"],
    build: |table| Ok(Box::new(registry::params::<LayerVelocity>(table)?.checked()?)),
    schema: || schemars::schema_for!(LayerVelocity),
    catalogue: Catalogue {
        number: 1,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances,
        confused_with: &["thin_seam", "water_table", "stiff_crust", "sensor_depth", "clock_offset"],
        key: "transfer functions between neighbouring sensors: only those across the range change",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "ln_factor",
    unit: "",
    zero: Some(0.0),
    low: -1.2,
    high: 1.2,
    scale: Scale::Linear,
    prior_sd: 0.2,
    draw: [0.08, 0.2],
    is_signed: true,
}];

/// Largest ln of a factor that a table may have.
pub const LAYER_VELOCITY_LN: f64 = 1.5;

/// One instance for each range of the column that the records can tell apart.
fn instances(array: &Array) -> Vec<Instance> {
    layers::ranges_m(array).into_iter().map(velocity_between).collect()
}

/// The velocity between two depths, m, its ln free.
pub fn velocity_between(range_m: [f64; 2]) -> Instance {
    Instance::between(ENTRY.name, range_m, vec![Free::new(&PARAMETERS[0], 0.0)])
}

/// Scales the shear-wave velocity of a depth range; layers are cut at its ends.
///
/// ```text
/// Vs → Vs · exp(ln_factor)                                              (1)
/// ```
///
/// | symbol    | field       | unit | range      |
/// |-----------|-------------|------|------------|
/// | ln_factor | `ln_factor` | –    | −1.5…1.5   |
/// | top       | `top_m`     | m    | ≥ 0        |
/// | bottom    | `bottom_m`  | m    | > `top_m`  |
///
/// Limits: strength and curves keep their parameters.
/// Check:  `zero_strength_is_identical_and_only_the_range_changes`.
/// Source: Thompson et al. (2009) on velocity bias at vertical arrays.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LayerVelocity {
    ln_factor: f64,
    #[serde(default)]
    top_m: f64,
    #[serde(default = "super::bottomless")]
    bottom_m: f64,
}

impl LayerVelocity {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("ln_factor", self.ln_factor, -LAYER_VELOCITY_LN, LAYER_VELOCITY_LN, "")])?;
        super::depth_range(self.top_m, self.bottom_m)?;
        Ok(self)
    }
}

impl Effect for LayerVelocity {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.ln_factor == 0.0 {
            return;
        }
        for layer in layers::between(profile, self.top_m, self.bottom_m) {
            layer.vs_m_s *= self.ln_factor.exp(); // (1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::Layer;
    use crate::effects::layers::tests::profile;

    #[test]
    fn two_sensors_have_groups_of_layers_as_places_and_three_have_their_intervals() {
        let layers = [(1.0, 110.0), (33.0, 250.0), (22.0, 1200.0), (30.0, 490.0), (29.0, 560.0)];
        let layers = layers.map(|(thickness_m, vs_m_s)| Layer::plain("elastic", thickness_m, 1900.0, vs_m_s));
        let array = |depths_m: Vec<f64>| Array {
            profile: Profile { elements: 40, ..Profile::plain(layers.to_vec()) },
            input: "base".into(),
            outputs: depths_m.iter().map(|d| format!("at {d}")).collect(),
            depths_m,
            components: vec!["EW".into()],
        };
        let places = |depths_m| instances(&array(depths_m)).iter().map(Instance::place).collect::<Vec<_>>();
        assert_eq!(places(vec![0.0]), ["0.0–115.0 m", "0.0–34.0 m", "34.0–56.0 m", "56.0–115.0 m"]);
        assert_eq!(places(vec![20.0, 0.0]), ["0.0–20.0 m", "20.0–115.0 m"]);
    }

    #[test]
    fn zero_strength_is_identical_and_only_the_range_changes() {
        let mut edited = profile("elastic");
        let effect = |ln_factor, top_m, bottom_m| LayerVelocity { ln_factor, top_m, bottom_m };
        effect(0.0, 0.0, 9.0).edit(&mut edited, &Situation::default());
        assert_eq!(edited, profile("elastic"));
        effect(0.1, 1.5, 4.0).edit(&mut edited, &Situation::default());
        let fast = 150.0 * 0.1f64.exp();
        let seen: Vec<_> = edited.layers.iter().map(|l| (l.thickness_m, l.vs_m_s)).collect();
        assert_eq!(seen, [(1.5, 150.0), (0.5, fast), (2.0, fast)]);
    }
}
