//! Twins of a small array.

use crate::support::{Replays, Truth, array, problem, settings, table};
use flare_pipe::diagnosis::{self, Diagnosis, Thresholds, Verdict, diagnose, drawn, nuisances};
use flare_pipe::effects;
use flare_pipe::numerics::random;
use flare_pipe::progress::Quiet;
use rand::RngExt;

fn thresholds() -> Thresholds {
    Thresholds { gain: 5.0, validation_gain: 5.0, excess: 4.0, deviations: 3.0, twins: 0, null_gains: Vec::new() }
}

/// Prints the remarks.
struct Loud;

impl flare_pipe::progress::Progress for Loud {
    fn start(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn note(&self, text: &str) {
        println!("      . {text}");
    }
}

fn line(found: &Diagnosis) -> String {
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
    let mut all = drawn(&nuisances(&empty).unwrap(), seed);
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
            let (what, found, seconds) = twin(kind, seed, false);
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
fn a_turned_sensor_on_a_nonlinear_site_is_named() {
    let array = array();
    let truth = [table("kind = 'sensor_orientation'\nsensor = 'mid'\nazimuth_deg = 20.0")];
    let problem = problem(&array, &truth, Truth { elements: 120, max_step_s: 0.0025, seed: 11, events: 8 });
    let found = diagnose(&problem, &Replays(&problem), &settings(), &thresholds(), &Quiet).unwrap();
    println!("{}", line(&found));
    assert_eq!(found.verdict, Verdict::Known);
    assert_eq!(found.effects[0].kind, "sensor_orientation");
}
