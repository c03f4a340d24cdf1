//! Signs and labels of the channels, judged before anything continuous: which assignment of records to predictions fits?

use super::anchor::Anchor;
use super::cost::pairs;
use super::generic::Pair;
use super::search::Search;
use super::unknowns::Placed;
use crate::effects::Array;
use crate::error::Result;
use realfft::num_complex::Complex;
use toml::{Table, Value};

type C64 = Complex<f64>;

/// Misfit over the declared assignment's that another one must stay below, in every event.
const CLEARLY: f64 = 0.6;

/// Spectra of all output channels of one event, `[sensor][component][bin]`.
#[derive(Debug, Clone)]
pub struct Shot {
    /// What the declared model predicts.
    pub predicted: Vec<Vec<Vec<C64>>>,
    /// What was recorded under the declared labels.
    pub measured: Vec<Vec<Vec<C64>>>,
}

/// Another assignment of channels that fits much better than the declared one.
#[derive(Debug, Clone, PartialEq)]
pub struct Suspicion {
    /// `[[effects]]` that say so: swapped channels and wrong signs.
    pub tables: Vec<Table>,
    /// Residual power over that of the records, declared and under the tables; mean over channels and events.
    pub misfit: [f64; 2],
}

/// What one recorded sensor really is.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    sensor: usize,
    is_turned: bool,
    signs: [f64; 2],
}

/// Tries every order of up to five output sensors, exchanged components and signs; `None` where the declared assignment
/// is the best or nearly so.
///
/// ```text
/// misfit = mean over channels and events of |Y − s Ŷ|²/|Y|²             (1)
/// ```
///
/// Wrong signs or labels of all outputs alike are those of the input sensor.
///
/// Limits: (1) of the declared model must be well below 2 for the right assignment; a model that is that far off tells nothing.
/// Check:  `each_wrong_label_is_found_and_sound_records_raise_no_suspicion`.
pub fn hygiene(array: &Array, shots: &[Shot]) -> Option<Suspicion> {
    let n_sensor = array.outputs.len();
    let n_component = array.components.len().min(2);
    if shots.is_empty() || n_component == 0 {
        return None;
    }
    let declared: Vec<Channel> =
        (0..n_sensor).map(|sensor| Channel { sensor, is_turned: false, signs: [1.0; 2] }).collect();
    let before = misfits(shots, &declared, n_component);
    let orders = if n_sensor <= 5 { orders(n_sensor) } else { vec![(0..n_sensor).collect()] };
    let best = orders
        .iter()
        .map(|order| {
            let assigned: Vec<Channel> =
                order.iter().enumerate().map(|(recorded, s)| best_channel(shots, recorded, *s, n_component)).collect();
            let misfit = misfits(shots, &assigned, n_component);
            (assigned, misfit)
        })
        .min_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1)))?;
    let (assigned, after) = best;
    let is_clear = before.iter().zip(&after).all(|(b, a)| *a < CLEARLY * b);
    (assigned != declared && is_clear)
        .then(|| Suspicion { tables: tables(array, &assigned, n_component), misfit: [mean(&before), mean(&after)] })
}

/// Tries the labels of `search`'s records against the model as declared, settled against `anchor`; events that lack a component
/// do not count.
///
/// # Errors
/// When the declared model cannot be evaluated.
pub(super) fn suspicion(search: &Search<'_>, anchor: &Anchor) -> Result<Option<Suspicion>> {
    let (scene, array) = (search.scene, &search.scene.problem.array);
    let declared = search.settle(&[], &vec![0.0; search.nuisances.len()], anchor, None, 0)?;
    let effects = search.unknowns(&[]).build(&scene.problem.declared, declared.x())?;
    let mut shots = Vec::new();
    for (groups, point) in [(&search.train, &declared.train), (&search.validation, &declared.validation)] {
        for g in groups.iter().filter(|g| scene.groups[**g].records.len() == array.components.len()) {
            let rows = pairs(scene, &effects, &point.responses, (anchor, &Placed::plain(declared.x())), *g);
            let of = |choose: fn(&Pair) -> &Vec<C64>| -> Vec<Vec<Vec<C64>>> {
                (0..array.outputs.len()).map(|s| rows.iter().map(|row| choose(&row[s]).clone()).collect()).collect()
            };
            shots.push(Shot { predicted: of(|p| &p.predicted), measured: of(|p| &p.measured) });
        }
    }
    Ok(hygiene(array, &shots))
}

fn mean(x: &[f64]) -> f64 {
    x.iter().sum::<f64>() / x.len().max(1) as f64
}

/// (1) of each event.
fn misfits(shots: &[Shot], assigned: &[Channel], n_component: usize) -> Vec<f64> {
    let of = |shot: &Shot| {
        let channels = assigned.iter().enumerate().flat_map(|(s, a)| (0..n_component).map(move |c| (s, *a, c)));
        let each: Vec<f64> = channels.map(|(s, a, c)| misfit(shot, s, &a, c)).collect();
        mean(&each)
    };
    shots.iter().map(of).collect()
}

fn misfit(shot: &Shot, recorded: usize, channel: &Channel, c: usize) -> f64 {
    let y = &shot.measured[recorded][c];
    let from = if channel.is_turned { 1 - c } else { c };
    let p = &shot.predicted[channel.sensor][from];
    let rest: f64 = y.iter().zip(p).map(|(y, p)| (y - p * channel.signs[c]).norm_sqr()).sum();
    rest / y.iter().map(C64::norm_sqr).sum::<f64>().max(f64::MIN_POSITIVE)
}

/// The components and signs with which `recorded` fits the prediction of `sensor` best.
fn best_channel(shots: &[Shot], recorded: usize, sensor: usize, n_component: usize) -> Channel {
    let turns: &[bool] = if n_component == 2 { &[false, true] } else { &[false] };
    let total = |channel: &Channel, c: usize| shots.iter().map(|shot| misfit(shot, recorded, channel, c)).sum::<f64>();
    let with_signs = |is_turned: bool| {
        let mut channel = Channel { sensor, is_turned, signs: [1.0; 2] };
        let mut sum = 0.0;
        for c in 0..n_component {
            let positive = total(&channel, c);
            channel.signs[c] = -1.0;
            let negative = total(&channel, c);
            if positive <= negative {
                channel.signs[c] = 1.0;
            }
            sum += positive.min(negative);
        }
        (channel, sum)
    };
    let all = turns.iter().map(|t| with_signs(*t));
    let declared = Channel { sensor, is_turned: false, signs: [1.0; 2] };
    all.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(declared, |(channel, _)| channel)
}

/// All orders of 0…n−1, the declared one first.
fn orders(n: usize) -> Vec<Vec<usize>> {
    if n == 0 {
        return vec![Vec::new()];
    }
    let mut found: Vec<Vec<usize>> = Vec::new();
    for first in 0..n {
        for rest in orders(n - 1) {
            let mut order = vec![first];
            order.extend(rest.iter().map(|i| if *i >= first { i + 1 } else { *i }));
            found.push(order);
        }
    }
    found
}

/// The assignment as effects.
fn tables(array: &Array, assigned: &[Channel], n_component: usize) -> Vec<Table> {
    let table = |kind: &str, keys: &[(&str, &str)]| {
        let mut table = Table::from_iter([("kind".to_string(), Value::from(kind))]);
        table.extend(keys.iter().map(|(k, v)| (k.to_string(), Value::from(*v))));
        table
    };
    let mut found = Vec::new();
    let mut now: Vec<usize> = (0..assigned.len()).collect();
    for (recorded, channel) in assigned.iter().enumerate() {
        if now[recorded] != channel.sensor
            && let Some(other) = now.iter().position(|s| *s == channel.sensor)
        {
            now.swap(recorded, other);
            let names = [("sensor", array.outputs[recorded].as_str()), ("with", array.outputs[other].as_str())];
            found.push(table("swapped_channels", &names));
        }
    }
    // Turned components of all outputs are those of the input, and so are signs.
    let all_turned = assigned.iter().all(|c| c.is_turned);
    for channel in assigned.iter().filter(|c| c.is_turned && !all_turned) {
        found.push(table("swapped_channels", &[("sensor", &array.outputs[channel.sensor])]));
    }
    if all_turned {
        found.push(table("swapped_channels", &[("sensor", &array.input)]));
    }
    for c in 0..n_component {
        let wrong: Vec<&Channel> = assigned.iter().filter(|a| a.signs[c] < 0.0).collect();
        let component = &array.components[c];
        if wrong.len() == assigned.len() && !all_turned {
            found.push(table("sensor_polarity", &[("sensor", &array.input), ("component", component)]));
        } else {
            found.extend(
                wrong.iter().map(|a| {
                    table("sensor_polarity", &[("sensor", &array.outputs[a.sensor]), ("component", component)])
                }),
            );
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::{Features, Profile, Rayleigh, Vertical};
    use crate::effects::{self, Place};
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    fn array() -> Array {
        let profile = Profile {
            layers: Vec::new(),
            water_table_m: 0.0,
            vertical: Vertical::Free,
            rayleigh: Rayleigh::default(),
            elements: 1,
            features: Features::default(),
        };
        Array {
            profile,
            input: "base".into(),
            outputs: ["deep", "mid", "top"].map(String::from).to_vec(),
            depths_m: vec![11.0, 6.0, 0.0],
            components: ["EW", "NS"].map(String::from).to_vec(),
        }
    }

    /// Four events whose predictions are 30 % off, seen through `tables`.
    fn shots(tables: &[&str]) -> Vec<Shot> {
        let array = array();
        let tables: Vec<Table> = tables.iter().map(|t| toml::from_str(t).unwrap()).collect();
        let effects = effects::build_all(&tables).unwrap();
        let mut stream = random::stream(6, "hygiene");
        let mut normal = || -> f64 { StandardNormal.sample(&mut stream) };
        let mut white = || -> Vec<C64> { (0..200).map(|_| C64::new(normal(), normal())).collect() };
        (0..4)
            .map(|_| {
                let input = [white(), white()];
                let predicted: Vec<Vec<Vec<C64>>> = (0..3)
                    .map(|s| {
                        let delay = |k: usize| C64::from_polar(1.0 + 0.5 * s as f64, -0.01 * (s * k) as f64);
                        input.iter().map(|u| u.iter().enumerate().map(|(k, u)| u * delay(k)).collect()).collect()
                    })
                    .collect();
                let mut measured = predicted.clone();
                for channel in measured.iter_mut().flatten() {
                    channel.iter_mut().zip(white()).for_each(|(y, w)| *y += w * 0.3);
                }
                for (name, channels) in array.outputs.iter().zip(&mut measured) {
                    let place = Place { sensor: name, components: &array.components };
                    let Some(o) = effects::operator(&effects, &place, 1.0) else { continue };
                    let [first, second] = channels.as_mut_slice() else { panic!("two components") };
                    for (a, b) in first.iter_mut().zip(second) {
                        [*a, *b] = o.apply([*a, *b]);
                    }
                }
                for (a, b) in effects.iter().filter_map(|e| e.exchange()) {
                    let at = |name: &str| array.outputs.iter().position(|o| o == name).unwrap();
                    measured.swap(at(a), at(b));
                }
                Shot { predicted, measured }
            })
            .collect()
    }

    #[test]
    fn each_wrong_label_is_found_and_sound_records_raise_no_suspicion() {
        assert!(hygiene(&array(), &shots(&[])).is_none());
        for tables in [
            vec!["kind = 'sensor_polarity'\nsensor = 'top'\ncomponent = 'NS'"],
            vec!["kind = 'swapped_channels'\nsensor = 'deep'\nwith = 'top'"],
            vec!["kind = 'swapped_channels'\nsensor = 'mid'"],
            vec![
                "kind = 'swapped_channels'\nsensor = 'deep'\nwith = 'mid'",
                "kind = 'sensor_polarity'\nsensor = 'mid'\ncomponent = 'EW'",
            ],
        ] {
            let found = hygiene(&array(), &shots(&tables)).unwrap();
            let expected: Vec<Table> = tables.iter().map(|t| toml::from_str(t).unwrap()).collect();
            assert_eq!(found.tables, expected);
            assert!(found.misfit[1] < 0.15 && found.misfit[0] > 2.0 * found.misfit[1], "{:?}", found.misfit);
        }
    }

    #[test]
    fn a_wrong_sign_of_all_outputs_is_that_of_the_input() {
        let mut shots = shots(&[]);
        shots.iter_mut().flat_map(|s| &mut s.measured).for_each(|s| s[1].iter_mut().for_each(|v| *v = -*v));
        let found = hygiene(&array(), &shots).unwrap();
        let expected: Table = toml::from_str("kind = 'sensor_polarity'\nsensor = 'base'\ncomponent = 'NS'").unwrap();
        assert_eq!(found.tables, [expected]);
    }
}
