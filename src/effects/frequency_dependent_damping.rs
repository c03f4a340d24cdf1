//! Damping that the declared column lacks, of Rayleigh form.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "frequency_dependent_damping",
    about: "mass- and stiffness-proportional damping beyond the declared one",
    build: |table| Ok(Box::new(registry::params::<FrequencyDependentDamping>(table)?.checked()?)),
    schema: || schemars::schema_for!(FrequencyDependentDamping),
    catalogue: Catalogue {
        number: 4,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances: |_| {
            let free = PARAMETERS.iter().map(|p| Free::new(p, 0.0));
            free.map(|f| Instance::new(ENTRY.name, [], vec![f])).collect()
        },
        confused_with: &["small_strain_damping", "instrument_low_pass"],
        key: "the misfit of the second mode over that of the first",
    },
};

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "beta_s",
        unit: "s",
        zero: Some(0.0),
        low: 0.0,
        high: 0.01,
        scale: Scale::Linear,
        prior_sd: 0.002,
        draw: [0.001, 0.003],
        is_signed: false,
    },
    Parameter {
        name: "alpha_1_s",
        unit: "1/s",
        zero: Some(0.0),
        low: 0.0,
        high: 5.0,
        scale: Scale::Linear,
        prior_sd: 0.7,
        draw: [0.4, 1.5],
        is_signed: false,
    },
];

/// Adds Rayleigh damping to the column.
///
/// ```text
/// ξ(f) = α / (4 π f) + β π f + b f / f_r,   f_r = 5 Hz                  (1)
/// ```
///
/// | symbol | field       | unit | range  |
/// |--------|-------------|------|--------|
/// | α      | `alpha_1_s` | 1/s  | 0…20   |
/// | β      | `beta_s`    | s    | 0…0.05 |
/// | b      | `slope`     | –    | 0…0.5  |
///
/// b is β by another name: the damping ratio it adds at f_r.
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
    #[serde(default)]
    slope: f64,
}

/// f_r of (1), Hz.
const REFERENCE_HZ: f64 = 5.0;

impl FrequencyDependentDamping {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("alpha_1_s", self.alpha_1_s, 0.0, 20.0, "1/s"),
            ("beta_s", self.beta_s, 0.0, 0.05, "s"),
            ("slope", self.slope, 0.0, 0.5, ""),
        ])?;
        Ok(self)
    }
}

impl Effect for FrequencyDependentDamping {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        profile.rayleigh.alpha_1_s += self.alpha_1_s;
        profile.rayleigh.beta_s += self.beta_s + self.slope / (std::f64::consts::PI * REFERENCE_HZ); // (1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slope_is_the_damping_ratio_added_at_five_hertz() {
        let edited = |table: &str| {
            let effect = (ENTRY.build)(table.parse().expect("TOML")).expect("in range");
            let mut profile = Profile::plain(Vec::new());
            effect.edit(&mut profile, &Situation::default());
            profile.rayleigh
        };
        let beta_s = edited("slope = 0.03").beta_s;
        assert!((std::f64::consts::PI * 5.0 * beta_s - 0.03).abs() < 1e-15);
        assert_eq!(edited("slope = 0.0"), Default::default());
    }
}
