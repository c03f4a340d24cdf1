//! `flare-pipe status`: how every stage stands.

use super::SiteArguments;
use super::output::{data, write_json};
use super::workspace::Workspace;
use crate::error::Result;
use crate::pipeline::Results;

/// Prints state, key, time and size of each stage.
///
/// # Errors
/// Usage errors; outside files that cannot be read.
pub fn status(arguments: &SiteArguments, json: bool) -> Result<()> {
    let workspace = Workspace::open(arguments)?;
    let stages = Results::of(&workspace.site(), &workspace.graph)?.status();
    if json {
        return write_json(&stages);
    }
    data!("{:22} {:10} {:14} {:>10} {:>10}", "stage", "state", "key", "time", "size")?;
    for stage in stages {
        let key = stage.entry.as_ref().map_or("–".into(), |e| e.key.short().to_string());
        let time = stage.seconds.map_or("–".into(), |s| format!("{s:.1} s"));
        let size = stage.bytes.map_or("–".into(), |b| format!("{:.1} MB", b as f64 / 1e6));
        data!("{:22} {:10} {:14} {:>10} {:>10}", stage.stage, stage.state, key, time, size)?;
        if let Some(shards) = &stage.shards {
            data!("{:22} {shards}", "")?;
        }
    }
    Ok(())
}
