//! What the residuals of a model say by themselves, whatever effects are tried: how much of them follows the input, how
//! much repeats from event to event, and what a smooth factor without a name would take out.

use super::anchor::Anchor;
use super::coherence::{Trace, coherent};
use super::cost::pairs;
use super::followed::scaled;
use super::generic::{GenericCorrection, Pair, fit};
use super::independence::independence;
use super::repeatable::partition;
use super::search::{Model, Search};
use super::spectra::history;
use crate::error::Result;
use crate::records::Split;
use realfft::num_complex::Complex;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

type C64 = Complex<f64>;

/// Longest lag of the residual behind the input, s.
const LONGEST_LAG_S: f64 = 3.0;

/// Evidence of one model, by output sensor.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Evidence {
    /// Share of the amplitude error that is the same in all events; below 0.3 hardly any correction of the site helps.
    pub repeatable_share: BTreeMap<String, f64>,
    /// Largest cross-correlation of a residual with the input over the bound for independent ones; above one the
    /// residual still follows the input.
    pub dependence: BTreeMap<String, f64>,
    /// A smooth complex factor without physical meaning, where it lowers the residual on validation events.
    pub generic: BTreeMap<String, GenericCorrection>,
}

/// Share of a model's whitened residual that follows the recorded input alike in all events, both components together.
pub(super) fn input_coherent_share(search: &Search<'_>, model: &Model) -> Option<f64> {
    let array = &search.scene.problem.array;
    let (n_sensor, n_component) = (array.outputs.len(), array.components.len().max(1));
    let mut channels: Vec<Vec<Trace<'_>>> = vec![Vec::new(); n_sensor * n_component];
    for (groups, residual) in [(&search.train, &model.train.residual), (&search.validation, &model.validation.residual)]
    {
        let mut at = 0;
        for group in groups.iter().map(|g| &search.scene.groups[*g]) {
            let (n_record, n_bin) = (group.records.len(), group.frequencies_hz.len());
            for (r, record) in group.records.iter().enumerate() {
                let others = group.records.iter().filter(|o| o.event != record.event);
                let inputs: Vec<&[C64]> =
                    std::iter::once(record).chain(others).map(|o| o.channels[0].as_slice()).collect();
                let component = search.scene.problem.events[record.event].component();
                for s in 0..n_sensor {
                    channels[component * n_sensor + s].push(Trace {
                        frequencies_hz: &group.frequencies_hz,
                        inputs: inputs.clone(),
                        residual: group.residual_bins(&residual[at..], n_sensor, [r, s]),
                    });
                }
            }
            at += 2 * n_bin * n_record * n_sensor;
        }
    }
    let power = |traces: &[Trace<'_>]| -> f64 { traces.iter().flat_map(|t| &t.residual).map(C64::norm_sqr).sum() };
    let total: f64 = channels.iter().map(|t| power(t)).sum();
    let following: f64 = channels.iter().map(|t| coherent(t).both * power(t)).sum();
    (total > 0.0).then(|| following / total)
}

/// Evidence of `model`, which was settled against `anchor`.
///
/// # Errors
/// When the model's effects cannot be built.
pub(super) fn evidence(search: &Search<'_>, model: &Model, anchor: &Anchor) -> Result<Evidence> {
    let (scene, array) = (search.scene, &search.scene.problem.array);
    let unknowns = search.unknowns(&model.effects);
    let effects = unknowns.build(&scene.problem.declared, model.x())?;
    let x = scaled(scene, &unknowns, model.x())?;
    let mut found: Vec<(Split, usize, Vec<Pair>)> = Vec::new();
    for (groups, point) in [(&search.train, &model.train), (&search.validation, &model.validation)] {
        for g in groups {
            for (r, row) in pairs(scene, &effects, &point.responses, (anchor, &x), *g).into_iter().enumerate() {
                found.push((scene.groups[*g].split, scene.groups[*g].records[r].event, row));
            }
        }
    }
    let band_hz = search.settings.band_hz;
    let mut evidence = Evidence::default();
    for (s, name) in array.outputs.iter().enumerate() {
        let of = |split: Split| -> Vec<Pair> {
            found.iter().filter(|(own, ..)| *own == split).map(|(.., row)| row[s].clone()).collect()
        };
        let (train, validation) = (of(Split::Train), of(Split::Validation));
        if let Some(parts) = partition(&[train.clone(), validation.clone()].concat(), band_hz) {
            evidence.repeatable_share.insert(name.clone(), parts.repeatable_share());
        }
        if let Some(correction) = fit(&train, &validation, band_hz) {
            evidence.generic.insert(name.clone(), correction);
        }
        let dependence = found.iter().filter_map(|(_, event, row)| dependence(search, *event, &row[s]));
        if let Some(largest) = dependence.reduce(f64::max) {
            evidence.dependence.insert(name.clone(), largest);
        }
    }
    Ok(evidence)
}

/// Largest cross-correlation of the residual of one channel with the input of its record, over the bound.
fn dependence(search: &Search<'_>, event: usize, pair: &Pair) -> Option<f64> {
    let record = search.scene.groups.iter().flat_map(|g| &g.records).find(|r| r.event == event)?;
    let [first, second] = [pair.frequencies_hz.first()?, pair.frequencies_hz.get(1)?];
    let bin = (first / (second - first)).round() as usize;
    let n = record.window.len();
    let residual: Vec<C64> = pair.measured.iter().zip(&pair.predicted).map(|(m, p)| m - p).collect();
    let dt_s = search.scene.problem.events[event].dt_s;
    let [input, residual] = [&record.channels[0], &residual].map(|x| history(x, bin, n));
    independence(&input, &residual, dt_s, LONGEST_LAG_S).map(|i| i.deviations / i.bound)
}
