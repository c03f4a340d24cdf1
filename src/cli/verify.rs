//! `flare-pipe verify`: whether what is stored is as it was written, and its repair.

use super::SiteArguments;
use super::jobs::{JobsArgument, start_threads};
use super::output::{data, say, write_json};
use super::publish::publish;
use super::reporter::{Terminal, Verbosity};
use super::workspace::{Workspace, results_folder};
use crate::error::{Error, Result};
use crate::pipeline::{self, Damage, Mode, Options, Results, Verification};
use clap::Args;
use serde_json::json;
use std::path::PathBuf;

/// What is looked at.
#[derive(Debug, Args)]
pub struct VerifyArguments {
    /// Manifest of the site whose outputs are looked at
    #[arg(value_name = "SITE", required_unless_present = "all", conflicts_with = "all")]
    site: Option<PathBuf>,
    /// Look at all that is stored
    #[arg(long)]
    all: bool,
    /// Pipeline to use instead of the one the manifest names
    #[arg(long, value_name = "NAME", requires = "site")]
    pipeline: Option<String>,
    /// Override a manifest value (repeatable)
    #[arg(long, value_name = "KEY=VALUE", requires = "site")]
    set: Vec<String>,
    /// Folder for results and cache [default: `runs` in the folder of the project]
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
    /// Remove what is damaged, and for a site compute it again
    #[arg(long)]
    repair: bool,
    #[command(flatten)]
    jobs: JobsArgument,
}

/// Compares all files with their hashes, says which differ, and with `--repair` mends them.
///
/// # Errors
/// When something is damaged and stays so, or the run directory cannot be read.
pub fn verify(arguments: &VerifyArguments, json: bool) -> Result<()> {
    let options = Options { jobs: arguments.jobs.or(Options::default().jobs)?, ..Options::default() };
    start_threads(options.jobs);
    let Some(manifest) = &arguments.site else {
        let run_dir = results_folder(arguments.run_dir.as_deref())?;
        let found = pipeline::verify_all(&run_dir)?;
        if arguments.repair {
            pipeline::discard(&run_dir, &found.damaged)?;
        }
        return tell(&found, arguments.repair, json);
    };
    let workspace = Workspace::open(&SiteArguments {
        site: manifest.clone(),
        pipeline: arguments.pipeline.clone(),
        set: arguments.set.clone(),
        run_dir: arguments.run_dir.clone(),
    })?;
    let site = workspace.site();
    let found = pipeline::verify_site(&site, &workspace.graph)?;
    if arguments.repair {
        pipeline::discard(site.run_dir, &found.damaged)?;
        let terminal = Terminal::new(if json { Verbosity::Quiet } else { Verbosity::Normal });
        let summary = pipeline::run(&site, &workspace.graph, &options, Mode::Run, &terminal)?;
        let _lease = site.lease();
        publish(&workspace, &Results::of(&site, &workspace.graph)?)?;
        if let Some(failure) = summary.failures.into_iter().next() {
            return Err(failure.error);
        }
    }
    tell(&found, arguments.repair, json)
}

fn tell(found: &Verification, is_repaired: bool, json: bool) -> Result<()> {
    let Verification { entries, damaged } = found;
    if json {
        write_json(&json!({ "entries": entries, "damaged": damaged, "is_repaired": is_repaired }))?;
    } else {
        for Damage { entry, why } in damaged {
            data!("{:24} {}  {why}", entry.folder, entry.key.short())?;
        }
        let what = if is_repaired && !damaged.is_empty() { " and repaired" } else { "" };
        say!("{entries} entries, {} of them damaged{what}", damaged.len());
    }
    if damaged.is_empty() || is_repaired {
        return Ok(());
    }
    let error = Error::new(format!("{} of {entries} entries are not as they were written", damaged.len()));
    Err(error.hint("`--repair` removes them and, for a site, computes them again"))
}
