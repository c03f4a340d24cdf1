//! Pseudo-acceleration response spectra and the error between two of them.

use crate::numerics::resample::sample_band_limited;
use std::f64::consts::PI;

/// Damping ratio of the reported spectra.
pub const DAMPING: f64 = 0.05;
/// Periods of the reported spectra, s.
pub const PERIOD_RANGE_S: [f64; 2] = [0.10, 5.00];
/// Number of periods of the reported spectra.
pub const N_PERIOD: usize = 100;
/// Samples a period: the peak between two samples is then missed by at most 1.2 %.
const SAMPLES_A_PERIOD: f64 = 20.0;
/// Straight lines between samples this far apart lose 0.7 % of a 9 Hz wave.
const LONGEST_STEP_S: f64 = 0.005;
/// Samples between two given ones: twenty to the shortest wave that these can hold, more would show nothing new.
const FINEST: f64 = 10.0;

/// The periods of the reported spectra: [`N_PERIOD`] over [`PERIOD_RANGE_S`], log-spaced.
pub fn log_periods_s() -> Vec<f64> {
    let [first, last] = PERIOD_RANGE_S;
    (0..N_PERIOD).map(|i| first * (last / first).powf(i as f64 / (N_PERIOD - 1) as f64)).collect()
}

/// Pseudo-acceleration spectrum: peak of a damped oscillator under base acceleration, exact for piecewise linear input.
///
/// ```text
/// ẍ + 2ξω ẋ + ω² x = −a(t),   PSA(T) = ω² max|x|,   ω = 2π/T                              (1)
/// [x ẋ]_{i+1} = A [x ẋ]_i + B [a_i a_{i+1}],  A, B closed form in ω, ξ, dt                 (2)
/// ```
///
/// | symbol | argument  | shape      | unit | range   |
/// |--------|-----------|------------|------|---------|
/// | a      | x         | `[n_step]`   | m/s² |         |
/// | ξ      | damping   | scalar     | –    | 0 … < 1 |
/// | T      | periods_s | `[n_period]` | s    | > 0     |
/// | PSA    | returned  | `[n_period]` | m/s² |         |
///
/// Limits: the peak is sought within the record only, not in the free vibration after it; an input coarser than 0.005 s or
/// a twentieth of the shortest period is first interpolated (band-limited, ten samples between two at most), which cannot restore what
/// the sampling lost.
/// Check:  `spectra_are_those_of_independent_implementations`, `harmonic_base_motion_matches_the_closed_form`, `a_step_gives_the_known_overshoot`.
/// Source: Nigam and Jennings (1969), Calculation of response spectra from strong-motion earthquake records, BSSA 59, 909–922.
pub fn psa(x: &[f64], dt_s: f64, damping: f64, periods_s: &[f64]) -> Vec<f64> {
    let shortest_s = periods_s.iter().copied().fold(f64::INFINITY, f64::min);
    let finest_s = (shortest_s / SAMPLES_A_PERIOD).min(LONGEST_STEP_S);
    let factor = (dt_s / finest_s * (1.0 - 1e-9)).ceil().clamp(1.0, FINEST) as usize;
    let fine = if factor == 1 { x.to_vec() } else { refined(x, dt_s, factor) };
    periods_s.iter().map(|&period_s| pseudo_acceleration(&fine, dt_s / factor as f64, damping, period_s)).collect()
}

/// Root mean square of the natural-log ratio of two spectra at equal periods.
///
/// ```text
/// e = √( mean_T [ ln PSA_p(T) − ln PSA_a(T) ]² )
/// ```
///
/// Limits: NaN when an ordinate is not positive or the lengths differ; 0.1 is about 10 %.
/// Check:  `a_constant_factor_is_its_logarithm`.
pub fn spectrum_ln_rmse(pred: &[f64], obs: &[f64]) -> f64 {
    if pred.len() != obs.len() || obs.is_empty() || pred.iter().chain(obs).any(|v| v.is_nan() || *v <= 0.0) {
        return f64::NAN;
    }
    (pred.iter().zip(obs).map(|(p, a)| (p / a).ln().powi(2)).sum::<f64>() / obs.len() as f64).sqrt()
}

/// [`spectrum_ln_rmse`] of two histories (m/s², step `dt_s`): 5 % damping, 0.10–5.00 s.
pub fn psa_ln_rmse(pred: &[f64], obs: &[f64], dt_s: f64) -> f64 {
    let periods_s = log_periods_s();
    spectrum_ln_rmse(&psa(pred, dt_s, DAMPING, &periods_s), &psa(obs, dt_s, DAMPING, &periods_s))
}

fn refined(x: &[f64], dt_s: f64, factor: usize) -> Vec<f64> {
    let n = if x.is_empty() { 0 } else { (x.len() - 1) * factor + 1 };
    let mut fine = sample_band_limited(x, dt_s, 0.0, dt_s / factor as f64, n, dt_s / factor as f64);
    // The given samples are kept as they are: interpolation only fills in between them.
    for (i, value) in x.iter().enumerate() {
        fine[i * factor] = *value;
    }
    fine
}

fn pseudo_acceleration(a: &[f64], dt_s: f64, damping: f64, period_s: f64) -> f64 {
    let omega = 2.0 * PI / period_s;
    let Recursion { a11, a12, a21, a22, b11, b12, b21, b22 } = Recursion::new(omega, damping, dt_s);
    let (mut x, mut v, mut peak) = (0.0f64, 0.0f64, 0.0f64);
    for pair in a.windows(2) {
        let next = a11 * x + a12 * v + b11 * pair[0] + b12 * pair[1]; // (2)
        v = a21 * x + a22 * v + b21 * pair[0] + b22 * pair[1];
        x = next;
        peak = if x.is_nan() { f64::NAN } else { peak.max(x.abs()) };
    }
    omega * omega * peak // (1)
}

/// Matrices A and B of (2).
struct Recursion {
    a11: f64,
    a12: f64,
    a21: f64,
    a22: f64,
    b11: f64,
    b12: f64,
    b21: f64,
    b22: f64,
}

impl Recursion {
    fn new(omega: f64, xi: f64, dt: f64) -> Self {
        let root = (1.0 - xi * xi).sqrt();
        let omega_d = omega * root;
        let decay = (-xi * omega * dt).exp();
        let (sin, cos) = (omega_d * dt).sin_cos();
        let a11 = decay * (xi / root * sin + cos);
        let a12 = decay * sin / omega_d;
        let a21 = -omega / root * decay * sin;
        let a22 = decay * (cos - xi / root * sin);
        // Particular solution for a(t) = a_0 + s t: x_p = −a_0/ω² − s t/ω² + 2ξ s/ω³.
        let (w2, w3) = (omega * omega, omega.powi(3));
        let ramp = |a0: f64, a1: f64| {
            let slope = (a1 - a0) / dt;
            let (p0, q0) = (-a0 / w2 + 2.0 * xi * slope / w3, -slope / w2);
            let p1 = p0 - slope * dt / w2;
            (p1 - a11 * p0 - a12 * q0, q0 - a21 * p0 - a22 * q0)
        };
        let ((b11, b21), (b12, b22)) = (ramp(1.0, 0.0), ramp(0.0, 1.0));
        Self { a11, a12, a21, a22, b11, b12, b21, b22 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative displacement of a damped oscillator from rest under a sin(Ω t) base acceleration.
    fn harmonic_response(t: f64, omega: f64, xi: f64, big_omega: f64) -> f64 {
        let (k, c) = (omega * omega - big_omega * big_omega, 2.0 * xi * omega * big_omega);
        let scale = -1.0 / (k * k + c * c);
        let omega_d = omega * (1.0 - xi * xi).sqrt();
        // x = scale (k sin Ωt − c cos Ωt) + e^{−ξωt} (P cos ω_d t + Q sin ω_d t), x(0) = ẋ(0) = 0.
        let p = scale * c;
        let q = (xi * omega * p - scale * k * big_omega) / omega_d;
        scale * (k * (big_omega * t).sin() - c * (big_omega * t).cos())
            + (-xi * omega * t).exp() * (p * (omega_d * t).cos() + q * (omega_d * t).sin())
    }

    #[test]
    fn harmonic_base_motion_matches_the_closed_form() {
        let (dt_s, n) = (0.0005, 40_001);
        for f_hz in [0.5, 2.0, 7.0] {
            let a: Vec<f64> = (0..n).map(|i| (2.0 * PI * f_hz * i as f64 * dt_s).sin()).collect();
            for period_s in [0.1, 0.37, 0.5, 2.0, 5.0] {
                let omega = 2.0 * PI / period_s;
                let exact = (0..n)
                    .map(|i| harmonic_response(i as f64 * dt_s, omega, 0.05, 2.0 * PI * f_hz).abs())
                    .fold(0.0, f64::max)
                    * omega
                    * omega;
                let got = psa(&a, dt_s, 0.05, &[period_s])[0];
                assert!((got / exact - 1.0).abs() < 1e-4, "{f_hz} Hz, {period_s} s: {got} against {exact}");
            }
        }
    }

    /// `python tests/metrics/vectors.py`: eqsig 1.2.17, `pseudo_response_spectra` (in the time domain, peaks at samples), and
    /// pyrotd 0.6.1, `calc_spec_accels` (in the frequency domain).
    #[test]
    fn spectra_are_those_of_independent_implementations() {
        use crate::metrics::made_up::{DT_S, observed, predicted};
        let periods_s = [0.2, 0.5, 1.0, 3.0];
        let eqsig = [
            [4.038010106754755, 1.7278712746718432, 1.5369220539552555, 0.07156636548240727],
            [3.274906922327955, 2.071551289710194, 1.843673217932622, 0.08564268400485335],
        ];
        let pyrotd = [
            [4.089957906609986, 1.7317599446694913, 1.5351056811207913, 0.071555730000504],
            [3.31149409490967, 2.0756070000619538, 1.841308337902079, 0.0856176799793735],
        ];
        for (i, x) in [observed(), predicted()].iter().enumerate() {
            for (k, got) in psa(x, DT_S, 0.05, &periods_s).iter().enumerate() {
                assert!((got / pyrotd[i][k] - 1.0).abs() < 0.01, "{}: {got} {}", periods_s[k], pyrotd[i][k]);
                assert!((got / eqsig[i][k] - 1.0).abs() < 0.015, "{}: {got} {}", periods_s[k], eqsig[i][k]);
            }
        }
    }

    #[test]
    fn a_coarse_record_gives_the_spectrum_of_the_fine_one() {
        let signal = |dt_s: f64, n: usize| -> Vec<f64> {
            (0..n)
                .map(|i| i as f64 * dt_s)
                .map(|t| (2.0 * PI * 6.5 * t).sin() * (-((t - 6.0) / 2.0).powi(2)).exp())
                .collect()
        };
        let periods_s = log_periods_s();
        let coarse = psa(&signal(0.05, 301), 0.05, 0.05, &periods_s);
        let fine = psa(&signal(0.001, 15_001), 0.001, 0.05, &periods_s);
        for ((c, f), period_s) in coarse.iter().zip(&fine).zip(&periods_s) {
            assert!((c / f - 1.0).abs() < 0.012, "{period_s} s: {c} against {f}");
        }
    }

    #[test]
    fn a_step_gives_the_known_overshoot() {
        let got = psa(&vec![1.0; 4001], 0.001, 0.05, &[1.0])[0];
        let exact = 1.0 + (-PI * 0.05 / (1.0f64 - 0.0025).sqrt()).exp();
        assert!((got - exact).abs() < 1e-5, "{got} against {exact}");
    }

    #[test]
    fn a_stiff_oscillator_feels_the_peak_base_acceleration() {
        let a: Vec<f64> = (0..4001).map(|i| 0.3 * (2.0 * PI * 0.3 * i as f64 * 0.005).sin()).collect();
        assert!((psa(&a, 0.005, 0.05, &[0.05])[0] / 0.3 - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_constant_factor_is_its_logarithm() {
        let x: Vec<f64> = (0..2000).map(|i| (0.05 * i as f64).sin() * (-(i as f64) / 500.0).exp()).collect();
        let y: Vec<f64> = x.iter().map(|v| 1.3 * v).collect();
        assert!((psa_ln_rmse(&y, &x, 0.01) - 1.3f64.ln()).abs() < 1e-9);
        assert!(spectrum_ln_rmse(&[0.0], &[1.0]).is_nan());
        assert_eq!(psa(&[], 0.01, 0.05, &[1.0]), vec![0.0]);
    }

    #[test]
    fn periods_span_the_reported_range() {
        let periods_s = log_periods_s();
        assert!((periods_s[0] - 0.1).abs() < 1e-12 && (periods_s[N_PERIOD - 1] - 5.0).abs() < 1e-12);
    }
}
