//! NRMSE where the record can be predicted wave by wave, and of what can be predicted of it wave by wave.

use crate::numerics::spectrum::spectrum;

/// Coherence from which on a frequency belongs to the coherent band.
pub const COHERENT: f64 = 0.7;

/// NRMSE of one channel in percent, over the frequencies whose coherence is [`COHERENT`] or more; over all without a coherence.
///
/// ```text
/// NRMSE_c = √( Σ |P(f) − A(f)|² / Σ |A(f)|² ) · 100 %,   sums over c(f) ≥ 0.7            (1)
/// ```
///
/// | symbol | argument  | shape        | unit          |
/// |--------|-----------|--------------|---------------|
/// | P, A   | spectra of `pred`, `obs` | `[n_step]` | m/s² |
/// | c      | coherence | `[n]` of `[f_hz, c]`, rising in f | Hz, 0 … 1 |
///
/// c is linear between its knots and constant beyond them.
///
/// Limits: NaN where the band holds nothing of the record; by Parseval the full band gives the NRMSE of the series.
/// Check:  `only_coherent_frequencies_count`, `the_full_band_is_the_nrmse_of_the_series`.
/// Source: definition.
pub fn coherent_nrmse_percent(pred: &[f64], obs: &[f64], dt_s: f64, coherence: Option<&[[f64; 2]]>) -> f64 {
    over_band(pred, obs, dt_s, |f_hz| {
        let counts = coherence.is_none_or(|c| at(c, f_hz) >= COHERENT);
        counts.then_some(1.0)
    })
}

/// NRMSE in percent of what a prediction says of the waveform of a record that follows it with the coherence c: its coherent mean.
///
/// ```text
/// NRMSE_m = √( Σ |c(f) P(f) − A(f)|² / Σ |A(f)|² ) · 100 %              (2)
/// ```
///
/// Arguments as those of [`coherent_nrmse_percent`]; sums are over all frequencies. Without a coherence it is the NRMSE of the series.
///
/// Check:  `the_coherent_mean_of_what_does_not_follow_is_nothing`.
/// Source: c P is the mean of A given P where both are normal; Bendat and Piersol (2010), Random Data, section 6.1.
pub fn coherent_mean_nrmse_percent(pred: &[f64], obs: &[f64], dt_s: f64, coherence: Option<&[[f64; 2]]>) -> f64 {
    over_band(pred, obs, dt_s, |f_hz| Some(coherence.map_or(1.0, |c| at(c, f_hz))))
}

/// NRMSE in percent of a prediction times a factor of frequency, over the frequencies that have one.
fn over_band(pred: &[f64], obs: &[f64], dt_s: f64, factor: impl Fn(f64) -> Option<f64>) -> f64 {
    if pred.len() != obs.len() || obs.is_empty() {
        return f64::NAN;
    }
    let (frequencies_hz, observed) = spectrum(obs, dt_s);
    let (_, predicted) = spectrum(pred, dt_s);
    let (mut left, mut all) = (0.0, 0.0);
    for (k, f_hz) in frequencies_hz.iter().enumerate() {
        if let Some(factor) = factor(*f_hz) {
            // The lines between zero and the Nyquist frequency stand for their mirror images, too.
            let weight = if k == 0 || k + 1 == frequencies_hz.len() { 0.5 } else { 1.0 };
            left += weight * (predicted[k] * factor - observed[k]).norm_sqr();
            all += weight * observed[k].norm_sqr();
        }
    }
    if all > 0.0 { 100.0 * (left / all).sqrt() } else { f64::NAN } // (1)
}

fn at(coherence: &[[f64; 2]], f_hz: f64) -> f64 {
    let i = coherence.partition_point(|[f, _]| *f <= f_hz);
    match (i.checked_sub(1).map(|b| coherence[b]), coherence.get(i)) {
        (Some([f0, c0]), Some([f1, c1])) => c0 + (c1 - c0) * (f_hz - f0) / (f1 - f0),
        (Some([_, c]), None) => c,
        (None, Some([_, c])) => *c,
        (None, None) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::made_up::{DT_S, observed, predicted};
    use crate::metrics::nrmse_percent;

    #[test]
    fn the_full_band_is_the_nrmse_of_the_series() {
        let got = coherent_nrmse_percent(&predicted(), &observed(), DT_S, None);
        assert!((got - nrmse_percent(&predicted(), &observed())).abs() < 1e-9);
    }

    #[test]
    fn the_coherent_mean_of_what_does_not_follow_is_nothing() {
        let (pred, obs) = (predicted(), observed());
        let mean = |c: f64| coherent_mean_nrmse_percent(&pred, &obs, DT_S, Some(&[[1.0, c]]));
        assert!((mean(0.0) - 100.0).abs() < 1e-9);
        let half: Vec<f64> = pred.iter().map(|p| 0.5 * p).collect();
        assert!((mean(0.5) - nrmse_percent(&half, &obs)).abs() < 1e-9);
        assert!((coherent_mean_nrmse_percent(&pred, &obs, DT_S, None) - nrmse_percent(&pred, &obs)).abs() < 1e-9);
    }

    #[test]
    fn only_coherent_frequencies_count() {
        let tone = |f: f64| (0..4000).map(move |i| (std::f64::consts::TAU * f * f64::from(i) * DT_S).sin());
        let obs: Vec<f64> = tone(1.0).zip(tone(6.0)).map(|(a, b)| a + b).collect();
        let pred: Vec<f64> = tone(1.0).map(|a| 0.9 * a).collect();
        let coherence = [[0.0, 1.0], [2.0, 1.0], [4.0, 0.0]];
        let got = coherent_nrmse_percent(&pred, &obs, DT_S, Some(&coherence));
        assert!((got - 10.0).abs() < 0.5, "{got}");
        assert!(coherent_nrmse_percent(&pred, &obs, DT_S, None) > 60.0);
        assert!(coherent_nrmse_percent(&pred, &obs, DT_S, Some(&[[1.0, 0.1]])).is_nan());
        assert!(coherent_nrmse_percent(&pred, &obs, DT_S, Some(&[])).is_nan());
        assert!(coherent_nrmse_percent(&[], &[], DT_S, None).is_nan());
    }
}
