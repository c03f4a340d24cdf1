//! The key of an output: a hash of everything that can change it, and of nothing else.

use super::parameters::Leaves;
use crate::error::{Context, Result};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, PoisonError};
use std::time::SystemTime;

/// Hash of [`Parts`], 32 hexadecimal digits.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Key(String);

impl Key {
    /// The digits.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The first eight digits, for people.
    pub fn short(&self) -> &str {
        self.0.get(..8).unwrap_or(&self.0)
    }
}

impl fmt::Display for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Where an output lies in the store: `<kind>-v<version>/<key>`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Address {
    /// Folder of the kind, `<kind>-v<version>`.
    pub folder: String,
    /// Key of the output.
    pub key: Key,
}

impl Address {
    /// Reads what [`fmt::Display`] writes.
    pub fn parse(text: &str) -> Option<Self> {
        let (folder, key) = text.split_once('/')?;
        let is_plain = |s: &str| !s.is_empty() && !s.contains(['/', '\\']) && !s.starts_with('.');
        (is_plain(folder) && is_plain(key)).then(|| Self { folder: folder.to_string(), key: Key(key.to_string()) })
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.folder, self.key)
    }
}

impl Serialize for Address {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// A file from outside, by content; its name only helps to explain a change.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct OutsideFile {
    /// File name without folders; not hashed.
    pub name: String,
    /// BLAKE3 of the content, hexadecimal.
    pub blake3: String,
}

impl OutsideFile {
    /// Reads and hashes `path`.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        Ok(Self { name, blake3: file_hash(path)? })
    }
}

/// Everything a key is made of; written as `stage.toml` beside the output.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parts {
    /// Kind of the stage.
    pub kind: String,
    /// Version of the stage.
    pub version: u32,
    /// Dotted manifest leaves it reads.
    pub parameters: Leaves,
    /// Role (or `role.instance`) → key of the input.
    #[serde(default)]
    pub inputs: BTreeMap<String, Key>,
    /// Outside files, in the order of the stage.
    #[serde(default, rename = "file")]
    pub files: Vec<OutsideFile>,
}

impl Parts {
    /// The key; every text is hashed with its length, so no two different parts share a hashed stream.
    pub fn key(&self) -> Key {
        let mut hash = blake3::Hasher::new_derive_key("flare-pipe stage key v1");
        let mut text = |s: &str| {
            hash.update(&(s.len() as u64).to_le_bytes());
            hash.update(s.as_bytes());
        };
        text(&self.kind);
        text(&self.version.to_string());
        text(&self.parameters.len().to_string());
        for (leaf, value) in &self.parameters {
            text(leaf);
            text(&value.to_string());
        }
        text(&self.inputs.len().to_string());
        for (role, key) in &self.inputs {
            text(role);
            text(key.as_str());
        }
        for file in &self.files {
            text(&file.blake3);
        }
        let mut digits = hash.finalize().to_hex().to_string();
        digits.truncate(32);
        Key(digits)
    }

    /// Where the output lies.
    pub fn address(&self) -> Address {
        Address { folder: format!("{}-v{}", self.kind, self.version), key: self.key() }
    }
}

/// BLAKE3 of `bytes`, hexadecimal: for item parameters that stand for data ("this base motion").
pub fn content_hash(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// BLAKE3 of a file's content, hexadecimal.
pub(super) fn file_hash(path: &Path) -> Result<String> {
    let what = || format!("cannot read `{}`", path.display());
    let mut hash = blake3::Hasher::new();
    hash.update_reader(crate::atomic::open(path).context(what)?).context(what)?;
    Ok(hash.finalize().to_hex().to_string())
}

/// The same of a stored file: one that this process has read before, and that has not been written since, is not read again.
pub(super) fn stored_hash(path: &Path) -> Result<String> {
    /// When a file was written, its size, and the hash of what it held then.
    type Known = HashMap<PathBuf, (SystemTime, u64, String)>;
    static KNOWN: LazyLock<Mutex<Known>> = LazyLock::new(Mutex::default);
    let what = || format!("cannot read `{}`", path.display());
    let known = || KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let found = std::fs::metadata(path).context(what)?;
    let written = found.modified().context(what)?;
    if let Some((_, _, hash)) = known().get(path).filter(|known| (known.0, known.1) == (written, found.len())) {
        return Ok(hash.clone());
    }
    let hash = file_hash(path)?;
    known().insert(path.to_path_buf(), (written, found.len(), hash.clone()));
    Ok(hash)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::parameters::leaves;

    fn parts(text: &str) -> Parts {
        let table: toml::Table = toml::from_str(text).expect("the text is TOML");
        Parts {
            kind: "calibrate".into(),
            version: 1,
            parameters: leaves(&table, &[]),
            inputs: BTreeMap::from([("pretrain".to_string(), Key("0".repeat(32)))]),
            files: vec![OutsideFile { name: "a.csv".into(), blake3: content_hash(b"1") }],
        }
    }

    #[test]
    fn the_order_of_the_manifest_and_names_of_files_do_not_matter_to_the_key() {
        let a = parts("x = 1\ny = 2.5");
        let mut b = parts("y = 2.5\nx = 1");
        b.files[0].name = "moved.csv".into();
        assert_eq!(a.key(), b.key());
    }

    #[test]
    fn every_part_matters_to_the_key() {
        let a = parts("x = 1");
        let mut others = vec![parts("x = 2"), parts("x = 1.0"), parts("x = '1'"), parts("z = 1")];
        let edits: [fn(&mut Parts); 5] = [
            |p| p.kind = "b".into(),
            |p| p.version = 2,
            |p| p.inputs.clear(),
            |p| p.files[0].blake3 = content_hash(b"2"),
            |p| p.files.clear(),
        ];
        for edit in edits {
            let mut b = a.clone();
            edit(&mut b);
            others.push(b);
        }
        for other in others {
            assert_ne!(a.key(), other.key(), "{other:?}");
            assert!(!other.changes_from(&a).is_empty());
        }
    }

    #[test]
    fn changes_read_as_sentences() {
        let mut now = parts("calibrate = { penalty = 0.2, kept = 1, window = 3 }");
        now.version = 2;
        now.inputs.insert("pretrain".into(), Key("1".repeat(32)));
        now.files[0].blake3 = content_hash(b"2");
        let before = parts("calibrate = { penalty = 0.1, kept = 1, old = true }");
        let text: Vec<String> = now.changes_from(&before).iter().map(ToString::to_string).collect();
        assert_eq!(
            text,
            [
                "stage version 1 → 2",
                "`calibrate.old` is gone (was true)",
                "`calibrate.penalty`: 0.1 → 0.2",
                "`calibrate.window` is new: 3",
                "input `pretrain` changed",
                "outside files changed (`a.csv`)",
            ]
        );
        assert!(before.changes_from(&before).is_empty());
    }

    #[test]
    fn parts_survive_their_file() {
        let parts = parts("a = 0.1\nb = [1.0, 2.0]\nc = 'text'\n[d]\n[[e]]\nf = 1e-9");
        let text = toml::to_string(&parts).expect("serialisable");
        let back: Parts = toml::from_str(&text).expect("readable");
        assert_eq!(back, parts);
        assert_eq!(back.key(), parts.key());
    }

    #[test]
    fn addresses_are_read_as_written() {
        let address = parts("x = 1").address();
        assert_eq!(Address::parse(&address.to_string()), Some(address));
        assert_eq!(Address::parse("../x"), None);
        assert_eq!(Address::parse("a/../../x"), None);
    }
}
