//! The command line: one file per command. stdout is data, stderr is for people.

mod check;
mod completions;
mod export;
mod fleet;
mod gc;
mod graph;
mod init;
mod jobs;
mod list;
mod names;
mod output;
mod power;
mod predict;
mod publish;
mod records;
mod report;
mod reporter;
mod run;
mod schema;
mod shard;
mod show;
mod signals;
mod status;
mod twin;
mod twins;
mod verify;
mod workspace;

pub use output::tell;
pub use signals::stop_on_signals;

use crate::error::Result;
use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;

/// From a site manifest to held-out predictions of how a soil site shakes.
#[derive(Debug, Parser)]
#[command(name = "flare-pipe", version, about, max_term_width = 110)]
pub struct Arguments {
    /// Print the result, or what went wrong, as JSON on stdout
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

impl Arguments {
    /// Whether results and errors are to be JSON.
    pub fn json(&self) -> bool {
        self.json
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Write the first manifest of a site, from a profile and a folder of records
    Init(init::InitArguments),
    /// Run the pipeline of a site; what is cached is not computed again
    Run(run::RunArguments),
    /// Run one pipeline for many sites on one cache; a page and a table of all
    Fleet(fleet::FleetArguments),
    /// Run one pipeline for a site under every combination of settings; a page and a table of all
    Sweep(fleet::SweepArguments),
    /// What would run and why, stage by stage
    Plan(run::RunArguments),
    /// Every problem in a manifest at once, with file, line, caret and hint
    Check(SiteArguments),
    /// What is in the record files: step, length, peaks, band with signal, and what is odd
    Records(SiteArguments),
    /// State, key, time and size of each stage
    Status(SiteArguments),
    /// Predict the response to one new event from its base motion and a short initial window
    Predict(predict::PredictArguments),
    /// Write the results of a site as CSV and MCAP for other programs
    Export(export::ExportArguments),
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
    /// Print the JSON Schema of a file that people write, for editors
    Schema {
        /// Which file
        #[arg(value_enum, default_value = "site")]
        of: schema::SchemaOf,
    },
    /// Compute one shard of an ensemble; called by jobs on a cluster
    #[command(hide = true)]
    Shard(shard::ShardArguments),
    /// Compare what is stored with its hashes, and mend it
    Verify(verify::VerifyArguments),
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
    /// Folder for results and cache [default: `runs` in the folder of the project, which is the nearest one up from the manifest that
    /// has `pipelines` or results, or its own]
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
}

/// Does what the command line asks.
///
/// # Errors
/// Whatever the command could not do.
pub fn dispatch(arguments: Arguments) -> Result<()> {
    let json = arguments.json;
    match arguments.command {
        Command::Init(arguments) => init::init(&arguments, json),
        Command::Run(arguments) => run::run(&arguments, json),
        Command::Fleet(arguments) => fleet::fleet(&arguments, json),
        Command::Sweep(arguments) => fleet::sweep(&arguments, json),
        Command::Plan(arguments) => run::plan(&arguments, json),
        Command::Check(arguments) => check::check(&arguments, json),
        Command::Records(arguments) => records::records(&arguments, json),
        Command::Status(arguments) => status::status(&arguments, json),
        Command::Predict(arguments) => predict::predict(&arguments, json),
        Command::Export(arguments) => export::export(&arguments, json),
        Command::Power(arguments) => power::power(&arguments, json),
        Command::Twin(arguments) => twin::twin(&arguments, json),
        Command::Twins(arguments) => twins::twins(&arguments, json),
        Command::Report(arguments) => report::report(&arguments, json),
        Command::Show(arguments) => show::show(&arguments, json),
        Command::Graph(arguments) => graph::graph(&arguments, json),
        Command::List(arguments) => list::list(&arguments, json),
        Command::Schema { of } => schema::schema(of),
        Command::Shard(arguments) => shard::shard(&arguments),
        Command::Verify(arguments) => verify::verify(&arguments, json),
        Command::Gc(arguments) => gc::gc(&arguments, json),
        Command::Completions(arguments) => completions::completions(&arguments),
    }
}
