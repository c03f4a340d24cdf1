//! `flare-pipe shard`: one shard of an ensemble, on a machine of a cluster. Called by jobs, not by people.

use super::SiteArguments;
use super::jobs::{JobsArgument, start_threads};
use super::reporter::{Terminal, Verbosity};
use super::signals::cancels_jobs;
use super::workspace::Workspace;
use crate::error::{Context, Result};
use crate::pipeline::{self, Graph, Options, Site, Slurm};
use clap::{Args, ValueEnum};
use std::ffi::OsString;
use std::path::PathBuf;

/// Where ensembles are computed.
#[derive(Debug, Args)]
pub struct ExecutorArgument {
    /// Where ensembles are computed
    #[arg(long, value_enum, default_value = "local")]
    executor: Executor,
    /// Cancel jobs on a cluster when this is interrupted; otherwise they go on and the next run waits for them
    #[arg(long)]
    cancel_on_exit: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Executor {
    /// This machine
    Local,
    /// A cluster that runs Slurm, as `[executor.slurm]` of the manifest says
    Slurm,
}

impl ExecutorArgument {
    /// The cluster, if one is asked for, on which shards of a site are computed by `command`.
    ///
    /// # Errors
    /// When that command is not known.
    pub fn of(&self, workspace: &Workspace, command: impl FnOnce() -> Result<Vec<OsString>>) -> Result<Option<Slurm>> {
        let Executor::Slurm = self.executor else { return Ok(None) };
        if self.cancel_on_exit {
            cancels_jobs();
        }
        let settings = workspace.manifest.site.executor.slurm.clone();
        let mut command = command()?;
        command.extend(["--jobs".into(), settings.cpus.to_string().into()]);
        Ok(Some(Slurm { settings, command }))
    }
}

/// Which shard of which submission.
#[derive(Debug, Args)]
#[group(requires_all = ["shards", "index"])]
pub struct ShardArgument {
    /// Folder of the submission
    #[arg(long, value_name = "DIR", hide = true)]
    shards: Option<PathBuf>,
    /// Number of the shard in it, from 0
    #[arg(long, value_name = "N", hide = true)]
    index: Option<usize>,
}

impl ShardArgument {
    /// Computes the shard of `site` that is asked for; whether one is.
    ///
    /// # Errors
    /// When there is no such shard, what its stage reads is not stored, or the machine fails.
    pub fn compute(&self, site: &Site<'_>, graph: &Graph, options: &Options) -> Result<bool> {
        let Some((shards, index)) = self.shards.as_ref().zip(self.index) else { return Ok(false) };
        let task = pipeline::shard_of(shards, index)?;
        pipeline::compute_shard(site, graph, task, options, &Terminal::new(Verbosity::Verbose))?;
        Ok(true)
    }
}

/// A shard of a site that a pipeline runs for.
#[derive(Debug, Args)]
pub struct ShardArguments {
    #[command(flatten)]
    site: SiteArguments,
    #[command(flatten)]
    shard: ShardArgument,
    #[command(flatten)]
    jobs: JobsArgument,
}

/// Computes the items of one shard.
///
/// # Errors
/// When there is no such shard, what its stage reads is not stored, or the machine fails.
pub fn shard(arguments: &ShardArguments) -> Result<()> {
    let options = Options { jobs: arguments.jobs.or(Options::default().jobs)?, ..Options::default() };
    let workspace = Workspace::open(&arguments.site)?;
    start_threads(options.jobs);
    arguments.shard.compute(&workspace.site(), &workspace.graph, &options).map(|_| ())
}

/// The command by which a job computes a shard of this site, but for which one.
///
/// # Errors
/// When it is not known where this program or this folder is.
pub fn command(command: &[&str], site: &SiteArguments, more: &[OsString]) -> Result<Vec<OsString>> {
    let program = std::env::current_exe().context(|| "it is not known where this program is".into())?;
    let here = std::env::current_dir().context(|| "it is not known which folder this is".into())?;
    let mut words: Vec<OsString> = vec![program.into()];
    words.extend(command.iter().map(Into::into));
    words.push(here.join(&site.site).into());
    let mut option = |name: &str, value: OsString| words.extend([name.into(), value]);
    if let Some(pipeline) = &site.pipeline {
        option("--pipeline", pipeline.into());
    }
    site.set.iter().for_each(|set| option("--set", set.into()));
    if let Some(run_dir) = &site.run_dir {
        option("--run-dir", here.join(run_dir).into());
    }
    words.extend(more.iter().cloned());
    Ok(words)
}
