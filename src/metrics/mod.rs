//! Measures of agreement between a prediction and a record: one measure a file.

mod bootstrap;
mod cosine;
mod nrmse;
mod psa;
mod quartiles;
mod r2;
mod timewise;

pub use bootstrap::median_interval;
pub use cosine::cosine_similarity;
pub use nrmse::nrmse_percent;
pub use psa::{DAMPING, N_PERIOD, PERIOD_RANGE_S, log_periods_s, psa, psa_ln_rmse, spectrum_ln_rmse};
pub use quartiles::{Quartiles, median, quantile};
pub use r2::{r2, r2_pooled};
pub use timewise::timewise_error_percent;

/// Root mean square of a series; zero for an empty one.
pub fn rms(x: &[f64]) -> f64 {
    if x.is_empty() { 0.0 } else { (x.iter().map(|v| v * v).sum::<f64>() / x.len() as f64).sqrt() }
}
