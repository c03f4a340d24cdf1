//! A made-up array whose declared profile is far off, seen through wrong sensors.

use super::super::problem::{Event, NoiseSpectrum};
use super::*;
use crate::column::{Features, Layer, Profile, Rayleigh, Vertical};
use crate::effects::{self, Array, Channels, Direction, Recording, Situation};
use crate::manifest::Tolerances;
use crate::numerics::{random, spectrum};
use crate::records::Split;
use rand_distr::{Distribution, StandardNormal};

const DT_S: f64 = 0.02;
const STEPS: usize = 2048;
const DEPTH_M: f64 = 40.0;

fn array(vs_m_s: f64) -> Array {
    let profile = Profile {
        layers: vec![Layer::plain("elastic", DEPTH_M, 2000.0, vs_m_s)],
        water_table_m: 100.0,
        vertical: Vertical::Free,
        rayleigh: Rayleigh::default(),
        elements: 1,
        features: Features::default(),
    };
    Array {
        profile,
        input: "base".into(),
        outputs: ["mid", "top"].map(String::from).to_vec(),
        depths_m: vec![20.0, 0.0],
        components: ["EW", "NS"].map(String::from).to_vec(),
    }
}

/// Six events of a uniform column of 150 m/s, declared as one of 200 m/s, seen through `effects`.
fn problem(table: &str) -> Problem {
    let tables: Vec<toml::Table> = if table.is_empty() { Vec::new() } else { vec![toml::from_str(table).unwrap()] };
    let built = effects::build_all(&tables).unwrap();
    let array = array(200.0);
    let transfer = |z: f64, f: f64| {
        let k = TAU * f / (C64::new(1.0, 2.0 * 0.03).sqrt() * 150.0);
        (k * z).cos() / (k * DEPTH_M).cos()
    };
    let mut stream = random::stream(5, "low frequency");
    let mut events = Vec::new();
    for e in 0..6 {
        let name = format!("E{e}");
        let mut motions: Vec<Channels> = vec![Vec::new(); 3];
        for _ in 0..2 {
            let envelope = |i: usize| (-((i as f64 - 700.0) / 250.0).powi(2)).exp();
            let white: Vec<f64> = (0..STEPS).map(|i| envelope(i) * sample(&mut stream)).collect();
            for (s, z) in [DEPTH_M, 20.0, 0.0].into_iter().enumerate() {
                let [motion] = spectrum::respond([white.as_slice()], DT_S, |f, [u]| [u * transfer(z, f)]);
                motions[s].push(motion);
            }
        }
        let names: Vec<String> = array.sensors().map(String::from).collect();
        let recording = Recording {
            event: &name,
            dt_s: DT_S,
            sensors: &names,
            depths_m: &[DEPTH_M, 20.0, 0.0],
            components: &array.components,
        };
        let mut recorded = effects::observe(&recording, &motions, &built, Direction::Distort);
        recorded.iter_mut().flatten().flatten().for_each(|v| *v += 0.01 * sample(&mut stream));
        for c in 0..2 {
            events.push(Event {
                name: name.clone(),
                situation: Situation::of(c, &name, ["E0"]),
                split: Split::Train,
                dt_s: DT_S,
                input: recorded[0][c].clone(),
                outputs: recorded[1..].iter().map(|s| s[c].clone()).collect(),
                noise: vec![NoiseSpectrum::white(0.01, DT_S); 3],
            });
        }
    }
    let tolerances = Tolerances { gain_ln: 0.01, clock_s: 0.001, orientation_deg: 1.0, ..Tolerances::default() };
    Problem { array, declared: Vec::new(), tolerances, events }
}

fn sample(stream: &mut impl rand::Rng) -> f64 {
    StandardNormal.sample(stream)
}

#[test]
fn errors_of_a_sensor_are_found_under_a_profile_that_is_far_off() {
    let settings = super::super::DiagnoseSettings::default();
    let cases = [
        ("sensor_orientation", "azimuth_deg", 12.0, 0.7),
        ("sensor_orientation", "azimuth_deg", -140.0, 0.7),
        ("clock_offset", "offset_s", 0.02, 0.003),
        ("sensor_gain", "ln_gain", 0.2, 0.03),
        ("instrument_high_pass", "corner_hz", 0.06, 0.01),
    ];
    for sensor in ["top", "base"] {
        for (kind, parameter, value, close) in cases {
            let text = format!("kind = '{kind}'\nsensor = '{sensor}'\n{parameter} = {value:?}");
            let found = super::super::standing(&problem(&text), &settings);
            // A high-pass of the input sensor is no high-pass of the others, and nothing is said of it.
            if kind == "instrument_high_pass" && sensor == "base" {
                continue;
            }
            assert_eq!(found.len(), 1, "{text}: {found:?}");
            let found = &found[0].found;
            assert_eq!((found.kind.as_str(), found.target.as_str()), (kind, sensor));
            let estimate = &found.parameters[parameter];
            assert!((estimate.value - value).abs() < close, "{text}: {estimate:?}");
        }
        for text in ["kind = 'sensor_polarity'\ncomponent = 'NS'", "kind = 'swapped_channels'"] {
            let text = format!("{text}\nsensor = '{sensor}'");
            let found = super::super::standing(&problem(&text), &settings);
            let tables: Vec<toml::Table> = found.into_iter().map(|s| s.found.table).collect();
            assert_eq!(tables, [toml::from_str::<toml::Table>(&text).unwrap()]);
        }
    }
    assert!(super::super::standing(&problem(""), &settings).is_empty());
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
