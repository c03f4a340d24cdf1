//! Twins of a small array.

use crate::support::{Loud, Noted, Replays, Truth, array, problem, settings, table};
use flare_pipe::diagnosis::{
    self, Diagnosis, Disturbance, Scene, Thresholds, Verdict, diagnose, drawn, nuisance_tables, nuisances,
};
use flare_pipe::effects;
use flare_pipe::progress::Quiet;
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
