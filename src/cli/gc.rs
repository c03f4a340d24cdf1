//! `flare-pipe gc`: removes what no site refers to.

use crate::error::Result;
use crate::pipeline;
use clap::Args;
use std::path::PathBuf;

/// Where, and whether only to say.
#[derive(Debug, Args)]
pub struct GcArguments {
    /// Folder for results and cache
    #[arg(long, value_name = "DIR", default_value = "runs")]
    run_dir: PathBuf,
    /// Only list what would be removed
    #[arg(long)]
    dry_run: bool,
}

/// Removes unused cache entries and lists them.
///
/// # Errors
/// When the run directory cannot be read or written.
pub fn gc(arguments: &GcArguments) -> Result<()> {
    let removed = pipeline::gc(&arguments.run_dir, arguments.dry_run)?;
    for entry in &removed {
        println!("{}  {:.1} MB", entry.entry, entry.bytes as f64 / 1e6);
    }
    let megabytes = removed.iter().map(|r| r.bytes).sum::<u64>() as f64 / 1e6;
    let verb = if arguments.dry_run { "would be removed" } else { "removed" };
    eprintln!("{} entries, {megabytes:.1} MB {verb}", removed.len());
    Ok(())
}
