//! Reads all records a manifest names, and lists the components that are missing.

use super::record::Record;
use super::settings::{RecordSettings, Split};
use super::{FORMATS, Format, Request};
use crate::error::{Error, Result};
use crate::registry;
use rayon::prelude::*;
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

/// What was found of one component of one event.
enum Found {
    /// A sound record.
    Record(Record),
    /// This file is not there.
    Missing(PathBuf),
    /// What is there is no sound record.
    Unsound(Error),
}

/// Reads every event and component of `settings` from `dir`; `input` and `outputs` are the sensor names of the manifest.
///
/// # Errors
/// Everything that is wrong at once: the format, the folder or all components of an event are missing, or files are no sound records.
pub fn load(settings: &RecordSettings, dir: &Path, input: &str, outputs: &[String]) -> Result<Records> {
    let name = if settings.format == "twin" { "csv" } else { &settings.format };
    let format = (registry::find("record format", FORMATS, name)?.build)(settings.options.clone())
        .map_err(|e| e.at("`records.options`"))?;
    if !dir.is_dir() {
        return Err(Error::new(format!("there is no folder `{}` with records", dir.display()))
            .hint("set `records.dir` in the manifest, or `--set records.dir=PATH`"));
    }
    let all: Vec<(&str, Split, &String)> = settings
        .events()
        .flat_map(|(event, split)| settings.components.iter().map(move |component| (event, split, component)))
        .collect();
    let read = |(event, _, component): &(&str, Split, &String)| {
        let request = Request { dir, event, component, unit: settings.unit, input, outputs };
        read_one(format.as_ref(), &request)
    };
    let found: Vec<Found> = all.par_iter().map(read).collect();
    let mut read = Records { records: Vec::new(), missing: Vec::new() };
    let mut wrong = Vec::new();
    for ((event, split, component), found) in all.into_iter().zip(found) {
        match found {
            Found::Record(record) => read.records.push((split, record)),
            Found::Missing(file) => {
                read.missing.push(Missing { event: event.into(), component: component.clone(), file })
            }
            Found::Unsound(error) => wrong.push((event, error)),
        }
    }
    for (event, _) in settings.events() {
        let is_there = read.records.iter().any(|(_, r)| r.event == event) || wrong.iter().any(|(e, _)| *e == event);
        if !is_there {
            wrong.push((event, nothing_found(event, &read.missing, dir)));
        }
    }
    Error::all(wrong.into_iter().map(|(_, error)| error).collect()).map(|()| read)
}

fn read_one(format: &dyn Format, request: &Request) -> Found {
    if let Some(file) = format.files(request).into_iter().find(|f| !f.exists()) {
        return Found::Missing(file);
    }
    let place = || format!("event `{}`, component `{}`", request.event, request.component);
    let implausible = |error: Error| match format.files(request).first() {
        Some(file) => error.at(format!("`{}`", file.display())),
        None => error,
    };
    let sound = |record: Record| record.check_plausible().map(|()| record).map_err(implausible);
    match format.read(request).and_then(sound) {
        Ok(record) => Found::Record(record),
        Err(error) => Found::Unsound(error.at(place())),
    }
}

/// That none of the files of an event, which are among the `missing` ones, is in `dir`.
fn nothing_found(event: &str, missing: &[Missing], dir: &Path) -> Error {
    let files: Vec<String> = missing
        .iter()
        .filter(|m| m.event == event)
        .map(|m| format!("`{}`", m.file.strip_prefix(dir).unwrap_or(&m.file).display()))
        .collect();
    Error::new(format!("event `{event}` has no record: none of {} is in `{}`", files.join(", "), dir.display()))
        .hint("check `records.dir`, or take the event out of the split")
}
