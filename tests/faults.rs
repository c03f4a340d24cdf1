//! What becomes of a run under faults of the machine: kills, signals, damage on the disk, full disks, a collection beside it, closed pipes.
//!
//! Here in small; `FAULTS=12 cargo test --release --test faults -- --nocapture --test-threads 1` repeats everything twelve times as often
//! and prints what was tried.

#[path = "support/small_site.rs"]
mod small_site;
#[path = "support/tree.rs"]
mod tree;

use small_site::SMALL;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, SystemTime};
use tree::files;

const SITE: &str = "configs/smoke.toml";

/// Stages whose output is computed again under faults.
const STAGES: [&str; 7] = ["motions", "simulate", "dataset", "pretrain", "distill", "calibrate", "evaluate"];

/// How many times as much is tried as in every test run.
fn times() -> usize {
    std::env::var("FAULTS").ok().and_then(|n| n.parse().ok()).unwrap_or(1)
}

/// Numbers that look drawn and are the same in every run.
struct Drawn(u64);

impl Drawn {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % n
    }
}

fn command(words: &[&str], run_dir: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flare-pipe"));
    command.current_dir(env!("CARGO_MANIFEST_DIR")).args(words).arg("--run-dir").arg(run_dir).stdin(Stdio::null());
    command
}

fn run(run_dir: &Path, more: &[&str]) -> Command {
    command(&[&["run", SITE], SMALL, more].concat(), run_dir)
}

fn said(command: &mut Command) -> (Option<i32>, String) {
    let Output { status, stderr, .. } = command.stdout(Stdio::piped()).output().expect("the program starts");
    (status.code(), String::from_utf8_lossy(&stderr).into_owned())
}

/// Runs and expects it to go well.
fn runs(run_dir: &Path, more: &[&str]) -> String {
    let (status, stderr) = said(&mut run(run_dir, more));
    assert_eq!(status, Some(0), "{more:?}: {stderr}");
    stderr
}

/// The same without what tells of the time.
fn lasting(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let tells_time = |name: &Path| name.ends_with("timing.toml") || name.ends_with("log.txt");
    // Replays serve the stage that is at work, and `gc` takes them.
    let passes =
        |name: &Path| name.components().any(|part| part.as_os_str().to_string_lossy().starts_with("replayed-"));
    let mut all = files(dir);
    all.retain(|name, _| !tells_time(name) && !passes(name));
    for (name, bytes) in &mut all {
        if name.ends_with("metrics.json") {
            let mut value: serde_json::Value = serde_json::from_slice(bytes).expect("JSON");
            value.as_object_mut().expect("an object").remove("timings_s");
            *bytes = value.to_string().into_bytes();
        }
        if name.ends_with("report.html") && name.starts_with("smoke") {
            bytes.clear(); // with times and durations; its content is that of the stage's own page
        }
    }
    all
}

/// Asserts that two folders hold the same, and names what differs.
fn assert_same(found: &BTreeMap<PathBuf, Vec<u8>>, expected: &BTreeMap<PathBuf, Vec<u8>>, after: &str) {
    let names: BTreeSet<&PathBuf> = found.keys().chain(expected.keys()).collect();
    let other: Vec<_> = names.into_iter().filter(|name| found.get(*name) != expected.get(*name)).collect();
    assert!(other.is_empty(), "after {after}: {other:?}");
}

fn copy(from: &Path, to: &Path) {
    let status = Command::new("cp").arg("-a").arg(from).arg(to).status().expect("`cp` starts");
    assert!(status.success());
}

/// A folder with everything computed, and what is in it.
fn finished() -> (tempfile::TempDir, BTreeMap<PathBuf, Vec<u8>>) {
    let dir = tempfile::tempdir().expect("a folder");
    runs(&dir.path().join("runs"), &[]);
    let expected = lasting(&dir.path().join("runs"));
    (dir, expected)
}

fn pause(drawn: &mut Drawn, most_ms: usize) {
    std::thread::sleep(Duration::from_millis(drawn.below(most_ms) as u64));
}

fn started(run_dir: &Path, more: &[&str]) -> Child {
    run(run_dir, more).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts")
}

#[test]
fn a_killed_run_loses_what_was_at_work_and_nothing_else() {
    let (place, expected) = finished();
    let runs_dir = place.path().join("killed");
    let mut drawn = Drawn(1);
    let (mut killed, mut ended) = (0, 0);
    while killed < 40 * times() {
        // What is stored is computed again, so that there is always something to kill.
        let stage = STAGES[drawn.below(STAGES.len())];
        let force = ["--force", stage];
        let mut child = started(&runs_dir, if killed < 10 { &[] } else { &force });
        pause(&mut drawn, 400);
        match child.try_wait().expect("waited for") {
            Some(status) => {
                assert!(status.success(), "{stage}");
                ended += 1;
                if killed < 10 {
                    fs::remove_dir_all(&runs_dir).expect("removable");
                }
            }
            None => {
                child.kill().expect("killed");
                child.wait().expect("waited for");
                killed += 1;
            }
        }
    }
    runs(&runs_dir, &[]);
    // What was begun for a second time and not taken up again is nobody's.
    let (status, text) = said(&mut command(&["gc", "--yes"], &runs_dir));
    assert_eq!(status, Some(0), "{text}");
    assert_same(&lasting(&runs_dir), &expected, "kills");
    println!("kills: {killed} tried, {ended} runs ended before; the folder is that of a run left alone");
}

#[test]
fn a_signal_stops_a_run_in_order() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut drawn = Drawn(2);
    let mut stopped = |name: &str, number: i32| {
        let mut child = run(dir.path(), &["--force", "all"])
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        // Not before it can hear.
        std::thread::sleep(Duration::from_millis(150));
        pause(&mut drawn, 100);
        let sent = Command::new("kill").args([format!("-{name}"), child.id().to_string()]).status();
        assert!(sent.expect("`kill` starts").success());
        let status = child.wait().expect("waited for");
        let mut text = String::new();
        child.stderr.take().expect("piped").read_to_string(&mut text).expect("readable");
        if status.success() && text.contains("report: done") {
            return false; // It had ended before it was told.
        }
        assert_eq!(status.code(), Some(128 + number), "{name}: {text}");
        assert!(text.contains("stopped; run again to go on"), "{name}: {text}");
        true
    };
    for (name, number) in [("TERM", 15), ("INT", 2), ("HUP", 1)].into_iter().cycle().take(3 * times()) {
        assert!((0..5).any(|_| stopped(name, number)), "{name} stops nothing");
    }
    println!("signals: {} tried", 3 * times());
}

/// What may happen to a file.
const DAMAGES: [&str; 5] = ["flipped", "cut", "emptied", "deleted", "swapped"];

/// Damages `path`; false where there is nothing to swap it with, or it would be as before.
fn damage(path: &Path, how: &str, drawn: &mut Drawn) -> bool {
    let before = fs::read(path).expect("readable");
    match how {
        "flipped" if before.is_empty() => return false,
        "flipped" => {
            let mut bytes = before.clone();
            let at = drawn.below(bytes.len());
            bytes[at] ^= 1 << drawn.below(8);
            fs::write(path, bytes).expect("writable");
        }
        "cut" => fs::write(path, &before[..before.len() / 2]).expect("writable"),
        "emptied" => fs::write(path, "").expect("writable"),
        "deleted" => fs::remove_file(path).expect("removable"),
        _ => {
            let own = path.parent().expect("in an entry");
            let others = fs::read_dir(own.parent().expect("in a kind")).expect("a folder");
            let name = path.file_name().expect("a name");
            let others = others.map(|entry| entry.expect("an entry").path()).filter(|other| other != own);
            let Some(other) = others.map(|other| other.join(name)).find(|other| other.is_file()) else { return false };
            fs::copy(other, path).expect("copied");
        }
    }
    fs::read(path).ok().is_none_or(|after| after != before)
}

/// The stage that reads what a kind of entry holds, and is computed again after damage.
fn reader(kind: &str) -> Option<&'static str> {
    Some(match kind.rsplit_once("-v").expect("a version").0 {
        "motions" => "simulate",
        "simulate" | "trajectory" => "dataset",
        "dataset" | "pretrain" => "distill",
        "records" | "replayed" => "replay",
        "distill" => "calibrate",
        "replay" | "calibrate" => "evaluate",
        "evaluate" => "report",
        _ => return None,
    })
}

/// One file of each kind of entry and name.
fn kinds(cache: &Path) -> Vec<(String, PathBuf)> {
    let mut found: BTreeMap<(String, String), PathBuf> = BTreeMap::new();
    for name in files(cache).into_keys() {
        let parts: Vec<String> = name.iter().map(|part| part.to_string_lossy().into_owned()).collect();
        if let [kind, _, inside @ ..] = parts.as_slice()
            && !name.ends_with("timing.toml")
        {
            // Of the many records and replays of one entry one will do.
            let ending = inside.last().map_or("", |file| file.rsplit('.').next().unwrap_or(file));
            let file = if ending == "csv" && inside.last().is_some_and(|f| f.starts_with('E')) { "E.csv" } else { "" };
            let file = if file.is_empty() { inside.join("/") } else { file.to_string() };
            found.entry((kind.clone(), file)).or_insert(name);
        }
    }
    found.into_iter().map(|((kind, _), name)| (kind, name)).collect()
}

#[test]
fn damaged_files_are_used_by_nobody_and_are_mended() {
    let (place, expected) = finished();
    let original = place.path().join("runs");
    let mut drawn = Drawn(3);
    let (mut tried, mut mended) = (0, 0);
    for (number, (kind, name)) in kinds(&original.join("cache")).into_iter().enumerate() {
        for (i, how) in DAMAGES.into_iter().enumerate() {
            // In every test run each kind in one way, all ways in turn.
            if times() == 1 && i != number % DAMAGES.len() {
                continue;
            }
            let runs_dir = place.path().join("damaged");
            copy(&original, &runs_dir);
            let path = runs_dir.join("cache").join(&name);
            if !damage(&path, how, &mut drawn) {
                fs::remove_dir_all(&runs_dir).expect("removable");
                continue;
            }
            tried += 1;
            let what = format!("{} {how}", name.display());
            let more: Vec<&str> = reader(&kind).iter().flat_map(|stage| ["--until", stage, "--force", stage]).collect();
            runs(&runs_dir, &more);
            let found = lasting(&runs_dir);
            if found == expected {
                mended += 1;
            } else {
                // Nobody read it: everything else is as it was, and it is found by whoever looks.
                let others = |all: &BTreeMap<PathBuf, Vec<u8>>| {
                    let own = Path::new("cache").join(&name);
                    all.iter().filter(|(n, _)| **n != own).map(|(n, b)| (n.clone(), b.clone())).collect()
                };
                assert_same(&others(&found), &others(&expected), &what);
                let (status, text) = said(&mut command(&[&["verify", SITE], SMALL].concat(), &runs_dir));
                assert_eq!(status, Some(1), "{what}: {text}");
                let (status, text) = said(&mut command(&[&["verify", SITE], SMALL, &["--repair"]].concat(), &runs_dir));
                assert_eq!(status, Some(0), "{what}: {text}");
                assert_same(&lasting(&runs_dir), &expected, &what);
            }
            fs::remove_dir_all(&runs_dir).expect("removable");
        }
    }
    println!("damage: {tried} tried, {mended} mended by who reads it, the others found and mended by `verify`, 0 used");
    assert!(tried > 25);
}

#[test]
fn a_clock_that_jumps_makes_nothing_old() {
    let (dir, expected) = finished();
    let runs_dir = dir.path().join("runs");
    let years = |n: u64| Duration::from_secs(n * 365 * 86_400);
    for jump in [SystemTime::UNIX_EPOCH + years(1), SystemTime::now() + years(100)] {
        for name in files(&runs_dir).keys() {
            let path = runs_dir.join(name);
            fs::File::options().append(true).open(&path).and_then(|f| f.set_modified(jump)).expect("a time is set");
            if name.ends_with("timing.toml") {
                let text = fs::read_to_string(&path).expect("readable");
                let since = jump.duration_since(SystemTime::UNIX_EPOCH).expect("after it").as_secs();
                let of = |line: &str| match line.starts_with("done_unix_s") {
                    true => format!("done_unix_s = {since}"),
                    false => line.to_string(),
                };
                fs::write(&path, text.lines().map(of).collect::<Vec<_>>().join("\n")).expect("writable");
            }
        }
        let told = run(&runs_dir, &["--json"]).stderr(Stdio::null()).output().expect("the program starts");
        let told: serde_json::Value = serde_json::from_slice(&told.stdout).expect("JSON");
        assert!(told["computed"].as_array().expect("a list").is_empty(), "{told}");
        // What a site uses is kept, however old it is.
        let words = [[&["status", SITE], SMALL].concat(), vec!["gc", "--yes", "--older-than", "1"]];
        for words in &words {
            let (status, text) = said(&mut command(words, &runs_dir));
            assert_eq!(status, Some(0), "{text}");
        }
        assert_same(&lasting(&runs_dir), &expected, "a clock that jumped");
    }
}

#[test]
fn a_full_disk_is_told_and_becomes_nothing_else() {
    let (place, expected) = finished();
    let bytes: usize = files(&place.path().join("runs")).values().map(Vec::len).sum();
    let disk = place.path().join("disk");
    fs::create_dir(&disk).expect("made");
    let mount = |options: &str| {
        let words = ["-t", "tmpfs", "-o", options, "tmpfs"];
        Command::new("mount").args(words).arg(&disk).stderr(Stdio::null()).status().is_ok_and(|s| s.success())
    };
    let (mut told, mut fitted) = (0, 0);
    let n = 10 * times();
    for i in 0..n {
        let size_kib = bytes / 1024 * (2 + i) / n;
        if !mount(&format!("size={size_kib}k")) {
            eprintln!("skipped: nothing can be mounted here");
            return;
        }
        let runs_dir = disk.join("runs");
        let (status, text) = said(&mut run(&runs_dir, &[]));
        if status == Some(0) {
            assert_same(&lasting(&runs_dir), &expected, &format!("a disk of {size_kib} KiB"));
            fitted += 1;
        } else {
            assert_eq!(status, Some(1), "{size_kib} KiB: {text}");
            assert!(text.contains("No space left on device"), "{size_kib} KiB: {text}");
            told += 1;
            assert!(mount("remount,size=1g"));
            runs(&runs_dir, &[]);
            assert_same(&lasting(&runs_dir), &expected, &format!("a disk of {size_kib} KiB and room again"));
        }
        let status = Command::new("umount").arg(&disk).status().expect("`umount` starts");
        assert!(status.success());
    }
    println!("full disks: {n} sizes, {told} told and mended once there was room, {fitted} fitted, 0 silent");
    assert!(told > 0);
}

#[test]
fn a_collection_takes_nothing_from_a_run() {
    let (place, expected) = finished();
    let mut drawn = Drawn(5);
    let (mut collected, mut refused) = (0, 0);
    for number in 0..4 * times() {
        let runs_dir = place.path().join(format!("collected-{number}"));
        let mut child = started(&runs_dir, &[]);
        while child.try_wait().expect("waited for").is_none() {
            pause(&mut drawn, 100);
            if !runs_dir.join("cache").is_dir() {
                continue;
            }
            let (status, text) = said(&mut command(&["gc", "--yes"], &runs_dir));
            collected += 1;
            if status != Some(0) {
                assert!(status == Some(1) && text.contains("a run is at work"), "{status:?}: {text}");
                refused += 1;
            }
        }
        assert!(child.wait().expect("waited for").success());
        runs(&runs_dir, &[]);
        assert_same(&lasting(&runs_dir), &expected, "collections");
        fs::remove_dir_all(&runs_dir).expect("removable");
    }
    println!("collections beside a run: {collected} tried, {refused} refused, 0 runs failed");
}

/// A column that no motion gets through.
const UNSOLVABLE: [&str; 6] = [
    "--set",
    "analysis.max_iterations=2",
    "--set",
    "analysis.min_step_s=0.001",
    "--set",
    "analysis.tolerance=0.000000000001",
];

#[test]
fn a_run_that_fails_leaves_no_page_of_another_unmarked() {
    let (place, expected) = finished();
    let runs_dir = place.path().join("runs");
    let (status, text) = said(&mut run(&runs_dir, &UNSOLVABLE));
    assert_eq!(status, Some(1), "{text}");
    assert!(text.contains("motion 001 did not finish"), "told without being asked: {text}");
    assert!(text.contains("`report.html` of an earlier run moved to `earlier`"), "{text}");
    for name in ["report.html", "metrics.json"] {
        let site = runs_dir.join("smoke");
        assert!(!site.join(name).exists() && site.join("earlier").join(name).is_file(), "{name}");
    }
    runs(&runs_dir, &[]);
    // The records of the other column are stored besides, and this run remembers those of its own.
    let own: BTreeMap<_, _> = lasting(&runs_dir).into_iter().filter(|(name, _)| expected.contains_key(name)).collect();
    assert_same(&own, &expected, "a run that failed");
    assert!(!runs_dir.join("smoke/earlier").exists());
}

#[test]
fn messages_that_nobody_takes_stop_nothing() {
    let dir = tempfile::tempdir().expect("a folder");
    let runs_dir = dir.path().join("runs");
    let mut child = run(&runs_dir, &["-v"]).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("starts");
    drop(child.stderr.take());
    assert_eq!(child.wait().expect("waited for").code(), Some(0), "nobody reads its messages");
    let full = || fs::OpenOptions::new().write(true).open("/dev/full").expect("a device that is always full");
    let status = run(&runs_dir, &["--force", "report"]).stderr(full()).stdout(Stdio::null()).status();
    assert_eq!(status.expect("starts").code(), Some(0), "its messages cannot be written");
    let status = run(&runs_dir, &["--json"]).stdout(full()).stderr(Stdio::null()).status();
    assert_eq!(status.expect("starts").code(), Some(1), "its data cannot be written");
    for words in [&["status"][..], &["plan"], &["verify"]] {
        let mut child = command(&[words, &[SITE], SMALL].concat(), &runs_dir)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("starts");
        drop(child.stdout.take());
        let status = child.wait().expect("waited for").code();
        assert!(matches!(status, Some(0 | 1)), "{words:?}: {status:?}");
    }
}
