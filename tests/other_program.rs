//! Records that another finite-element program made of a column with nothing undeclared: what two programs differ by is no effect.

#[path = "support/diagnosed_site.rs"]
mod diagnosed_site;

use diagnosed_site::diagnosed;
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

#[test]
fn another_program_that_computes_the_same_column_lacks_nothing() {
    let dir = path("../shared/records/opensees-null");
    if !dir.is_dir() {
        eprintln!("skipped: no records in ../shared/records/opensees-null");
        return;
    }
    let lotung = std::fs::read_to_string(path("configs/lotung.toml")).expect("a manifest");
    let lotung: toml::Table = toml::from_str(&lotung).expect("TOML");
    let law = lotung["law"]["silty_sand"].as_table().expect("a law");
    let found = diagnosed(&format!("{OTHER_PROGRAM}[law.sand]\n{law}"), &dir);
    assert_eq!(found["verdict"], "none", "{found:#}");
    // The two programs differ, and nothing that repeats is more than the declared error of a column.
    assert!(found["rest"]["verdict"] != "unnamed", "{}", found["rest"]);
}
