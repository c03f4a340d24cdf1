//! Closing the loop as a user meets it: what is missing is named, correcting it pays on events nobody touched, nothing is
//! named where nothing is missing, and nobody but the records stage reads the truth.

use assert_cmd::Command;
use flare_pipe::records::{self, RecordSettings};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

#[path = "support/python.rs"]
mod python;

/// Epochs enough for a test.
const FEW: [&str; 3] = ["pretrain.epochs=20", "distill.epochs=5", "calibrate.epochs=10"];

/// A place with a manifest, a truth and a run directory.
struct Place {
    dir: tempfile::TempDir,
}

/// A made-up site small enough for a test, its truth drawn within its tolerances.
const EVENTS: [(&str, f64, f64); 8] = [
    ("E1", 0.02, 0.03),
    ("E2", 0.05, 0.04),
    ("E3", 0.08, 0.06),
    ("E4", 0.04, 0.05),
    ("E5", 0.03, 0.02),
    ("E6", 0.06, 0.05),
    ("E7", 0.03, 0.04),
    ("E8", 0.05, 0.07),
];

/// What was exported as MCAP is read as records again, to the digits that it has.
fn reads_back(out: &Path) {
    let settings: RecordSettings =
        toml::from_str("format = 'mcap'\ncomponents = ['EW', 'NS']\ntrain = ['E7']\nvalidation = []\ntest = ['E8']\n")
            .expect("settings");
    let outputs = ["middle".to_string(), "surface".into()];
    let read = records::load(&settings, out, "base", &outputs).expect("records").records;
    assert_eq!(read.len(), 2 * 2);
    let table = fs::read_to_string(out.join("histories.csv")).expect("a table");
    for (_, record) in &read {
        for (sensor, name) in record.sensors().zip(["input", "middle", "surface"]) {
            let start = format!("{},{},{name},record,", record.event, record.component);
            let value = |line: &str| line.rsplit(',').next().and_then(|v| v.parse::<f64>().ok()).expect("a value");
            let expected: Vec<f64> = table.lines().filter(|line| line.starts_with(&start)).map(value).collect();
            assert!(expected.len() > 1000 && expected.len() == sensor.acceleration_m_s2.len(), "{start}");
            let pairs = expected.iter().zip(&sensor.acceleration_m_s2);
            pairs.for_each(|(a, b)| assert!((a - b).abs() <= 1e-5 * a.abs(), "{start}: {a} {b}"));
        }
    }
}

impl Place {
    /// The results as other programs read them.
    fn export(&self) {
        let mut command = Command::cargo_bin("flare-pipe").expect("the program is built");
        let [manifest, runs, out] = ["site.toml", "runs", "out"].map(|name| self.path(name));
        command
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .arg("export")
            .arg(manifest)
            .arg("--run-dir")
            .arg(runs)
            .arg("-o")
            .arg(&out);
        FEW.iter().for_each(|f| {
            command.args(["--set", f]);
        });
        command.assert().success();
        reads_back(&out);
        let packages =
            ["pandas", "xarray", "mcap-protobuf-support", "safetensors", "matplotlib", "nbclient", "ipykernel"];
        let imports = "import pandas, xarray, mcap_protobuf, safetensors, matplotlib, nbclient, ipykernel";
        let Some(python) = python::python("export", imports, &packages) else { return };
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let script = root.join("tests/read_export.py");
        let read = std::process::Command::new(&python).arg(script).arg(&out).output().expect("python");
        assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
        let program = Path::new(env!("CARGO_BIN_EXE_flare-pipe")).parent().expect("a folder");
        let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap_or_default());
        let runs = self.path("runs").display().to_string();
        let options: Vec<&str> =
            ["--run-dir", &runs].into_iter().chain(FEW.iter().flat_map(|f| ["--set", *f])).collect();
        let opens = |script: &mut std::process::Command| {
            script.env("PATH", &path).env("PYTHONPATH", root.join("python")).env("PYTHONDONTWRITEBYTECODE", "1");
            let opened = script.current_dir(root).output().expect("python");
            assert!(opened.status.success(), "{}", String::from_utf8_lossy(&opened.stderr));
        };
        let script = |name: &str| {
            let mut script = std::process::Command::new(&python);
            script.arg(name);
            script
        };
        opens(script("tests/read_package.py").arg(self.path("site.toml")).args(&options));
        let mut notebook = script("tests/run_notebook.py");
        notebook.env("FLARE_PIPE_SITE", self.path("site.toml")).env("FLARE_PIPE_OPTIONS", options.join(" "));
        opens(notebook.arg("examples/results.ipynb"));
        let lines = String::from_utf8_lossy(&read.stdout).lines().map(str::to_string).collect::<Vec<_>>();
        assert_eq!(lines.len(), 2 * 2, "events, components: {lines:?}");
        for line in lines {
            assert!(line.ends_with("\t24\t6"), "depths of two models, record and five models: {line}");
        }
    }

    fn new(effect: &str) -> Self {
        let place = Self { dir: tempfile::tempdir().expect("a folder") };
        let smoke = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/smoke.toml");
        let manifest = fs::read_to_string(smoke).expect("a manifest");
        let lists = [("train", &EVENTS[..4]), ("validation", &EVENTS[4..6]), ("test", &EVENTS[6..])];
        let mut table: toml::Table = toml::from_str(&manifest).expect("TOML");
        table.insert("pipeline".into(), "close-loop".into());
        let records = table["records"].as_table_mut().expect("a table");
        records.insert("truth".into(), "truth.toml".into());
        for (split, events) in lists {
            let names: Vec<toml::Value> = events.iter().map(|e| e.0.into()).collect();
            records.insert(split.into(), names.into());
        }
        fs::write(place.path("site.toml"), table.to_string()).expect("written");
        let mut truth = String::from("site = 'site.toml'\nseed = 4\n[noise]\nrms_share = 0.02\n");
        for (name, ew, ns) in EVENTS {
            truth += &format!("[[event]]\nname = '{name}'\npga_g = {{ EW = {ew}, NS = {ns} }}\nduration_s = 12.0\n");
        }
        fs::write(place.path("truth.toml"), truth + effect).expect("written");
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// Runs with few epochs and returns what was computed.
    fn run(&self, more: &[&str]) -> Vec<String> {
        let mut command = Command::cargo_bin("flare-pipe").expect("the program is built");
        command.current_dir(env!("CARGO_MANIFEST_DIR")).arg("run").arg(self.path("site.toml"));
        command.arg("--run-dir").arg(self.path("runs")).args(["--json", "-q"]).args(more);
        FEW.iter().for_each(|f| {
            command.args(["--set", f]);
        });
        let output = command.output().expect("the program starts");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let said: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let computed = said["computed"].as_array().expect("a list");
        computed.iter().map(|name| name.as_str().expect("a name").to_string()).collect()
    }

    fn loop_json(&self) -> Value {
        serde_json::from_slice(&fs::read(self.path("runs/smoke/loop.json")).expect("written")).expect("JSON")
    }
}

#[test]
fn what_is_missing_is_named_from_sealed_records_and_correcting_it_pays_on_held_out_events() {
    let place = Place::new("[[effects]]\nkind = 'sensor_orientation'\nsensor = 'surface'\nazimuth_deg = 22.0\n");
    let computed = place.run(&["--until", "records"]);
    assert_eq!(computed, ["records"]);
    // Nobody else may need the truth: it is gone before anything else runs.
    fs::remove_file(place.path("truth.toml")).expect("removed");
    let computed = place.run(&[]);
    assert!(computed.iter().any(|s| s == "diagnose") && !computed.iter().any(|s| s == "records"), "{computed:?}");

    let found = place.loop_json();
    assert_eq!(found["verdict"], "known", "{found:#}");
    assert_eq!(found["effects"].as_array().map(Vec::len), Some(1), "{found:#}");
    let effect = &found["effects"][0];
    assert_eq!((&effect["kind"], &effect["target"]), (&"sensor_orientation".into(), &"surface".into()), "{found:#}");
    let azimuth = &effect["parameters"]["azimuth_deg"];
    // The sensor stands as it was put, give or take the degree of the tolerance.
    assert!((azimuth["value"].as_f64().expect("a number") - 22.0).abs() < 4.0, "{azimuth}");
    assert_eq!(found["candidates"][0]["kind"], "sensor_orientation");
    assert!(effect["p_value"].as_f64().is_some_and(|p| p < 0.01), "{effect}");
    // How the base is turned is told beside it, though nothing of it is named.
    let declared = found["declared"].as_array().expect("a list");
    let is_meant = |v: &&Value| v["kind"] == "sensor_orientation" && v["target"] == "base";
    let base = declared.iter().find(is_meant).expect("an azimuth of the base");
    assert!(base["estimate"]["ci95"][0].as_f64() < base["estimate"]["ci95"][1].as_f64(), "{base}");

    let medians = &found["summary"]["test_median_nrmse_percent"];
    let median = |name: &str| medians[name].as_f64().expect("a number");
    assert!(median("corrected") < 0.8 * median("recalibrated"), "{medians}");
    assert!(median("flare_after").is_finite() && median("noise_floor") < 0.5 * median("recalibrated"), "{medians}");
    let rows = found["errors"].as_array().expect("a list");
    assert_eq!(rows.len(), 8 * 2 * 2, "events, components, sensors");
    for row in rows {
        for name in ["declared", "recalibrated", "corrected", "flare_before", "flare_after", "noise_floor", "ceiling"] {
            assert!(row["nrmse_percent"][name].is_number(), "{row}");
        }
    }

    let report = fs::read_to_string(place.path("runs/smoke/report.html")).expect("a report");
    assert!(report.contains("Known: surface is turned by "));
    let corrected = place.path("runs/smoke/site.corrected.toml");
    let mut check = Command::cargo_bin("flare-pipe").expect("the program is built");
    check.current_dir(env!("CARGO_MANIFEST_DIR")).arg("check").arg(&corrected).assert().success();
    assert!(fs::read_to_string(corrected).expect("written").contains("kind = \"sensor_orientation\""));
    assert!(place.run(&[]).is_empty(), "everything is cached, the truth still gone");
    // Replays are for a diagnosis that goes on: nothing that is done needs them.
    let replays = || {
        let entries = fs::read_dir(place.path("runs/cache")).expect("a cache").flatten();
        entries.filter(|e| e.file_name().to_string_lossy().starts_with("replayed-")).map(|e| e.path()).next()
    };
    let count = |folder: Option<PathBuf>| folder.map_or(0, |f| fs::read_dir(f).expect("a folder").count());
    assert!(count(replays()) > 100);
    // The manifest as it stands there was begun and never finished: what was run has settings besides.
    fs::rename(place.path("site.toml"), place.path("site.away")).expect("renamed");
    let mut gc = Command::cargo_bin("flare-pipe").expect("the program is built");
    gc.arg("gc").arg("--yes").arg("--run-dir").arg(place.path("runs")).assert().success();
    fs::rename(place.path("site.away"), place.path("site.toml")).expect("renamed");
    assert_eq!(count(replays()), 0);
    assert!(place.run(&[]).is_empty(), "everything that lasts is still there");
    place.export();

    // The same loop without FLARE-T compares the same replays, over whole records.
    assert_eq!(place.run(&["--pipeline", "diagnose"]), ["compare", "report"]);
    let first = place.loop_json()["answer"][0].as_str().expect("a sentence").to_string();
    assert!(first.starts_with("Known: surface is turned by "), "{first}");
    let report = fs::read_to_string(place.path("runs/smoke/report.html")).expect("a report");
    assert!(report.contains(&first), "the report begins with the same words");
    let alone = place.loop_json()["summary"]["test_median_nrmse_percent"].clone();
    assert!(alone["flare_after"].is_null(), "{alone}");
    for name in ["declared", "recalibrated", "corrected", "noise_floor"] {
        let [alone, beside] = [&alone, medians].map(|m| m[name].as_f64().expect("a number"));
        assert!((alone / beside - 1.0).abs() < 0.1, "{name}: {alone} {beside}");
    }
}

#[test]
fn nothing_is_named_where_nothing_is_missing_and_the_second_pass_is_the_first() {
    let place = Place::new("");
    let computed = place.run(&[]);
    let found = place.loop_json();
    assert_eq!(found["verdict"], "none", "{found:#}");
    assert_eq!(found["effects"].as_array().map(Vec::len), Some(0));
    let medians = &found["summary"]["test_median_nrmse_percent"];
    assert!(medians["recalibrated"].is_number() && medians["corrected"].is_null() && medians["flare_after"].is_null());
    let again = ["simulate-corrected", "replay-corrected", "pretrain-corrected", "calibrate-ablation.EW"];
    assert!(!computed.iter().any(|s| again.contains(&s.as_str())), "{computed:?}");
    assert!(!place.path("runs/smoke/site.corrected.toml").exists());
}

#[test]
fn what_has_no_name_is_called_unknown_and_corrected_without_physics_under_the_same_rule() {
    let place = Place::new("[[outside]]\nkind = 'lateral_scattering'\nln_amplitude = 0.4\nphase_rad = 0.4\n");
    place.run(&[]);
    let found = place.loop_json();
    assert_eq!(found["verdict"], "unknown", "{found:#}");
    // What comes nearest to a name may be said; it explains too little to be applied.
    assert!(found["summary"]["test_median_nrmse_percent"]["corrected"].is_null(), "{found:#}");
    let generic = &found["generic"];
    assert_eq!(generic["is_physical"], false);
    let rows = generic["errors"].as_array().expect("a list");
    assert_eq!(rows.len(), 8 * 2 * 2, "events, components, sensors");
    for (row, six) in rows.iter().zip(found["errors"].as_array().expect("a list")) {
        let nrmse = &row["nrmse_percent"];
        assert_eq!(nrmse["fe"], six["nrmse_percent"]["recalibrated"], "{row}");
        assert_eq!(nrmse["flare_t"], six["nrmse_percent"]["flare_before"], "{row}");
        let sensor = row["sensor"].as_str().expect("a name");
        assert_eq!(nrmse["fe_generic"].is_number(), generic["factors"].get(sensor).is_some(), "{row}");
        let component = row["component"].as_str().expect("a name");
        assert_eq!(nrmse["flare_t_generic"].is_null(), generic["terms"][component]["taken"].is_null(), "{row}");
    }
    assert!(generic["factors"].as_object().is_some_and(|f| !f.is_empty()), "{:#}", generic["factors"]);
    for component in ["EW", "NS"] {
        let terms = &generic["terms"][component];
        assert_eq!(terms["is_asked"], true);
        assert!(terms["tried"].as_array().is_some_and(|tried| tried.len() >= 3), "{terms}");
        let [before, after] = [0, 1].map(|i| terms["validation"][i].as_f64().expect("a number"));
        assert!(if terms["taken"].is_null() { after == before } else { after < before }, "{terms}");
    }
    // A shape that is the same in all events is taken off events that nobody looked at.
    let change = &generic["changes"][0];
    assert_eq!((&change["from"], &change["to"]), (&"fe".into(), &"fe_generic".into()));
    assert!(change["mean"].as_f64().is_some_and(|points| points < -2.0), "{change}");
    let report = fs::read_to_string(place.path("runs/smoke/report.html")).expect("a report");
    assert!(report.contains("without physical meaning") && report.contains("FE with factors"));
}
