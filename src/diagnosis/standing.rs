//! Errors of sensors that stand whatever the profile: what the low frequencies say, put down to one sensor or another.

use super::hygiene::Suspicion;
use super::low_frequency::{Error, Passed, passed};
use super::outcome::{Estimate, Found};
use super::problem::{Motions, Problem, Replay};
use super::responses::Scene;
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use super::tilt::{self, tilts, without};
use super::unknowns::{nuisance_tables, nuisances};
use crate::effects::{self, Array, Class};
use crate::error::Result;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use toml::{Table, Value};

/// Distance from what is declared that is beyond doubt, in standard deviations.
const BEYOND: f64 = 4.0;
/// What the field is from one-dimensional at low frequencies, by [`KINDS`]: 3 %, 3 ms, [`CORNER_HZ`], 1°; a tilt of 0.01° that it may
/// have.
const FIELD: [f64; 5] = [0.03, 0.003, CORNER_HZ, 0.017, tilt::FIELD_DEG];
/// Corner of a high-pass that any instrument may have, Hz.
pub(super) const CORNER_HZ: f64 = 0.01;
/// Place of tilts in [`KINDS`].
const TILT: usize = 4;
/// Normal quantile of a two-sided 95 % interval.
const TWO_SIDED: f64 = 1.96;

/// An error of a sensor that stands, and what the low frequencies cannot tell from it.
#[derive(Debug, Clone, PartialEq)]
pub struct Standing {
    /// The effect.
    pub found: Found,
    /// Kinds that look the same there, its own included.
    pub alike: Vec<String>,
    /// Why it stands, for people.
    pub why: &'static str,
}

/// Cost over that of noise alone up to which amplitudes of the whole band are trusted.
const TRUSTED: f64 = 2.0;
/// The effect that delays all output sensors.
const BASE: &str = "compliant_base";
/// Steps of a recalibration.
const STEPS: usize = 6;

const PASSED: &str = "stands whatever the profile: every column passes low frequencies alike";
const LABELS: &str = "stands: with these labels and signs every event fits far better";

/// `standing` with those that look like other kinds at low frequencies told from them by the whole band, where the model is
/// good enough for its amplitudes to say so; a base that lets waves out is left to the search.
///
/// # Errors
/// When an event is unusable or a replay is impossible.
pub fn decided(
    mut standing: Vec<Standing>,
    problem: &Problem,
    replay: &dyn Replay,
    settings: &DiagnoseSettings,
) -> Result<Vec<Standing>> {
    let mut at = 0;
    while at < standing.len() {
        let alike = standing[at].alike.clone();
        let mut options = Vec::new();
        for kind in &alike {
            let own = if *kind == standing[at].found.kind {
                Some(standing[at].clone())
            } else {
                low_pass(&standing[at], &problem.array).filter(|l| l.found.kind == *kind)
            };
            let others = standing.iter().enumerate().filter(|(i, _)| *i != at).map(|(_, s)| s.clone());
            let beside: Vec<Standing> = own.iter().cloned().chain(others).collect();
            let more = own.is_none().then_some(kind.as_str());
            let model = settled(problem, replay, settings, &beside, more)?;
            options.extend(model.map(|(m, _)| (own, [m.cost(), m.level()])));
        }
        options.sort_by(|a, b| a.1[0].total_cmp(&b.1[0]));
        let is_clear = match options.as_slice() {
            [(_, best), (_, next), ..] => {
                best[1] < TRUSTED && next[0] - best[0] > settings.ambiguity * best[1].max(1.0)
            }
            _ => false,
        };
        match options.into_iter().next().filter(|_| is_clear) {
            Some((Some(own), _)) => standing[at] = Standing { alike: Vec::new(), ..own },
            Some((None, _)) => {
                standing.remove(at);
                continue;
            }
            // Where several output sensors share a delay, the search has their differences to judge a base by.
            None if alike.iter().any(|kind| kind == BASE) && problem.array.outputs.len() > 1 => {
                standing.remove(at);
                continue;
            }
            None => {}
        }
        at += 1;
    }
    Ok(standing)
}

/// What may stand instead: each of the kinds that look the same at low frequencies, and nothing, for these may have been the
/// soil's.
pub(super) fn others(standing: &[Standing], array: &Array) -> Vec<Vec<Standing>> {
    let mut all = Vec::new();
    for (at, own) in standing.iter().enumerate() {
        if let Some(other) = low_pass(own, array).filter(|l| own.alike.contains(&l.found.kind)) {
            let mut instead = standing.to_vec();
            // Where it is better than its like, it is told from them.
            instead[at] = Standing { alike: Vec::new(), ..other };
            all.push(instead);
        }
    }
    // No soil tilts a sensor.
    let tilts: Vec<Standing> = standing.iter().filter(|s| s.found.kind == tilt::KIND).cloned().collect();
    if tilts.len() < standing.len() {
        all.push(tilts);
    }
    all
}

/// The recalibrated model beside what stands, with an effect of `kind` more; with the tables of its nuisances.
pub(super) fn settled(
    problem: &Problem,
    replay: &dyn Replay,
    settings: &DiagnoseSettings,
    standing: &[Standing],
    kind: Option<&str>,
) -> Result<Option<(Model, Vec<Table>)>> {
    let (known, replay) = beside(problem, replay, &tables(standing));
    let mut scene = Scene::new(&known, settings)?;
    let anchor = scene.declared(Some(&replay), nuisances(&known)?.len())?;
    let search = Search::new(&scene, settings, Some(&replay))?;
    let mut x = vec![0.0; search.nuisances.len()];
    let mut effects = Vec::new();
    if let Some(kind) = kind {
        let Some(instance) = search.instances.iter().find(|i| i.kind == kind) else { return Ok(None) };
        x.extend(instance.start());
        effects.push(instance.clone());
    }
    let model = search.settle(&effects, &x, &anchor, None, STEPS)?;
    let tables = nuisance_tables(&search.nuisances, model.x());
    Ok(Some((model, tables)))
}

/// The low-pass that delays low frequencies as the clock of `standing` does.
fn low_pass(standing: &Standing, array: &Array) -> Option<Standing> {
    let delay = standing.found.parameters.get("offset_s")?;
    let own = standing.found.table.get("sensor").and_then(Value::as_str)?;
    // What is early at the one output sensor is late at the input sensor.
    let sensor = match (delay.value > 0.0, array.outputs.as_slice()) {
        (true, _) => own,
        (false, [only]) if only == own => array.input.as_str(),
        _ => return None,
    };
    let corner_hz = |offset_s: f64| 1.0 / (TAU * offset_s.abs());
    let mut table = table("instrument_low_pass", sensor);
    table.insert("corner_hz".into(), Value::Float(corner_hz(delay.value)));
    let [low, high] = delay.ci95.map(corner_hz);
    let ci95 = [low.min(high), low.max(high)];
    let estimate = Estimate { value: corner_hz(delay.value), unit: "Hz".into(), ci95 };
    let alike: Vec<&str> = standing.alike.iter().map(String::as_str).collect();
    Some(stands(table, BTreeMap::from([("corner_hz".to_string(), estimate)]), standing.found.gain, &alike))
}

/// `[[effects]]` tables of what stands.
pub(super) fn tables(standing: &[Standing]) -> Vec<Table> {
    standing.iter().map(|s| s.found.table.clone()).collect()
}

/// `problem` with these effects declared, and its column shaken accordingly.
pub fn beside<'a>(problem: &Problem, replay: &'a dyn Replay, effects: &[Table]) -> (Problem, Beside<'a>) {
    let mut known = problem.clone();
    known.declared.extend(effects.iter().cloned());
    (known, Beside { replay, tables: effects.to_vec() })
}

/// Replays under effects that stand already.
pub struct Beside<'a> {
    pub(super) replay: &'a dyn Replay,
    pub(super) tables: Vec<Table>,
}

impl Beside<'_> {
    fn and(&self, effects: &[Table]) -> Vec<Table> {
        self.tables.iter().chain(effects).cloned().collect()
    }
}

impl Replay for Beside<'_> {
    fn replay(&self, effects: &[Table]) -> Result<Motions> {
        self.replay.replay(&self.and(effects))
    }

    fn replay_roughly(&self, effects: &[Table]) -> Result<Motions> {
        self.replay.replay_roughly(&self.and(effects))
    }

    fn replay_noisier(&self, effects: &[Table]) -> Result<Motions> {
        self.replay.replay_noisier(&self.and(effects))
    }
}

/// Kinds of [`Passed::errors`] and of tilts, with the parameter and its unit.
pub(super) const KINDS: [[&str; 3]; 5] = [
    ["sensor_gain", "ln_gain", ""],
    ["clock_offset", "offset_s", "s"],
    ["instrument_high_pass", "corner_hz", "Hz"],
    ["sensor_orientation", "azimuth_deg", "°"],
    [tilt::KIND, "tilt_deg", "°"],
];

/// Errors of sensors in `problem` that stand out of the declared tolerances, whether the declared column was replayed or not.
///
/// One output sensor tells no more than its error less that of the input sensor: it is then put down to the output sensor.
/// What most of several output sensors share is put down to the input sensor.
///
/// Limits: waves that come aslant or run along the surface are in `FIELD` only; at a low-pass or a base that lets waves out, motions are late at low frequencies as if a clock were wrong.
/// Check:  `what_all_outputs_share_is_the_input_sensors`.
///
/// # Errors
/// When an effect that stands is not registered.
pub fn standing(problem: &Problem, replays: Option<&Motions>, settings: &DiagnoseSettings) -> Result<Vec<Standing>> {
    let array = &problem.array;
    let cleaned = without(problem, &problem.declared)?;
    let own = tilts(&cleaned)?;
    let own: Vec<(usize, Error)> = own.into_iter().enumerate().collect();
    let mut found = Attributed::default();
    found.add(TILT, &own, 0.0, array);
    let known = found.all().map(|s| s.found.table.clone()).chain(problem.declared.iter().cloned());
    let level = without(problem, &known.collect::<Vec<_>>())?;
    let passed = passed(&level, replays, settings.band_hz[0]);
    reflections(problem, &passed, &mut found);
    let t = &problem.tolerances;
    for (kind, tolerance) in [t.gain_ln, t.clock_s, 0.0, t.orientation_deg.to_radians()].into_iter().enumerate() {
        let own: Vec<(usize, Error)> = passed.iter().map(|p| (p.output, p.errors[kind].unwrap_or(NOTHING))).collect();
        found.add(kind, &own, tolerance, array);
    }
    // The records went through reflections before turns; to undo them at the input sensor they come the other way round.
    found.of_input.reverse();
    found.of_outputs.sort_by_key(|(output, _)| *output);
    Ok(found.of_input.into_iter().chain(found.of_outputs.into_iter().map(|(_, s)| s)).collect())
}

/// What stands, put down to the input sensor or to output sensors by their index.
#[derive(Default)]
struct Attributed {
    of_input: Vec<Standing>,
    of_outputs: Vec<(usize, Standing)>,
}

impl Attributed {
    fn all(&self) -> impl Iterator<Item = &Standing> {
        self.of_input.iter().chain(self.of_outputs.iter().map(|(_, s)| s))
    }

    /// Errors of `KINDS[kind]` of the output sensors against the input sensor that are beyond the `tolerance`.
    fn add(&mut self, kind: usize, own: &[(usize, Error)], tolerance: f64, array: &Array) {
        let tolerance = tolerance.hypot(FIELD[kind]);
        let common = shared(&own.iter().map(|(_, e)| *e).collect::<Vec<_>>(), tolerance);
        if let Some(common) = common {
            let error = Error { value: -common.value, ..common };
            self.of_input.push(effect(kind, &array.input, error, common.value > 0.0));
        }
        let common = common.map_or(0.0, |c| c.value);
        let is_alone = own.len() == 1;
        for (output, own) in own {
            let rest = Error { value: own.value - common, ..*own };
            if !is_beyond(rest, tolerance) {
                continue;
            }
            // A corner cannot be negative: it is the other sensor's.
            if kind != 2 || rest.value > 0.0 {
                let late = is_alone && rest.value > 0.0;
                self.of_outputs.push((*output, effect(kind, &array.outputs[*output], rest, late)));
            } else if is_alone {
                self.of_input.push(effect(kind, &array.input, Error { value: -rest.value, ..rest }, false));
            }
        }
    }
}

const NOTHING: Error = Error { value: 0.0, deviation: 0.0 };

fn is_beyond(error: Error, tolerance: f64) -> bool {
    error.value.abs() > BEYOND * error.deviation.hypot(tolerance)
}

/// The error that most of several output sensors share.
fn shared(own: &[Error], tolerance: f64) -> Option<Error> {
    if own.len() < 2 {
        return None;
    }
    let mut values: Vec<f64> = own.iter().map(|e| e.value).collect();
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    let value = if values.len() % 2 == 1 { values[half] } else { 0.5 * (values[half - 1] + values[half]) };
    let is_like = |e: &&Error| !is_beyond(Error { value: e.value - value, ..**e }, tolerance);
    let alike: Vec<&Error> = own.iter().filter(is_like).collect();
    let deviation = alike.iter().map(|e| e.deviation).fold(0.0, f64::max);
    let common = Error { value, deviation };
    (2 * alike.len() > own.len() && is_beyond(common, tolerance)).then_some(common)
}

fn reflections(problem: &Problem, passed: &[Passed], found: &mut Attributed) {
    let array = &problem.array;
    let is_none = |p: &Passed| p.reflection == [[1.0, 0.0], [0.0, 1.0]];
    let all = passed.len() > 1 && passed.iter().all(|p| p.reflection == passed[0].reflection);
    if all && !is_none(&passed[0]) {
        found.of_input.extend(reflection(&array.components, &array.input, passed[0].reflection));
        return;
    }
    for p in passed.iter().filter(|p| !is_none(p)) {
        let own = reflection(&array.components, &array.outputs[p.output], p.reflection);
        found.of_outputs.extend(own.into_iter().map(|s| (p.output, s)));
    }
}

/// A reflection as wrong labels and signs of a sensor.
fn reflection(components: &[String], sensor: &str, matrix: [[f64; 2]; 2]) -> Vec<Standing> {
    let polarity = |component: Option<&String>| {
        let mut table = table("sensor_polarity", sensor);
        table.extend(component.map(|c| ("component".to_string(), Value::from(c.as_str()))));
        stands(table, BTreeMap::new(), f64::INFINITY, &[])
    };
    let swapped = || stands(table("swapped_channels", sensor), BTreeMap::new(), f64::INFINITY, &[]);
    match matrix {
        [[a, _], _] if a < 0.0 => vec![polarity(components.first())],
        [_, [_, d]] if d < 0.0 => vec![polarity(components.get(1))],
        [[_, b], _] if b > 0.0 => vec![swapped()],
        _ => vec![swapped(), polarity(None)],
    }
}

/// The effect `kind` at `sensor`, without its parameters.
pub(super) fn table(kind: &str, sensor: &str) -> Table {
    Table::from_iter([("kind".to_string(), Value::from(kind)), ("sensor".to_string(), Value::from(sensor))])
}

/// The effect of `KINDS[kind]` at `sensor`; `all_late` where it makes all output sensors late against the input sensor.
fn effect(kind: usize, sensor: &str, error: Error, all_late: bool) -> Standing {
    let [name, parameter, unit] = KINDS[kind];
    let error = Error { deviation: error.deviation.hypot(FIELD[kind]), ..error };
    let in_unit = |x: f64| if kind == 3 { x.to_degrees() } else { x };
    let turned = if kind == 3 { (error.value + PI).rem_euclid(TAU) - PI } else { error.value };
    let [low, value, high] = [-TWO_SIDED, 0.0, TWO_SIDED].map(|s| in_unit(turned + s * error.deviation));
    let mut table = table(name, sensor);
    table.insert(parameter.into(), Value::Float(value));
    let estimate = Estimate { value, unit: unit.into(), ci95: [low, high] };
    let mut alike = Vec::new();
    if name == "clock_offset" {
        alike.extend(["clock_offset", "instrument_low_pass"]);
        // A compliant base delays every output sensor against what is declared to shake it.
        if all_late {
            alike.push(BASE);
        }
    }
    let deviations = error.value / error.deviation.max(f64::MIN_POSITIVE);
    stands(table, BTreeMap::from([(parameter.to_string(), estimate)]), deviations * deviations, &alike)
}

fn stands(table: Table, parameters: BTreeMap<String, Estimate>, gain: f64, alike: &[&str]) -> Standing {
    let kind = table.get("kind").and_then(Value::as_str).unwrap_or_default().to_string();
    let found = Found {
        target: effects::place(&table),
        kind,
        class: Class::Sensor,
        table,
        parameters,
        gain,
        validation_gain: 0.0,
        is_standing: true,
    };
    Standing { found, alike: alike.iter().map(ToString::to_string).collect(), why: PASSED }
}

/// Wrong labels and signs that stand by how the declared model fits.
pub fn labels(suspicion: Suspicion) -> Vec<Standing> {
    let of = |table| Standing { why: LABELS, ..stands(table, BTreeMap::new(), f64::INFINITY, &[]) };
    suspicion.tables.into_iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_all_outputs_share_is_the_input_sensors() {
        let error = |value| Error { value, deviation: 0.01 };
        let of = |values: &[f64]| shared(&values.iter().map(|v| error(*v)).collect::<Vec<_>>(), 0.01).map(|e| e.value);
        assert_eq!(of(&[0.3]), None, "one output sensor cannot tell");
        assert_eq!(of(&[0.3, 0.3, 0.32]), Some(0.3));
        assert_eq!(of(&[0.3, 0.0, 0.01]), None);
        assert_eq!(of(&[0.3, 0.0]), None);
        assert_eq!(of(&[0.3, 0.3, 0.6]), Some(0.3));
    }

    #[test]
    fn what_stands_gives_way_to_its_like_and_to_nothing() {
        let array = Array {
            profile: crate::column::Profile::plain(Vec::new()),
            input: "base".into(),
            outputs: vec!["middle".into(), "top".into()],
            depths_m: vec![5.0, 0.0],
            components: vec!["EW".into()],
        };
        let late = effect(1, "top", Error { value: 0.02, deviation: 0.001 }, false);
        let loud = effect(0, "middle", Error { value: 0.3, deviation: 0.01 }, false);
        let kinds = |standing: &[Standing]| standing.iter().map(|s| s.found.kind.clone()).collect::<Vec<_>>();
        let found: Vec<Vec<String>> = others(&[loud, late], &array).iter().map(|s| kinds(s)).collect();
        assert_eq!(found, [vec!["sensor_gain".to_string(), "instrument_low_pass".to_string()], vec![]]);
        assert!(others(&[], &array).is_empty());
    }

    #[test]
    fn reflections_become_labels_and_signs_that_make_them() {
        let components = ["NS", "EW"].map(String::from);
        for matrix in
            [[[-1.0, 0.0], [0.0, 1.0]], [[1.0, 0.0], [0.0, -1.0]], [[0.0, 1.0], [1.0, 0.0]], [[0.0, -1.0], [-1.0, 0.0]]]
        {
            let tables: Vec<Table> =
                reflection(&components, "top", matrix).into_iter().map(|s| s.found.table).collect();
            let effects = effects::build_all(&tables).unwrap();
            let place = effects::Place { sensor: "top", components: &components };
            let made = effects::operator(&effects, &place, 1.0).unwrap().0;
            assert_eq!(made.map(|row| row.map(|v| v.re)), matrix);
        }
    }
}
