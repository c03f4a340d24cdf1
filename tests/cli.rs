//! The program as a user meets it: exit status, what is said where, caching, overrides, and prediction of a new event.

use assert_cmd::Command;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

fn flare_pipe(arguments: &[&str]) -> Command {
    let mut command = Command::cargo_bin("flare-pipe").expect("the program is built");
    command.current_dir(env!("CARGO_MANIFEST_DIR")).args(arguments);
    command
}

/// Runs and returns exit status, stdout and stderr.
fn said(arguments: &[&str]) -> (i32, String, String) {
    let output = flare_pipe(arguments).output().expect("the program starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap_or(-1), text(&output.stdout), text(&output.stderr))
}

/// A small version of the smoke run: few motions and epochs.
const SMALL: &[&str] = &["--set", "pretrain.epochs=20", "--set", "distill.epochs=5", "--set", "calibrate.epochs=10"];

fn run_small(run_dir: &Path, more: &[&str]) -> (i32, String, String) {
    let run_dir = run_dir.to_str().expect("a path in UTF-8");
    said(&[&["run", "configs/smoke.toml", "--run-dir", run_dir], SMALL, more].concat())
}

fn files(dir: &Path) -> BTreeMap<PathBuf, (SystemTime, u64)> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(dir).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            found.extend(files(&path));
        } else {
            let data = fs::metadata(&path).expect("a file");
            found.insert(path, (data.modified().expect("a time"), data.len()));
        }
    }
    found
}

#[test]
fn a_whole_run_is_cached_explained_and_predicts() {
    let dir = tempfile::tempdir().expect("a folder");
    let (status, stdout, stderr) = run_small(dir.path(), &[]);
    assert_eq!(status, 0, "{stderr}");
    assert_eq!(stdout, "", "stdout is for data");
    let site = dir.path().join("smoke");
    let metrics: serde_json::Value =
        serde_json::from_slice(&fs::read(site.join("metrics.json")).expect("metrics")).expect("JSON");
    assert_eq!(metrics["site"], "smoke");
    assert_eq!(metrics["test"].as_array().map(Vec::len), Some(8), "2 events, 2 components, 2 sensors");
    for row in metrics["test"].as_array().expect("a list") {
        assert!(row["nrmse_percent"]["fe"].as_f64().is_some_and(|v| v > 0.0), "{row}");
    }
    assert!(metrics["stages"]["pretrain"]["median_nrmse_percent"].is_number());
    assert!(metrics["timings_s"]["pretrain"].is_number());
    assert!(fs::read_to_string(site.join("report.html")).expect("a report").contains("synthetic twins"));

    let before = files(dir.path());
    let (status, _, stderr) = run_small(dir.path(), &[]);
    assert_eq!(status, 0, "{stderr}");
    assert_eq!(files(dir.path()), before, "a cached run rewrites nothing");

    let (status, plan, _) = {
        let run_dir = dir.path().to_str().expect("UTF-8");
        said(
            &[&["plan", "configs/smoke.toml", "--run-dir", run_dir], SMALL, &["--set", "calibrate.penalty=0.5"]]
                .concat(),
        )
    };
    assert_eq!(status, 0);
    for line in plan.lines() {
        let is_cached = line.contains("cached");
        let follows = ["calibrate", "extend", "evaluate", "compare", "report"].iter().any(|s| line.starts_with(s));
        assert_eq!(is_cached, !follows, "{line}");
    }
    assert!(plan.contains("`calibrate.penalty`: 1.0 → 0.5"), "{plan}");
    assert!(plan.lines().any(|l| l.starts_with("calibrate.EW") && l.contains("about ")), "{plan}");

    shows_the_model(dir.path());
    predicts(dir.path());

    let alone = tempfile::tempdir().expect("a folder");
    let (status, _, stderr) = run_small(alone.path(), &["--jobs", "1"]);
    assert_eq!(status, 0, "{stderr}");
    assert_eq!(contents(&alone.path().join("cache")), contents(&dir.path().join("cache")), "on one thread as on many");
}

#[test]
fn two_source_models_of_a_site_are_compared_on_the_same_records() {
    let dir = tempfile::tempdir().expect("a folder");
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
    let text = fs::read_to_string(configs.join("smoke.toml")).expect("a manifest");
    let truth = configs.join("truth/smoke.toml").display().to_string();
    let other = text
        .replace("name = \"smoke\"", "name = \"softer\"")
        .replace("truth/smoke.toml", &truth)
        .replace("plasticity_index = 5.0", "plasticity_index = 0.0");
    let path = dir.path().join("other.toml");
    fs::write(&path, other).expect("written");
    let study = format!("study.other={}", path.display());
    let (status, _, stderr) = run_small(dir.path(), &["--pipeline", "source-study", "--set", &study]);
    assert_eq!(status, 0, "{stderr}");
    let site = dir.path().join("smoke");
    let found: serde_json::Value =
        serde_json::from_slice(&fs::read(site.join("study.json")).expect("a study")).expect("JSON");
    assert_eq!(found["sources"], serde_json::json!(["smoke", "softer"]));
    assert_eq!(found["held_out"].as_array().map(Vec::len), Some(4), "2 events, 2 components");
    for row in found["held_out"].as_array().expect("a list") {
        let [own, other] = [0, 1].map(|i| row["r2"][i]["fe"].as_f64().expect("a number"));
        assert!(own != other, "two columns give two responses: {row}");
    }
    assert!(fs::read_to_string(site.join("report.html")).expect("a report").contains("Two source models"));
    let (status, _, stderr) = run_small(dir.path(), &["--pipeline", "source-study"]);
    assert_eq!(status, 2);
    assert!(stderr.contains("`[study]`"), "{stderr}");
}

/// Every file below `dir` by its path there and its bytes, but for the times that stages took.
fn contents(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let is_output = |path: &PathBuf| path.file_name().is_some_and(|n| n != "timing.toml");
    let relative = |path: &Path| path.strip_prefix(dir).expect("below").to_path_buf();
    files(dir)
        .into_keys()
        .filter(is_output)
        .map(|path| (relative(&path), fs::read(&path).expect("a file")))
        .filter(|(path, _)| path.extension().is_none_or(|e| e != "lock"))
        .collect()
}

fn shows_the_model(run_dir: &Path) {
    let run_dir = run_dir.to_str().expect("UTF-8");
    let show =
        |more: &[&str]| said(&[&["show", "model", "configs/smoke.toml", "--run-dir", run_dir], SMALL, more].concat());
    let (status, all, stderr) = show(&[]);
    assert_eq!(status, 0, "{stderr}");
    let titles: Vec<&str> = all.lines().filter(|l| l.starts_with('#')).collect();
    assert_eq!(titles.len(), 3, "{all}");
    for (title, start) in titles.iter().zip(["# source model: ", "# component EW: ", "# component NS: "]) {
        assert!(title.starts_with(start), "{title}");
    }
    assert_eq!(all.lines().filter(|l| l.starts_with("dz6/dt = ")).count(), 3);
    let (status, one, _) = show(&["--component", "NS"]);
    assert_eq!((status, one.lines().count()), (0, 9)); // a title, six states and two hidden ones
    assert!(all.ends_with(&one), "the same equations by themselves");
    let (status, _, stderr) = show(&["--component", "UD"]);
    assert_eq!(status, 2);
    assert!(stderr.contains("`UD`"), "{stderr}");
}

fn predicts(run_dir: &Path) {
    let dir = tempfile::tempdir().expect("a folder");
    let wave = |t: f64| 0.3 * (9.0 * t).sin() * (-(t - 4.0) * (t - 4.0) / 4.0).exp();
    let mut base = String::from("# a made-up event\n# unit: m/s2\ntime_s,base\n");
    let mut window = String::from("# unit: m/s2\ntime_s,middle,surface\n");
    for k in 0..1000 {
        let t = f64::from(k) * 0.01;
        base += &format!("{t:.2},{}\n", wave(t));
        if k < 60 {
            window += &format!("{t:.2},{},{}\n", wave(t), wave(t));
        }
    }
    let path = |name: &str| dir.path().join(name).to_str().expect("UTF-8").to_string();
    fs::write(path("base.csv"), base).expect("written");
    fs::write(path("window.csv"), window).expect("written");
    let (input, initial) = (path("base.csv"), path("window.csv"));
    for output in ["out.csv", "out.mcap"] {
        let output = path(output);
        let run_dir = run_dir.to_str().expect("UTF-8");
        let arguments = ["predict", "configs/smoke.toml", "--component", "EW", "--run-dir", run_dir];
        let files = ["--input", &input, "--window", &initial, "-o", &output];
        let (status, _, stderr) = said(&[&arguments, &files[..], SMALL].concat());
        assert_eq!(status, 0, "{stderr}");
        assert!(fs::metadata(&output).expect("a file").len() > 1000);
    }
    let table = fs::read_to_string(path("out.csv")).expect("a table");
    let mut lines = table.lines();
    assert_eq!(lines.next(), Some("time_s,middle,surface"));
    assert!(lines.next().is_some_and(|l| l.starts_with("0.25")), "the prediction begins after five samples of 0.05 s");
    assert_eq!(table.lines().count(), 1 + 195);
    let (status, _, stderr) = said(
        &[
            &["predict", "configs/smoke.toml", "--component", "UD", "--run-dir", run_dir.to_str().expect("UTF-8")],
            &["--input", &input, "--window", &initial, "-o", &path("x.csv")][..],
            SMALL,
        ]
        .concat(),
    );
    assert_ne!(status, 0);
    assert!(stderr.contains("calibrate.UD"), "{stderr}");
}

#[test]
fn every_problem_of_a_manifest_is_shown_at_once_with_its_line() {
    let dir = tempfile::tempdir().expect("a folder");
    let text =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/smoke.toml")).expect("a manifest");
    let text = text
        .replacen("vs_m_s = 130.0", "vs_m_s = -130.0", 1)
        .replacen("latent = 6", "latnet = 6", 1)
        .replacen("law = \"sand\"", "law = \"snad\"", 1)
        .replacen("depth_m = 10.0", "depth_m = \"ten\"", 1);
    let path = dir.path().join("site.toml");
    fs::write(&path, text).expect("written");
    let (status, _, stderr) = said(&["check", path.to_str().expect("UTF-8")]);
    assert_eq!(status, 2);
    for part in ["unknown key `latnet`", "nearest: `latent`", "must be a number", "site.toml:", "^"] {
        assert!(stderr.contains(part), "`{part}` in\n{stderr}");
    }
}

#[test]
fn ranges_and_names_are_checked_across_sections() {
    let (status, _, stderr) = said(&[
        "check",
        "configs/smoke.toml",
        "--set",
        "site.layer[1].vs_m_s=-5",
        "--set",
        "law.sand.kind=\"hyperbollic\"",
        "--set",
        "records.test=[\"E1\"]",
    ]);
    assert_eq!(status, 2);
    for part in ["20…5000 m/s, got -5", "nearest: `hyperbolic`", "E1"] {
        assert!(stderr.contains(part), "`{part}` in\n{stderr}");
    }
}

#[test]
fn a_mistake_in_a_law_is_told_once_for_all_its_layers() {
    let (status, _, stderr) = said(&["check", "configs/lotung.toml", "--set", "law.silty_sand.lambda=0.1"]);
    assert_eq!(status, 2);
    assert_eq!(stderr.matches("unknown key `lambda`").count(), 1, "{stderr}");
}

#[test]
fn mistakes_on_the_command_line_end_with_two() {
    for arguments in [
        vec!["run", "configs/absent.toml"],
        vec!["run", "configs/smoke.toml", "--pipeline", "flare"],
        vec!["run", "configs/smoke.toml", "--only", "nothing"],
        vec!["run", "configs/smoke.toml", "--set", "latent"],
        vec!["frobnicate"],
    ] {
        let (status, stdout, stderr) = said(&arguments);
        assert_eq!(status, 2, "{arguments:?}: {stderr}");
        assert_eq!(stdout, "");
        assert!(!stderr.is_empty());
    }
}

#[test]
fn lists_name_what_a_manifest_can_name() {
    for (what, name) in
        [("laws", "sanisand"), ("effects", "layer_velocity"), ("formats", "csv"), ("stages", "calibrate")]
    {
        let (status, stdout, _) = said(&["list", what]);
        assert_eq!(status, 0);
        assert!(stdout.lines().any(|l| l.starts_with(name)), "{stdout}");
    }
}

#[test]
fn shells_complete_the_names_of_stages_and_effects() {
    let (status, script, _) = said(&["completions", "bash"]);
    assert_eq!(status, 0);
    for name in ["replay-corrected", "downgoing_wave", "sanisand"] {
        assert!(script.contains(name), "{name}");
    }
    // Other names are taken as well: a pipeline may have stages of its own.
    let (status, _, told) = said(&["run", "configs/smoke.toml", "--until", "other", "--dry-run"]);
    assert!(status == 2 && told.contains("the pipeline has no stage `other`"), "{told}");
}

/// Editors read the schemas that are beside the shipped files; `flare-pipe schema KIND > configs/schema/KIND.json` renews one.
#[test]
fn the_shipped_schemas_are_those_of_the_program() {
    for kind in ["site", "truth", "matrix", "pipeline"] {
        let (status, printed, _) = said(&["schema", kind]);
        assert_eq!(status, 0);
        let shipped = fs::read_to_string(format!("configs/schema/{kind}.json")).expect("a schema");
        assert!(shipped == printed, "`flare-pipe schema {kind} > configs/schema/{kind}.json` renews it");
    }
}

#[test]
fn power_tells_before_any_data_what_could_be_seen() {
    let (status, stdout, stderr) = said(&["power", "configs/smoke.toml", "--json"]);
    assert_eq!(status, 0, "{stderr}");
    let power: serde_json::Value = serde_json::from_str(&stdout).expect("JSON");
    let of = |kind: &str, target: &str| {
        let effects = power["effects"].as_array().expect("a list").iter();
        effects.clone().find(|e| e["kind"] == kind && e["target"] == target).expect("an effect").clone()
    };
    assert_eq!(of("clock_offset", "surface")["is_visible"], true, "30 ms at the surface show");
    assert!(of("clock_offset", "surface")["detectable"].as_f64().is_some_and(|s| s > 1e-4 && s < 0.05));
    let (_, noisy, _) = said(&["power", "configs/smoke.toml", "--json", "--noise", "0.3"]);
    let noisy: serde_json::Value = serde_json::from_str(&noisy).expect("JSON");
    let best = |p: &serde_json::Value| p["effects"][0]["expected_score"].as_f64().expect("a number");
    assert!(best(&noisy) < 0.2 * best(&power), "noise hides");
    let (status, table, _) = said(&["power", "configs/smoke.toml"]);
    assert!(status == 0 && table.lines().any(|l| l.starts_with("sensor_gain")), "{table}");
}

#[test]
fn every_shipped_manifest_is_right() {
    for entry in fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("configs")).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|e| e == "toml") {
            let (status, _, stderr) = said(&["check", path.to_str().expect("UTF-8")]);
            if stderr.contains("there is no folder") {
                println!("skipped: the records of `{}` are not here", path.display());
                continue;
            }
            assert_eq!(status, 0, "{stderr}");
        }
    }
}
