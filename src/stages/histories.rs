//! Histories of the held-out events, recorded and of every model, as the comparison leaves them for the report and for export.
//!
//! A table for each event and component: at the step of the record the input, and for each sensor the record and the finite elements; on the
//! axis of FLARE-T its predictions. Columns are called `SENSOR:MODEL`, the record being the model `record`.

use super::artifact::{read_table, write_json, write_table};
use super::side_by_side::Channel;
use crate::error::Result;
use crate::records::Split;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

const FOLDER: &str = "histories";
const INDEX: &str = "histories.json";
/// Name of the column with the input.
const INPUT: &str = "input";

/// Histories of one step.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Axis {
    /// Time of the first sample, s.
    pub start_s: f64,
    /// Step, s.
    pub step_s: f64,
    /// By model, one history a sensor in the order of [`Event::sensors`], m/s².
    pub models: BTreeMap<String, Vec<Vec<f64>>>,
}

/// One component of one held-out event.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// Output sensors.
    pub sensors: Vec<String>,
    /// Input at the step of the record, m/s².
    pub input: Vec<f64>,
    /// Record and finite elements, and FLARE-T.
    pub axes: [Axis; 2],
}

#[derive(Serialize, Deserialize)]
struct Entry {
    event: String,
    component: String,
    sensors: Vec<String>,
    start_s: [f64; 2],
    step_s: [f64; 2],
}

/// Writes the histories of the held-out `channels`; FLARE-T's begin at `start_s`.
///
/// # Errors
/// When a file cannot be written.
pub fn write(folder: &Path, channels: &[Channel], start_s: f64) -> Result<()> {
    let mut index: Vec<Entry> = Vec::new();
    let held_out: Vec<&Channel> = channels.iter().filter(|c| c.split == Split::Test).collect();
    let dir = folder.join(FOLDER);
    crate::error::Context::context(std::fs::create_dir_all(&dir), || format!("cannot make `{}`", dir.display()))?;
    for channel in &held_out {
        if index.iter().any(|e| e.event == channel.event && e.component == channel.component) {
            continue;
        }
        let of: Vec<&&Channel> =
            held_out.iter().filter(|c| c.event == channel.event && c.component == channel.component).collect();
        let mut fine: Vec<(String, &[f64])> = vec![(INPUT.into(), &channel.fine.input)];
        let mut coarse: Vec<(String, &[f64])> = Vec::new();
        for c in &of {
            fine.push((format!("{}:record", c.sensor), &c.fine.observed));
            fine.extend(c.fine.predicted.iter().map(|(model, x)| (format!("{}:{model}", c.sensor), x.as_slice())));
            let flare = c.coarse.predicted.iter().filter(|(model, _)| !c.fine.predicted.contains_key(*model));
            coarse.extend(flare.map(|(model, x)| (format!("{}:{model}", c.sensor), x.as_slice())));
        }
        for (suffix, step_s, columns) in [("", channel.fine.dt_s, fine), (".flare", channel.coarse.dt_s, coarse)] {
            let named: Vec<(&str, &[f64])> = columns.iter().map(|(name, x)| (name.as_str(), *x)).collect();
            if !named.is_empty() {
                write_table(&dir.join(format!("{}.{}{suffix}.csv", channel.event, channel.component)), step_s, &named)?;
            }
        }
        index.push(Entry {
            event: channel.event.clone(),
            component: channel.component.clone(),
            sensors: of.iter().map(|c| c.sensor.clone()).collect(),
            start_s: [0.0, start_s],
            step_s: [channel.fine.dt_s, channel.coarse.dt_s],
        });
    }
    write_json(&folder.join(INDEX), &index)
}

/// What [`write()`] left in `folder`.
///
/// # Errors
/// When a file is not there or holds something else.
pub fn read(folder: &Path) -> Result<Vec<Event>> {
    let index: Vec<Entry> = super::artifact::read_json(&folder.join(INDEX))?;
    let event = |entry: Entry| -> Result<Event> {
        let path = |suffix: &str| folder.join(FOLDER).join(format!("{}.{}{suffix}.csv", entry.event, entry.component));
        let mut input = Vec::new();
        let mut axes = [Axis::default(), Axis::default()];
        for (i, suffix) in ["", ".flare"].into_iter().enumerate() {
            axes[i] = Axis { start_s: entry.start_s[i], step_s: entry.step_s[i], models: BTreeMap::new() };
            if !path(suffix).exists() {
                continue;
            }
            for (name, values) in read_table(&path(suffix))? {
                if name == INPUT {
                    input = values;
                    continue;
                }
                let Some((sensor, model)) = name.rsplit_once(':') else { continue };
                let Some(place) = entry.sensors.iter().position(|s| s == sensor) else { continue };
                let of_model =
                    axes[i].models.entry(model.to_string()).or_insert_with(|| vec![Vec::new(); entry.sensors.len()]);
                of_model[place] = values;
            }
        }
        Ok(Event { event: entry.event, component: entry.component, sensors: entry.sensors, input, axes })
    };
    index.into_iter().map(event).collect()
}

#[cfg(test)]
mod tests {
    use super::super::side_by_side::Histories;
    use super::*;
    use crate::diagnosis::Six;

    #[test]
    fn histories_come_back_as_they_were_written() {
        let histories = |dt_s: f64, n: usize, models: &[&'static str]| Histories {
            dt_s,
            input: (0..n).map(|i| i as f64).collect(),
            observed: vec![0.5; n],
            predicted: models.iter().enumerate().map(|(k, model)| (*model, vec![k as f64 / 3.0; n])).collect(),
        };
        let channel = |sensor: &str, split: Split| Channel {
            event: "E: 1".into(),
            component: "EW".into(),
            sensor: sensor.into(),
            split,
            fine: histories(0.01, 50, &["corrected", "declared"]),
            coarse: histories(0.05, 10, &["corrected", "declared", "flare_after"]),
            nrmse_percent: Six::default(),
        };
        let place = tempfile::tempdir().expect("a folder");
        let channels = [channel("a: b", Split::Test), channel("c", Split::Test), channel("c", Split::Train)];
        write(place.path(), &channels, 0.7).expect("written");
        let read = read(place.path()).expect("read");
        assert_eq!(read.len(), 1);
        assert_eq!((read[0].sensors.as_slice(), read[0].input.len()), (&["a: b".to_string(), "c".into()][..], 50));
        assert_eq!(read[0].axes[0].models.keys().collect::<Vec<_>>(), ["corrected", "declared", "record"]);
        assert_eq!(read[0].axes[0].models["declared"][1], vec![1.0 / 3.0; 50]);
        assert_eq!((read[0].axes[1].start_s, read[0].axes[1].step_s), (0.7, 0.05));
        assert_eq!(read[0].axes[1].models["flare_after"][0], vec![2.0 / 3.0; 10]);
    }
}
