//! Damping that the declared column lacks, of Rayleigh form.

use super::Effect;
use crate::column::Profile;
use crate::error::{Error, Result};
use crate::registry::{self, Entry};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry<dyn Effect> = Entry {
    name: "frequency_dependent_damping",
    about: "mass- and stiffness-proportional damping beyond the declared one",
    build: |table| Ok(Box::new(registry::params::<FrequencyDependentDamping>(table)?.checked()?)),
    schema: || schemars::schema_for!(FrequencyDependentDamping),
};

/// Adds Rayleigh damping to the column.
///
/// ```text
/// ξ(f) = α / (4 π f) + β π f                                            (1)
/// ```
///
/// | symbol | field       | unit | range  |
/// |--------|-------------|------|--------|
/// | α      | `alpha_1_s` | 1/s  | 0…20   |
/// | β      | `beta_s`    | s    | 0…0.05 |
///
/// Limits: the same for every layer.
/// Check:  the column's transfer function with Rayleigh damping against the exact one.
/// Source: Tao and Rathje (2019) on damping needed at four vertical arrays.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct FrequencyDependentDamping {
    #[serde(default)]
    alpha_1_s: f64,
    #[serde(default)]
    beta_s: f64,
}

impl FrequencyDependentDamping {
    fn checked(self) -> Result<Self> {
        for (name, value, highest, unit) in
            [("alpha_1_s", self.alpha_1_s, 20.0, "1/s"), ("beta_s", self.beta_s, 0.05, "s")]
        {
            if !(0.0..=highest).contains(&value) {
                return Err(Error::new(format!("`{name}` must be in 0…{highest} {unit}, got {value}")).usage());
            }
        }
        Ok(self)
    }
}

impl Effect for FrequencyDependentDamping {
    fn apply(&self, profile: &mut Profile) {
        profile.rayleigh.alpha_1_s += self.alpha_1_s;
        profile.rayleigh.beta_s += self.beta_s;
    }
}
