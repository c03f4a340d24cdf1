//! Whether what is stored is still as it was written.

use super::files::remove_dir;
use super::{Address, Graph, Lock, Outputs, Site, State, Store};
use crate::error::Result;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::Path;

/// An entry that is not as it was written.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Damage {
    /// Its address.
    pub entry: Address,
    /// What is wrong.
    pub why: String,
}

/// Entries that were looked at, and those of them that are damaged.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Verification {
    /// How many there are.
    pub entries: usize,
    /// Those that are not as they were written.
    pub damaged: Vec<Damage>,
}

/// Compares every file of every entry of the cache of `run_dir` with its hash.
///
/// # Errors
/// When the cache cannot be read.
pub fn verify_all(run_dir: &Path) -> Result<Verification> {
    let store = Store::new(run_dir);
    let all = store.inventory()?.into_iter().map(|(address, _)| address).collect();
    Ok(verified(&store, &all))
}

/// The same for what a site uses as it is, items included.
///
/// # Errors
/// When outside files of the site cannot be read.
pub fn verify_site(site: &Site<'_>, graph: &Graph) -> Result<Verification> {
    let store = site.store();
    let mut open: Vec<Address> =
        super::Results::of(site, graph)?.status().into_iter().filter_map(|stage| stage.entry).collect();
    let mut all = BTreeSet::new();
    while let Some(address) = open.pop() {
        let items = Outputs::read(&store.dir(&address)).map(|outputs| outputs.items).unwrap_or_default();
        open.extend(items.iter().filter_map(|item| Address::parse(&item.entry)).filter(|item| !all.contains(item)));
        all.insert(address);
    }
    Ok(verified(&store, &all))
}

fn verified(store: &Store, all: &BTreeSet<Address>) -> Verification {
    let all: Vec<&Address> = all.iter().filter(|address| store.dir(address).is_dir()).collect();
    let damage = |address: &&&Address| match store.verify_files(address) {
        State::Damaged(why) => Some(Damage { entry: (**address).clone(), why }),
        _ => None,
    };
    Verification { entries: all.len(), damaged: all.par_iter().filter_map(|address| damage(&address)).collect() }
}

/// Removes damaged entries, so that the next run that needs them computes them again.
///
/// # Errors
/// When a run is at work, or something cannot be removed.
pub fn discard(run_dir: &Path, damaged: &[Damage]) -> Result<()> {
    let store = Store::new(run_dir);
    let _lease = store.alone()?;
    for Damage { entry, .. } in damaged {
        let _lock = Lock::acquire(&store.lock_path(entry), |_| ())?;
        remove_dir(&store.dir(entry))?;
    }
    Ok(())
}
