//! A crust at the surface that the declared profile does not have.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation, layers};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "stiff_crust",
    about: "a stiff crust or fill at the surface that the profile does not show",
    phrases: &["a crust {thickness_m} thick with a Vs of {vs_m_s} covers the profile"],
    build: |table| Ok(Box::new(registry::params::<StiffCrust>(table)?.checked()?)),
    schema: || schemars::schema_for!(StiffCrust),
    catalogue: Catalogue {
        number: 25,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances,
        confused_with: &["layer_velocity", "sensor_gain", "structure_interaction", "thin_seam"],
        key: "more high frequencies at the surface, nothing at the sensors below",
    },
};

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "thickness_m",
        unit: "m",
        zero: Some(0.0),
        low: 0.0,
        high: 3.0,
        scale: Scale::Linear,
        prior_sd: 1.0,
        draw: [0.5, 2.0],
        is_signed: false,
    },
    Parameter {
        name: "vs_m_s",
        unit: "m/s",
        zero: None,
        low: 60.0,
        high: 1000.0,
        scale: Scale::Log,
        prior_sd: 0.5,
        draw: [250.0, 500.0],
        is_signed: false,
    },
];

/// One instance, started at twice the declared velocity of the surface.
fn instances(array: &Array) -> Vec<Instance> {
    let vs_m_s = 2.0 * array.profile.layers.first().map_or(100.0, |l| l.vs_m_s);
    vec![Instance::new(ENTRY.name, [], vec![Free::new(&PARAMETERS[0], 0.0), Free::new(&PARAMETERS[1], vs_m_s)])]
}

/// Gives the top of the column one velocity.
///
/// ```text
/// Vs = Vs_c   for z < h_c                                               (1)
/// ```
///
/// | symbol | field         | unit | range   |
/// |--------|---------------|------|---------|
/// | h_c    | `thickness_m` | m    | 0…50    |
/// | Vs_c   | `vs_m_s`      | m/s  | 30…3000 |
///
/// Limits: density and law stay those of the layers below; a crust thinner than 2 cm is none.
/// Check:  `only_the_crust_changes`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct StiffCrust {
    /// Thickness, m.
    thickness_m: f64,
    /// Shear-wave velocity, m/s.
    vs_m_s: f64,
}

impl StiffCrust {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("thickness_m", self.thickness_m, 0.0, 50.0, "m"),
            ("vs_m_s", self.vs_m_s, 30.0, 3000.0, "m/s"),
        ])?;
        Ok(self)
    }
}

impl Effect for StiffCrust {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.thickness_m == 0.0 {
            return;
        }
        for layer in layers::between(profile, 0.0, self.thickness_m) {
            layer.vs_m_s = self.vs_m_s; // (1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::layers::tests::profile;

    #[test]
    fn only_the_crust_changes() {
        let mut profile = profile("elastic");
        StiffCrust { thickness_m: 0.5, vs_m_s: 300.0 }.edit(&mut profile, &Situation::default());
        let seen: Vec<_> = profile.layers.iter().map(|l| (l.thickness_m, l.vs_m_s)).collect();
        assert_eq!(seen, [(0.5, 300.0), (1.5, 150.0), (2.0, 150.0)]);
    }
}
