//! Which effect does the declared model lack? One parameter space, one weighting of residuals, one competition: the method of the diagnosis
//! for measured records and those of other programs (`[diagnose] method = "competition"`, the default). The search of
//! [`crate::diagnosis`] is for twins that this program makes.
//!
//! Declared values that may be off within their tolerances and effects of a catalogue are parameters with priors (`parameters`). What is
//! expected of residuals (noise, a field that is partly incoherent, a column that is not exact) is read off the records beside the model
//! that leaves least and is one for all models (`weights`), so that a fit is nonlinear least squares (`posterior`) and models compete by
//! their evidence (`competition`). Values and slopes are replays of the column (`forward`); what other programs make of the same column is
//! no effect (`convention`). The answer says what is named and what remains (`answer`).
//!
//! ```text
//! records ─► spread (coherence, level) ─► weights ─► fits of models ─► evidence ─► best model ─► spread …  until it stands still
//! ```

mod algebra;
mod answer;
mod competition;
mod convention;
mod covariance;
mod few;
mod forward;
mod intervals;
#[cfg(test)]
mod made_up;
mod parameters;
mod posterior;
mod weights;

pub use answer::diagnose;
