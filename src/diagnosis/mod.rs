//! Which effect does the declared model lack? Recalibration within tolerances, search over a catalogue of named effects,
//! confirmation with the nonlinear column, choice on validation events, and honest silence.
//!
//! The search runs on a linear-equivalent column in the frequency domain ([`FastColumn`]) anchored at replays of the
//! finite-element column: residuals come from the latter, derivatives from the former. Noise of the input sensor is in the
//! cost, which therefore knows that a residual at a resonance of the column is worth little. Declared tolerances are
//! nuisances of every test: only what they cannot explain may be called an effect, and the alarm thresholds are those
//! of null twins of the same array.

mod curves;
mod fast_column;
mod noise;
mod outcome;
mod problem;
mod settings;

pub use curves::{Curve, Curves};
pub use fast_column::{FastColumn, Grid, March, element_count};
pub use noise::noise;
pub use outcome::{
    Candidate, Diagnosis, Estimate, EventRemainder, Excess, Found, Remainder, Thresholds, ToleranceAlarm, UpperBound,
    Verdict,
};
pub use problem::{Event, NoiseSpectrum, Problem, Replay};
pub use settings::DiagnoseSettings;
