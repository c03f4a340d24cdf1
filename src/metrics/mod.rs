//! Measures of agreement between a prediction and a record: one measure a file.

mod anderson;
mod ceiling;
mod coherent;
mod cosine;
mod field;
mod fourier;
mod history;
mod intensity;
mod ln_ratio;
#[cfg(test)]
mod made_up;
mod matched_filter;
mod measures;
mod normal;
mod nrmse;
mod peaks;
mod psa;
mod quartiles;
mod r2;
mod student;
mod timewise;
mod transfer;

pub use anderson::{Anderson, BANDS_HZ as ANDERSON_BANDS_HZ};
pub use ceiling::{Ceiling, FreeFilter, Pair};
pub use coherent::{COHERENT, coherent_mean_nrmse_percent, coherent_nrmse_percent};
pub use cosine::cosine_similarity;
pub use field::{BiasSigma, Claimed, FieldSummary};
pub use fourier::smoothed_fourier_amplitude;
pub use history::{History, fourier_frequencies_hz, psa_periods_s};
pub use intensity::{arias_build_up_m_s, significant_duration_s};
pub use ln_ratio::{Bands, LnRatio, RmsOf};
pub use matched_filter::MatchedFilter;
pub use measures::{Measures, fourier_bands, ln_psa_by_s, psa_bands};
pub use normal::{normal_probability, scaled_tail};
pub use nrmse::nrmse_percent;
pub use peaks::{peak, peak_velocity_m_s};
pub use psa::{DAMPING, N_PERIOD, PERIOD_RANGE_S, log_periods_s, psa, psa_ln_rmse, spectrum_ln_rmse};
pub use quartiles::{Quartiles, median, quantile};
pub use r2::{r2, r2_pooled};
pub use student::{PairedDifference, t_quantile};
pub use timewise::timewise_error_percent;
pub use transfer::{GOOD_FIT, HIGH_VARIABILITY, SensorTransfer, TransferCurves, TransferFit, pearson};

/// Root mean square of a series; zero for an empty one.
pub fn rms(x: &[f64]) -> f64 {
    if x.is_empty() { 0.0 } else { (x.iter().map(|v| v * v).sum::<f64>() / x.len() as f64).sqrt() }
}
