//! Twin records: what the sensors of a site would have recorded if a *truth* other than the declared model held.
//!
//! The truth column has a finer mesh, its own seed, and parameters drawn within the declared tolerances; it may carry
//! effects that the manifest does not declare, and things outside the catalogue of effects. Sensors have gains, clocks and
//! azimuths within their tolerances and noise, the input sensor too. The truth file is read here and nowhere else.

mod draw;
mod foreign;
mod matrix;
mod outside;
mod processing;
mod simulate;
mod tally;
mod truth;

pub use draw::{draw, total};
pub use foreign::{Foreign, ForeignDamping, OwnDamping};
pub use matrix::{Case, Cell, Matrix};
pub use outside::OUTSIDE;
pub use processing::Processing;
pub use simulate::{Recorder, record_event, recorder};
pub use tally::{Four, Outcome, Recovered, Report, Share, Spread, Tally};
pub use truth::{EventSection, Truth};
