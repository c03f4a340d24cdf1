//! `flare-pipe gc`: removes what no site refers to.

use super::SiteArguments;
use super::output::{data, say, write_json};
use super::reporter::clock;
use super::workspace::{Workspace, results_folder};
use crate::error::{Context, Error, Result};
use crate::pipeline::{self, Address, Results, Unused};
use crate::stages::STAGES;
use clap::Args;
use serde_json::json;
use std::io::{BufRead, IsTerminal, Write};
use std::path::{Path, PathBuf};

/// Where, and whether only to say.
#[derive(Debug, Args)]
pub struct GcArguments {
    /// Folder for results and cache [default: `runs` in the folder of the project]
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
    /// Only what was written so many days ago or earlier
    #[arg(long, value_name = "DAYS", default_value_t = 0)]
    older_than: u64,
    /// Only list what would be removed
    #[arg(long)]
    dry_run: bool,
    /// Do not ask
    #[arg(long)]
    yes: bool,
}

const A_DAY_S: u64 = 86_400;
/// Folders below that of a project in which manifests are looked for.
const DEPTH: usize = 6;

/// Lists cache entries that neither a manifest of the project nor what was run last refers to, asks, and removes them.
///
/// # Errors
/// When the run directory cannot be read or written, a run is at work in it, or nobody can be asked.
pub fn gc(arguments: &GcArguments, as_json: bool) -> Result<()> {
    let run_dir = results_folder(arguments.run_dir.as_deref())?;
    let Needed { entries: needed, is_unfinished } = needed(run_dir.parent().unwrap_or(Path::new("")), &run_dir)?;
    let mut unused = pipeline::unused(&run_dir, &needed)?;
    if is_unfinished {
        // What an ensemble has done so far is in no list before it is whole.
        let is_stage = |entry: &Address| STAGES.iter().any(|s| entry.folder.starts_with(&format!("{}-v", s.kind())));
        unused.retain(|unused| is_stage(&unused.entry));
    }
    // What the clock has in the future may be of a minute ago.
    let is_old = |age_s: u64| age_s / A_DAY_S >= arguments.older_than;
    unused.retain(|unused| unused.age_s.map_or(arguments.older_than == 0, is_old));
    let megabytes = |bytes: u64| format!("{:.1} MB", bytes as f64 / 1e6);
    let total = megabytes(unused.iter().map(|r| r.bytes).sum());
    if !as_json {
        for Unused { entry, bytes, age_s, .. } in &unused {
            let age = age_s.map_or("–".into(), age);
            data!("{:24} {}  {:>10}  {age:>12} old", entry.folder, entry.key.short(), megabytes(*bytes))?;
        }
    }
    let is_asked = !arguments.dry_run && !arguments.yes && !unused.is_empty();
    let is_removed = !arguments.dry_run && (!is_asked || confirmed(unused.len(), &total)?);
    if is_removed {
        pipeline::remove(&run_dir, &needed, &unused)?;
    }
    if as_json {
        return write_json(&json!({ "is_removed": is_removed, "entries": unused }));
    }
    let verb = if is_removed { "removed" } else { "not removed" };
    say!("{} entries, {total}, {verb}", unused.len());
    Ok(())
}

fn age(seconds: u64) -> String {
    match seconds / A_DAY_S {
        0 => clock(seconds as f64),
        1 => "1 day".into(),
        days => format!("{days} days"),
    }
}

fn confirmed(count: usize, total: &str) -> Result<bool> {
    let stdin = std::io::stdin();
    if !stdin.is_terminal() {
        let hint = "`--yes` removes them, `--dry-run` only lists them";
        return Err(Error::new(format!("nobody can be asked whether to remove {count} entries")).hint(hint).usage());
    }
    let _ = write!(std::io::stderr(), "Remove these {count} entries, {total}? [y/N] ");
    let mut answer = String::new();
    stdin.lock().read_line(&mut answer).context(|| "cannot read the answer".into())?;
    Ok(["y", "yes"].contains(&answer.trim().to_lowercase().as_str()))
}

/// What manifests of the project lead to.
struct Needed {
    entries: Vec<Address>,
    /// Whether some of that was begun and is not there yet.
    is_unfinished: bool,
}

/// What manifests of the project lead to as they are. A site of which nothing was ever run leads nowhere.
///
/// # Errors
/// When that is not known of a site that was run.
fn needed(root: &Path, run_dir: &Path) -> Result<Needed> {
    let mut needed = Needed { entries: Vec::new(), is_unfinished: false };
    for site in manifests(root, DEPTH) {
        let place = site.display().to_string();
        let arguments = SiteArguments { site, pipeline: None, set: Vec::new(), run_dir: Some(run_dir.to_path_buf()) };
        // What is no manifest, or none that is right, leads nowhere.
        let Ok(workspace) = Workspace::open(&arguments) else { continue };
        if !workspace.site().dir().is_dir() {
            continue;
        }
        let site = workspace.site();
        let stages = Results::of(&site, &workspace.graph).map_err(|e| e.at(format!("`{place}`")))?.status();
        needed.is_unfinished |= stages.iter().any(|stage| stage.state != "cached");
        needed.entries.extend(stages.into_iter().filter_map(|stage| stage.entry));
    }
    Ok(needed)
}

fn manifests(folder: &Path, depth: usize) -> Vec<PathBuf> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let mut found = Vec::new();
    for path in std::fs::read_dir(folder).into_iter().flatten().filter_map(|e| Some(e.ok()?.path())) {
        let is_hidden = path.file_name().is_none_or(|name| name.to_string_lossy().starts_with('.'));
        if path.is_dir() && !is_hidden && depth > 0 && !path.join("cache").is_dir() {
            found.extend(manifests(&path, depth - 1));
        } else if path.extension().is_some_and(|e| e == "toml") {
            found.push(path);
        }
    }
    found
}
