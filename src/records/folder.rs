//! The files of a folder of records: in it, in a folder an event, or in `.zip` and `.tar.gz` archives.

use crate::atomic;
use crate::error::{Context, Error, Result};
use flate2::read::GzDecoder;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest file that can be a record, bytes.
pub(super) const LARGEST_BYTES: u64 = 1 << 28;
/// Most files of one archive.
const MOST_MEMBERS: usize = 100_000;

/// Endings of the names of archives.
const ARCHIVES: [&str; 3] = [".zip", ".tar.gz", ".tgz"];

/// One file.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Source {
    /// Its name without folders.
    pub name: String,
    /// Where it is; the archive, where it is in one.
    pub path: PathBuf,
    /// Folder or archive by which it may belong to an event.
    group: Option<String>,
    /// Its place in the archive.
    member: Option<usize>,
}

impl Source {
    /// What an event of this file alone, or of its folder or archive, may be called.
    pub fn event(&self) -> &str {
        let name = self.group.as_deref().unwrap_or(&self.name);
        let archive = ARCHIVES.iter().find_map(|ending| name.strip_suffix(ending));
        match &self.group {
            Some(_) => archive.unwrap_or(name),
            None => name.split('.').next().unwrap_or(name),
        }
    }

    /// Its bytes.
    ///
    /// # Errors
    /// When it cannot be read, or is larger than a record can be.
    pub fn bytes(&self) -> Result<Vec<u8>> {
        let place = || format!("cannot read `{}`", self.shown());
        let read = |from: &mut dyn Read| {
            let mut bytes = Vec::new();
            from.take(LARGEST_BYTES + 1).read_to_end(&mut bytes).context(place)?;
            if bytes.len() as u64 > LARGEST_BYTES {
                let what = format!("`{}` is larger than {} MiB", self.shown(), LARGEST_BYTES >> 20);
                return Err(Error::new(what).hint("a record is smaller: take the file out of the folder"));
            }
            Ok(bytes)
        };
        let file = atomic::open(&self.path).context(place)?;
        let Some(member) = self.member else { return read(&mut { file }) };
        if is_zip(&self.path) {
            let mut archive = zip::ZipArchive::new(file).context(place)?;
            let mut entry = archive.by_index(member).context(place)?;
            return read(&mut entry);
        }
        let mut archive = tar::Archive::new(GzDecoder::new(file));
        let mut entry = archive
            .entries()
            .context(place)?
            .nth(member)
            .ok_or_else(|| Error::new(place()).hint("the archive changed while it was read: run again"))?
            .context(place)?;
        read(&mut entry)
    }

    /// Its path, with that of its archive.
    pub fn shown(&self) -> String {
        match self.member {
            Some(_) => format!("{}:{}", self.path.display(), self.name),
            None => self.path.display().to_string(),
        }
    }
}

fn is_zip(path: &Path) -> bool {
    has_ending(path, &[".zip"])
}

fn is_archive(path: &Path) -> bool {
    has_ending(path, &ARCHIVES)
}

fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
    endings.iter().any(|ending| name.ends_with(ending))
}

/// All files of a folder.
#[derive(Debug)]
pub struct Folder {
    sources: Vec<Source>,
}

impl Folder {
    /// Lists `dir`, the folders in it, and the archives in both.
    ///
    /// # Errors
    /// When a folder or an archive cannot be read.
    pub fn open(dir: &Path) -> Result<Self> {
        if !dir.is_dir() {
            return Err(Error::new(format!("there is no folder `{}` with records", dir.display()))
                .hint("set `records.dir` in the manifest, or `--set records.dir=PATH`"));
        }
        let mut sources = Vec::new();
        for path in entries(dir)? {
            if path.is_dir() {
                let group = path.file_name().map(|name| name.to_string_lossy().into_owned());
                for inside in entries(&path)?.into_iter().filter(|path| path.is_file()) {
                    add(&inside, group.clone(), &mut sources)?;
                }
            } else if path.is_file() {
                add(&path, None, &mut sources)?;
            }
        }
        sources.sort();
        Ok(Self { sources })
    }

    /// The files of an event whose files, folder or archive are named by `stem`: it comes first, and no letter or digit after it.
    pub fn of_event(&self, stem: &str) -> Vec<&Source> {
        let begins = |name: &str| {
            let rest = name.strip_prefix(stem)?;
            (!rest.starts_with(|c: char| c.is_alphanumeric())).then_some(())
        };
        let belongs = |s: &&Source| begins(&s.name).or_else(|| s.group.as_deref().and_then(begins)).is_some();
        self.sources.iter().filter(belongs).collect()
    }

    /// All of them, by name and path.
    pub fn sources(&self) -> &[Source] {
        &self.sources
    }
}

fn entries(dir: &Path) -> Result<Vec<PathBuf>> {
    let place = || format!("cannot read the folder `{}`", dir.display());
    let paths = std::fs::read_dir(dir).context(place)?.map(|entry| entry.map(|e| e.path()));
    paths.collect::<std::io::Result<_>>().context(place)
}

fn add(path: &Path, group: Option<String>, sources: &mut Vec<Source>) -> Result<()> {
    let Some(name) = path.file_name().map(|name| name.to_string_lossy().into_owned()) else { return Ok(()) };
    if !is_archive(path) {
        sources.push(Source { name, path: path.into(), group, member: None });
        return Ok(());
    }
    let place = || format!("cannot read the archive `{}`", path.display());
    let file = File::open(path).context(place)?;
    let mut members: Vec<(usize, String)> = Vec::new();
    if is_zip(path) {
        let mut archive = zip::ZipArchive::new(file).context(place)?;
        for index in 0..archive.len().min(MOST_MEMBERS) {
            let entry = archive.by_index_raw(index).context(place)?;
            if entry.is_file() {
                members.push((index, entry.name().context(place)?.into_owned()));
            }
        }
    } else {
        let mut archive = tar::Archive::new(GzDecoder::new(file));
        for (index, entry) in archive.entries().context(place)?.take(MOST_MEMBERS).enumerate() {
            let entry = entry.context(place)?;
            if entry.header().entry_type().is_file() {
                members.push((index, entry.path().context(place)?.to_string_lossy().into_owned()));
            }
        }
    }
    let group = group.unwrap_or(name);
    for (index, member) in members {
        let name = member.rsplit(['/', '\\']).next().unwrap_or(&member).to_string();
        sources.push(Source { name, path: path.into(), group: Some(group.clone()), member: Some(index) });
    }
    Ok(())
}
