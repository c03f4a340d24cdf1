//! The whole catalogue: what holds for every effect.

use super::*;
use crate::column::{Analysis, Column, Features, Layer, Rayleigh, Vertical};
use crate::numerics::random;
use std::collections::BTreeSet;

fn array() -> Array {
    let layer = |thickness_m: f64, vs_m_s: f64, law_kind: &str| Layer::plain(law_kind, thickness_m, 1900.0, vs_m_s);
    Array {
        profile: Profile {
            layers: vec![layer(3.0, 130.0, "hyperbolic"), layer(4.0, 170.0, "sanisand"), layer(3.0, 220.0, "elastic")],
            water_table_m: 1.5,
            vertical: Vertical::Free,
            rayleigh: Rayleigh { alpha_1_s: 0.1, beta_s: 1e-4 },
            elements: 40,
            features: Features::default(),
        },
        input: "base".into(),
        outputs: vec!["mid".into(), "top".into()],
        depths_m: vec![5.0, 0.0],
        components: vec!["EW".into(), "NS".into()],
    }
}

/// The same in a container, and instances of both.
fn all_instances() -> Vec<(Array, Instance)> {
    let mut contained = array();
    contained.profile.vertical = Vertical::Restrained;
    let all = |array: &Array| EFFECTS.iter().flat_map(|e| (e.catalogue.instances)(array)).collect::<Vec<_>>();
    let of = |array: Array| all(&array).into_iter().map(move |i| (array.clone(), i)).collect::<Vec<_>>();
    [of(array()), of(contained)].concat()
}

fn motions() -> Vec<Channels> {
    let wave = |s: usize, c: usize| {
        let sample = move |i: usize| {
            let t = i as f64 * 0.01 - 0.02 * s as f64;
            (0.5 + 0.4 * s as f64) * (-((t - 4.0) / 1.5).powi(2)).exp() * ((9.0 + 3.0 * c as f64) * t).sin()
        };
        (0..1200).map(sample).collect()
    };
    (0..3).map(|s| (0..2).map(|c| wave(s, c)).collect()).collect()
}

fn observed(array: &Array, motions: &[Channels], table: &toml::Table, direction: Direction) -> Vec<Channels> {
    let sensors: Vec<String> = array.sensors().map(String::from).collect();
    let depths: Vec<f64> = std::iter::once(array.profile.depth_m()).chain(array.depths_m.iter().copied()).collect();
    let recording =
        Recording { event: "E1", dt_s: 0.01, sensors: &sensors, depths_m: &depths, components: &array.components };
    observe(&recording, motions, &build_all(std::slice::from_ref(table)).unwrap(), direction)
}

#[test]
fn what_changes_the_column_is_what_edits_it_or_moves_a_sensor() {
    let situation = Situation { component: Some(1), order: Some(2.5) };
    for (array, instance) in all_instances() {
        let table = instance.draw(&mut random::stream(1, instance.kind));
        let effect = build(&table).unwrap();
        let mut profile = array.profile.clone();
        effect.edit(&mut profile, &situation);
        let is_changed = profile != array.profile || effect.moves_sensor();
        assert_eq!(changes_column(&table), is_changed, "{table}");
    }
}

#[test]
fn every_effect_of_zero_strength_leaves_everything_bit_identical() {
    let motions = motions();
    let situation = Situation { component: Some(1), order: Some(2.5) };
    for (array, instance) in all_instances() {
        let Some(zero) = instance.zero() else { continue };
        let table = instance.at(&zero);
        let mut profile = array.profile.clone();
        apply(std::slice::from_ref(&table), &mut profile, &situation).unwrap();
        assert_eq!(profile, array.profile, "{table:?}");
        for direction in [Direction::Distort, Direction::Predict, Direction::Clean, Direction::Undo] {
            assert!(observed(&array, &motions, &table, direction) == motions, "{table:?} {direction:?}");
        }
        let effect = build(&table).unwrap();
        assert_eq!(effect.depth_m("mid", 5.0), 5.0, "{table:?}");
    }
}

#[test]
fn every_effect_does_something_where_it_is_drawn_and_the_column_still_runs() {
    let motions = motions();
    let mut random = crate::numerics::random::stream(3, "catalogue test");
    let mut seen = BTreeSet::new();
    for (array, instance) in all_instances() {
        let table = instance.draw(&mut random);
        let mut profile = array.profile.clone();
        let situation = Situation { component: Some(0), order: Some(2.0) };
        apply(std::slice::from_ref(&table), &mut profile, &situation).unwrap_or_else(|e| panic!("{table:?}: {e}"));
        let effect = build(&table).unwrap();
        let acts = profile != array.profile
            || observed(&array, &motions, &table, Direction::Distort) != motions
            || effect.depth_m("mid", 5.0) != 5.0;
        assert!(acts, "{table:?}");
        assert_eq!(
            !find(instance.kind).unwrap().catalogue.class.moves_column(),
            profile == array.profile && effect.arrival(0.0, 1.0).is_none(),
            "{table:?}"
        );
        if seen.insert(instance.kind) {
            let column = Column::new(&profile, &Analysis::default()).unwrap_or_else(|e| panic!("{table:?}: {e}"));
            column.run(0.01, &motions[0][0][300..500], &mut |_| Ok(())).unwrap_or_else(|e| panic!("{table:?}: {e}"));
        }
    }
    let missing: Vec<&str> = EFFECTS.iter().map(|e| e.name).filter(|name| !seen.contains(name)).collect();
    assert!(missing.is_empty(), "no instance of {missing:?}");
}

#[test]
fn what_a_sensor_does_is_undone() {
    let (array, motions) = (array(), motions());
    let mut random = crate::numerics::random::stream(5, "catalogue test");
    for instance in instances(&array) {
        if find(instance.kind).unwrap().catalogue.class != Class::Sensor && instance.kind != "surface_wave" {
            continue;
        }
        let table = instance.draw(&mut random);
        let recorded = observed(&array, &motions, &table, Direction::Distort);
        let back = observed(&array, &recorded, &table, Direction::Undo);
        for (undone, truth) in back.iter().flatten().zip(motions.iter().flatten()) {
            let error: f64 = undone.iter().zip(truth).map(|(a, b)| (a - b).powi(2)).sum();
            let size: f64 = truth.iter().map(|a| a * a).sum();
            assert!((error / size).sqrt() < 0.05, "{table:?}: {}", (error / size).sqrt());
        }
    }
}

/// Relative error of undoing `tables` on what they made of `motions`.
fn undone_error(array: &Array, motions: &[Channels], tables: &[&str]) -> f64 {
    let effects = build_all(&tables.iter().map(|t| toml::from_str(t).unwrap()).collect::<Vec<_>>()).unwrap();
    let sensors: Vec<String> = array.sensors().map(String::from).collect();
    let components = &array.components[..motions[0].len()];
    let recording = Recording { event: "E1", dt_s: 0.01, sensors: &sensors, depths_m: &[10.0, 5.0, 0.0], components };
    let recorded = observe(&recording, motions, &effects, Direction::Distort);
    assert!(recorded != motions);
    let back = observe(&recording, &recorded, &effects, Direction::Undo);
    let pairs = || back.iter().flatten().flatten().zip(motions.iter().flatten().flatten());
    (pairs().map(|(a, b)| (a - b).powi(2)).sum::<f64>() / pairs().map(|(_, b)| b * b).sum::<f64>()).sqrt()
}

#[test]
fn several_effects_at_once_and_a_single_component_are_undone() {
    let (array, motions) = (array(), motions());
    let tables = [
        "kind = 'sensor_orientation'\nsensor = 'top'\nazimuth_deg = 25.0",
        "kind = 'clock_offset'\nsensor = 'top'\noffset_s = 0.03",
        "kind = 'swapped_channels'\nsensor = 'mid'\nwith = 'top'",
        "kind = 'swapped_channels'\nsensor = 'base'\nwith = 'top'",
        "kind = 'sensor_gain'\nsensor = 'base'\nln_gain = -0.3",
    ];
    assert!(undone_error(&array, &motions, &tables) < 1e-3);
    let single: Vec<Channels> = motions.iter().map(|s| s[..1].to_vec()).collect();
    assert!(undone_error(&array, &single, &tables) < 1e-3);
}

#[test]
fn what_is_predicted_is_what_is_recorded_without_interference() {
    let (array, motions) = (array(), motions());
    let hum =
        toml::from_str("kind = 'machine_hum'\nsensor = 'top'\nfrequency_hz = 5.0\namplitude_m_s2 = 0.05").unwrap();
    assert!(observed(&array, &motions, &hum, Direction::Predict) == motions);
    let recorded = observed(&array, &motions, &hum, Direction::Distort);
    assert!(recorded[..2] == motions[..2] && recorded[2] != motions[2]);
    let gain = toml::from_str("kind = 'sensor_gain'\nsensor = 'top'\nln_gain = 0.2").unwrap();
    let predicted = observed(&array, &motions, &gain, Direction::Predict);
    assert!((predicted[2][0][400] / motions[2][0][400] - 0.2f64.exp()).abs() < 1e-9);
}

#[test]
fn the_catalogue_is_consistent() {
    let mut numbers = BTreeSet::new();
    for entry in EFFECTS {
        let catalogue = &entry.catalogue;
        assert!(numbers.insert(catalogue.number), "number {} comes twice", catalogue.number);
        for other in catalogue.confused_with {
            assert!(find(other).is_ok() && *other != entry.name, "{} is confused with {other}", entry.name);
        }
        for parameter in catalogue.parameters {
            let [low, high] = parameter.bounds();
            let drawn = parameter.draw.map(|v| parameter.coordinate(v));
            assert!(low < high && drawn.iter().all(|x| (low..=high).contains(x)), "{} {}", entry.name, parameter.name);
            let zero = parameter.coordinate(parameter.zero.unwrap_or(parameter.draw[0]));
            assert!((low..=high).contains(&zero), "{} {}", entry.name, parameter.name);
            assert!((parameter.value(parameter.coordinate(3.0)) - 3.0).abs() < 1e-12);
        }
        for instance in (catalogue.instances)(&array()) {
            assert_eq!(instance.kind, entry.name);
            let names: Vec<&str> = instance.free.iter().map(|f| f.parameter.name).collect();
            assert!(names.iter().all(|n| catalogue.parameters.iter().any(|p| p.name == *n)), "{}", entry.name);
            build(&instance.at(&instance.start())).unwrap_or_else(|e| panic!("{}: {e}", entry.name));
            check(&[instance.at(&instance.start())], &array()).unwrap();
        }
    }
}

#[test]
fn a_sensor_that_does_not_exist_is_named_with_the_nearest() {
    let table: toml::Table = toml::from_str("kind = 'sensor_gain'\nsensor = 'tpo'\nln_gain = 0.1").unwrap();
    let error = check(&[table], &array()).unwrap_err();
    assert!(error.to_string().contains("no sensor `tpo`") && error.hint_text().unwrap().contains("nearest: `top`"));
}

#[test]
fn seams_at_two_depths_are_alike_and_two_dampings_are_not() {
    let of = |kind: &str| (find(kind).unwrap().catalogue.instances)(&array());
    let (seams, dampings) = (of("thin_seam"), of("frequency_dependent_damping"));
    assert!(seams.len() > 1 && seams[0].is_alike(&seams[1]) && seams[0] != seams[1]);
    assert!(dampings.len() > 1 && !dampings[0].is_alike(&dampings[1]));
}

/// The array with every layer following one law, all of them with 2 % of small-strain damping.
fn of_one_law(law_kind: &str) -> Array {
    let mut array = array();
    array.profile.elements = 20;
    for layer in &mut array.profile.layers {
        layer.law_kind = law_kind.into();
        layers::set(layer, "damping_ratio", 0.02);
    }
    array
}

/// Surface motion of the column of `array` under `table`, shaken hard.
fn surface(array: &Array, table: Option<&toml::Table>) -> Vec<f64> {
    let situation = Situation { component: Some(0), order: Some(2.0) };
    let mut profile = array.profile.clone();
    apply(table.map(std::slice::from_ref).unwrap_or_default(), &mut profile, &situation).unwrap();
    let base: Vec<f64> = motions()[0][0][250..500].iter().map(|a| 6.0 * a).collect();
    let mut rows = Vec::new();
    let column = Column::new(&profile, &Analysis::default()).unwrap_or_else(|e| panic!("{table:?}: {e}"));
    let take = &mut |frame: &crate::column::Frame<'_>| {
        rows.push(frame.surface_m_s2());
        Ok(())
    };
    column.run(0.01, &base, take).unwrap_or_else(|e| panic!("{table:?}: {e}"));
    rows
}

#[test]
fn with_every_law_every_effect_on_the_column_changes_its_motion_or_is_refused() {
    let mut random = crate::numerics::random::stream(7, "catalogue test");
    let everywhere = all_instances();
    for law in crate::soil::LAWS {
        let array = of_one_law(law.name);
        let plain = surface(&array, None);
        let size: f64 = plain.iter().map(|a| a * a).sum();
        let offered = instances(&array);
        for entry in EFFECTS.iter().filter(|e| e.catalogue.class.moves_column()) {
            let mut tried: Vec<&Instance> = Vec::new();
            let elsewhere = everywhere.iter().map(|(_, i)| i);
            for instance in offered.iter().chain(elsewhere).filter(|i| i.kind == entry.name) {
                if tried.iter().any(|t| t.is_alike(instance) && t.target.get("law") == instance.target.get("law")) {
                    continue;
                }
                tried.push(instance);
                let table = instance.draw(&mut random);
                if build(&table).unwrap().arrival(0.0, 1.0).is_some() {
                    continue;
                }
                if let Err(error) = check(std::slice::from_ref(&table), &array) {
                    assert!(error.to_string().contains("has nothing to act on"), "{error}");
                    assert!(!offered.contains(instance), "{} offers {table:?} and refuses it", law.name);
                    println!("{}: {error}", law.name);
                    continue;
                }
                let moved = surface(&array, Some(&table));
                let change: f64 = moved.iter().zip(&plain).map(|(a, b)| (a - b).powi(2)).sum();
                assert!(change > 1e-8 * size, "{}: {table:?} changes nothing", law.name);
            }
        }
    }
}
