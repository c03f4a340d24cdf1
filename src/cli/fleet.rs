//! `flare-pipe fleet` and `flare-pipe sweep`: one pipeline for many sites, or for one with many settings, on one cache.

use super::SiteArguments;
use super::jobs::{JobsArgument, start_threads};
use super::output::{data, say, write_json};
use super::publish;
use super::reporter::{clock, log_to};
use super::shard::{self, ExecutorArgument};
use super::signals::goes_on_when_run_again;
use super::workspace::{Workspace, project_root};
use crate::error::{Context, Error, Result};
use crate::numerics::threads;
use crate::pipeline::{self, Event, Mode, Options, Reporter, Results, write_if_changed};
use crate::report::{FleetRow, fleet_csv, fleet_page};
use clap::Args;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Most combinations of one sweep.
const MOST: usize = 10_000;

/// What every member shares.
#[derive(Debug, Args)]
struct Shared {
    /// Pipeline to use instead of the one each manifest names
    #[arg(long, value_name = "NAME")]
    pipeline: Option<String>,
    /// Override a value of every manifest (repeatable)
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Folder for results and cache [default: `runs` in the folder of the project]
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
    #[command(flatten)]
    jobs: JobsArgument,
    #[command(flatten)]
    executor: ExecutorArgument,
}

/// Which sites.
#[derive(Debug, Args)]
pub struct FleetArguments {
    /// Site manifests, or tables (`.csv`) with a column `site` and a column of values for each key that differs
    #[arg(value_name = "SITE", required = true)]
    sites: Vec<PathBuf>,
    #[command(flatten)]
    shared: Shared,
}

/// Which site, and what of it changes.
#[derive(Debug, Args)]
pub struct SweepArguments {
    /// Site manifest
    site: PathBuf,
    /// A key and its values, for example --over tolerances.model=0.02,0.03; every combination is run (repeatable)
    #[arg(long, value_name = "KEY=A,B,…", required = true)]
    over: Vec<String>,
    #[command(flatten)]
    shared: Shared,
}

/// One site under one set of settings.
struct Member {
    label: String,
    /// Folder of its results in the run directory, where that is not the name of its site.
    folder: Option<String>,
    settings: BTreeMap<String, String>,
    arguments: SiteArguments,
}

/// Runs one pipeline for every site; what fails stops no other.
///
/// # Errors
/// When a table cannot be read, two sites have one folder, or a site failed.
pub fn fleet(arguments: &FleetArguments, json: bool) -> Result<()> {
    let mut members = Vec::new();
    for path in &arguments.sites {
        if path.extension().is_some_and(|e| e == "csv") {
            members.extend(listed(path, &arguments.shared)?);
        } else {
            members.push(member(path.clone(), BTreeMap::new(), &arguments.shared, false));
        }
    }
    let folder = folder_of(&arguments.shared, Path::new("")).join("fleet");
    run_all(members, &arguments.shared, &folder, "Sites", json)
}

/// Runs one pipeline for every combination of settings.
///
/// # Errors
/// When a setting is none, there are too many combinations, or one of them failed.
pub fn sweep(arguments: &SweepArguments, json: bool) -> Result<()> {
    let mut all: Vec<BTreeMap<String, String>> = vec![BTreeMap::new()];
    for over in &arguments.over {
        let (key, values) = parsed(over)?;
        if all.len().saturating_mul(values.len()) > MOST {
            return Err(Error::new(format!("the sweep has more than {MOST} combinations")).usage());
        }
        let with = |known: &BTreeMap<String, String>, value: &String| {
            let mut known = known.clone();
            known.insert(key.clone(), value.clone());
            known
        };
        all = all.iter().flat_map(|known| values.iter().map(move |value| with(known, value))).collect();
    }
    let members = all.into_iter().map(|over| member(arguments.site.clone(), over, &arguments.shared, true)).collect();
    let site = arguments.site.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let manifest_dir = arguments.site.parent().unwrap_or(Path::new(""));
    let folder = folder_of(&arguments.shared, manifest_dir).join(format!("{site}.sweep"));
    run_all(members, &arguments.shared, &folder, &format!("Sweep of {site}"), json)
}

fn folder_of(shared: &Shared, dir: &Path) -> PathBuf {
    shared.run_dir.clone().unwrap_or_else(|| project_root(dir).join("runs"))
}

/// Key and values of `--over KEY=A,B`; commas within brackets, braces and quotes divide nothing.
fn parsed(over: &str) -> Result<(String, Vec<String>)> {
    let mistake = |what: String| {
        Error::new(what).hint("write `--over KEY=A,B`, for example `--over site.layer[1].vs_m_s=120,140`").usage()
    };
    let (key, rest) = over.split_once('=').ok_or_else(|| mistake(format!("`--over {over}` has no `=`")))?;
    let (mut depth, mut is_quoted, mut values) = (0i32, false, vec![String::new()]);
    for c in rest.chars() {
        match c {
            '"' | '\'' => is_quoted = !is_quoted,
            '[' | '{' if !is_quoted => depth += 1,
            ']' | '}' if !is_quoted => depth -= 1,
            ',' if !is_quoted && depth == 0 => {
                values.push(String::new());
                continue;
            }
            _ => {}
        }
        values.last_mut().unwrap_or(&mut String::new()).push(c);
    }
    let values: Vec<String> = values.into_iter().map(|v| v.trim().to_string()).collect();
    if key.trim().is_empty() || values.iter().any(String::is_empty) {
        return Err(mistake(format!("`--over {over}` has an empty key or value")));
    }
    let distinct: BTreeSet<&String> = values.iter().collect();
    if distinct.len() < values.len() {
        return Err(mistake(format!("`--over {over}` has a value twice")));
    }
    Ok((key.trim().to_string(), values))
}

/// Members of a table: the column `site` is a path from its folder, the others are keys of manifests.
fn listed(path: &Path, shared: &Shared) -> Result<Vec<Member>> {
    let what = || format!("cannot read `{}`", path.display());
    let mut reader =
        csv::ReaderBuilder::new().comment(Some(b'#')).trim(csv::Trim::All).from_path(path).context(what)?;
    let header = reader.headers().context(what)?.clone();
    let site = header.iter().position(|name| name == "site").ok_or_else(|| {
        Error::new(format!("`{}` has no column `site`", path.display()))
            .hint("its first line names the columns: `site`, and keys of manifests such as `records.dir`")
            .usage()
    })?;
    let dir = path.parent().unwrap_or(Path::new(""));
    let of = |row: csv::Result<csv::StringRecord>| {
        let row = row.context(what)?;
        let cells = header.iter().zip(&row).enumerate();
        let settings = cells.filter(|(i, (_, value))| *i != site && !value.is_empty());
        let settings: BTreeMap<String, String> = settings.map(|(_, (k, v))| (k.to_string(), v.to_string())).collect();
        let is_variant = !settings.is_empty();
        Ok(member(dir.join(&row[site]), settings, shared, is_variant))
    };
    reader.records().map(of).collect()
}

fn member(site: PathBuf, settings: BTreeMap<String, String>, shared: &Shared, is_variant: bool) -> Member {
    let own = settings.iter().map(|(key, value)| format!("{key}={value}"));
    let label: Vec<String> = own.clone().collect();
    let stem = site.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let hash = pipeline::content_hash(label.join("\n").as_bytes());
    Member {
        label: if is_variant { format!("{stem}, {}", label.join(", ")) } else { stem.clone() },
        folder: is_variant.then(|| format!("{stem}.{}", hash.get(..8).unwrap_or(&hash))),
        arguments: SiteArguments {
            site,
            pipeline: shared.pipeline.clone(),
            set: shared.set.iter().cloned().chain(own).collect(),
            run_dir: shared.run_dir.clone(),
        },
        settings,
    }
}

/// Runs all `members`, writes their table and page into `folder`, and says how each ended.
fn run_all(members: Vec<Member>, shared: &Shared, folder: &Path, title: &str, json: bool) -> Result<()> {
    let jobs = shared.jobs.or(Options::default().jobs)?;
    apart(&members)?;
    start_threads(jobs);
    goes_on_when_run_again();
    log_to(folder.join("log.txt"));
    let count = jobs.min(members.len()).max(1);
    let runner = Runner { executor: &shared.executor, jobs: jobs.div_ceil(count), folder };
    let done = AtomicUsize::new(0);
    let rows: Vec<FleetRow> = threads::on_threads(members.len(), |i| {
        let row = runner.ran(&members[i]);
        let number = done.fetch_add(1, Ordering::Relaxed) + 1;
        let outcome = row.error.as_deref().and_then(|e| e.lines().next()).or(row.verdict.as_deref()).unwrap_or("done");
        say!("[{number:3}/{}] {}: {outcome}, {}", members.len(), row.label, clock(row.stages_s));
        row
    });
    let table = fleet_csv(&rows).context(|| "the table cannot be written".into())?;
    write_if_changed(&folder.join("fleet.csv"), &table)?;
    write_if_changed(&folder.join("fleet.html"), fleet_page(title, &rows).as_bytes())?;
    if json {
        write_json(&rows)?;
    } else {
        data!("{}", folder.join("fleet.html").display())?;
        data!("{}", folder.join("fleet.csv").display())?;
    }
    let failed = rows.iter().filter(|row| row.error.is_some()).count();
    if failed == 0 {
        return Ok(());
    }
    let error = Error::new(format!("{failed} of {} runs failed", rows.len()));
    Err(error.hint("the page has the first line of each error; `flare-pipe run` of one of them says all of it"))
}

/// Refuses two members whose results would go into one folder.
fn apart(members: &[Member]) -> Result<()> {
    let mut known: BTreeMap<String, &str> = BTreeMap::new();
    for member in members {
        // What cannot be opened has no results, and its own row says why.
        let name = || Workspace::open(&member.arguments).ok().map(|w| w.site().name.to_string());
        let Some(folder) = member.folder.clone().or_else(name) else { continue };
        if let Some(other) = known.insert(folder.clone(), &member.label) {
            let what = format!("`{other}` and `{}` both have their results in the folder `{folder}`", member.label);
            return Err(Error::new(what)
                .hint("give each manifest a `name` of its own, and name each site once")
                .usage());
        }
    }
    Ok(())
}

/// How members are run.
struct Runner<'a> {
    executor: &'a ExecutorArgument,
    /// Threads of each.
    jobs: usize,
    /// Where the page goes.
    folder: &'a Path,
}

impl Runner<'_> {
    /// Runs one member to its end, whatever that is.
    fn ran(&self, member: &Member) -> FleetRow {
        let row = FleetRow { label: member.label.clone(), settings: member.settings.clone(), ..FleetRow::default() };
        self.completed(member, row.clone()).unwrap_or_else(|error| FleetRow { error: Some(error.to_string()), ..row })
    }

    fn completed(&self, member: &Member, row: FleetRow) -> Result<FleetRow> {
        let workspace = Workspace::open(&member.arguments)?.in_folder(member.folder.clone());
        let (site, graph) = (workspace.site(), &workspace.graph);
        let reporter = Warnings { label: &member.label };
        let slurm = self.executor.of(&workspace, || shard::command(&["shard"], &member.arguments, &[]))?;
        let options = Options { jobs: self.jobs, slurm, ..Options::default() };
        let summary = pipeline::run(&site, graph, &options, Mode::Run, &reporter)?;
        let _lease = site.lease();
        let results = Results::of(&site, graph)?;
        publish::publish(&workspace, &results)?;
        let stages = results.status();
        let row = FleetRow {
            stages_s: stages.iter().filter_map(|s| s.seconds).sum(),
            computed: summary.computed.len(),
            ..row
        };
        if let Some(failure) = summary.failures.into_iter().next() {
            publish::set_aside(&workspace, &results)?;
            return Ok(FleetRow { error: Some(failure.error.to_string()), ..row });
        }
        let read = |name: &str| -> Value {
            let bytes = std::fs::read(site.dir().join(name)).ok();
            bytes.and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default()
        };
        let (found, metrics) = (read("loop.json"), read("metrics.json"));
        let mut numbers = BTreeMap::new();
        for place in ["test_median_nrmse_percent", "test_median_nrmse_coherent_mean_percent", "test_measures"] {
            flattened(place, &found["summary"][place], &mut numbers);
        }
        for place in ["rest", "discretisation_share"] {
            flattened(place, &found[place], &mut numbers);
        }
        flattened("stages", &metrics["stages"], &mut numbers);
        let is_there = site.dir().join("report.html").is_file();
        let report = is_there.then(|| relative(self.folder, &site.dir().join("report.html")));
        let verdict = found["verdict"].as_str().map(String::from);
        let answer = found["answer"].as_array().into_iter().flatten();
        let answer: Vec<String> = answer.filter_map(|line| Some(line.as_str()?.to_string())).collect();
        Ok(FleetRow {
            attention: attention(&found, workspace.manifest.site.tolerances.model),
            verdict,
            answer,
            numbers,
            report,
            ..row
        })
    }
}

/// The numbers below a place, but for those in lists.
fn flattened(place: &str, value: &Value, into: &mut BTreeMap<String, f64>) {
    match value {
        Value::Number(number) => _ = number.as_f64().map(|number| into.insert(place.to_string(), number)),
        Value::Object(fields) => {
            fields.iter().for_each(|(key, value)| flattened(&format!("{place}.{key}"), value, into))
        }
        _ => {}
    }
}

/// What of an answer asks for a look, the weightiest first; `model` is the error that is declared of the column, a share.
fn attention(found: &Value, model: f64) -> Vec<String> {
    let median = |model: &str| found["summary"]["test_median_nrmse_percent"][model].as_f64();
    let verdict = found["verdict"].as_str().unwrap_or_default();
    let ended = found["declared"].as_array().into_iter().flatten();
    let ended = ended.filter(|value| value["is_at_end"] == true).count();
    let is_worse = median("corrected").zip(median("declared")).is_some_and(|(after, before)| after > before);
    let not_converged = found["discretisation_share"].as_f64().is_some_and(|share| share > model);
    [
        (verdict == "unknown").then(|| "something is there that has no name".to_string()),
        (verdict == "ambiguous").then(|| "several effects explain it alike".to_string()),
        (found["rest"]["verdict"] == "unnamed").then(|| "the rest repeats and has no name".to_string()),
        not_converged.then(|| "strong motion is not converged".to_string()),
        is_worse.then(|| "the correction is worse on held-out events".to_string()),
        (ended > 0).then(|| format!("{ended} declared values are at the end of their tolerance")),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// `to` as seen from the folder `from`, which is beside its parent.
fn relative(from: &Path, to: &Path) -> String {
    let root = from.parent().unwrap_or(Path::new(""));
    to.strip_prefix(root).map_or_else(|_| to.display().to_string(), |inside| format!("../{}", inside.display()))
}

/// Tells warnings of one member, with its label.
struct Warnings<'a> {
    label: &'a str,
}

impl Reporter for Warnings<'_> {
    fn event(&self, event: &Event<'_>) {
        if let Event::Warning { stage, text } = event {
            say!("warning: {}, {stage}: {text}", self.label);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_divided_by_commas_outside_of_brackets() {
        let values = |text| parsed(text).map(|(key, values)| (key, values.join("|"))).map_err(|e| e.to_string());
        assert_eq!(values("a.b=1,2 ,3"), Ok(("a.b".into(), "1|2|3".into())));
        assert_eq!(values("a=[1, 2],[3]"), Ok(("a".into(), "[1, 2]|[3]".into())));
        assert_eq!(values("a='x,y','z'"), Ok(("a".into(), "'x,y'|'z'".into())));
        for wrong in ["a", "a=", "=1", "a=1,,2", "a=1,1"] {
            assert!(values(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn numbers_are_found_by_place_and_lists_left_out() {
        let mut found = BTreeMap::new();
        flattened("a", &serde_json::json!({ "b": 1.5, "c": { "d": 2, "e": [3, 4], "f": null } }), &mut found);
        assert_eq!(found, BTreeMap::from([("a.b".to_string(), 1.5), ("a.c.d".to_string(), 2.0)]));
    }
}
