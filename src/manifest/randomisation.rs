//! `[randomisation]`: a realisation of a site, its velocities, curves and damping drawn around what is declared.

use super::{LayerSection, Site};
use crate::effects::kind;
use crate::numerics::random;
use crate::ranges::{Range, Ranged, range};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::{Table, Value};

/// Correlation of ln of the reference strain with ln of the damping: soil that softens at larger strains dissipates less.
///
/// Source: Darendeli (2001), Development of a new family of normalized modulus reduction and material damping curves, which models of
/// modulus and damping take for −0.5.
const STRAIN_AND_DAMPING: f64 = -0.5;
/// Depth over which the time-averaged velocity tells the class of a site, m.
const CLASS_DEPTH_M: f64 = 30.0;

/// A realisation of the declared site.
///
/// ```text
/// ln Vs_i = ln V_i + σ Z_i,   Z_i = ρ Z_{i−1} + √(1 − ρ²) ε_i                                                        (1)
/// ρ = (1 − ρ_d) ρ₀ exp(−t/Δ) + ρ_d,   ρ_d = ρ₂₀₀ (d/200 m)^b,   ρ₂₀₀ below 200 m                                         (2)
/// ```
///
/// V is declared, d the mean depth of the middles of two neighbouring layers and t the distance of these. ε is standard normal, drawn again
/// until |Z| is at most `truncation_sd`. The reference strain of all laws and the small-strain damping get one factor each, lognormal and
/// correlated by −0.5; a law that has none of either refuses it.
///
/// Source: Toro (1995), Probabilistic models of site velocity profiles for generic and site-specific ground-motion amplification studies,
///         for (1), (2) and the values of the classes; thicknesses stay as declared.
/// Check:  `velocities_have_the_deviation_and_the_correlation_of_the_class`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Randomisation {
    /// Which realisation it is.
    pub seed: u64,
    /// Kind of site by which velocities vary: `usgs_a` to `usgs_d`, `geomatrix_ab` or `geomatrix_cd`; without one that of the mean
    /// velocity of the upper 30 m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site_class: Option<SiteClass>,
    /// Standard deviation of ln of the velocities; without one that of the class.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vs_sd_ln: Option<f64>,
    /// Standard deviation of ln of the reference strain of the curves.
    #[serde(default)]
    pub reference_strain_sd_ln: f64,
    /// Standard deviation of ln of the damping at small strains.
    #[serde(default)]
    pub damping_sd_ln: f64,
    /// Farthest from what is declared, standard deviations.
    #[serde(default = "default_truncation_sd")]
    pub truncation_sd: f64,
}

fn default_truncation_sd() -> f64 {
    2.0
}

impl Ranged for Randomisation {
    const RANGES: &'static [Range<Self>] = &[
        Range {
            key: "vs_sd_ln",
            unit: "",
            ends: [0.0, 1.0],
            is_list: false,
            values: |of| of.vs_sd_ln.into_iter().collect(),
        },
        range!(reference_strain_sd_ln, "", 0.0, 1.0),
        range!(damping_sd_ln, "", 0.0, 1.0),
        range!(truncation_sd, "", 0.5, 6.0),
    ];
}

/// Kind of site, by the mean velocity of its upper 30 m (USGS) or by its ground (Geomatrix).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SiteClass {
    /// Above 750 m/s.
    UsgsA,
    /// 360 to 750 m/s.
    UsgsB,
    /// 180 to 360 m/s.
    UsgsC,
    /// Below 180 m/s.
    UsgsD,
    /// Rock and shallow soil.
    GeomatrixAb,
    /// Deep soil.
    GeomatrixCd,
}

/// How velocities of a class vary; see (1) and (2) of [`Randomisation`].
struct Variation {
    sd_ln: f64,
    rho_0: f64,
    delta_m: f64,
    rho_200: f64,
    b: f64,
}

impl SiteClass {
    /// Of the declared layers; the last one goes on below the column.
    fn of(layers: &[LayerSection]) -> Self {
        let (mut left_m, mut time_s) = (CLASS_DEPTH_M, 0.0);
        for (i, layer) in layers.iter().enumerate() {
            let is_last = i + 1 == layers.len();
            let thickness_m = if is_last { left_m } else { layer.thickness_m.min(left_m) };
            time_s += thickness_m / layer.vs_m_s;
            left_m -= thickness_m;
        }
        match CLASS_DEPTH_M / time_s {
            v if v > 750.0 => Self::UsgsA,
            v if v > 360.0 => Self::UsgsB,
            v if v > 180.0 => Self::UsgsC,
            _ => Self::UsgsD,
        }
    }

    fn variation(self) -> Variation {
        let of = |[sd_ln, rho_0, delta_m, rho_200, b]: [f64; 5]| Variation { sd_ln, rho_0, delta_m, rho_200, b };
        of(match self {
            Self::UsgsA => [0.36, 0.95, 3.4, 0.42, 0.063],
            Self::UsgsB => [0.27, 0.97, 3.8, 1.00, 0.293],
            Self::UsgsC => [0.31, 0.99, 3.9, 0.98, 0.344],
            Self::UsgsD => [0.37, 0.00, 5.0, 0.50, 0.744],
            Self::GeomatrixAb => [0.46, 0.96, 13.1, 0.96, 0.095],
            Self::GeomatrixCd => [0.38, 0.99, 8.0, 1.00, 0.160],
        })
    }
}

impl Variation {
    /// (2) for two neighbouring layers by the depths of their middles.
    fn correlation(&self, [upper_m, lower_m]: [f64; 2]) -> f64 {
        let of_depth = self.rho_200 * (0.5 * (upper_m + lower_m) / 200.0).min(1.0).powf(self.b);
        (1.0 - of_depth) * self.rho_0 * (-(lower_m - upper_m) / self.delta_m).exp() + of_depth
    }
}

impl Randomisation {
    /// The realisation of `site`, which no longer says that it is one.
    pub(super) fn realised(&self, mut site: Site) -> Site {
        site.randomisation = None;
        let variation = self.site_class.unwrap_or_else(|| SiteClass::of(&site.site.layer)).variation();
        let sd_ln = self.vs_sd_ln.unwrap_or(variation.sd_ln);
        let mut stream = random::stream(self.seed, "velocities of a realisation");
        let (mut top_m, mut above): (f64, Option<[f64; 2]>) = (0.0, None);
        for layer in &mut site.site.layer {
            let middle_m = top_m + 0.5 * layer.thickness_m;
            let [above_z, rho] = above.map_or([0.0; 2], |[z, m]| [z, variation.correlation([m, middle_m])]);
            let z = self.drawn(&mut stream, above_z, rho);
            layer.vs_m_s *= (sd_ln * z).exp();
            above = Some([z, middle_m]);
            top_m += layer.thickness_m;
        }
        let mut stream = random::stream(self.seed, "curves of a realisation");
        let strain = self.drawn(&mut stream, 0.0, 0.0);
        let damping = self.drawn(&mut stream, strain, STRAIN_AND_DAMPING);
        let effect = |kind: &str, parameter: &str, value: f64| -> Table {
            Table::from_iter([("kind".to_string(), Value::from(kind)), (parameter.to_string(), value.into())])
        };
        let mut drawn = Vec::new();
        if self.reference_strain_sd_ln > 0.0 {
            drawn.push(effect(kind::NONLINEARITY, "ln_gamma_ref", self.reference_strain_sd_ln * strain));
        }
        if self.damping_sd_ln > 0.0 {
            drawn.push(effect(kind::SMALL_STRAIN_DAMPING, "multiplier", (self.damping_sd_ln * damping).exp()));
        }
        // What is drawn is the ground that declared effects act on.
        site.effects.splice(0..0, drawn);
        site
    }

    /// A standard normal number with the correlation `rho` to the number `other`, as far out as is admissible.
    fn drawn(&self, stream: &mut impl Rng, other: f64, rho: f64) -> f64 {
        loop {
            let normal: f64 = StandardNormal.sample(stream);
            let z = rho * other + (1.0 - rho * rho).max(0.0).sqrt() * normal;
            if z.abs() <= self.truncation_sd {
                return z;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Manifest;
    use super::*;
    use crate::metrics::pearson;
    use std::path::Path;

    fn smoke(overrides: &[&str]) -> Result<Manifest, String> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/smoke.toml");
        let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
        Manifest::load(&path, &overrides).map_err(|e| e.to_string())
    }

    #[test]
    fn velocities_have_the_deviation_and_the_correlation_of_the_class() {
        let declared = smoke(&[]).expect("a site").site;
        let randomisation = |seed| Randomisation {
            seed,
            site_class: Some(SiteClass::UsgsC),
            vs_sd_ln: None,
            reference_strain_sd_ln: 0.0,
            damping_sd_ln: 0.0,
            truncation_sd: 6.0,
        };
        let ln = |seed: u64| -> Vec<f64> {
            let realised = randomisation(seed).realised(declared.clone());
            let pairs = realised.site.layer.iter().zip(&declared.site.layer);
            pairs.map(|(a, b)| (a.vs_m_s / b.vs_m_s).ln()).collect()
        };
        let all: Vec<Vec<f64>> = (0..4000).map(ln).collect();
        let of_layer = |i: usize| -> Vec<f64> { all.iter().map(|ln| ln[i]).collect() };
        let count = declared.site.layer.len();
        assert!(count > 1);
        for i in 0..count {
            let (ln, n) = (of_layer(i), all.len() as f64);
            let sd = (ln.iter().map(|x| x * x).sum::<f64>() / n).sqrt();
            // Four standard errors.
            assert!((sd / 0.31 - 1.0).abs() < 4.0 / (2.0 * n).sqrt(), "layer {i}: {sd}");
            let mean = ln.iter().sum::<f64>() / n;
            assert!(mean.abs() < 4.0 * 0.31 / n.sqrt(), "layer {i}: {mean}");
        }
        let layers = &declared.site.layer;
        let middles = [0.5 * layers[0].thickness_m, layers[0].thickness_m + 0.5 * layers[1].thickness_m];
        let rho = SiteClass::UsgsC.variation().correlation(middles);
        let found = pearson(&of_layer(0), &of_layer(1));
        assert!((found - rho).abs() < 4.0 * (1.0 - rho * rho) / (all.len() as f64).sqrt(), "{found}, {rho}");
    }

    #[test]
    fn a_realisation_is_a_plain_site_and_the_same_for_its_seed() {
        let of = |seed: u64, more: &[&str]| {
            let seed = format!("randomisation.seed={seed}");
            let manifest = smoke(&[&[seed.as_str()], more].concat()).expect("a site");
            assert_eq!(manifest.site.randomisation, None);
            manifest.canonical().expect("a table").to_string()
        };
        let more = ["randomisation.damping_sd_ln=0.2"];
        assert_eq!(of(3, &more), of(3, &more));
        assert_ne!(of(3, &more), of(4, &more));
        assert!(of(3, &more).contains("small_strain_damping") && !of(3, &[]).contains("small_strain_damping"));
        let still = of(3, &["randomisation.vs_sd_ln=0.0"]);
        assert_eq!(still, smoke(&[]).expect("a site").canonical().expect("a table").to_string());
    }

    #[test]
    fn what_is_drawn_stays_within_its_truncation_and_what_cannot_be_is_refused() {
        let declared = smoke(&[]).expect("a site").site;
        for seed in 0..200 {
            let seed = format!("randomisation.seed={seed}");
            let near =
                smoke(&[&seed, "randomisation.vs_sd_ln=0.1", "randomisation.truncation_sd=1.0"]).expect("a site");
            let pairs = near.site.site.layer.iter().zip(&declared.site.layer);
            assert!(pairs.map(|(a, b)| (a.vs_m_s / b.vs_m_s).ln()).all(|ln| ln.abs() <= 0.1 + 1e-12));
        }
        let elastic = "law.sand={kind = 'elastic', damping_ratio = 0.02}";
        let refused = |more: &str| smoke(&["randomisation.seed=1", elastic, more]).expect_err("refused");
        assert!(refused("randomisation.vs_sd_ln=3.0").contains("`vs_sd_ln` must be in 0…1"));
        assert!(refused("randomisation.site_class='usgs_e'").contains("usgs_d"));
        let strain = refused("randomisation.reference_strain_sd_ln=0.3");
        assert!(strain.contains("nonlinearity") && strain.contains("randomisation"), "{strain}");
    }
}
