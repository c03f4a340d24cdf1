//! Records that another finite-element program made with another law, Iwan's plasticity: what is undeclared in them is named, and nothing
//! else.
//!
//! All cases, about half an hour on two cores, with a Python for which `openseespy` is made:
//! `PYTHON=python3.12 cargo test --release --test other_law -- --ignored --nocapture`.

#[path = "support/diagnosed_site.rs"]
mod diagnosed_site;
#[path = "support/python.rs"]
mod python;

use diagnosed_site::diagnosed;
use std::path::Path;
use std::process::Command;

/// The site as an investigation has it: profile and backbones are those of the records, loops are Masing's.
const SITE: &str = r#"
name = "other-law"
about = "Records of another finite-element program with another law"
pipeline = "diagnose"
[site]
depth_m = 30.0
elements = 75
vertical = "restrained"
rayleigh = { alpha_1_s = 0.1713596, beta_s = 0.00043406 }
[[site.layer]]
thickness_m = 5.0
density_kg_m3 = 1800.0
vs_m_s = 170.0
law = "soil"
gamma_ref = 4e-4
[[site.layer]]
thickness_m = 10.0
density_kg_m3 = 1900.0
vs_m_s = 240.0
law = "soil"
gamma_ref = 6e-4
[[site.layer]]
thickness_m = 15.0
density_kg_m3 = 2000.0
vs_m_s = 330.0
law = "soil"
gamma_ref = 9e-4
[law.soil]
kind = "hyperbolic"
damping_ratio = 0.0
reduce_damping = false
[sensors]
input = "BASE"
[[sensors.output]]
name = "S15"
depth_m = 15.0
[[sensors.output]]
name = "S6"
depth_m = 6.0
[[sensors.output]]
name = "SURF"
depth_m = 0.0
[records]
format = "csv"
unit = "m/s2"
components = ["EW"]
train = ["E00", "E01", "E02", "E03", "E04", "E05", "E06", "E07"]
validation = ["E08", "E09", "E10"]
test = ["E11", "E12", "E13"]
"#;

/// What the records have that the site does not, and the effect that is to be named, with its value.
struct Case {
    about: &'static str,
    seed: u64,
    named: Option<(&'static str, &'static str, f64)>,
}

const CASES: [Case; 5] = [
    Case { about: "nothing", seed: 1, named: None },
    Case { about: "damping", seed: 2, named: Some(("small_strain_damping", "multiplier", 3.0)) },
    // 1.2 m of half the velocity: as slow as a seam of the catalogue's 1.76 m by this much.
    Case { about: "seam", seed: 3, named: Some(("thin_seam", "ln_factor", -0.557)) },
    Case { about: "nonlinear", seed: 4, named: Some(("nonlinearity", "ln_gamma_ref", -0.799)) },
    Case { about: "gain", seed: 5, named: Some(("sensor_gain", "ln_gain", -0.198)) },
];

#[test]
#[ignore = "about half an hour on two cores, and needs a Python for which `openseespy` is made"]
fn what_another_program_with_another_law_has_undeclared_is_named() {
    let Some(python) = python::python("opensees", "import openseespy.opensees, numpy", &["openseespy", "numpy"]) else {
        return;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/other_law/records.py");
    let mut wrong = Vec::new();
    for Case { about, seed, named } in CASES {
        let folder = tempfile::tempdir().expect("a folder");
        let made = Command::new(&python).arg(&script).args([about, &seed.to_string()]).arg(folder.path()).status();
        assert!(made.expect("the script starts").success(), "{about}");
        let found = diagnosed(SITE, folder.path());
        let effects = found["effects"].as_array().expect("effects");
        println!("{about}: {} {}", found["verdict"], found["effects"]);
        let is_right = match named {
            None => found["verdict"] == "none" && effects.is_empty(),
            Some((kind, parameter, value)) => {
                let ends = &effects.first().unwrap_or(&serde_json::Value::Null)["parameters"][parameter]["ci95"];
                let end = |i: usize| ends[i].as_f64().unwrap_or(f64::NAN);
                // Of a seam only thickness over stiffness can be told, and that about.
                let slack = if kind == "thin_seam" { 0.1 } else { 0.0 };
                let is_within = end(0) - slack <= value && value <= end(1) + slack;
                found["verdict"] == "known" && effects.len() == 1 && effects[0]["kind"] == kind && is_within
            }
        };
        if !is_right {
            wrong.push(about);
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}
