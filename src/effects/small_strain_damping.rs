//! Damping at strains where the laws hardly dissipate.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation, layers};
use crate::column::{Layer, Profile};
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// ξ_ref of (2).
const REFERENCE_RATIO: f64 = 0.01;

pub(super) const ENTRY: Entry = Entry {
    name: "small_strain_damping",
    about: "damping at small strains is a multiple of the declared one",
    phrases: &["damping at small strains is {multiplier} times the declared one"],
    build: |table| Ok(Box::new(registry::params::<SmallStrainDamping>(table)?.checked()?)),
    schema: || schemars::schema_for!(SmallStrainDamping),
    catalogue: Catalogue {
        number: 3,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances: |_| vec![Instance::new(ENTRY.name, [], vec![Free::new(&PARAMETERS[0], 1.0)])],
        confused_with: &["frequency_dependent_damping", "compliant_base", "sensor_gain"],
        key: "how late motion decays, in weak events as much as in strong ones",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "multiplier",
    unit: "",
    zero: Some(1.0),
    low: 0.1,
    high: 20.0,
    scale: Scale::Log,
    prior_sd: 0.5,
    draw: [1.7, 3.5],
    is_signed: false,
}];

/// Multiplies small-strain damping: the ratio of each layer's law, and the declared Rayleigh damping.
///
/// ```text
/// ξ → m ξ,  α → m α,  β → m β                                           (1)
/// ξ → max(m − 1, 0) ξ_ref   where neither law nor column declares any    (2)
/// ```
///
/// | symbol | field        | unit | range  |
/// |--------|--------------|------|--------|
/// | m      | `multiplier` | –    | 0.02…50 |
/// | ξ_ref  | [`REFERENCE_RATIO`] | – | 0.01 |
///
/// (2) is for laws such as SANISAND without a `damping_ratio`: nothing is there to be multiplied, so m counts in units of
/// one per cent, about the small-strain damping of sand at shallow depth. The column turns ratios into Rayleigh damping.
///
/// Limits: in (2), m below one is refused: hysteresis at small strains cannot be taken away.
/// Check:  `what_is_declared_is_multiplied_and_what_is_not_gets_a_stated_ratio`.
/// Source: Tao & Rathje (2019) and Pretell et al. (2023) for multipliers of 1.5…5.5; Darendeli (2001) for ξ_ref.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SmallStrainDamping {
    /// Factor m; one is as declared.
    multiplier: f64,
}

impl SmallStrainDamping {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("multiplier", self.multiplier, 0.02, 50.0, "")])?;
        Ok(self)
    }
}

impl Effect for SmallStrainDamping {
    fn refusal(&self, profile: &Profile) -> Option<String> {
        let is_declared = has_rayleigh(profile) || profile.layers.iter().any(has_damping);
        (self.multiplier < 1.0 && !is_declared).then(|| {
            "neither the column nor a layer declares a small-strain damping that could be less; a multiplier above 1 adds one".into()
        })
    }

    fn edit(&self, profile: &mut Profile, _: &Situation) {
        let m = self.multiplier;
        if m == 1.0 {
            return;
        }
        let is_declared = has_rayleigh(profile);
        profile.rayleigh.alpha_1_s *= m; // (1)
        profile.rayleigh.beta_s *= m;
        for layer in &mut profile.layers {
            if has_damping(layer) {
                layers::scale_damping(layer, m);
            } else if !is_declared && m > 1.0 {
                layers::set(layer, "damping_ratio", (m - 1.0) * REFERENCE_RATIO); // (2)
            }
        }
    }
}

/// Whether a layer has small-strain damping of its own.
fn has_damping(layer: &Layer) -> bool {
    layer.law_kind == "hyperbolic" || layers::number(layer, "damping_ratio", 0.0) > 0.0
}

fn has_rayleigh(profile: &Profile) -> bool {
    profile.rayleigh.alpha_1_s > 0.0 || profile.rayleigh.beta_s > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::layers::tests::profile;

    fn edited(kind: &str, ratio: Option<f64>, alpha_1_s: f64, multiplier: f64) -> Profile {
        let mut profile = profile(kind);
        profile.rayleigh.alpha_1_s = alpha_1_s;
        for layer in &mut profile.layers {
            if let Some(ratio) = ratio {
                layers::set(layer, "damping_ratio", ratio);
            }
        }
        SmallStrainDamping { multiplier }.edit(&mut profile, &Situation::default());
        profile
    }

    #[test]
    fn what_is_declared_is_multiplied_and_what_is_not_gets_a_stated_ratio() {
        let ratio = |p: &Profile| layers::number(&p.layers[1], "damping_ratio", 0.0);
        assert_eq!(ratio(&edited("elastic", Some(0.02), 0.0, 2.5)), 0.05);
        assert_eq!(ratio(&edited("sanisand", None, 0.0, 3.0)), 0.02);
        assert_eq!(ratio(&edited("sanisand", None, 0.0, 0.5)), 0.0);
        let rayleigh = edited("mohr_coulomb", None, 0.4, 3.0);
        assert_eq!((ratio(&rayleigh), rayleigh.rayleigh.alpha_1_s), (0.0, 0.4 * 3.0));
        let refused = |kind: &str, multiplier: f64| SmallStrainDamping { multiplier }.refusal(&profile(kind)).is_some();
        assert!(refused("sanisand", 0.5) && !refused("sanisand", 2.0) && !refused("hyperbolic", 0.5));
        let hyperbolic = edited("hyperbolic", None, 0.0, 3.0);
        assert_eq!(layers::number(&hyperbolic.layers[0], "damping_multiplier", 1.0), 3.0);
    }
}
