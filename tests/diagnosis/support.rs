//! A small array and twins of it.

use flare_pipe::column::{Analysis, BaseMotion, Column, Features, Layer, Profile, Rayleigh, Vertical};
use flare_pipe::dataset::sensor_histories;
use flare_pipe::diagnosis::{DiagnoseSettings, Event, NoiseSpectrum, Problem, Replay};
use flare_pipe::effects::{self, Array, Direction, Recording, Situation};
use flare_pipe::error::Result;
use flare_pipe::manifest::Tolerances;
use flare_pipe::motion::{self, Band, MotionSettings};
use flare_pipe::numerics::{random, resample};
use flare_pipe::records::Split;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::sync::Mutex;

/// Time step of the records, s.
pub const STEP_S: f64 = 0.02;
/// Standard deviation of the noise as a share of a channel's RMS.
pub const NOISE: f64 = 0.03;

/// A hyperbolic column of 17 m, velocities growing with depth.
pub fn profile(elements: usize) -> Profile {
    let vs = [110.0, 125.0, 140.0, 155.0, 165.0, 180.0, 200.0];
    let thickness = [1.0, 2.0, 3.0, 2.0, 3.0, 3.0, 3.0];
    let law = || table("plasticity_index = 10.0");
    Profile {
        layers: vs
            .iter()
            .zip(thickness)
            .map(|(vs_m_s, thickness_m)| Layer {
                thickness_m,
                density_kg_m3: 1900.0,
                vs_m_s: *vs_m_s,
                k0: 0.5,
                fineness: 1.0,
                law_kind: "hyperbolic".into(),
                law: law().into(),
            })
            .collect(),
        water_table_m: 2.0,
        vertical: Vertical::Free,
        rayleigh: Rayleigh::default(),
        elements,
        features: Features::default(),
    }
}

/// Three output sensors over the input at 17 m, two components.
pub fn array() -> Array {
    Array {
        profile: profile(60),
        input: "base".into(),
        outputs: vec!["low".into(), "mid".into(), "top".into()],
        depths_m: vec![11.0, 6.0, 0.0],
        components: vec!["EW".into(), "NS".into()],
    }
}

/// Base motions of `count` events and two components at the records' step: `[event][component]`.
fn inputs(seed: u64, count: usize) -> Vec<[Vec<f64>; 2]> {
    let settings = MotionSettings {
        count: 2 * count,
        seed,
        duration_s: 16.0,
        step_s: 0.005,
        bands: vec![Band { count: 2 * count, min_pga_g: 0.01, max_pga_g: 0.09 }],
        train: "1".into(),
        validation: "2".into(),
        low_hz: 0.3,
        high_hz: 9.0,
        dominant_hz: [1.0, 5.0],
        strong_share: [0.25, 0.5],
    };
    let motions = motion::suite(&settings).expect("motions");
    let fine = |i: usize| {
        let m = &motions[i];
        resample::resample_band_limited(&m.acceleration_m_s2, m.dt_s, STEP_S)
    };
    (0..count).map(|e| [fine(2 * e), fine(2 * e + 1)]).collect()
}

/// How a truth is computed.
#[derive(Clone, Copy)]
pub struct Truth {
    /// Elements of the truth column.
    pub elements: usize,
    /// Its largest time step, s.
    pub max_step_s: f64,
    /// Seed of motions and noise.
    pub seed: u64,
    /// Number of events; the last three validate.
    pub events: usize,
}

/// A problem whose records come from the nonlinear column under `tables`.
pub fn problem(array: &Array, tables: &[toml::Table], truth: Truth) -> Problem {
    let motions = inputs(truth.seed, truth.events);
    let names: Vec<String> = array.sensors().map(String::from).collect();
    let depths: Vec<f64> = std::iter::once(17.0).chain(array.depths_m.iter().copied()).collect();
    let built = effects::build_all(tables).expect("effects");
    let events: Vec<Vec<Event>> = motions
        .par_iter()
        .enumerate()
        .map(|(e, components)| {
            let name = format!("E{:02}", e + 1);
            let all: Vec<String> = (0..truth.events).map(|e| format!("E{:02}", e + 1)).collect();
            let situation = |c: usize| Situation::of(c, &name, all.iter().map(String::as_str));
            let mut channels: Vec<Vec<Vec<f64>>> = vec![Vec::new(); names.len()];
            for (c, input) in components.iter().enumerate() {
                let analysis = Analysis { max_step_s: truth.max_step_s, initial_step_s: 0.001, ..Analysis::default() };
                let histories = shaken(&array.profile, truth.elements, &built, &situation(c), &analysis, input, array)
                    .expect("a truth");
                channels[0].push(input.clone());
                for (channel, history) in channels[1..].iter_mut().zip(histories) {
                    channel.push(history);
                }
            }
            let recording = Recording {
                event: &name,
                dt_s: STEP_S,
                sensors: &names,
                depths_m: &depths,
                components: &array.components,
            };
            let recorded = effects::observe(&recording, &channels, &built, Direction::Distort);
            (0..2)
                .map(|c| {
                    let mut random = random::stream(truth.seed, &format!("{name} {c}"));
                    let mut noise = Vec::new();
                    let mut noisy: Vec<Vec<f64>> = recorded
                        .iter()
                        .map(|sensor| {
                            let x = &sensor[c];
                            let rms = (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt();
                            noise.push(NoiseSpectrum::white(NOISE * rms, STEP_S));
                            let draw = |x: &f64| {
                                let n: f64 = StandardNormal.sample(&mut random);
                                x + NOISE * rms * n
                            };
                            x.iter().map(draw).collect()
                        })
                        .collect();
                    Event {
                        name: name.clone(),
                        situation: situation(c),
                        split: if e + 3 < truth.events { Split::Train } else { Split::Validation },
                        dt_s: STEP_S,
                        input: noisy.remove(0),
                        outputs: noisy,
                        noise,
                    }
                })
                .collect()
        })
        .collect();
    let tolerances = Tolerances { vs_ln: 0.03, ..Tolerances::default() };
    Problem { array: array.clone(), declared: Vec::new(), tolerances, events: events.into_iter().flatten().collect() }
}

/// Motions of the output sensors over a nonlinear column, at the records' step.
fn shaken(
    declared: &Profile,
    elements: usize,
    built: &[Box<dyn effects::Effect>],
    situation: &Situation,
    analysis: &Analysis,
    input: &[f64],
    array: &Array,
) -> Result<Vec<Vec<f64>>> {
    let mut profile = Profile { elements, ..declared.clone() };
    for effect in built {
        effect.edit(&mut profile, situation);
    }
    let depths: Vec<f64> = array
        .outputs
        .iter()
        .zip(&array.depths_m)
        .map(|(name, z)| effects::depth_m(built, name, *z, declared.depth_m()))
        .collect();
    let column = Column::new(&profile, analysis)?;
    let base = BaseMotion { dt_s: STEP_S, acceleration_m_s2: input };
    let histories = sensor_histories(&column, base, &depths)?;
    let coarse = |h: &Vec<f64>| {
        let mut x = resample::resample_band_limited(h, analysis.output_step_s, STEP_S);
        x.resize(input.len(), 0.0);
        x
    };
    Ok(histories[1..].iter().map(coarse).collect())
}

/// The declared column as a replay.
pub struct Replays<'a>(pub &'a Problem);

impl Replay for Replays<'_> {
    fn replay(&self, tables: &[toml::Table]) -> Result<Vec<Option<Vec<Vec<f64>>>>> {
        let built = effects::build_all(tables)?;
        let problem = self.0;
        let array = &problem.array;
        let names: Vec<String> = vec![array.input.clone()];
        problem
            .events
            .par_iter()
            .map(|event| {
                let pair: Vec<&Event> = problem.events.iter().filter(|e| e.name == event.name).collect();
                let inputs = vec![pair.iter().map(|e| e.input.clone()).collect::<Vec<_>>()];
                let recording = Recording {
                    event: &event.name,
                    dt_s: event.dt_s,
                    sensors: &names,
                    depths_m: &[array.profile.depth_m()],
                    components: &array.components,
                };
                let undone = effects::observe(&recording, &inputs, &built, Direction::Undo);
                let input = &undone[0][event.component()];
                let analysis = Analysis::default();
                let run =
                    shaken(&array.profile, array.profile.elements, &built, &event.situation, &analysis, input, array);
                Ok(run.ok())
            })
            .collect()
    }
}

/// Notes what it replays, but for what is replayed roughly.
pub struct Noted<'a> {
    /// Who replays.
    pub replays: Replays<'a>,
    /// The tables of each replay.
    pub asked: Mutex<Vec<Vec<toml::Table>>>,
}

impl Replay for Noted<'_> {
    fn replay(&self, tables: &[toml::Table]) -> Result<Vec<Option<Vec<Vec<f64>>>>> {
        self.asked.lock().expect("nobody panicked").push(tables.to_vec());
        self.replays.replay(tables)
    }

    fn replay_roughly(&self, tables: &[toml::Table]) -> Result<Vec<Option<Vec<Vec<f64>>>>> {
        self.replays.replay(tables)
    }
}

/// Settings for a small array.
pub fn settings() -> DiagnoseSettings {
    DiagnoseSettings { null_twins: 12, ..DiagnoseSettings::default() }
}

/// A table from text.
pub fn table(text: &str) -> toml::Table {
    text.parse().expect("a TOML table")
}

/// Prints the remarks.
pub struct Loud;

impl flare_pipe::progress::Progress for Loud {
    fn start(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn note(&self, text: &str) {
        println!("      . {text}");
    }
}
