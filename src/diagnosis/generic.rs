//! The correction that names nothing: a smooth complex factor for each sensor, where no effect of the catalogue explains
//! what is left. It is not physics and is never reported as such.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use realfft::num_complex::Complex;
use serde::{Deserialize, Serialize};

type C64 = Complex<f64>;

/// B-splines of a factor.
const SPLINES: usize = 10;
/// Ridges tried, as shares of the mean diagonal; validation chooses.
const RIDGES: [f64; 7] = [1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0];

/// Prediction and record of one channel in one event.
#[derive(Debug, Clone)]
pub struct Pair {
    /// Frequencies of the bins, Hz.
    pub frequencies_hz: Vec<f64>,
    /// Spectrum that the model predicts.
    pub predicted: Vec<C64>,
    /// Spectrum that was recorded.
    pub measured: Vec<C64>,
}

/// A smooth complex factor on what a model predicts for one sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GenericCorrection {
    /// Band in which it was fitted, Hz; beyond it the end values hold.
    pub band_hz: [f64; 2],
    /// Real and imaginary parts of the coefficients.
    pub coefficients: Vec<[f64; 2]>,
    /// Ridge that validation chose, as a share of the mean diagonal.
    pub ridge: f64,
    /// Residual power on the validation events, before and after, over that of the records.
    pub validation: [f64; 2],
}

/// Fits the factor on `train` and chooses its stiffness on `validation`; `None` where it does not lower the residual there.
///
/// ```text
/// C(f) = 1 + Σ_b c_b φ_b(f)      φ_b cubic B-splines over the band, constant outside            (1)
/// min over c of Σ_e Σ_f |Y − C Ŷ|²/P_e + λ Σ_b |c_b|²      P_e = Σ_f |Y|² of the event            (2)
/// ```
///
/// Limits: linear and the same in all events; a delay of much more than the inverse distance of the knots is beyond it.
/// Check:  `a_smooth_error_is_taken_out_and_noise_is_left_alone`.
/// Source: de Boor (2001), A Practical Guide to Splines, for φ.
pub fn fit(train: &[Pair], validation: &[Pair], band_hz: [f64; 2]) -> Option<GenericCorrection> {
    let (mut normal, mut right) = (vec![C64::default(); SPLINES * SPLINES], vec![C64::default(); SPLINES]);
    for pair in train {
        let power: f64 = pair.measured.iter().map(C64::norm_sqr).sum();
        let weight = if power > 0.0 { 1.0 / power } else { 0.0 };
        for ((f, predicted), measured) in pair.frequencies_hz.iter().zip(&pair.predicted).zip(&pair.measured) {
            let phi = splines(*f, band_hz);
            let own = weight * predicted.norm_sqr();
            let cross = predicted.conj() * (measured - predicted) * weight;
            for i in 0..SPLINES {
                right[i] += cross * phi[i];
                for j in 0..SPLINES {
                    normal[i * SPLINES + j] += own * phi[i] * phi[j];
                }
            }
        }
    }
    let mean = (0..SPLINES).map(|i| normal[i * SPLINES + i].re).sum::<f64>() / SPLINES as f64;
    let before = misfit(validation, |_| C64::new(1.0, 0.0));
    let candidates = RIDGES.iter().filter_map(|ridge| {
        // The normal matrix is real, so both parts of the coefficients solve the same equations.
        let matrix =
            Mat::from_fn(SPLINES, SPLINES, |i, j| normal[i * SPLINES + j].re + if i == j { ridge * mean } else { 0.0 });
        let sides = Mat::from_fn(SPLINES, 2, |i, part| if part == 0 { right[i].re } else { right[i].im });
        let solved = matrix.llt(Side::Lower).ok()?.solve(sides);
        let coefficients = (0..SPLINES).map(|i| [solved[(i, 0)], solved[(i, 1)]]).collect();
        let mut found = GenericCorrection { band_hz, coefficients, ridge: *ridge, validation: [before; 2] };
        found.validation[1] = misfit(validation, |f| found.factor(f));
        Some(found)
    });
    candidates
        .min_by(|a, b| a.validation[1].total_cmp(&b.validation[1]))
        .filter(|best| best.validation[1] < best.validation[0])
}

/// Residual power under `factor`, over that of the records, mean over the events.
fn misfit(pairs: &[Pair], factor: impl Fn(f64) -> C64) -> f64 {
    let of = |pair: &Pair| {
        let bins = pair.frequencies_hz.iter().zip(&pair.predicted).zip(&pair.measured);
        let rest: f64 = bins.map(|((f, p), m)| (m - factor(*f) * p).norm_sqr()).sum();
        let power: f64 = pair.measured.iter().map(C64::norm_sqr).sum();
        rest / power.max(f64::MIN_POSITIVE)
    };
    pairs.iter().map(of).sum::<f64>() / pairs.len().max(1) as f64
}

impl GenericCorrection {
    /// (1).
    pub fn factor(&self, frequency_hz: f64) -> C64 {
        let phi = splines(frequency_hz, self.band_hz);
        let sum: C64 = phi.iter().zip(&self.coefficients).map(|(phi, c)| C64::new(c[0], c[1]) * phi).sum();
        sum + 1.0
    }
}

/// Uniform cubic B-splines at a frequency; beyond the band those of its end.
fn splines(frequency_hz: f64, [low, high]: [f64; 2]) -> [f64; SPLINES] {
    let intervals = (SPLINES - 3) as f64;
    let x = ((frequency_hz - low) / (high - low)).clamp(0.0, 1.0) * intervals;
    let i = (x as usize).min(SPLINES - 4);
    let t = x - i as f64;
    let mut phi = [0.0; SPLINES];
    phi[i] = (1.0 - t).powi(3) / 6.0;
    phi[i + 1] = (3.0 * t.powi(3) - 6.0 * t * t + 4.0) / 6.0;
    phi[i + 2] = (-3.0 * t.powi(3) + 3.0 * t * t + 3.0 * t + 1.0) / 6.0;
    phi[i + 3] = t.powi(3) / 6.0;
    phi
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};
    use std::f64::consts::TAU;

    fn pairs(seed: u64, count: usize, truth: impl Fn(f64) -> C64, noise: f64) -> Vec<Pair> {
        let mut stream = random::stream(seed, "generic correction");
        let mut normal = || -> f64 { StandardNormal.sample(&mut stream) };
        let frequencies: Vec<f64> = (8..380).map(|k| k as f64 * 0.025).collect();
        (0..count)
            .map(|e| {
                let size = 1.0 + e as f64;
                let predicted: Vec<C64> = frequencies.iter().map(|_| C64::new(normal(), normal()) * size).collect();
                let measured = frequencies
                    .iter()
                    .zip(&predicted)
                    .map(|(f, p)| truth(*f) * p + C64::new(normal(), normal()) * noise * size)
                    .collect();
                Pair { frequencies_hz: frequencies.clone(), predicted, measured }
            })
            .collect()
    }

    #[test]
    fn a_smooth_error_is_taken_out_and_noise_is_left_alone() {
        let truth = |f: f64| C64::from_polar(0.8 + 0.03 * f, -TAU * f * 0.02);
        let found = fit(&pairs(1, 6, truth, 0.05), &pairs(2, 3, truth, 0.05), [0.2, 9.5]).unwrap();
        assert!(found.validation[0] > 0.1 && found.validation[1] < 0.005, "{:?}", found.validation);
        for f in [0.5, 2.0, 5.0, 9.0] {
            assert!((found.factor(f) - truth(f)).norm() < 0.03, "{f} Hz");
        }
        let one = |_: f64| C64::new(1.0, 0.0);
        if let Some(found) = fit(&pairs(3, 6, one, 0.3), &pairs(4, 3, one, 0.3), [0.2, 9.5]) {
            assert!(found.validation[1] > 0.97 * found.validation[0], "{:?}", found.validation);
        }
    }

    #[test]
    fn splines_add_up_to_one_and_are_smooth() {
        for k in 0..200 {
            let f = k as f64 * 0.05;
            let [a, b] = [f, f + 1e-6].map(|f| splines(f, [0.2, 9.5]));
            assert!((a.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5));
        }
        assert!(fit(&[], &[], [0.2, 9.5]).is_none());
    }
}
