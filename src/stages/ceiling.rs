//! The ceiling of every channel, from training events alone: what filters fitted to other events predict.
//!
//! A training event is predicted from the other training events, every other event from all of them.

use super::evaluate::{self, Axis};
use super::side_by_side::{Channel, Measured};
use crate::dataset::Coarse;
use crate::metrics::{
    Ceiling, FreeFilter, History, MatchedFilter, Measures, Pair, coherent_nrmse_percent, ln_psa_by_s, psa_periods_s,
};
use crate::metrics::{DAMPING, psa};
use crate::records::{Record, Split};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// What can be reached in one channel; `None` with fewer than two other training events.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CeilingErrors {
    /// NRMSE of the free filter, the amplitude-matched one or zero, whichever is best on the training events, %.
    pub nrmse_percent: Option<f64>,
    /// The same in the coherent band, %.
    pub nrmse_coherent_percent: Option<f64>,
    /// The field's measures of the amplitude-matched filter; its response spectrum is that of the input times the mean ratio of the
    /// training events.
    pub measures: Option<Measures>,
}

/// What the filters from other events make of one channel.
struct Filtered {
    /// On the axis of FLARE-T, m/s²: free filter and amplitude-matched one.
    free: Vec<f64>,
    matched: Vec<f64>,
    measures: Measures,
}

/// Ceilings of all channels, each sensor and component by itself.
pub fn ceilings(
    channels: &[Channel],
    measured: &[Measured],
    coherence: &BTreeMap<String, Vec<[f64; 2]>>,
    scored_hz: [f64; 2],
) -> Vec<CeilingErrors> {
    let periods_s = psa_periods_s();
    let input_psa: Vec<Vec<f64>> =
        channels.par_iter().map(|c| psa(&c.fine.input, c.fine.dt_s, DAMPING, &periods_s)).collect();
    let filtered: Vec<Option<Filtered>> = (0..channels.len())
        .into_par_iter()
        .map(|i| {
            let others = others(channels, i);
            let channel = &channels[i];
            let pairs: Vec<Pair<'_>> = others.iter().map(|o| pair(&channels[*o])).collect();
            let free = FreeFilter::of(&pairs, channel.coarse.dt_s)?;
            let amplitudes: Vec<[&[f64]; 2]> = others
                .iter()
                .map(|o| [measured[*o].input_fourier_m_s(), measured[*o].observed().fourier_m_s.as_slice()])
                .collect();
            let matched = MatchedFilter::of(&amplitudes)?;
            let response = matched.apply(&channel.fine.input, channel.fine.dt_s);
            let history = History::new(&response, channel.fine.dt_s, scored_hz);
            let spectrum: Vec<f64> = (0..periods_s.len())
                .map(|k| {
                    let ratios = others.iter().map(|o| (measured[*o].observed().psa_m_s2[k] / input_psa[*o][k]).ln());
                    input_psa[i][k] * (ratios.sum::<f64>() / others.len() as f64).exp()
                })
                .collect();
            let observed = measured[i].observed();
            let first = channel.coarse.input.len() - channel.coarse.observed.len();
            Some(Filtered {
                free: free.apply(&channel.coarse.input)[first..].to_vec(),
                matched: matched.apply(&channel.coarse.input, channel.coarse.dt_s)[first..].to_vec(),
                measures: Measures {
                    ln_psa_by_s: ln_psa_by_s(&spectrum, &observed.psa_m_s2),
                    ..Measures::of(&history, observed)
                },
            })
        })
        .collect();
    (0..channels.len()).map(|i| reached(channels, &filtered, i, coherence)).collect()
}

fn reached(
    channels: &[Channel],
    filtered: &[Option<Filtered>],
    i: usize,
    coherence: &BTreeMap<String, Vec<[f64; 2]>>,
) -> CeilingErrors {
    let Some(own) = &filtered[i] else { return CeilingErrors::default() };
    let coarse = &channels[i].coarse;
    let training: Vec<usize> = (0..channels.len())
        .filter(|t| channels[*t].split == Split::Train && is_same_place(&channels[*t], &channels[i]))
        .collect();
    let errors = |of: fn(&Filtered) -> &Vec<f64>| -> Vec<f64> {
        let error = |t: &usize| evaluate::nrmse(of(filtered[*t].as_ref()?), &channels[*t].coarse.observed);
        training.iter().filter_map(error).collect()
    };
    let nothing = vec![0.0; coarse.observed.len()];
    let best = match Ceiling::chosen(&errors(|f| &f.free), &errors(|f| &f.matched)) {
        Ceiling::Filter => &own.free,
        Ceiling::Matched => &own.matched,
        Ceiling::Zero => &nothing,
    };
    let coherence = coherence.get(&channels[i].sensor).map(Vec::as_slice);
    let coherent = coherent_nrmse_percent(best, &coarse.observed, coarse.dt_s, coherence);
    CeilingErrors {
        nrmse_percent: evaluate::nrmse(best, &coarse.observed),
        nrmse_coherent_percent: Some(coherent).filter(|v| v.is_finite()),
        measures: Some(own.measures.clone()),
    }
}

/// Training events that may predict channel `i`.
fn others(channels: &[Channel], i: usize) -> Vec<usize> {
    let is_other =
        |o: &usize| *o != i && channels[*o].split == Split::Train && is_same_place(&channels[*o], &channels[i]);
    (0..channels.len()).filter(is_other).collect()
}

fn is_same_place(a: &Channel, b: &Channel) -> bool {
    a.component == b.component && a.sensor == b.sensor
}

fn pair(channel: &Channel) -> Pair<'_> {
    Pair { input: &channel.coarse.input, output: &channel.coarse.observed }
}

/// Input and record of one sensor in one component of one event, on the axis of FLARE-T.
pub struct Side {
    split: Split,
    component: String,
    sensor: String,
    step_s: f64,
    /// From the beginning of the record, m/s².
    input: Vec<f64>,
    /// After the initial window, m/s².
    observed: Vec<f64>,
}

/// The sides of `record`, one a sensor; `observed` is what its sensors recorded on `axis`.
pub fn sides(record: &Record, split: Split, axis: Axis, observed: &[Vec<f64>]) -> Vec<Side> {
    let input = Coarse::of_record(record, axis.step_s).base_m_s2;
    let of = |(sensor, observed): (&crate::records::Sensor, &Vec<f64>)| Side {
        split,
        component: record.component.clone(),
        sensor: sensor.name.clone(),
        step_s: axis.step_s,
        input: input.clone(),
        observed: observed.clone(),
    };
    record.outputs.iter().zip(observed).map(of).collect()
}

/// NRMSE of each side, %, by a filter fitted to the other training events of its sensor and component, or by nothing where that is better
/// on average over the training events; `None` with fewer than two other training events.
pub fn filter_nrmse_percent(sides: &[Side]) -> Vec<Option<f64>> {
    let is_alike = |a: &Side, b: &Side| a.component == b.component && a.sensor == b.sensor;
    let filtered = |i: usize| {
        let is_other = |o: &usize| *o != i && sides[*o].split == Split::Train && is_alike(&sides[*o], &sides[i]);
        let others = (0..sides.len()).filter(is_other);
        let pairs: Vec<Pair<'_>> =
            others.map(|o| Pair { input: &sides[o].input, output: &sides[o].observed }).collect();
        let own = Pair { input: &sides[i].input, output: &sides[i].observed };
        Some(FreeFilter::of(&pairs, sides[i].step_s)?.nrmse_percent(&own)).filter(|v| v.is_finite())
    };
    let filtered: Vec<Option<f64>> = (0..sides.len()).into_par_iter().map(filtered).collect();
    let best = |i: usize| {
        let training = (0..sides.len()).filter(|t| sides[*t].split == Split::Train && is_alike(&sides[*t], &sides[i]));
        let errors: Vec<f64> = training.filter_map(|t| filtered[t]).collect();
        let nothing = || evaluate::nrmse(&vec![0.0; sides[i].observed.len()], &sides[i].observed);
        filtered[i].and_then(|own| if Ceiling::chosen(&errors, &[]) == Ceiling::Zero { nothing() } else { Some(own) })
    };
    (0..sides.len()).map(best).collect()
}
