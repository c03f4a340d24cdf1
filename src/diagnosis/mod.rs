//! What a diagnosis is about, what it says, and what that was worth: the declared array with its events and their noise ([`Problem`]), the
//! answer ([`Diagnosis`]), errors before and after ([`Summary`]). The room `inference` finds the answer.

mod comparison;
mod floor;
mod generic;
mod noise;
mod outcome;
mod problem;
mod settings;
pub(crate) mod spectra;

pub use comparison::{Change, ErrorRow, PREDICTIONS, Six, Summary, missing_predictions};
pub use floor::noise_deviation_m_s2;
pub use generic::{GenericCorrection, Pair, fit as fit_generic};
pub use noise::{USUAL_SHARE, denoised, noise, signal_band_hz};
pub use outcome::{Candidate, DeclaredValue, Diagnosis, Estimate, Found, Hidden, Rest, RestVerdict, Verdict};
pub use problem::{Event, Motions, NoiseSource, NoiseSpectrum, Problem, Replay};
pub use settings::DiagnoseSettings;
pub use spectra::HIGHEST_SHARE;
