//! Records that another finite-element program made of a column with nothing undeclared: what two programs differ by is no effect, and
//! errors of sensors are told from it.
//!
//! All errors, in all events: `cargo test --release --test other_program -- --ignored --nocapture`.

#[path = "support/diagnosed_site.rs"]
mod diagnosed_site;

use diagnosed_site::{diagnosed, diagnosed_beside};
use std::path::{Path, PathBuf};

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Site of the records that another finite-element program made, see their README.
const OTHER_PROGRAM: &str = r#"
name = "other"
about = "Records of another finite-element program"
pipeline = "diagnose"
[site]
depth_m = 17.0
elements = 85
water_table_m = 0.6
vertical = "free"
rayleigh = { alpha_1_s = 0.1142, beta_s = 0.0002894 }
[[site.layer]]
thickness_m = 2.0
density_kg_m3 = 1900.0
vs_m_s = 120.0
k0 = 0.5
law = "sand"
[[site.layer]]
thickness_m = 4.0
density_kg_m3 = 1900.0
vs_m_s = 140.0
k0 = 0.5
law = "sand"
[[site.layer]]
thickness_m = 5.0
density_kg_m3 = 1900.0
vs_m_s = 165.0
k0 = 0.5
law = "sand"
[[site.layer]]
thickness_m = 6.0
density_kg_m3 = 1900.0
vs_m_s = 190.0
k0 = 0.5
law = "sand"
[sensors]
input = "DHB17"
[[sensors.output]]
name = "DHB11"
depth_m = 11.0
[[sensors.output]]
name = "DHB6"
depth_m = 6.0
[[sensors.output]]
name = "FA1-5"
depth_m = 0.0
[tolerances]
vs_ln = 0.03
[records]
format = "csv"
unit = "m/s2"
components = ["EW"]
train = ["LSST05", "LSST06", "LSST08", "LSST09", "LSST12"]
validation = ["LSST11", "LSST15"]
test = ["LSST07"]
"#;

/// The folder of records of the other program, if it is there.
fn records(name: &str) -> Option<PathBuf> {
    let dir = path("../shared/records").join(name);
    if !dir.is_dir() {
        eprintln!("skipped: no records in {}", dir.display());
    }
    dir.is_dir().then_some(dir)
}

/// The site with the law of its sand.
fn site() -> String {
    let lotung = std::fs::read_to_string(path("configs/lotung.toml")).expect("a manifest");
    let lotung: toml::Table = toml::from_str(&lotung).expect("TOML");
    let law = lotung["law"]["silty_sand"].as_table().expect("a law");
    format!("{OTHER_PROGRAM}[law.sand]\n{law}")
}

#[test]
fn another_program_that_computes_the_same_column_lacks_nothing() {
    let Some(dir) = records("opensees-null") else { return };
    let found = diagnosed(&site(), &dir);
    assert_eq!(found["verdict"], "none", "{found:#}");
    // The two programs differ, and nothing that repeats is more than the declared error of a column.
    assert!(found["rest"]["verdict"] != "unnamed", "{}", found["rest"]);
}

/// What is wrong beside the other program, and what is to be named: kind, and parameter and value where it has one.
struct Case {
    about: &'static str,
    records: &'static str,
    /// `[[effects]]` put on the records.
    errors: &'static str,
    /// Depth that is declared for DHB6, m. A measured motion cannot be read at another one.
    depth_m: f64,
    named: &'static [(&'static str, Option<(&'static str, f64)>)],
}

const ANISOTROPY: (&str, Option<(&str, f64)>) = ("directional_anisotropy", Some(("ln_velocity_difference", 0.2)));

const CASES: [Case; 7] = [
    Case { about: "nothing", records: "opensees-null", errors: "", depth_m: 6.0, named: &[] },
    Case { about: "anisotropy", records: "opensees-anisotropy", errors: "", depth_m: 6.0, named: &[ANISOTROPY] },
    Case {
        about: "gain",
        records: "opensees-null",
        errors: "[[effects]]\nkind = 'sensor_gain'\nsensor = 'DHB6'\nln_gain = -0.163",
        depth_m: 6.0,
        named: &[("sensor_gain", Some(("ln_gain", -0.163)))],
    },
    Case {
        about: "clock",
        records: "opensees-null",
        errors: "[[effects]]\nkind = 'clock_offset'\nsensor = 'DHB11'\noffset_s = 0.025",
        depth_m: 6.0,
        named: &[("clock_offset", Some(("offset_s", 0.025)))],
    },
    Case {
        about: "depth",
        records: "opensees-null",
        errors: "",
        depth_m: 4.5,
        named: &[("sensor_depth", Some(("offset_m", 1.5)))],
    },
    Case {
        about: "labels",
        records: "opensees-null",
        errors: "[[effects]]\nkind = 'swapped_channels'\nsensor = 'DHB11'\nwith = 'DHB6'",
        depth_m: 6.0,
        named: &[("swapped_channels", None)],
    },
    Case {
        about: "azimuth",
        records: "opensees-anisotropy",
        errors: "[[effects]]\nkind = 'sensor_orientation'\nsensor = 'FA1-5'\nazimuth_deg = 20.0",
        depth_m: 6.0,
        named: &[ANISOTROPY, ("sensor_orientation", Some(("azimuth_deg", 20.0)))],
    },
];

#[test]
#[ignore = "about twenty minutes on two cores"]
fn errors_of_sensors_are_named_beside_another_program() {
    const EVENTS: [(&str, &[&str]); 3] = [
        ("train", &["LSST05", "LSST06", "LSST08", "LSST09", "LSST10", "LSST12", "LSST13", "LSST18"]),
        ("validation", &["LSST11", "LSST15", "LSST16"]),
        ("test", &["LSST07", "LSST14", "LSST17"]),
    ];
    let declared: toml::Table = toml::from_str(&site()).expect("TOML");
    let mut wrong = Vec::new();
    for case in CASES {
        let Some(dir) = records(case.records) else { return };
        let mut site = declared.clone();
        for (split, events) in EVENTS {
            site["records"][split] = events.to_vec().into();
        }
        if case.records == "opensees-anisotropy" {
            site["records"]["components"] = vec!["EW", "NS"].into();
        }
        site["sensors"]["output"][1]["depth_m"] = case.depth_m.into();
        let found = diagnosed_beside(&site.to_string(), &dir, case.errors);
        let effects = found["effects"].as_array().expect("effects");
        let is_right = |(kind, value): &(&str, Option<(&str, f64)>)| {
            effects.iter().filter(|e| e["kind"] == *kind).any(|effect| {
                value.is_none_or(|(parameter, value)| {
                    let found = &effect["parameters"][parameter];
                    let end = |i: usize| found["ci95"][i].as_f64().unwrap_or(f64::NAN);
                    // The anisotropy is so well determined that its interval is narrower than the two programs are apart.
                    let is_near =
                        *kind == ANISOTROPY.0 && (found["value"].as_f64().unwrap_or(f64::NAN) - value).abs() <= 0.01;
                    is_near || (end(0) <= value && value <= end(1))
                })
            })
        };
        println!("{}: {} {}", case.about, found["verdict"], found["effects"]);
        let verdict = if case.named.is_empty() { "none" } else { "known" };
        if found["verdict"] != verdict || effects.len() != case.named.len() || !case.named.iter().all(is_right) {
            wrong.push(case.about);
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}
