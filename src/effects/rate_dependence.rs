//! Strength that grows with the rate of strain.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Laws, Parameter, Scale, Situation};
use crate::column::{Profile, RateZone};
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "rate_dependence",
    about: "clay is stronger at the strain rates of an earthquake than in the laboratory",
    phrases: &["strength grows by a share of {per_log_cycle} for a rate ten times as high"],
    build: |table| Ok(Box::new(registry::params::<RateDependence>(table)?.checked()?)),
    schema: || schemars::schema_for!(RateDependence),
    catalogue: Catalogue {
        number: 27,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances: |array| {
            let clay = ["cam_clay", "hyperbolic"].into_iter().filter(|kind| array.has_law(&[kind]));
            clay.map(|kind| Instance::new(ENTRY.name, [("law", kind.into())], vec![Free::new(&PARAMETERS[0], 0.05)]))
                .collect()
        },
        confused_with: &["nonlinearity", "interface_slip"],
        key: "the declared model clips the strongest and fastest motions too early",
    },
};

/// Laws with a strength.
const LAWS_WITH_STRENGTH: [&str; 4] = ["hyperbolic", "mohr_coulomb", "cam_clay", "sanisand"];

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "per_log_cycle",
    unit: "",
    zero: Some(0.0),
    low: 0.0,
    high: 0.3,
    scale: Scale::Linear,
    prior_sd: 0.07,
    draw: [0.05, 0.15],
    is_signed: false,
}];

/// Makes the shear strength of a material grow with the strain rate; the equations are [`crate::soil::Rate`]'s.
///
/// | symbol | field               | unit | range |
/// |--------|---------------------|------|-------|
/// | β      | `per_log_cycle`     | –    | 0…0.5 |
/// | where  | `law`               | –    | a kind of law; all with a strength where absent |
/// | range  | `top_m`, `bottom_m` | m    | element centres |
///
/// Limits: those of the rate dependence: small-strain stiffness and pore pressure do not depend on the rate.
/// Check:  `tests/verification/around_a_law.rs`: strengths at rates a decade apart in closed form.
/// Source: Afacan, Brandenberg & Stewart (2014), doi 10.1061/(ASCE)GT.1943-5606.0001000.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct RateDependence {
    /// Gain of strength β per tenfold rate; zero is none.
    per_log_cycle: f64,
    /// Kind of the law of the layers it holds for.
    #[serde(default)]
    law: Option<String>,
    /// Top of the range, m.
    #[serde(default)]
    top_m: f64,
    /// Bottom of the range, m.
    #[serde(default = "super::bottomless")]
    bottom_m: f64,
}

impl RateDependence {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("per_log_cycle", self.per_log_cycle, 0.0, 0.5, ""),
            ("top_m", self.top_m, 0.0, 1e4, "m"),
            ("bottom_m", self.bottom_m, self.top_m, 1e4, "m"),
        ])?;
        if let Some(kind) = &self.law {
            registry::find("soil law", crate::soil::LAWS, kind)?;
        }
        Ok(self)
    }
}

impl Effect for RateDependence {
    fn laws(&self) -> Option<Laws> {
        let Self { top_m, bottom_m, .. } = *self;
        let is_meant = |kind: &&str| self.law.as_deref().is_none_or(|own| own == *kind);
        let kinds = LAWS_WITH_STRENGTH.into_iter().filter(is_meant).collect();
        Some(Laws { kinds, what: "a strength that grows", top_m, bottom_m })
    }

    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.per_log_cycle > 0.0 {
            profile.features.rates.push(RateZone {
                top_m: self.top_m,
                bottom_m: self.bottom_m,
                law_kind: self.law.clone(),
                per_log_cycle: self.per_log_cycle,
            });
        }
    }
}
