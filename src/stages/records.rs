//! The records of the site: read from files, or recorded at a twin of the site.

use super::artifact::write_json;
use super::instrument::{Instrument, by_event};
use crate::effects::{self, Tolerances};
use crate::error::{Error, Result};
use crate::manifest::{ColumnSections, SensorsSection};
use crate::pipeline::{Stage, Task};
use crate::records::{self, Record, RecordSettings};
use crate::twin::{self, Truth};
use crate::units::AccelerationUnit;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use toml::Table;

/// Collects the records in one form.
pub struct Records;

impl Stage for Records {
    fn kind(&self) -> &'static str {
        "records"
    }

    fn about(&self) -> &'static str {
        "measured records from files (altered by a truth, where one is given), or synthetic ones of a twin site, in m/s²"
    }

    fn version(&self) -> u32 {
        9
    }

    fn reads(&self) -> &'static [&'static str] {
        &["site", "law", "sensors", "tolerances", "analysis", "records"]
    }

    fn unkeyed(&self) -> &'static [&'static str] {
        &["records.dir", "records.truth"]
    }

    fn files(&self, parameters: &Table, _: &Path) -> Result<Vec<PathBuf>> {
        let settings: RecordSettings = section(parameters, "records")?;
        let mut files: Vec<PathBuf> = settings.truth.iter().flat_map(|truth| Truth::files(Path::new(truth))).collect();
        if settings.format == "twin" {
            return Ok(files);
        }
        files.extend(records::files(&settings, Path::new(settings.dir.as_deref().unwrap_or_default()))?);
        Ok(files)
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let settings: RecordSettings = task.section("records")?;
        let (found, missing) = if settings.format == "twin" {
            (twin_records(task, &settings)?, Vec::new())
        } else {
            let read = measured(&settings, &column(task)?)?;
            (read.records.into_iter().map(|(_, r)| r).collect(), read.missing)
        };
        for record in &found {
            records::csv::write(task.output_dir(), record, AccelerationUnit::MetrePerSecondSquared, &["unit: m/s2"])?;
        }
        let gaps: Vec<[&str; 2]> = missing.iter().map(|m| [m.event.as_str(), m.component.as_str()]).collect();
        for [event, component] in &gaps {
            task.progress().note(&format!("event {event} has no component {component}"));
        }
        write_json(&task.output_dir().join("missing.json"), &gaps)
    }
}

fn section<T: serde::de::DeserializeOwned>(parameters: &Table, name: &str) -> Result<T> {
    let value = parameters.get(name).cloned().ok_or_else(|| {
        Error::new(format!("the manifest has no `[{name}]`")).hint("calibration needs measured or twin records").usage()
    })?;
    value.try_into().map_err(|e: toml::de::Error| Error::new(e.message().to_string()).usage())
}

fn twin_records(task: &Task<'_>, settings: &RecordSettings) -> Result<Vec<Record>> {
    let truth = Truth::load(Path::new(settings.truth.as_deref().unwrap_or_default()))?;
    let sections = column(task)?;
    let recorder = twin::recorder(&sections, &task.section::<Tolerances>("tolerances")?, &truth)?;
    let events: Vec<&str> = settings.events().map(|(event, _)| event).collect();
    task.progress().start("twin events", events.len() as u64);
    let records: Vec<Vec<Record>> = events
        .par_iter()
        .map(|event| {
            let records = twin::record_event(&recorder, event, &settings.components)?;
            task.progress().advance(1);
            Ok(records)
        })
        .collect::<Result<_>>()?;
    Ok(records.into_iter().flatten().collect())
}

/// The records in the files that `settings` name; where these name a truth too, as its sensors would have recorded what was
/// measured.
///
/// # Errors
/// When a file is not a sound record, or the truth holds more than effects between the ground and the record.
pub fn measured(settings: &RecordSettings, sections: &ColumnSections) -> Result<records::Records> {
    let dir = Path::new(settings.dir.as_deref().unwrap_or_default());
    let mut read = records::load(settings, dir, &sections.sensors.input, &sections.sensors.names())?;
    if let Some(path) = &settings.truth {
        let truth = Truth::load(Path::new(path))?;
        let checked = truth.check_alters().and_then(|()| {
            effects::check(&truth.effects, &sections.array(&settings.components)?)?;
            Instrument::new(&sections.sensors, sections.site.depth_m, &truth.effects)
        });
        let instrument = checked.map_err(|e| e.at(format!("`{path}`")))?;
        let altered = |(split, records): (_, Vec<Record>)| {
            instrument.distorted(&records).into_iter().map(move |record| (split, record)).collect::<Vec<_>>()
        };
        read.records = by_event(read.records).into_iter().flat_map(altered).collect();
    }
    Ok(read)
}

/// The sections that make the column, of a stage that reads them.
///
/// # Errors
/// When one is missing.
pub fn column(task: &Task<'_>) -> Result<ColumnSections> {
    task.parameters().clone().try_into().map_err(|e| Error::new("no column").cause(e))
}

/// The settings of a stage that may not open the held-out events: their list is empty.
///
/// # Errors
/// When the manifest has no records.
pub fn settings_without_test(task: &Task<'_>) -> Result<RecordSettings> {
    let mut settings: Table = task.section("records")?;
    settings.insert("test".into(), toml::Value::Array(Vec::new()));
    settings.try_into().map_err(|e: toml::de::Error| Error::new(e.message().to_string()).usage())
}

/// The records that stage left in `folder`, with their split.
///
/// # Errors
/// When they cannot be read.
pub fn read(folder: &Path, settings: &RecordSettings, sensors: &SensorsSection) -> Result<records::Records> {
    let stored = RecordSettings {
        format: "csv".into(),
        unit: Some(AccelerationUnit::MetrePerSecondSquared),
        channels: Default::default(),
        options: Table::new(),
        ..settings.clone()
    };
    records::load(&stored, folder, &sensors.input, &sensors.names())
}
