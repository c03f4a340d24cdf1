//! Many sites, and one site under many settings: one cache, a table and a page of all, and a failure that stops no other.

#[path = "support/small_site.rs"]
mod small_site;

use small_site::SMALL;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

fn said(words: &[&str], run_dir: &Path) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flare-pipe"));
    command.current_dir(env!("CARGO_MANIFEST_DIR")).args(words).args(SMALL).arg("--run-dir").arg(run_dir);
    let output = command.stdin(Stdio::null()).output().expect("the program starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap_or(-1), text(&output.stdout), text(&output.stderr))
}

/// Rows of a CSV by their label.
fn rows(path: &Path) -> BTreeMap<String, BTreeMap<String, String>> {
    let mut reader = csv::Reader::from_path(path).expect("a table");
    let header: Vec<String> = reader.headers().expect("a header").iter().map(String::from).collect();
    let of = |row: csv::StringRecord| header.iter().cloned().zip(row.iter().map(String::from)).collect();
    let rows: Vec<BTreeMap<String, String>> = reader.records().map(|row| of(row.expect("a row"))).collect();
    rows.into_iter().map(|row| (row["label"].clone(), row)).collect()
}

#[test]
fn a_sweep_shares_what_its_settings_do_not_change() {
    let dir = tempfile::tempdir().expect("a folder");
    let words = ["sweep", "configs/smoke.toml", "--over", "pretrain.latent=4,6", "--over", "distill.window=3,5"];
    let (status, stdout, stderr) = said(&words, dir.path());
    assert_eq!(status, 0, "{stderr}");
    let folder = dir.path().join("smoke.sweep");
    assert_eq!(
        stdout.lines().map(Path::new).collect::<Vec<_>>(),
        [folder.join("fleet.html"), folder.join("fleet.csv")]
    );
    let rows = rows(&folder.join("fleet.csv"));
    let labels: Vec<&str> = rows.keys().map(String::as_str).collect();
    let label = |window, latent| format!("smoke, distill.window={window}, pretrain.latent={latent}");
    assert_eq!(labels, [label(3, 4), label(3, 6), label(5, 4), label(5, 6)]);
    for row in rows.values() {
        let error: f64 = row["stages.pretrain.median_nrmse_percent"].parse().expect("a number");
        assert!(error > 0.0 && row["error"].is_empty(), "{row:?}");
    }
    // Of four runs, one ensemble, two trainings and four encoders.
    let count = |kind: &str| {
        let kinds =
            fs::read_dir(dir.path().join("cache")).expect("a cache").map(|entry| entry.expect("an entry").path());
        let own = kinds
            .filter(|path| path.file_name().is_some_and(|n| n.to_string_lossy().starts_with(&format!("{kind}-v"))));
        own.flat_map(|path| fs::read_dir(path).expect("a folder")).count()
    };
    assert_eq!([count("simulate"), count("pretrain"), count("distill")], [1, 2, 4]);
    let page = fs::read_to_string(folder.join("fleet.html")).expect("a page");
    let linked =
        page.split("href=\"").filter_map(|rest| rest.split('"').next()).filter(|link| link.ends_with("report.html"));
    let linked: Vec<&str> = linked.collect();
    assert_eq!(linked.len(), 4);
    assert!(linked.iter().all(|link| folder.join(link).is_file()), "{linked:?}");
    // Again: nothing is computed, and the same is said.
    let before = fs::read(folder.join("fleet.csv")).expect("readable");
    let (status, json, stderr) = said(&[&words[..], &["--json"]].concat(), dir.path());
    assert_eq!(status, 0, "{stderr}");
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert!(json.as_array().expect("a list").iter().all(|row| row["computed"] == 0), "{json}");
    assert_eq!(fs::read(folder.join("fleet.csv")).expect("readable"), before);
}

#[test]
fn a_site_that_fails_stops_no_other() {
    let dir = tempfile::tempdir().expect("a folder");
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/smoke.toml");
    let table = dir.path().join("sites.csv");
    let text = format!(
        "# three sites\nsite,motions.seed,analysis.max_iterations,analysis.min_step_s,analysis.tolerance\n{0},1,,,\n{0},2,,,\n{0},3,2,0.001,1e-12\nabsent.toml,4,,,\n",
        own.display()
    );
    fs::write(&table, text).expect("writable");
    let runs = dir.path().join("runs");
    let (status, _, stderr) = said(&["fleet", table.to_str().expect("UTF-8")], &runs);
    assert_eq!(status, 1, "{stderr}");
    assert!(stderr.contains("2 of 4 runs failed"), "{stderr}");
    let rows = rows(&runs.join("fleet/fleet.csv"));
    let errors: Vec<&str> = rows.values().map(|row| row["error"].as_str()).collect();
    assert_eq!(rows.len(), 4);
    let with = |text: &str| errors.iter().filter(|error| error.contains(text)).count();
    let none = errors.iter().filter(|error| error.is_empty()).count();
    assert_eq!([none, with("cannot read the manifest"), with("motions did not finish")], [2, 1, 1], "{errors:?}");
    let page = fs::read_to_string(runs.join("fleet/fleet.html")).expect("a page");
    assert!(page.contains("4 runs, 2 of them failed"), "{page}");
    let (status, _, stderr) = said(&["fleet", "configs/smoke.toml", "configs/smoke.toml"], &runs);
    assert_eq!(status, 2, "{stderr}");
    assert!(stderr.contains("both have their results in the folder `smoke`"), "{stderr}");
}
