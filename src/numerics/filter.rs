//! Zero-phase filters in the frequency domain: a real gain, hence no delay and no phase distortion.
//!
//! The ends are continued by odd reflection (`2 x₀ − x₋ₖ`), faded to a common value, before the transform, so that a
//! series that does not start or end at zero makes no step in the periodic continuation.

use super::spectrum::transforms;
use std::f64::consts::PI;

/// Applies a real gain of the frequency in Hz to a series, without delay.
///
/// ```text
/// y = F⁻¹[ g(f) F[x] ],  g real                                  (1)
/// ```
///
/// Limits: within about one period of the lowest frequency passed, the ends depend on the assumed continuation.
/// Check:  `a_sine_in_the_pass_band_keeps_amplitude_and_phase`.
pub fn zero_phase(x: &[f64], dt_s: f64, gain: impl Fn(f64) -> f64) -> Vec<f64> {
    let n = x.len();
    if n < 2 {
        return x.iter().map(|v| v * gain(0.0)).collect();
    }
    let pad = n - 1;
    let length = fast_length(n + 2 * pad);
    let (forward, inverse) = transforms(length);
    let mut series = continued(x, pad, length);
    let mut spectrum = forward.make_output_vec();
    forward.process(&mut series, &mut spectrum).expect("buffers made by the plan itself");
    let d_f = 1.0 / (length as f64 * dt_s);
    for (k, value) in spectrum.iter_mut().enumerate() {
        *value *= gain(k as f64 * d_f); // (1)
    }
    // A real series needs real end bins; multiplying by a real gain keeps them real up to the sign of zero.
    spectrum[0].im = 0.0;
    if length.is_multiple_of(2) {
        spectrum[length / 2].im = 0.0;
    }
    inverse.process(&mut spectrum, &mut series).expect("buffers made by the plan itself");
    series[pad..pad + n].iter().map(|v| v / length as f64).collect()
}

/// Low-pass of eighth order without delay (the gain of a fourth-order Butterworth filter run forth and back).
///
/// ```text
/// g(f) = 1 / (1 + (f/f_c)⁸)
/// ```
///
/// | symbol | argument  | unit | range          |
/// |--------|-----------|------|----------------|
/// | f_c    | corner_hz | Hz   | 0 … 0.5 / dt_s |
///
/// Limits: half the amplitude is left at the corner.
/// Check:  `low_pass_halves_the_corner_and_removes_what_is_above`.
pub fn low_pass_zero_phase(x: &[f64], dt_s: f64, corner_hz: f64) -> Vec<f64> {
    zero_phase(x, dt_s, |f| 1.0 / (1.0 + (f / corner_hz).powi(8)))
}

/// Band-pass of eighth order a side without delay; see [`low_pass_zero_phase`].
pub fn band_pass_zero_phase(x: &[f64], dt_s: f64, low_hz: f64, high_hz: f64) -> Vec<f64> {
    zero_phase(x, dt_s, |f| band_gain(f, low_hz, high_hz))
}

/// Gain of [`band_pass_zero_phase`] at the frequency `f_hz`.
pub fn band_gain(f_hz: f64, low_hz: f64, high_hz: f64) -> f64 {
    let low = (f_hz / low_hz).powi(8);
    (low / (1.0 + low)) / (1.0 + (f_hz / high_hz).powi(8))
}

/// Scales the first and the last `ramp` samples by a half cosine that starts and ends at zero.
pub fn taper_ends(x: &mut [f64], ramp: usize) {
    let n = x.len();
    let ramp = ramp.min(n / 2);
    for i in 0..ramp {
        let weight = 0.5 * (1.0 - (PI * i as f64 / ramp as f64).cos());
        x[i] *= weight;
        x[n - 1 - i] *= weight;
    }
}

/// Series index `i` of a series continued by odd reflection about both end values.
pub(super) fn reflected(x: &[f64], i: isize) -> f64 {
    let last = x.len() as isize - 1;
    if i < 0 {
        2.0 * x[0] - x[(-i).min(last) as usize]
    } else if i > last {
        2.0 * x[last as usize] - x[(2 * last - i).max(0) as usize]
    } else {
        x[i as usize]
    }
}

fn continued(x: &[f64], pad: usize, length: usize) -> Vec<f64> {
    let n = x.len() as isize;
    let middle = 0.5 * (x[0] + x[x.len() - 1]);
    let tail = length - pad - x.len();
    (0..length as isize)
        .map(|k| {
            let i = k - pad as isize;
            let value = reflected(x, i);
            let fraction = if i < 0 {
                (-i) as f64 / pad as f64
            } else if i >= n {
                (i - n + 1) as f64 / tail as f64
            } else {
                return value;
            };
            // Both continuations fade to the same value, where the period closes.
            let weight = 0.5 * (1.0 + (PI * fraction.min(1.0)).cos());
            middle + weight * (value - middle)
        })
        .collect()
}

/// The smallest `2^a 3^b 5^c ≥ n`: lengths that transform fast.
pub(super) fn fast_length(n: usize) -> usize {
    let mut best = n.next_power_of_two();
    let mut fives = 1;
    while fives < best {
        let mut threes = fives;
        while threes < best {
            let mut length = threes;
            while length < n {
                length *= 2;
            }
            best = best.min(length);
            threes *= 3;
        }
        fives *= 5;
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sine(f_hz: f64, n: usize, dt_s: f64) -> Vec<f64> {
        (0..n).map(|i| (2.0 * PI * f_hz * i as f64 * dt_s).sin()).collect()
    }

    #[test]
    fn a_sine_in_the_pass_band_keeps_amplitude_and_phase() {
        let x = sine(2.0, 4000, 0.005);
        let y = low_pass_zero_phase(&x, 0.005, 20.0);
        let worst = x.iter().zip(&y).skip(200).take(3600).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-6, "{worst}");
    }

    #[test]
    fn low_pass_halves_the_corner_and_removes_what_is_above() {
        let middle = |f_hz: f64| {
            let y = low_pass_zero_phase(&sine(f_hz, 4000, 0.005), 0.005, 10.0);
            y[1000..3000].iter().fold(0.0f64, |m, v| m.max(v.abs()))
        };
        assert!((middle(10.0) - 0.5).abs() < 2e-3, "{}", middle(10.0));
        assert!(middle(40.0) < 1e-4, "{}", middle(40.0));
    }

    #[test]
    fn a_constant_passes_unchanged_and_ends_do_not_ring() {
        let y = low_pass_zero_phase(&[3.0; 500], 0.01, 5.0);
        assert!(y.iter().all(|v| (v - 3.0).abs() < 1e-12));
        let line: Vec<f64> = (0..500).map(|i| i as f64 / 500.0).collect();
        let y = low_pass_zero_phase(&line, 0.01, 5.0);
        let worst = line.iter().zip(&y).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 2e-3, "{worst}");
    }

    #[test]
    fn fast_lengths_have_small_factors_and_are_not_below() {
        for n in [1, 2, 7, 97, 1000, 3001, 9001] {
            let mut m = fast_length(n);
            assert!(m >= n && m < n + n / 4 + 2, "{n} → {m}");
            for p in [2, 3, 5] {
                while m.is_multiple_of(p) {
                    m /= p;
                }
            }
            assert_eq!(m, 1);
        }
    }

    #[test]
    fn short_series_do_not_panic() {
        for n in 0..5 {
            assert_eq!(low_pass_zero_phase(&vec![1.0; n], 0.01, 5.0).len(), n);
        }
    }
}
