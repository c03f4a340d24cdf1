//! `flare-pipe twins`: how well the diagnosis does on twins of a site whose truth is known.

use super::SiteArguments;
use super::jobs::{JobsArgument, start_threads};
use super::output::{data, write_json};
use super::reporter::{Terminal, Verbosity};
use super::shard::{self, ExecutorArgument, ShardArgument};
use super::signals::goes_on_when_run_again;
use super::workspace::Workspace;
use crate::error::{Context, Error, Result};
use crate::pipeline::{self, Graph, Mode, Options, Recipe, Results, Site};
use crate::stages::{STAGES, twins as stage};
use crate::twin::{Matrix, Report, Share, Spread, Tally};
use clap::Args;
use std::path::PathBuf;
use toml::{Table, Value};

/// Which site, what to draw and how.
#[derive(Debug, Args)]
pub struct TwinsArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Matrix file, for example configs/matrix/smoke.toml
    #[arg(long, value_name = "FILE")]
    matrix: PathBuf,
    /// Seed of all draws
    #[arg(long, value_name = "N")]
    seed: u32,
    #[command(flatten)]
    jobs: JobsArgument,
    #[command(flatten)]
    executor: ExecutorArgument,
    #[command(flatten)]
    shard: ShardArgument,
    /// Say less
    #[arg(short, long)]
    quiet: bool,
}

const RECIPE: &str = "about = 'a matrix of twins'
[[stage]]
name = 'twins'
";

/// Runs the matrix, every twin from the cache that is there, and prints the tally.
///
/// # Errors
/// Usage errors; what the stages cannot do.
pub fn twins(arguments: &TwinsArguments, json: bool) -> Result<()> {
    let mut options = Options::default();
    options.jobs = arguments.jobs.or(options.jobs)?;
    let workspace = Workspace::open(&arguments.site)?;
    if workspace.manifest.site.records.is_none() {
        let what = "the manifest has no `[records]`: which events calibrate, validate and test?";
        return Err(Error::new(what).usage());
    }
    let (matrix, truth) = Matrix::load(&arguments.matrix)?;
    let text = |e: toml::ser::Error| Error::new("the matrix cannot be written as TOML").cause(e);
    let section = Table::from_iter([
        ("matrix".to_string(), Value::try_from(&matrix).map_err(text)?),
        ("truth".to_string(), Value::try_from(&truth).map_err(text)?),
        ("seed".to_string(), Value::from(i64::from(arguments.seed))),
    ]);
    let mut table = workspace.table.clone();
    table.insert("twins".into(), Value::Table(section));
    let graph = Graph::new(&Recipe::parse(RECIPE, "twins")?, STAGES, &table)?;
    let name = format!("{}-twins", workspace.manifest.site.name);
    let site = Site { name: &name, manifest: &table, ..workspace.site() };
    start_threads(options.jobs);
    if arguments.shard.compute(&site, &graph, &options)? {
        return Ok(());
    }
    let here = std::env::current_dir().context(|| "it is not known which folder this is".into())?;
    let seed = arguments.seed.to_string();
    let more = ["--matrix".into(), here.join(&arguments.matrix).into(), "--seed".into(), seed.into()];
    options.slurm = arguments.executor.of(&workspace, || shard::command(&["twins"], &arguments.site, &more))?;
    goes_on_when_run_again();
    let verbosity = if arguments.quiet { Verbosity::Quiet } else { Verbosity::Normal };
    let summary = pipeline::run(&site, &graph, &options, Mode::Run, &Terminal::new(verbosity))?;
    if let Some(failure) = summary.failures.into_iter().next() {
        return Err(failure.error);
    }
    let report = stage::read(&Results::of(&site, &graph)?.output("twins")?)?;
    if json { write_json(&report) } else { print(&report) }
}

fn print(report: &Report) -> Result<()> {
    for (name, tally) in &report.cells {
        lines(name, tally)?;
    }
    for (name, tally) in &report.surviving {
        lines(&format!("{name}: those whose error outlives recalibration"), tally)?;
    }
    if let Some(factor) = report.inflation {
        data!("half-widths of all intervals × {factor:.2} would hold 95 % of the truths; none is applied")?;
    }
    data!("what held → what was said")?;
    for (held, answers) in &report.confusion {
        for (answer, count) in answers {
            data!("  {held:44} {count:4}  {answer}")?;
        }
    }
    for (twin, reason) in &report.failed {
        data!("  {twin} could not be computed: {}", reason.lines().next().unwrap_or_default())?;
    }
    Ok(())
}

fn lines(name: &str, tally: &Tally) -> Result<()> {
    let share = |s: &Share| {
        let percent = |v: f64| 100.0 * v;
        let [low, high] = s.ci95.map(percent);
        let value = percent(s.hits as f64 / s.of.max(1) as f64);
        format!("{:3} of {:3} = {value:5.1} % [{low:.0}, {high:.0}]", s.hits, s.of)
    };
    let spread = |s: &Option<Spread>, factor: f64| {
        s.map_or("–".into(), |s| {
            format!("median {:.3}, 90 % below {:.3} ({})", factor * s.median, factor * s.q90, s.of)
        })
    };
    data!("{name}")?;
    data!("  right class          {}", share(&tally.right_class))?;
    data!("  confident wrong      {}", share(&tally.wrong))?;
    if tally.null_alarms.of > 0 {
        data!("  null alarms          {}", share(&tally.null_alarms))?;
    }
    if let Some(incoherent) = &tally.incoherent {
        data!("  rest incoherent      {}", share(incoherent))?;
    }
    if tally.outside_right.of > 0 {
        data!("  outside, right       {}", share(&tally.outside_right))?;
    }
    data!("  interval holds truth {}", share(&tally.coverage))?;
    data!("  alarm                {}", share(&tally.alarms))?;
    data!("  unknown              {}", share(&tally.unknown))?;
    data!("  right name           {}", share(&tally.right))?;
    data!("  best single effect   {}", share(&tally.top_1))?;
    data!("  among the best three {}", share(&tally.top_3))?;
    data!("  parameter error      {}", spread(&tally.parameter_error, 1.0))?;
    data!("  corrected / floor    {}", spread(&tally.corrected_over_floor, 1.0))?;
    let nrmse = &tally.nrmse_percent;
    let percent = |v: Option<f64>| v.map_or("–".into(), |v| format!("{v:.1} %"));
    data!(
        "  held-out NRMSE       declared {}, recalibrated {}, corrected {}, floor {}",
        percent(nrmse.declared),
        percent(nrmse.recalibrated),
        percent(nrmse.corrected),
        percent(nrmse.floor)
    )
}
