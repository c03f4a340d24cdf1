//! `flare-pipe graph`: the pipeline as a picture in text.

use super::SiteArguments;
use super::output::{data, write_json};
use super::workspace::Workspace;
use crate::error::Result;
use crate::pipeline::Node;
use clap::{Args, ValueEnum};
use serde_json::{Value, json};

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
pub fn graph(arguments: &GraphArguments, json: bool) -> Result<()> {
    let workspace = Workspace::open(&arguments.site)?;
    if json {
        let nodes = workspace.graph.nodes();
        let inputs = |n: &Node| n.dependencies().into_iter().map(|i| nodes[i].name.clone()).collect::<Vec<_>>();
        let node = |n: &Node| json!({ "stage": n.name, "kind": n.stage.kind(), "after": inputs(n) });
        return write_json(&nodes.iter().map(node).collect::<Vec<Value>>());
    }
    match arguments.format {
        Language::Mermaid => data!("{}", workspace.graph.mermaid().trim_end()),
        Language::Dot => data!("{}", workspace.graph.dot().trim_end()),
    }
}
