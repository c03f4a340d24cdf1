//! `flare-pipe run` and `flare-pipe plan`.

use super::SiteArguments;
use super::jobs::{JobsArgument, start_threads};
use super::names::Names;
use super::output::{data, say, write_json};
use super::publish::{self, publish};
use super::reporter::{Terminal, Verbosity, clock, log_to, plan_line};
use super::shard::{self, ExecutorArgument};
use super::signals::goes_on_when_run_again;
use super::workspace::Workspace;
use crate::error::Result;
use crate::pipeline::{self, Action, Mode, Node, Options, Results, Summary};
use crate::progress::Quiet;
use clap::Args;
use serde_json::{Map, Value, json};
use std::path::PathBuf;

/// What to run and how.
#[derive(Debug, Args)]
pub struct RunArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Run these stages and no others (repeatable)
    #[arg(long, value_name = "STAGE", value_parser = Names::Stages, hide_possible_values = true)]
    only: Vec<String>,
    /// Run this stage and what depends on it
    #[arg(long, value_name = "STAGE", value_parser = Names::Stages, hide_possible_values = true)]
    from: Option<String>,
    /// Run this stage and what it needs
    #[arg(long, value_name = "STAGE", value_parser = Names::Stages, hide_possible_values = true)]
    until: Option<String>,
    /// Compute a stage again although it is stored; `all` for every one (repeatable)
    #[arg(long, value_name = "STAGE|all", value_parser = Names::Stages, hide_possible_values = true)]
    force: Vec<String>,
    /// Only say what would run and why
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    jobs: JobsArgument,
    #[command(flatten)]
    executor: ExecutorArgument,
    /// Say less
    #[arg(short, long, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more
    #[arg(short, long)]
    verbose: bool,
}

impl RunArguments {
    fn options(&self) -> Result<Options> {
        let mut options = Options {
            only: self.only.clone(),
            from: self.from.clone(),
            until: self.until.clone(),
            force: self.force.clone(),
            ..Options::default()
        };
        options.jobs = self.jobs.or(options.jobs)?;
        Ok(options)
    }

    fn verbosity(&self) -> Verbosity {
        match (self.quiet, self.verbose) {
            (true, _) => Verbosity::Quiet,
            (_, true) => Verbosity::Verbose,
            _ => Verbosity::Normal,
        }
    }
}

/// What a run ends with saying where it is, of what its pipeline publishes.
const ANSWERS: [(&str, &str); 2] = [("loop", "loop.json"), ("report", "report.html")];

/// What a run ends with: the answer of the loop, and the files that people look at, as far as they are of these settings.
struct Answer {
    lines: Vec<String>,
    verdict: Option<Value>,
    files: Vec<(&'static str, PathBuf)>,
}

impl Answer {
    fn of(workspace: &Workspace, results: &Results<'_>) -> Self {
        let (site, graph) = (workspace.site(), &workspace.graph);
        let is_current = |name: &str| {
            let is_publisher = |n: &&Node| n.publishes.iter().any(|(_, p)| p == name) || publish::is_page(n, name);
            let publisher = graph.nodes().iter().find(is_publisher);
            publisher.is_some_and(|node| results.output(&node.name).is_ok())
        };
        let current = ANSWERS.into_iter().filter(|(_, name)| is_current(name));
        let files: Vec<(&str, PathBuf)> = current.map(|(what, name)| (what, site.dir().join(name))).collect();
        let found = files.iter().find(|(what, _)| *what == "loop").and_then(|(_, path)| std::fs::read(path).ok());
        let found: Value = found.and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default();
        let lines =
            found["answer"].as_array().into_iter().flatten().filter_map(|line| Some(line.as_str()?.to_string()));
        Self { lines: lines.collect(), verdict: found.get("verdict").cloned(), files }
    }
}

/// Decides and, unless `--dry-run` says otherwise, does.
///
/// # Errors
/// Usage errors, and the first failure of a stage.
pub fn run(arguments: &RunArguments, json: bool) -> Result<()> {
    if arguments.dry_run {
        return plan(arguments, json);
    }
    let workspace = Workspace::open(&arguments.site)?;
    let mut options = arguments.options()?;
    options.slurm = arguments.executor.of(&workspace, || shard::command(&["shard"], &arguments.site, &[]))?;
    goes_on_when_run_again();
    start_threads(options.jobs);
    let site = workspace.site();
    log_to(site.dir().join("log.txt"));
    let terminal = Terminal::new(arguments.verbosity());
    let start = std::time::Instant::now();
    let mut summary = pipeline::run(&site, &workspace.graph, &options, Mode::Run, &terminal)?;
    let answer = {
        let _lease = site.lease();
        let results = Results::of(&site, &workspace.graph)?;
        publish(&workspace, &results)?;
        if !summary.failures.is_empty() {
            publish::set_aside(&workspace, &results)?;
        }
        Answer::of(&workspace, &results)
    };
    if json {
        print_json(&summary, Some(&answer))?;
    }
    if summary.failures.is_empty() {
        if arguments.verbosity() > Verbosity::Quiet {
            let count = summary.computed.len();
            let stages = if count == 1 { "stage" } else { "stages" };
            say!("{count} {stages} computed in {}\n", clock(start.elapsed().as_secs_f64()));
            answer.lines.iter().for_each(|line| say!("{line}"));
            answer.files.iter().for_each(|(what, path)| say!("{what}: {}", path.display()));
        }
        return Ok(());
    }
    let first = summary.failures.remove(0);
    if json {
        return Err(first.error.told());
    }
    for failure in &summary.failures {
        say!("error: {}\n", failure.error);
    }
    Err(first.error)
}

/// Says what would run and why.
///
/// # Errors
/// Usage errors.
pub fn plan(arguments: &RunArguments, json: bool) -> Result<()> {
    let workspace = Workspace::open(&arguments.site)?;
    let summary = pipeline::run(&workspace.site(), &workspace.graph, &arguments.options()?, Mode::Plan, &Quiet)?;
    if json {
        return print_json(&summary, None);
    }
    say!("pipeline: {}", workspace.pipeline);
    for decision in &summary.decisions {
        data!("{}", plan_line(decision))?;
    }
    let due = || summary.decisions.iter().filter(|d| matches!(d.action, Action::Run | Action::Wait));
    let known: Vec<f64> = due().filter_map(|d| d.last_s).collect();
    if !known.is_empty() {
        let (n, total) = (due().count(), clock(known.iter().sum()));
        let all = if known.len() == n { String::new() } else { format!(" ({} of {n} never ran)", n - known.len()) };
        say!("about {total}, one after another as they ran last{all}");
    }
    Ok(())
}

fn print_json(summary: &Summary, answer: Option<&Answer>) -> Result<()> {
    let failures: Vec<Value> = summary.failures.iter().map(|f| json!({ "stage": f.stage, "error": f.error })).collect();
    let mut outcome = json!({
        "decisions": summary.decisions, "computed": summary.computed,
        "failures": failures, "skipped": summary.skipped,
    });
    if let Some(Answer { lines, verdict, files }) = answer {
        let files: Map<String, Value> = files.iter().map(|(what, path)| ((*what).into(), json!(path))).collect();
        outcome["answer"] = json!({ "verdict": verdict, "lines": lines, "files": files });
    }
    write_json(&outcome)
}
