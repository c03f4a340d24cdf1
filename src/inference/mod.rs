//! Which effect does the declared model lack? One parameter space, one weighting of residuals, one competition.
//!
//! Declared values that may be off within their tolerances and effects of a catalogue are parameters with priors (`parameters`). What is
//! expected of residuals (noise, a field that is partly incoherent, a column that is not exact) is read off the records beside the model
//! that leaves least (`spread`, `coherence`) and is one for all models (`weights`), so that a fit is nonlinear least squares (`posterior`)
//! and models compete by their evidence (`competition`). Values are those of replays of the column (`forward`); how they change, and what
//! candidates do, is looked at by the equivalent-linear column, tuned to a replay (`equivalent`) and corrected by what it lacked where
//! replays told, as far as it foretells them. What other programs make of the same column is no effect (`convention`). The answer says what
//! is named and what remains (`answer`).
//!
//! ```text
//! records ─► spread (coherence, level) ─► weights ─► fits of models ─► evidence ─► best model ─► spread …  until it stands still
//! ```

mod algebra;
mod answer;
mod coherence;
mod competition;
mod convention;
mod correlation;
mod covariance;
mod density;
mod depth_modes;
mod equivalent;
mod forward;
mod intervals;
#[cfg(test)]
mod made_up;
#[doc = include_str!("measured.md")]
pub mod measured {}
mod parameters;
mod posterior;
mod power;
mod recalibration;
mod spread;
mod weights;

pub use answer::diagnose;
pub use power::{Confusion, Power, Sensitivity, power};
pub use recalibration::recalibrate;
