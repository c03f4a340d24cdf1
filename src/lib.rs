//! `flare-pipe`: from a site manifest to held-out predictions of how a soil site shakes.
//!
//! ```text
//! manifest ─► motions ─► simulate ─► dataset ─► pretrain ─► distill ─► calibrate ─► evaluate ─┐
//!    │        (base)     (column)    (windows)  (FLARE-T)   (sensors)  (records)    (held out) │
//!    └─► records ─► replay ─► diagnose ─► recalibrate, correct ─► the same stages again ───────┴─► compare ─► report
//!                   (column)  (inference)  (manifests)
//! ```
//!
//! Every arrow is a file in the cache; `stages` has a file for each box, `pipelines` says which stages a run has.
//!
//! Signs and axes, once for the whole crate: `z` is depth, positive down from the free surface (m); `u` is the horizontal
//! displacement, positive in the record's azimuth, and is **total**, not relative to the base, so that a node's
//! acceleration compares directly with a downhole sensor; `γ = ∂u/∂z`; `τ` has the sign of `γ` on first loading;
//! `t = 0` at the first sample. Inside, everything is SI (`units` holds the only conversions).
//!
//! A room uses those before it in this line and no others: `error units ranges numerics registry progress atomic metrics pipeline motion
//! soil column equivalent_linear records dataset flare effects diagnosis inference manifest twin report stages cli`. `pipeline` knows
//! nothing of soil and meets stages through its `Stage` trait.

pub mod atomic;
pub mod cli;
pub mod column;
pub mod dataset;
pub mod diagnosis;
pub mod effects;
pub mod equivalent_linear;
pub mod error;
pub mod flare;
pub mod inference;
pub mod manifest;
pub mod metrics;
pub mod motion;
pub mod numerics;
pub mod pipeline;
pub mod progress;
pub mod ranges;
pub mod records;
pub mod registry;
pub mod report;
pub mod soil;
pub mod stages;
pub mod twin;
pub mod units;

pub use error::{Error, Result};
