//! A complex response of frequency on time series, without wrap-around.

use super::filter::fast_length;
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::f64::consts::PI;
use std::sync::{Arc, LazyLock, Mutex, PoisonError};

/// Transforms that were planned already: a plan takes longer than a transform.
static PLANNER: LazyLock<Mutex<RealFftPlanner<f64>>> = LazyLock::new(|| Mutex::new(RealFftPlanner::new()));

/// The transform of `length` real values, and its inverse, which is so many times the series.
pub fn transforms(length: usize) -> (Arc<dyn RealToComplex<f64>>, Arc<dyn ComplexToReal<f64>>) {
    let mut planner = PLANNER.lock().unwrap_or_else(PoisonError::into_inner);
    (planner.plan_fft_forward(length), planner.plan_fft_inverse(length))
}

/// Spectra of `series`, which share a length, are changed in place by `change(f_hz, spectra)` and transformed back.
///
/// ```text
/// y = F⁻¹[ O(f) F[x] ],   F[x](f) = Σ x(t) exp(−i 2π f t)                (1)
/// ```
///
/// Before and behind, a series goes on with its end value, which fades to zero over half its length, and as much again
/// is zero: an echo of up to a series' length does not wrap around. Where no constant passes, it goes on with zero: what has passed a
/// high-pass has no constant part, and undoing that would make one out of the noise of the end value.
///
/// Limits: what a response brings in from before the first sample is the assumed continuation.
/// Check:  `a_delay_moves_a_pulse_and_nothing_wraps_around`, `a_constant_and_its_ends_stay`.
pub fn respond<const N: usize>(
    series: [&[f64]; N],
    dt_s: f64,
    mut change: impl FnMut(f64, [Complex<f64>; N]) -> [Complex<f64>; N],
) -> [Vec<f64>; N] {
    let n = series.iter().map(|x| x.len()).max().unwrap_or(0);
    if n == 0 {
        return series.map(<[f64]>::to_vec);
    }
    let fade = n / 2 + 64;
    let length = fast_length(2 * n + 2 * fade);
    let zero = Complex::new(0.0, 0.0);
    let constant = |i: usize| std::array::from_fn(|j| if i == j { Complex::new(1.0, 0.0) } else { zero });
    let goes_on = (0..N).any(|i| change(0.0, constant(i)) != [zero; N]);
    let (forward, inverse) = transforms(length);
    let mut spectra = series.map(|x| {
        let ends = if goes_on { [x[0], x[x.len() - 1]] } else { [0.0; 2] };
        let mut padded = continued(x, ends, fade, length);
        let mut spectrum = forward.make_output_vec();
        forward.process(&mut padded, &mut spectrum).expect("buffers made by the plan itself");
        spectrum
    });
    let d_f = 1.0 / (length as f64 * dt_s);
    for k in 0..length / 2 + 1 {
        let changed = change(k as f64 * d_f, std::array::from_fn(|i| spectra[i][k]));
        for (spectrum, value) in spectra.iter_mut().zip(changed) {
            spectrum[k] = value; // (1)
        }
    }
    spectra.map(|mut spectrum| {
        // A real series needs real end bins.
        spectrum[0].im = 0.0;
        if length.is_multiple_of(2) {
            spectrum[length / 2].im = 0.0;
        }
        let mut back = inverse.make_output_vec();
        inverse.process(&mut spectrum, &mut back).expect("buffers made by the plan itself");
        back[fade..fade + n].iter().map(|v| v / length as f64).collect()
    })
}

/// Frequencies, Hz, and values of the spectrum of `series`, followed by as many zeros as it is long or more.
pub fn spectrum(series: &[f64], dt_s: f64) -> (Vec<f64>, Vec<Complex<f64>>) {
    let length = fast_length(2 * series.len().max(1));
    let mut padded = series.to_vec();
    padded.resize(length, 0.0);
    let (forward, _) = transforms(length);
    let mut spectrum = forward.make_output_vec();
    forward.process(&mut padded, &mut spectrum).expect("buffers made by the plan itself");
    ((0..spectrum.len()).map(|k| k as f64 / (length as f64 * dt_s)).collect(), spectrum)
}

/// `x` after so many samples that lead up to it, and before as many that lead away, from and to zero; next to it are these values.
fn continued(x: &[f64], [first, last]: [f64; 2], fade: usize, length: usize) -> Vec<f64> {
    let mut padded = vec![0.0; length];
    padded[fade..fade + x.len()].copy_from_slice(x);
    for i in 0..fade {
        let weight = 0.5 * (1.0 + (PI * (i + 1) as f64 / (fade + 1) as f64).cos());
        padded[fade - 1 - i] = first * weight;
        padded[fade + x.len() + i] = last * weight;
    }
    padded
}

#[cfg(test)]
mod tests {
    use super::*;

    fn delayed(x: &[f64], dt_s: f64, delay_s: f64) -> Vec<f64> {
        let [y] = respond([x], dt_s, |f, [v]| [v * Complex::from_polar(1.0, -2.0 * PI * f * delay_s)]);
        y
    }

    #[test]
    fn a_delay_moves_a_pulse_and_nothing_wraps_around() {
        let dt = 0.01;
        let pulse = |t: f64| (-((t - 1.0) / 0.05).powi(2)).exp();
        let x: Vec<f64> = (0..300).map(|i| pulse(i as f64 * dt)).collect();
        for delay in [0.0137, -0.3, 1.5, 2.9] {
            for (i, v) in delayed(&x, dt, delay).iter().enumerate() {
                assert!((v - pulse(i as f64 * dt - delay)).abs() < 1e-9, "{delay} {i}");
            }
        }
    }

    #[test]
    fn a_constant_and_its_ends_stay() {
        let y = delayed(&[2.0; 400], 0.01, 0.033);
        assert!(y.iter().all(|v| (v - 2.0).abs() < 2e-3), "{:?}", y.iter().fold(0.0f64, |m, v| m.max((v - 2.0).abs())));
    }

    /// A high-pass of second order with its corner at 0.3 Hz.
    fn high_pass(f: f64) -> Complex<f64> {
        let stage = Complex::new(f, 0.0) / Complex::new(f, -0.3);
        stage * stage
    }

    #[test]
    fn undoing_a_high_pass_makes_no_motion_out_of_the_noise_of_an_end() {
        let dt = 0.01;
        let x: Vec<f64> = (0..1200).map(|i| i as f64 * dt - 5.0).map(|t| (-t * t).exp() * (9.0 * t).sin()).collect();
        let [mut recorded] = respond([&x], dt, |f, [v]| [v * high_pass(f)]);
        recorded[1199] += 0.02;
        let undone = |f| high_pass(f).conj() / (high_pass(f).norm_sqr() + 1e-3);
        let [back] = respond([&recorded], dt, |f, [v]| [v * undone(f)]);
        let worst = back[..1190].iter().zip(&x).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 0.01, "{worst}");
    }

    #[test]
    fn series_are_mixed_at_each_frequency() {
        let (x, y) = ([1.0, -2.0, 3.0, 0.5], [0.0, 1.0, 0.0, -1.0]);
        let [a, b] = respond([&x, &y], 0.1, |_, [u, v]| [u + v, v * 2.0]);
        for i in 0..4 {
            assert!((a[i] - x[i] - y[i]).abs() < 1e-12 && (b[i] - 2.0 * y[i]).abs() < 1e-12);
        }
        assert_eq!(respond([&[]], 0.1, |_, v| v)[0], Vec::<f64>::new());
    }
}
