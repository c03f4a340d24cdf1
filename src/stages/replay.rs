//! The column of a manifest under the recorded base motions: what finite elements alone say the sensors record.

use super::artifact::{read_table, write_table};
use super::instrument::{Instrument, by_event};
use super::records;
use super::shake::{BaseMotion, Response, shake};
use crate::effects::{Channels, Situation};
use crate::error::Result;
use crate::manifest::ColumnSections;
use crate::numerics::resample::resample_band_limited;
use crate::pipeline::{Stage, Task};
use crate::records::{Record, RecordSettings};
use std::path::Path;

/// Replays every record.
pub struct Replay;

impl Stage for Replay {
    fn kind(&self) -> &'static str {
        "replay"
    }

    fn about(&self) -> &'static str {
        "the column under the recorded base motions, as its sensors would record it"
    }

    fn version(&self) -> u32 {
        9
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
        let sections: ColumnSections = records::column(task)?;
        let settings: RecordSettings = task.section("records")?;
        let instrument = Instrument::of(task)?;
        let found = records::read(task.input("records")?, &settings, &sections.sensors)?.records;
        let events: Vec<Vec<Record>> = by_event(found).into_iter().map(|(_, records)| records).collect();
        let step_s = sections.analysis.output_step_s;
        let names = sections.sensors.names();
        let records = events.iter().flatten();
        let responses = replayed(Some(task), &sections, &instrument, &settings, &events)?;
        for (record, response) in records.zip(responses) {
            let name = file_name(&record.event, &record.component);
            match response {
                Ok(outputs) => {
                    let columns: Vec<(&str, &[f64])> =
                        names.iter().zip(&outputs).map(|(n, h)| (n.as_str(), h.as_slice())).collect();
                    write_table(&task.output_dir().join(name), step_s, &columns)?;
                }
                Err(reason) => task.progress().warn(&format!("the column did not finish {name}: {reason}")),
            }
        }
        Ok(())
    }
}

/// What the array of `sections` would record of the column under the motions of `events`, record after record at the output
/// step of the analysis.
///
/// # Errors
/// When the column cannot be built or the cache cannot be read or written.
pub fn replayed(
    task: Option<&Task<'_>>,
    sections: &ColumnSections,
    instrument: &Instrument,
    settings: &RecordSettings,
    events: &[Vec<Record>],
) -> Result<Vec<Response>> {
    let undone: Vec<Vec<Record>> = events.iter().map(|records| instrument.undone(records)).collect();
    let motions = base_motions(&undone, settings);
    let mut shaken = shake(task, sections, instrument.effects(), &motions)?.into_iter();
    let step_s = sections.analysis.output_step_s;
    let mut all = Vec::with_capacity(motions.len());
    for (records, undone) in events.iter().zip(&undone) {
        let responses: Vec<Response> = shaken.by_ref().take(records.len()).collect();
        all.extend(as_recorded(instrument, records, undone, responses, step_s));
    }
    Ok(all)
}

/// The true motions of the input sensor, record after record, with their place in the history of **all** events: those
/// held out count by name alone.
pub fn base_motions<'a>(events: &'a [Vec<Record>], settings: &RecordSettings) -> Vec<BaseMotion<'a>> {
    let situation = |record: &Record| {
        let component = settings.components.iter().position(|c| *c == record.component).unwrap_or(0);
        Situation::of(component, &record.event, settings.events().map(|(event, _)| event))
    };
    let motion = |record: &'a Record| BaseMotion {
        id: format!("{}.{}", record.event, record.component),
        situation: situation(record),
        dt_s: record.dt_s,
        acceleration_m_s2: &record.input.acceleration_m_s2,
    };
    events.iter().flatten().map(motion).collect()
}

/// What the output sensors would record of the `responses` of the components of one event. A component without a response
/// lends its record to the others.
fn as_recorded(
    instrument: &Instrument,
    records: &[Record],
    undone: &[Record],
    responses: Vec<Response>,
    step_s: f64,
) -> Vec<Response> {
    let n_step = responses.iter().flatten().flatten().map(Vec::len).min().unwrap_or(0);
    let fitted = |history: &[f64], dt_s: f64| {
        let mut history = resample_band_limited(history, dt_s, step_s);
        history.resize(n_step, 0.0);
        history
    };
    let n_output = records.first().map_or(0, |r| r.outputs.len());
    let mut motions: Vec<Channels> = vec![Vec::new(); n_output + 1];
    for (record, response) in undone.iter().zip(&responses) {
        motions[0].push(fitted(&record.input.acceleration_m_s2, record.dt_s));
        for (s, output) in record.outputs.iter().enumerate() {
            motions[s + 1].push(match response {
                Ok(histories) => histories[s][..n_step].to_vec(),
                Err(_) => fitted(&output.acceleration_m_s2, record.dt_s),
            });
        }
    }
    let recorded = instrument.recorded(records, step_s, &motions);
    let of = |c: usize| recorded[1..].iter().map(|channels| channels[c].clone()).collect();
    responses.into_iter().enumerate().map(|(c, response)| response.map(|_| of(c))).collect()
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
