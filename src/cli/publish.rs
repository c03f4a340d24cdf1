//! What people look at beside what stages publish: numbers, report and corrected manifest of a site.

use super::output::say;
use super::workspace::Workspace;
use crate::error::{Context, Result};
use crate::pipeline::{Node, Results, StageStatus, write_if_changed};
use crate::report::{ExecutedStage, Execution, executed};
use crate::stages::correct;
use serde_json::{Map, Value, json};
use std::path::Path;

/// The report.
const PAGE: &str = "report.html";
const METRICS: &str = "metrics.json";
/// The corrected manifest.
const CORRECTED: &str = "site.corrected.toml";

/// Writes all of it as far as there is any.
///
/// # Errors
/// When an output cannot be read or a file not be written.
pub fn publish(workspace: &Workspace, results: &Results<'_>) -> Result<()> {
    if let Ok(folder) = results.output("report") {
        let stages = results.status();
        metrics(workspace, &folder, &stages)?;
        report(workspace, results, &folder, stages)?;
        [PAGE, METRICS].into_iter().try_for_each(|name| workspace.site().supersede(name))?;
    }
    correction(workspace, results)
}

/// Moves what is not up to date of it aside, after a run that failed.
///
/// # Errors
/// When a file cannot be moved.
pub fn set_aside(workspace: &Workspace, results: &Results<'_>) -> Result<()> {
    let site = workspace.site();
    for (stage, name) in [("report", PAGE), ("report", METRICS), ("correct", CORRECTED)] {
        if results.output(stage).is_err() && site.set_aside(name)? {
            say!("`{name}` of an earlier run moved to `earlier`");
        }
    }
    Ok(())
}

/// `site.corrected.toml`: the manifest with the sections that the stage `correct` wrote, a site of its own that runs by
/// itself; gone where nothing was corrected.
fn correction(workspace: &Workspace, results: &Results<'_>) -> Result<()> {
    let site = workspace.site();
    let Ok(folder) = results.output("correct") else { return Ok(()) };
    let path = folder.join(correct::FILE);
    let text = std::fs::read_to_string(&path).context(|| format!("cannot read `{}`", path.display()))?;
    let sections: toml::Table = toml::from_str(&text).context(|| format!("`{}` is no TOML", path.display()))?;
    let published = site.dir().join(CORRECTED);
    site.supersede(CORRECTED)?;
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

/// Whether a node makes the page that is published under this name, with how its results were computed.
pub fn is_page(node: &Node, name: &str) -> bool {
    node.name == "report" && name == PAGE
}

/// `report.html`: what the report stage wrote, and how the results in it were computed.
fn report(workspace: &Workspace, results: &Results<'_>, folder: &Path, stages: Vec<StageStatus>) -> Result<()> {
    let site = workspace.site();
    let path = folder.join(PAGE);
    let page = std::fs::read_to_string(&path).context(|| format!("cannot read `{}`", path.display()))?;
    let stage = |s: StageStatus| {
        Some(ExecutedStage {
            date: date(s.done_unix_s),
            host: s.host.unwrap_or_default(),
            duration_s: s.seconds?,
            stage: s.stage,
        })
    };
    let files = results.outside_files("records").unwrap_or_default();
    let execution = Execution {
        command: std::env::args().collect::<Vec<_>>().join(" "),
        commit: commit(site.manifest_dir),
        stages: stages.into_iter().filter_map(stage).collect(),
        files: files.into_iter().map(|file| (file.name, file.blake3.to_string())).collect(),
    };
    write_if_changed(&site.dir().join(PAGE), executed(&page, &execution).as_bytes())?;
    Ok(())
}

/// A time in seconds since 1970-01-01 UTC in words; nothing where it is not known.
fn date(unix_s: Option<u64>) -> String {
    let time = unix_s.and_then(|s| jiff::Timestamp::from_second(i64::try_from(s).ok()?).ok());
    time.map_or_else(String::new, |time| time.strftime("%Y-%m-%d %H:%M UTC").to_string())
}

/// The commit of a folder that is under version control, marked where files differ from it.
fn commit(folder: &Path) -> Option<String> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let mut git = std::process::Command::new("git");
    git.arg("-C").arg(folder).args(["describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=, with changes"]);
    let found = git.output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(found.stdout).ok()?.trim().to_string()).filter(|commit| !commit.is_empty())
}

/// `metrics.json`: what the report stage computed, and how long each stage took whenever it ran.
fn metrics(workspace: &Workspace, folder: &Path, stages: &[StageStatus]) -> Result<()> {
    let path = folder.join("metrics.json");
    let bytes = std::fs::read(&path).context(|| format!("cannot read `{}`", path.display()))?;
    let mut metrics: Map<String, Value> =
        serde_json::from_slice(&bytes).context(|| format!("`{}` is no JSON object", path.display()))?;
    let timings: Map<String, Value> =
        stages.iter().filter_map(|s| Some((s.stage.clone(), json!(s.seconds?)))).collect();
    metrics.insert("timings_s".into(), Value::Object(timings));
    let text = serde_json::to_string_pretty(&metrics).context(|| "cannot write the metrics".into())? + "\n";
    write_if_changed(&workspace.site().dir().join(METRICS), text.as_bytes())?;
    Ok(())
}
