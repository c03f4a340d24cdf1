//! `flare-pipe shard`: one shard of an ensemble, on a machine of a cluster. Called by jobs, not by people.

use super::SiteArguments;
use super::jobs::{JobsArgument, start_threads};
use super::reporter::{Terminal, Verbosity};
use super::workspace::Workspace;
use crate::error::{Context, Result};
use crate::pipeline::{self, Options};
use clap::Args;
use std::ffi::OsString;
use std::path::PathBuf;

/// Which shard of which submission.
#[derive(Debug, Args)]
pub struct ShardArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Folder of the submission
    #[arg(long, value_name = "DIR")]
    shards: PathBuf,
    /// Number of the shard in it, from 0
    #[arg(long, value_name = "N")]
    index: usize,
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
    let (stage, is_forced, own) = pipeline::shard_of(&arguments.shards, arguments.index)?;
    let terminal = Terminal::new(Verbosity::Verbose);
    pipeline::compute_shard(&workspace.site(), &workspace.graph, (&stage, is_forced, own), &options, &terminal)
}

/// The command by which a job computes a shard of this site, but for which one.
///
/// # Errors
/// When it is not known where this program or this folder is.
pub fn command(site: &SiteArguments, cpus: usize) -> Result<Vec<OsString>> {
    let program = std::env::current_exe().context(|| "it is not known where this program is".into())?;
    let here = std::env::current_dir().context(|| "it is not known which folder this is".into())?;
    let mut words: Vec<OsString> = vec![program.into(), "shard".into(), here.join(&site.site).into()];
    let mut option = |name: &str, value: OsString| words.extend([name.into(), value]);
    if let Some(pipeline) = &site.pipeline {
        option("--pipeline", pipeline.into());
    }
    site.set.iter().for_each(|set| option("--set", set.into()));
    if let Some(run_dir) = &site.run_dir {
        option("--run-dir", here.join(run_dir).into());
    }
    option("--jobs", cpus.to_string().into());
    Ok(words)
}
