//! A diagnosis of the twin that a shipped manifest comes with; slow, so on demand.

use crate::support::{Loud, Replays};
use crate::twins::line;
use flare_pipe::diagnosis::{self, Event, Problem, Thresholds, diagnose, thresholds};
use flare_pipe::effects::Situation;
use flare_pipe::manifest::Manifest;
use flare_pipe::records::Split;
use flare_pipe::twin;
use rayon::prelude::*;
use std::path::Path;
use std::time::Instant;

/// The problem that the twin of `manifest` poses, `effects` (where given) in place of the truth's own.
fn problem(manifest: &Manifest, effects: Option<Vec<toml::Table>>) -> Problem {
    let site = &manifest.site;
    let records = site.records.as_ref().expect("records");
    let mut truth = twin::Truth::load(manifest.truth.as_ref().expect("a truth")).expect("a truth");
    if let Some(effects) = effects {
        truth.effects = effects;
    }
    let sections = site.column();
    let recorder = twin::recorder(&sections, &site.tolerances, &truth).expect("a recorder");
    let names: Vec<(&str, Split)> = records.events().filter(|(_, s)| *s != Split::Test).collect();
    let found: Vec<Vec<Event>> = names
        .par_iter()
        .map(|(name, split)| {
            let recorded = twin::record_event(&recorder, name, &records.components).expect("records");
            let event = |(c, record): (usize, &flare_pipe::records::Record)| Event {
                name: (*name).to_string(),
                situation: Situation::of(c, name, records.events().map(|(n, _)| n)),
                split: *split,
                dt_s: record.dt_s,
                input: record.input.acceleration_m_s2.clone(),
                outputs: record.outputs.iter().map(|s| s.acceleration_m_s2.clone()).collect(),
                noise: diagnosis::noise(record),
            };
            recorded.iter().enumerate().map(event).collect()
        })
        .collect();
    Problem {
        array: sections.array(&records.components).expect("an array"),
        declared: Vec::new(),
        tolerances: site.tolerances.clone(),
        events: found.into_iter().flatten().collect(),
    }
}

#[test]
#[ignore = "minutes: SITE=configs/lotung.toml EFFECTS='[[effects]] …' NULLS=n"]
fn site() {
    let path = std::env::var("SITE").unwrap_or_else(|_| "configs/lotung.toml".into());
    let manifest = Manifest::load(Path::new(&path), &[]).expect("a manifest");
    let effects = std::env::var("EFFECTS").ok().map(|text| {
        let table: toml::Table = text.parse().expect("a TOML table");
        let list = table.get("effects").and_then(|e| e.as_array()).cloned().unwrap_or_default();
        list.into_iter().filter_map(|e| e.as_table().cloned()).collect()
    });
    let start = Instant::now();
    let problem = problem(&manifest, effects);
    println!("records after {:.1} s", start.elapsed().as_secs_f64());
    let mut settings = crate::support::settings();
    let mut limits =
        Thresholds { gain: 10.0, validation_gain: 5.0, excess: 4.0, deviations: 3.0, twins: 0, null_gains: Vec::new() };
    if let Some(count) = std::env::var("NULLS").ok().and_then(|n| n.parse().ok()) {
        settings.null_twins = count;
        let start = Instant::now();
        limits = thresholds(&problem, None, &settings, &Loud).expect("thresholds");
        println!("{limits:?} after {:.1} s", start.elapsed().as_secs_f64());
    }
    let start = Instant::now();
    let found = diagnose(&problem, &Replays(&problem), &settings, &limits, &Loud).expect("a diagnosis");
    println!("{:.1} s\n{}", start.elapsed().as_secs_f64(), line(&found));
    for c in found.candidates.iter().filter(|c| c.gain > 0.0) {
        println!(
            "   {} {} {} {:.0} ({:.0}) {:.2}",
            c.round, c.kind, c.target, c.gain, c.validation_gain, c.explained_share
        );
    }
    for alarm in &found.tolerance_alarms {
        println!("   out of tolerance: {} {:.1} sd {:?}", alarm.what, alarm.deviations, alarm.estimate);
    }
    println!("   {:?}\n   {:?}", found.notes, found.remainder.sensor_band);
}
