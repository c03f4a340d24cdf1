//! Twins of a small array.

use crate::support::{Loud, Noted, Replays, Truth, array, problem, settings, table};
use flare_pipe::diagnosis::{
    self, Diagnosis, Disturbance, Scene, Thresholds, Verdict, diagnose, drawn, nuisance_tables, nuisances, power,
};
use flare_pipe::effects;
use flare_pipe::numerics::random;
use flare_pipe::progress::Quiet;
use rand::RngExt;
use std::sync::Mutex;

fn thresholds() -> Thresholds {
    Thresholds { gain: 5.0, validation_gain: 5.0, excess: 4.0, deviations: 3.0, twins: 0, null_gains: Vec::new() }
}

/// A diagnosis in a line.
pub fn line(found: &Diagnosis) -> String {
    let named: Vec<String> = found
        .effects
        .iter()
        .map(|f| {
            let values: Vec<String> = f
                .parameters
                .iter()
                .map(|(n, e)| format!("{n}={:.4}[{:.4},{:.4}]", e.value, e.ci95[0], e.ci95[1]))
                .collect();
            format!("{} {} {} gain {:.0}/{:.0}", f.kind, f.target, values.join(","), f.gain, f.validation_gain)
        })
        .collect();
    let excess = |e: diagnosis::Excess| format!("{:.1}/{:.1}", e.train, e.validation);
    format!(
        "{:?} E={:?} excess {} {} {} ambiguity {:?} :: {}",
        found.verdict,
        found.explained_share.map(|e| (1000.0 * e).round() / 1000.0),
        excess(found.declared),
        excess(found.recalibrated),
        excess(found.corrected),
        found.ambiguity,
        named.join(" + ")
    )
}

/// One twin with a random place and size of `kind` (`null`: none) and nuisances of its own.
fn twin(kind: &str, seed: u64, is_fast: bool) -> (String, Diagnosis, f64) {
    let array = array();
    let start = std::time::Instant::now();
    let truth = Truth {
        elements: if is_fast { 60 } else { 120 },
        max_step_s: if is_fast { 0.005 } else { 0.0025 },
        seed,
        events: 8,
    };
    let mut random = random::stream(seed, kind);
    let places: Vec<_> = effects::instances(&array).into_iter().filter(|i| i.kind == kind).collect();
    let mut tables = Vec::new();
    let mut what = kind.to_string();
    if !places.is_empty() {
        let place = &places[random.random_range(0..places.len())];
        tables.push(place.draw(&mut random));
        what = toml::to_string(&tables[0]).unwrap().replace('\n', " ");
    }
    let empty = problem(&array, &[], Truth { events: 4, ..truth });
    let nuisances = nuisances(&empty).unwrap();
    let mut all = nuisance_tables(&nuisances, &drawn(&nuisances, seed));
    if std::env::var("TWIN_EXACT").is_ok() {
        all.clear();
    }
    all.extend(tables);
    let problem = problem(&array, &all, truth);
    let found = diagnose(&problem, &Replays(&problem), &settings(), &thresholds(), &Loud).unwrap();
    (what, found, start.elapsed().as_secs_f64())
}

#[test]
#[ignore = "development: TWIN_KINDS=a,b TWIN_SEEDS=1-3"]
fn matrix() {
    let kinds = std::env::var("TWIN_KINDS").unwrap_or_else(|_| "null".into());
    let seeds = std::env::var("TWIN_SEEDS").unwrap_or_else(|_| "1-2".into());
    let (a, b) = seeds.split_once('-').unwrap();
    for kind in kinds.split(',') {
        for seed in a.parse::<u64>().unwrap()..=b.parse().unwrap() {
            let (what, found, seconds) = twin(kind, seed, std::env::var("TWIN_SAME").is_ok());
            println!("#{seed} {what}\n   {seconds:.0}s {}", line(&found));
            for c in found.candidates.iter().filter(|c| c.round == 1).take(4) {
                println!(
                    "      {} {} {:.0} ({:.0}) {:.2} {}",
                    c.kind, c.target, c.gain, c.validation_gain, c.explained_share, c.is_confirmed
                );
            }
        }
    }
}

#[test]
fn a_turned_sensor_on_a_nonlinear_site_is_named_and_what_is_said_was_replayed() {
    let array = array();
    let truth = [table("kind = 'sensor_orientation'\nsensor = 'mid'\nazimuth_deg = 20.0")];
    let problem = problem(&array, &truth, Truth { elements: 120, max_step_s: 0.0025, seed: 11, events: 8 });
    let noted = Noted { replays: Replays(&problem), asked: Mutex::default() };
    let found = diagnose(&problem, &noted, &settings(), &thresholds(), &Quiet).unwrap();
    println!("{}", line(&found));
    assert_eq!(found.verdict, Verdict::Known);
    assert_eq!(found.effects[0].kind, "sensor_orientation");
    let effects = found.effects.iter().filter(|f| !f.is_standing).map(|f| &f.table);
    let said: Vec<toml::Table> = found.corrected_nuisances.iter().chain(effects).cloned().collect();
    // What stands whatever the profile comes before it.
    let asked = noted.asked.into_inner().unwrap();
    assert!(asked.iter().any(|replayed| replayed.ends_with(&said)), "{said:?}");
}

#[test]
#[ignore = "development: thresholds of the small array and fresh nulls against them"]
fn nulls() {
    let array = array();
    let truth = Truth { elements: 60, max_step_s: 0.005, seed: 77, events: 8 };
    let problem = problem(&array, &[], truth);
    let start = std::time::Instant::now();
    let limits = diagnosis::thresholds(&problem, None, &settings(), &Quiet).unwrap();
    println!("{limits:?} in {:.0} s", start.elapsed().as_secs_f64());
    let start = std::time::Instant::now();
    let power = power(&problem, &settings(), Some(&limits)).unwrap();
    println!("power in {:.0} s", start.elapsed().as_secs_f64());
    for e in power.effects.iter().take(400) {
        println!(
            "  {} {} typical {:?} {} score {:.0} of {:.0}, from {:?}",
            e.kind, e.target, e.typical, e.unit, e.expected_score, e.needed_score, e.detectable
        );
    }
    for c in power.confusions.iter().take(30) {
        println!("  {} ~ {} {:.2}", c.one, c.other, c.collinearity);
    }
    println!("{:?}", power.classes);
}

#[test]
fn a_twin_of_the_fast_column_with_a_late_clock_is_named_and_one_without_is_not() {
    let array = array();
    let declared = problem(&array, &[], Truth { elements: 60, max_step_s: 0.005, seed: 21, events: 6 });
    let scene = Scene::new(&declared, &settings()).unwrap();
    let disturbance = Disturbance { seed: Some(4), model_error: 0.0, deviations: None };
    let nuisances = nuisances(&declared).unwrap();
    let tables = nuisance_tables(&nuisances, &drawn(&nuisances, 4));
    let seen = |extra: &[toml::Table]| {
        let all: Vec<toml::Table> = tables.iter().chain(extra).cloned().collect();
        let twin = scene.simulated(&effects::build_all(&all).unwrap(), disturbance).unwrap();
        let replay = FastReplay(&twin);
        diagnose(&twin, &replay, &settings(), &thresholds(), &Loud).unwrap()
    };
    let late = seen(&[table("kind = 'clock_offset'\nsensor = 'mid'\noffset_s = 0.02")]);
    println!("{}", line(&late));
    for c in &late.candidates {
        println!("   {} {} {} {:.0} ({:.0}) {}", c.round, c.kind, c.target, c.gain, c.validation_gain, c.is_confirmed);
    }
    assert_eq!(late.verdict, Verdict::Known);
    assert_eq!(late.effects[0].kind, "clock_offset");
    let null = seen(&[]);
    println!("{}", line(&null));
    assert_eq!(null.verdict, Verdict::None);
}

/// The fast column in the place of the nonlinear one.
struct FastReplay<'a>(&'a diagnosis::Problem);

impl diagnosis::Replay for FastReplay<'_> {
    fn replay(&self, tables: &[toml::Table]) -> flare_pipe::error::Result<Vec<Option<Vec<Vec<f64>>>>> {
        let scene = Scene::new(self.0, &settings())?;
        let soil: Vec<toml::Table> = tables.iter().filter(|t| !t.contains_key("sensor")).cloned().collect();
        let runs = scene
            .simulated(&effects::build_all(&soil)?, Disturbance { seed: None, model_error: 0.0, deviations: None })?;
        Ok(runs.events.into_iter().map(|e| Some(e.outputs)).collect())
    }
}
