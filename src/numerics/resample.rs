//! Change of the time step without aliasing: one windowed-sinc kernel for decimation, interpolation and half steps.
//!
//! The kernel is a Kaiser-windowed sinc whose transition ends at the lower of the two Nyquist frequencies: it passes
//! 80 % of that band unchanged and stops what would fold back. It is symmetric, so nothing is delayed; linear in the
//! samples, so that filtering input and response alike leaves the relation between them as it was.

use super::filter::reflected;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Share of the lower Nyquist frequency at which the kernel starts to fall.
pub const PASS_SHARE: f64 = 0.8;
/// Half width of the kernel in samples of the coarser series.
const HALF_WIDTH: f64 = 32.0;
/// Shape of the Kaiser window: stops to 1e-5.
const KAISER_BETA: f64 = 10.0;

/// The series at `start_s, start_s + dt_out_s, …` (`n_out` samples), band-limited for a step of `band_dt_s`.
///
/// ```text
/// y(t) = Σ_k x_k h(t − k dt),   h(τ) = 2 f_c dt sinc(2 f_c τ) w(τ),   Σ h = 1          (1)
/// f_c = 0.9 · 0.5 / max(dt, dt_band),   w Kaiser, β = 10
/// ```
///
/// | symbol  | argument  | unit | range               |
/// |---------|-----------|------|---------------------|
/// | dt      | dt_in_s   | s    | > 0                 |
/// | dt_band | band_dt_s | s    | > 0                 |
/// | t       | start_s   | s    | inside the series   |
///
/// Limits: within 32 coarse samples of an end the result depends on the odd reflection assumed beyond it.
/// Check:  `a_pass_band_sine_survives_any_change_of_step` and `what_would_fold_back_is_stopped`.
/// Source: Oppenheim and Schafer, Discrete-Time Signal Processing, section 7.5 (Kaiser window).
pub fn sample_band_limited(
    x: &[f64],
    dt_in_s: f64,
    start_s: f64,
    dt_out_s: f64,
    n_out: usize,
    band_dt_s: f64,
) -> Vec<f64> {
    if x.is_empty() {
        return Vec::new();
    }
    let stretch = (band_dt_s / dt_in_s).max(1.0);
    let mut kernels: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
    (0..n_out)
        .map(|i| {
            let position = (start_s + i as f64 * dt_out_s) / dt_in_s;
            let mut centre = position.floor();
            let mut phase = ((position - centre) * 1e9).round() as u64;
            if phase == 1_000_000_000 {
                (centre, phase) = (centre + 1.0, 0);
            }
            // Integer ratios of the steps have few phases; a cap keeps odd ratios from filling memory.
            if kernels.len() > 4096 {
                kernels.clear();
            }
            let kernel = kernels.entry(phase).or_insert_with(|| kernel(phase as f64 * 1e-9, stretch));
            let first = centre as isize - (kernel.len() as isize - 1) / 2;
            let inside = first >= 0 && first as usize + kernel.len() <= x.len();
            if inside {
                x[first as usize..].iter().zip(kernel.iter()).map(|(v, h)| v * h).sum()
            } else {
                kernel.iter().enumerate().map(|(k, h)| h * reflected(x, first + k as isize)).sum()
            }
        })
        .collect()
}

/// The whole series at another step, band-limited to the lower of the two Nyquist frequencies.
pub fn resample_band_limited(x: &[f64], dt_in_s: f64, dt_out_s: f64) -> Vec<f64> {
    if (dt_in_s / dt_out_s - 1.0).abs() < 1e-9 {
        return x.to_vec();
    }
    sample_band_limited(x, dt_in_s, 0.0, dt_out_s, resampled_len(x.len(), dt_in_s, dt_out_s), dt_out_s)
}

/// Every `factor`-th sample of the band-limited series.
pub fn decimate(x: &[f64], dt_s: f64, factor: usize) -> Vec<f64> {
    resample_band_limited(x, dt_s, dt_s * factor.max(1) as f64)
}

/// The series of [`resample_band_limited`] half a step later: at `dt/2, 3 dt/2, …`, one sample fewer.
///
/// Taken from the finer series with the same kernel, so that steps and half steps are one and the same signal.
pub fn half_steps(x: &[f64], dt_in_s: f64, dt_out_s: f64) -> Vec<f64> {
    let n = resampled_len(x.len(), dt_in_s, dt_out_s).saturating_sub(1);
    sample_band_limited(x, dt_in_s, 0.5 * dt_out_s, dt_out_s, n, dt_out_s)
}

/// Number of samples after [`resample_band_limited`]: those that lie within the series.
pub fn resampled_len(n: usize, dt_in_s: f64, dt_out_s: f64) -> usize {
    if n == 0 { 0 } else { ((n - 1) as f64 * dt_in_s / dt_out_s + 1e-6).floor() as usize + 1 }
}

/// Weights for a point `phase` (0…1) input samples after the centre; `stretch` input samples make one coarse sample.
fn kernel(phase: f64, stretch: f64) -> Vec<f64> {
    let reach = (HALF_WIDTH * stretch).ceil() as isize;
    let cut = 0.5 * (1.0 + PASS_SHARE) / stretch; // corner over the input's Nyquist frequency
    let mut weights: Vec<f64> = (-reach..=reach)
        .map(|k| {
            let tau = phase - k as f64;
            let u = tau / (HALF_WIDTH * stretch);
            let window = if u.abs() < 1.0 { bessel_i0(KAISER_BETA * (1.0 - u * u).sqrt()) } else { 0.0 };
            sinc(cut * tau) * window // (1)
        })
        .collect();
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|w| *w /= sum);
    weights
}

fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-12 { 1.0 } else { (PI * x).sin() / (PI * x) }
}

/// Modified Bessel function I₀ by its power series.
fn bessel_i0(x: f64) -> f64 {
    let (mut term, mut sum) = (1.0, 1.0);
    for k in 1..60 {
        term *= (0.5 * x / k as f64).powi(2);
        sum += term;
        if term < 1e-17 * sum {
            break;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sine(f_hz: f64, n: usize, dt_s: f64, phase: f64) -> Vec<f64> {
        (0..n).map(|i| (2.0 * PI * f_hz * i as f64 * dt_s + phase).sin()).collect()
    }

    fn worst(a: &[f64], b: &[f64], skip: usize) -> f64 {
        a.iter().zip(b).skip(skip).take(a.len() - 2 * skip).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn a_pass_band_sine_survives_any_change_of_step() {
        for (dt_in, dt_out) in [(0.005, 0.05), (0.01, 0.05), (0.01, 0.005), (0.004, 0.05), (1.0 / 256.0, 0.005)] {
            let f_hz = 0.79 * 0.5 / f64::max(dt_in, dt_out);
            let y = resample_band_limited(&sine(f_hz, 30_000, dt_in, 0.3), dt_in, dt_out);
            let skip = (40.0 * f64::max(1.0, dt_in / dt_out)) as usize;
            let error = worst(&y, &sine(f_hz, y.len(), dt_out, 0.3), skip);
            assert!(error < 1e-4, "{dt_in} → {dt_out}: {error}");
        }
    }

    #[test]
    fn what_would_fold_back_is_stopped() {
        for f_hz in [10.05, 12.0, 19.0, 33.0, 80.0] {
            let y = decimate(&sine(f_hz, 12_000, 0.005, 0.1), 0.005, 10);
            let left = y[40..y.len() - 40].iter().fold(0.0f64, |m, v| m.max(v.abs()));
            assert!(left < 1e-4, "{f_hz} Hz: {left}");
        }
    }

    #[test]
    fn half_steps_lie_on_the_same_signal() {
        for dt_in in [0.005, 0.01] {
            let y = half_steps(&sine(3.0, 6001, dt_in, 0.0), dt_in, 0.05);
            let exact: Vec<f64> = (0..y.len()).map(|i| (2.0 * PI * 3.0 * (i as f64 + 0.5) * 0.05).sin()).collect();
            assert!(worst(&exact, &y, 40) < 1e-4);
            assert_eq!(y.len() + 1, decimate(&vec![0.0; 6001], dt_in, (0.05 / dt_in).round() as usize).len());
        }
    }

    #[test]
    fn constants_and_lines_are_kept_to_the_ends() {
        let line: Vec<f64> = (0..1001).map(|i| 2.0 - 0.01 * i as f64).collect();
        for (i, value) in decimate(&line, 0.005, 10).iter().enumerate() {
            assert!((value - (2.0 - 0.1 * i as f64)).abs() < 1e-6, "{i}: {value}");
        }
    }

    #[test]
    fn lengths_are_those_within_the_series() {
        assert_eq!(resampled_len(3001, 0.005, 0.05), 301);
        assert_eq!(resampled_len(3000, 0.005, 0.05), 300);
        assert_eq!(resampled_len(0, 0.005, 0.05), 0);
        assert_eq!(decimate(&[1.0], 0.005, 10), vec![1.0]);
        assert!(half_steps(&[], 0.005, 0.05).is_empty());
    }
}
