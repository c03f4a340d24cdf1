//! Shear builds up less or more pore pressure than the declared law says.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Laws, Parameter, Scale, Situation, layers};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "contractancy",
    about: "shear builds up less or more pore pressure than the declared law says",
    phrases: &["shear of {place} contracts {ln_factor|less|more} than declared"],
    build: |table| Ok(Box::new(registry::params::<Contractancy>(table)?.checked()?)),
    schema: || schemars::schema_for!(Contractancy),
    catalogue: Catalogue {
        number: 28,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances: |array| {
            let whole = || Instance::new(ENTRY.name, [], vec![Free::new(&PARAMETERS[0], 0.0)]);
            array.has_law(&LAWS_THAT_CONTRACT).then(whole).into_iter().collect()
        },
        confused_with: &["nonlinearity", "pore_pressure", "water_table"],
        key: "pore pressures, or how much softer the ground is after the strong phase, in the strongest events alone",
    },
};

/// Laws with a contraction of their own that a parameter scales.
const LAWS_THAT_CONTRACT: [&str; 1] = ["sanisand"];

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "ln_factor",
    unit: "",
    zero: Some(0.0),
    low: -2.5,
    high: 1.5,
    scale: Scale::Linear,
    prior_sd: 0.6,
    draw: [0.6, 1.2],
    is_signed: true,
}];

/// Scales the contraction of laws that build up pore pressure by shear; dilation stays.
///
/// ```text
/// D → D · exp(ln_factor)   where D > 0                                  (1)
/// ```
///
/// | law        | parameter                | why |
/// |------------|--------------------------|-----|
/// | `sanisand` | `contraction_multiplier` | it is (1) |
/// | `cam_clay` | refused                  | its contraction follows from its yield surface: it has no parameter of its own |
/// | `mohr_coulomb`, `hyperbolic`, `elastic` | refused | none of them contracts; see `pore_pressure` |
///
/// | symbol      | field              | unit | range |
/// |-------------|--------------------|------|-------|
/// | ln_factor   | `ln_factor`        | –    | −5…2  |
/// | depth range | `top_m`, `bottom_m`| m    | ≥ 0   |
///
/// Limits: drained layers settle less or more instead; below the water table alone it is a pore pressure.
/// Check:  `an_undrained_cycle_builds_up_less_or_more_pore_pressure`.
/// Source: Dafalias & Manzari (2004), equation of the dilatancy; its published set was fitted to Toyoura sand.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Contractancy {
    /// ln of the factor on contraction.
    ln_factor: f64,
    /// Top of the depth range, m.
    #[serde(default)]
    top_m: f64,
    /// Bottom of the depth range, m; the base where it is absent.
    #[serde(default = "super::bottomless")]
    bottom_m: f64,
}

impl Contractancy {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("ln_factor", self.ln_factor, -5.0, 2.0, "")])?;
        super::depth_range(self.top_m, self.bottom_m)?;
        Ok(self)
    }
}

impl Effect for Contractancy {
    fn laws(&self) -> Option<Laws> {
        let Self { top_m, bottom_m, .. } = *self;
        Some(Laws { kinds: LAWS_THAT_CONTRACT.to_vec(), what: "a contraction of its own", top_m, bottom_m })
    }

    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.ln_factor == 0.0 {
            return;
        }
        let contracting = layers::between(profile, self.top_m, self.bottom_m)
            .filter(|layer| LAWS_THAT_CONTRACT.contains(&layer.law_kind.as_str()));
        for layer in contracting {
            layers::scale(layer, "contraction_multiplier", 1.0, self.ln_factor.exp()); // (1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::layers::tests::profile;
    use crate::soil::{Increment, LAWS, Point};

    /// Share of the vertical effective stress lost in one undrained cycle of small strain.
    fn lost(ln_factor: f64) -> f64 {
        let mut profile = profile("sanisand");
        Contractancy { ln_factor, top_m: 0.0, bottom_m: 1e4 }.edit(&mut profile, &Situation::default());
        let table = profile.layers[0].law.as_ref().clone();
        let law = (registry::find("law", LAWS, "sanisand").unwrap().build)(table).unwrap();
        let (density_kg_m3, vs_m_s) = (1900.0, 150.0);
        let point = Point { depth_m: 6.0, density_kg_m3, vs_m_s, vertical_pa: 6e4, horizontal_pa: 4e4 };
        let mut state = vec![0.0; law.n_state()];
        law.start(&point, &mut state).unwrap();
        let (mut last, mut sigma) = (0.0, -6e4);
        for k in 1..=400 {
            let gamma = 2e-4 * (std::f64::consts::TAU * f64::from(k) / 400.0).sin();
            let mut next = state.clone();
            sigma = law.update(Increment::new(gamma - last, 0.0), &state, &mut next).unwrap().sigma_yy_pa;
            (state, last) = (next, gamma);
        }
        1.0 + sigma / 6e4
    }

    #[test]
    fn an_undrained_cycle_builds_up_less_or_more_pore_pressure() {
        let [less, declared, more] = [-1.0, 0.0, 0.5].map(lost);
        println!("lost in a cycle: {less:.4}, {declared:.4}, {more:.4}");
        assert!(declared > 0.005);
        // Less than in proportion: the shear that is left over from less contraction meets stiffer sand.
        assert!((0.3..0.6).contains(&(less / declared)) && (1.3..1.8).contains(&(more / declared)));
    }
}
