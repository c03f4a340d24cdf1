//! The finite-element soil column: mesh, geostatic state, assembly, damping, time stepping, pore water.
//!
//! Plane strain, one element across with both sides tied: each elevation has a horizontal and a vertical displacement, each
//! element one integration point. Stresses are measured from the geostatic state, which is in equilibrium by construction.

mod analysis;
mod dynamics;
mod failure;
mod mesh;
mod profile;

pub use analysis::Analysis;
pub use dynamics::{Frame, RunSummary};
pub use failure::{Cause, Failure};
pub use mesh::{Column, LayerRemark};
pub use profile::{Layer, Profile, Rayleigh, Vertical};
