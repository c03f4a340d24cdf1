//! The set-up of a column as plain data, which effects edit.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Layers, water table, boundary and damping of a column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// Layers from the surface down.
    pub layers: Vec<Layer>,
    /// Depth of the water table, m; `None` for a dry column.
    pub water_table_m: Option<f64>,
    /// Vertical displacement above the base.
    pub vertical: Vertical,
    /// Rayleigh damping of the whole column.
    pub rayleigh: Rayleigh,
    /// Finite elements over the depth.
    pub elements: usize,
}

impl Profile {
    /// Depth of the base, m.
    pub fn depth_m(&self) -> f64 {
        self.layers.iter().map(|l| l.thickness_m).sum()
    }
}

/// One layer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Layer {
    /// Thickness, m.
    pub thickness_m: f64,
    /// Total mass density, kg/m³.
    pub density_kg_m3: f64,
    /// Small-strain shear-wave velocity, m/s.
    pub vs_m_s: f64,
    /// Horizontal over vertical effective stress at rest.
    pub k0: f64,
    /// Kind of the law, a name of [`crate::soil::LAWS`].
    pub law_kind: String,
    /// Parameters of the law in this layer.
    pub law: toml::Table,
}

/// Vertical displacement of the nodes above the base.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Vertical {
    /// Free.
    Free,
    /// Held everywhere: a pure shear column.
    Restrained,
}

/// Rayleigh damping α M + β K. K is the stiffness at the geostatic state, M acts on the velocity relative to the base, so
/// that a rigid translation is not damped.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Rayleigh {
    /// α in 1/s.
    pub alpha_1_s: f64,
    /// β in s.
    pub beta_s: f64,
}
