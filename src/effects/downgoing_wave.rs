//! A wave that comes back from the surface less coherent than it went up: the input sensor sees less interference than one dimension has.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "downgoing_wave",
    about: "the down-going wave at the input sensor has lost coherence: it interferes less with the up-going one than in one dimension",
    phrases: &["the down-going wave at the input sensor loses coherence above {corner_hz}"],
    build: |table| Ok(Box::new(registry::params::<DowngoingWave>(table)?.checked()?)),
    schema: || schemars::schema_for!(DowngoingWave),
    catalogue: Catalogue {
        number: 33,
        class: Class::Boundary,
        parameters: PARAMETERS,
        instances: |_| vec![Instance::new(ENTRY.name, [], vec![Free::new(&PARAMETERS[0], f64::INFINITY)])],
        confused_with: &["small_strain_damping", "frequency_dependent_damping", "compliant_base"],
        key: "peaks of surface over base are lower, and what lies between them is not",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "corner_hz",
    unit: "Hz",
    zero: Some(f64::INFINITY),
    low: 0.3,
    high: f64::INFINITY,
    scale: Scale::Inverse,
    prior_sd: 0.2,
    draw: [1.5, 5.0],
    is_signed: false,
}];

/// Up-going and down-going wave at the input sensor add up as waves of the coherence C do.
///
/// ```text
/// C(f) = 1 / (1 + (f/f_c)²)                                             (1)
/// ```
///
/// | symbol | field       | unit | range |
/// |--------|-------------|------|-------|
/// | f_c    | `corner_hz` | Hz   | 0.2…∞ |
///
/// What is recorded there is then made the motion of the base by [`crate::column::Downgoing`] before it shakes the column: at the
/// frequencies at which the base of the column would stand still, what is recorded is mostly what strays.
///
/// Limits: those of the motion of the base: a column at small strains; the same coherence in all events.
/// Check:  `tests/verification/boundaries.rs` against the exact solution.
/// Source: Steidl, Tumarkin and Archuleta (1996), What is a reference site?, BSSA 86, 1733–1748; the form of (1), with one parameter, is
/// a choice.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct DowngoingWave {
    /// Corner of the coherence, Hz; `inf` is full coherence.
    corner_hz: f64,
}

impl DowngoingWave {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("corner_hz", self.corner_hz, 0.2, f64::INFINITY, "Hz")])?;
        Ok(self)
    }
}

impl Effect for DowngoingWave {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.corner_hz.is_finite() {
            profile.features.downgoing_corner_hz = self.corner_hz; // (1)
        }
    }
}
