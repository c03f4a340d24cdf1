//! A filter that has the mean amplitude ratio of training events, and no more phase than that needs.

use super::history::fourier_frequencies_hz;
use crate::numerics::spectrum::{respond, transforms};
use realfft::num_complex::Complex;

/// Highest frequency of the filter, Hz; beyond it the amplitude stays.
const HIGHEST_HZ: f64 = 50.0;
/// Lines of the filter from zero to there.
const N_LINE: usize = 8192;
/// Band over which an amplitude ratio of records is believed, Hz; beyond it goes on with its end values.
const BELIEVED_HZ: [f64; 2] = [0.1, 25.0];

/// A causal filter of minimum phase.
///
/// ```text
/// ln|H(f)| = mean over events of ln A_out(f)/A_in(f)                                    (1)
/// H(f)     = exp( F[ w c ] ),  c = F⁻¹[ln|H|],  w = 1, 2 … 2, 1 on t = 0, t > 0, the middle; 0 behind     (2)
/// ```
///
/// A are Fourier amplitudes smoothed after Konno and Ohmachi. The phase is the least that a causal filter of this amplitude can have:
/// no travel time, which changes neither amplitudes nor response spectra.
///
/// Limits: a mean of logarithms is the ratio of a typical event; noise in the output counts as amplification.
/// Check:  `the_amplitude_is_the_mean_ratio_and_nothing_comes_before_its_cause`.
/// Source: Oppenheim and Schafer (2010), Discrete-Time Signal Processing, 3rd ed., sec. 13.6, eqs. 13.70–13.74.
#[derive(Debug, Clone)]
pub struct MatchedFilter {
    /// H at [`N_LINE`] + 1 lines from 0 to [`HIGHEST_HZ`].
    lines: Vec<Complex<f64>>,
}

impl MatchedFilter {
    /// Of smoothed Fourier amplitudes at [`fourier_frequencies_hz`], input and output of each event; `None` without a finite ratio.
    pub fn of(events: &[[&[f64]; 2]]) -> Option<Self> {
        let frequencies_hz = fourier_frequencies_hz();
        let [lowest_hz, highest_hz] = BELIEVED_HZ;
        let mean = |k: usize| {
            let ratios: Vec<f64> = events.iter().map(|[u, y]| (y[k] / u[k]).ln()).filter(|v| v.is_finite()).collect();
            ratios.iter().sum::<f64>() / ratios.len() as f64 // (1)
        };
        let knots: Vec<[f64; 2]> = (0..frequencies_hz.len())
            .filter(|k| frequencies_hz[*k] >= lowest_hz && frequencies_hz[*k] <= highest_hz)
            .map(|k| [frequencies_hz[k].ln(), mean(k)])
            .filter(|knot| knot[1].is_finite())
            .collect();
        (!knots.is_empty()).then(|| Self { lines: minimum_phase(&ln_amplitude(&knots)) })
    }

    /// What the filter makes of `input`.
    pub fn apply(&self, input: &[f64], dt_s: f64) -> Vec<f64> {
        let [output] = respond([input], dt_s, |f_hz, [v]| [v * self.at(f_hz)]);
        output
    }

    fn at(&self, f_hz: f64) -> Complex<f64> {
        let x = f_hz / HIGHEST_HZ * N_LINE as f64;
        let i = (x as usize).min(N_LINE - 1);
        let share = (x - i as f64).min(1.0);
        self.lines[i] + (self.lines[i + 1] - self.lines[i]) * share
    }
}

/// ln|H| at the lines of the filter, linear between `knots` of ln f and ln|H|.
fn ln_amplitude(knots: &[[f64; 2]]) -> Vec<f64> {
    let at = |ln_f: f64| {
        let i = knots.partition_point(|[x, _]| *x <= ln_f);
        match (i.checked_sub(1).map(|b| knots[b]), knots.get(i)) {
            (Some([x0, y0]), Some([x1, y1])) => y0 + (y1 - y0) * (ln_f - x0) / (x1 - x0),
            (Some([_, y]), None) => y,
            (None, knot) => knot.map_or(0.0, |[_, y]| *y),
        }
    };
    (0..=N_LINE).map(|k| at((k as f64 * HIGHEST_HZ / N_LINE as f64).ln())).collect()
}

fn minimum_phase(ln_amplitude: &[f64]) -> Vec<Complex<f64>> {
    let length = 2 * N_LINE;
    let (forward, inverse) = transforms(length);
    let mut spectrum: Vec<Complex<f64>> = ln_amplitude.iter().map(|v| Complex::new(*v, 0.0)).collect();
    let mut cepstrum = inverse.make_output_vec();
    inverse.process(&mut spectrum, &mut cepstrum).expect("buffers made by the plan itself");
    for (i, value) in cepstrum.iter_mut().enumerate() {
        let weight = match i {
            0 => 1.0,
            i if i < N_LINE => 2.0,
            i if i == N_LINE => 1.0,
            _ => 0.0,
        };
        *value *= weight / length as f64; // (2)
    }
    forward.process(&mut cepstrum, &mut spectrum).expect("buffers made by the plan itself");
    spectrum.iter().map(|v| v.exp()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::smoothed_fourier_amplitude;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn the_amplitude_is_the_mean_ratio_and_nothing_comes_before_its_cause() {
        let frequencies_hz = fourier_frequencies_hz();
        // A resonance of 2 Hz and 10 %, which is of minimum phase: its own answer to a pulse is known.
        let resonance = |f: f64| {
            let x = f / 2.0;
            Complex::new(1.0, 0.0) / Complex::new(1.0 - x * x, 0.2 * x)
        };
        let flat = vec![1.0; frequencies_hz.len()];
        let ratio: Vec<f64> = frequencies_hz.iter().map(|f| resonance(*f).norm()).collect();
        let filter = MatchedFilter::of(&[[&flat, &ratio], [&flat, &ratio]]).unwrap();
        for f in [0.5, 1.0, 2.0, 5.0, 15.0] {
            assert!((filter.at(f).norm() / resonance(f).norm() - 1.0).abs() < 0.03, "{f}");
        }
        for f in [0.5, 1.0, 1.8, 3.0] {
            let off = (filter.at(f) / resonance(f)).arg();
            // The amplitude stays beyond 25 Hz, where that of the resonance falls on: the phase that goes with it, 4/π f/25 Hz, is missing.
            assert!(off.abs() < 0.03 + 0.065 * f, "phase at {f} Hz is off by {off}");
        }
        let mut pulse = vec![0.0; 2000];
        pulse[1000] = 1.0;
        let answer = filter.apply(&pulse, 0.01);
        let power = |x: &[f64]| x.iter().map(|v| v * v).sum::<f64>();
        assert!(power(&answer[..998]) < 2e-3 * power(&answer), "{}", power(&answer[..998]) / power(&answer));
    }

    #[test]
    fn the_filter_of_some_events_gives_the_amplitudes_of_others() {
        let frequencies_hz = fourier_frequencies_hz();
        let mut random = random::stream(4, "matched filter");
        let mut motion = || -> Vec<f64> {
            (0..6000).map(|i| (-((f64::from(i) - 2000.0) / 900.0).powi(2)).exp() * normal(&mut random)).collect()
        };
        let layer = |f: f64| Complex::new(1.0, 0.0) / Complex::new((0.4 * f).cos(), 0.1 * (0.4 * f).sin());
        let event = |x: &[f64]| {
            let [y] = respond([x], 0.01, |f, [v]| [v * layer(f)]);
            [x, &y].map(|x| smoothed_fourier_amplitude(x, 0.01, &frequencies_hz))
        };
        let events: Vec<[Vec<f64>; 2]> = (0..8).map(|_| event(&motion())).collect();
        let borrowed: Vec<[&[f64]; 2]> = events.iter().map(|[u, y]| [u.as_slice(), y.as_slice()]).collect();
        let filter = MatchedFilter::of(&borrowed).unwrap();
        let new = motion();
        let [_, recorded] = event(&new);
        let predicted = smoothed_fourier_amplitude(&filter.apply(&new, 0.01), 0.01, &frequencies_hz);
        let errors: Vec<f64> = (0..frequencies_hz.len())
            .filter(|k| (0.5..15.0).contains(&frequencies_hz[*k]))
            .map(|k| (predicted[k] / recorded[k]).ln().abs())
            .collect();
        let worst = errors.iter().copied().fold(0.0, f64::max);
        assert!(worst < 0.25, "{worst}");
        assert!(MatchedFilter::of(&[]).is_none());
    }

    fn normal(random: &mut rand_chacha::ChaCha12Rng) -> f64 {
        StandardNormal.sample(random)
    }
}
