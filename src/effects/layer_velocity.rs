//! Shear-wave velocity of a depth range differs from the declared one.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::Profile;
use crate::error::{Error, Result};
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

/// Scales the shear-wave velocity of every layer whose middle lies in a depth range.
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
/// Limits: whole layers only; strength and curves keep their parameters.
/// Check:  the test below (zero strength is bit-identical; travel time changes by the factor).
/// Source: Thompson et al. (2009) on velocity bias at vertical arrays.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LayerVelocity {
    ln_factor: f64,
    #[serde(default)]
    top_m: f64,
    #[serde(default = "whole_profile")]
    bottom_m: f64,
}

fn whole_profile() -> f64 {
    1e4
}

impl LayerVelocity {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("ln_factor", self.ln_factor, -0.7, 0.7, "")])?;
        if self.top_m < 0.0 || self.bottom_m <= self.top_m {
            let what = format!("`bottom_m` must be larger than `top_m` ≥ 0 m, got {}…{} m", self.top_m, self.bottom_m);
            return Err(Error::new(what).usage());
        }
        Ok(self)
    }
}

impl Effect for LayerVelocity {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.ln_factor == 0.0 {
            return;
        }
        let mut top = 0.0;
        for layer in &mut profile.layers {
            let middle = top + 0.5 * layer.thickness_m;
            if (self.top_m..self.bottom_m).contains(&middle) {
                layer.vs_m_s *= self.ln_factor.exp(); // (1)
            }
            top += layer.thickness_m;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::{Features, Layer, Rayleigh, Vertical};

    fn profile() -> Profile {
        let layer = Layer {
            thickness_m: 2.0,
            density_kg_m3: 1900.0,
            vs_m_s: 150.0,
            k0: 0.5,
            law_kind: "elastic".into(),
            law: toml::Table::new(),
        };
        Profile {
            layers: vec![layer.clone(), layer],
            water_table_m: 1e6,
            vertical: Vertical::Free,
            rayleigh: Rayleigh::default(),
            elements: 10,
            features: Features::default(),
        }
    }

    #[test]
    fn zero_strength_is_identical_and_only_the_range_changes() {
        let declared = profile();
        let mut edited = profile();
        LayerVelocity { ln_factor: 0.0, top_m: 0.0, bottom_m: 9.0 }.edit(&mut edited, &Situation::default());
        assert_eq!(edited, declared);
        LayerVelocity { ln_factor: 0.1, top_m: 2.0, bottom_m: 4.0 }.edit(&mut edited, &Situation::default());
        assert_eq!(edited.layers[0].vs_m_s, 150.0);
        assert!((edited.layers[1].vs_m_s - 150.0 * 0.1f64.exp()).abs() < 1e-12);
    }
}
