//! Rock below the array that yields: the input sensor sees a mixture of outcrop and within motion.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "compliant_base",
    about: "a half-space below the column carries waves away; the input is its outcrop motion",
    phrases: &["the base carries waves away, its impedance ratio {impedance_ratio}"],
    build: |table| Ok(Box::new(registry::params::<CompliantBase>(table)?.checked()?)),
    schema: || schemars::schema_for!(CompliantBase),
    catalogue: Catalogue {
        number: 8,
        class: Class::Boundary,
        parameters: PARAMETERS,
        instances: |_| vec![Instance::new(ENTRY.name, [], vec![Free::new(&PARAMETERS[0], 0.2)])],
        confused_with: &["small_strain_damping", "frequency_dependent_damping", "sensor_gain"],
        key: "a common factor for all sensors: the ratios between output sensors stay right",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "impedance_ratio",
    unit: "",
    zero: Some(0.0),
    low: 0.0,
    high: 1.5,
    scale: Scale::Linear,
    prior_sd: 0.3,
    draw: [0.15, 0.6],
    is_signed: false,
}];

/// Puts the column on a half-space.
///
/// ```text
/// u_base + q τ_base / (iω ρV) = u_in,   ρV of the deepest layer           (1)
/// ```
///
/// | symbol | field             | unit | range |
/// |--------|-------------------|------|-------|
/// | q      | `impedance_ratio` | –    | 0…10  |
///
/// q is the impedance of the deepest layer over that of the half-space: 0 is rigid rock, 1 no contrast at all.
///
/// Limits: as [`crate::column`] states for a compliant base: vertical incidence, the base fixed vertically.
/// Check:  `tests/verification/boundaries.rs` against the exact solution.
/// Source: Joyner & Chen (1975), doi 10.1785/BSSA0650051315.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct CompliantBase {
    /// Impedance ratio q; zero is a rigid base.
    impedance_ratio: f64,
}

impl CompliantBase {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("impedance_ratio", self.impedance_ratio, 0.0, 10.0, "")])?;
        Ok(self)
    }
}

impl Effect for CompliantBase {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        profile.features.base_impedance_ratio += self.impedance_ratio; // (1)
    }
}
