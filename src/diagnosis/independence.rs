//! Whether a residual is independent of the input: the test for a model that simulates.

use crate::metrics::rms;
use realfft::RealFftPlanner;

/// Chance at which independence is doubted, over all lags.
const LEVEL: f64 = 0.05;

/// The largest cross-correlation of a residual with the input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Independence {
    /// It, over its standard deviation for independent histories.
    pub deviations: f64,
    /// The lag of the residual behind the input, s.
    pub lag_s: f64,
    /// What independent histories exceed with a chance of 5 % over all lags.
    pub bound: f64,
}

/// Tests the residual against the input at lags from 0 to `longest_s`.
///
/// ```text
/// ξ(τ) = Σ_t e(t + τ) u(t) / (N σ_e σ_u),   var ξ = P/N,   P = Σ_k ρ_e(k) ρ_u(k)      (1)
/// bound: |ξ|/√(P/N) that one lag exceeds with a chance of 1 − 0.95^(1/lags)                   (2)
/// ```
///
/// A simulation (output-error) model need not leave a white residual, but one that no longer follows the input.
///
/// Limits: (2) counts all lags as independent, which is cautious; `None` where a history is zero or shorter than the lags; nonstationary shaking makes (1) approximate.
/// Check:  `independent_histories_stay_below_the_bound_and_an_echo_does_not`.
/// Source: Ljung (1999), System Identification, 2nd ed., section 16.6.
pub fn independence(input: &[f64], residual: &[f64], dt_s: f64, longest_s: f64) -> Option<Independence> {
    let n = input.len().min(residual.len());
    let lags = (longest_s / dt_s) as usize + 1;
    let (u, e) = (&input[..n], &residual[..n]);
    let scale = rms(u) * rms(e) * n as f64;
    if lags >= n || scale == 0.0 {
        return None;
    }
    let (ru, re) = (correlation(u, u), correlation(e, e));
    let own = |r: &[f64], k: usize| r[k] / r[0];
    let correlated: f64 = 1.0 + 2.0 * (1..n / 2).map(|k| own(&ru, k) * own(&re, k)).sum::<f64>();
    let correlated = correlated.max(1.0); // P of (1)
    let deviation = (correlated / n as f64).sqrt();
    let cross = correlation(e, u);
    let (lag, largest) =
        (0..lags).map(|k| (k, (cross[k] / scale).abs())).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0));
    Some(Independence {
        deviations: largest / deviation,
        lag_s: lag as f64 * dt_s,
        bound: two_sided(1.0 - (1.0 - LEVEL).powf(1.0 / lags as f64)),
    })
}

/// Σ_t a(t + k) b(t) for k ≥ 0.
fn correlation(a: &[f64], b: &[f64]) -> Vec<f64> {
    let length = (2 * a.len()).next_power_of_two();
    let mut planner = RealFftPlanner::<f64>::new();
    let (forward, inverse) = (planner.plan_fft_forward(length), planner.plan_fft_inverse(length));
    let spectrum = |x: &[f64]| {
        let mut padded = x.to_vec();
        padded.resize(length, 0.0);
        let mut out = forward.make_output_vec();
        forward.process(&mut padded, &mut out).expect("buffers made by the plan itself");
        out
    };
    let mut product: Vec<_> = spectrum(a).iter().zip(spectrum(b)).map(|(a, b)| a * b.conj()).collect();
    product[0].im = 0.0;
    product[length / 2].im = 0.0;
    let mut out = inverse.make_output_vec();
    inverse.process(&mut product, &mut out).expect("buffers made by the plan itself");
    out.iter().take(a.len()).map(|v| v / length as f64).collect()
}

/// z with a chance `p` of |normal| > z.
fn two_sided(p: f64) -> f64 {
    let upper = |z: f64| 0.5 * complementary_error(z / 2.0f64.sqrt());
    let (mut low, mut high) = (0.0, 40.0);
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if 2.0 * upper(middle) > p { low = middle } else { high = middle }
    }
    low
}

/// erfc for x ≥ 0 (Abramowitz and Stegun 7.1.26, error below 1.5e-7).
fn complementary_error(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x);
    let series =
        ((((1.061_405_429 * t - 1.453_152_027) * t + 1.421_413_741) * t - 0.284_496_736) * t + 0.254_829_592) * t;
    series * (-x * x).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    fn coloured(seed: u64, n: usize) -> Vec<f64> {
        let mut stream = random::stream(seed, "independence");
        let (mut y1, mut y2) = (0.0, 0.0);
        (0..n)
            .map(|_| {
                let draw: f64 = StandardNormal.sample(&mut stream);
                let y = 1.6 * y1 - 0.8 * y2 + draw;
                (y2, y1) = (y1, y);
                y
            })
            .collect()
    }

    #[test]
    fn independent_histories_stay_below_the_bound_and_an_echo_does_not() {
        let mut alarms = 0;
        for seed in 0..100 {
            let (u, e) = (coloured(seed, 3000), coloured(1000 + seed, 3000));
            let found = independence(&u, &e, 0.01, 1.0).unwrap();
            alarms += usize::from(found.deviations > found.bound);
        }
        assert!(alarms <= 12, "{alarms} of 100");
        let (u, mut e) = (coloured(1, 3000), coloured(2, 3000));
        for i in 40..3000 {
            e[i] += 0.4 * u[i - 40];
        }
        let found = independence(&u, &e, 0.01, 1.0).unwrap();
        assert!(found.deviations > 2.0 * found.bound && (found.lag_s - 0.4).abs() < 0.021, "{found:?}");
    }

    #[test]
    fn silence_and_short_histories_tell_nothing() {
        assert!(independence(&[0.0; 500], &[1.0; 500], 0.01, 1.0).is_none());
        assert!(independence(&[1.0; 50], &[1.0; 50], 0.01, 1.0).is_none());
    }

    #[test]
    fn the_normal_quantile_is_right() {
        assert!((two_sided(0.05) - 1.959_964).abs() < 1e-4 && (two_sided(0.001) - 3.290_527).abs() < 1e-3);
    }
}
