//! Finished outputs by key: `<run-dir>/cache/<kind>-v<version>/<key>/`.
//!
//! An entry holds what the stage wrote, `stage.toml` (the parts of its key), `outputs.toml` (its files with size and hash, its items, and
//! a seal: the hash of these and of the parts) and `timing.toml`, the only file that may differ between two computations of the same
//! entry. Entries are built in `<key>.partial` beside and renamed when everything is on the disk.

use super::files::{list, make_dirs, remove_dir, sync_dir, sync_tree};
use super::key::{Address, Parts, content_hash, file_hash, stored_hash};
use super::lock::{Lease, Owner};
use crate::error::{Context, Error, Result};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::path::{Component, Path, PathBuf};

const STAGE: &str = "stage.toml";
const OUTPUTS: &str = "outputs.toml";
const TIMING: &str = "timing.toml";

/// All entries of one run directory; any number of sites and processes share it.
#[derive(Debug, Clone)]
pub struct Store {
    pub(super) root: PathBuf,
}

/// `outputs.toml`: what an entry consists of.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Outputs {
    /// Files the stage wrote, sorted by name.
    #[serde(default, rename = "file")]
    pub files: Vec<OutputFile>,
    /// Items it computed or found, in its order.
    #[serde(default, rename = "item")]
    pub items: Vec<ItemRecord>,
}

impl Outputs {
    /// What the entry in folder `dir` says it consists of.
    ///
    /// # Errors
    /// When it does not say so legibly.
    pub(super) fn read(dir: &Path) -> Result<Self> {
        Self::unsealed(dir).map_err(|damage| Error::new(format!("`{}` is damaged: {damage}", dir.display())))
    }

    fn unsealed(dir: &Path) -> std::result::Result<Self, String> {
        let text = |name: &str| fs::read_to_string(dir.join(name)).map_err(|_| format!("`{name}` cannot be read"));
        let (sealed, parts) = (text(OUTPUTS)?, text(STAGE)?);
        let own = sealed.split_once('\n').filter(|(line, rest)| *line == seal(&parts, rest));
        let (_, rest) = own.ok_or(format!("`{OUTPUTS}` or `{STAGE}` has other content than was written"))?;
        let outputs: Self = toml::from_str(rest).map_err(|_| format!("`{OUTPUTS}` cannot be read"))?;
        let is_inside = |f: &&OutputFile| Path::new(&f.name).components().all(|c| matches!(c, Component::Normal(_)));
        match outputs.files.iter().find(|f| !is_inside(f)) {
            Some(file) => Err(format!("`{}` is not inside", file.name)),
            None => Ok(outputs),
        }
    }

    /// As it is written beside `parts`.
    fn sealed(&self, parts: &str) -> std::result::Result<String, toml::ser::Error> {
        let text = toml::to_string(self)?;
        Ok(format!("{}\n{text}", seal(parts, &text)))
    }
}

/// First line of `outputs.toml`, where the rest of it is `outputs` and `stage.toml` is `parts`.
fn seal(parts: &str, outputs: &str) -> String {
    format!("seal = \"{}\"", content_hash(format!("{parts}\0{outputs}").as_bytes()))
}

/// One file of an entry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutputFile {
    /// Name relative to the entry.
    pub name: String,
    /// Size.
    pub bytes: u64,
    /// BLAKE3 of the content, hexadecimal.
    pub blake3: String,
}

/// One item of an entry: where it lies, or why it does not.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ItemRecord {
    /// Name of the item within its stage.
    pub id: String,
    /// Address in the store.
    pub entry: String,
    /// Why there is no output.
    pub failure: Option<String>,
}

/// `timing.toml`: how an entry was computed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Wall time, s.
    pub seconds: f64,
    /// Name of the machine; empty where it was not written.
    #[serde(default)]
    pub host: String,
    /// When it was done, seconds since 1970-01-01 UTC; 0 where it was not written.
    #[serde(default)]
    pub done_unix_s: u64,
}

/// What is at an address.
#[derive(Debug, Clone, PartialEq)]
pub enum State {
    /// Nothing.
    Missing,
    /// Something that cannot be used, and why.
    Damaged(String),
    /// A finished entry.
    Sound(Outputs),
}

/// A folder in which an entry is built, locked while it is.
pub(super) struct Draft {
    pub dir: PathBuf,
    _held: File,
}

/// How closely an entry is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Depth {
    Sizes,
    Files,
    Everything,
}

/// What became of a new output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Published {
    New,
    /// The same bytes were there already and stay.
    Same,
    /// Other bytes were there, sound or not.
    Replaced,
}

impl Store {
    /// The store of `<run-dir>/cache`; nothing is made until something is stored.
    pub fn new(run_dir: &Path) -> Self {
        Self { root: run_dir.join("cache") }
    }

    /// `<run-dir>/cache`.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Folder of an entry.
    pub fn dir(&self, address: &Address) -> PathBuf {
        self.root.join(&address.folder).join(address.key.as_str())
    }

    fn beside(&self, address: &Address, ending: &str) -> PathBuf {
        self.root.join(&address.folder).join(format!("{}.{ending}", address.key))
    }

    /// Lock file of an entry, there only while somebody computes it.
    pub fn lock_path(&self, address: &Address) -> PathBuf {
        self.beside(address, "lock")
    }

    /// File that every run locks while it works, and a collection by itself.
    pub(super) fn lease_path(&self) -> PathBuf {
        self.root.join("lease")
    }

    /// The cache for whoever removes of it.
    ///
    /// # Errors
    /// When a run is at work in it.
    pub(super) fn alone(&self) -> Result<Lease> {
        Lease::alone(&self.lease_path())?.ok_or_else(|| {
            Error::new(format!("a run is at work in `{}`", self.root.display())).hint("try again when it has ended")
        })
    }

    /// File that says what became of an item in a shard on a cluster, there only while it is waited for.
    pub(super) fn mark_path(&self, address: &Address) -> PathBuf {
        self.beside(address, "mark")
    }

    /// Folder of the shards of an entry on a cluster, their job and their logs.
    pub(super) fn shards_dir(&self, address: &Address) -> PathBuf {
        self.beside(address, "slurm")
    }

    /// Folder for work in flight that survives a kill.
    pub(super) fn checkpoint_dir(&self, address: &Address) -> PathBuf {
        self.beside(address, "checkpoint")
    }

    /// An entry and all its items by presence and size of their files.
    pub fn state(&self, address: &Address) -> State {
        self.check(address, Depth::Sizes, &[])
    }

    /// An entry by content, every file being hashed, and its items by size.
    pub fn verify_files(&self, address: &Address) -> State {
        self.check(address, Depth::Files, &[])
    }

    /// An entry and all its items by content: every file is hashed, and the parts must give the key.
    pub fn verify(&self, address: &Address) -> State {
        self.check(address, Depth::Everything, &[])
    }

    /// Checks an entry that is an item of the entries `above` it.
    fn check(&self, address: &Address, depth: Depth, above: &[Address]) -> State {
        if !self.dir(address).is_dir() {
            return State::Missing;
        }
        match self.examine(address, depth, above) {
            Ok(outputs) => State::Sound(outputs),
            Err(damage) => State::Damaged(damage),
        }
    }

    fn examine(&self, address: &Address, depth: Depth, above: &[Address]) -> std::result::Result<Outputs, String> {
        let dir = self.dir(address);
        let outputs = Outputs::unsealed(&dir)?;
        let by_content = depth != Depth::Sizes;
        if by_content && self.parts(address).is_none_or(|parts| parts.address() != *address) {
            return Err(format!("`{STAGE}` does not give its key"));
        }
        for file in &outputs.files {
            let path = dir.join(&file.name);
            let bytes = fs::metadata(&path).map_err(|_| format!("no `{}`", file.name))?.len();
            if bytes != file.bytes {
                return Err(format!("`{}` has {bytes} bytes instead of {}", file.name, file.bytes));
            }
            if by_content && stored_hash(&path).ok().as_deref() != Some(file.blake3.as_str()) {
                return Err(format!("`{}` has other content than was written", file.name));
            }
        }
        let path = [above, std::slice::from_ref(address)].concat();
        // Side by side: an ensemble may have ten thousand items, each of several small files.
        let damage = |item: &ItemRecord| {
            let Some(address) = Address::parse(&item.entry) else {
                return Some(format!("item `{}` is nowhere", item.id));
            };
            if path.contains(&address) {
                return Some(format!("item `{}` holds itself", item.id));
            }
            match self.check(&address, if depth == Depth::Everything { depth } else { Depth::Sizes }, &path) {
                State::Sound(_) => None,
                State::Missing => Some(format!("item `{}` is gone", item.id)),
                State::Damaged(why) => Some(format!("item `{}`: {why}", item.id)),
            }
        };
        let computed = outputs.items.par_iter().filter(|i| i.failure.is_none());
        if let Some(damage) = computed.map(damage).find_map_first(|damage| damage) {
            return Err(damage);
        }
        Ok(outputs)
    }

    /// What an entry says it consists of, its files unchecked.
    pub fn outputs(&self, address: &Address) -> Option<Outputs> {
        Outputs::read(&self.dir(address)).ok()
    }

    /// The parts of the key of an entry, if they are readable.
    pub fn parts(&self, address: &Address) -> Option<Parts> {
        toml::from_str(&fs::read_to_string(self.dir(address).join(STAGE)).ok()?).ok()
    }

    /// How an entry was computed.
    pub fn timing(&self, address: &Address) -> Option<Timing> {
        let text = fs::read_to_string(self.dir(address).join(TIMING)).ok()?;
        toml::from_str(&text).ok()
    }

    /// How long the entry took to compute, in seconds of wall time.
    pub fn seconds(&self, address: &Address) -> Option<f64> {
        self.timing(address).map(|t| t.seconds)
    }

    /// Size of an entry with its items.
    pub fn bytes(&self, outputs: &Outputs) -> u64 {
        let own: u64 = outputs.files.iter().map(|f| f.bytes).sum();
        let item = |record: &ItemRecord| Some(self.bytes(&self.outputs(&Address::parse(&record.entry)?)?));
        own + outputs.items.iter().filter_map(item).sum::<u64>()
    }

    /// An empty folder to build the entry in. Only the holder of its lock may ask.
    pub(super) fn draft(&self, address: &Address) -> Result<Draft> {
        let dir = self.beside(address, "partial");
        let what = || format!("cannot make `{}`", dir.display());
        if let Ok(held) = File::open(&dir) {
            // Of a killed run, or of one whose lock somebody removed: that is left to end. Not every file system locks folders.
            let _ = held.lock();
        }
        remove_dir(&dir)?;
        dir.parent().map_or(Ok(()), make_dirs).and_then(|()| fs::create_dir(&dir)).context(what)?;
        let held = File::open(&dir).context(what)?;
        let _ = held.lock();
        Ok(Draft { dir, _held: held })
    }

    /// Makes a draft the entry. Only the holder of its lock may ask.
    pub(super) fn publish(&self, parts: &Parts, items: Vec<ItemRecord>, seconds: f64) -> Result<Published> {
        let address = parts.address();
        let draft = self.beside(&address, "partial");
        let what = || format!("cannot store `{address}`");
        let mut outputs = Outputs { files: Vec::new(), items };
        for name in list(&draft).context(what)? {
            if [STAGE, OUTPUTS, TIMING].contains(&name.as_str()) {
                return Err(Error::new(format!("a stage may not write `{name}`: the cache keeps its own there")));
            }
            let path = draft.join(&name);
            let bytes = fs::metadata(&path).context(what)?.len();
            outputs.files.push(OutputFile { bytes, blake3: file_hash(&path)?, name });
        }
        let dir = self.dir(&address);
        if self.verify(&address) == State::Sound(outputs.clone()) {
            remove_dir(&draft)?;
            return Ok(Published::Same);
        }
        let Owner { host, since_unix_s: done_unix_s, .. } = Owner::this_process();
        let timing = Timing { seconds, host, done_unix_s };
        let stage = toml::to_string(parts).context(what)?;
        fs::write(draft.join(OUTPUTS), outputs.sealed(&stage).context(what)?).context(what)?;
        fs::write(draft.join(STAGE), stage).context(what)?;
        fs::write(draft.join(TIMING), toml::to_string(&timing).context(what)?).context(what)?;
        sync_tree(&draft).context(what)?;
        let is_replaced = dir.exists();
        let old = self.beside(&address, "old");
        if is_replaced {
            remove_dir(&old)?;
            fs::rename(&dir, &old).context(what)?;
        }
        fs::rename(&draft, &dir).context(what)?;
        dir.parent().map_or(Ok(()), sync_dir).context(what)?;
        remove_dir(&old)?;
        Ok(if is_replaced { Published::Replaced } else { Published::New })
    }

    /// Every address of the store with what else lies there: drafts, checkpoints, remains of replaced entries.
    pub(super) fn inventory(&self) -> Result<Vec<(Address, Vec<PathBuf>)>> {
        let mut found: std::collections::BTreeMap<String, Vec<PathBuf>> = std::collections::BTreeMap::new();
        let what = || format!("cannot read `{}`", self.root.display());
        if !self.root.is_dir() {
            return Ok(Vec::new());
        }
        for folder in fs::read_dir(&self.root).context(what)? {
            let folder = folder.context(what)?;
            if !folder.file_type().context(what)?.is_dir() {
                continue;
            }
            for entry in fs::read_dir(folder.path()).context(what)? {
                let entry = entry.context(what)?;
                let name = entry.file_name().to_string_lossy().into_owned();
                let key = name.split('.').next().unwrap_or(&name);
                let address = format!("{}/{key}", folder.file_name().to_string_lossy());
                found.entry(address).or_default().push(entry.path());
            }
        }
        Ok(found.into_iter().filter_map(|(text, paths)| Some((Address::parse(&text)?, paths))).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn parts(seed: i64) -> Parts {
        let parameters = BTreeMap::from([("seed".to_string(), toml::Value::Integer(seed))]);
        Parts { kind: "toy".into(), version: 1, parameters, inputs: BTreeMap::new(), files: Vec::new() }
    }

    fn put(store: &Store, parts: &Parts, content: &str, items: Vec<ItemRecord>) -> Published {
        let draft = store.draft(&parts.address()).expect("writable").dir;
        fs::create_dir(draft.join("sub")).expect("writable");
        fs::write(draft.join("sub/a.txt"), content).expect("writable");
        store.publish(parts, items, 1.5).expect("writable")
    }

    #[test]
    fn an_entry_is_missing_then_sound_then_damaged_then_mended() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let (store, parts) = (Store::new(dir.path()), parts(1));
        let address = parts.address();
        assert_eq!(store.state(&address), State::Missing);
        assert_eq!(put(&store, &parts, "hello", vec![]), Published::New);
        assert!(matches!(store.verify(&address), State::Sound(o) if o.files.len() == 1 && store.bytes(&o) == 5));
        assert_eq!(store.parts(&address), Some(parts.clone()));
        assert_eq!(store.seconds(&address), Some(1.5));
        assert_eq!(put(&store, &parts, "hello", vec![]), Published::Same);
        let file = store.dir(&address).join("sub/a.txt");
        fs::write(&file, "hellO").expect("writable");
        assert!(matches!(store.state(&address), State::Sound(_)));
        assert_eq!(
            store.verify(&address),
            State::Damaged("`sub/a.txt` has other content than was written".to_string())
        );
        fs::write(&file, "hell").expect("writable");
        assert_eq!(store.state(&address), State::Damaged("`sub/a.txt` has 4 bytes instead of 5".to_string()));
        assert_eq!(put(&store, &parts, "hello", vec![]), Published::Replaced);
        assert!(matches!(store.verify(&address), State::Sound(_)));
        assert_eq!(fs::read_dir(store.root().join("toy-v1")).expect("readable").count(), 1);
    }

    #[test]
    fn an_entry_is_damaged_with_its_items() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let (store, item, whole) = (Store::new(dir.path()), parts(1), parts(2));
        put(&store, &item, "four", vec![]);
        let record = |failure| ItemRecord { id: "001".into(), entry: item.address().to_string(), failure };
        put(&store, &whole, "hello", vec![record(None)]);
        assert!(matches!(store.state(&whole.address()), State::Sound(o) if store.bytes(&o) == 9));
        fs::remove_dir_all(store.dir(&item.address())).expect("writable");
        assert_eq!(store.state(&whole.address()), State::Damaged("item `001` is gone".to_string()));
        put(&store, &whole, "hello", vec![record(Some("diverged".into()))]);
        assert!(matches!(store.state(&whole.address()), State::Sound(_)));
    }

    #[test]
    fn an_entry_that_holds_itself_is_damaged() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let (store, one, other) = (Store::new(dir.path()), parts(1), parts(2));
        let item = |of: &Parts| ItemRecord { id: "001".into(), entry: of.address().to_string(), failure: None };
        put(&store, &one, "hello", vec![item(&other)]);
        put(&store, &other, "hello", vec![item(&one)]);
        let damaged = "item `001`: item `001` holds itself".to_string();
        assert_eq!(store.state(&one.address()), State::Damaged(damaged.clone()));
        assert_eq!(store.verify(&other.address()), State::Damaged(damaged));
    }

    #[test]
    fn a_stage_may_not_write_the_files_of_the_cache() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let (store, parts) = (Store::new(dir.path()), parts(1));
        let draft = store.draft(&parts.address()).expect("writable").dir;
        fs::write(draft.join("stage.toml"), "x").expect("writable");
        assert!(store.publish(&parts, vec![], 0.0).is_err());
    }
}
