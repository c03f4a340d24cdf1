//! Tests of whole runs on toy stages: what is computed, why, and what is left on the disk.

use super::lock::{Agreement, Lease};
use super::*;
use crate::error::{Error, Result};
use crate::progress::Quiet;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::SystemTime;

const CHAIN: &str = "about = 'x'
[[stage]]
name = 'number'
[[stage]]
name = 'fit'
kind = 'join'
inputs = { in = 'number' }
each = 'components'
[[stage]]
name = 'ensemble'
[[stage]]
name = 'all'
kind = 'join'
inputs = { in = 'fit', more = 'ensemble' }
";

const MANIFEST: &str =
    "components = ['EW', 'NS']\nnumber = { value = 1 }\njoin = { prefix = 'a' }\nensemble = { count = 4 }\n";

/// A run directory and a log of what was computed in it.
struct Place {
    dir: tempfile::TempDir,
    pipeline: String,
}

impl Place {
    fn new(pipeline: &str) -> Self {
        Self { dir: tempfile::tempdir().expect("a temporary folder"), pipeline: pipeline.into() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn with<T>(&self, manifest: &str, work: impl FnOnce(&Site<'_>, &Graph) -> Result<T>) -> Result<T> {
        let mut manifest: toml::Table = toml::from_str(manifest).expect("the text is TOML");
        manifest.insert("log".into(), self.path("log").display().to_string().into());
        let graph = Graph::new(&Recipe::parse(&self.pipeline, "p.toml")?, toy::STAGES, &manifest)?;
        let run_dir = self.path("runs");
        work(&Site { name: "toy", manifest: &manifest, manifest_dir: self.dir.path(), run_dir: &run_dir }, &graph)
    }

    fn status(&self, manifest: &str) -> Vec<StageStatus> {
        self.with(manifest, |site, graph| Ok(Results::of(site, graph)?.status())).expect("readable")
    }

    fn run(&self, manifest: &str, options: &Options) -> Result<Summary> {
        self.with(manifest, |site, graph| run(site, graph, options, Mode::Run, &Quiet))
    }

    fn plan(&self, manifest: &str, options: &Options) -> Result<Vec<String>> {
        let summary = self.with(manifest, |site, graph| run(site, graph, options, Mode::Plan, &Quiet))?;
        let line = |d: &Decision| format!("{} {:?} {}", d.stage, d.action, d.reason()).trim().to_string();
        Ok(summary.decisions.iter().map(line).collect())
    }

    /// What was computed since the last look, sorted.
    fn computed(&self) -> Vec<String> {
        let text = fs::read_to_string(self.path("log")).unwrap_or_default();
        let _ = fs::remove_file(self.path("log"));
        let mut lines: Vec<String> = text.lines().map(String::from).collect();
        lines.sort();
        lines
    }

    /// Every file of the run directory with content and time of writing.
    fn files(&self) -> BTreeMap<String, (Vec<u8>, SystemTime)> {
        let runs = self.path("runs");
        let read = |name: String| {
            let path = runs.join(&name);
            let written = fs::metadata(&path).and_then(|m| m.modified()).expect("readable");
            (name, (fs::read(&path).expect("readable"), written))
        };
        files::list(&runs).expect("readable").into_iter().map(read).collect()
    }

    /// Bytes of every file but timings, for comparison between run directories.
    fn bytes(&self) -> BTreeMap<String, Vec<u8>> {
        let is_same = |name: &String| !name.ends_with("timing.toml");
        self.files().into_iter().filter(|(name, _)| is_same(name)).map(|(name, (bytes, _))| (name, bytes)).collect()
    }
}

fn only(stage: &str) -> Options {
    Options { only: vec![stage.into()], ..Options::default() }
}

fn force(stage: &str) -> Options {
    Options { force: vec![stage.into()], ..Options::default() }
}

#[test]
fn a_second_run_computes_nothing_and_writes_no_file() {
    let place = Place::new(CHAIN);
    let first = place.run(MANIFEST, &Options::default()).expect("runs");
    assert_eq!(first.computed.len(), 5);
    assert_eq!(place.computed(), ["all", "fit.EW", "fit.NS", "item 0", "item 1", "item 2", "item 3", "number"]);
    assert_eq!(fs::read_to_string(place.path("runs/toy/value.txt")).expect("published"), "a(EW:a(:1))(NS:a(:1))");
    assert!(place.path("runs/toy/value.EW.txt").is_file());
    let before = place.files();
    assert!(before.keys().all(|name| !name.contains(".lock") && !name.contains(".checkpoint")), "{:?}", before.keys());
    let second = place.run(MANIFEST, &Options::default()).expect("runs");
    assert!(second.computed.is_empty() && second.decisions.iter().all(|d| d.action == Action::Cached));
    assert_eq!(place.files(), before);
    assert!(place.computed().is_empty());
}

#[test]
fn an_edit_reruns_what_reads_it_and_says_what_changed() {
    let place = Place::new(CHAIN);
    place.run(MANIFEST, &Options::default()).expect("runs");
    place.computed();
    let edited = MANIFEST.replace("prefix = 'a'", "prefix = 'b'");
    assert_eq!(
        place.plan(&edited, &Options::default()).expect("plans"),
        [
            "number Cached",
            "fit.EW Run `join.prefix`: \"a\" → \"b\"",
            "fit.NS Run `join.prefix`: \"a\" → \"b\"",
            "ensemble Cached",
            "all Run `join.prefix`: \"a\" → \"b\"; input `in.EW` changed; input `in.NS` changed",
        ]
    );
    assert!(place.computed().is_empty());
    place.run(&edited, &Options::default()).expect("runs");
    assert_eq!(place.computed(), ["all", "fit.EW", "fit.NS"]);
    // Back again: everything is still there, and the published file follows.
    place.run(MANIFEST, &Options::default()).expect("runs");
    assert!(place.computed().is_empty());
    assert!(fs::read_to_string(place.path("runs/toy/value.txt")).expect("published").starts_with('a'));
}

#[test]
fn an_edit_nobody_reads_and_another_place_of_the_log_rerun_nothing() {
    let place = Place::new(CHAIN);
    place.run(MANIFEST, &Options::default()).expect("runs");
    place.computed();
    place.run(&format!("{MANIFEST}unrelated = 3\n"), &Options { jobs: 1, ..Options::default() }).expect("runs");
    assert!(place.computed().is_empty());
}

#[test]
fn one_thread_or_eight_give_the_same_bytes() {
    let places = [1, 8].map(|jobs| {
        let place = Place::new(CHAIN);
        place.run(MANIFEST, &Options { jobs, ..Options::default() }).expect("runs");
        place.bytes()
    });
    assert_eq!(places[0], places[1]);
}

#[test]
fn a_failure_stops_what_depends_on_it_and_the_rest_finishes() {
    let place = Place::new(CHAIN);
    let summary = place.run(&MANIFEST.replace("value = 1", "value = -3"), &Options::default()).expect("runs");
    assert_eq!(summary.computed, ["ensemble"]);
    assert_eq!(summary.skipped, ["fit.EW", "fit.NS", "all"]);
    let text = summary.failures[0].error.to_string();
    assert_eq!(text, "`number.value` must not be negative, got -3\n  in stage `number`");
    let defect = place.run(&MANIFEST.replace("value = 1", "value = 13"), &Options::default()).expect("runs");
    assert!(defect.failures[0].error.to_string().contains("thirteen"));
    assert!(place.files().keys().all(|name| !name.contains(".partial") && !name.contains(".lock")));
}

#[test]
fn broken_items_are_recorded_and_a_grown_ensemble_computes_what_is_new() {
    let place = Place::new("about = 'x'\n[[stage]]\nname = 'ensemble'\n");
    place.run("ensemble = { count = 3, broken = [1] }", &Options::default()).expect("runs");
    assert_eq!(place.computed(), ["item 0", "item 1", "item 2"]);
    let entry = place
        .with("ensemble = { count = 3, broken = [1] }", |site, graph| Results::of(site, graph)?.output("ensemble"))
        .expect("stored");
    assert_eq!(fs::read_to_string(entry.join("value")).expect("written"), "2 of 3");
    let items = Outputs::read(&entry).expect("readable").items;
    assert_eq!(items.iter().map(|i| i.id.as_str()).collect::<Vec<_>>(), ["001", "002", "003"]);
    assert_eq!(items[1].failure.as_deref(), Some("item 1 is broken"));
    place.run("ensemble = { count = 5 }", &Options::default()).expect("runs");
    assert_eq!(place.computed(), ["item 1", "item 3", "item 4"]);
}

#[test]
fn an_item_that_the_machine_failed_fails_its_stage_and_is_recorded_nowhere() {
    let place = Place::new("about = 'x'\n[[stage]]\nname = 'ensemble'\n");
    let one = Options { jobs: 1, ..Options::default() };
    let summary = place.run("ensemble = { count = 5, broken = [0], defect = 2 }", &one).expect("runs");
    assert_eq!(summary.failures[0].error.what(), "no space left");
    assert_eq!(place.computed(), ["item 0", "item 1", "item 2"]);
    assert!(place.files().keys().all(|name| !name.contains("/ensemble-v1/")));
    place.run("ensemble = { count = 5, broken = [0] }", &one).expect("runs");
    assert_eq!(place.computed(), ["item 0", "item 2", "item 3", "item 4"]);
}

/// Makes another byte of the last one of a file, as a failing disk might.
fn flip(path: &Path) {
    let mut bytes = fs::read(path).expect("readable");
    *bytes.last_mut().expect("a byte") ^= 1;
    fs::write(path, bytes).expect("writable");
}

#[test]
fn what_a_stage_reads_is_as_it_was_written_or_is_computed_again() {
    let place = Place::new(CHAIN);
    place.run(MANIFEST, &Options::default()).expect("runs");
    let runs = place.path("runs");
    let edited = MANIFEST.replace("prefix = 'a'", "prefix = 'b'");
    place.run(&edited, &Options::default()).expect("runs");
    let right = place.bytes();
    place.computed();
    let flipped = runs.join(published_entry(&place, "number")).join("value");
    for (damaged, name) in [(flipped, "value"), (runs.join(published_entry(&place, "number")).join("outputs.toml"), "")]
    {
        if name.is_empty() {
            fs::write(&damaged, "").expect("writable")
        } else {
            flip(&damaged)
        }
        fs::remove_dir_all(runs.join(published_entry(&place, "fit.NS"))).expect("removable");
        place.run(&edited, &Options::default()).expect("runs");
        assert_eq!(place.computed(), ["fit.NS", "number"]);
        assert_eq!(place.bytes(), right);
    }
    let shown = || place.with(&edited, |site, graph| Results::of(site, graph)?.output("number"));
    flip(&runs.join(published_entry(&place, "number")).join("value"));
    let refused = shown().expect_err("other content").to_string();
    assert!(refused.contains("the output of `number` is damaged: `value` has other content"), "{refused}");
}

#[test]
fn what_is_published_is_as_it_was_written_or_is_computed_again() {
    let place = Place::new(CHAIN);
    place.run(MANIFEST, &Options::default()).expect("runs");
    let right = place.bytes();
    place.computed();
    flip(&place.path("runs").join(published_entry(&place, "all")).join("value.txt"));
    flip(&place.path("runs/toy/value.txt"));
    place.run(MANIFEST, &Options::default()).expect("runs");
    assert_eq!(place.computed(), ["all"]);
    assert_eq!(place.bytes(), right);
}

#[test]
fn what_an_earlier_run_published_is_set_aside_by_one_that_fails() {
    let place = Place::new(CHAIN);
    place.run(MANIFEST, &Options::default()).expect("runs");
    let before = fs::read(place.path("runs/toy/value.txt")).expect("published");
    place.run(&MANIFEST.replace("value = 1", "value = -3"), &Options::default()).expect("runs");
    assert!(!place.path("runs/toy/value.txt").exists());
    assert_eq!(fs::read(place.path("runs/toy/earlier/value.txt")).expect("moved"), before);
    place.run(MANIFEST, &Options::default()).expect("runs");
    assert_eq!(fs::read(place.path("runs/toy/value.txt")).expect("published"), before);
    assert!(!place.path("runs/toy/earlier").exists());
}

#[test]
fn two_runs_of_one_site_with_other_settings_are_not_at_work_together() {
    let place = Place::new(CHAIN);
    let other = MANIFEST.replace("value = 1", "value = 2");
    place
        .with(MANIFEST, |site, graph| {
            let (path, settings) = site.settings(graph)?;
            let share = Agreement::on(&path, &settings)?;
            let refused = place.run(&other, &Options::default()).expect_err("another is at work").to_string();
            assert!(refused.contains("a run of site `toy` with other settings is at work"), "{refused}");
            place.run(MANIFEST, &Options::default())?;
            drop(share);
            place.run(&other, &Options::default()).map(|_| ())
        })
        .expect("runs");
}

#[test]
fn an_ensemble_takes_no_item_that_is_not_as_it_was_written() {
    let place = Place::new("about = 'x'\n[[stage]]\nname = 'ensemble'\n");
    place.run("ensemble = { count = 3 }", &Options::default()).expect("runs");
    place.computed();
    let item = place.bytes().into_keys().find(|n| n.contains("toy-item-v1") && n.ends_with("number")).expect("an item");
    flip(&place.path("runs").join(item));
    place.run("ensemble = { count = 4 }", &Options::default()).expect("runs");
    assert_eq!(place.computed().len(), 2);
}

#[test]
fn a_damaged_item_is_computed_again_and_nothing_else_but_its_ensemble() {
    let place = Place::new(CHAIN);
    place.run(MANIFEST, &Options::default()).expect("runs");
    place.computed();
    let before = place.bytes();
    let item = before.keys().find(|n| n.contains("toy-item-v1") && n.ends_with("number")).expect("an item").clone();
    fs::write(place.path("runs").join(&item), "").expect("writable");
    let warnings = Warnings::default();
    let summary = place.with(MANIFEST, |site, graph| run(site, graph, &Options::default(), Mode::Run, &warnings));
    assert_eq!(summary.expect("runs").computed, ["ensemble"]);
    assert_eq!(place.computed().len(), 1);
    assert_eq!(place.bytes(), before);
    let said = warnings.0.into_inner().expect("whole");
    assert!(said.len() == 1 && said[0].contains("0 bytes instead of 1; it is computed again"), "{said:?}");
}

#[derive(Default)]
struct Warnings(Mutex<Vec<String>>);

impl Reporter for Warnings {
    fn event(&self, event: &Event<'_>) {
        if let (Event::Warning { text, .. }, Ok(mut said)) = (event, self.0.lock()) {
            said.push((*text).to_string());
        }
    }
}

#[test]
fn only_from_until_and_force_choose_stages() {
    let place = Place::new(CHAIN);
    let error = place.run(MANIFEST, &only("all")).expect_err("nothing is stored");
    assert_eq!(error.exit_status(), 2);
    assert_eq!(
        error.to_string(),
        "stage `all` needs the output of `fit.EW`, `fit.NS`, `ensemble`, which is not in the cache\n\n\
         hint: `flare-pipe run` with `--until all` computes everything it needs"
    );
    place.run(MANIFEST, &Options { until: Some("fit.EW".into()), ..Options::default() }).expect("runs");
    assert_eq!(place.computed(), ["fit.EW", "number"]);
    place.run(MANIFEST, &only("fit")).expect("runs");
    assert_eq!(place.computed(), ["fit.NS"]);
    let from_fit = Options { from: Some("fit".into()), ..Options::default() };
    assert!(place.run(MANIFEST, &from_fit).is_err(), "`ensemble` is neither stored nor asked for");
    place.run(MANIFEST, &Options::default()).expect("runs");
    place.computed();
    place.run(MANIFEST, &from_fit).expect("runs");
    assert!(place.computed().is_empty());
    let before = place.files();
    place.run(MANIFEST, &force("fit.NS")).expect("runs");
    assert_eq!(place.computed(), ["fit.NS"]);
    place.run(MANIFEST, &force("all")).expect("runs");
    assert_eq!(place.computed().len(), 8);
    assert_eq!(place.files(), before, "the same bytes are not written again");
    assert_eq!(place.plan(MANIFEST, &force("number")).expect("plans")[0], "number Run forced");
    for (options, text) in [
        (only("fti"), "has no stage `fti`"),
        (Options { force: vec!["number".into()], ..only("all") }, "not among those asked for"),
        (Options { from: Some("all".into()), ..only("number") }, "none in common"),
    ] {
        let error = place.run(MANIFEST, &options).expect_err("a mistake");
        assert!(error.to_string().contains(text) && error.exit_status() == 2, "{error}");
    }
}

#[test]
fn an_outside_file_counts_by_content_and_not_by_place() {
    let place = Place::new("about = 'x'\n[[stage]]\nname = 'file'\n");
    for (name, text) in [("a.csv", "1"), ("b.csv", "1"), ("c.csv", "2")] {
        fs::write(place.path(name), text).expect("writable");
    }
    let at = |name: &str| format!("file = {{ path = '{name}' }}");
    place.run(&at("a.csv"), &Options::default()).expect("runs");
    assert_eq!(place.computed(), ["file"]);
    assert_eq!(place.plan(&at("b.csv"), &Options::default()).expect("plans"), ["file Cached"]);
    assert_eq!(
        place.plan(&at("c.csv"), &Options::default()).expect("plans"),
        ["file Run outside files changed (`c.csv`)"]
    );
    let error = place.run(&at("absent.csv"), &Options::default()).expect_err("no such file");
    assert!(error.to_string().contains("absent.csv") && error.to_string().contains("in stage `file`"), "{error}");
}

#[test]
fn what_was_made_from_an_outside_file_outlives_it() {
    let place =
        Place::new("about = 'x'\n[[stage]]\nname = 'file'\n[[stage]]\nname = 'join'\ninputs = { in = 'file' }\n");
    fs::write(place.path("a.csv"), "1").expect("writable");
    let manifest = "file = { path = 'a.csv' }";
    place.run(manifest, &Options::default()).expect("runs");
    place.computed();
    fs::remove_file(place.path("a.csv")).expect("removable");
    let edited = format!("{manifest}\njoin = {{ prefix = 'b' }}");
    assert_eq!(
        place.plan(&edited, &Options::default()).expect("plans"),
        ["file Cached `a.csv` is gone; what was made from it is kept", "join Run `join.prefix` is new: \"b\""]
    );
    place.run(&edited, &Options::default()).expect("runs");
    assert_eq!(place.computed(), ["join"]);
    assert_eq!(place.status(&edited)[0].state, "cached");
    // Nothing stands in for a file of another name, nor once the output is to be computed again.
    let error = place.run("file = { path = 'b.csv' }", &Options::default()).expect_err("no such file");
    assert!(error.to_string().contains("b.csv"), "{error}");
    assert_eq!(place.run(manifest, &force("file")).expect("runs").failures.len(), 1);
}

const LOOP: &str = "about = 'x'
[[stage]]
name = 'before'
kind = 'number'
[[stage]]
name = 'correct'
kind = 'manifest'
[[stage]]
name = 'after'
kind = 'number'
manifest = 'correct'
[[stage]]
name = 'both'
kind = 'join'
inputs = { in = 'before', after = 'after' }
";

#[test]
fn a_second_pass_takes_its_parameters_from_a_manifest_that_a_stage_wrote() {
    let place = Place::new(LOOP);
    let manifest = "number = { value = 1 }\ncorrected = { value = 2 }";
    let plan = place.plan(manifest, &Options::default()).expect("plans");
    assert_eq!(plan[2..], ["after Wait decided when `correct` is done", "both Wait decided when `after` is done"]);
    let summary = place.run(manifest, &Options { jobs: 1, ..Options::default() }).expect("runs");
    assert_eq!(summary.computed, ["before", "correct", "after", "both"]);
    assert_eq!(place.computed(), ["after", "before", "both"]);
    let value = |stage| {
        place.with(manifest, |site, graph| Ok(fs::read(Results::of(site, graph)?.output(stage)?.join("value"))))
    };
    assert_eq!(value("after").expect("stored").expect("written"), b"2");
    assert!(place.plan(manifest, &Options::default()).expect("plans").iter().all(|line| line.ends_with("Cached")));
    // Nothing to correct: the second pass is the first.
    let summary = place.run("number = { value = 3 }", &Options { jobs: 1, ..Options::default() }).expect("runs");
    assert_eq!(summary.computed, ["before", "correct", "both"]);
}

#[test]
fn a_published_file_of_an_earlier_output_does_not_stay() {
    let place =
        Place::new("about = 'x'\n[[stage]]\nname = 'number'\n[[stage]]\nname = 'join'\ninputs = { in = 'number' }\n");
    place.run("number = { value = 1 }\njoin = { has_extra = true }", &Options::default()).expect("runs");
    assert!(place.path("runs/toy/extra.txt").is_file());
    place.run("number = { value = 1 }\njoin = { has_extra = false }", &Options::default()).expect("runs");
    assert!(!place.path("runs/toy/extra.txt").exists());
}

#[test]
fn status_tells_state_time_and_size() {
    let place = Place::new(CHAIN);
    let states = |manifest: &str| {
        let list = place.status(manifest);
        list.into_iter().map(|s| (s.stage, s.state, s.bytes)).collect::<Vec<_>>()
    };
    assert!(states(MANIFEST).iter().all(|(_, state, bytes)| *state != "cached" && bytes.is_none()));
    assert!(!place.path("runs").exists(), "looking makes nothing");
    place.run(MANIFEST, &Options::default()).expect("runs");
    let ensemble = &states(MANIFEST)[3];
    assert_eq!(*ensemble, ("ensemble".to_string(), "cached", Some(10)));
    fs::write(place.path("runs").join(published_entry(&place, "number")).join("value"), "long").expect("writable");
    assert_eq!(states(MANIFEST)[0].1, "damaged");
    assert_eq!(states(&MANIFEST.replace("count = 4", "count = 3"))[3].1, "outdated");
    let json = serde_json::to_value(place.status(MANIFEST)).expect("serialisable");
    assert_eq!(json[0]["reasons"][0], "output damaged: `value` has 4 bytes instead of 1");
}

fn published_entry(place: &Place, stage: &str) -> PathBuf {
    let text = fs::read_to_string(place.path("runs/toy/last.toml")).expect("written");
    let last: BTreeMap<String, String> = toml::from_str(&text).expect("readable");
    Path::new("cache").join(&last[stage])
}

#[test]
fn collection_removes_what_no_site_used_last_and_only_that() {
    let place = Place::new(CHAIN);
    place.run(MANIFEST, &Options::default()).expect("runs");
    let shorter = MANIFEST.replace("count = 4", "count = 2");
    place.run(&shorter, &Options::default()).expect("runs");
    let runs = place.path("runs");
    let listed = unused(&runs, &[]).expect("readable");
    // Of the longer ensemble: itself, what joined it, and two items.
    assert_eq!(listed.len(), 4, "{listed:?}");
    // What a manifest still leads to stays, with what it was made from.
    let joined = listed.iter().find(|u| u.entry.folder.starts_with("join")).expect("listed").entry.clone();
    let folder = joined.folder.clone();
    assert!(unused(&runs, &[joined]).expect("readable").is_empty());
    let share = Lease::shared(&runs.join("cache/lease"), || {}).expect("locked");
    let refused = remove(&runs, &[], &listed).expect_err("a run is at work").to_string();
    assert!(refused.contains("a run is at work"), "{refused}");
    drop(share);
    let left = [runs.join("toy"), runs.join("cache").join(&folder)].map(|dir| dir.join(".writing-of-a-killed-run"));
    left.iter().for_each(|path| fs::write(path, "ha").expect("writable"));
    remove(&runs, &[], &listed).expect("writable");
    assert!(left.iter().all(|path| !path.exists()));
    assert!(unused(&runs, &[]).expect("readable").is_empty());
    place.computed();
    place.run(&shorter, &Options::default()).expect("runs");
    assert!(place.computed().is_empty());
    assert_eq!(place.plan(MANIFEST, &Options::default()).expect("plans")[3], "ensemble Run `ensemble.count`: 2 → 4");
    fs::write(runs.join("toy/last.toml"), "what? =").expect("writable");
    let refused = unused(&runs, &[]).expect_err("nobody knows what is used").to_string();
    assert!(refused.contains("last.toml"), "{refused}");
}

#[test]
fn two_runs_at_once_compute_each_entry_once() {
    let place = Place::new(CHAIN);
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| place.run(MANIFEST, &Options::default()).expect("runs"));
        }
    });
    assert_eq!(place.computed().len(), 8);
}

#[test]
fn the_folder_of_the_cache_is_no_name_for_a_site() {
    let place = Place::new(CHAIN);
    let result = place.with(MANIFEST, |site, graph| {
        run(&Site { name: "cache", ..*site }, graph, &Options::default(), Mode::Plan, &Quiet)
    });
    assert_eq!(result.map(|_| ()).map_err(|e: Error| e.exit_status()), Err(2));
}
