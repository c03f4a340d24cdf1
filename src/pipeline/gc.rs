//! Removes what no site uses any more.

use super::files::list;
use super::site::Memory;
use super::{Address, Lock, Store};
use crate::error::{Context, Result};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// An entry that was, or would be, removed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Removed {
    /// Its address.
    pub entry: Address,
    /// What it takes on the disk, drafts and checkpoints included.
    pub bytes: u64,
}

/// Removes, or with `is_dry_run` only lists, the entries of `<run-dir>/cache` that no site of `run_dir` used last, with items
/// and checkpoints of killed work. What somebody is computing stays.
///
/// # Errors
/// When the run directory cannot be read or written.
pub fn gc(run_dir: &Path, is_dry_run: bool) -> Result<Vec<Removed>> {
    let store = Store::new(run_dir);
    let kept = kept(run_dir, &store)?;
    let mut removed = Vec::new();
    for (entry, paths) in store.inventory()? {
        let is_entry = |p: &Path| p == store.dir(&entry);
        let lock_path = store.lock_path(&entry);
        let doomed: Vec<_> = paths.into_iter().filter(|p| !(is_entry(p) && kept.contains(&entry))).collect();
        if doomed.is_empty() || Lock::holder(&lock_path).is_some() {
            continue;
        }
        removed.push(Removed { bytes: doomed.iter().map(|p| size(p)).sum(), entry });
        if is_dry_run {
            continue;
        }
        let Some(_lock) = Lock::try_acquire(&lock_path)? else { continue };
        for path in doomed.iter().filter(|p| **p != lock_path) {
            let result = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
            result.context(|| format!("cannot remove `{}`", path.display()))?;
        }
    }
    Ok(removed)
}

/// Addresses that some site used last, with their items.
fn kept(run_dir: &Path, store: &Store) -> Result<BTreeSet<Address>> {
    let mut kept = BTreeSet::new();
    let what = || format!("cannot read `{}`", run_dir.display());
    if !run_dir.is_dir() {
        return Ok(kept);
    }
    for site in fs::read_dir(run_dir).context(what)? {
        for address in Memory::load(&site.context(what)?.path()).all() {
            if let Some(outputs) = store.outputs(&address) {
                kept.extend(outputs.items.iter().filter_map(|item| Address::parse(&item.entry)));
            }
            kept.insert(address);
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
