//! `flare-pipe report`: the report again, from cached results.

use super::SiteArguments;
use super::output::{data, write_json};
use super::publish::publish;
use super::reporter::{Terminal, Verbosity};
use super::workspace::Workspace;
use crate::error::Result;
use crate::pipeline::{self, Mode, Options, Results};
use serde_json::json;

/// Rebuilds the report; everything it needs must be stored.
///
/// # Errors
/// When a result it needs is not stored.
pub fn report(arguments: &SiteArguments, json: bool) -> Result<()> {
    let workspace = Workspace::open(arguments)?;
    let stage = vec!["report".to_string()];
    let options = Options { only: stage.clone(), force: stage, ..Options::default() };
    let site = workspace.site();
    let summary = pipeline::run(&site, &workspace.graph, &options, Mode::Run, &Terminal::new(Verbosity::Quiet))?;
    if let Some(failure) = summary.failures.into_iter().next() {
        return Err(failure.error);
    }
    let _lease = site.lease();
    publish(&workspace, &Results::of(&site, &workspace.graph)?)?;
    let path = site.dir().join("report.html");
    if json { write_json(&json!({ "report": path })) } else { data!("{}", path.display()) }
}
