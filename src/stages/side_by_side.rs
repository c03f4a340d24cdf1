//! What was recorded and what every pass predicted, history beside history, and all measures of each.
//!
//! Finite elements are compared at the step of the record, FLARE-T at its own; NRMSE of all is taken on the axis of FLARE-T.

use super::ceiling::{CeilingErrors, ceilings};
use super::evaluate;
use crate::diagnosis::{ErrorRow, PREDICTIONS, Six};
use crate::metrics::{
    History, Measures, SensorTransfer, TransferCurves, TransferFit, coherent_mean_nrmse_percent,
    coherent_nrmse_percent, fourier_frequencies_hz, smoothed_fourier_amplitude,
};
use crate::records::Split;
use crate::units::G_M_S2;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// An NRMSE, %, of a prediction of a record every so many seconds with this coherence.
type Nrmse = fn(&[f64], &[f64], f64, Option<&[[f64; 2]]>) -> f64;

/// Highest frequency that the score looks at, Hz: meshes and processed records hold nothing sound above.
const SCORED_TO_HZ: f64 = 20.0;
/// Peak of a weak record, g: above, soil softens and its transfer function is not that of small strains.
const WEAK_G: f64 = 0.1;
/// Highest frequency of transfer functions, Hz.
const TRANSFER_TO_HZ: f64 = 20.0;

/// One sensor in one component of one event.
pub struct Channel {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// Sensor.
    pub sensor: String,
    /// What the event was used for.
    pub split: Split,
    /// At the step of the record, finite elements.
    pub fine: Histories,
    /// On the axis of FLARE-T, all models; the input is longer by the initial window.
    pub coarse: Histories,
    /// NRMSE of the models, %, where the passes took it already; ceiling missing.
    pub nrmse_percent: Six<Option<f64>>,
}

/// A record and its predictions at one step.
pub struct Histories {
    /// Step, s.
    pub dt_s: f64,
    /// Input sensor, m/s².
    pub input: Vec<f64>,
    /// The record, m/s².
    pub observed: Vec<f64>,
    /// Predictions by model, m/s²; as long as the record.
    pub predicted: BTreeMap<&'static str, Vec<f64>>,
}

/// A channel, measured.
pub struct Measured {
    /// Smoothed Fourier amplitude of the input at the step of the record and on the axis of FLARE-T, m/s.
    input_fourier_m_s: [Vec<f64>; 2],
    /// Recorded history at these two.
    observed: [History; 2],
    /// Predictions by model: which of the two axes, history.
    predicted: BTreeMap<&'static str, (usize, History)>,
}

impl Measured {
    /// The record at its own step.
    pub fn observed(&self) -> &History {
        &self.observed[0]
    }

    /// Smoothed Fourier amplitude of the input at the step of the record, m/s.
    pub fn input_fourier_m_s(&self) -> &[f64] {
        &self.input_fourier_m_s[0]
    }
}

/// Rows of all channels, `coherence` being pairs of frequency and coherence by sensor, and the transfer functions of the weak
/// ones; the score and the transfer functions start at `lowest_hz`.
pub fn judged(
    channels: &[Channel],
    coherence: &BTreeMap<String, Vec<[f64; 2]>>,
    lowest_hz: f64,
) -> (Vec<ErrorRow>, Vec<SensorTransfer>) {
    let scored_hz = [lowest_hz, SCORED_TO_HZ];
    let measured: Vec<Measured> = channels.par_iter().map(|c| c.measured(scored_hz)).collect();
    let ceilings = ceilings(channels, &measured, coherence, scored_hz);
    let rows = (0..channels.len()).map(|i| {
        let other = channels.iter().position(|c| c.is_other_component_of(&channels[i]));
        let beside = other.map(|o| Measures::of(measured[o].observed(), measured[i].observed()));
        channels[i].row(&measured[i], &ceilings[i], beside, coherence)
    });
    (rows.collect(), transfer(channels, &measured, [lowest_hz, TRANSFER_TO_HZ]))
}

impl Channel {
    fn is_other_component_of(&self, other: &Self) -> bool {
        self.event == other.event
            && self.sensor == other.sensor
            && self.component != other.component
            && self.fine.dt_s.total_cmp(&other.fine.dt_s).is_eq()
    }

    fn measured(&self, scored_hz: [f64; 2]) -> Measured {
        let history = |x: &[f64], dt_s: f64| History::new(x, dt_s, scored_hz);
        let frequencies_hz = fourier_frequencies_hz();
        let both = [&self.fine, &self.coarse];
        let of_axis = |(axis, h): (usize, &Histories)| {
            let models: Vec<(&'static str, usize, History)> = h
                .predicted
                .iter()
                .filter(|(model, _)| axis == 0 || !self.fine.predicted.contains_key(*model))
                .map(|(model, x)| (*model, axis, history(x, h.dt_s)))
                .collect();
            models
        };
        let predicted = both.into_iter().enumerate().flat_map(of_axis);
        Measured {
            input_fourier_m_s: both.map(|h| {
                // The window before the first prediction is no part of the record there.
                let first = h.input.len().saturating_sub(h.observed.len());
                smoothed_fourier_amplitude(&h.input[first..], h.dt_s, &frequencies_hz)
            }),
            observed: both.map(|h| history(&h.observed, h.dt_s)),
            predicted: predicted.map(|(model, axis, h)| (model, (axis, h))).collect(),
        }
    }

    fn row(
        &self,
        measured: &Measured,
        ceiling: &CeilingErrors,
        other_component: Option<Measures>,
        coherence: &BTreeMap<String, Vec<[f64; 2]>>,
    ) -> ErrorRow {
        let coherence = coherence.get(&self.sensor).map(Vec::as_slice);
        let by = |of: Nrmse, ceiling: Option<f64>| {
            let percent = |model: &'static str| {
                let percent = of(self.coarse.predicted.get(model)?, &self.coarse.observed, self.coarse.dt_s, coherence);
                Some(percent).filter(|v| v.is_finite())
            };
            Six {
                declared: percent("declared"),
                recalibrated: percent("recalibrated"),
                corrected: percent("corrected"),
                flare_before: percent("flare_before"),
                flare_after: percent("flare_after"),
                noise_floor: None,
                ceiling,
            }
        };
        let of = |model: &'static str| {
            let (axis, history) = measured.predicted.get(model)?;
            Some(Measures::of(history, &measured.observed[*axis]))
        };
        let mut measures: BTreeMap<String, Option<Measures>> =
            PREDICTIONS.into_iter().map(|model| (model.to_string(), of(model))).collect();
        measures.insert("ceiling".into(), ceiling.measures.clone());
        measures.insert("other_component".into(), other_component);
        ErrorRow {
            event: self.event.clone(),
            component: self.component.clone(),
            sensor: self.sensor.clone(),
            split: self.split,
            nrmse_percent: Six { ceiling: ceiling.nrmse_percent, ..self.nrmse_percent },
            nrmse_coherent_percent: by(coherent_nrmse_percent, ceiling.nrmse_coherent_percent),
            // The filter was fitted by least squares: what it predicts is a coherent mean.
            nrmse_coherent_mean_percent: by(coherent_mean_nrmse_percent, ceiling.nrmse_percent),
            measures,
        }
    }
}

impl Histories {
    /// NRMSE of one model, %.
    pub fn nrmse(&self, model: &str) -> Option<f64> {
        evaluate::nrmse(self.predicted.get(model)?, &self.observed)
    }
}

/// Transfer functions over all weak events, by component and sensor.
fn transfer(channels: &[Channel], measured: &[Measured], band_hz: [f64; 2]) -> Vec<SensorTransfer> {
    let all_hz = fourier_frequencies_hz();
    let is_inside = |k: &usize| all_hz[*k] >= band_hz[0] && all_hz[*k] <= band_hz[1];
    let lines: Vec<usize> = (0..all_hz.len()).filter(is_inside).collect();
    let frequencies_hz: Vec<f64> = lines.iter().map(|k| all_hz[*k]).collect();
    let ln_ratio = |y: &[f64], u: &[f64]| -> Vec<f64> { lines.iter().map(|k| (y[*k] / u[*k]).ln()).collect() };
    let mut places: Vec<(&String, &String)> = Vec::new();
    for channel in channels {
        if !places.contains(&(&channel.component, &channel.sensor)) {
            places.push((&channel.component, &channel.sensor));
        }
    }
    // Recorded and predicted ln amplitudes of the weak events that have the model.
    let weak = |component: &String, sensor: &String, model: Option<&str>| -> [Vec<Vec<f64>>; 2] {
        let (mut recorded, mut predicted) = (Vec::new(), Vec::new());
        for (channel, found) in channels.iter().zip(measured) {
            let is_weak = found.observed().pga_m_s2 < WEAK_G * G_M_S2;
            if &channel.component == component && &channel.sensor == sensor && is_weak {
                let Some(model) = model else {
                    recorded.push(ln_ratio(&found.observed().fourier_m_s, found.input_fourier_m_s()));
                    continue;
                };
                let Some((axis, history)) = found.predicted.get(model) else { continue };
                let input = &found.input_fourier_m_s[*axis];
                recorded.push(ln_ratio(&found.observed[*axis].fourier_m_s, input));
                predicted.push(ln_ratio(&history.fourier_m_s, input));
            }
        }
        [recorded, predicted]
    };
    let of = |(component, sensor): &(&String, &String)| {
        let by_model = PREDICTIONS.map(|model| (model.to_string(), weak(component, sensor, Some(model))));
        let [recorded, _] = weak(component, sensor, None);
        let predicted = by_model.iter().map(|(model, [_, predicted])| (model.clone(), predicted.clone())).collect();
        let fit = |(model, [recorded, predicted]): (String, [Vec<Vec<f64>>; 2])| {
            (model, TransferFit::of(&frequencies_hz, &recorded, &predicted))
        };
        SensorTransfer {
            component: (*component).clone(),
            sensor: (*sensor).clone(),
            curves: TransferCurves::of(&frequencies_hz, &recorded, predicted),
            models: by_model.into_iter().map(fit).collect(),
        }
    };
    places.iter().map(of).collect()
}
