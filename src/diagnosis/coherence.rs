//! How much of a residual follows the recorded input, and could therefore be explained at all.

use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// Width of the bands over which spectra are averaged, Hz.
const BAND_HZ: f64 = 0.3;

/// The residual of one channel in one event, with the inputs it may follow.
#[derive(Debug, Clone)]
pub struct Trace<'a> {
    /// Frequencies of the bins, Hz, rising.
    pub frequencies_hz: &'a [f64],
    /// Spectra of the input: the channel's own component first, then the other.
    pub inputs: Vec<&'a [C64]>,
    /// Spectrum of the residual.
    pub residual: Vec<C64>,
}

/// Shares of the residual's power, from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Coherent {
    /// That follows the channel's own input, alike in all events.
    pub own: f64,
    /// That follows both components of the input together.
    pub both: f64,
}

/// Shares of the residual of one channel that follow the input in all `traces` (one an event) alike.
///
/// ```text
/// γ²(f) = s* G⁻¹ s / P_r,   s = Σ ū r,   G = Σ ū uᵀ,   P_r = Σ |r|²      sums over events and a band of 0.3 Hz    (1)
/// γ²    → 1 − (1 − γ²) n/(n − p)                                        n sums of p inputs                      (2)
/// share = Σ_f γ² P_r / Σ_f P_r                                                                               (3)
/// ```
///
/// Each event counts alike: inputs and residual are divided by the RMS of its own input.
///
/// Limits: a nonlinear model's error also depends on the strength of the event and is then not wholly coherent; delays of
/// more than a second blur within a band.
/// Check:  `what_follows_the_input_is_told_from_noise`, `noise_alone_has_no_coherent_share`.
/// Source: Bendat and Piersol (2010), Random Data, 4th ed., chapters 7 and 9.
pub fn coherent(traces: &[Trace<'_>]) -> Coherent {
    let scales: Vec<f64> = traces
        .iter()
        .map(|t| {
            let power: f64 = t.inputs.iter().flat_map(|u| u.iter()).map(C64::norm_sqr).sum();
            if power > 0.0 { 1.0 / power } else { 0.0 }
        })
        .collect();
    let highest = traces.iter().filter_map(|t| t.frequencies_hz.last()).fold(0.0f64, |m, f| m.max(*f));
    let (mut total, mut own, mut both) = (0.0, 0.0, 0.0);
    for band in 0..=(highest / BAND_HZ) as usize {
        let mut sums = Sums::default();
        for (trace, scale) in traces.iter().zip(&scales) {
            for (k, f) in trace.frequencies_hz.iter().enumerate() {
                if (f / BAND_HZ) as usize == band {
                    let second = trace.inputs.get(1).map_or(C64::default(), |u| u[k]);
                    sums.add([trace.inputs[0][k], second], trace.residual[k], *scale);
                }
            }
        }
        total += sums.residual;
        own += sums.residual * unbiased(sums.explained_by_first(), sums.count, 1.0);
        both += sums.residual * unbiased(sums.explained_by_both(), sums.count, 2.0);
    }
    let share = |part: f64| if total > 0.0 { (part / total).clamp(0.0, 1.0) } else { 0.0 };
    Coherent { own: share(own), both: share(both) }
}

/// (2); negative values stay, so that they cancel in the sum over bands.
fn unbiased(squared: f64, count: f64, inputs: f64) -> f64 {
    if count > inputs { 1.0 - (1.0 - squared) * count / (count - inputs) } else { 0.0 }
}

/// Sums of (1).
#[derive(Default)]
struct Sums {
    count: f64,
    residual: f64,
    cross: [C64; 2],
    input: [f64; 2],
    mixed: C64,
}

impl Sums {
    fn add(&mut self, u: [C64; 2], r: C64, scale: f64) {
        self.count += 1.0;
        self.residual += scale * r.norm_sqr();
        for (i, u) in u.iter().enumerate() {
            self.cross[i] += u.conj() * r * scale;
            self.input[i] += scale * u.norm_sqr();
        }
        self.mixed += u[0].conj() * u[1] * scale;
    }

    fn explained_by_first(&self) -> f64 {
        let power = self.input[0] * self.residual;
        if power > 0.0 { self.cross[0].norm_sqr() / power } else { 0.0 }
    }

    /// s* G⁻¹ s / P_r for two inputs.
    fn explained_by_both(&self) -> f64 {
        let determinant = self.input[0] * self.input[1] - self.mixed.norm_sqr();
        if determinant <= 1e-9 * self.input[0] * self.input[1] || self.residual == 0.0 {
            return self.explained_by_first();
        }
        let [a, b] = self.cross;
        let form = self.input[1] * a.norm_sqr() + self.input[0] * b.norm_sqr() - 2.0 * (a.conj() * self.mixed * b).re;
        form / determinant / self.residual
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    /// Shares for 8 events of residual = own·H₁ + other·H₂ + noise, at powers of their own.
    fn shares(own: f64, other: f64, noise: f64) -> Coherent {
        let mut stream = random::stream(2, "coherence");
        let mut normal = || -> f64 { StandardNormal.sample(&mut stream) };
        let frequencies: Vec<f64> = (10..400).map(|k| k as f64 * 0.025).collect();
        let events: Vec<[Vec<C64>; 3]> = (0..8)
            .map(|e| {
                let mut white = |size: f64| -> Vec<C64> {
                    frequencies.iter().map(|_| C64::new(normal(), normal()) * size).collect()
                };
                let size = 0.5 + f64::from(e);
                let (u, v, w) = (white(size), white(size), white(size));
                let h = |f: f64| C64::from_polar(1.0, 0.7 * f);
                let r = (0..u.len()).map(|k| (u[k] * own + v[k] * other) * h(frequencies[k]) + w[k] * noise).collect();
                [u, v, r]
            })
            .collect();
        let traces: Vec<Trace<'_>> = events
            .iter()
            .map(|[u, v, r]| Trace { frequencies_hz: &frequencies, inputs: vec![u, v], residual: r.clone() })
            .collect();
        coherent(&traces)
    }

    #[test]
    fn what_follows_the_input_is_told_from_noise() {
        let half = shares(1.0, 0.0, 1.0);
        assert!((half.own - 0.5).abs() < 0.05 && (half.both - 0.5).abs() < 0.05, "{half:?}");
        let crossed = shares(0.0, 3.0, 1.0);
        assert!(crossed.own.abs() < 0.03 && (crossed.both - 0.9).abs() < 0.03, "{crossed:?}");
        let all = shares(1.0, 0.5, 0.0);
        assert!(all.both > 0.98 && (all.own - 0.8).abs() < 0.04, "{all:?}");
    }

    #[test]
    fn noise_alone_has_no_coherent_share() {
        let none = shares(0.0, 0.0, 1.0);
        assert!(none.own < 0.02 && none.both < 0.02, "{none:?}");
        assert_eq!(coherent(&[]), Coherent::default());
    }
}
