//! A structure that stands beside the array and shakes the ground it stands on.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::{Profile, Structure};
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "structure_interaction",
    about: "a structure on the surface: an oscillator with its weight",
    phrases: &["a structure of {mass_t_m2} at {frequency_hz} stands on the surface"],
    build: |table| Ok(Box::new(registry::params::<StructureInteraction>(table)?.checked()?)),
    schema: || schemars::schema_for!(StructureInteraction),
    catalogue: Catalogue {
        number: 9,
        class: Class::Boundary,
        parameters: PARAMETERS,
        instances: |_| {
            let at = |hz: &f64| {
                let free = vec![Free::new(&PARAMETERS[0], 0.5), Free::new(&PARAMETERS[1], *hz)];
                Instance::new(ENTRY.name, [("damping", 0.07.into())], free)
            };
            [1.3, 1.7, 2.2, 2.8, 3.5, 4.5, 5.8, 7.5].iter().map(at).collect()
        },
        confused_with: &["layer_velocity", "stiff_crust", "thin_seam", "small_strain_damping"],
        key: "a narrow band that fades with depth, in weak and strong events alike",
    },
};

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "mass_t_m2",
        unit: "t/m²",
        zero: Some(0.0),
        low: 0.0,
        high: 20.0,
        scale: Scale::Linear,
        prior_sd: 4.0,
        draw: [2.0, 8.0],
        is_signed: false,
    },
    Parameter {
        name: "frequency_hz",
        unit: "Hz",
        zero: None,
        low: 0.8,
        high: 9.0,
        scale: Scale::Log,
        prior_sd: 0.5,
        draw: [1.5, 6.0],
        is_signed: false,
    },
    Parameter {
        name: "damping",
        unit: "",
        zero: None,
        low: 0.01,
        high: 0.3,
        scale: Scale::Log,
        prior_sd: 0.5,
        draw: [0.04, 0.12],
        is_signed: false,
    },
];

/// Puts a single-degree-of-freedom structure on the surface; the equations are [`Structure`]'s.
///
/// | symbol | field          | unit | range   |
/// |--------|----------------|------|---------|
/// | m      | `mass_t_m2`    | t/m² | 0…50    |
/// | f_s    | `frequency_hz` | Hz   | 0.1…50  |
/// | ζ      | `damping`      | –    | 0…0.5   |
///
/// Its weight m g enters the geostatic state, so soil without confinement is not asked to carry inertia alone. Where laws
/// take their stiffness from the velocity profile, that profile is the one under the structure.
///
/// Limits: one structure; of several, the last holds. As wide as the site.
/// Check:  `tests/verification/boundaries.rs` against the exact transfer function; SANISAND columns under it finish.
/// Source: the quarter-scale containments beside the Lotung array; Tang, Tang & Stepp (1990) on their response.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct StructureInteraction {
    /// Mass per area m, t/m²; zero is no structure.
    mass_t_m2: f64,
    /// Fixed-base frequency f_s, Hz.
    frequency_hz: f64,
    /// Damping ratio ζ.
    #[serde(default = "usual_damping")]
    damping: f64,
}

fn usual_damping() -> f64 {
    0.07
}

impl StructureInteraction {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("mass_t_m2", self.mass_t_m2, 0.0, 50.0, "t/m²"),
            ("frequency_hz", self.frequency_hz, 0.1, 50.0, "Hz"),
            ("damping", self.damping, 0.0, 0.5, ""),
        ])?;
        Ok(self)
    }
}

impl Effect for StructureInteraction {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.mass_t_m2 > 0.0 {
            profile.features.structure = Structure {
                mass_kg_m2: 1e3 * self.mass_t_m2,
                frequency_hz: self.frequency_hz,
                damping_ratio: self.damping,
            };
        }
    }
}
