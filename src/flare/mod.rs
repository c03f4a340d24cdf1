//! FLARE-T: encoder, latent equations, decoder; pretraining, distillation, calibration.
//!
//! | stage | function | trains | from |
//! |-------|----------|--------|------|
//! | 1 | [`pretrain()`] | `E_T`, `Ξ₀`, `D` | dense simulations |
//! | 2 | [`distill()`] | `E_S` | simulations at the sensors |
//! | 3 | [`calibrate()`] | `ΔΞ` | records of one component |
//! | – | [`predict`] | nothing | first window and base acceleration of an event |
//!
//! How stage 1 responds to its settings, as median NRMSE over 20 validation motions of the synthetic column of
//! `tests/support` (100 channels, r = 14, 80 training motions). The row "nothing" is 120 epochs, batch 32, latent weight
//! 0.1, equation weight 0.01, stress factor 2, all else the defaults; the present defaults differ from it in just these
//! five. One seed each, and the best epoch was chosen on the motions it is reported for, so that differences of a few
//! tenths mean nothing:
//!
//! | changed | NRMSE % |
//! |---------|---------|
//! | nothing | 6.9 |
//! | batch 16 | 5.8 |
//! | learning rate 2e-3 | 6.5 |
//! | learning rate of the coefficients 3e-4 | 8.1 |
//! | both learning rates doubled or more (2e-3, 3e-3) | 10.3 |
//! | no amplitude weighting | 10.6 |
//! | segments as long at the end as at the beginning, or whole motions | 7.0, 6.9 |
//! | no mirroring; no jitter | 6.8, 6.8 |
//! | no equation term; no latent term | 6.7, 6.6 |
//!
//! What each lever on top of the published recipe gave on the Lotung column (r = 14, 250 epochs unless said otherwise): score
//! of selection ([`PretrainSettings`]) and median NRMSE over the validation motions; for hidden states also the largest
//! median of a motion and the error of the validation events after the calibration (EW, NS).
//!
//! | lever | score | median % | largest % | stage 3 |
//! |-------|-------|----------|-----------|---------|
//! | published library, 200 epochs | 0.0473 | 23.6 | 56 | |
//! | + memories, 200 epochs | 0.0466 | 31.2 | 51 | |
//! | + energies, 200 epochs | 0.0447 | 32.4 | 50 | |
//! | + polish and soft limits | 0.0307 | 13.6 | 59 | 0.070, 0.044 |
//! | + 2 hidden states (the default) | 0.0245 | 12.7 | 39 | 0.076, 0.060 |
//! | + 4 hidden states | 0.0233 | 14.4 | 44 | 0.098, 0.054 |
//! | centrifuge (r = 8): no hidden state | 0.0046 | 12.8 | 18 | 0.0060 |
//! | centrifuge: 6 hidden states (its manifest) | 0.0023 | 8.7 | 14 | 0.0032 |
//!
//! All of it together against the published recipe (`--set recipe=published`) on the same simulations of Lotung: median 12.7
//! instead of 31.1 %, the largest motion 39 instead of 58, stage 3 0.076 and 0.060 instead of 0.143 and 0.088; it is at 26 %
//! after 47 s and at 13 % after 113 s of 156 s on two cores, where the published recipe ends after 32 s.
//!
//! The last rows come from `flare-pipe run SITE --until evaluate --set pretrain.hidden=N`. What limits the rest: encoding and
//! decoding alone leave 2 % on weak and 14 % on strong motions of Lotung, rolling out 11 and 39 %, on training motions
//! hardly less: the equations, not the manifold and not the number of motions. None of these settings moved the strong motions
//! (median, largest): `pretrain.polish_steps=24` (12.7, 38), `pretrain.hidden=6` (14.1, 43), `pretrain.amplitude_weighting=0.5`
//! (16.3, 44). Nor did, in code not kept, terms |z_i| h_k in which the hidden states slide with friction (14.8, 47); resonators
//! driven by `u` as further inputs, two Runge–Kutta steps a sample, and a term in du/dt changed the error on the centrifuge by
//! less than a twentieth.
//!
//! Everything in here is normalised and sampled at the model's step; the caller converts. The gradients are written by
//! hand and tested against finite differences; matrix products run on faer.

mod adam;
mod adjoint;
mod calibrate;
mod case;
mod checkpoint;
mod descent;
mod distill;
mod equations;
mod events;
mod extend;
mod gauss_newton;
mod guard;
mod history;
mod integrator;
mod kernels;
mod library;
mod limits;
mod memory;
mod mlp;
mod model;
mod normal;
mod objective;
mod observation;
mod penalty;
mod poles;
mod polish;
mod pretrain;
mod recipe;
mod residuals;
mod resume;
mod ridge;
mod rollout;
mod sensitivity;
mod settings;
mod snapshot;
mod start;
mod training;
mod validation;

pub use calibrate::{Calibration, Data, calibrate};
pub use case::{Case, Event};
pub use checkpoint::Normalisation;
pub use distill::distill;
pub use equations::equations;
pub use extend::{Extension, Tried, extend};
pub use guard::Guard;
pub use history::History;
pub use library::Library;
pub use memory::Memories;
pub use model::{Shape, SourceModel, SparseEncoder};
pub use observation::Observation;
pub use pretrain::pretrain;
pub use recipe::Recipe;
pub use rollout::{observe, predict, reconstruct};
pub use settings::{CalibrateSettings, DistillSettings, FreeTerms, LossWeights, Metric, PretrainSettings, Solver};
pub use training::Training;
