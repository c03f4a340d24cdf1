//! Constitutive laws: one law a file, registered in [`LAWS`].
//!
//! A [`Law`] is a set of parameters; placed at a [`Point`] of the profile it becomes a [`Material`], an immutable value
//! that maps a committed state and a strain increment to a trial state, stresses and a tangent. The column owns the
//! states: accepting a step is one copy, cutting it another.
//!
//! Stresses here are effective, in Pa, **tension positive** like the strains: `σ_yy` and `ε_yy` are vertical, `τ` and `γ`
//! horizontal shear; ε_xx = ε_zz = 0.

mod elastic;
mod hyperbolic;
mod sanisand;

use crate::error::Result;
use crate::registry::{self, Entry};

/// All laws, by the `kind` of a `[law.NAME]` table.
pub const LAWS: &[Entry<dyn Law>] = &[elastic::ENTRY, hyperbolic::ENTRY, sanisand::ENTRY];

/// Where a material point lies and how it starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Depth below the surface, m.
    pub depth_m: f64,
    /// Total mass density, kg/m³.
    pub density_kg_m3: f64,
    /// Small-strain shear-wave velocity, m/s.
    pub vs_m_s: f64,
    /// Vertical effective stress after the geostatic step, compression positive, Pa.
    pub vertical_effective_stress_pa: f64,
    /// Horizontal over vertical effective stress.
    pub k0: f64,
}

impl Point {
    /// Small-strain shear modulus ρ Vs², Pa.
    pub fn shear_modulus_pa(&self) -> f64 {
        self.density_kg_m3 * self.vs_m_s * self.vs_m_s
    }

    /// Mean effective stress, compression positive, Pa.
    pub fn mean_effective_stress_pa(&self) -> f64 {
        self.vertical_effective_stress_pa * (1.0 + 2.0 * self.k0) / 3.0
    }
}

/// Strain increment of a column element since the committed state, tension positive.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Increment {
    /// Engineering shear strain ∂u/∂z.
    pub gamma: f64,
    /// Vertical normal strain ∂w/∂z.
    pub epsilon_yy: f64,
}

/// Effective stresses and their derivatives after an increment.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Response {
    /// Shear stress, Pa.
    pub tau_pa: f64,
    /// Vertical effective stress less the geostatic one, tension positive, Pa.
    pub sigma_yy_pa: f64,
    /// ∂(τ, σ_yy)/∂(γ, ε_yy), Pa, row by row.
    pub tangent_pa: [[f64; 2]; 2],
}

/// Why a law could not follow an increment; the time step is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// More substeps than the law allows itself.
    TooManySubsteps,
    /// The mean effective stress, residual pressure included, vanished.
    NoConfinement,
    /// A number stopped being finite.
    NotFinite,
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::TooManySubsteps => "the law needs more substeps than it allows",
            Self::NoConfinement => "the mean effective stress vanished",
            Self::NotFinite => "the law gave a value that is not finite",
        })
    }
}

/// Parameters of a constitutive law.
pub trait Law: Send + Sync {
    /// The law at one point of the profile.
    ///
    /// # Errors
    /// When the point lies outside what the law can represent.
    fn at(&self, point: &Point) -> Result<Box<dyn Material>>;
}

/// A law at one point: immutable; its memory is a slice that the column owns.
pub trait Material: Send + Sync {
    /// Length of the state.
    fn n_state(&self) -> usize;

    /// Writes the geostatic state.
    fn initial(&self, state: &mut [f64]);

    /// Follows `increment` from `committed` into `trial`.
    ///
    /// # Errors
    /// When the increment is too large for the law; the caller halves it.
    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal>;

    /// Tangent at the geostatic state, Pa.
    fn initial_tangent_pa(&self) -> [[f64; 2]; 2];

    /// Small-strain damping that the law's own hysteresis does not supply, as a fraction of critical.
    fn small_strain_damping(&self) -> f64 {
        0.0
    }

    /// Void ratio that sets how much pore water there is.
    fn void_ratio(&self) -> f64;

    /// Bulk modulus of the pore water, Pa.
    fn water_bulk_modulus_pa(&self) -> f64 {
        WATER_BULK_MODULUS_PA
    }

    /// What is worth printing beside a layer ("G0 = 301.2").
    fn remark(&self) -> Option<String> {
        None
    }
}

/// Bulk modulus of water, Pa.
pub const WATER_BULK_MODULUS_PA: f64 = 2.2e9;

/// Builds the law of `kind` with parameters `table`.
///
/// # Errors
/// When the kind is unknown or a parameter missing, unknown or out of range.
pub fn build(kind: &str, table: &toml::Table) -> Result<Box<dyn Law>> {
    (registry::find("soil law", LAWS, kind)?.build)(table.clone())
}
