//! Coefficient of determination, pooled over channels.

/// Coefficient of determination of one series.
///
/// ```text
/// R² = 1 − Σ (a − p)² / Σ (a − ā)²
/// ```
///
/// Limits: 1 is perfect, 0 what the mean gets, negative is worse than the mean; NaN for a constant or empty observation.
/// Check:  `the_mean_scores_zero_and_the_truth_one`.
/// Source: Nash and Sutcliffe (1970), River flow forecasting through conceptual models, J. Hydrol. 10, 282–290, eq. 3.
pub fn r2(pred: &[f64], obs: &[f64]) -> f64 {
    r2_pooled(&[(pred, obs)])
}

/// R² over all samples of several (prediction, observation) pairs at once: one mean, one sum.
pub fn r2_pooled(pairs: &[(&[f64], &[f64])]) -> f64 {
    if pairs.iter().any(|(p, a)| p.len() != a.len()) {
        return f64::NAN;
    }
    let n: usize = pairs.iter().map(|(_, a)| a.len()).sum();
    let mean = pairs.iter().flat_map(|(_, a)| a.iter()).sum::<f64>() / n as f64;
    let residual: f64 = pairs.iter().flat_map(|(p, a)| p.iter().zip(a.iter())).map(|(p, a)| (a - p).powi(2)).sum();
    let total: f64 = pairs.iter().flat_map(|(_, a)| a.iter()).map(|a| (a - mean).powi(2)).sum();
    if total > 0.0 { 1.0 - residual / total } else { f64::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_scores_zero_and_the_truth_one() {
        let obs = [1.0, 2.0, 3.0, 6.0];
        assert_eq!(r2(&obs, &obs), 1.0);
        assert_eq!(r2(&[3.0; 4], &obs), 0.0);
        assert!((r2(&[1.0, 2.0, 3.0, 4.0], &obs) - (1.0 - 4.0 / 14.0)).abs() < 1e-15);
        assert!(r2(&[1.0], &[1.0]).is_nan() && r2(&[], &[]).is_nan());
    }

    #[test]
    fn pooling_is_the_score_of_the_joined_series() {
        let (a, b) = ([1.0, -2.0, 0.5], [10.0, -30.0]);
        let (p, q) = ([0.8, -1.0, 0.5], [12.0, -25.0]);
        let joined = r2(&[0.8, -1.0, 0.5, 12.0, -25.0], &[1.0, -2.0, 0.5, 10.0, -30.0]);
        assert!((r2_pooled(&[(&p, &a), (&q, &b)]) - joined).abs() < 1e-15);
    }
}
