//! Measured records of a KiK-net site, as they are and with an effect put on them: what a sensor did wrong is found on top of
//! whatever the site itself lacks.

use flare_pipe::diagnosis::{self, DiagnoseSettings, Event, Problem, Standing};
use flare_pipe::effects::Situation;
use flare_pipe::manifest::Manifest;
use flare_pipe::metrics::{FreeFilter, Pair};
use flare_pipe::numerics::filter::band_pass_zero_phase;
use flare_pipe::numerics::resample::resample_band_limited;
use flare_pipe::records::RecordSettings;
use flare_pipe::stages;
use std::path::{Path, PathBuf};

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Training and validation events of FKSH11, altered by a truth; `None` where the records are not at hand.
fn problem(truth: Option<&str>) -> Option<Problem> {
    let manifest = Manifest::load(&path("configs/fksh11.toml"), &[]).expect("a sound manifest");
    let Some(dir) = manifest.records_dir.clone().filter(|dir| dir.is_dir()) else {
        eprintln!("skipped: no records in ../shared/records/FKSH11");
        return None;
    };
    let sections = manifest.site.column();
    let declared = manifest.site.records.clone().expect("records");
    let settings = RecordSettings {
        dir: Some(dir.display().to_string()),
        truth: truth.map(|t| path(&format!("configs/truth/fksh11-{t}.toml")).display().to_string()),
        test: Vec::new(),
        ..declared
    };
    let read = stages::measured(&settings, &sections).expect("sound records");
    let event = |(split, record): &(_, flare_pipe::records::Record)| Event {
        name: record.event.clone(),
        situation: Situation::of(
            settings.components.iter().position(|c| *c == record.component).expect("a component"),
            &record.event,
            settings.events().map(|(event, _)| event),
        ),
        split: *split,
        dt_s: record.dt_s,
        input: record.input.acceleration_m_s2.clone(),
        outputs: record.outputs.iter().map(|s| s.acceleration_m_s2.clone()).collect(),
        noise: diagnosis::noise(record, None),
    };
    Some(Problem {
        array: sections.array(&settings.components).expect("an array"),
        declared: Vec::new(),
        tolerances: manifest.site.tolerances.clone(),
        events: read.records.iter().map(event).collect(),
    })
}

fn standing(problem: &Problem) -> Vec<Standing> {
    diagnosis::standing(problem, None, &DiagnoseSettings::default()).unwrap()
}

/// `problem` without each of its events in turn.
fn each_left_out(problem: &Problem) -> impl Iterator<Item = (String, Problem)> {
    let mut names: Vec<String> = problem.events.iter().map(|e| e.name.clone()).collect();
    names.dedup();
    names.into_iter().map(|name| {
        let mut rest = problem.clone();
        rest.events.retain(|e| e.name != name);
        (name, rest)
    })
}

#[test]
fn sensors_as_they_are_raise_no_alarm_whichever_event_is_left_out() {
    let Some(problem) = problem(None) else { return };
    assert!(standing(&problem).is_empty());
    for (event, rest) in each_left_out(&problem) {
        let found = standing(&rest);
        assert!(found.is_empty(), "without {event}: {found:?}");
    }
}

#[test]
fn what_a_truth_put_on_the_records_is_found_on_top_of_what_the_site_lacks_whichever_event_is_left_out() {
    // The sensors' own errors within their tolerances come on top: about 2°, 5 % and a few ms.
    for (truth, kind, parameter, value, close) in [
        ("orientation", "sensor_orientation", "azimuth_deg", 25.0, 3.0),
        ("clock", "clock_offset", "offset_s", 0.03, 0.01),
        ("gain", "sensor_gain", "ln_gain", -0.22314, 0.08),
        // A first-order low-pass of 4 Hz is 40 ms late at low frequencies, as a clock would be: the kinds are named together.
        ("low-pass", "clock_offset", "offset_s", 0.0398, 0.01),
    ] {
        let Some(problem) = problem(Some(truth)) else { return };
        let found = standing(&problem);
        let estimate = &found[0].found.parameters[parameter];
        println!("{truth}: {kind} {:.4} [{:.4}, {:.4}]", estimate.value, estimate.ci95[0], estimate.ci95[1]);
        assert!((estimate.value - value).abs() < close, "{truth}: {estimate:?}");
        for (event, rest) in each_left_out(&problem).chain([(String::new(), problem.clone())]) {
            let found = standing(&rest);
            assert_eq!(found.len(), 1, "{truth} without {event}: {found:?}");
            let one = &found[0];
            assert_eq!((one.found.kind.as_str(), one.found.target.as_str()), (kind, "surface"), "{truth}");
            assert_eq!(one.alike.iter().any(|k| k == "instrument_low_pass"), kind == "clock_offset");
        }
    }
}

/// What no filter that is the same in all events can beat by much: each of the ten weak events is predicted from the nine others.
#[test]
fn weak_events_of_a_real_site_have_the_ceiling_of_the_prototype() {
    const STEP_S: f64 = 0.05;
    let manifest = Manifest::load(&path("configs/fksh11.toml"), &[]).expect("a sound manifest");
    let Some(dir) = manifest.records_dir.clone().filter(|dir| dir.is_dir()) else {
        eprintln!("skipped: no records in ../shared/records/FKSH11");
        return;
    };
    let settings =
        RecordSettings { dir: Some(dir.display().to_string()), ..manifest.site.records.clone().expect("records") };
    let read = stages::measured(&settings, &manifest.site.column()).expect("sound records");
    let strong = ["2102132308", "1104111716", "2203162336"];
    for component in &settings.components {
        let coarse = |x: &[f64], dt_s: f64| {
            let band = band_pass_zero_phase(x, dt_s, 0.3, 9.5);
            resample_band_limited(&band, dt_s, STEP_S)
        };
        let histories: Vec<[Vec<f64>; 2]> = read
            .records
            .iter()
            .map(|(_, r)| r)
            .filter(|r| &r.component == component && !strong.contains(&r.event.as_str()))
            .map(|r| [&r.input, &r.outputs[0]].map(|s| coarse(&s.acceleration_m_s2, r.dt_s)))
            .collect();
        let pairs: Vec<Pair<'_>> = histories.iter().map(|[u, y]| Pair { input: u, output: y }).collect();
        let left_out = |i: usize| {
            let others: Vec<Pair<'_>> = pairs.iter().enumerate().filter(|(o, _)| *o != i).map(|(_, p)| *p).collect();
            FreeFilter::of(&others, STEP_S).expect("nine events").nrmse_percent(&pairs[i])
        };
        let errors: Vec<f64> = (0..pairs.len()).map(left_out).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        println!("{component}: ceiling {mean:.1} %, by event {errors:.0?}");
        assert!(errors.len() == 10 && (80.0..90.0).contains(&mean), "{component}: {mean} {errors:?}");
    }
}
