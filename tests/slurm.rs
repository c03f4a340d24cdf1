//! Ensembles on a real Slurm of this host: what they leave is what this machine leaves by itself, whatever is killed in the middle.
//!
//! `tests/slurm/start` installs and starts it; where it cannot, the tests say so and end.

#[path = "support/tree.rs"]
mod tree;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tree::files;

/// Eight motions that take long enough to be killed under, two to a shard.
const SITE: &[&str] = &[
    "run",
    "configs/smoke.toml",
    "--pipeline",
    "flare-t",
    "--until",
    "simulate",
    "--set",
    "motions.count=8",
    "--set",
    "motions.bands=[{ count = 8, min_pga_g = 0.01, max_pga_g = 0.1 }]",
    "--set",
    "motions.train='1-6'",
    "--set",
    "motions.validation='7-8'",
    "--set",
    "motions.duration_s=20",
    "--set",
    "analysis.max_step_s=0.0002",
    "--set",
    "analysis.initial_step_s=0.0002",
    "--set",
    "executor.slurm.shard_items=2",
];
/// Longest that a run may take.
const LONGEST: Duration = Duration::from_secs(400);

/// A Slurm of its own.
struct Cluster {
    root: PathBuf,
}

impl Cluster {
    fn start(root: PathBuf) -> Option<Self> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/slurm/start");
        let Output { status, stderr, .. } = Command::new(script).arg(&root).arg("3").output().ok()?;
        let cluster = Self { root };
        if !status.success() {
            eprintln!("skipped: no Slurm can be started here: {}", String::from_utf8_lossy(&stderr));
            return None;
        }
        Some(cluster)
    }

    fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.env("SLURM_CONF", self.root.join("slurm.conf"));
        command
    }

    fn said(&self, program: &str, words: &[&str]) -> String {
        let output = self.command(program).args(words).output().expect("the command starts");
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    /// Number of the process of a daemon.
    fn pid(&self, daemon: &str) -> String {
        fs::read_to_string(self.root.join(format!("{daemon}.pid"))).expect("it runs").trim().to_string()
    }

    fn driver(&self, run_dir: &Path) -> Child {
        let mut command = self.command(env!("CARGO_BIN_EXE_flare-pipe"));
        command
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .args(SITE)
            .args(["--executor", "slurm", "--run-dir"])
            .arg(run_dir);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the program starts")
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        let _ = self.command("scancel").args(["--user", "root"]).output();
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/slurm/stop");
        let _ = Command::new(script).arg(&self.root).output();
    }
}

/// Every file below `dir` that does not tell of the time, without what a killed process had no name for yet (`gc` takes it).
fn lasting(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = files(dir);
    let is_unfinished = |name: &Path| name.file_name().is_some_and(|n| n.to_string_lossy().starts_with(".writing-"));
    all.retain(|name, _| !name.ends_with("timing.toml") && !name.ends_with("log.txt") && !is_unfinished(name));
    all
}

/// Waits until `is_so`; false after a minute.
fn soon(is_so: impl Fn() -> bool) -> bool {
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(60) {
        if is_so() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    false
}

/// Processes that compute shards in `run_dir`.
fn shards(run_dir: &Path) -> Vec<String> {
    let pattern = format!("flare-pipe shard .*{}", run_dir.display());
    let output = Command::new("pgrep").args(["-f", &pattern]).output().expect("`pgrep` starts");
    String::from_utf8_lossy(&output.stdout).lines().map(String::from).collect()
}

/// Kills a process; false where it has ended by itself.
fn kill(pid: &str) -> bool {
    Command::new("kill").args(["-9", pid]).status().expect("`kill` starts").success()
}

/// Waits for a run; its exit status and messages.
fn ended(mut child: Child) -> (Option<i32>, String) {
    let begun = Instant::now();
    while child.try_wait().expect("waited for").is_none() {
        assert!(begun.elapsed() < LONGEST, "the run does not end");
        std::thread::sleep(Duration::from_millis(100));
    }
    let Output { status, stderr, .. } = child.wait_with_output().expect("waited for");
    (status.code(), String::from_utf8_lossy(&stderr).into_owned())
}

#[test]
fn what_is_killed_on_a_cluster_changes_no_byte() {
    let dir = tempfile::tempdir().expect("a folder");
    let Some(cluster) = Cluster::start(dir.path().join("slurm")) else { return };
    let alone = dir.path().join("alone");
    let mut command = Command::new(env!("CARGO_BIN_EXE_flare-pipe"));
    let status = command.current_dir(env!("CARGO_MANIFEST_DIR")).args(SITE).arg("--run-dir").arg(&alone).status();
    assert!(status.expect("the program starts").success());
    let expected = lasting(&alone);
    for what in ["nothing", "a task", "a node", "the controller", "the driver"] {
        let run_dir = dir.path().join(what.replace(' ', "-"));
        let begun = Instant::now();
        let mut driver = cluster.driver(&run_dir);
        if what != "nothing" {
            assert!(soon(|| !shards(&run_dir).is_empty()), "no shard was begun");
            std::thread::sleep(Duration::from_millis(300));
        }
        match what {
            "a task" => assert!(soon(|| shards(&run_dir).iter().any(|pid| kill(pid))), "no shard was killed"),
            "a node" => {
                // The daemon and what computes for it.
                assert!(kill(&cluster.pid("slurmd.n1")));
                let tasks = cluster.said("squeue", &["--noheader", "--nodelist=n1", "--states=R", "--format=%i"]);
                println!("  tasks on the node: {}", tasks.split_whitespace().count());
                shards(&run_dir).iter().for_each(|pid| _ = kill(pid));
                std::thread::sleep(Duration::from_secs(2));
                assert!(cluster.command("slurmd").args(["-N", "n1"]).status().expect("it starts").success());
            }
            "the controller" => {
                assert!(kill(&cluster.pid("slurmctld")));
                std::thread::sleep(Duration::from_secs(3));
                assert!(cluster.command("slurmctld").status().expect("it starts").success());
            }
            "the driver" => {
                driver.kill().expect("killed");
                driver.wait().expect("waited for");
                driver = cluster.driver(&run_dir);
            }
            _ => {}
        }
        let (status, text) = ended(driver);
        assert_eq!(status, Some(0), "{what}: {text}");
        let found = lasting(&run_dir);
        let other: Vec<_> = expected.keys().chain(found.keys()).filter(|n| expected.get(*n) != found.get(*n)).collect();
        assert!(other.is_empty(), "{what}: {other:?}");
        let again = text.lines().filter(|line| line.contains("submitted again")).count();
        println!(
            "killed: {what:15} {:4.0} s, submitted again {again} times, result identical",
            begun.elapsed().as_secs_f64()
        );
    }
}

#[test]
fn what_slurm_refuses_is_said_in_its_words() {
    let dir = tempfile::tempdir().expect("a folder");
    let Some(cluster) = Cluster::start(dir.path().join("slurm")) else { return };
    let mut command = cluster.command(env!("CARGO_BIN_EXE_flare-pipe"));
    command.current_dir(env!("CARGO_MANIFEST_DIR")).args(SITE).args(["--executor", "slurm", "--run-dir"]);
    command.arg(dir.path().join("runs")).args(["--set", "executor.slurm.max_attempts=1"]);
    command.args(["--set", "executor.slurm.extra=['--wrap-is-no-option']"]);
    let output = command.output().expect("the program starts");
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("`sbatch` failed") && text.contains("wrap-is-no-option"), "{text}");
}
