//! The declared column under the recorded base motions: what finite elements alone predict.

use super::artifact::{read_table, write_table};
use super::records;
use crate::column::Column;
use crate::dataset::sensor_histories;
use crate::error::{Error, Result};
use crate::manifest::ColumnSections;
use crate::pipeline::{Item, Stage, Task, content_hash};
use crate::records::{Record, RecordSettings};
use std::path::Path;
use toml::Value;

/// Replays every record.
pub struct Replay;

/// Kind and version of the cache entries of single replays.
const REPLAY: (&str, u32) = ("replayed", 1);
const FILE: &str = "response_m_s2.csv";

impl Stage for Replay {
    fn kind(&self) -> &'static str {
        "replay"
    }

    fn about(&self) -> &'static str {
        "the column under the recorded base motions"
    }

    fn version(&self) -> u32 {
        2
    }

    fn reads(&self) -> &'static [&'static str] {
        &[
            "site",
            "law",
            "effects",
            "sensors",
            "analysis",
            "records.components",
            "records.train",
            "records.validation",
            "records.test",
            "records.format",
        ]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let sections: ColumnSections =
            task.parameters().clone().try_into().map_err(|e| Error::new("no column").cause(e))?;
        let settings: RecordSettings = task.section("records")?;
        let column = Column::new(&sections.profile()?, &sections.analysis)?;
        let found = records::read(task.input("records")?, &settings, &sections.sensors)?.records;
        let items: Vec<Item> = found.iter().map(|(_, record)| item(task, record)).collect();
        let depths = sections.sensors.depths_m();
        let names = sections.sensors.names();
        let outcomes = task.items(REPLAY.0, REPLAY.1, &items, |i, folder| {
            let record = &found[i].1;
            let histories = sensor_histories(&column, record.dt_s, &record.input.acceleration_m_s2, &depths)?;
            let columns: Vec<(&str, &[f64])> =
                names.iter().zip(&histories[1..]).map(|(n, h)| (n.as_str(), h.as_slice())).collect();
            write_table(&folder.join(FILE), sections.analysis.output_step_s, &columns)
        })?;
        for ((_, record), outcome) in found.iter().zip(outcomes) {
            let name = file_name(&record.event, &record.component);
            match outcome.output {
                Ok(folder) => {
                    let columns = read_table(&folder.join(FILE))?;
                    let columns: Vec<(&str, &[f64])> =
                        columns.iter().map(|(n, h)| (n.as_str(), h.as_slice())).collect();
                    write_table(&task.output_dir().join(name), sections.analysis.output_step_s, &columns)?;
                }
                Err(reason) => task.progress().note(&format!("the column did not finish {name}: {reason}")),
            }
        }
        Ok(())
    }
}

fn item(task: &Task<'_>, record: &Record) -> Item {
    let mut parameters = task.parameters().clone();
    parameters.remove("records");
    let mut bytes = record.dt_s.to_le_bytes().to_vec();
    bytes.extend(record.input.acceleration_m_s2.iter().flat_map(|a| a.to_le_bytes()));
    parameters.insert("motion".into(), Value::String(content_hash(&bytes)));
    Item { id: format!("{}.{}", record.event, record.component), parameters }
}

fn file_name(event: &str, component: &str) -> String {
    format!("{event}.{component}.csv")
}

/// The replay of one record, one history a sensor at the output step of the analysis, m/s²; `None` where the column did not
/// finish.
///
/// # Errors
/// When the table cannot be read.
pub fn read(folder: &Path, event: &str, component: &str) -> Result<Option<Vec<Vec<f64>>>> {
    let path = folder.join(file_name(event, component));
    if !path.exists() {
        return Ok(None);
    }
    Ok(Some(read_table(&path)?.into_iter().map(|(_, history)| history).collect()))
}
