//! Items of an ensemble on a cluster that runs Slurm: shards as tasks of one array, through `flare-pipe shard`.
//!
//! ```text
//! missing items ─► shards.toml ─► sbatch --array ─► shard k: its items into the store, a mark beside each ─► all marked, or once more
//! ```
//!
//! An item is done when its mark is there, never because of an exit status or the state of a job: tasks end with 0 after a time limit, and
//! run twice after a crash of the controller. Shards are idempotent, since an item is published by a rename under its lock. The job is
//! written down before it is waited for, so that a driver that was killed waits for the same job when it is run again.

use super::local::{Ensemble, Job};
use crate::error::{Context, Error, Result};
use crate::pipeline::files::{remove_dir, remove_file};
use crate::pipeline::{Address, State, Store, write_if_changed};
use crate::ranges::{Range, Ranged, range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Most tasks of one array: `MaxArraySize` is 1001 unless a site says otherwise.
const MOST_SHARDS: usize = 1000;
/// Shards of an ensemble where no size is declared.
const SHARDS: usize = 100;
/// Pause between two looks, and the longest that it grows to.
const POLL: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(10)];
/// How often, and after what pause, is looked again for what a shared file system may show late.
const LATE: (usize, Duration) = (4, Duration::from_secs(1));

/// `[executor.slurm]`: how shards are run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SlurmSettings {
    /// Partition; that of the cluster where it is empty.
    pub partition: String,
    /// Time limit of a shard, min.
    pub time_min: usize,
    /// Memory of a shard, MiB.
    pub memory_mib: usize,
    /// Cores of a shard.
    pub cpus: usize,
    /// Items of a shard; 0 for a hundredth of the ensemble.
    pub shard_items: usize,
    /// Most shards at work at once.
    pub max_in_flight: usize,
    /// How often what is missing is submitted.
    pub max_attempts: usize,
    /// Further arguments of `sbatch`.
    pub extra: Vec<String>,
}

impl Default for SlurmSettings {
    fn default() -> Self {
        Self {
            partition: String::new(),
            time_min: 60,
            memory_mib: 2000,
            cpus: 1,
            shard_items: 0,
            max_in_flight: 100,
            max_attempts: 3,
            extra: Vec::new(),
        }
    }
}

impl Ranged for SlurmSettings {
    const RANGES: &'static [Range<Self>] = &[
        range!(time_min, "min", 1.0, 1e5),
        range!(memory_mib, "MiB", 100.0, 1e7),
        range!(cpus, "", 1.0, 1024.0),
        range!(shard_items, "", 0.0, 1e6),
        range!(max_in_flight, "", 1.0, 1e5),
        range!(max_attempts, "", 1.0, 100.0),
    ];
}

/// A cluster, and how this program is called on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Slurm {
    /// How shards are run.
    pub settings: SlurmSettings,
    /// The command that runs a shard, up to its stage: program, `shard`, the site and its settings.
    pub command: Vec<OsString>,
}

/// What one task of an array has to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shard {
    /// Kind of the items.
    pub kind: String,
    /// Their addresses.
    pub items: BTreeSet<String>,
}

/// A shard with what it is of.
#[derive(Debug, Clone, PartialEq)]
pub struct ShardTask {
    /// Stage in the pipeline.
    pub stage: String,
    /// Whether items are computed though they are stored.
    pub is_forced: bool,
    /// Its items.
    pub shard: Shard,
}

/// `shards.toml`: all shards of one submission.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Shards {
    /// Stage in the pipeline.
    stage: String,
    is_forced: bool,
    shard: Vec<Shard>,
}

/// `job.toml`: what was submitted.
#[derive(Debug, Serialize, Deserialize)]
struct Submitted {
    /// Number that Slurm gave.
    job: String,
    attempt: usize,
}

/// Jobs of this process that are at work.
static ACTIVE: Mutex<Vec<String>> = Mutex::new(Vec::new());

/// Jobs on a cluster that this process waits for.
pub fn active_jobs() -> Vec<String> {
    ACTIVE.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// Cancels them.
pub fn cancel_jobs() {
    let _ = Command::new("scancel").args(active_jobs()).status();
}

/// What task `index` of the submission in `folder` has to do.
///
/// # Errors
/// When there is no such submission or task.
pub fn shard_of(folder: &Path, index: usize) -> Result<ShardTask> {
    let shards: Shards = read(&folder.join("shards.toml"))?;
    let Shards { stage, is_forced, shard } = shards;
    let found = shard.into_iter().nth(index);
    let shard = found.ok_or_else(|| Error::new(format!("`{}` has no shard {index}", folder.display())).usage())?;
    Ok(ShardTask { stage, is_forced, shard })
}

/// How far a submission is, in words; none where there is none.
pub(in crate::pipeline) fn standing(folder: &Path) -> Option<String> {
    let (Submitted { job, attempt }, Shards { shard, .. }) =
        (read(&folder.join("job.toml")).ok()?, read(&folder.join("shards.toml")).ok()?);
    let store = folder.parent()?.parent()?;
    let is_done = |item: &&String| store.join(format!("{item}.mark")).is_file();
    let n: usize = shard.iter().map(|shard| shard.items.len()).sum();
    let done = shard.iter().flat_map(|shard| &shard.items).filter(is_done).count();
    Some(format!("job {job}, attempt {attempt}: {done} of {n} items in {} shards", shard.len()))
}

/// What became of an item in a shard: beside its entry, `ok` or why the model has no result.
pub(in crate::pipeline) fn mark(path: &Path, outcome: &std::result::Result<(), String>) -> Result<()> {
    let text = match outcome {
        Ok(()) => "ok".to_string(),
        Err(failure) => format!("failed\n{failure}"),
    };
    write_if_changed(path, text.as_bytes()).map(|_| ())
}

fn read_mark(path: &Path) -> Option<std::result::Result<(), String>> {
    let text = fs::read_to_string(path).ok()?;
    match text.split_once('\n') {
        Some(("failed", failure)) => Some(Err(failure.to_string())),
        _ if text == "ok" => Some(Ok(())),
        _ => None,
    }
}

fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    let what = || format!("cannot read `{}`", path.display());
    toml::from_str(&fs::read_to_string(path).context(what)?).context(what)
}

fn write(path: &Path, value: &impl Serialize) -> Result<()> {
    let text = toml::to_string(value).context(|| format!("cannot write `{}`", path.display()))?;
    write_if_changed(path, text.as_bytes()).map(|_| ())
}

/// The ensemble of one stage on the cluster.
pub(in crate::pipeline) struct Submission<'a> {
    pub(in crate::pipeline) slurm: &'a Slurm,
    /// Name of the stage.
    pub(in crate::pipeline) stage: &'a str,
    /// Folder of its shards, job and logs.
    pub(in crate::pipeline) folder: PathBuf,
}

impl Submission<'_> {
    /// Has `jobs` computed and says for which of them the model has no result.
    pub(super) fn compute(
        &self,
        ensemble: &Ensemble<'_>,
        kind: &str,
        jobs: &[Job],
    ) -> Result<BTreeMap<Address, String>> {
        fs::create_dir_all(&self.folder).context(|| format!("cannot make `{}`", self.folder.display()))?;
        let mut open: BTreeMap<Address, PathBuf> =
            jobs.iter().map(|job| (job.address.clone(), ensemble.store.mark_path(&job.address))).collect();
        let mut failures = BTreeMap::new();
        let submitted: Option<Submitted> = read(&self.folder.join("job.toml")).ok();
        let mut attempt = 0;
        let mut job = None;
        if let Some(Submitted { job: known, attempt: done }) = submitted {
            // Whether it is at work or over: what it has marked counts.
            ensemble.progress.note(&format!("goes on with job {known}"));
            (attempt, job) = (done, Some(known));
        } else {
            // Marks of a submission that nobody remembers say nothing.
            open.values().try_for_each(|path| remove_file(path))?;
        }
        loop {
            let own = match job.take() {
                Some(known) => known,
                None if open.is_empty() => break,
                None if attempt == self.slurm.settings.max_attempts => {
                    let what =
                        format!("{} of {} items were not computed in {attempt} attempts", open.len(), jobs.len());
                    let hint = format!("logs are in `{}`; run again for further attempts", self.folder.display());
                    remove_file(&self.folder.join("job.toml"))?;
                    return Err(Error::new(what).cause(self.last_words()).hint(hint));
                }
                None => {
                    attempt += 1;
                    self.submit(ensemble, kind, open.keys(), attempt)?
                }
            };
            ACTIVE.lock().unwrap_or_else(PoisonError::into_inner).push(own.clone());
            let waited = self.wait(ensemble, &own, &mut open, &mut failures);
            ACTIVE.lock().unwrap_or_else(PoisonError::into_inner).retain(|job| *job != own);
            waited?;
            if !open.is_empty() {
                ensemble
                    .progress
                    .warn(&format!("job {own} ended without {} items, which are submitted again", open.len()));
            }
        }
        Ok(failures)
    }

    /// Removes what a submission leaves beside the `items` of an ensemble that is whole, whoever waited for it.
    pub(super) fn clear<'i>(&self, store: &Store, mut items: impl Iterator<Item = &'i Address>) -> Result<()> {
        if !self.folder.is_dir() {
            return Ok(());
        }
        items.try_for_each(|address| remove_file(&store.mark_path(address)))?;
        remove_dir(&self.folder)
    }

    /// Submits what is `open`; the number of the job.
    fn submit<'i>(
        &self,
        ensemble: &Ensemble<'_>,
        kind: &str,
        open: impl ExactSizeIterator<Item = &'i Address>,
        attempt: usize,
    ) -> Result<String> {
        let settings = &self.slurm.settings;
        let n = open.len();
        let size = match settings.shard_items {
            0 => n.div_ceil(SHARDS),
            size => size.max(n.div_ceil(MOST_SHARDS)),
        };
        let all: Vec<String> = open.map(ToString::to_string).collect();
        let of = |items: &[String]| Shard { kind: kind.into(), items: items.iter().cloned().collect() };
        let shard: Vec<Shard> = all.chunks(size).map(of).collect();
        let count = shard.len();
        write(
            &self.folder.join("shards.toml"),
            &Shards { stage: self.stage.into(), is_forced: ensemble.is_forced, shard },
        )?;
        let script = self.folder.join("job.sh");
        let words: Vec<String> = self.slurm.command.iter().map(|word| quoted(&word.to_string_lossy())).collect();
        let folder = quoted(&self.folder.to_string_lossy());
        let text = format!("#!/bin/sh\nexec {} --shards {folder} --index \"$SLURM_ARRAY_TASK_ID\"\n", words.join(" "));
        write_if_changed(&script, text.as_bytes())?;
        let mut command = Command::new("sbatch");
        command.args(["--parsable", "--requeue"]);
        command.arg(format!("--array=0-{}%{}", count - 1, settings.max_in_flight));
        command.arg(format!("--job-name=flare-pipe.{}", self.stage));
        command.arg(format!("--time={}", settings.time_min));
        command.arg(format!("--mem={}M", settings.memory_mib));
        command.arg(format!("--cpus-per-task={}", settings.cpus));
        command.arg(format!("--output={}/%A.%a.log", self.folder.display()));
        if !settings.partition.is_empty() {
            command.arg(format!("--partition={}", settings.partition));
        }
        let said = said(command.args(&settings.extra).arg(&script))?;
        let job = said.trim().split(';').next().unwrap_or_default().to_string();
        if job.is_empty() || !job.bytes().all(|b| b.is_ascii_digit()) {
            return Err(Error::new(format!("`sbatch` gave no number of a job but `{}`", said.trim())));
        }
        write(&self.folder.join("job.toml"), &Submitted { job: job.clone(), attempt })?;
        ensemble.progress.note(&format!("job {job}: {n} items in {count} shards"));
        Ok(job)
    }

    /// Waits until all is there that is `open`, or the job is over.
    fn wait(
        &self,
        ensemble: &Ensemble<'_>,
        job: &str,
        open: &mut BTreeMap<Address, PathBuf>,
        failures: &mut BTreeMap<Address, String>,
    ) -> Result<()> {
        let (mut pause, mut late, mut is_told) = (POLL[0], 0, false);
        loop {
            let before = open.len();
            open.retain(|address, path| match read_mark(path) {
                Some(Ok(())) => !matches!(ensemble.store.verify(address), State::Sound(_)),
                Some(Err(failure)) => {
                    failures.insert(address.clone(), failure);
                    false
                }
                None => true,
            });
            ensemble.progress.advance((before - open.len()) as u64);
            if open.is_empty() {
                return Ok(());
            }
            let is_at_work = match self.is_at_work(job) {
                Ok(is_at_work) => is_at_work,
                Err(error) => {
                    if !std::mem::replace(&mut is_told, true) {
                        ensemble.progress.warn(&format!(
                            "the controller cannot be asked, its answer is waited for: {}",
                            error.what()
                        ));
                    }
                    true
                }
            };
            if !is_at_work {
                // What a task has written may be seen later than that it is over.
                if late == LATE.0 {
                    return Ok(());
                }
                late += 1;
                std::thread::sleep(LATE.1);
                continue;
            }
            std::thread::sleep(pause);
            pause = if open.len() < before { POLL[0] } else { (pause * 2).min(POLL[1]) };
        }
    }

    /// Whether any task of a job waits or runs. Tasks that could not be launched are held until somebody lets them go: these are cancelled,
    /// and submitted again with what else is missing.
    fn is_at_work(&self, job: &str) -> Result<bool> {
        match said(Command::new("squeue").args(["--noheader", "--format=%i %r", "--jobs", job])) {
            Ok(said) => {
                let is_held = |line: &&str| line.to_lowercase().contains("held");
                let held: Vec<&str> = said.lines().filter(is_held).collect();
                for task in held.iter().filter_map(|line| line.split_whitespace().next()) {
                    let _ = Command::new("scancel").arg(task).status();
                }
                Ok(said.lines().filter(|line| !line.trim().is_empty()).count() > held.len())
            }
            // Jobs that ended are forgotten after some minutes.
            Err(error) if error.to_string().contains("Invalid job id") => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// The end of the log that was written last.
    fn last_words(&self) -> String {
        let logs = fs::read_dir(&self.folder).into_iter().flatten().flatten().map(|entry| entry.path());
        let logs = logs.filter(|path| path.extension().is_some_and(|e| e == "log"));
        let last = logs.max_by_key(|path| fs::metadata(path).and_then(|m| m.modified()).ok());
        let text = last.and_then(|path| fs::read_to_string(path).ok()).unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        match lines.as_slice() {
            [] => "no shard wrote a word".into(),
            lines => lines[lines.len().saturating_sub(5)..].join("\n"),
        }
    }
}

/// What a command says; its words where it fails.
fn said(command: &mut Command) -> Result<String> {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command.output().map_err(|error| {
        let hint = "`--executor slurm` needs the commands of Slurm on the path of this machine";
        Error::new(format!("cannot run `{name}`")).cause(error).hint(hint)
    })?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let words = String::from_utf8_lossy(&output.stderr).trim().to_string();
    Err(Error::new(format!("`{name}` failed")).cause(words))
}

/// A word of a shell.
fn quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_a_shell_are_quoted() {
        assert_eq!(quoted("a b"), "'a b'");
        assert_eq!(quoted("it's"), "'it'\\''s'");
    }

    #[test]
    fn marks_are_read_as_written_and_half_of_one_is_none() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("key.mark");
        assert_eq!(read_mark(&path), None);
        for outcome in [Ok(()), Err("no convergence\nat 3 s".to_string())] {
            mark(&path, &outcome).unwrap();
            assert_eq!(read_mark(&path), Some(outcome));
        }
        fs::write(&path, "o").unwrap();
        assert_eq!(read_mark(&path), None);
    }
}
