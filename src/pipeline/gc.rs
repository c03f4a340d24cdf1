//! Removes what no site uses any more.

use super::files::{HALF_WRITTEN, list};
use super::site::{Memory, SETTINGS};
use super::{Address, Key, Lock, Outputs, Store};
use crate::error::{Context, Result};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// An entry that nothing refers to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Unused {
    /// Its address.
    pub entry: Address,
    /// What it takes on the disk, drafts and checkpoints included.
    pub bytes: u64,
    /// How long ago it was written, s; none where the clock cannot tell.
    pub age_s: Option<u64>,
    #[serde(skip)]
    paths: Vec<PathBuf>,
}

/// Everything in `<run-dir>/cache` that no site of `run_dir` used last, that is no input of that and is not among `also`, with items and
/// checkpoints of killed work. What somebody is computing is not listed.
///
/// # Errors
/// When the run directory, or what a site used last, cannot be read.
pub fn unused(run_dir: &Path, also: &[Address]) -> Result<Vec<Unused>> {
    let store = Store::new(run_dir);
    let inventory = store.inventory()?;
    let by_key = inventory.iter().map(|(entry, _)| (entry.key.clone(), entry)).collect();
    let kept = kept(run_dir, &store, also, &by_key)?;
    let mut found = Vec::new();
    for (entry, paths) in inventory.clone() {
        let is_entry = |p: &Path| p == store.dir(&entry);
        let lock_path = store.lock_path(&entry);
        let checkpoint = store.checkpoint_dir(&entry);
        // Of an entry that is there, nobody goes on with a checkpoint.
        let is_begun = |p: &Path| p == checkpoint && !store.dir(&entry).is_dir();
        let stays = |p: &Path| kept.contains(&entry) && (is_entry(p) || is_begun(p));
        let paths: Vec<_> = paths.into_iter().filter(|p| !stays(p)).collect();
        if paths.is_empty() || Lock::holder(&lock_path).is_some() {
            continue;
        }
        let written = paths.iter().filter_map(|p| fs::metadata(p).and_then(|m| m.modified()).ok()).max();
        let age = written.and_then(|t| SystemTime::now().duration_since(t).ok());
        let bytes = paths.iter().map(|p| size(p)).sum();
        found.push(Unused { entry, bytes, age_s: age.map(|a| a.as_secs()), paths });
    }
    Ok(found)
}

/// Removes `entries` as far as they are still [`unused`].
///
/// # Errors
/// When a run is at work, or something cannot be removed.
pub fn remove(run_dir: &Path, also: &[Address], entries: &[Unused]) -> Result<()> {
    let store = Store::new(run_dir);
    // What a run has begun with may be in no list yet.
    let lease = store.alone();
    if entries.is_empty() && lease.is_err() {
        return Ok(());
    }
    let _lease = lease?;
    // A run may have come and gone since they were listed.
    let still = unused(run_dir, also)?;
    for Unused { entry, paths, .. } in still.iter().filter(|s| entries.iter().any(|e| e.entry == s.entry)) {
        let lock_path = store.lock_path(entry);
        let Some(_lock) = Lock::try_acquire(&lock_path)? else { continue };
        for path in paths.iter().filter(|p| **p != lock_path) {
            let result = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
            result.context(|| format!("cannot remove `{}`", path.display()))?;
        }
    }
    remove_left_over(run_dir)
}

/// Removes what a killed run left in the folders of sites and of the cache: files that had no names yet, and what says
/// that it is at work.
fn remove_left_over(run_dir: &Path) -> Result<()> {
    let folders = |dir: &Path| -> Result<Vec<PathBuf>> {
        let entries = fs::read_dir(dir).context(|| format!("cannot read `{}`", dir.display()))?;
        Ok(entries.flatten().map(|entry| entry.path()).filter(|path| path.is_dir()).collect())
    };
    let mut all = folders(run_dir)?;
    let cache = Store::new(run_dir).root;
    if cache.is_dir() {
        all.extend(folders(&cache)?);
    }
    for file in all.iter().flat_map(|dir| fs::read_dir(dir).into_iter().flatten().flatten()) {
        let name = file.file_name().to_string_lossy().into_owned();
        if [HALF_WRITTEN, SETTINGS].iter().any(|start| name.starts_with(start)) {
            fs::remove_file(file.path()).context(|| format!("cannot remove `{}`", file.path().display()))?;
        }
    }
    Ok(())
}

/// Addresses that some site used last and those in `also`, with their items and all that these were made from.
fn kept(
    run_dir: &Path,
    store: &Store,
    also: &[Address],
    by_key: &BTreeMap<Key, &Address>,
) -> Result<BTreeSet<Address>> {
    let mut open: Vec<Address> = also.to_vec();
    let what = || format!("cannot read `{}`", run_dir.display());
    if run_dir.is_dir() {
        for site in fs::read_dir(run_dir).context(what)? {
            open.extend(Memory::strict(&site.context(what)?.path())?);
        }
    }
    let mut kept = BTreeSet::new();
    while let Some(address) = open.pop() {
        if !kept.insert(address.clone()) {
            continue;
        }
        let dir = store.dir(&address);
        if dir.is_dir() {
            let hint = "run the site again, which mends it, then collect";
            let outputs = Outputs::read(&dir).map_err(|e| e.hint(hint))?;
            open.extend(outputs.items.iter().filter_map(|item| Address::parse(&item.entry)));
        }
        if let Some(parts) = store.parts(&address) {
            open.extend(parts.inputs.values().filter_map(|key| by_key.get(key).map(|address| (*address).clone())));
        }
    }
    Ok(kept)
}

fn size(path: &Path) -> u64 {
    let bytes = |p: &Path| fs::metadata(p).map_or(0, |m| m.len());
    if path.is_dir() {
        list(path).unwrap_or_default().iter().map(|name| bytes(&path.join(name))).sum()
    } else {
        bytes(path)
    }
}
