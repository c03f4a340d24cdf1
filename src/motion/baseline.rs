//! Baseline correction: velocity and displacement come to rest at the end.

use crate::numerics::{filter, integrate};

/// Makes velocity and displacement end at zero, exactly for a piecewise linear acceleration that starts at zero.
///
/// ```text
/// a ← a − w(t) (c₀ + c₁ τ),   τ = 2t/T − 1,   v(T) = d(T) = 0                              (1)
/// ```
///
/// with `w` a window that is one but for `ramp_s` at each end, where it falls to zero, so that the ends stay at zero.
///
/// Limits: adds content near 1/T; meant for a series that is already free of it, whose correction is then small.
/// Check:  `velocity_and_displacement_end_at_rest`.
pub fn correct_baseline(a: &mut [f64], dt_s: f64, ramp_s: f64) {
    let n = a.len();
    if n < 4 {
        a.fill(0.0);
        return;
    }
    let mut window = vec![1.0; n];
    filter::taper_ends(&mut window, (ramp_s / dt_s) as usize);
    let tilted: Vec<f64> =
        window.iter().enumerate().map(|(i, w)| w * (2.0 * i as f64 / (n - 1) as f64 - 1.0)).collect();
    let end = |x: &[f64]| {
        let (v, d) = integrate::twice(x, dt_s);
        [v[n - 1], d[n - 1]]
    };
    let (p, q) = (end(&window), end(&tilted));
    let determinant = p[0] * q[1] - p[1] * q[0];
    // A second pass removes what rounding left of the first.
    for _ in 0..2 {
        let e = end(a);
        let c0 = (e[0] * q[1] - e[1] * q[0]) / determinant;
        let c1 = (p[0] * e[1] - p[1] * e[0]) / determinant;
        for i in 0..n {
            a[i] -= c0 * window[i] + c1 * tilted[i]; // (1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn velocity_and_displacement_end_at_rest() {
        let dt_s = 0.005;
        let mut a: Vec<f64> = (0..3001)
            .map(|i| i as f64 * dt_s)
            .map(|t| (7.0 * t).sin() * (-((t - 5.0) / 2.0).powi(2)).exp() + 0.01 + 0.002 * t)
            .collect();
        filter::taper_ends(&mut a, 100);
        correct_baseline(&mut a, dt_s, 0.5);
        let (v, d) = integrate::twice(&a, dt_s);
        assert!(v[3000].abs() < 1e-13 && d[3000].abs() < 1e-12, "{} {}", v[3000], d[3000]);
        assert!(a[0].abs() < 1e-15 && a[3000].abs() < 1e-15);
    }

    #[test]
    fn series_too_short_to_correct_become_zero() {
        let mut a = [1.0, 2.0];
        correct_baseline(&mut a, 0.01, 0.5);
        assert_eq!(a, [0.0, 0.0]);
    }
}
