//! The ceiling of every channel, from training events alone: what filters fitted to other events predict.
//!
//! A training event is predicted from the other training events, every other event from all of them.

use super::evaluate;
use super::side_by_side::{Channel, Measured};
use crate::dataset::Coarse;
use crate::metrics::{
    Ceiling, FreeFilter, History, MatchedFilter, Measures, Pair, coherent_nrmse_percent, ln_psa_by_s, psa_periods_s,
};
use crate::metrics::{DAMPING, psa};
use crate::records::{Record, Sensor, Split};
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
    let places: Vec<Place<'_>> = channels.iter().map(place).collect();
    let periods_s = psa_periods_s();
    let input_psa: Vec<Vec<f64>> =
        channels.par_iter().map(|c| psa(&c.fine.input, c.fine.dt_s, DAMPING, &periods_s)).collect();
    let filtered: Vec<Option<Filtered>> = (0..channels.len())
        .into_par_iter()
        .map(|i| {
            let others = others(&places, i);
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
    (0..channels.len()).map(|i| reached(channels, &places, &filtered, i, coherence)).collect()
}

fn reached(
    channels: &[Channel],
    places: &[Place<'_>],
    filtered: &[Option<Filtered>],
    i: usize,
    coherence: &BTreeMap<String, Vec<[f64; 2]>>,
) -> CeilingErrors {
    let Some(own) = &filtered[i] else { return CeilingErrors::default() };
    let coarse = &channels[i].coarse;
    let errors = |of: fn(&Filtered) -> &Vec<f64>| -> Vec<f64> {
        let error = |t: usize| evaluate::nrmse(of(filtered[t].as_ref()?), &channels[t].coarse.observed);
        training(places, i).filter_map(error).collect()
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

/// What an event of one sensor in one component was used for.
#[derive(Clone, Copy)]
struct Place<'a> {
    component: &'a str,
    sensor: &'a str,
    split: Split,
}

/// Training events of the sensor and component of place `i`.
fn training(places: &[Place<'_>], i: usize) -> impl Iterator<Item = usize> {
    let is_alike = move |p: &Place<'_>| p.component == places[i].component && p.sensor == places[i].sensor;
    (0..places.len()).filter(move |t| places[*t].split == Split::Train && is_alike(&places[*t]))
}

/// Those that may predict it: all but itself.
fn others(places: &[Place<'_>], i: usize) -> Vec<usize> {
    training(places, i).filter(|o| *o != i).collect()
}

fn place(channel: &Channel) -> Place<'_> {
    Place { component: &channel.component, sensor: &channel.sensor, split: channel.split }
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

impl Side {
    fn place(&self) -> Place<'_> {
        Place { component: &self.component, sensor: &self.sensor, split: self.split }
    }

    fn pair(&self) -> Pair<'_> {
        Pair { input: &self.input, output: &self.observed }
    }
}

/// The sides of `record`, one a sensor; `coarse` is that at the step of FLARE-T and `observed` what its sensors recorded after the window.
pub fn sides(record: &Record, split: Split, coarse: &Coarse, observed: &[Vec<f64>]) -> Vec<Side> {
    let of = |(sensor, observed): (&Sensor, &Vec<f64>)| Side {
        split,
        component: record.component.clone(),
        sensor: sensor.name.clone(),
        step_s: coarse.dt_s,
        input: coarse.base_m_s2.clone(),
        observed: observed.clone(),
    };
    record.outputs.iter().zip(observed).map(of).collect()
}

/// NRMSE of each side, %, by a filter fitted to the other training events of its sensor and component, or by nothing where that is better
/// on average over the training events; `None` with fewer than two other training events.
pub fn filter_nrmse_percent(sides: &[Side]) -> Vec<Option<f64>> {
    let places: Vec<Place<'_>> = sides.iter().map(Side::place).collect();
    let filtered = |i: usize| {
        let pairs: Vec<Pair<'_>> = others(&places, i).into_iter().map(|o| sides[o].pair()).collect();
        let filter = FreeFilter::of(&pairs, sides[i].step_s)?;
        Some(filter.nrmse_percent(&sides[i].pair())).filter(|v| v.is_finite())
    };
    let filtered: Vec<Option<f64>> = (0..sides.len()).into_par_iter().map(filtered).collect();
    let best = |i: usize| {
        let own = filtered[i]?;
        let errors: Vec<f64> = training(&places, i).filter_map(|t| filtered[t]).collect();
        let observed = &sides[i].observed;
        let is_nothing = Ceiling::chosen(&errors, &[]) == Ceiling::Zero;
        if is_nothing { evaluate::nrmse(&vec![0.0; observed.len()], observed) } else { Some(own) }
    };
    (0..sides.len()).map(best).collect()
}
