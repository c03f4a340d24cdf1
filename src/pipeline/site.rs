//! The folder of one site: which entries its stages used last, and copies of the files people look at.

use super::files::{copy_if_changed, make_dirs, remove_file, write_if_changed};
use super::{Address, Graph, Lease, Node, Store, content_hash};
use crate::error::{Context, Error, Result};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

const LAST: &str = "last.toml";
/// How the name of the file begins by which runs agree on settings.
pub(super) const SETTINGS: &str = ".settings-";
/// Folder of what was published before a run that failed.
pub(super) const EARLIER: &str = "earlier";

/// One site and where its results go.
#[derive(Debug, Clone, Copy)]
pub struct Site<'a> {
    /// Names the folder in the run directory.
    pub name: &'a str,
    /// The manifest with all defaults filled in.
    pub manifest: &'a toml::Table,
    /// Folder of the manifest: its relative paths start there.
    pub manifest_dir: &'a Path,
    /// `runs/`: holds the cache and one folder per site.
    pub run_dir: &'a Path,
}

impl Site<'_> {
    /// `<run-dir>/<site>`.
    pub fn dir(&self) -> PathBuf {
        self.run_dir.join(self.name)
    }

    /// The cache it shares with other sites.
    pub fn store(&self) -> Store {
        Store::new(self.run_dir)
    }

    /// A share in the cache and the folders of sites, from which nothing is collected while there is one; none where they cannot be written.
    pub fn lease(&self) -> Option<Lease> {
        Lease::shared(&self.store().lease_path(), || ()).ok()
    }

    /// Settings as one word, and the file on which runs of a pipeline with these stages agree on them.
    pub(super) fn settings(&self, graph: &Graph) -> Result<(PathBuf, String)> {
        let names: Vec<&str> = graph.nodes().iter().map(|node| node.name.as_str()).collect();
        let pipeline = content_hash(names.join(" ").as_bytes());
        let text = toml::to_string(self.manifest).context(|| "the manifest cannot be written as TOML".into())?;
        let file = format!("{SETTINGS}{}", pipeline.get(..8).unwrap_or(&pipeline));
        Ok((self.dir().join(file), content_hash(text.as_bytes())))
    }

    /// Moves a file of the folder of the site to `earlier`: it is not of the settings as they are. Whether there was one.
    ///
    /// # Errors
    /// When it cannot be moved.
    pub fn set_aside(&self, name: &str) -> Result<bool> {
        let (from, to) = (self.dir().join(name), self.dir().join(EARLIER).join(name));
        if !from.is_file() {
            return Ok(false);
        }
        let what = || format!("cannot move `{}` aside", from.display());
        to.parent().map_or(Ok(()), make_dirs).context(what)?;
        fs::rename(&from, &to).context(what)?;
        Ok(true)
    }

    /// Removes what was set aside of a file that is up to date again.
    ///
    /// # Errors
    /// When it cannot be removed.
    pub fn supersede(&self, name: &str) -> Result<()> {
        let earlier = self.dir().join(EARLIER).join(name);
        remove_file(&earlier)?;
        // Where there is more in it, it stays.
        let _ = earlier.parent().map(fs::remove_dir);
        Ok(())
    }

    /// Copies the files a node publishes to the folder of the site, in place of earlier ones. One that its output does not have is removed
    /// there: it would be of an earlier output.
    pub(super) fn publish(&self, node: &Node, entry: &Path) -> Result<()> {
        for (file, name) in &node.publishes {
            let (from, to) = (entry.join(file), self.dir().join(name));
            if from.is_file() {
                copy_if_changed(&from, &to)?;
            } else {
                remove_file(&to)?;
            }
            self.supersede(name)?;
        }
        Ok(())
    }
}

/// `last.toml`: stage → address of the entry it used last. Explains reruns and keeps entries from being collected.
pub(super) struct Memory {
    path: PathBuf,
    last: Mutex<BTreeMap<String, String>>,
}

impl Memory {
    /// Reads the memory of a site folder; an unreadable one is an empty one.
    pub(super) fn load(site_dir: &Path) -> Self {
        let path = site_dir.join(LAST);
        Self { last: Mutex::new(read(&path)), path }
    }

    /// Addresses in the memory of a site folder; none where there is no memory.
    ///
    /// # Errors
    /// When there is one that cannot be read: what it refers to is not known.
    pub(super) fn strict(site_dir: &Path) -> Result<Vec<Address>> {
        let path = site_dir.join(LAST);
        let what = || format!("cannot read `{}`, which says what a site uses", path.display());
        if !path.try_exists().context(what)? {
            return Ok(Vec::new());
        }
        let text = fs::read_to_string(&path).context(what)?;
        let last: BTreeMap<String, String> = toml::from_str(&text).context(what)?;
        let address = |text: &String| Address::parse(text).ok_or_else(|| Error::new(what()));
        last.values().map(address).collect()
    }

    pub(super) fn last(&self, stage: &str) -> Option<Address> {
        Address::parse(self.last.lock().unwrap_or_else(PoisonError::into_inner).get(stage)?)
    }

    /// Remembers one stage, and writes only if that is news. What another process wrote meanwhile is kept.
    pub(super) fn remember(&self, stage: &str, address: &Address) -> Result<()> {
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let text = address.to_string();
        if last.get(stage) == Some(&text) {
            return Ok(());
        }
        last.extend(read(&self.path));
        last.insert(stage.to_string(), text);
        let bytes = toml::to_string(&*last).context(|| format!("cannot write `{}`", self.path.display()))?;
        write_if_changed(&self.path, bytes.as_bytes()).map(|_| ())
    }
}

fn read(path: &Path) -> BTreeMap<String, String> {
    fs::read_to_string(path).ok().and_then(|text| toml::from_str(&text).ok()).unwrap_or_default()
}
