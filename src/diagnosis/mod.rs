//! Which effect does the declared model lack? Recalibration within tolerances, search over a catalogue of named effects,
//! confirmation with the nonlinear column, choice on validation events, and honest silence.
//!
//! Residuals come from replays of the finite-element column. What a change of the soil within its tolerances does to
//! them is told by replays around the estimate, what an effect of the soil does by replays along its strength, and any
//! other by a linear-equivalent column in the frequency domain ([`FastColumn`]) that replays anchor; each further replay
//! corrects all of them along the steps taken. Noise of the
//! input sensor is in the cost, which therefore knows that a residual at a resonance of the column is worth little, and
//! so is what a yielding column makes of that noise. Fits see training events alone; validation events are judged by
//! what these let expect of them, the uncertainty of the fit included. Declared tolerances are nuisances of every test:
//! only what they cannot explain may be called an effect, and the alarm thresholds are those of null twins of the same
//! array. The way along a valley between an effect and tolerances is shown by derivatives from replays right beside the model: so are
//! the recalibrated model and the answer settled, and the verdict is on what the last replay leaves. What effects of the answer are
//! confused with is tried in their place. Of models that leave no more than noise the one closest to what is declared stands, and
//! where that still is farther off than chance puts it, the search goes on for what its tolerances have made up for.

mod anchor;
mod at_its_end;
mod axes;
mod bounded;
mod centre;
mod closely;
mod coherence;
mod comparison;
mod confirm;
mod cost;
mod curves;
mod diagnose;
mod evidence;
mod fast_column;
mod fit;
mod floor;
mod followed;
mod generic;
mod hygiene;
mod independence;
mod interference;
mod line;
mod low_frequency;
#[cfg(test)]
mod made_up;
mod needless;
mod neighbours;
mod noise;
mod null_twins;
mod operators;
mod outcome;
mod path;
mod places;
mod power;
mod problem;
mod propagated;
mod relaxed;
mod remainder;
mod repeatable;
pub(crate) mod responses;
mod round;
mod screen;
mod search;
mod secants;
mod settings;
mod settling;
mod simulated;
pub(crate) mod spectra;
mod stand_ins;
mod standing;
mod surroundings;
mod tilt;
mod together;
mod tuning;
mod unknowns;
mod velocities;
mod verdict;

pub use coherence::{Coherent, Trace, coherent};
pub use comparison::{Change, ErrorRow, Six, Summary};
pub use curves::{Curve, Curves};
pub use diagnose::{diagnose, recalibrated};
pub use evidence::Evidence;
pub use fast_column::{FastColumn, Grid, March, element_count};
pub use floor::noise_deviation_m_s2;
pub use generic::{GenericCorrection, Pair, fit as fit_generic};
pub use hygiene::{Shot, Suspicion, hygiene};
pub use independence::{Independence, independence};
pub use noise::{denoised, noise, noisier};
pub use null_twins::{drawn, thresholds};
pub use outcome::{
    Candidate, Diagnosis, Estimate, EventRemainder, Excess, Found, Remainder, Rest, RestVerdict, Thresholds,
    ToleranceAlarm, UpperBound, Verdict,
};
pub use power::{Confusion, Power, Sensitivity, power};
pub use problem::{Event, Motions, NoiseSpectrum, Problem, Replay};
pub use repeatable::{Partition, partition};
pub use responses::Scene;
pub use settings::{DiagnoseSettings, Method};
pub use simulated::Disturbance;
pub use standing::{Standing, standing};
pub use tuning::Tuning;
pub use unknowns::{Nuisance, nuisance_tables, nuisances, ranges};
