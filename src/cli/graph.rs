//! `flare-pipe graph`: the pipeline as a picture in text.

use super::SiteArguments;
use super::workspace::Workspace;
use crate::error::Result;
use clap::{Args, ValueEnum};

/// Which site and in what language.
#[derive(Debug, Args)]
pub struct GraphArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Language of the graph
    #[arg(long, value_enum, default_value = "mermaid")]
    format: Language,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Language {
    /// Mermaid flow chart
    Mermaid,
    /// Graphviz
    Dot,
}

/// Prints the graph.
///
/// # Errors
/// Usage errors.
pub fn graph(arguments: &GraphArguments) -> Result<()> {
    let workspace = Workspace::open(&arguments.site)?;
    match arguments.format {
        Language::Mermaid => print!("{}", workspace.graph.mermaid()),
        Language::Dot => print!("{}", workspace.graph.dot()),
    }
    Ok(())
}
