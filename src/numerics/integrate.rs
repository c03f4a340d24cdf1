//! Time integrals of a sampled series that is taken as piecewise linear between its samples.

/// Integral from the first sample, which is zero.
///
/// ```text
/// v_{i+1} = v_i + (a_i + a_{i+1}) dt/2                           (1)
/// ```
pub fn cumulative(a: &[f64], dt_s: f64) -> Vec<f64> {
    let mut v = vec![0.0; a.len()];
    for i in 1..a.len() {
        v[i] = v[i - 1] + 0.5 * dt_s * (a[i - 1] + a[i]); // (1)
    }
    v
}

/// First and second integral (velocity and displacement of an acceleration), exact for a piecewise linear series.
///
/// ```text
/// d_{i+1} = d_i + v_i dt + (2 a_i + a_{i+1}) dt²/6               (2)
/// ```
///
/// Limits: starts from rest; a constant offset of the input grows linearly and quadratically.
/// Check:  `integrals_of_a_cubic_motion_are_exact`.
pub fn twice(a: &[f64], dt_s: f64) -> (Vec<f64>, Vec<f64>) {
    let v = cumulative(a, dt_s);
    let mut d = vec![0.0; a.len()];
    for i in 1..a.len() {
        d[i] = d[i - 1] + dt_s * v[i - 1] + dt_s * dt_s / 6.0 * (2.0 * a[i - 1] + a[i]); // (2)
    }
    (v, d)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integrals_of_a_cubic_motion_are_exact() {
        let dt_s = 0.01;
        let a: Vec<f64> = (0..500).map(|i| 1.5 - 0.7 * i as f64 * dt_s).collect();
        let (v, d) = twice(&a, dt_s);
        for i in 0..500 {
            let t = i as f64 * dt_s;
            assert!((v[i] - (1.5 * t - 0.35 * t * t)).abs() < 1e-12);
            assert!((d[i] - (0.75 * t * t - 0.35 * t.powi(3) / 3.0)).abs() < 1e-11);
        }
        assert_eq!(cumulative(&a, dt_s), v);
        assert!(cumulative(&[], dt_s).is_empty() && twice(&[2.0], dt_s) == (vec![0.0], vec![0.0]));
    }
}
