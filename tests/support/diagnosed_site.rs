//! Sites whose records tests write: the program diagnoses them from the command line.

use std::path::Path;

/// What a manifest needs besides its site and records, and a diagnosis does not look at.
const REST: &str = r#"
[motions]
count = 20
seed = 1
duration_s = 15.0
bands = [{ count = 20, min_pga_g = 0.01, max_pga_g = 0.03 }]
train = "1-16"
validation = "17-20"
[pretrain]
window = 3
latent = 6
channels = 16
step_s = 0.05
[distill]
window = 5
[calibrate]
"#;

/// `loop.json` of the manifest `site`, with records from `records_dir`, run from nothing.
pub fn diagnosed(site: &str, records_dir: &Path) -> serde_json::Value {
    diagnosed_beside(site, records_dir, "")
}

/// The same with the `[[effects]]` of sensors in `errors` put on the records.
pub fn diagnosed_beside(site: &str, records_dir: &Path, errors: &str) -> serde_json::Value {
    let place = tempfile::tempdir().expect("a folder");
    let mut manifest: toml::Table = toml::from_str(&format!("{site}{REST}")).expect("TOML");
    let records = manifest["records"].as_table_mut().expect("a table");
    records.insert("dir".into(), records_dir.display().to_string().into());
    if !errors.is_empty() {
        records.insert("truth".into(), "truth.toml".into());
        let truth = format!("about = \"errors of sensors\"\nsite = \"site.toml\"\nseed = 1\n{errors}");
        std::fs::write(place.path().join("truth.toml"), truth).expect("written");
    }
    let (name, path) = (manifest["name"].as_str().expect("a name").to_string(), place.path().join("site.toml"));
    std::fs::write(&path, manifest.to_string()).expect("written");
    let mut command = assert_cmd::Command::cargo_bin("flare-pipe").expect("the program is built");
    command.current_dir(env!("CARGO_MANIFEST_DIR")).arg("run").arg(path);
    command.arg("--run-dir").arg(place.path().join("runs")).arg("-q").assert().success();
    let text = std::fs::read(place.path().join("runs").join(name).join("loop.json")).expect("written");
    serde_json::from_slice(&text).expect("JSON")
}
