//! A made-up array for tests: a uniform column under the errors of its sensors.

use super::anchor::Anchor;
use super::path::Path;
use super::problem::{Event, Motions, NoiseSpectrum, Problem, Replay};
use super::round::Fitted;
use super::search::Model;
use crate::column::{Layer, Profile};
use crate::effects::{self, Array, Channels, Direction, Recording, Situation};
use crate::error::Result;
use crate::manifest::Tolerances;
use crate::numerics::{random, spectrum};
use crate::records::Split;
use rand_distr::{Distribution, StandardNormal};
use realfft::num_complex::Complex;
use std::f64::consts::TAU;

type C64 = Complex<f64>;

pub const DT_S: f64 = 0.02;
const STEPS: usize = 2048;
pub const DEPTH_M: f64 = 40.0;

/// The array, its uniform profile of `vs_m_s`.
pub fn array(vs_m_s: f64) -> Array {
    Array {
        profile: Profile {
            water_table_m: 100.0,
            ..Profile::plain(vec![Layer::plain("elastic", DEPTH_M, 2000.0, vs_m_s)])
        },
        input: "base".into(),
        outputs: ["mid", "top"].map(String::from).to_vec(),
        depths_m: vec![20.0, 0.0],
        components: ["EW", "NS"].map(String::from).to_vec(),
    }
}

/// Motion at `depth_m` over that of the base of a uniform column.
pub fn transfer(vs_m_s: f64, damping_ratio: f64, depth_m: f64, frequency_hz: f64) -> C64 {
    let k = TAU * frequency_hz / (C64::new(1.0, 2.0 * damping_ratio).sqrt() * vs_m_s);
    (k * depth_m).cos() / (k * DEPTH_M).cos()
}

/// Motion at `depth_m` of a uniform column, shaken with `base`.
pub fn moved(base: &[f64], [vs_m_s, damping_ratio]: [f64; 2], depth_m: f64) -> Vec<f64> {
    let [motion] = spectrum::respond([base], DT_S, |f, [u]| [u * transfer(vs_m_s, damping_ratio, depth_m, f)]);
    motion
}

/// Six events of a uniform column of 150 m/s, declared as one of 200 m/s, seen through `effects`.
pub fn problem(table: &str) -> Problem {
    let tables: Vec<toml::Table> = if table.is_empty() { Vec::new() } else { vec![toml::from_str(table).unwrap()] };
    let built = effects::build_all(&tables).unwrap();
    let array = array(200.0);
    let mut stream = random::stream(5, "low frequency");
    let mut events = Vec::new();
    for e in 0..6 {
        let name = format!("E{e}");
        let mut motions: Vec<Channels> = vec![Vec::new(); 3];
        for _ in 0..2 {
            let envelope = |i: usize| (-((i as f64 - 700.0) / 250.0).powi(2)).exp();
            let white: Vec<f64> = (0..STEPS).map(|i| envelope(i) * sample(&mut stream)).collect();
            for (s, z) in [DEPTH_M, 20.0, 0.0].into_iter().enumerate() {
                motions[s].push(moved(&white, [150.0, 0.03], z));
            }
        }
        let names: Vec<String> = array.sensors().map(String::from).collect();
        let recording = Recording {
            event: &name,
            dt_s: DT_S,
            sensors: &names,
            depths_m: &[DEPTH_M, 20.0, 0.0],
            components: &array.components,
        };
        let mut recorded = effects::observe(&recording, &motions, &built, Direction::Distort);
        recorded.iter_mut().flatten().flatten().for_each(|v| *v += 0.01 * sample(&mut stream));
        for c in 0..2 {
            events.push(Event {
                name: name.clone(),
                situation: Situation::of(c, &name, ["E0"]),
                split: Split::Train,
                dt_s: DT_S,
                input: recorded[0][c].clone(),
                outputs: recorded[1..].iter().map(|s| s[c].clone()).collect(),
                noise: vec![NoiseSpectrum::white(0.01, DT_S); 3],
            });
        }
    }
    let tolerances = Tolerances { gain_ln: 0.01, clock_s: 0.001, orientation_deg: 1.0, ..Tolerances::default() };
    Problem { array, declared: Vec::new(), tolerances, events }
}

/// The same, its last event being one to judge by.
pub fn judged(table: &str) -> Problem {
    let mut problem = problem(table);
    problem.events[10..].iter_mut().for_each(|e| e.split = Split::Validation);
    problem
}

/// Replays a uniform column that knows velocities, and damping that tolerances multiply and an effect adds to.
pub struct Uniform<'a>(pub &'a Problem);

impl Replay for Uniform<'_> {
    fn replay(&self, effects: &[toml::Table]) -> Result<Motions> {
        let sum = |kind: &str, key: &str| -> f64 {
            let of = |t: &&toml::Table| t["kind"].as_str() == Some(kind);
            effects.iter().filter(of).filter_map(|t| t.get(key)?.as_float()).sum()
        };
        let vs_m_s = 200.0 * sum("layer_velocity", "ln_factor").exp();
        let of_effect = |key: &str| sum("frequency_dependent_damping", key);
        let added = 100.0 * of_effect("beta_s") + 0.02 * of_effect("alpha_1_s");
        let damping_ratio = 0.02 * sum("small_strain_damping", "multiplier").max(0.1) + added;
        let passed = |event: &Event| {
            let at = |z: &f64| moved(&event.input, [vs_m_s, damping_ratio], *z);
            Some(self.0.array.depths_m.iter().map(at).collect())
        };
        Ok(self.0.events.iter().map(passed).collect())
    }
}

/// A path that ends with `corrected` and has recalibrated nothing.
pub(super) fn path(corrected: Model, anchor: Anchor) -> Path {
    let accepted = corrected.effects.iter().map(|instance| Fitted {
        instance: instance.clone(),
        model: corrected.clone(),
        gain: 1000.0,
        validation_gain: 100.0,
        is_confirmed: true,
        against: corrected.costs(),
        plain: None,
    });
    Path {
        declared: corrected.clone(),
        recalibrated: corrected.clone(),
        accepted: accepted.collect(),
        corrected,
        candidates: Vec::new(),
        first: Vec::new(),
        anchor,
        plain: Vec::new(),
        alternatives: Vec::new(),
        confirmed: None,
        rival: None,
        stand_ins: Vec::new(),
    }
}

fn sample(stream: &mut impl rand::Rng) -> f64 {
    StandardNormal.sample(stream)
}
