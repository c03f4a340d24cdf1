//! Stages for tests: numbers, sums, and an ensemble; each tells in a file outside the cache that it ran.

use super::{Item, ItemKind, Stage, Task};
use crate::error::{Context, Error, Result};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

pub(super) const STAGES: &[&'static dyn Stage] = &[&Number, &Join, &Ensemble, &File, &Manifest];

fn put(path: &Path, text: &str) -> Result<()> {
    fs::write(path, text).context(|| format!("cannot write `{}`", path.display()))
}

fn tell(task: &Task<'_>, text: &str) -> Result<()> {
    let Some(log) = task.optional::<PathBuf>("log")? else { return Ok(()) };
    let file = fs::OpenOptions::new().create(true).append(true).open(&log);
    file.and_then(|mut f| f.write_all(format!("{text}\n").as_bytes())).context(|| "cannot tell".into())
}

/// Writes the number of its section, plus the length of `each`.
struct Number;

impl Stage for Number {
    fn kind(&self) -> &'static str {
        "number"
    }
    fn about(&self) -> &'static str {
        "writes a number"
    }
    fn version(&self) -> u32 {
        1
    }
    fn reads(&self) -> &'static [&'static str] {
        &["number"]
    }
    fn unkeyed(&self) -> &'static [&'static str] {
        &["log"]
    }
    fn run(&self, task: &Task<'_>) -> Result<()> {
        tell(task, task.name())?;
        let number: i64 = task.section("number.value")?;
        if number < 0 {
            return Err(Error::new(format!("`number.value` must not be negative, got {number}")));
        }
        assert!(number != 13, "thirteen");
        put(&task.output_dir().join("value"), &format!("{number}{}", task.each().unwrap_or_default()))
    }
}

/// Writes the values of all its inputs in a row, and publishes them.
struct Join;

impl Stage for Join {
    fn kind(&self) -> &'static str {
        "join"
    }
    fn about(&self) -> &'static str {
        "joins what its inputs wrote"
    }
    fn version(&self) -> u32 {
        1
    }
    fn reads(&self) -> &'static [&'static str] {
        &["join"]
    }
    fn unkeyed(&self) -> &'static [&'static str] {
        &["log"]
    }
    fn publishes(&self) -> &'static [&'static str] {
        &["value.txt", "extra.txt"]
    }
    fn run(&self, task: &Task<'_>) -> Result<()> {
        tell(task, task.name())?;
        let mut text: String = task.optional("join.prefix")?.unwrap_or_default();
        for (instance, path) in task.inputs("in")? {
            let value = fs::read_to_string(path.join("value")).context(|| "no value".into())?;
            text += &format!("({instance}:{value})");
        }
        if task.optional::<bool>("join.has_extra")?.unwrap_or(false) {
            put(&task.output_dir().join("extra.txt"), "extra")?;
        }
        put(&task.output_dir().join("value"), &text)?;
        put(&task.output_dir().join("value.txt"), &text)
    }
}

/// `ensemble.count` items, of which those in `ensemble.broken` have no result and `ensemble.defect` cannot be written.
struct Ensemble;

impl Stage for Ensemble {
    fn kind(&self) -> &'static str {
        "ensemble"
    }
    fn about(&self) -> &'static str {
        "computes items"
    }
    fn version(&self) -> u32 {
        1
    }
    fn reads(&self) -> &'static [&'static str] {
        &["ensemble"]
    }
    fn unkeyed(&self) -> &'static [&'static str] {
        &["log", "ensemble.defect"]
    }
    fn run(&self, task: &Task<'_>) -> Result<()> {
        let count: usize = task.section("ensemble.count")?;
        let broken: Vec<usize> = task.optional("ensemble.broken")?.unwrap_or_default();
        let item = |i: usize| Item {
            id: format!("{:03}", i + 1),
            parameters: toml::Table::from_iter([("number".to_string(), toml::Value::Integer(i as i64))]),
        };
        let items: Vec<Item> = (0..count).map(item).collect();
        let outcomes = task.items(&ItemKind::of_output("toy-item", 1), &items, |index, dir| {
            tell(task, &format!("item {index}"))?;
            if task.optional::<usize>("ensemble.defect")? == Some(index) {
                return Err(Error::new("no space left"));
            }
            if broken.contains(&index) {
                return Err(Error::new(format!("item {index} is broken")).of_model());
            }
            put(&dir.join("number"), &index.to_string())
        })?;
        let n_good = outcomes.iter().filter(|o| o.output.is_ok()).count();
        task.checkpoint_dir()?;
        put(&task.output_dir().join("value"), &format!("{n_good} of {count}"))
    }
}

/// Copies an outside file.
struct File;

impl Stage for File {
    fn kind(&self) -> &'static str {
        "file"
    }
    fn about(&self) -> &'static str {
        "copies a file"
    }
    fn version(&self) -> u32 {
        1
    }
    fn reads(&self) -> &'static [&'static str] {
        &["file"]
    }
    fn unkeyed(&self) -> &'static [&'static str] {
        &["file.path", "log"]
    }
    fn files(&self, parameters: &toml::Table, manifest_dir: &Path) -> Result<Vec<PathBuf>> {
        let path = super::parameters::lookup(parameters, "file.path").and_then(toml::Value::as_str);
        Ok(path.map(|p| manifest_dir.join(p)).into_iter().collect())
    }
    fn run(&self, task: &Task<'_>) -> Result<()> {
        tell(task, task.name())?;
        let path: PathBuf = task.section("file.path")?;
        let text = fs::read_to_string(task.manifest_dir().join(path)).context(|| "no file".into())?;
        put(&task.output_dir().join("value"), &text)
    }
}

/// Writes a manifest whose number is `corrected.value`.
struct Manifest;

impl Stage for Manifest {
    fn kind(&self) -> &'static str {
        "manifest"
    }
    fn about(&self) -> &'static str {
        "writes a corrected manifest"
    }
    fn version(&self) -> u32 {
        1
    }
    fn reads(&self) -> &'static [&'static str] {
        &["corrected", "*"]
    }
    fn run(&self, task: &Task<'_>) -> Result<()> {
        let mut manifest = task.parameters().clone();
        if let Some(corrected) = manifest.get("corrected").cloned() {
            manifest.insert("number".into(), corrected);
        }
        put(&task.output_dir().join("manifest.toml"), &manifest.to_string())
    }
}
