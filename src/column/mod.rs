//! The finite-element soil column: mesh, geostatic state, assembly, damping, HHT time stepping, pore water.
//!
//! Plane strain, one element across with tied sides: two displacements per elevation (horizontal u, vertical v positive
//! down) and one integration point per element with γ = ∂u/∂z and ε_yy = ∂v/∂z. The column is computed in displacements
//! relative to the base, which for a rigid base is the same equations as total displacement without the drift of an
//! integrated base motion; everything handed out is **absolute** acceleration. Mass-proportional damping acts on the
//! velocity relative to the base. Knows no files.
//!
//! Small-strain damping of `elastic` and `hyperbolic` is memory of their stress ([`crate::soil::Viscoelastic`]) and does not
//! depend on frequency; the other laws' ratio becomes Rayleigh damping at the fundamental frequency and five times that. What
//! `[site.rayleigh]` declares acts beside either.
//!
//! Steps are HHT-α steps of at most `max_step_s`, halved where Newton's iteration or a law asks for it, and where an
//! acceleration front passes ([`Analysis::max_jump`]): soil that unloads stiffer than it loads carries jumps of the
//! acceleration, and an implicit step across many elements overshoots behind them by as much as the jump. Without the
//! control single samples stood out by 1.2 times a channel's peak at depth; with it by less than 0.3, for a tenth to a
//! quarter more steps. Check: `tests/verification/robustness.rs`: no spikes at any depth, independence of mesh and step.
//!
//! On a compliant base ([`Features::base_impedance_ratio`] q > 0) the base is a node of its own, and the motion handed in
//! is the outcrop's: with e^{iωt},
//!
//! ```text
//! u_base + q τ_base / (iω ρV) = u_in,     that is  τ_base = (ρV/q) (u̇_in − u̇_base)              (1)
//! ```
//!
//! a dashpot, ρV that of the deepest layer. Displacements and mass-proportional damping are then relative to the input.
//! Where the down-going wave has lost coherence at the sensor that recorded the motion handed in
//! ([`Features::downgoing_corner_hz`]), that motion is first made one of the base ([`Downgoing`]).
//!
//! Limits: vertical incidence; the base stays fixed vertically. Check: `tests/verification/boundaries.rs` against the
//! exact solution. Source: Lysmer & Kuhlemeyer (1969), doi 10.1061/JMCEA3.0001144.

mod analysis;
mod batch;
mod downgoing;
mod failure;
mod features;
mod linear;
mod mesh;
mod oscillator;
mod profile;
mod run;
mod step;

pub use analysis::{Analysis, MassMatrix};
pub use downgoing::Downgoing;
pub use failure::{Cause, Failure};
pub use features::{Container, Features, MovedBoundary, RateZone, Slip, SofteningZone, Structure};
pub use linear::Slice;
pub use profile::{Layer, Profile, Rayleigh, Vertical};
pub(crate) use profile::{is_uniform, uniform};
pub use run::{BaseMotion, Frame, RunSummary};

use crate::error::Result;
use mesh::Mesh;
use std::sync::Arc;

/// A column ready to be shaken; one value serves all threads.
pub struct Column {
    mesh: Mesh,
    analysis: Analysis,
    downgoing: Option<Arc<Downgoing>>,
}

impl Column {
    /// Meshes `profile`, sets the geostatic state and starts every law from it.
    ///
    /// # Errors
    /// When the profile or a law's parameters are out of range, all problems named.
    pub fn new(profile: &Profile, analysis: &Analysis) -> Result<Self> {
        let problems: Vec<String> = profile
            .problems()
            .into_iter()
            .chain(analysis.problems())
            .map(|(key, what)| format!("`{key}` {what}"))
            .collect();
        if !problems.is_empty() {
            return Err(crate::error::Error::new(problems.join("\n")).usage());
        }
        let (mesh, corner_hz) = (Mesh::new(profile, analysis)?, profile.features.downgoing_corner_hz);
        let downgoing = (corner_hz > 0.0 && corner_hz.is_finite()).then(|| Arc::new(Downgoing::new(&mesh, corner_hz)));
        Ok(Self { mesh, analysis: analysis.clone(), downgoing })
    }

    /// Depths of the element centres, surface down, m.
    pub fn channel_depths_m(&self) -> Vec<f64> {
        self.mesh.elements.iter().map(|e| e.depth_m).collect()
    }

    /// Depths where elements meet, from the surface to the base, m.
    pub fn node_depths_m(&self) -> Vec<f64> {
        let bottoms_m = self.mesh.elements.iter().map(|e| e.depth_m + 0.5 * e.height_m);
        std::iter::once(0.0).chain(bottoms_m).collect()
    }

    /// Vertical effective stress of each element before shaking, Pa, compression positive.
    pub fn vertical_effective_stress_pa(&self) -> Vec<f64> {
        self.mesh.elements.iter().map(|e| e.vertical_pa).collect()
    }

    /// Small-strain shear modulus of each element at the geostatic state, Pa.
    pub fn shear_modulus_pa(&self) -> Vec<f64> {
        self.mesh.elements.iter().map(|e| e.elastic_pa[0]).collect()
    }

    /// Fundamental frequency from the travel time of shear waves, Vs-weighted, Hz.
    pub fn frequency_hz(&self) -> f64 {
        self.mesh.frequency_hz
    }

    /// How an analysis of this column is stepped.
    pub fn analysis(&self) -> &Analysis {
        &self.analysis
    }
}
