//! A made-up array for tests: a uniform elastic column that an analytic solution replays.

use super::competition::Competition;
use super::forward::Forward;
use super::parameters::{Declared, Model};
use super::posterior::{Fit, Fitter, Start, Stop};
use super::weights::Expected;
use crate::column::{Analysis, BaseMotion, Column, Layer, MassMatrix, Profile};
use crate::dataset::all_sensor_histories;
use crate::diagnosis::{DiagnoseSettings, Event, Motions, NoiseSource, NoiseSpectrum, Problem, Replay};
use crate::effects::{self, Array, Channels, Direction, Effect, Recording, Situation, Tolerances, kind};
use crate::error::{Error, Result};
use crate::numerics::{random, spectrum};
use crate::records::Split;
use rand_distr::{Distribution, StandardNormal};
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::sync::Arc;

type C64 = Complex<f64>;

pub const DT_S: f64 = 0.02;
const STEPS: usize = 2048;
const DEPTH_M: f64 = 40.0;
/// Of the nonlinear column.
const ELEMENTS: usize = 80;
/// Damping ratio of the declared column.
pub const DAMPING: f64 = 0.02;
/// Largest damping ratio that a law takes.
const MAX_DAMPING: f64 = 0.5;

fn array(vs_m_s: f64) -> Array {
    let law = toml::Table::from_iter([("damping_ratio".to_string(), DAMPING.into())]);
    Array {
        profile: Profile {
            water_table_m: 100.0,
            ..Profile::plain(vec![Layer { law: law.into(), ..Layer::plain("elastic", DEPTH_M, 2000.0, vs_m_s) }])
        },
        input: "base".into(),
        outputs: ["mid", "top"].map(String::from).to_vec(),
        depths_m: vec![20.0, 0.0],
        components: ["EW", "NS"].map(String::from).to_vec(),
    }
}

fn transfer(vs_m_s: f64, damping_ratio: f64, depth_m: f64, frequency_hz: f64) -> C64 {
    let k = TAU * frequency_hz / (C64::new(1.0, 2.0 * damping_ratio).sqrt() * vs_m_s);
    (k * depth_m).cos() / (k * DEPTH_M).cos()
}

fn moved(base: &[f64], [vs_m_s, damping_ratio]: [f64; 2], depth_m: f64) -> Vec<f64> {
    let [motion] = spectrum::respond([base], DT_S, |f, [u]| [u * transfer(vs_m_s, damping_ratio, depth_m, f)]);
    motion
}

/// What holds at the made-up site.
pub struct Truth<'a> {
    /// `[[effects]]` of sensors.
    pub table: &'a str,
    /// Velocity (m/s) and damping ratio of the column, declared as 200 m/s and [`DAMPING`].
    pub soil: [f64; 2],
    /// Noise of every sensor, m/s².
    pub noise_m_s2: f64,
    /// Coherence at a frequency.
    pub coherence: fn(f64) -> f64,
    /// For all that is drawn.
    pub seed: u64,
    /// Events, the last quarter of them for validation.
    pub events: u32,
}

impl Default for Truth<'_> {
    fn default() -> Self {
        Self { table: "", soil: [200.0, DAMPING], noise_m_s2: 0.01, coherence: |_| 1.0, seed: 5, events: 8 }
    }
}

/// Events of a uniform column.
pub fn problem(truth: &Truth<'_>) -> Problem {
    let tables: Vec<toml::Table> =
        if truth.table.is_empty() { Vec::new() } else { vec![toml::from_str(truth.table).unwrap()] };
    let built = effects::build_all(&tables).unwrap();
    let array = array(200.0);
    let mut stream = random::stream(truth.seed, "made up");
    let mut events = Vec::new();
    for e in 0..truth.events {
        let name = format!("E{e}");
        let mut motions: Vec<Channels> = vec![Vec::new(); 3];
        let size = 0.5 + 1.6 * f64::from(e) / f64::from(truth.events);
        for _ in 0..2 {
            let envelope = |i: usize| size * (-((i as f64 - 700.0) / 250.0).powi(2)).exp();
            let white: Vec<f64> = (0..STEPS).map(|i| envelope(i) * sample(&mut stream)).collect();
            motions[0].push(white.clone());
            for (s, z) in [(1, 20.0), (2, 0.0)] {
                let follows = moved(&white, truth.soil, z);
                let other: Vec<f64> = (0..STEPS).map(|i| envelope(i) * sample(&mut stream)).collect();
                let strays = moved(&other, truth.soil, z);
                let c = truth.coherence;
                let [both] = spectrum::respond([&follows], DT_S, |f, [y]| [y * c(f)]);
                let [rest] = spectrum::respond([&strays], DT_S, |f, [y]| [y * (1.0 - c(f).powi(2)).sqrt()]);
                motions[s].push(both.iter().zip(rest).map(|(a, b)| a + b).collect());
            }
        }
        let names: Vec<String> = array.sensors().map(String::from).collect();
        let mut recorded = effects::observe(&recording(&array, &name, &names), &motions, &built, Direction::Distort);
        recorded.iter_mut().flatten().flatten().for_each(|v| *v += truth.noise_m_s2 * sample(&mut stream));
        for c in 0..2 {
            events.push(Event {
                name: name.clone(),
                situation: Situation::of(c, &name, ["E0"]),
                split: if 4 * e < 3 * truth.events { Split::Train } else { Split::Validation },
                dt_s: DT_S,
                input: recorded[0][c].clone(),
                outputs: recorded[1..].iter().map(|s| s[c].clone()).collect(),
                noise: vec![NoiseSpectrum::white(truth.noise_m_s2, DT_S, NoiseSource::Declared); 3],
            });
        }
    }
    Problem { array, declared: Vec::new(), tolerances: Tolerances::default(), events }
}

/// How the sensors of the made-up site recorded an event.
fn recording<'r>(array: &'r Array, event: &'r str, sensors: &'r [String]) -> Recording<'r> {
    Recording { event, dt_s: DT_S, sensors, depths_m: &[DEPTH_M, 20.0, 0.0], components: &array.components }
}

/// Motion of the base in each record, what sensors did to it undone.
fn bases(problem: &Problem, built: &[Box<dyn Effect>]) -> Vec<Vec<f64>> {
    let names: Vec<String> = problem.array.sensors().map(String::from).collect();
    let undone = |both: &[Event]| {
        let channels =
            |s: usize| both.iter().map(move |e| if s == 0 { e.input.clone() } else { e.outputs[s - 1].clone() });
        let recorded: Vec<Channels> = (0..names.len()).map(|s| channels(s).collect()).collect();
        let recording = recording(&problem.array, &both[0].name, &names);
        effects::observe(&recording, &recorded, built, Direction::Undo).swap_remove(0)
    };
    problem.events.chunks(2).flat_map(undone).collect()
}

/// Replays the uniform column, which knows one velocity and one damping ratio.
pub struct Uniform<'a>(pub &'a Problem);

impl Replay for Uniform<'_> {
    fn replay(&self, tables: &[toml::Table]) -> Result<Motions> {
        let of = |kind: &'static str, key: &'static str| {
            let is_kind = move |t: &&toml::Table| t["kind"].as_str() == Some(kind);
            tables.iter().filter(is_kind).filter_map(move |t| t.get(key)?.as_float())
        };
        let vs_m_s = 200.0 * of(kind::LAYER_VELOCITY, "ln_factor").sum::<f64>().exp();
        let damping_ratio = DAMPING * of(kind::SMALL_STRAIN_DAMPING, "multiplier").product::<f64>();
        if damping_ratio > MAX_DAMPING {
            return Err(Error::new("damping beyond what a law takes"));
        }
        let passed = |base: &Vec<f64>| {
            let at = |z: &f64| moved(base, [vs_m_s, damping_ratio], *z);
            Ok(self.0.array.depths_m.iter().map(at).collect())
        };
        Ok(bases(self.0, &effects::build_all(tables)?).iter().map(passed).collect())
    }
}

/// Replays the nonlinear column of the declared profile.
pub struct Nonlinear<'a>(pub &'a Problem);

impl Replay for Nonlinear<'_> {
    fn replay(&self, tables: &[toml::Table]) -> Result<Motions> {
        let mut profile = Profile { elements: ELEMENTS, ..self.0.array.profile.clone() };
        effects::build_all(tables)?.iter().for_each(|e| e.edit(&mut profile, &Situation::default()));
        let mass = MassMatrix::Matched;
        let analysis = Analysis { output_step_s: DT_S, max_jump: f64::INFINITY, mass, ..Analysis::default() };
        let column = Column::new(&profile, &analysis)?;
        let bases: Vec<BaseMotion<'_>> =
            self.0.events.iter().map(|e| BaseMotion { dt_s: DT_S, acceleration_m_s2: &e.input }).collect();
        let found = all_sensor_histories(&column, &bases, &self.0.array.depths_m);
        found.into_iter().map(|histories| Ok(Ok(histories?.split_off(1)))).collect()
    }
}

/// What fits the models of a competition, and the fit without effects that it begins with.
pub type Beginning<'a> = (Fitter<'a>, Fit<'a>);

/// The beginning in which nothing is recalibrated.
pub fn as_declared<'a>(forward: &'a Forward<'a>, declared: &'a Declared) -> Beginning<'a> {
    let none = Model { declared, effects: Vec::new() };
    let x = vec![0.0; none.len()];
    beginning_at(forward, none, x, Stop::WHERE_IT_IS)
}

/// The beginning with a fit from `x`, where what is expected of residuals is read off.
pub fn beginning_at<'a>(forward: &'a Forward<'a>, model: Model<'a>, x: Vec<f64>, stop: Stop) -> Beginning<'a> {
    forward.anchor(&[]).unwrap();
    let prediction = Arc::new(forward.predict(&model.tables(&x)).unwrap());
    let fitter = Fitter::new(forward, Expected::of(forward, prediction));
    let fit = fitter.fit(Start::at(model, x), stop).unwrap();
    (fitter, fit)
}

/// Checks a competition over the records of `problem`.
pub fn in_competition(
    problem: &Problem,
    replay: &dyn Replay,
    begin: impl for<'a> FnOnce(&'a Forward<'a>, &'a Declared) -> Beginning<'a>,
    check: impl FnOnce(Competition<'_>),
) {
    let forward = Forward::new(problem, replay, &DiagnoseSettings::default()).unwrap();
    let declared = Declared::new(problem).unwrap();
    let (fitter, fit) = begin(&forward, &declared);
    // The equivalent-linear column is not that of these replays.
    let surrogate = forward.again();
    check(Competition::new(fitter, fit, &surrogate, 4));
}

/// A standard normal number.
pub fn sample(stream: &mut impl rand::Rng) -> f64 {
    StandardNormal.sample(stream)
}
