//! Killed and concurrent runs, in real processes: the test program starts itself again as the process that runs the pipeline.

use flare_pipe::error::{Context, Result};
use flare_pipe::pipeline::{Graph, Item, ItemKind, Mode, Options, Recipe, Site, Stage, Task, run, write_if_changed};
use flare_pipe::progress::Quiet;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const N_ITEM: usize = 12;
const N_STEP: usize = 8;

const RUN_DIR: &str = "FLARE_PIPE_TEST_RUN_DIR";
const LOG: &str = "FLARE_PIPE_TEST_LOG";
const STALL_KIND: &str = "FLARE_PIPE_TEST_STALL_KIND";
const STALL_FROM: &str = "FLARE_PIPE_TEST_STALL_FROM";

const PIPELINE: &str = "about = 'an ensemble and a training that reads it'
[[stage]]
name = 'ensemble'
[[stage]]
name = 'training'
inputs = { squares = 'ensemble' }
";

/// Tells the parent process that a piece of work begins; hangs from the piece on at which it is to be killed.
fn work(kind: &str, number: usize) -> Result<()> {
    let log = std::env::var(LOG).context(|| "no log".into())?;
    let file = fs::OpenOptions::new().create(true).append(true).open(log);
    file.and_then(|mut f| f.write_all(format!("{kind} {number}\n").as_bytes())).context(|| "cannot tell".into())?;
    let stalls_from = std::env::var(STALL_FROM).ok().and_then(|n| n.parse::<usize>().ok());
    while std::env::var(STALL_KIND).as_deref() == Ok(kind) && stalls_from.is_some_and(|n| number >= n) {
        std::thread::sleep(Duration::from_secs(1));
    }
    Ok(())
}

/// Squares, one an item.
struct Ensemble;

impl Stage for Ensemble {
    fn kind(&self) -> &'static str {
        "ensemble"
    }
    fn about(&self) -> &'static str {
        "squares"
    }
    fn version(&self) -> u32 {
        1
    }
    fn reads(&self) -> &'static [&'static str] {
        &[]
    }
    fn hands_on_items(&self) -> bool {
        true
    }
    fn run(&self, task: &Task<'_>) -> Result<()> {
        let item = |number: usize| Item {
            id: format!("{number:03}"),
            parameters: toml::Table::from_iter([("number".to_string(), toml::Value::Integer(number as i64))]),
        };
        let items: Vec<Item> = (1..=N_ITEM).map(item).collect();
        let outcomes = task.items(&ItemKind::of_output("square", 1), &items, |index, dir| {
            let number = index + 1;
            fs::write(dir.join("begun"), number.to_string()).context(|| "cannot write".into())?;
            work("item", number)?;
            fs::write(dir.join("square"), (number * number).to_string()).context(|| "cannot write".into())
        })?;
        let ids: Vec<String> = outcomes.into_iter().map(|o| o.id).collect();
        fs::write(task.output_dir().join("ids"), ids.join(" ")).context(|| "cannot write".into())
    }
}

/// Adds the squares up step by step, with a checkpoint after each.
struct Training;

impl Stage for Training {
    fn kind(&self) -> &'static str {
        "training"
    }
    fn about(&self) -> &'static str {
        "a sum with checkpoints"
    }
    fn version(&self) -> u32 {
        1
    }
    fn reads(&self) -> &'static [&'static str] {
        &[]
    }
    fn run(&self, task: &Task<'_>) -> Result<()> {
        let checkpoint = task.checkpoint_dir()?.join("sums");
        let mut sums: Vec<usize> =
            fs::read_to_string(&checkpoint).unwrap_or_default().lines().filter_map(|l| l.parse().ok()).collect();
        let items = task.input_items("squares")?;
        while sums.len() < N_STEP {
            work("step", sums.len())?;
            let path = items[sums.len()].output.as_ref().map_err(|e| flare_pipe::Error::new(e.clone()))?.join("square");
            let square: usize =
                fs::read_to_string(path).context(|| "no square".into())?.parse().context(|| "no number".into())?;
            sums.push(sums.last().copied().unwrap_or(0) + square);
            let lines: Vec<String> = sums.iter().map(ToString::to_string).collect();
            write_if_changed(&checkpoint, lines.join("\n").as_bytes())?;
        }
        fs::write(task.output_dir().join("sum"), sums[N_STEP - 1].to_string()).context(|| "cannot write".into())
    }
}

/// Not a test of its own: what the started processes do.
#[test]
fn started_process_runs_the_pipeline() {
    let Ok(run_dir) = std::env::var(RUN_DIR) else { return };
    let stages: &[&'static dyn Stage] = &[&Ensemble, &Training];
    let manifest = toml::Table::new();
    let graph = Recipe::parse(PIPELINE, "p.toml").and_then(|r| Graph::new(&r, stages, &manifest)).expect("sound");
    let site = Site { name: "toy", manifest: &manifest, manifest_dir: Path::new("."), run_dir: Path::new(&run_dir) };
    let options = Options { jobs: 3, ..Options::default() };
    let summary = run(&site, &graph, &options, Mode::Run, &Quiet).expect("runs");
    assert!(summary.failures.is_empty());
}

struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    fn cache(&self) -> PathBuf {
        self.0.path().join("runs/cache")
    }

    /// Starts a run that hangs at the given piece of work, if at any.
    fn start(&self, log: &str, stall: Option<(&str, usize)>) -> Child {
        let mut command = Command::new(std::env::current_exe().expect("the test program"));
        command.args(["--exact", "started_process_runs_the_pipeline"]);
        command.env(RUN_DIR, self.0.path().join("runs")).env(LOG, self.0.path().join(log)).stdout(Stdio::null());
        if let Some((kind, from)) = stall {
            command.env(STALL_KIND, kind).env(STALL_FROM, from.to_string());
        }
        command.spawn().expect("it starts")
    }

    fn finish(&self, log: &str) {
        assert!(self.start(log, None).wait().expect("it ends").success());
    }

    /// Lines of work told in a log.
    fn told(&self, log: &str) -> Vec<String> {
        let text = fs::read_to_string(self.0.path().join(log)).unwrap_or_default();
        text.lines().map(String::from).collect()
    }

    /// Starts a run that hangs at a piece of work, and kills it when `is_there` says that it got there.
    fn kill_at(&self, kind: &str, from: usize, log: &str, is_there: impl Fn() -> bool) {
        let mut child = self.start(log, Some((kind, from)));
        while !is_there() {
            assert!(child.try_wait().expect("a child").is_none(), "it ended by itself");
            std::thread::sleep(Duration::from_millis(1));
        }
        child.kill().expect("killed"); // SIGKILL: no handler, no destructor
        child.wait().expect("gone");
    }

    /// Names of finished items.
    fn finished_items(&self) -> BTreeSet<String> {
        let folder = fs::read_dir(self.cache().join("square-v1")).into_iter().flatten();
        let dirs = folder.filter_map(|e| Some(e.ok()?.path())).filter(|p| p.is_dir() && p.extension().is_none());
        let begun = dirs.map(|d| fs::read_to_string(d.join("begun")).expect("a finished item is whole"));
        begun.map(|number| format!("item {number}")).collect()
    }

    /// Bytes of every file under `runs` but timings.
    fn bytes(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let mut bytes = BTreeMap::new();
        let mut folders = vec![self.0.path().join("runs")];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).expect("readable") {
                let path = entry.expect("readable").path();
                if path.is_dir() {
                    folders.push(path);
                } else if !path.ends_with("timing.toml") {
                    let name = path.strip_prefix(self.0.path()).expect("inside").to_path_buf();
                    bytes.insert(name, fs::read(&path).expect("readable"));
                }
            }
        }
        bytes
    }
}

fn all_items() -> BTreeSet<String> {
    (1..=N_ITEM).map(|number| format!("item {number}")).collect()
}

#[test]
fn a_killed_ensemble_computes_only_what_is_missing_and_ends_with_the_same_bytes() {
    let (killed, whole) = (Place::new(), Place::new());
    killed.kill_at("item", 5, "first", || killed.finished_items().len() == 4 && killed.told("first").len() == 7);
    let finished = killed.finished_items();
    assert_eq!(finished.len(), 4);
    killed.finish("second");
    let told: BTreeSet<String> = killed.told("second").into_iter().filter(|l| l.starts_with("item")).collect();
    let missing: BTreeSet<String> = all_items().difference(&finished).cloned().collect();
    assert_eq!(told, missing);
    whole.finish("only");
    assert_eq!(killed.bytes(), whole.bytes());
}

#[test]
fn a_killed_training_goes_on_from_its_checkpoint_and_ends_with_the_same_bytes() {
    let (killed, whole) = (Place::new(), Place::new());
    killed.kill_at("step", 5, "first", || killed.told("first").contains(&"step 5".to_string()));
    killed.finish("second");
    assert_eq!(killed.told("second"), ["step 5", "step 6", "step 7"]);
    whole.finish("only");
    assert_eq!(killed.bytes(), whole.bytes());
}

#[test]
fn two_processes_at_once_do_none_of_the_work_twice() {
    let (shared, whole) = (Place::new(), Place::new());
    let mut children = [shared.start("log", None), shared.start("log", None)];
    for child in &mut children {
        assert!(child.wait().expect("it ends").success());
    }
    let mut told = shared.told("log");
    told.sort();
    let mut once: Vec<String> = all_items().into_iter().chain((0..N_STEP).map(|k| format!("step {k}"))).collect();
    once.sort();
    assert_eq!(told, once);
    whole.finish("only");
    assert_eq!(shared.bytes(), whole.bytes());
}

#[test]
fn what_a_killed_process_held_is_taken_over() {
    let place = Place::new();
    let mut stuck = place.start("first", Some(("item", 5)));
    while place.finished_items().len() < 4 {
        std::thread::sleep(Duration::from_millis(1));
    }
    let mut waiting = place.start("second", None);
    std::thread::sleep(Duration::from_millis(50));
    assert!(waiting.try_wait().expect("a child").is_none(), "it waits for the other");
    assert!(place.told("second").is_empty());
    stuck.kill().expect("killed");
    stuck.wait().expect("gone");
    assert!(waiting.wait().expect("it ends").success());
    assert_eq!(place.told("second").len(), N_ITEM - 4 + N_STEP);
}
