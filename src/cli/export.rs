//! `flare-pipe export`: a closed loop as files for other programs.

use super::SiteArguments;
use super::output::{data, write_json};
use super::workspace::Workspace;
use crate::error::{Error, Result};
use crate::pipeline::Results;
use crate::stages::{Closed, export as write};
use clap::Args;
use std::path::PathBuf;

/// Which site, and where the files go.
#[derive(Debug, Args)]
pub struct ExportArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Folder for the files
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

/// Writes histories, spectra, transfer functions, errors and values over depth as CSV, each held-out event as MCAP, the figures of the report as
/// SVG, and prints the paths.
///
/// # Errors
/// When the loop is not closed yet, or a file cannot be written.
pub fn export(arguments: &ExportArguments, json: bool) -> Result<()> {
    let workspace = Workspace::open(&arguments.site)?;
    let site = workspace.site();
    let results = Results::of(&site, &workspace.graph)?;
    let folder = |stage: &str| results.output(stage);
    let sections = &workspace.manifest.site;
    let settings = sections.records.clone().ok_or_else(|| {
        Error::new("the manifest has no `[records]`")
            .hint("a loop is closed with records: add them and run again")
            .usage()
    })?;
    let closed = Closed::read(folder, settings, sections.column())?;
    let report = folder("report").ok().map(|folder| folder.join("report.html"));
    let files = write(&closed, report.as_deref(), &arguments.output)?;
    if json {
        return write_json(&files);
    }
    files.iter().try_for_each(|file| data!("{}", file.display()))
}
