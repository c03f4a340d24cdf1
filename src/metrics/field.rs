//! The field's measures of many records together, and those of them that a claim may rest on.

use super::ln_ratio::LnRatio;
use super::measures::Measures;
use super::median;
use serde::{Deserialize, Serialize};

/// A measure on which an improvement may be claimed; smaller is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Claimed {
    /// NRMSE in percentage points: waveforms.
    #[default]
    NrmsePercent,
    /// Root mean square of the bias of the ln Fourier amplitude in ten bands: amplitudes.
    LnFourier,
    /// Root mean square of the ln ratio of response spectra: what a structure feels.
    LnPsa,
    /// NRMSE within the frequencies in which the site is coherent, in percentage points.
    CoherentNrmsePercent,
    /// Size of the ln ratio of peak accelerations.
    LnPga,
    /// Size of the ln ratio of Arias intensities.
    LnArias,
    /// Size of the ln ratio of the times from 5 to 95 % of the Arias intensity.
    LnDuration,
}

impl Claimed {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::NrmsePercent,
        Self::LnFourier,
        Self::LnPsa,
        Self::CoherentNrmsePercent,
        Self::LnPga,
        Self::LnArias,
        Self::LnDuration,
    ];

    /// For people.
    pub fn name(self) -> &'static str {
        match self {
            Self::NrmsePercent => "NRMSE",
            Self::LnFourier => "ln Fourier amplitude error",
            Self::LnPsa => "ln PSA error",
            Self::CoherentNrmsePercent => "NRMSE in the coherent band",
            Self::LnPga => "ln PGA error",
            Self::LnArias => "ln Arias intensity error",
            Self::LnDuration => "ln duration error",
        }
    }

    /// Its unit, with a space before it; empty where there is none.
    pub fn unit(self) -> &'static str {
        if self.is_percentage() { " points" } else { "" }
    }

    /// A value of it with as many digits as it deserves.
    pub fn written(self, value: f64) -> String {
        if self.is_percentage() { format!("{value:+.1}") } else { format!("{value:+.3}") }
    }

    /// Whether it is one of the three that every answer has: waveforms, amplitudes, and what a structure feels.
    pub fn is_first(self) -> bool {
        matches!(self, Self::NrmsePercent | Self::LnFourier | Self::LnPsa)
    }

    fn is_percentage(self) -> bool {
        matches!(self, Self::NrmsePercent | Self::CoherentNrmsePercent)
    }
}

/// Mean and scatter of an ln ratio.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BiasSigma {
    /// Mean.
    pub bias: f64,
    /// Standard deviation about it.
    pub sigma: f64,
}

/// One model over several records, every record counting the same.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FieldSummary {
    /// Records.
    pub n: usize,
    /// Fourier amplitude in [`super::fourier_bands`].
    pub ln_fourier_by_hz: LnRatio,
    /// Response spectrum in [`super::psa_bands`].
    pub ln_psa_by_s: LnRatio,
    /// Peak acceleration.
    pub ln_pga: Option<BiasSigma>,
    /// Peak velocity.
    pub ln_pgv: Option<BiasSigma>,
    /// Arias intensity.
    pub ln_arias: Option<BiasSigma>,
    /// Time from 5 to 75 % of the Arias intensity.
    pub ln_duration_5_75: Option<BiasSigma>,
    /// Time from 5 to 95 %.
    pub ln_duration_5_95: Option<BiasSigma>,
    /// Median of Anderson's score.
    pub anderson: Option<f64>,
}

impl FieldSummary {
    /// Of the measures of several records; `None` without any.
    pub fn of(records: &[&Measures]) -> Option<Self> {
        let ratio = |pick: fn(&Measures) -> Option<f64>| {
            let values: Vec<f64> = records.iter().filter_map(|m| pick(m)).collect();
            let n = values.len() as f64;
            let bias = values.iter().sum::<f64>() / n;
            let sigma = (values.iter().map(|v| (v - bias).powi(2)).sum::<f64>() / n).sqrt();
            (!values.is_empty()).then_some(BiasSigma { bias, sigma })
        };
        let scores: Vec<f64> = records.iter().filter_map(|m| Some(m.anderson.as_ref()?.score)).collect();
        let pooled =
            |pick: fn(&Measures) -> &LnRatio| LnRatio::pooled(&records.iter().map(|m| pick(m)).collect::<Vec<_>>());
        (!records.is_empty()).then(|| Self {
            n: records.len(),
            ln_fourier_by_hz: pooled(|m| &m.ln_fourier_by_hz),
            ln_psa_by_s: pooled(|m| &m.ln_psa_by_s),
            ln_pga: ratio(|m| m.ln_pga),
            ln_pgv: ratio(|m| m.ln_pgv),
            ln_arias: ratio(|m| m.ln_arias),
            ln_duration_5_75: ratio(|m| m.ln_duration_5_75),
            ln_duration_5_95: ratio(|m| m.ln_duration_5_95),
            anderson: (!scores.is_empty()).then(|| median(&scores)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_that_lack_a_measure_do_not_count_for_it() {
        let record = |ln_pga: Option<f64>| Measures { ln_pga, ..Measures::default() };
        let (a, b, c) = (record(Some(0.2)), record(Some(-0.4)), record(None));
        let found = FieldSummary::of(&[&a, &b, &c]).unwrap();
        let pga = found.ln_pga.unwrap();
        assert!((pga.bias + 0.1).abs() < 1e-12 && (pga.sigma - 0.3).abs() < 1e-12);
        assert!(found.ln_pgv.is_none() && found.anderson.is_none() && found.n == 3);
        assert_eq!(FieldSummary::of(&[]), None);
        assert_eq!(
            (Claimed::NrmsePercent.written(-3.21), Claimed::LnPsa.written(-0.1234)),
            ("-3.2".into(), "-0.123".into())
        );
    }
}
