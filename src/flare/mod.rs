//! FLARE-T: encoder, latent equations, decoder; pretraining, distillation, calibration.
//!
//! | stage | function | trains | from |
//! |-------|----------|--------|------|
//! | 1 | [`pretrain()`] | `E_T`, `Ξ₀`, `D` | dense simulations |
//! | 2 | [`distill()`] | `E_S` | simulations at the sensors |
//! | 3 | [`calibrate()`] | `ΔΞ` | records of one component |
//! | – | [`predict`] | nothing | first window and base acceleration of an event |
//!
//! Everything in here is normalised and sampled at the model's step; the caller converts. The gradients are written by
//! hand and tested against finite differences; matrix products run on faer.

mod adam;
mod adjoint;
mod calibrate;
mod case;
mod checkpoint;
mod distill;
mod equations;
mod events;
mod history;
mod integrator;
mod kernels;
mod library;
mod mlp;
mod model;
mod objective;
mod observation;
mod poles;
mod pretrain;
mod residuals;
mod resume;
mod ridge;
mod rollout;
mod settings;
mod start;
mod validation;

pub use calibrate::{Calibration, calibrate};
pub use case::{Case, Event};
pub use checkpoint::Normalisation;
pub use distill::distill;
pub use equations::equations;
pub use history::History;
pub use library::Library;
pub use model::{Shape, SourceModel, SparseEncoder};
pub use observation::Observation;
pub use pretrain::pretrain;
pub use rollout::{observe, predict, reconstruct};
pub use settings::{CalibrateSettings, DistillSettings, LossWeights, PretrainSettings};
