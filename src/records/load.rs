//! Reads all records a manifest names, and lists the components that are missing.

use super::record::Record;
use super::settings::{RecordSettings, Split};
use super::{FORMATS, Format, Request};
use crate::error::{Error, Result};
use crate::registry;
use std::path::{Path, PathBuf};

/// A component that an event lacks.
#[derive(Debug, Clone, PartialEq)]
pub struct Missing {
    /// Event name.
    pub event: String,
    /// Component name.
    pub component: String,
    /// The first file that is not there.
    pub file: PathBuf,
}

/// The records of a site, with the gaps.
#[derive(Debug, Clone, PartialEq)]
pub struct Records {
    /// Records with their split, in the order of the manifest (train, validation, test; component by component).
    pub records: Vec<(Split, Record)>,
    /// Components that are missing, in the same order.
    pub missing: Vec<Missing>,
}

impl Records {
    /// Records of one component and split.
    pub fn select<'a>(&'a self, component: &'a str, split: Split) -> impl Iterator<Item = &'a Record> {
        self.records.iter().filter(move |(s, r)| *s == split && r.component == component).map(|(_, r)| r)
    }
}

/// Reads every event and component of `settings` from `dir`; `input` and `outputs` are the sensor names of the manifest.
///
/// # Errors
/// When the folder or all components of an event are missing, or a file is not a sound record.
pub fn load(settings: &RecordSettings, dir: &Path, input: &str, outputs: &[String]) -> Result<Records> {
    let name = if settings.format == "twin" { "csv" } else { &settings.format };
    let format = (registry::find("record format", FORMATS, name)?.build)(settings.options.clone())
        .map_err(|e| e.at("`records.options`"))?;
    if !dir.is_dir() {
        return Err(Error::new(format!("there is no folder `{}` with records", dir.display()))
            .hint("set `records.dir` in the manifest, or `--set records.dir=PATH`"));
    }
    let mut read = Records { records: Vec::new(), missing: Vec::new() };
    for (event, split) in settings.events() {
        let before = read.records.len();
        for component in &settings.components {
            let request = Request { dir, event, component, unit: settings.unit, input, outputs };
            match read_one(format.as_ref(), &request)? {
                Ok(record) => read.records.push((split, record)),
                Err(missing) => read.missing.push(missing),
            }
        }
        if read.records.len() == before {
            return Err(nothing_found(event, &read.missing, dir));
        }
    }
    Ok(read)
}

fn read_one(format: &dyn Format, request: &Request) -> Result<std::result::Result<Record, Missing>> {
    if let Some(file) = format.files(request).into_iter().find(|f| !f.exists()) {
        let (event, component) = (request.event.to_string(), request.component.to_string());
        return Ok(Err(Missing { event, component, file }));
    }
    let place = || format!("event `{}`, component `{}`", request.event, request.component);
    let record = format.read(request).map_err(|e| e.at(place()))?;
    record.check_plausible().map_err(|error| match format.files(request).first() {
        Some(file) => error.at(format!("`{}`", file.display())).at(place()),
        None => error.at(place()),
    })?;
    Ok(Ok(record))
}

fn nothing_found(event: &str, missing: &[Missing], dir: &Path) -> Error {
    let files: Vec<String> = missing
        .iter()
        .filter(|m| m.event == event)
        .map(|m| format!("`{}`", m.file.strip_prefix(dir).unwrap_or(&m.file).display()))
        .collect();
    Error::new(format!("event `{event}` has no record: none of {} is in `{}`", files.join(", "), dir.display()))
        .hint("check `records.dir`, or take the event out of the split")
}
