//! The declared column as plain data: layers, water, base, damping. Effects edit it.

use super::Features;
use crate::ranges::{Range, Ranged, problem, range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Deepest water table, m: below every base.
const DEEPEST_WATER_M: f64 = 1e6;

/// A soil profile and how it is meshed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// Layers, surface down.
    pub layers: Vec<Layer>,
    /// Depth of the water table below the surface, m.
    pub water_table_m: f64,
    /// Vertical motion above the base.
    pub vertical: Vertical,
    /// Rayleigh damping of the whole column beside what the laws ask for.
    #[serde(default)]
    pub rayleigh: Rayleigh,
    /// Number of elements, distributed over the layers by thickness times fineness; layer boundaries are kept.
    pub elements: usize,
    /// What a plain layered column on a rigid base does not have.
    #[serde(default)]
    pub features: Features,
}

/// One soil layer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Thickness, m.
    pub thickness_m: f64,
    /// Mass density of the wet soil, kg/m³.
    pub density_kg_m3: f64,
    /// Shear-wave velocity, m/s.
    pub vs_m_s: f64,
    /// Coefficient of earth pressure at rest K₀.
    pub k0: f64,
    /// Elements in a metre of this layer over those in a metre of a layer with 1.
    #[serde(default = "uniform", skip_serializing_if = "is_uniform")]
    pub fineness: f64,
    /// Kind of the law, a name of `flare-pipe list laws`.
    pub law_kind: String,
    /// Parameters of the law, per-layer ones merged in; shared between edited profiles, of which a diagnosis makes many.
    #[schemars(with = "std::collections::BTreeMap<String, serde_json::Value>")]
    pub law: Arc<toml::Table>,
}

impl Ranged for Layer {
    const RANGES: &'static [Range<Self>] = &[
        range!(thickness_m, "m", 0.01, 2000.0),
        range!(density_kg_m3, "kg/m³", 1050.0, 3500.0),
        range!(vs_m_s, "m/s", 20.0, 5000.0),
        range!(k0, "", 0.1, 3.0),
        range!(fineness, "", 0.01, 100.0),
    ];
}

/// The fineness of a layer that says nothing of it.
pub(crate) fn uniform() -> f64 {
    1.0
}

/// Whether a layer need not say its fineness.
pub(crate) fn is_uniform(fineness: &f64) -> bool {
    *fineness == uniform()
}

#[cfg(test)]
impl Layer {
    /// A layer with K₀ = 0.5 whose law is left to its defaults.
    pub(crate) fn plain(law_kind: &str, thickness_m: f64, density_kg_m3: f64, vs_m_s: f64) -> Self {
        Self {
            thickness_m,
            density_kg_m3,
            vs_m_s,
            k0: 0.5,
            fineness: 1.0,
            law_kind: law_kind.into(),
            law: Arc::default(),
        }
    }
}

#[cfg(test)]
impl Profile {
    /// Undamped layers below a table at the surface, an element each, with nothing beside them.
    pub(crate) fn plain(layers: Vec<Layer>) -> Self {
        Self {
            elements: layers.len().max(1),
            layers,
            water_table_m: 0.0,
            vertical: Vertical::default(),
            rayleigh: Rayleigh::default(),
            features: Features::default(),
        }
    }
}

/// Vertical motion above the base.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Vertical {
    /// Free above the base.
    #[default]
    Free,
    /// Restrained everywhere: shear strain only.
    Restrained,
}

/// Rayleigh damping α·M + β·K with the elastic stiffness of the geostatic state.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Rayleigh {
    /// Mass-proportional coefficient α, 1/s.
    pub alpha_1_s: f64,
    /// Stiffness-proportional coefficient β, s.
    pub beta_s: f64,
}

impl Ranged for Rayleigh {
    const RANGES: &'static [Range<Self>] = &[range!(alpha_1_s, "1/s", 0.0, 100.0), range!(beta_s, "s", 0.0, 0.1)];
}

impl Rayleigh {
    /// Damping with this ratio at two angular frequencies, rad/s.
    ///
    /// ```text
    /// α = 2 ξ ω₁ω₂/(ω₁ + ω₂),   β = 2 ξ/(ω₁ + ω₂)
    /// ```
    ///
    /// Source: Chopra (2012), Dynamics of Structures, 4th ed., eq. 11.4.10.
    pub fn of_ratio(ratio: f64, [low, high]: [f64; 2]) -> Self {
        Self { alpha_1_s: 2.0 * ratio * low * high / (low + high), beta_s: 2.0 * ratio / (low + high) }
    }
}

impl Profile {
    /// Depth of the base, m.
    pub fn depth_m(&self) -> f64 {
        self.layers.iter().map(|l| l.thickness_m).sum()
    }

    /// The layer at `depth_m`, the last one below all; none without layers.
    pub fn layer_at(&self, depth_m: f64) -> Option<&Layer> {
        let mut bottom_m = 0.0;
        let is_below = |layer: &&Layer| {
            bottom_m += layer.thickness_m;
            depth_m < bottom_m
        };
        self.layers.iter().find(is_below).or(self.layers.last())
    }

    /// Time that a shear wave takes from the base to the surface, s.
    pub fn travel_time_s(&self) -> f64 {
        self.layers.iter().map(|l| l.thickness_m / l.vs_m_s).sum()
    }

    /// Fundamental frequency of a column of one velocity with this travel time, Hz.
    pub fn fundamental_hz(&self) -> f64 {
        0.25 / self.travel_time_s()
    }

    /// Share of the elements that each layer is to have, as far as their number allows.
    pub fn shares(&self) -> Vec<f64> {
        let weights: Vec<f64> = self.layers.iter().map(|l| l.thickness_m * l.fineness).collect();
        let sum: f64 = weights.iter().sum();
        weights.into_iter().map(|w| w / sum).collect()
    }

    /// What is out of range, as (key, sentence).
    pub fn problems(&self) -> Vec<(String, String)> {
        let below = |place: String, found: Vec<(String, String)>| {
            found.into_iter().map(move |(key, what)| (format!("{place}.{key}"), what))
        };
        let layers = self.layers.iter().enumerate();
        let mut problems: Vec<(String, String)> =
            layers.flat_map(|(i, layer)| below(format!("layer[{}]", i + 1), layer.beyond())).collect();
        problems.extend(problem("water_table_m", [0.0, DEEPEST_WATER_M], "m", self.water_table_m));
        problems.extend(below("rayleigh".into(), self.rayleigh.beyond()));
        if self.layers.is_empty() {
            problems.push(("layer".into(), "must stand at least once, surface down".into()));
        }
        if self.elements < self.layers.len() || self.elements > 100_000 {
            let range = format!("{}…100000 (at least one per layer)", self.layers.len());
            problems.push(("elements".into(), format!("must be in {range}, got {}", self.elements)));
        }
        problems.extend(self.features.problems(self.depth_m()));
        problems
    }
}
