//! What stands whatever the profile, and what the search found on top of it, as one diagnosis.

use super::outcome::{Candidate, Diagnosis, Excess, Found, Verdict};
use super::problem::{Problem, Replay};
use super::settings::DiagnoseSettings;
use super::standing::{CORNER_HZ, KINDS, Standing, settled};
use super::tilt;
use super::unknowns::TOLERATED;
use super::verdict::{KNOWN_LEVEL, excess};
use crate::error::Result;
use crate::manifest::Tolerances;
use toml::Value;

/// What stands, and what else was found on top of it; the recalibrated model is that of `problem` without any of it.
///
/// # Errors
/// When an event is unusable or a replay is impossible.
pub fn together(
    mut standing: Vec<Standing>,
    mut rest: Diagnosis,
    problem: &Problem,
    replay: &dyn Replay,
    settings: &DiagnoseSettings,
) -> Result<Diagnosis> {
    merge(&mut standing, &mut rest.effects, &problem.tolerances);
    let mut is_near_noise = false;
    if let Some((model, nuisances)) = settled(problem, replay, settings, &[], None)? {
        let cost =
            |e: &Excess| e.train * (2.0 * model.expected[0]).sqrt() + e.validation * (2.0 * model.expected[1]).sqrt();
        rest.recalibrated = excess(&model);
        let [lost, left] = [&rest.recalibrated, &rest.corrected].map(cost);
        rest.explained_share = (lost > 0.0).then(|| (1.0 - left / lost).clamp(0.0, 1.0));
        rest.nuisances = nuisances;
        is_near_noise = left < (KNOWN_LEVEL - 1.0) * model.expected.iter().sum::<f64>();
    }
    for Standing { found, alike, why } in &standing {
        rest.notes.push(format!("`{}` at {} {why}", found.kind, found.target));
        if alike.len() > 1 {
            rest.notes.push(format!("at low frequencies {} look the same", alike.join(", ")));
        }
        // Kinds that explain the records as well are named with those that were chosen.
        let named = if alike.len() > 1 || !rest.ambiguity.is_empty() { alike.as_slice() } else { &[] };
        let new: Vec<String> = named.iter().filter(|kind| !rest.ambiguity.contains(kind)).cloned().collect();
        rest.ambiguity.extend(new);
    }
    // What stands counts among the named effects: structure may remain beside them, as beside any others.
    let is_explained = rest.explained_share.is_some_and(|share| share >= settings.known_share);
    let is_named = !standing.is_empty() || !rest.effects.is_empty();
    rest.verdict = match rest.verdict {
        Verdict::Unknown if !(is_explained && is_near_noise) => Verdict::Unknown,
        _ if !is_named => Verdict::None,
        Verdict::Ambiguous => Verdict::Ambiguous,
        _ if standing.iter().any(|s| s.alike.len() > 1) => Verdict::Ambiguous,
        _ => Verdict::Known,
    };
    let tried = standing.iter().map(|s| Candidate {
        kind: s.found.kind.clone(),
        target: s.found.target.clone(),
        class: s.found.class,
        gain: s.found.gain,
        validation_gain: s.found.validation_gain,
        explained_share: rest.explained_share.unwrap_or_default(),
        round: 0,
        is_confirmed: true,
        table: s.found.table.clone(),
    });
    rest.candidates.splice(0..0, tried.collect::<Vec<_>>());
    rest.effects.splice(0..0, standing.into_iter().map(|s| s.found));
    Ok(rest)
}

/// The search has the whole band and all sensors to correct what stands: an error that it found at the same sensor is one with
/// that, and where the two take each other away within the tolerance, there is none. Errors add up, corners of high-passes as the
/// phase advances that they make at higher frequencies.
fn merge(standing: &mut Vec<Standing>, rest: &mut Vec<Found>, tolerances: &Tolerances) {
    standing.retain_mut(|Standing { found, .. }| {
        let Some([kind, key, _]) = KINDS.iter().find(|[kind, ..]| *kind == found.kind) else { return true };
        let again = rest.iter().position(|f| f.kind == found.kind && f.target == found.target);
        let Some(more) = again.map(|i| rest.remove(i)) else { return true };
        let (Some(own), Some(more)) = (found.parameters.get_mut(*key), more.parameters.get(*key)) else { return true };
        own.ci95 = more.ci95.map(|end| end + own.value);
        own.value += more.value;
        found.table.insert((*key).into(), Value::Float(own.value));
        let tolerance = match *kind {
            "sensor_gain" => tolerances.gain_ln,
            "clock_offset" => tolerances.clock_s,
            tilt::KIND => tilt::FIELD_DEG,
            "instrument_high_pass" => CORNER_HZ,
            _ => tolerances.orientation_deg,
        };
        own.value.abs() > TOLERATED * tolerance
    });
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Uniform, judged, path};
    use super::super::outcome::Thresholds;
    use super::super::responses::Scene;
    use super::super::search::Search;
    use super::super::standing::standing;
    use super::super::verdict::assemble;
    use super::*;
    use crate::diagnosis::Estimate;
    use crate::effects::Class;
    use std::collections::BTreeMap;

    fn found([kind, key]: [&str; 2], sensor: &str, value: f64) -> Found {
        let ci95 = [value - 0.25, value + 0.25];
        Found {
            kind: kind.into(),
            target: sensor.into(),
            class: Class::Sensor,
            table: toml::Table::from_iter([(key.to_string(), Value::Float(value))]),
            parameters: BTreeMap::from([(key.to_string(), Estimate { value, unit: "°".into(), ci95 })]),
            gain: 1.0,
            validation_gain: 1.0,
            is_standing: true,
        }
    }

    #[test]
    fn what_stands_is_no_full_answer_where_far_more_than_noise_is_left() {
        let (problem, settings) = (judged("kind = 'sensor_polarity'\nsensor = 'top'"), DiagnoseSettings::default());
        let replay = Uniform(&problem);
        let scene = Scene::new(&problem, &settings).unwrap();
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        let x = vec![0.0; search.nuisances.len()];
        let anchor = search.anchored(&[], &x, None).unwrap();
        let model = search.settle(&[], &x, &anchor, None, 0).unwrap();
        let expected = model.expected;
        let thresholds = Thresholds {
            gain: 5.0,
            validation_gain: 5.0,
            excess: 3.0,
            deviations: 3.0,
            twins: 0,
            null_gains: Vec::new(),
        };
        let rest = assemble(&search, &path(model, anchor), &thresholds).unwrap();
        assert_eq!(rest.verdict, Verdict::Unknown);
        let standing = standing(&problem, None, &settings).unwrap();
        assert_eq!(standing.len(), 1);
        let verdict_at = |level: f64| {
            let train = (level - 1.0) * (expected[0] + expected[1]) / (2.0 * expected[0]).sqrt();
            let rest = Diagnosis { corrected: Excess { train, validation: 0.0 }, ..rest.clone() };
            let whole = together(standing.clone(), rest, &problem, &replay, &settings).unwrap();
            assert!(whole.explained_share.unwrap() > settings.known_share, "{:?}", whole.explained_share);
            whole.verdict
        };
        assert_eq!([1.5, 2.5].map(verdict_at), [Verdict::Known, Verdict::Unknown]);
    }

    #[test]
    fn one_error_is_named_once() {
        let turned = |sensor, angle| found(["sensor_orientation", "azimuth_deg"], sensor, angle);
        let passed = |sensor, corner| found(["instrument_high_pass", "corner_hz"], sensor, corner);
        let stands = |found| Standing { found, alike: Vec::new(), why: "" };
        let first = [turned("base", -6.0), turned("middle", 9.0), turned("top", 20.0), passed("base", 0.25)];
        let mut standing: Vec<Standing> = first.into_iter().map(stands).collect();
        let mut rest = vec![turned("base", 5.5), turned("middle", 1.5), turned("other", 7.0), passed("base", 0.5)];
        merge(&mut standing, &mut rest, &Tolerances::default());
        let named: Vec<(&str, f64)> = standing
            .iter()
            .map(|s| (s.found.target.as_str(), s.found.parameters.values().map(|p| p.value).sum()))
            .collect();
        assert_eq!(named, [("middle", 10.5), ("top", 20.0), ("base", 0.75)]);
        assert_eq!(standing[0].found.table["azimuth_deg"].as_float(), Some(10.5));
        assert_eq!(standing[0].found.parameters["azimuth_deg"].ci95, [10.25, 10.75]);
        assert_eq!(rest.iter().map(|f| f.target.as_str()).collect::<Vec<_>>(), ["other"]);
    }
}
