//! Which effect does the declared model lack? One parameter space, one likelihood, one competition: the successor of the search of
//! [`crate::diagnosis`], beside it until its rates on twins are as good.
//!
//! Declared values that may be off within their tolerances, effects of a catalogue, the coherence of the field and the error of the column
//! itself are parameters with priors (`parameters`, `likelihood`). Replays of the column make values and slopes (`forward`); between
//! replays everything is linear algebra on normal equations, event by event. A model is fitted by Fisher scoring within a trust region
//! (`posterior`), models compete by their evidence (`competition`), and the answer says what is named and what remains (`answer`).

mod algebra;
mod answer;
mod competition;
mod convention;
mod covariance;
mod forward;
#[cfg(test)]
mod made_up;
mod parameters;
mod posterior;
mod weights;

pub use answer::{Compared, Named, Probable, Rest, RestVerdict, compete};
