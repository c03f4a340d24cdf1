//! A thin layer that the declared profile does not have.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation, layers};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "thin_seam",
    about: "a thin soft or stiff seam that the profile does not show",
    phrases: &["a seam {place} has a Vs that is {ln_factor|lower|higher}"],
    build: |table| Ok(Box::new(registry::params::<ThinSeam>(table)?.checked()?)),
    schema: || schemars::schema_for!(ThinSeam),
    catalogue: Catalogue {
        number: 2,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances,
        confused_with: &["layer_velocity", "water_table", "sensor_depth", "stiff_crust"],
        key: "second and third mode move more than the first; only thickness over stiffness can be told",
    },
};

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "ln_factor",
        unit: "",
        zero: Some(0.0),
        low: -1.2,
        high: 0.7,
        scale: Scale::Linear,
        prior_sd: 0.5,
        draw: [-0.9, -0.43],
        is_signed: false,
    },
    Parameter {
        name: "depth_m",
        unit: "m",
        zero: None,
        low: 0.0,
        high: 1000.0,
        scale: Scale::Linear,
        prior_sd: 1.0,
        draw: [1.0, 16.0],
        is_signed: false,
    },
    Parameter {
        name: "thickness_m",
        unit: "m",
        zero: None,
        low: 0.1,
        high: 10.0,
        scale: Scale::Log,
        prior_sd: 0.5,
        draw: [0.3, 1.5],
        is_signed: false,
    },
];

/// Seams one below the other over the whole depth, at most sixteen; their depth and thickness are held.
fn instances(array: &Array) -> Vec<Instance> {
    let depth_m = array.profile.depth_m();
    let spacing = (depth_m / 17.0).max(1.0);
    let at = |i: usize| {
        let target = [("depth_m", (i as f64 * spacing).into()), ("thickness_m", spacing.into())];
        Instance::new(ENTRY.name, target, vec![Free::new(&PARAMETERS[0], 0.0)])
    };
    (1..).take_while(|i| (*i as f64 + 0.5) * spacing <= depth_m + 1e-6).map(at).collect()
}

/// Scales the shear-wave velocity of a seam.
///
/// ```text
/// Vs → Vs · exp(ln_factor)   where |z − depth| < thickness/2             (1)
/// ```
///
/// | symbol    | field         | unit | range    |
/// |-----------|---------------|------|----------|
/// | ln_factor | `ln_factor`   | –    | −2…1.5   |
/// | depth     | `depth_m`     | m    | 0…2000   |
/// | thickness | `thickness_m` | m    | 0.05…100 |
///
/// Limits: at wavelengths much above the thickness only thickness/Vs² counts, so that a thinner, softer seam is the same.
/// Check:  `the_seam_is_a_layer_of_its_own`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct ThinSeam {
    /// Depth of its middle, m.
    depth_m: f64,
    /// Thickness, m.
    thickness_m: f64,
    /// ln of the factor on the shear-wave velocity.
    ln_factor: f64,
}

impl ThinSeam {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("ln_factor", self.ln_factor, -2.0, 1.5, ""),
            ("depth_m", self.depth_m, 0.0, 2000.0, "m"),
            ("thickness_m", self.thickness_m, 0.05, 100.0, "m"),
        ])?;
        Ok(self)
    }
}

impl Effect for ThinSeam {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.ln_factor == 0.0 {
            return;
        }
        let [top_m, bottom_m] = [-0.5, 0.5].map(|x| self.depth_m + x * self.thickness_m);
        for layer in layers::between(profile, top_m, bottom_m) {
            layer.vs_m_s *= self.ln_factor.exp(); // (1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::layers::tests::profile;

    #[test]
    fn the_seam_is_a_layer_of_its_own() {
        let mut profile = profile("elastic");
        let seam = ThinSeam { depth_m: 2.0, thickness_m: 0.5, ln_factor: -0.5 };
        seam.edit(&mut profile, &Situation::default());
        let seen: Vec<_> = profile.layers.iter().map(|l| (l.thickness_m, l.vs_m_s)).collect();
        let soft = 150.0 * (-0.5f64).exp();
        assert_eq!(seen, [(1.75, 150.0), (0.25, soft), (0.25, soft), (1.75, 150.0)]);
        assert_eq!(profile.elements, 10);
    }
}
