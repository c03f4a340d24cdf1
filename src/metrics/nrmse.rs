//! Normalised root-mean-square error of one channel.

use super::rms;

/// NRMSE of one channel in percent of the observed RMS.
///
/// ```text
/// NRMSE = RMS[p − a] / RMS[a] · 100 %
/// ```
///
/// | symbol | argument | shape    | unit            |
/// |--------|----------|----------|-----------------|
/// | p      | pred     | `[n_step]` | that of `obs`   |
/// | a      | obs      | `[n_step]` | any             |
///
/// Limits: 100 % is what a prediction of zero gets; NaN when the observation is all zero or empty, or the lengths differ.
/// Check:  `zero_prediction_is_100_percent_and_scaling_shows`.
/// Source: Zhu, Chen, Li, FLARE-T, equation for NRMSE_j.
pub fn nrmse_percent(pred: &[f64], obs: &[f64]) -> f64 {
    if pred.len() != obs.len() || obs.is_empty() {
        return f64::NAN;
    }
    let residual = pred.iter().zip(obs).map(|(p, a)| (p - a) * (p - a)).sum::<f64>() / obs.len() as f64;
    let scale = rms(obs);
    if scale > 0.0 { residual.sqrt() / scale * 100.0 } else { f64::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_prediction_is_100_percent_and_scaling_shows() {
        let obs: Vec<f64> = (0..200).map(|i| (0.1 * i as f64).sin()).collect();
        let scaled: Vec<f64> = obs.iter().map(|v| 1.25 * v).collect();
        assert!((nrmse_percent(&[0.0; 200], &obs) - 100.0).abs() < 1e-12);
        assert!((nrmse_percent(&scaled, &obs) - 25.0).abs() < 1e-12);
        assert_eq!(nrmse_percent(&obs, &obs), 0.0);
        assert!(nrmse_percent(&[1.0], &[0.0]).is_nan() && nrmse_percent(&[], &[]).is_nan());
    }
}
