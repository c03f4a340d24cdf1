//! Sensors of a made-up array whose declared profile is far off.

use super::super::made_up::{DEPTH_M, array, moved, problem};
use super::column::{first_order_s2, travel_s};
use super::*;

#[test]
fn errors_of_a_sensor_are_found_under_a_profile_that_is_far_off() {
    let settings = super::super::DiagnoseSettings::default();
    let cases = [
        ("sensor_orientation", "azimuth_deg", 12.0, 0.7),
        ("sensor_orientation", "azimuth_deg", -140.0, 0.7),
        ("clock_offset", "offset_s", 0.02, 0.003),
        ("sensor_gain", "ln_gain", 0.2, 0.03),
        ("instrument_high_pass", "corner_hz", 0.06, 0.01),
        ("instrument_high_pass", "corner_hz", 0.4, 0.04),
    ];
    for sensor in ["top", "base"] {
        for (kind, parameter, value, close) in cases {
            let text = format!("kind = '{kind}'\nsensor = '{sensor}'\n{parameter} = {value:?}");
            let found = super::super::standing(&problem(&text), None, &settings).unwrap();
            assert_eq!(found.len(), 1, "{text}: {found:?}");
            let found = &found[0].found;
            assert_eq!((found.kind.as_str(), found.target.as_str()), (kind, sensor));
            let estimate = &found.parameters[parameter];
            assert!((estimate.value - value).abs() < close, "{text}: {estimate:?}");
        }
        for text in ["kind = 'sensor_polarity'\ncomponent = 'NS'", "kind = 'swapped_channels'"] {
            let text = format!("{text}\nsensor = '{sensor}'");
            let found = super::super::standing(&problem(&text), None, &settings).unwrap();
            let tables: Vec<toml::Table> = found.into_iter().map(|s| s.found.table).collect();
            assert_eq!(tables, [toml::from_str::<toml::Table>(&text).unwrap()]);
        }
    }
    assert!(super::super::standing(&problem(""), None, &settings).unwrap().is_empty());
}

#[test]
fn the_first_order_is_that_of_the_exact_column() {
    let array = array(150.0);
    for depth_m in [0.0, 20.0, 33.0] {
        let f = 0.05;
        let k = TAU * f / 150.0;
        let exact = ((k * depth_m).cos() / (k * DEPTH_M).cos()).ln();
        let first = first_order_s2(&array.profile, depth_m) * f * f;
        assert!((first / exact - 1.0).abs() < 0.01, "{first} {exact}");
    }
    let mut cut = array.profile.clone();
    cut.layers = vec![cut.layers[0].clone(); 2];
    cut.layers[0].thickness_m = 13.0;
    cut.layers[1].thickness_m = 27.0;
    for depth_m in [0.0, 13.0, 20.0] {
        let [one, two] = [&array.profile, &cut].map(|p| first_order_s2(p, depth_m));
        assert!((one - two).abs() < 1e-12 && (travel_s(&cut, depth_m) - depth_m / 150.0).abs() < 1e-12);
    }
}

#[test]
fn soil_that_gets_soft_is_no_late_clock() {
    let settings = super::super::DiagnoseSettings::default();
    let mut problem = problem("");
    // Soil far softer than declared at rest, the more so the stronger an event; the replayed column knows by how much, to a few percent.
    let both = |base: &[f64], soil: [f64; 2]| [20.0, 0.0].map(|z| moved(base, soil, z)).to_vec();
    let mut replays = Vec::new();
    for (i, event) in problem.events.iter_mut().enumerate() {
        let (vs_m_s, damping_ratio) = (130.0 - 6.0 * i as f64, 0.15 + 0.02 * i as f64);
        event.outputs = both(&event.input, [vs_m_s, damping_ratio]);
        replays.push(Some(both(&event.input, [1.04 * vs_m_s, 0.9 * damping_ratio])));
    }
    let found = |replays| super::super::standing(&problem, replays, &settings).unwrap();
    assert!(found(Some(&replays)).is_empty(), "{:?}", found(Some(&replays)));
    assert!(found(None).iter().any(|s| s.found.kind == "clock_offset"), "{:?}", found(None));
}
