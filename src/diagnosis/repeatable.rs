//! Which part of a model's error is the same in every event: only that part can a correction of the site take out.

use super::generic::Pair;
use realfft::num_complex::Complex;

/// Bands of the partition, equally wide in ln f.
const BANDS: usize = 10;

/// Variances of ln |record/prediction| of one channel, by band of frequency and event.
#[derive(Debug, Clone, PartialEq)]
pub struct Partition {
    /// Mean squared bias that all events share, by band.
    pub bias: f64,
    /// Variance of an event's own level.
    pub event: f64,
    /// Variance of what is left.
    pub rest: f64,
}

impl Partition {
    /// Share of the bias, from 0 to 1; below 0.3 hardly any correction of the site helps.
    pub fn repeatable_share(&self) -> f64 {
        let total = self.bias + self.event + self.rest;
        if total > 0.0 { self.bias / total } else { 0.0 }
    }
}

/// Splits the amplitude error of one channel, a pair an event, over the band `[low, high]` in Hz.
///
/// ```text
/// ln (|Y|/|Ŷ|)_{e,b} = bias_b + η_e + ε_{e,b}                            (1)
/// ```
///
/// by two-way analysis of variance, with the part of η and ε in the mean over events taken off the bias.
///
/// Limits: amplitudes only; `None` with fewer than two events or a band without power.
/// Check:  `the_parts_of_a_known_mixture_are_found`.
/// Source: Searle, Casella and McCulloch (1992), Variance Components, chapter 4; Thompson et al. (2012) for its use on transfer functions.
pub fn partition(pairs: &[Pair], [low_hz, high_hz]: [f64; 2]) -> Option<Partition> {
    let width = (high_hz / low_hz).ln() / BANDS as f64;
    let levels: Vec<Vec<f64>> = pairs
        .iter()
        .map(|pair| {
            let mut power = [[0.0; 2]; BANDS];
            for ((f, p), m) in pair.frequencies_hz.iter().zip(&pair.predicted).zip(&pair.measured) {
                let x = (f / low_hz).ln() / width;
                if x >= 0.0 && (x as usize) < BANDS {
                    power[x as usize][0] += Complex::norm_sqr(m);
                    power[x as usize][1] += Complex::norm_sqr(p);
                }
            }
            power.iter().map(|[m, p]| 0.5 * (m / p).ln()).collect()
        })
        .collect();
    of_levels(&levels)
}

/// (1) for `levels[event][band]`.
fn of_levels(levels: &[Vec<f64>]) -> Option<Partition> {
    let (events, bands) = (levels.len(), levels.first()?.len());
    if events < 2 || bands < 2 || levels.iter().flatten().any(|v| !v.is_finite()) {
        return None;
    }
    let (n, m) = (events as f64, bands as f64);
    let of_event: Vec<f64> = levels.iter().map(|l| l.iter().sum::<f64>() / m).collect();
    let of_band: Vec<f64> = (0..bands).map(|b| levels.iter().map(|l| l[b]).sum::<f64>() / n).collect();
    let grand = of_event.iter().sum::<f64>() / n;
    let mut rest = 0.0;
    for (level, event) in levels.iter().zip(&of_event) {
        for (v, band) in level.iter().zip(&of_band) {
            rest += (v - event - band + grand).powi(2);
        }
    }
    let rest = rest / ((n - 1.0) * (m - 1.0));
    let between = of_event.iter().map(|e| (e - grand).powi(2)).sum::<f64>() / (n - 1.0);
    let event = (between - rest / m).max(0.0);
    let bias = (of_band.iter().map(|b| b * b).sum::<f64>() / m - (rest + event) / n).max(0.0);
    Some(Partition { bias, event, rest })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    fn mixture(bias: f64, event: f64, rest: f64) -> Partition {
        let mut stream = random::stream(4, "partition");
        let mut normal =
            |sd: f64| -> f64 { sd * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut stream) };
        let of_band: Vec<f64> = (0..40).map(|_| normal(bias)).collect();
        let levels: Vec<Vec<f64>> = (0..40)
            .map(|_| {
                let eta = normal(event);
                of_band.iter().map(|b| b + eta + normal(rest)).collect()
            })
            .collect();
        of_levels(&levels).unwrap()
    }

    #[test]
    fn the_parts_of_a_known_mixture_are_found() {
        let p = mixture(0.3, 0.2, 0.4);
        for (found, truth) in [(p.bias, 0.09), (p.event, 0.04), (p.rest, 0.16)] {
            assert!((found / truth - 1.0).abs() < 0.35, "{p:?}");
        }
        assert!(mixture(0.0, 0.2, 0.4).repeatable_share() < 0.05);
        assert!(mixture(0.5, 0.0, 0.1).repeatable_share() > 0.9);
        assert!(of_levels(&[vec![0.1, 0.2]]).is_none());
    }

    #[test]
    fn a_gain_is_all_bias() {
        let one = realfft::num_complex::Complex::new(1.0, 0.0);
        let pair = |size: f64| Pair {
            frequencies_hz: (1..400).map(|k| k as f64 * 0.025).collect(),
            predicted: vec![one * size; 399],
            measured: vec![one * 1.5 * size; 399],
        };
        let found = partition(&[pair(1.0), pair(3.0), pair(0.2)], [0.3, 9.0]).unwrap();
        assert!((found.bias - 1.5f64.ln().powi(2)).abs() < 1e-9 && found.repeatable_share() > 0.999);
    }
}
