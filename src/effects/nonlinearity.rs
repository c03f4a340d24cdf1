//! Soil that softens at smaller or larger strains than declared.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Laws, Parameter, Scale, Situation, layers};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use crate::soil::CAM_CLAY_M;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "nonlinearity",
    about: "the strain at which the soil softens is smaller or larger than declared",
    phrases: &["the reference strain of {place} is {ln_gamma_ref|smaller|larger}"],
    build: |table| Ok(Box::new(registry::params::<Nonlinearity>(table)?.checked()?)),
    schema: || schemars::schema_for!(Nonlinearity),
    catalogue: Catalogue {
        number: 5,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances: |array| {
            let whole = || Instance::new(ENTRY.name, [], vec![Free::new(&PARAMETERS[0], 0.0)]);
            array.has_law(&LAWS_WITH_STRENGTH).then(whole).into_iter().collect()
        },
        confused_with: &["pore_pressure", "ageing", "rate_dependence", "interface_slip"],
        key: "apparent velocity falls with the strength of the motion, not with its order",
    },
};

/// Laws with a parameter that takes (1).
const LAWS_WITH_STRENGTH: [&str; 4] = ["hyperbolic", "sanisand", "cam_clay", "mohr_coulomb"];

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "ln_gamma_ref",
    unit: "",
    zero: Some(0.0),
    low: -2.0,
    high: 2.0,
    scale: Scale::Linear,
    prior_sd: 0.4,
    draw: [0.6, 1.1],
    is_signed: true,
}];

/// Scales the reference strain of the backbone: that of each law's equivalent parameter.
///
/// ```text
/// γ_r → γ_r · exp(ln_gamma_ref)                                         (1)
/// ```
///
/// | law            | parameter that takes the factor | why |
/// |----------------|---------------------------------|-----|
/// | `hyperbolic`   | `gamma_ref_multiplier`          | it is (1) |
/// | `sanisand`     | `h_0`                           | plastic strain at a stress ratio goes with 1/h₀ while α ≪ α^b |
/// | `cam_clay`     | `m`                             | strength over stiffness goes with M |
/// | `mohr_coulomb` | `cohesion_kpa`, tan of `friction_angle_deg` | strength over stiffness goes with both |
/// | `elastic`      | none, refused                   | there is no reference strain |
///
/// | symbol       | field              | unit | range |
/// |--------------|--------------------|------|-------|
/// | ln_gamma_ref | `ln_gamma_ref`     | –    | −3…3  |
/// | depth range  | `top_m`, `bottom_m`| m    | ≥ 0   |
///
/// Limits: friction angles stop at 60°, M at 0.3 and 2.5, and dilation stays below friction; a strength below the geostatic stress is
/// refused by the law.
/// Check:  `the_secant_modulus_is_the_same_at_a_strain_larger_by_the_factor` (within 12 % for all laws).
/// Source: Darendeli (2001) for γ_r; Dafalias & Manzari (2004) for the role of h₀.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Nonlinearity {
    /// ln of the factor on the reference strain.
    ln_gamma_ref: f64,
    /// Top of the depth range, m.
    #[serde(default)]
    top_m: f64,
    /// Bottom of the depth range, m; the base where it is absent.
    #[serde(default = "super::bottomless")]
    bottom_m: f64,
}

impl Nonlinearity {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("ln_gamma_ref", self.ln_gamma_ref, -3.0, 3.0, "")])?;
        super::depth_range(self.top_m, self.bottom_m)?;
        Ok(self)
    }
}

impl Effect for Nonlinearity {
    fn laws(&self) -> Option<Laws> {
        let Self { top_m, bottom_m, .. } = *self;
        Some(Laws { kinds: LAWS_WITH_STRENGTH.to_vec(), what: "a reference strain", top_m, bottom_m })
    }

    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.ln_gamma_ref == 0.0 {
            return;
        }
        let factor = self.ln_gamma_ref.exp(); // (1)
        for layer in layers::between(profile, self.top_m, self.bottom_m) {
            match layer.law_kind.as_str() {
                "hyperbolic" => layers::scale(layer, "gamma_ref_multiplier", 1.0, factor),
                "sanisand" => layers::scale(layer, "h_0", 6.0, factor),
                "cam_clay" => {
                    let m = layers::number(layer, "m", 1.2);
                    layers::set(layer, "m", (factor * m).clamp(CAM_CLAY_M[0], CAM_CLAY_M[1]));
                }
                "mohr_coulomb" => {
                    layers::scale(layer, "cohesion_kpa", 1.0, factor);
                    let tangent = layers::number(layer, "friction_angle_deg", 35.0).to_radians().tan();
                    let friction_deg = (factor * tangent).atan().to_degrees().clamp(1.0, 60.0);
                    let dilation_deg = layers::number(layer, "dilation_angle_deg", 5.0).min(friction_deg);
                    layers::set(layer, "friction_angle_deg", friction_deg);
                    layers::set(layer, "dilation_angle_deg", dilation_deg);
                }
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::layers::tests::profile;
    use crate::soil::{Increment, LAWS, Point};

    /// Secant modulus over the first one at strain `gamma`, sheared from the geostatic state at constant volume.
    fn secant_ratio(kind: &str, ln_gamma_ref: f64, gamma: f64) -> f64 {
        let mut profile = profile(kind);
        Nonlinearity { ln_gamma_ref, top_m: 0.0, bottom_m: 1e4 }.edit(&mut profile, &Situation::default());
        let law = (registry::find("law", LAWS, kind).unwrap().build)(profile.layers[0].law.as_ref().clone()).unwrap();
        let (depth_m, density_kg_m3, vs_m_s) = (6.0, 1900.0, 150.0);
        let point = Point { depth_m, density_kg_m3, vs_m_s, vertical_pa: 6e4, horizontal_pa: 4e4 };
        let mut state = vec![0.0; law.n_state()];
        let first = law.start(&point, &mut state).unwrap()[0];
        let mut tau = 0.0;
        for _ in 0..2000 {
            let mut next = state.clone();
            let step = Increment::new(gamma / 2000.0, 0.0);
            tau = law.update(step, &state, &mut next).unwrap().tau_pa;
            state = next;
        }
        tau / gamma / first
    }

    #[test]
    fn the_secant_modulus_is_the_same_at_a_strain_larger_by_the_factor() {
        for kind in ["hyperbolic", "sanisand", "cam_clay", "mohr_coulomb"] {
            for gamma in [1e-3, 2e-3] {
                let declared = secant_ratio(kind, 0.0, gamma);
                let scaled = secant_ratio(kind, 0.4, gamma * 0.4f64.exp());
                assert!(declared < 0.9, "{kind}: {declared}");
                assert!((scaled / declared - 1.0).abs() < 0.12, "{kind} at {gamma}: {scaled} {declared}");
            }
        }
        assert_eq!(secant_ratio("elastic", 0.4, 1e-3), secant_ratio("elastic", 0.0, 1e-3));
    }
}
