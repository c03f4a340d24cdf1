//! Damping whose dependence on frequency is not the declared one.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation, layers};
use crate::column::{Layer, Profile};
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The name of its kind.
pub const FREQUENCY_DEPENDENT_DAMPING: &str = "frequency_dependent_damping";

pub(super) const ENTRY: Entry = Entry {
    name: FREQUENCY_DEPENDENT_DAMPING,
    about: "damping grows or falls with frequency: Rayleigh damping beyond the declared one, or a power of the frequency",
    phrases: &[
        "damping falls with frequency, by {alpha_1_s} of Rayleigh's α more than declared",
        "damping grows with frequency, by {beta_s} of Rayleigh's β more than declared",
        "damping of {place} goes with frequency to the power of {exponent}",
        "the frequencies at which Rayleigh damping is as declared are {ln_shift|lower|higher}",
    ],
    build: |table| Ok(Box::new(registry::params::<FrequencyDependentDamping>(table)?.checked()?)),
    schema: || schemars::schema_for!(FrequencyDependentDamping),
    catalogue: Catalogue {
        number: 4,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances,
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
    Parameter {
        name: "exponent",
        unit: "",
        zero: Some(0.0),
        low: -EXPONENT,
        high: EXPONENT,
        scale: Scale::Linear,
        prior_sd: 0.2,
        draw: [0.25, 0.5],
        is_signed: true,
    },
    Parameter {
        name: "ln_shift",
        unit: "",
        zero: Some(0.0),
        low: -3.0,
        high: 3.0,
        scale: Scale::Linear,
        prior_sd: 0.5,
        draw: [0.5, 1.0],
        is_signed: true,
    },
];

/// Largest power that the memory of a law follows.
const EXPONENT: f64 = 0.6;
/// Laws whose small-strain damping is memory of their stress, ξ₀ (f/f_r)ⁿ.
const LAWS_WITH_MEMORY: [&str; 2] = ["elastic", "hyperbolic"];

/// Each coefficient for the whole column; the exponent where there is small-strain damping that has one, also for each range that the
/// records can tell apart. Where Rayleigh damping meets its ratios is a choice of a program and no effect of a site.
fn instances(array: &Array) -> Vec<Instance> {
    let of = |p: &'static Parameter, range: Option<[f64; 2]>| {
        let free = vec![Free::new(p, 0.0)];
        match range {
            Some(range) => Instance::between(ENTRY.name, range, free),
            None => Instance::new(ENTRY.name, [], free),
        }
    };
    let has_exponent = |range: [f64; 2]| has_memory_between(&array.profile, range);
    let depth_m = array.profile.depth_m();
    let is_part = |[top_m, bottom_m]: &[f64; 2]| *top_m > 0.0 || *bottom_m < depth_m;
    let parts = layers::ranges_m(array).into_iter().filter(is_part).filter(|range| has_exponent(*range));
    let ranges_of = |p: &Parameter| match p.name {
        "exponent" if has_exponent([0.0, depth_m]) => std::iter::once(None).chain(parts.clone().map(Some)).collect(),
        "exponent" | "ln_shift" => Vec::new(),
        _ => vec![None],
    };
    PARAMETERS.iter().flat_map(|p| ranges_of(p).into_iter().map(move |range| of(p, range))).collect()
}

/// Whether the layer's small-strain damping can depend on frequency: it is memory, and not declared to be none.
fn has_memory(layer: &Layer) -> bool {
    let undeclared = if layer.law_kind == "hyperbolic" { f64::MIN_POSITIVE } else { 0.0 };
    LAWS_WITH_MEMORY.contains(&layer.law_kind.as_str()) && layers::number(layer, "damping_ratio", undeclared) > 0.0
}

/// Whether a layer between two depths, m, has such damping.
fn has_memory_between(profile: &Profile, [top_m, bottom_m]: [f64; 2]) -> bool {
    layers::between(&mut profile.clone(), top_m, bottom_m).any(|layer| has_memory(layer))
}

/// Adds Rayleigh damping to the column, and makes the small-strain damping of a depth range a power of the frequency.
///
/// ```text
/// ξ(f) = ξ₀ (1 − r) (f/f_0)ⁿ + α / (4 π f) + β π f + b f / f_r,   f_0 = 3 Hz, f_r = 5 Hz            (1)
/// ```
///
/// ξ₀ (f/f_0)ⁿ is that of laws whose damping is memory of their stress (`elastic`, `hyperbolic`); without r and n it is the
/// declared one, which does not depend on frequency unless the law declares an exponent, to which n is added. Rayleigh
/// damping comes on top of any law.
///
/// | symbol | field       | unit | range  |
/// |--------|-------------|------|--------|
/// | α      | `alpha_1_s` | 1/s  | 0…20   |
/// | β      | `beta_s`    | s    | 0…0.05 |
/// | b      | `slope`     | –    | 0…0.5  |
/// | n      | `exponent`  | –    | −0.6…0.6 |
/// | r      | `replaced`  | –    | 0…1    |
/// | ln of a factor on the frequencies at which Rayleigh damping meets its ratios, declared damping included | `ln_shift` | – | −3…3 |
/// | range of r and n | `top_m`, `bottom_m` | m | ≥ 0 |
///
/// b is β by another name: the damping ratio it adds at f_r.
///
/// Limits: α, β and b are the same for every layer; r and n are refused where no layer in the range has such damping, and `ln_shift` where
/// the column has no Rayleigh damping.
/// Check:  the column's transfer function with Rayleigh damping against the exact one; that of memory at its peaks.
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
    /// Exponent n of small-strain damping.
    #[serde(default)]
    exponent: f64,
    /// Share r of its ratio that Rayleigh damping takes the place of.
    #[serde(default)]
    replaced: f64,
    /// ln of the factor on the frequencies at which Rayleigh damping meets its ratios.
    #[serde(default)]
    ln_shift: f64,
    /// Top of the range of exponent and share, m.
    #[serde(default)]
    top_m: f64,
    /// Bottom of that range, m; the base where it is absent.
    #[serde(default = "super::bottomless")]
    bottom_m: f64,
}

/// f_r of (1), Hz.
const REFERENCE_HZ: f64 = 5.0;

impl FrequencyDependentDamping {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("alpha_1_s", self.alpha_1_s, 0.0, 20.0, "1/s"),
            ("beta_s", self.beta_s, 0.0, 0.05, "s"),
            ("slope", self.slope, 0.0, 0.5, ""),
            ("exponent", self.exponent, -EXPONENT, EXPONENT, ""),
            ("replaced", self.replaced, 0.0, 1.0, ""),
            ("ln_shift", self.ln_shift, -3.0, 3.0, ""),
        ])?;
        super::depth_range(self.top_m, self.bottom_m)?;
        Ok(self)
    }
}

impl Effect for FrequencyDependentDamping {
    fn refusal(&self, profile: &Profile) -> Option<String> {
        let own = [self.alpha_1_s, self.beta_s, self.slope];
        let declared = [profile.rayleigh.alpha_1_s, profile.rayleigh.beta_s];
        if self.ln_shift != 0.0 && own.iter().chain(&declared).all(|c| *c == 0.0) {
            return Some("`ln_shift` shifts Rayleigh damping, and the column has none".into());
        }
        if self.exponent == 0.0 && self.replaced == 0.0 {
            return None;
        }
        let is_met = has_memory_between(profile, [self.top_m, self.bottom_m]);
        let what = "no layer there has small-strain damping that can be a power of the frequency";
        (!is_met).then(|| format!("{what} (law {}, `damping_ratio` not 0)", LAWS_WITH_MEMORY.join(" or ")))
    }

    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.exponent != 0.0 || self.replaced != 0.0 {
            for layer in layers::between(profile, self.top_m, self.bottom_m).filter(|layer| has_memory(layer)) {
                let exponent = layers::number(layer, "damping_exponent", 0.0) + self.exponent;
                layers::set(layer, "damping_exponent", exponent.clamp(-EXPONENT, EXPONENT));
                if self.replaced != 0.0 {
                    layers::scale_damping(layer, 1.0 - self.replaced);
                }
            }
        }
        profile.rayleigh.alpha_1_s += self.alpha_1_s;
        profile.rayleigh.beta_s += self.beta_s + self.slope / (std::f64::consts::PI * REFERENCE_HZ); // (1)
        profile.rayleigh.alpha_1_s *= self.ln_shift.exp();
        profile.rayleigh.beta_s *= (-self.ln_shift).exp();
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
        // The ratio of 0.02 at 1 and 9 Hz is that at 2 and 18 Hz.
        let at = |f: [f64; 2]| crate::column::Rayleigh::of_ratio(0.02, f.map(|f| std::f64::consts::TAU * f));
        let [from, to] = [at([1.0, 9.0]), at([2.0, 18.0])];
        let shift = std::f64::consts::LN_2;
        let found = edited(&format!("alpha_1_s = {}\nbeta_s = {}\nln_shift = {shift}", from.alpha_1_s, from.beta_s));
        assert!((found.alpha_1_s - to.alpha_1_s).abs() < 1e-12 && (found.beta_s - to.beta_s).abs() < 1e-12);
    }

    #[test]
    fn an_exponent_has_a_place_in_every_range_with_damping_of_its_own() {
        let mut profile = layers::tests::profile("hyperbolic");
        profile.layers[1] = Layer::plain("sanisand", 2.0, 1900.0, 150.0);
        let places = |profile: &Profile, outputs: &[f64]| -> Vec<String> {
            let array = Array {
                profile: profile.clone(),
                input: "base".into(),
                outputs: outputs.iter().map(|z| format!("at {z} m")).collect(),
                depths_m: outputs.to_vec(),
                components: vec!["EW".into()],
            };
            let all = instances(&array).into_iter().filter(|i| i.free[0].parameter.name == "exponent");
            all.map(|i| i.target.to_string().replace('\n', " ")).collect()
        };
        assert_eq!(places(&profile, &[0.0]).len(), 1);
        assert_eq!(places(&profile, &[2.0, 0.0]), ["", "top_m = 0.0 bottom_m = 2.0 "]);
        assert_eq!(places(&layers::tests::profile("hyperbolic"), &[2.0, 0.0]).len(), 3);
        assert!(places(&layers::tests::profile("sanisand"), &[2.0, 0.0]).is_empty());
    }

    #[test]
    fn a_shift_without_rayleigh_damping_is_refused() {
        let refusal = |table: &str, profile: &Profile| {
            (ENTRY.build)(table.parse().expect("TOML")).expect("in range").refusal(profile)
        };
        let mut profile = layers::tests::profile("hyperbolic");
        assert!(refusal("ln_shift = 0.5", &profile).is_some_and(|why| why.contains("ln_shift")));
        assert_eq!(refusal("ln_shift = 0.5\nbeta_s = 0.001", &profile), None);
        profile.rayleigh.beta_s = 0.001;
        assert_eq!(refusal("ln_shift = 0.5", &profile), None);
    }

    #[test]
    fn a_power_of_the_frequency_is_set_in_its_range_for_laws_that_have_one() {
        let build = |table: &str| (ENTRY.build)(table.parse().expect("TOML")).expect("in range");
        let mut profile = layers::tests::profile("hyperbolic");
        build("exponent = 0.3\nreplaced = 0.4\ntop_m = 2.0").edit(&mut profile, &Situation::default());
        let declared = layers::tests::profile("hyperbolic");
        assert_eq!(profile.layers[0], declared.layers[0]);
        assert_eq!(layers::number(&profile.layers[1], "damping_exponent", 0.0), 0.3);
        assert_eq!(layers::number(&profile.layers[1], "damping_multiplier", 1.0), 0.6);
        let refused = |kind: &str| build("exponent = 0.3").refusal(&layers::tests::profile(kind)).is_some();
        assert_eq!(["hyperbolic", "elastic", "sanisand"].map(refused), [false, true, true]);
    }
}
