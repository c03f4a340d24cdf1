//! The command line: one file per command. stdout is data, stderr is for people.

mod check;
mod completions;
mod gc;
mod graph;
mod list;
mod power;
mod predict;
mod report;
mod reporter;
mod run;
mod schema;
mod show;
mod status;
mod twin;
mod twins;
mod workspace;

use crate::error::Result;
use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;

/// From a site manifest to held-out predictions of how a soil site shakes.
#[derive(Debug, Parser)]
#[command(name = "flare-pipe", version, about, max_term_width = 110)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the pipeline of a site; what is cached is not computed again
    Run(run::RunArguments),
    /// What would run and why, stage by stage
    Plan(run::RunArguments),
    /// Every problem in a manifest at once, with file, line, caret and hint
    Check(SiteArguments),
    /// State, key, time and size of each stage
    Status(status::StatusArguments),
    /// Predict the response to one new event from its base motion and a short initial window
    Predict(predict::PredictArguments),
    /// Before any data: which effects could this array and split reveal, which are confusable
    Power(power::PowerArguments),
    /// Write the records of a twin site, whose truth a manifest does not declare
    Twin(twin::TwinArguments),
    /// Diagnose many twins with drawn truths and tally the answers
    Twins(twins::TwinsArguments),
    /// Rebuild the report from cached results
    Report(SiteArguments),
    /// Print what is inside the trained model of a site
    Show(show::ShowArguments),
    /// Print the pipeline as a graph
    Graph(graph::GraphArguments),
    /// Print what a manifest can name
    List(list::ListArguments),
    /// Print the JSON Schema of a site manifest
    Schema,
    /// Remove cache entries that no site refers to
    Gc(gc::GcArguments),
    /// Print shell completions
    Completions(completions::CompletionsArguments),
}

/// A site manifest and where its results go.
#[derive(Debug, Clone, Args)]
pub struct SiteArguments {
    /// Site manifest, for example configs/lotung.toml
    site: PathBuf,
    /// Pipeline to use instead of the one the manifest names (a file of pipelines/, or a path)
    #[arg(long, value_name = "NAME")]
    pipeline: Option<String>,
    /// Override a manifest value, for example --set pretrain.latent=6 (repeatable)
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Folder for results and cache
    #[arg(long, value_name = "DIR", default_value = "runs")]
    run_dir: PathBuf,
}

/// Does what the command line asks.
///
/// # Errors
/// Whatever the command could not do.
pub fn dispatch(arguments: Arguments) -> Result<()> {
    match arguments.command {
        Command::Run(arguments) => run::run(&arguments),
        Command::Plan(arguments) => run::plan(&arguments),
        Command::Check(arguments) => check::check(&arguments),
        Command::Status(arguments) => status::status(&arguments),
        Command::Predict(arguments) => predict::predict(&arguments),
        Command::Power(arguments) => power::power(&arguments),
        Command::Twin(arguments) => twin::twin(&arguments),
        Command::Twins(arguments) => twins::twins(&arguments),
        Command::Report(arguments) => report::report(&arguments),
        Command::Show(arguments) => show::show(&arguments),
        Command::Graph(arguments) => graph::graph(&arguments),
        Command::List(arguments) => list::list(&arguments),
        Command::Schema => schema::schema(),
        Command::Gc(arguments) => gc::gc(&arguments),
        Command::Completions(arguments) => completions::completions(&arguments),
    }
}
