//! How well a one-dimensional transfer function fits, and how much the recorded one varies: the letters of Thompson et al.

use super::median;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Standard deviation between events from which on variability is high.
pub const HIGH_VARIABILITY: f64 = 0.35;
/// Correlation from which on the fit is good.
pub const GOOD_FIT: f64 = 0.6;
/// Peaks of the predicted transfer function between whose first and last the two are compared.
const PEAKS: usize = 4;
/// A peak is the highest within so much of ln f: the mean over a few events has wiggles that are no resonance.
const NEAR_LN: f64 = 0.2;

/// Transfer function of one sensor over its input in one component: recorded and predicted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TransferFit {
    /// Pearson's r between predicted and mean recorded ln amplitude.
    pub r: f64,
    /// Median over frequency of the standard deviation of the recorded ln amplitude between events.
    pub sigma: f64,
    /// `LG`, `LP`, `HG` or `HP`: low or high variability between events, good or poor fit.
    pub letters: String,
    /// Band in which they were compared, Hz.
    pub band_hz: [f64; 2],
    /// Events behind it.
    pub n_event: usize,
}

impl TransferFit {
    /// Of ln amplitudes at `frequencies_hz`, recorded and predicted in each event; `None` with fewer than three events or without a
    /// band.
    ///
    /// ```text
    /// r = corr_f( mean_e ln|H_p|, mean_e ln|H_a| ),   σ = median_f sd_e ln|H_a|                      (1)
    /// f from the first to the fourth peak of mean_e ln|H_p|, or to the last frequency where there are fewer
    /// L: σ < 0.35, H otherwise;   G: r > 0.6, P otherwise                                            (2)
    /// ```
    ///
    /// | argument            | shape                 | unit |
    /// |---------------------|-----------------------|------|
    /// | frequencies_hz      | `[n_f]`, evenly in ln | Hz   |
    /// | recorded, predicted | `[n_event][n_f]`      | –    |
    ///
    /// Limits: the events should be weak (Thompson et al.: below 0.1 g), or softening counts as variability; the source smooths less
    /// and uses both horizontal components together, and its r is that of the amplitudes, not of their logarithm.
    /// Check:  `letters_follow_the_limits_of_the_source`.
    /// Source: Thompson, Baise, Tanaka and Kayen (2012), A taxonomy of site response complexity, SDEE 41, 32–43, eqs. 1–5.
    pub fn of(frequencies_hz: &[f64], recorded: &[Vec<f64>], predicted: &[Vec<f64>]) -> Option<Self> {
        let n_event = recorded.len();
        if n_event < 3 || predicted.is_empty() {
            return None;
        }
        let [observed, theory] = [recorded, predicted].map(|events| mean(events, frequencies_hz.len()));
        let usable = |k: &usize| observed[*k].is_finite() && theory[*k].is_finite();
        let peaks: Vec<usize> = (1..frequencies_hz.len().saturating_sub(1))
            .filter(usable)
            .filter(|k| is_peak(frequencies_hz, &theory, *k))
            .collect();
        let first = *peaks.first()?;
        let last = peaks.get(PEAKS - 1).copied().or_else(|| (first..frequencies_hz.len()).rev().find(usable))?;
        let band: Vec<usize> = (first..=last).filter(usable).collect();
        if band.len() < 3 {
            return None;
        }
        let at = |values: &[f64]| band.iter().map(|k| values[*k]).collect::<Vec<f64>>();
        let r = pearson(&at(&theory), &at(&observed));
        let deviations: Vec<f64> = band
            .iter()
            .map(|k| recorded.iter().map(|e| (e[*k] - observed[*k]).powi(2)).sum::<f64>())
            .map(|squares| (squares / (n_event - 1) as f64).sqrt())
            .filter(|v| v.is_finite())
            .collect();
        let sigma = median(&deviations); // (1)
        let variability = if sigma < HIGH_VARIABILITY { 'L' } else { 'H' };
        let fit = if r > GOOD_FIT { 'G' } else { 'P' }; // (2)
        let letters = format!("{variability}{fit}");
        let band_hz = [frequencies_hz[first], frequencies_hz[last]];
        (r.is_finite() && sigma.is_finite()).then_some(Self { r, sigma, letters, band_hz, n_event })
    }
}

/// Whether nothing near the frequency of line `k` is higher.
fn is_peak(frequencies_hz: &[f64], theory: &[f64], k: usize) -> bool {
    let is_near = |i: &usize| (frequencies_hz[*i] / frequencies_hz[k]).ln().abs() < NEAR_LN;
    let mut neighbours = (0..theory.len()).filter(|i| *i != k).filter(is_near);
    let is_inside = k > 0 && k + 1 < theory.len();
    is_inside && theory[k] > theory[k - 1].max(theory[k + 1]) && neighbours.all(|i| theory[k] >= theory[i])
}

/// Transfer functions of one sensor over its input: ln amplitudes, recorded and predicted, as means over events.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TransferCurves {
    /// Frequencies, Hz.
    pub frequencies_hz: Vec<f64>,
    /// Mean of the recorded ln amplitude; none where a record holds nothing.
    pub recorded_ln: Vec<Option<f64>>,
    /// Standard deviation of the recorded ln amplitude between events; empty with fewer than two.
    pub recorded_sigma_ln: Vec<Option<f64>>,
    /// Mean of the predicted ln amplitude by model, over the events that have it; none where a prediction holds nothing.
    pub predicted_ln: BTreeMap<String, Vec<Option<f64>>>,
    /// Events behind the recorded mean.
    pub n_event: usize,
}

impl TransferCurves {
    /// Of ln amplitudes at `frequencies_hz`, `[n_event][n_f]` each; `predicted` by model.
    pub fn of(frequencies_hz: &[f64], recorded: &[Vec<f64>], predicted: BTreeMap<String, Vec<Vec<f64>>>) -> Self {
        let n = frequencies_hz.len();
        let finite =
            |values: Vec<f64>| values.into_iter().map(|v| Some(v).filter(|v| v.is_finite())).collect::<Vec<_>>();
        let recorded_mean = mean(recorded, n);
        let deviation = |k: usize| {
            let squares: f64 = recorded.iter().map(|e| (e[k] - recorded_mean[k]).powi(2)).sum();
            (squares / (recorded.len() - 1) as f64).sqrt()
        };
        let sigma = if recorded.len() < 2 { Vec::new() } else { (0..n).map(deviation).collect() };
        let predicted = predicted.into_iter().filter(|(_, events)| !events.is_empty());
        Self {
            frequencies_hz: frequencies_hz.to_vec(),
            recorded_sigma_ln: finite(sigma),
            predicted_ln: predicted.map(|(model, events)| (model, finite(mean(&events, n)))).collect(),
            recorded_ln: finite(recorded_mean),
            n_event: recorded.len(),
        }
    }
}

/// One sensor in one component: the fit of each model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SensorTransfer {
    /// Component.
    pub component: String,
    /// Sensor.
    pub sensor: String,
    /// By model; `None` where too few weak events have it.
    pub models: BTreeMap<String, Option<TransferFit>>,
    /// The curves behind it; of no events where none is weak.
    #[serde(default)]
    pub curves: TransferCurves,
}

/// Pearson's coefficient of correlation; NaN where a series is constant, or the lengths differ.
///
/// ```text
/// r = Σ (x − x̄)(y − ȳ) / √( Σ (x − x̄)² Σ (y − ȳ)² )
/// ```
///
/// Check:  `correlation_is_that_of_scipy`.
/// Source: Pearson (1895), Proc. R. Soc. Lond. 58, 240–242.
pub fn pearson(x: &[f64], y: &[f64]) -> f64 {
    if x.len() != y.len() || x.is_empty() {
        return f64::NAN;
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (x_mean, y_mean) = (mean(x), mean(y));
    let sum = |f: &dyn Fn(f64, f64) -> f64| x.iter().zip(y).map(|(a, b)| f(a - x_mean, b - y_mean)).sum::<f64>();
    sum(&|a, b| a * b) / (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt()
}

fn mean(events: &[Vec<f64>], n: usize) -> Vec<f64> {
    (0..n).map(|k| events.iter().map(|e| e[k]).sum::<f64>() / events.len() as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::made_up::{observed, predicted};
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn curves_of_no_event_or_of_silence_come_back_from_json() {
        let f_hz = [1.0, 2.0];
        let silent = vec![vec![0.5, f64::NEG_INFINITY]];
        for (recorded, predicted) in
            [(vec![], vec![]), (silent.clone(), silent), (vec![vec![0.1, 0.2], vec![0.3, 0.0]], vec![vec![0.0; 2]])]
        {
            let curves = TransferCurves::of(&f_hz, &recorded, BTreeMap::from([("declared".to_string(), predicted)]));
            let text = serde_json::to_string(&curves).unwrap();
            assert_eq!(serde_json::from_str::<TransferCurves>(&text).unwrap(), curves);
        }
    }

    #[test]
    fn correlation_is_that_of_scipy() {
        // `python tests/metrics/vectors.py` with scipy 1.17.1: `pearsonr`.
        assert!((pearson(&observed(), &predicted()) - 0.9383287089056117).abs() < 1e-12);
        assert!(pearson(&[1.0, 1.0], &[1.0, 2.0]).is_nan() && pearson(&[], &[]).is_nan());
    }

    /// ln |1/cos(kH)| of a damped layer with its first peak at `f_1`, seen by `n` events that vary by `sd`.
    fn recorded(f_hz: &[f64], f_1: f64, sd: f64, n: usize) -> Vec<Vec<f64>> {
        let mut random = random::stream(5, "transfer functions");
        let layer = |f: f64| {
            let phase = 0.5 * std::f64::consts::PI * f / f_1;
            -0.5 * (phase.cos().powi(2) + (0.05 * phase).powi(2)).ln()
        };
        let mut event = || {
            let draw =
                |f: &f64| layer(*f) + sd * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut random);
            f_hz.iter().map(draw).collect()
        };
        (0..n).map(|_| event()).collect()
    }

    #[test]
    fn letters_follow_the_limits_of_the_source() {
        let f_hz: Vec<f64> = (0..200).map(|i| 0.3 * (20.0f64 / 0.3).powf(f64::from(i) / 199.0)).collect();
        let theory = recorded(&f_hz, 1.5, 0.0, 1);
        for (f_1, sd, letters) in [(1.5, 0.1, "LG"), (1.5, 0.5, "HG"), (2.2, 0.1, "LP"), (2.2, 0.5, "HP")] {
            let found = TransferFit::of(&f_hz, &recorded(&f_hz, f_1, sd, 12), &theory).unwrap();
            assert_eq!(found.letters, letters, "{found:?}");
            assert!((found.sigma / sd - 1.0).abs() < 0.15, "{found:?}");
            assert!(
                (found.band_hz[0] / 1.5 - 1.0).abs() < 0.03 && (found.band_hz[1] / 10.5 - 1.0).abs() < 0.05,
                "{found:?}"
            );
        }
        assert!(TransferFit::of(&f_hz, &recorded(&f_hz, 1.5, 0.1, 2), &theory).is_none());
    }
}
