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
    low: -0.5,
    high: 0.5,
    scale: Scale::Linear,
    prior_sd: 0.2,
    draw: [0.08, 0.2],
    is_signed: true,
}];

/// One instance between each two neighbouring sensors.
fn instances(array: &Array) -> Vec<Instance> {
    let cuts = array.cuts_m();
    let between = |pair: &[f64]| {
        let target = [("top_m", pair[0].into()), ("bottom_m", pair[1].into())];
        Instance::new(ENTRY.name, target, vec![Free::new(&PARAMETERS[0], 0.0)])
    };
    cuts.windows(2).map(between).collect()
}

/// Scales the shear-wave velocity of a depth range; layers are cut at its ends.
///
/// ```text
/// Vs → Vs · exp(ln_factor)                                              (1)
/// ```
///
/// | symbol    | field       | unit | range      |
/// |-----------|-------------|------|------------|
/// | ln_factor | `ln_factor` | –    | −0.7…0.7   |
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
        super::ranges(&[("ln_factor", self.ln_factor, -0.7, 0.7, "")])?;
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
    use crate::effects::layers::tests::profile;

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
