//! `flare-pipe run` and `flare-pipe plan`.

use super::SiteArguments;
use super::reporter::{Terminal, Verbosity, log_to, plan_line};
use super::workspace::Workspace;
use crate::error::{Context, Error, Result};
use crate::pipeline::{self, Mode, Options, Summary, write_if_changed};
use crate::progress::Quiet;
use crate::stages::correct;
use clap::{Args, ValueEnum};
use serde_json::{Map, Value, json};

/// What to run and how.
#[derive(Debug, Args)]
pub struct RunArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Run these stages and no others (repeatable)
    #[arg(long, value_name = "STAGE")]
    only: Vec<String>,
    /// Run this stage and what depends on it
    #[arg(long, value_name = "STAGE")]
    from: Option<String>,
    /// Run this stage and what it needs
    #[arg(long, value_name = "STAGE")]
    until: Option<String>,
    /// Compute a stage again although it is stored; `all` for every one (repeatable)
    #[arg(long, value_name = "STAGE|all")]
    force: Vec<String>,
    /// Only say what would run and why
    #[arg(long)]
    dry_run: bool,
    /// Stages and trajectories computed at once, and threads in all [default: one a core]
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Where ensembles are computed
    #[arg(long, value_enum, default_value = "local")]
    executor: Executor,
    /// Print decisions and outcome as JSON on stdout
    #[arg(long)]
    json: bool,
    /// Say less
    #[arg(short, long, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more
    #[arg(short, long)]
    verbose: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Executor {
    /// This machine
    Local,
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
        match self.jobs {
            Some(0) => return Err(Error::new("`--jobs` must be at least 1, got 0").usage()),
            Some(jobs) => options.jobs = jobs,
            None => {}
        }
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

/// Decides and, unless `--dry-run` says otherwise, does.
///
/// # Errors
/// Usage errors, and the first failure of a stage.
pub fn run(arguments: &RunArguments) -> Result<()> {
    if arguments.dry_run {
        return plan(arguments);
    }
    let Executor::Local = arguments.executor;
    let workspace = Workspace::open(&arguments.site)?;
    let options = arguments.options()?;
    // Only the first call in a process sets the pool; results do not depend on its size.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(options.jobs).build_global();
    let site = workspace.site();
    log_to(site.dir().join("log.txt"));
    let terminal = Terminal::new(arguments.verbosity());
    let mut summary = pipeline::run(&site, &workspace.graph, &options, Mode::Run, &terminal)?;
    publish_metrics(&workspace)?;
    publish_correction(&workspace)?;
    print_json(arguments, &summary)?;
    if summary.failures.is_empty() {
        if arguments.verbosity() > Verbosity::Quiet {
            let published = workspace.graph.nodes().iter().flat_map(|n| &n.publishes).map(|(_, name)| name);
            for (what, name) in ANSWERS.iter().filter(|(_, name)| published.clone().any(|p| p == name)) {
                let path = site.dir().join(name);
                if path.is_file() {
                    eprintln!("{what}: {}", path.display());
                }
            }
        }
        return Ok(());
    }
    let first = summary.failures.remove(0);
    for failure in &summary.failures {
        eprintln!("error: {}\n", failure.error);
    }
    Err(first.error)
}

/// Says what would run and why.
///
/// # Errors
/// Usage errors.
pub fn plan(arguments: &RunArguments) -> Result<()> {
    let workspace = Workspace::open(&arguments.site)?;
    let summary = pipeline::run(&workspace.site(), &workspace.graph, &arguments.options()?, Mode::Plan, &Quiet)?;
    if arguments.json {
        return print_json(arguments, &summary);
    }
    for decision in &summary.decisions {
        println!("{}", plan_line(decision));
    }
    Ok(())
}

fn print_json(arguments: &RunArguments, summary: &Summary) -> Result<()> {
    if arguments.json {
        let failures: Vec<Value> =
            summary.failures.iter().map(|f| json!({ "stage": f.stage, "error": f.error.to_string() })).collect();
        let outcome = json!({
            "decisions": summary.decisions, "computed": summary.computed,
            "failures": failures, "skipped": summary.skipped,
        });
        println!("{}", serde_json::to_string_pretty(&outcome).context(|| "cannot write the outcome".into())?);
    }
    Ok(())
}

/// `site.corrected.toml`: the manifest with the sections that the stage `correct` wrote, a site of its own that runs by
/// itself; gone where nothing was corrected.
fn publish_correction(workspace: &Workspace) -> Result<()> {
    let site = workspace.site();
    let Ok(folder) = pipeline::output(&site, &workspace.graph, "correct") else { return Ok(()) };
    let path = folder.join(correct::FILE);
    let text = std::fs::read_to_string(&path).context(|| format!("cannot read `{}`", path.display()))?;
    let sections: toml::Table = toml::from_str(&text).context(|| format!("`{}` is no TOML", path.display()))?;
    let published = site.dir().join("site.corrected.toml");
    if sections.iter().all(|(name, section)| workspace.table.get(name) == Some(section)) {
        if published.is_file() {
            std::fs::remove_file(&published).context(|| format!("cannot remove `{}`", published.display()))?;
        }
        return Ok(());
    }
    let mut manifest = workspace.table.clone();
    manifest.extend(sections);
    manifest.insert("name".into(), format!("{}-corrected", site.name).into());
    let head = format!(
        "# Site `{}` as its records ask for it: declared values recalibrated first, then the effects that were named.\n\
         # Written by flare-pipe.\n",
        site.name
    );
    write_if_changed(&published, (head + &manifest.to_string()).as_bytes())?;
    Ok(())
}

/// `metrics.json`: what the report stage computed, and how long each stage took whenever it ran.
pub fn publish_metrics(workspace: &Workspace) -> Result<()> {
    let site = workspace.site();
    let Ok(folder) = pipeline::output(&site, &workspace.graph, "report") else { return Ok(()) };
    let path = folder.join("metrics.json");
    let bytes = std::fs::read(&path).context(|| format!("cannot read `{}`", path.display()))?;
    let mut metrics: Map<String, Value> =
        serde_json::from_slice(&bytes).context(|| format!("`{}` is no JSON object", path.display()))?;
    let timings: Map<String, Value> = pipeline::status(&site, &workspace.graph)?
        .into_iter()
        .filter_map(|s| Some((s.stage, json!(s.seconds?))))
        .collect();
    metrics.insert("timings_s".into(), Value::Object(timings));
    let text = serde_json::to_string_pretty(&metrics).context(|| "cannot write the metrics".into())? + "\n";
    write_if_changed(&site.dir().join("metrics.json"), text.as_bytes())?;
    Ok(())
}
