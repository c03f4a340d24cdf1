//! Records of an exact linear column of layers with a damping ratio that does not depend on frequency: where the manifest declares just
//! that, nothing is missing, and what it does not declare is named.
//!
//! All seeds, and what is undeclared: `cargo test --release --test linear_column -- --ignored --nocapture`.

#[path = "support/diagnosed_site.rs"]
mod diagnosed_site;

use diagnosed_site::diagnosed;
use flare_pipe::numerics::random::stream;
use flare_pipe::numerics::spectrum::respond;
use rand_distr::{Distribution, StandardNormal, Uniform};
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::fmt::Write;
use std::path::Path;

type C64 = Complex<f64>;

const DT_S: f64 = 0.01;
const STEPS: usize = 4000;
const EVENTS: usize = 8;
/// Sensors from the input up, and their depths, m.
const SENSORS: [(&str, f64); 4] = [("B30", 30.0), ("D16", 16.0), ("D6", 6.0), ("S0", 0.0)];
const SITE: &str = r#"
name = "linear"
about = "An exact linear column"
pipeline = "diagnose"
[site]
depth_m = 30.0
elements = 60
water_table_m = 30.0
vertical = "free"
[sensors]
input = "B30"
[records]
format = "csv"
unit = "m/s2"
components = ["EW", "NS"]
train = ["L1", "L2", "L3", "L4"]
validation = ["L5", "L6"]
test = ["L7", "L8"]
"#;

/// Laws that are declared.
const ELASTIC: &str = "kind = \"elastic\"\ndamping_ratio = 0.03";
const HYPERBOLIC: &str = "kind = \"hyperbolic\"\nplasticity_index = 20.0\ndamping_ratio = 0.01";
/// Peaks of motions so weak that the hyperbolic law is linear as well.
const WEAK_M_S2: f64 = 0.002;

#[derive(Clone)]
struct Layer {
    thickness_m: f64,
    vs_m_s: f64,
    density_kg_m3: f64,
}

const LAYERS: [Layer; 3] = [
    Layer { thickness_m: 6.0, vs_m_s: 140.0, density_kg_m3: 1850.0 },
    Layer { thickness_m: 10.0, vs_m_s: 210.0, density_kg_m3: 1900.0 },
    Layer { thickness_m: 14.0, vs_m_s: 290.0, density_kg_m3: 1950.0 },
];

/// What holds.
struct Column {
    layers: Vec<Layer>,
    damping_ratio: f64,
    /// Peaks of base motions, on average.
    size_m_s2: f64,
}

/// Motion at `depth_m` over that at the base: Kramer (1996), Geotechnical Earthquake Engineering, section 7.2.1.3, of the modulus
/// G (1 + 2 i ξ).
fn transfer(column: &Column, f_hz: f64, depth_m: f64) -> C64 {
    let velocity = |layer: &Layer| C64::new(1.0, 2.0 * column.damping_ratio).sqrt() * layer.vs_m_s;
    let (mut up, mut down) = (C64::from(1.0), C64::from(1.0));
    let (mut top_m, mut there) = (0.0, C64::from(2.0));
    for (i, layer) in column.layers.iter().enumerate() {
        let wave = |z_m: f64, sign: f64| (C64::i() * sign * TAU * f_hz / velocity(layer) * z_m).exp();
        if (top_m..top_m + layer.thickness_m).contains(&depth_m) {
            there = up * wave(depth_m - top_m, 1.0) + down * wave(depth_m - top_m, -1.0);
        }
        (up, down) = (up * wave(layer.thickness_m, 1.0), down * wave(layer.thickness_m, -1.0));
        if let Some(below) = column.layers.get(i + 1) {
            let ratio = velocity(layer) * layer.density_kg_m3 / (velocity(below) * below.density_kg_m3);
            (up, down) =
                ((up * (1.0 + ratio) + down * (1.0 - ratio)) * 0.5, (up * (1.0 - ratio) + down * (1.0 + ratio)) * 0.5);
        }
        top_m += layer.thickness_m;
    }
    there / (up + down)
}

/// Writes the records of every event and component of `column` into `dir`.
fn record(column: &Column, dir: &Path, seed: u64) {
    let mut random = stream(seed, "linear column");
    let mut between = |low: f64, high: f64| Uniform::new(low, high).expect("a range").sample(&mut random);
    for event in 1..=EVENTS {
        for component in ["EW", "NS"] {
            let (ln_size, corner_hz) = (between(-1.0, 1.0), between(1.5, 4.0));
            let mut random = stream(seed, &format!("linear {event} {component}"));
            let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
            let envelope = |i: usize| {
                let t = i as f64 * DT_S / 4.0;
                t * t * (2.0 * (1.0 - t)).exp()
            };
            let white: Vec<f64> = (0..STEPS).map(|i| envelope(i) * normal()).collect();
            let shape =
                |f: f64| f * f / (0.09 + f * f) / (1.0 + (f / corner_hz).powi(2)).sqrt() / (1.0 + (f / 20.0).powi(8));
            let [mut base] = respond([&white], DT_S, |f, [x]| [x * shape(f)]);
            let peak = base.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
            base.iter_mut().for_each(|x| *x *= column.size_m_s2 * ln_size.exp() / peak);
            let moved = |depth_m: f64| -> Vec<f64> {
                if depth_m >= 30.0 {
                    return base.clone();
                }
                let [motion] = respond([&base], DT_S, |f, [u]| [u * transfer(column, f, depth_m)]);
                motion
            };
            let recorded = SENSORS.map(|(_, depth_m)| {
                let motion = moved(depth_m);
                let rms = (motion.iter().map(|x| x * x).sum::<f64>() / STEPS as f64).sqrt();
                motion.into_iter().map(|x| x + 0.01 * rms * normal()).collect::<Vec<f64>>()
            });
            let mut text = format!("time_s,{}\n", SENSORS.map(|(name, _)| name).join(","));
            for i in 0..STEPS {
                let row: Vec<String> = recorded.iter().map(|x| format!("{:.6e}", x[i])).collect();
                writeln!(text, "{:.2},{}", i as f64 * DT_S, row.join(",")).expect("a string");
            }
            std::fs::write(dir.join(format!("L{event}.{component}.csv")), text).expect("written");
        }
    }
}

/// What is found in records of `column` where [`LAYERS`] of `law` are declared.
fn found(column: &Column, law: &str, seed: u64) -> serde_json::Value {
    let place = tempfile::tempdir().expect("a folder");
    record(column, place.path(), seed);
    let mut site = format!("{SITE}[law.soil]\n{law}\n");
    for Layer { thickness_m, vs_m_s, density_kg_m3 } in LAYERS {
        let values = format!("thickness_m = {thickness_m:?}\nvs_m_s = {vs_m_s:?}\ndensity_kg_m3 = {density_kg_m3:?}");
        writeln!(site, "[[site.layer]]\nlaw = \"soil\"\n{values}").expect("a string");
    }
    for (name, depth_m) in &SENSORS[1..] {
        writeln!(site, "[[sensors.output]]\nname = \"{name}\"\ndepth_m = {depth_m:?}").expect("a string");
    }
    diagnosed(&site, place.path())
}

fn lacks_nothing(seed: u64) {
    let found = found(&Column { layers: LAYERS.to_vec(), damping_ratio: 0.03, size_m_s2: 0.2 }, ELASTIC, seed);
    assert_eq!(found["verdict"], "none", "seed {seed}: {}", found["effects"]);
    assert_eq!(found["rest"]["verdict"], "noise", "seed {seed}: {}", found["rest"]);
}

#[test]
fn a_linear_column_as_declared_lacks_nothing() {
    lacks_nothing(1);
}

#[test]
#[ignore = "minutes on two cores"]
fn linear_columns_as_declared_lack_nothing() {
    (2..=6).for_each(lacks_nothing);
}

#[test]
#[ignore = "minutes on two cores"]
fn what_a_linear_column_has_undeclared_is_named() {
    let thrice = Column { layers: LAYERS.to_vec(), damping_ratio: 0.03, size_m_s2: WEAK_M_S2 };
    let soft = Layer { thickness_m: 1.0, vs_m_s: 105.0, ..LAYERS[1] };
    let [above, below] = [3.0, 6.0].map(|thickness_m| Layer { thickness_m, ..LAYERS[1] });
    let [first, _, last] = LAYERS;
    let seam = Column { layers: vec![first, above, soft, below, last], damping_ratio: 0.01, size_m_s2: WEAK_M_S2 };
    for (column, kind, truth) in [(thrice, "small_strain_damping", Some(3.0)), (seam, "thin_seam", None)] {
        let found = found(&column, HYPERBOLIC, 1);
        println!("{kind}: {} {}", found["verdict"], found["effects"]);
        let kinds: Vec<_> = found["effects"].as_array().expect("effects").iter().map(|e| e["kind"].clone()).collect();
        assert_eq!((&found["verdict"], kinds), (&"known".into(), vec![kind.into()]), "{}", found["effects"]);
        if let Some(truth) = truth {
            let interval = &found["effects"][0]["parameters"]["multiplier"]["ci95"];
            let end = |i: usize| interval[i].as_f64().expect("an interval");
            assert!((end(0)..=end(1)).contains(&truth), "{interval}");
        }
    }
}
