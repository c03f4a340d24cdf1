//! Normalised absolute error at each time.

use super::rms;

/// Absolute error at each time in percent of the observed RMS.
///
/// ```text
/// e(t) = |p(t) − a(t)| / RMS[a] · 100 %
/// ```
///
/// Limits: all NaN when the observation is all zero; compares the common leading samples.
/// Check:  `root_mean_square_of_the_timewise_error_is_the_nrmse`.
/// Source: Zhu, Chen, Li, FLARE-T, equation for e_j(t).
pub fn timewise_error_percent(pred: &[f64], obs: &[f64]) -> Vec<f64> {
    let scale = rms(obs);
    let scale = if scale > 0.0 { 100.0 / scale } else { f64::NAN };
    pred.iter().zip(obs).map(|(p, a)| (p - a).abs() * scale).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::nrmse_percent;

    #[test]
    fn root_mean_square_of_the_timewise_error_is_the_nrmse() {
        let obs: Vec<f64> = (0..300).map(|i| (0.07 * i as f64).sin()).collect();
        let pred: Vec<f64> = (0..300).map(|i| (0.07 * i as f64 + 0.2).sin()).collect();
        let error = timewise_error_percent(&pred, &obs);
        assert!((rms(&error) - nrmse_percent(&pred, &obs)).abs() < 1e-10);
        assert!(timewise_error_percent(&[1.0], &[0.0])[0].is_nan());
    }
}
