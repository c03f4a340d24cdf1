//! Fourier amplitude, smoothed evenly over the logarithm of frequency.

use crate::numerics::spectrum::spectrum;
use std::f64::consts::PI;

/// Bandwidth coefficient b of the window: 40 is what the field uses for ratios of spectra.
const BANDWIDTH: f64 = 40.0;
/// The window is cut where its argument passes this: its side lobes are below 1.4 · 10⁻⁵ there.
const REACH: f64 = 5.0 * PI;

/// Fourier amplitude of `x` at `frequencies_hz`, smoothed with the window of Konno and Ohmachi.
///
/// ```text
/// A(f_c) = Σ W(f, f_c) |X(f)| dt / Σ W(f, f_c),   X(f) = Σ x(t) exp(−i 2π f t)               (1)
/// W      = [ sin(b log₁₀ f/f_c) / (b log₁₀ f/f_c) ]⁴,  b = 40                               (2)
/// ```
///
/// | symbol | argument       | shape      | unit | range |
/// |--------|----------------|------------|------|-------|
/// | x      | x              | `[n_step]` | m/s² |       |
/// | f_c    | frequencies_hz | `[n]`      | Hz   | > 0   |
/// | A      | returned       | `[n]`      | m/s  |       |
///
/// Limits: NaN where no line of the spectrum lies within the window, as above the Nyquist frequency.
/// Check:  `the_window_is_that_of_an_independent_implementation`, `a_factor_is_its_logarithm_at_every_frequency`.
/// Source: Konno and Ohmachi (1998), Ground-motion characteristics estimated from spectral ratio, BSSA 88, 228–241, eq. 4.
pub fn smoothed_fourier_amplitude(x: &[f64], dt_s: f64, frequencies_hz: &[f64]) -> Vec<f64> {
    let (lines_hz, values) = spectrum(x, dt_s);
    let amplitude: Vec<f64> = values.iter().map(|v| v.norm() * dt_s).collect();
    let step_hz = lines_hz.get(1).copied().unwrap_or(f64::INFINITY);
    let factor = 10f64.powf(REACH / BANDWIDTH);
    let smoothed = |centre_hz: &f64| {
        let first = ((centre_hz / factor / step_hz).ceil() as usize).max(1);
        let last = ((centre_hz * factor / step_hz).floor() as usize).min(amplitude.len().saturating_sub(1));
        if *centre_hz > lines_hz[lines_hz.len() - 1] || first > last {
            return f64::NAN;
        }
        let (mut sum, mut weights) = (0.0, 0.0);
        for k in first..=last {
            let weight = window(lines_hz[k] / centre_hz);
            sum += weight * amplitude[k];
            weights += weight;
        }
        if weights > 0.0 { sum / weights } else { f64::NAN } // (1)
    };
    frequencies_hz.iter().map(smoothed).collect()
}

fn window(ratio: f64) -> f64 {
    let argument = BANDWIDTH * ratio.log10();
    if argument.abs() < 1e-6 { 1.0 } else { (argument.sin() / argument).powi(4) } // (2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::made_up::{DT_S, observed, predicted};

    /// `python tests/metrics/vectors.py` with obspy 1.5.1: `konno_ohmachi_smoothing_window` on the lines of a transform of twice
    /// the length.
    const OBSERVED_M_S: [f64; 5] =
        [1.247392834839734, 2.0549700261081023, 0.2612373830947335, 0.29217347190528137, 0.3697681680047221];
    const PREDICTED_M_S: [f64; 5] =
        [1.4968696423412116, 2.465963525850805, 0.3134830421257951, 0.20452229801346583, 0.25883829369165906];

    #[test]
    fn the_window_is_that_of_an_independent_implementation() {
        let frequencies_hz = [1.2, 1.3, 1.5, 4.5, 4.7];
        for (x, expected) in [(observed(), OBSERVED_M_S), (predicted(), PREDICTED_M_S)] {
            let got = smoothed_fourier_amplitude(&x, DT_S, &frequencies_hz);
            for (got, expected) in got.iter().zip(expected) {
                assert!((got / expected - 1.0).abs() < 2e-3, "{got} {expected}");
            }
        }
    }

    #[test]
    fn a_factor_is_its_logarithm_at_every_frequency() {
        let x = observed();
        let twice: Vec<f64> = x.iter().map(|v| 2.0 * v).collect();
        let [a, b] = [&x, &twice].map(|x| smoothed_fourier_amplitude(x, DT_S, &[0.3, 3.0, 30.0]));
        assert!(a.iter().zip(&b).all(|(a, b)| ((b / a).ln() - 2f64.ln()).abs() < 1e-12));
        assert!(smoothed_fourier_amplitude(&x, DT_S, &[60.0])[0].is_nan());
        assert!(smoothed_fourier_amplitude(&[], DT_S, &[1.0])[0].is_nan());
    }
}
