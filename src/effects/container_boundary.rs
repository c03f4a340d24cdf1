//! A laminar container whose rings move with the soil.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::{Profile, Vertical};
use crate::error::Result;
use crate::registry;
use crate::units::KPA;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "container_boundary",
    about: "a container around the column adds mass and shear stiffness",
    phrases: &[
        "a container adds {mass_kg_m2} of mass and {stiffness_kpa} of stiffness",
        "a container adds {mass_kg_m2} of mass",
        "a container adds {stiffness_kpa} of stiffness",
    ],
    build: |table| Ok(Box::new(registry::params::<ContainerBoundary>(table)?.checked()?)),
    schema: || schemars::schema_for!(ContainerBoundary),
    catalogue: Catalogue {
        number: 26,
        class: Class::Boundary,
        parameters: PARAMETERS,
        // Only a model in a container is restrained sideways and vertically.
        instances: |array| match array.profile.vertical {
            Vertical::Restrained => {
                vec![Instance::new(ENTRY.name, [], PARAMETERS.iter().map(|p| Free::new(p, p.draw[0])).collect())]
            }
            Vertical::Free => Vec::new(),
        },
        confused_with: &["layer_velocity", "small_strain_damping"],
        key: "modes move alike in weak and strong events and in every soil put into the container",
    },
};

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "mass_kg_m2",
        unit: "kg/m²",
        zero: Some(0.0),
        low: 0.0,
        high: 2e4,
        scale: Scale::Linear,
        prior_sd: 5e3,
        draw: [2e3, 1e4],
        is_signed: false,
    },
    Parameter {
        name: "stiffness_kpa",
        unit: "kPa",
        zero: Some(0.0),
        low: 0.0,
        high: 1e4,
        scale: Scale::Linear,
        prior_sd: 2e3,
        draw: [500.0, 4e3],
        is_signed: false,
    },
];

/// Adds a container; the equations are [`crate::column::Container`]'s.
///
/// | symbol | field           | unit  | range  |
/// |--------|-----------------|-------|--------|
/// | m_c    | `mass_kg_m2`    | kg/m² | 0…1e5  |
/// | k_c    | `stiffness_kpa` | kPa   | 0…1e5  |
///
/// Prototype scale: mass per plan area over the whole depth, shear stress per unit of shear strain.
///
/// Limits: no friction between the rings, so its damping does not depend on the amplitude.
/// Check:  `tests/verification/boundaries.rs` against the exact transfer function.
/// Source: Fiegel, Hudson, Idriss, Kutter & Zeng (1994), Centrifuge 94; Afacan, Brandenberg & Stewart (2014).
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct ContainerBoundary {
    /// Mass per plan area m_c, kg/m².
    #[serde(default)]
    mass_kg_m2: f64,
    /// Shear stiffness k_c, kPa.
    #[serde(default)]
    stiffness_kpa: f64,
}

impl ContainerBoundary {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("mass_kg_m2", self.mass_kg_m2, 0.0, 1e5, "kg/m²"),
            ("stiffness_kpa", self.stiffness_kpa, 0.0, 1e5, "kPa"),
        ])?;
        Ok(self)
    }
}

impl Effect for ContainerBoundary {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        profile.features.container.mass_kg_m2 += self.mass_kg_m2;
        profile.features.container.stiffness_pa += self.stiffness_kpa * KPA;
    }
}
