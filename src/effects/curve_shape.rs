//! Modulus and damping curves of another shape than declared.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Laws, Parameter, Scale, Situation, layers};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "curve_shape",
    about: "modulus and damping curves bend more or less, or enclose more or less, than declared",
    phrases: &[
        "the curves of {place} bend {ln_curvature|less|more} and their loops enclose {ln_hysteresis|less|more} than declared",
        "the curves of {place} bend {ln_curvature|less|more} than declared",
        "the loops of {place} enclose {ln_hysteresis|less|more} than declared",
    ],
    build: |table| Ok(Box::new(registry::params::<CurveShape>(table)?.checked()?)),
    schema: || schemars::schema_for!(CurveShape),
    catalogue: Catalogue {
        number: 29,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances: |array| {
            let each = PARAMETERS.iter().map(|p| Instance::new(ENTRY.name, [], vec![Free::new(p, 0.0)]));
            each.filter(|_| array.has_law(&LAWS_WITH_CURVES)).collect()
        },
        confused_with: &["nonlinearity", "small_strain_damping", "pore_pressure"],
        key: "softening and damping of weak, middling and strong events against each other",
    },
};

/// Laws whose curves have a shape of their own.
const LAWS_WITH_CURVES: [&str; 1] = ["hyperbolic"];
/// Curvatures that the law takes.
const CURVATURES: [f64; 2] = [0.5, 1.5];
/// Factors on hysteretic damping that the law takes.
const FACTORS: [f64; 2] = [0.05, 3.0];

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "ln_curvature",
        unit: "",
        zero: Some(0.0),
        low: -0.6,
        high: 0.48,
        scale: Scale::Linear,
        prior_sd: 0.15,
        draw: [0.15, 0.3],
        is_signed: true,
    },
    Parameter {
        name: "ln_hysteresis",
        unit: "",
        zero: Some(0.0),
        low: -1.5,
        high: 0.6,
        scale: Scale::Linear,
        prior_sd: 0.3,
        draw: [0.3, 0.5],
        is_signed: true,
    },
];

/// Bends the backbone and scales the damping of its loops, at unchanged modulus and reference strain.
///
/// ```text
/// s → s · exp(ln_curvature),  within 0.5…1.5                            (1)
/// F → F · exp(ln_hysteresis)                                            (2)
/// ```
///
/// | law          | parameters                            | why |
/// |--------------|---------------------------------------|-----|
/// | `hyperbolic` | `curvature`, `hysteresis_multiplier`  | they are (1) and (2) |
/// | others       | refused                               | their curves follow from plasticity, which other effects change |
///
/// With (1) the secant modulus at the reference strain stays G/2; below it falls less, above it more for larger s.
///
/// | symbol        | field               | unit | range   |
/// |---------------|---------------------|------|---------|
/// | ln_curvature  | `ln_curvature`      | –    | −1…1    |
/// | ln_hysteresis | `ln_hysteresis`     | –    | −2.5…1  |
/// | depth range   | `top_m`, `bottom_m` | m    | ≥ 0     |
///
/// Limits: one factor for all strains; loops with more than Masing's damping (F > 1) are not excluded.
/// Check:  `the_secant_modulus_pivots_at_the_reference_strain_and_loops_enclose_the_factor`.
/// Source: Darendeli (2001) for the scatter of a and b; Phillips & Hashash (2009), doi 10.1016/j.soildyn.2008.12.004.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct CurveShape {
    /// ln of the factor on the curvature of the backbone.
    #[serde(default)]
    ln_curvature: f64,
    /// ln of the factor on the damping of its loops.
    #[serde(default)]
    ln_hysteresis: f64,
    /// Top of the depth range, m.
    #[serde(default)]
    top_m: f64,
    /// Bottom of the depth range, m; the base where it is absent.
    #[serde(default = "super::bottomless")]
    bottom_m: f64,
}

impl CurveShape {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("ln_curvature", self.ln_curvature, -1.0, 1.0, ""),
            ("ln_hysteresis", self.ln_hysteresis, -2.5, 1.0, ""),
        ])?;
        super::depth_range(self.top_m, self.bottom_m)?;
        Ok(self)
    }
}

impl Effect for CurveShape {
    fn laws(&self) -> Option<Laws> {
        let Self { top_m, bottom_m, .. } = *self;
        Some(Laws { kinds: LAWS_WITH_CURVES.to_vec(), what: "curves of a declared shape", top_m, bottom_m })
    }

    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.ln_curvature == 0.0 && self.ln_hysteresis == 0.0 {
            return;
        }
        let curved = layers::between(profile, self.top_m, self.bottom_m)
            .filter(|layer| LAWS_WITH_CURVES.contains(&layer.law_kind.as_str()));
        for layer in curved {
            if self.ln_curvature != 0.0 {
                let curvature = layers::number(layer, "curvature", 0.919) * self.ln_curvature.exp(); // (1)
                layers::set(layer, "curvature", curvature.clamp(CURVATURES[0], CURVATURES[1]));
            }
            if self.ln_hysteresis != 0.0 {
                let factor = layers::number(layer, "hysteresis_multiplier", 1.0) * self.ln_hysteresis.exp(); // (2)
                layers::set(layer, "hysteresis_multiplier", factor.clamp(FACTORS[0], FACTORS[1]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::Vertical;
    use crate::effects::layers::tests::profile;
    use crate::equivalent_linear::Curve;
    use crate::soil::{LAWS, Point};

    /// (G/G₀, D) at `gamma`, the reference strain 1e-3.
    fn at(ln_curvature: f64, ln_hysteresis: f64, gamma: f64) -> (f64, f64) {
        let mut profile = profile("hyperbolic");
        layers::set(&mut profile.layers[0], "gamma_ref", 1e-3);
        let effect = CurveShape { ln_curvature, ln_hysteresis, top_m: 0.0, bottom_m: 1e4 };
        effect.edit(&mut profile, &Situation::default());
        let table = profile.layers[0].law.as_ref().clone();
        let law = (registry::find("law", LAWS, "hyperbolic").unwrap().build)(table).unwrap();
        let (density_kg_m3, vs_m_s) = (1900.0, 150.0);
        let point = Point { depth_m: 6.0, density_kg_m3, vs_m_s, vertical_pa: 6e4, horizontal_pa: 4e4 };
        Curve::of(law, &point, 0.0, Vertical::Free).at(gamma)
    }

    #[test]
    fn the_secant_modulus_pivots_at_the_reference_strain_and_loops_enclose_the_factor() {
        let (bent, declared) = (|gamma| at(0.3, 0.0, gamma).0, |gamma| at(0.0, 0.0, gamma).0);
        assert!((bent(1e-3) / declared(1e-3) - 1.0).abs() < 0.05, "{} {}", bent(1e-3), declared(1e-3));
        assert!(bent(1e-4) > 1.03 * declared(1e-4) && bent(1e-2) < 0.8 * declared(1e-2));
        for gamma in [3e-4, 1e-3, 3e-3] {
            let ((modulus, damping), (as_declared, less)) = (at(0.0, 0.0, gamma), at(0.0, -0.4, gamma));
            assert!((less / damping / (-0.4f64).exp() - 1.0).abs() < 0.03, "{less} {damping}");
            assert!((modulus / as_declared - 1.0).abs() < 0.03);
        }
    }
}
