//! Natural-log ratio of two spectra: bias and scatter by band.

use serde::{Deserialize, Serialize};

/// Bias and scatter of ln(predicted/observed), band by band.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LnRatio {
    /// Mean in each band; `None` where a band has no finite ratio.
    pub bias: Vec<Option<f64>>,
    /// Standard deviation in each band, about its mean.
    pub sigma: Vec<Option<f64>>,
    /// One number for all: see [`Bands::rms_of`].
    pub rms: Option<f64>,
}

/// Bands of frequency or period, and which of them count for the one number.
pub struct Bands {
    /// Lower and upper edge of each.
    pub edges: Vec<[f64; 2]>,
    /// First and last value that counts for [`LnRatio::rms`].
    pub counted: [f64; 2],
    /// What the one number is made of.
    pub rms_of: RmsOf,
}

/// What the one number of a ratio is the root mean square of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RmsOf {
    /// The bias of each band: scatter within a band does not count.
    Bias,
    /// The ratio at every ordinate.
    Ordinates,
}

impl LnRatio {
    /// Of two spectra at the same `abscissae`.
    ///
    /// ```text
    /// e_i = ln p_i/a_i,   b = mean e,   σ² = mean (e − b)²   over the ordinates of a band     (1)
    /// ```
    ///
    /// | symbol | argument            | shape |
    /// |--------|---------------------|-------|
    /// | p, a   | predicted, observed | `[n]` |
    ///
    /// Limits: an ordinate counts only where both spectra are positive; a ratio of two noises counts as any other.
    /// Check:  `a_factor_is_all_bias_and_a_wave_all_scatter`.
    /// Source: Kaklamanos, Bradley, Thompson and Baise (2013), Critical parameters affecting bias and variability in site-response
    /// analyses, BSSA 103, 1733–1749: residuals of ln amplitudes.
    pub fn of(abscissae: &[f64], predicted: &[f64], observed: &[f64], bands: &Bands) -> Self {
        let ordinates: Vec<(f64, f64)> = abscissae
            .iter()
            .zip(predicted.iter().zip(observed))
            .map(|(x, (p, a))| (*x, (p / a).ln()))
            .filter(|(_, e)| e.is_finite())
            .collect();
        let within = |[low, high]: [f64; 2]| -> Vec<f64> {
            ordinates.iter().filter(|(x, _)| *x >= low && *x < high).map(|(_, e)| *e).collect()
        };
        let bias: Vec<Option<f64>> = bands.edges.iter().map(|band| mean(&within(*band))).collect();
        let sigma = bands.edges.iter().zip(&bias).map(|(band, bias)| {
            let squares: Vec<f64> =
                within(*band).iter().map(|e| (e - (*bias)?).powi(2).into()).collect::<Option<_>>()?;
            mean(&squares).map(f64::sqrt) // (1)
        });
        let sigma = sigma.collect();
        let [first, last] = bands.counted;
        let counted: Vec<f64> = match bands.rms_of {
            RmsOf::Ordinates => ordinates.iter().filter(|(x, _)| *x >= first && *x <= last).map(|(_, e)| *e).collect(),
            RmsOf::Bias => {
                let inside = |[low, high]: &[f64; 2]| *low >= first * (1.0 - 1e-9) && *high <= last * (1.0 + 1e-9);
                let counted = bands.edges.iter().zip(&bias).filter(|(band, _)| inside(band));
                counted.filter_map(|(_, bias)| *bias).collect()
            }
        };
        let rms = mean(&counted.iter().map(|e| e * e).collect::<Vec<_>>()).map(f64::sqrt);
        Self { bias, sigma, rms }
    }

    /// Of several records together: the mean of the biases, and the scatter of all ordinates about it, every record counting the same.
    ///
    /// ```text
    /// b = mean b_r,   σ² = mean [σ_r² + (b_r − b)²]                                       (2)
    /// ```
    pub fn pooled(records: &[&Self]) -> Self {
        let n_band = records.iter().map(|r| r.bias.len()).max().unwrap_or(0);
        let in_band = |i: usize| -> Vec<(f64, f64)> {
            records.iter().filter_map(|r| Some(((*r.bias.get(i)?)?, (*r.sigma.get(i)?)?))).collect()
        };
        let bias: Vec<Option<f64>> =
            (0..n_band).map(|i| mean(&in_band(i).iter().map(|(b, _)| *b).collect::<Vec<_>>())).collect();
        let sigma = (0..n_band).map(|i| {
            let middle = bias[i]?;
            let squares: Vec<f64> = in_band(i).iter().map(|(b, s)| s * s + (b - middle).powi(2)).collect(); // (2)
            mean(&squares).map(f64::sqrt)
        });
        let squares: Vec<f64> = records.iter().filter_map(|r| r.rms).map(|v| v * v).collect();
        Self { sigma: sigma.collect(), rms: mean(&squares).map(f64::sqrt), bias }
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bands(rms_of: RmsOf) -> Bands {
        Bands { edges: vec![[1.0, 2.0], [2.0, 4.0], [40.0, 80.0]], counted: [1.0, 4.0], rms_of }
    }

    #[test]
    fn a_factor_is_all_bias_and_a_wave_all_scatter() {
        let x: Vec<f64> = (0..300).map(|i| 1.0 + 0.01 * f64::from(i)).collect();
        let flat = vec![3.0; 300];
        let wave: Vec<f64> =
            (0..300).map(|i| 3.0 * (0.2 * (f64::from(i) * std::f64::consts::TAU / 50.0).sin()).exp()).collect();
        let factor = LnRatio::of(&x, &[6.0; 300], &flat, &bands(RmsOf::Bias));
        assert!((factor.bias[0].unwrap() - 2f64.ln()).abs() < 1e-12 && factor.sigma[0].unwrap() < 1e-9);
        assert!(
            (factor.rms.unwrap() - 2f64.ln()).abs() < 1e-12 && factor.bias[2].is_none() && factor.sigma[2].is_none()
        );
        let [of_bias, of_all] = [RmsOf::Bias, RmsOf::Ordinates].map(|r| LnRatio::of(&x, &wave, &flat, &bands(r)));
        assert!(of_bias.bias[0].unwrap().abs() < 1e-3 && of_bias.rms.unwrap() < 1e-3);
        for v in [of_bias.sigma[0].unwrap(), of_all.rms.unwrap()] {
            assert!((v - 0.2 / 2f64.sqrt()).abs() < 2e-3, "{v}");
        }
    }

    #[test]
    fn records_together_add_their_difference_to_the_scatter() {
        let record =
            |b: f64, s: f64| LnRatio { bias: vec![Some(b), None], sigma: vec![Some(s), None], rms: Some(b.abs()) };
        let all = LnRatio::pooled(&[&record(0.3, 0.1), &record(-0.3, 0.1), &LnRatio::default()]);
        assert!(all.bias[0].unwrap().abs() < 1e-12 && all.bias[1].is_none());
        assert!(
            (all.sigma[0].unwrap() - (0.01f64 + 0.09).sqrt()).abs() < 1e-12 && (all.rms.unwrap() - 0.3).abs() < 1e-12
        );
        assert_eq!(LnRatio::pooled(&[]), LnRatio::default());
    }

    #[test]
    fn what_is_not_positive_does_not_count() {
        let found = LnRatio::of(&[1.0, 1.5], &[0.0, 2.0], &[1.0, 1.0], &bands(RmsOf::Ordinates));
        assert!((found.rms.unwrap() - 2f64.ln()).abs() < 1e-12);
        assert!(LnRatio::of(&[], &[], &[], &bands(RmsOf::Bias)).rms.is_none());
    }
}
