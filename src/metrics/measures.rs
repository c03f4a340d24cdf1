//! The field's measures of one predicted history against the recorded one.

use super::anderson::Anderson;
use super::history::{History, fourier_frequencies_hz, psa_periods_s};
use super::ln_ratio::{Bands, LnRatio, RmsOf};
use super::psa::PERIOD_RANGE_S;
use serde::{Deserialize, Serialize};

/// Bands of the Fourier amplitude that count for its one number: ten, even in ln f.
const FOURIER_COUNTED_HZ: [f64; 2] = [0.5, 9.5];
const N_FOURIER_BAND: usize = 10;
/// Edges of the bands of the response spectrum, s.
const PSA_EDGES_S: [f64; 9] = [0.01, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0];

/// What one prediction is off by; ln ratios are of predicted over recorded.
///
/// Check: `a_factor_shows_in_every_measure_as_its_logarithm`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// Step of the two histories, s: finite elements are compared at that of the record, FLARE-T at its own.
    pub step_s: f64,
    /// Smoothed Fourier amplitude in [`fourier_bands`]; `rms` is that of the bias of the ten bands from 0.5 to 9.5 Hz.
    pub ln_fourier_by_hz: LnRatio,
    /// Response spectrum of 5 % in [`psa_bands`]; `rms` is that of all periods from 0.1 to 5 s.
    pub ln_psa_by_s: LnRatio,
    /// Peak acceleration.
    pub ln_pga: Option<f64>,
    /// Peak velocity.
    pub ln_pgv: Option<f64>,
    /// Arias intensity.
    pub ln_arias: Option<f64>,
    /// Time from 5 to 75 % of the Arias intensity.
    pub ln_duration_5_75: Option<f64>,
    /// Time from 5 to 95 %.
    pub ln_duration_5_95: Option<f64>,
    /// Anderson's score; `None` where no band counts.
    pub anderson: Option<Anderson>,
}

impl Measures {
    /// Of a predicted history against the recorded one, of the same step and length.
    pub fn of(predicted: &History, observed: &History) -> Self {
        let ln = |p: f64, a: f64| Some((p / a).ln()).filter(|v| v.is_finite());
        let spectra = [&predicted.fourier_m_s, &observed.fourier_m_s];
        let [ln_duration_5_75, ln_duration_5_95] = [0, 1].map(|k| ln(predicted.duration_s[k], observed.duration_s[k]));
        Self {
            step_s: observed.dt_s,
            ln_fourier_by_hz: LnRatio::of(&fourier_frequencies_hz(), spectra[0], spectra[1], &fourier_bands()),
            ln_psa_by_s: ln_psa_by_s(&predicted.psa_m_s2, &observed.psa_m_s2),
            ln_pga: ln(predicted.pga_m_s2, observed.pga_m_s2),
            ln_pgv: ln(predicted.pgv_m_s, observed.pgv_m_s),
            ln_arias: ln(predicted.arias_m_s, observed.arias_m_s),
            ln_duration_5_75,
            ln_duration_5_95,
            anderson: Anderson::of(predicted, observed),
        }
    }
}

/// Bias and scatter of two response spectra at [`psa_periods_s`].
pub fn ln_psa_by_s(predicted: &[f64], observed: &[f64]) -> LnRatio {
    LnRatio::of(&psa_periods_s(), predicted, observed, &psa_bands())
}

/// Bands of the Fourier amplitude, Hz: 0.2 to 0.5, ten from 0.5 to 9.5, and 9.5 to 20.
pub fn fourier_bands() -> Bands {
    let [first, last] = FOURIER_COUNTED_HZ;
    let edge = |i: usize| first * (last / first).powf(i as f64 / N_FOURIER_BAND as f64);
    let mut edges = vec![[0.2, first]];
    edges.extend((0..N_FOURIER_BAND).map(|i| [edge(i), edge(i + 1)]));
    edges.push([last, 20.0]);
    Bands { edges, counted: FOURIER_COUNTED_HZ, rms_of: RmsOf::Bias }
}

/// Bands of the response spectrum, s: eight from 0.01 to 10.
pub fn psa_bands() -> Bands {
    let edges = PSA_EDGES_S.windows(2).map(|e| [e[0], e[1]]).collect();
    Bands { edges, counted: PERIOD_RANGE_S, rms_of: RmsOf::Ordinates }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::made_up::{DT_S, observed};

    #[test]
    fn a_factor_shows_in_every_measure_as_its_logarithm() {
        let scaled: Vec<f64> = observed().iter().map(|v| 1.5 * v).collect();
        let [p, a] = [&scaled, &observed()].map(|x| History::new(x, DT_S, [0.2, 20.0]));
        let found = Measures::of(&p, &a);
        let ln = 1.5f64.ln();
        let near = |v: Option<f64>, expected: f64| assert!((v.expect("a number") - expected).abs() < 1e-9, "{v:?}");
        near(found.ln_pga, ln);
        near(found.ln_pgv, ln);
        near(found.ln_arias, 2.0 * ln);
        near(found.ln_duration_5_75, 0.0);
        near(found.ln_duration_5_95, 0.0);
        near(found.ln_fourier_by_hz.rms, ln);
        near(found.ln_psa_by_s.rms, ln);
        assert_eq!((found.ln_fourier_by_hz.bias.len(), found.ln_psa_by_s.bias.len()), (12, 8));
        for v in found.ln_fourier_by_hz.bias.iter().chain(&found.ln_psa_by_s.bias) {
            near(*v, ln);
        }
        for v in found.ln_fourier_by_hz.sigma.iter().chain(&found.ln_psa_by_s.sigma) {
            near(*v, 0.0);
        }
    }

    #[test]
    fn silence_has_no_ratio() {
        let [p, a] = [&vec![0.0; 2001], &observed()].map(|x| History::new(x, DT_S, [0.2, 20.0]));
        let found = Measures::of(&p, &a);
        assert_eq!((found.ln_pga, found.ln_arias, found.ln_fourier_by_hz.rms), (None, None, None));
        assert!(found.anderson.is_none_or(|a| a.score.is_finite()));
    }
}
