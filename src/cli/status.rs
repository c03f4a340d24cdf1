//! `flare-pipe status`: how every stage stands.

use super::SiteArguments;
use super::workspace::Workspace;
use crate::error::{Context, Result};
use crate::pipeline;
use clap::Args;

/// Which site and in what form.
#[derive(Debug, Args)]
pub struct StatusArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Prints state, key, time and size of each stage.
///
/// # Errors
/// Usage errors; outside files that cannot be read.
pub fn status(arguments: &StatusArguments) -> Result<()> {
    let workspace = Workspace::open(&arguments.site)?;
    let stages = pipeline::status(&workspace.site(), &workspace.graph)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&stages).context(|| "cannot write the status".into())?);
        return Ok(());
    }
    println!("{:22} {:10} {:14} {:>10} {:>10}", "stage", "state", "key", "time", "size");
    for stage in stages {
        let key = stage.entry.as_ref().map_or("–".into(), |e| e.key.short().to_string());
        let time = stage.seconds.map_or("–".into(), |s| format!("{s:.1} s"));
        let size = stage.bytes.map_or("–".into(), |b| format!("{:.1} MB", b as f64 / 1e6));
        println!("{:22} {:10} {:14} {:>10} {:>10}", stage.stage, stage.state, key, time, size);
    }
    Ok(())
}
