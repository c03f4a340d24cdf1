//! A closed loop as tables and histories that other programs read: tidy CSV, MCAP with a channel for each sensor and depth, and a layout to
//! look at them; and the figures of the report as SVG.
//!
//! Every CSV has one value a row and its unit in the name of the column. An MCAP file holds one component of one held-out event: topics
//! `/MODEL/SENSOR` (the record is a model) with `{"acceleration_m_s2": …}` and, for finite elements, `/MODEL/depth/DEPTH m` with strain, stress
//! and excess pore pressure, as JSON messages at the time since the first sample.

use super::closed::{self, Closed, Shaken, transfers};
use super::compare;
use crate::atomic::Partial;
use crate::error::{Context, Error, Result};
use crate::report::content::{DepthView, EventView};
use crate::report::pictures;
use crate::units::KPA;
use mcap::WriteOptions;
use mcap::records::MessageHeader;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// Depths whose strain, stress and pore pressure are exported.
const DEPTHS: usize = 12;

/// Writes everything into `folder`, the figures of a rendered `report` too; the paths of the files.
///
/// # Errors
/// When an output cannot be read or a file not be written.
pub fn export(closed: &Closed, report: Option<&Path>, folder: &Path) -> Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder).context(|| format!("cannot make `{}`", folder.display()))?;
    let found = compare::read(&closed.compare)?;
    let events = closed.events(&found)?;
    let mut files = vec![
        histories(folder, &events)?,
        spectra(folder, &events)?,
        transfer(folder, &found)?,
        errors(folder, &found)?,
    ];
    let mut over_depth = Vec::new();
    for event in &events {
        let shaken = closed.shaken(&event.event, &event.component)?;
        files.push(mcap(folder, event, &shaken)?);
        over_depth.push(closed::over_depth(&event.event, &event.component, &shaken));
    }
    files.push(depth(folder, &over_depth)?);
    files.push(layout(folder, &events)?);
    if let Some(report) = report {
        files.extend(figures(folder, report)?);
    }
    Ok(files)
}

/// Flushes a file and gives it its name.
fn publish(partial: Partial, out: BufWriter<File>, what: impl Fn() -> String) -> Result<()> {
    let file = out.into_inner().map_err(|e| Error::new(what()).cause(e.to_string()))?;
    partial.publish(&file)
}

/// One CSV: its name, the names of its columns, and its rows.
fn table<const N: usize>(
    folder: &Path,
    name: &str,
    columns: [&str; N],
    rows: impl Iterator<Item = [String; N]>,
) -> Result<PathBuf> {
    let path = folder.join(name);
    let what = || format!("cannot write `{}`", path.display());
    let (partial, file) = Partial::create(&path)?;
    let mut writer = csv::Writer::from_writer(BufWriter::new(file));
    writer.write_record(columns).context(what)?;
    for row in rows {
        writer.write_record(row).context(what)?;
    }
    let file = writer.into_inner().map_err(|e| Error::new(what()).cause(e.to_string()))?;
    publish(partial, file, what)?;
    Ok(path)
}

fn histories(folder: &Path, events: &[EventView]) -> Result<PathBuf> {
    let columns = ["event", "component", "sensor", "model", "time_s", "acceleration_m_s2"];
    let input = events.iter().map(|e| (e, "input", "record", &e.input));
    let others = events.iter().flat_map(|e| {
        e.sensors
            .iter()
            .flat_map(move |s| s.models.iter().map(move |m| (e, s.sensor.as_str(), m.model.as_str(), &m.history)))
    });
    let rows = input.chain(others).flat_map(|(e, sensor, model, series)| {
        series.values.iter().enumerate().map(move |(i, v)| {
            let time_s = series.start_s + i as f64 * series.step_s;
            let names = [e.event.as_str(), e.component.as_str(), sensor, model].map(str::to_string);
            six(names.into_iter().chain([format!("{time_s:.6}"), v.to_string()]))
        })
    });
    table(folder, "histories.csv", columns, rows)
}

/// Six cells of a row.
fn six(mut cells: impl Iterator<Item = String>) -> [String; 6] {
    std::array::from_fn(|_| cells.next().unwrap_or_default())
}

fn spectra(folder: &Path, events: &[EventView]) -> Result<PathBuf> {
    let columns = ["event", "component", "sensor", "model", "period_s", "psa_m_s2"];
    let rows = events.iter().flat_map(|e| {
        e.sensors.iter().flat_map(move |s| {
            s.models.iter().flat_map(move |m| {
                s.period_s.iter().zip(&m.psa_m_s2).map(move |(t, v)| {
                    let names = [&e.event, &e.component, &s.sensor, &m.model].map(String::clone);
                    six(names.into_iter().chain([t.to_string(), v.to_string()]))
                })
            })
        })
    });
    table(folder, "spectra.csv", columns, rows)
}

fn transfer(folder: &Path, found: &compare::Compared) -> Result<PathBuf> {
    let columns = ["component", "sensor", "model", "frequency_hz", "amplification", "sigma_ln"];
    let mut rows = Vec::new();
    for view in transfers(found) {
        for (k, f) in view.frequencies_hz.iter().enumerate() {
            let sigma = view.sigma_ln.get(k).map(f64::to_string).unwrap_or_default();
            let recorded = ("record", view.recorded_ln[k], sigma);
            let models = view.predicted_ln.iter().map(|(model, ln)| (model.as_str(), ln[k], String::new()));
            for (model, ln, sigma) in std::iter::once(recorded).chain(models) {
                let names = [view.component.clone(), view.sensor.clone(), model.to_string()];
                rows.push(six(names.into_iter().chain([f.to_string(), ln.exp().to_string(), sigma])));
            }
        }
    }
    table(folder, "transfer.csv", columns, rows.into_iter())
}

fn errors(folder: &Path, found: &compare::Compared) -> Result<PathBuf> {
    let columns = ["event", "component", "sensor", "split", "model", "nrmse_percent", "nrmse_coherent_percent"];
    let text = |value: Option<f64>| value.map(|v| v.to_string()).unwrap_or_default();
    let rows = found.errors.iter().flat_map(|row| {
        let split = format!("{:?}", row.split).to_lowercase();
        row.nrmse_percent.named().into_iter().map(move |(model, percent)| {
            let coherent = row.nrmse_coherent_percent.get(model).copied().flatten();
            [
                row.event.clone(),
                row.component.clone(),
                row.sensor.clone(),
                split.clone(),
                model.to_string(),
                text(*percent),
                text(coherent),
            ]
        })
    });
    table(folder, "errors.csv", columns, rows)
}

fn depth(folder: &Path, events: &[DepthView]) -> Result<PathBuf> {
    let columns = [
        "event",
        "component",
        "model",
        "depth_m",
        "peak_acceleration_g",
        "peak_strain_percent",
        "peak_stress_kpa",
        "pore_pressure_ratio",
    ];
    let mut rows = Vec::new();
    for event in events {
        for model in &event.models {
            for i in 0..model.depth_m.len() {
                let values = [
                    model.depth_m[i],
                    model.pga_g[i],
                    model.strain_percent[i],
                    model.stress_kpa[i],
                    model.pore_ratio[i],
                ];
                let [z, a, g, t, u] = values.map(|v| v.to_string());
                rows.push([event.event.clone(), event.component.clone(), model.model.clone(), z, a, g, t, u]);
            }
        }
    }
    table(folder, "depth.csv", columns, rows.into_iter())
}

/// One message: nanoseconds since the first sample, topic, content.
type Message = (u64, u16, Value);

fn mcap(folder: &Path, event: &EventView, shaken: &[Shaken]) -> Result<PathBuf> {
    let path = folder.join(format!("{}.{}.mcap", event.event, event.component));
    let what = || format!("cannot write `{}`", path.display());
    let (partial, file) = Partial::create(&path)?;
    let mut writer = WriteOptions::new()
        .compression(Some(mcap::Compression::Zstd))
        .compression_threads(0)
        .library("flare-pipe")
        .create(BufWriter::new(file))
        .context(what)?;
    let acceleration = json!({ "type": "object", "properties": { "acceleration_m_s2": { "type": "number" } } });
    let element = json!({ "type": "object", "properties": {
        "strain": { "type": "number" }, "stress_kpa": { "type": "number" }, "excess_pore_pressure_kpa": { "type": "number" } } });
    let schema = |name: &str, value: &Value, writer: &mut mcap::Writer<BufWriter<File>>| {
        writer.add_schema(name, "jsonschema", value.to_string().as_bytes()).context(what)
    };
    let [sensor_schema, element_schema] =
        [schema("Acceleration", &acceleration, &mut writer)?, schema("Element", &element, &mut writer)?];
    let mut messages: Vec<Message> = Vec::new();
    let mut channel =
        |topic: String, schema: u16| writer.add_channel(schema, &topic, "json", &BTreeMap::new()).context(what);
    let nanoseconds = |time_s: f64| (time_s.max(0.0) * 1e9).round() as u64;
    let input = std::iter::once(("record", "input", &event.input));
    let others = event
        .sensors
        .iter()
        .flat_map(|s| s.models.iter().map(move |m| (m.model.as_str(), s.sensor.as_str(), &m.history)));
    for (model, sensor, series) in input.chain(others) {
        let id = channel(format!("/{model}/{sensor}"), sensor_schema)?;
        messages.extend(series.values.iter().enumerate().map(|(i, v)| {
            (nanoseconds(series.start_s + i as f64 * series.step_s), id, json!({ "acceleration_m_s2": short(*v) }))
        }));
    }
    for Shaken { model, profile, .. } in shaken {
        let (n, count) = (profile.depth_m.len(), DEPTHS.min(profile.depth_m.len()));
        for i in (0..count).map(|i| (2 * i + 1) * n / (2 * count)) {
            let id = channel(format!("/{model}/depth/{:.2} m", profile.depth_m[i]), element_schema)?;
            let history = &profile.histories[i];
            messages.extend(profile.time_s.iter().enumerate().map(|(k, time_s)| {
                let of = |values: &[f32], unit: f64| short(f64::from(values[k]) / unit);
                let value = json!({
                    "strain": of(&history.gamma, 1.0),
                    "stress_kpa": of(&history.tau_pa, KPA),
                    "excess_pore_pressure_kpa": of(&history.excess_pore_pa, KPA),
                });
                (nanoseconds(*time_s), id, value)
            }));
        }
    }
    messages.sort_by_key(|(time_ns, id, _)| (*time_ns, *id));
    for (sequence, (time_ns, channel_id, value)) in messages.into_iter().enumerate() {
        let header = MessageHeader { channel_id, sequence: sequence as u32, log_time: time_ns, publish_time: time_ns };
        writer.write_to_known_channel(&header, value.to_string().as_bytes()).context(what)?;
    }
    writer.finish().context(what)?;
    publish(partial, writer.into_inner(), what)?;
    Ok(path)
}

/// Six significant digits: a message is text.
fn short(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(value)
}

/// The figures of a rendered report.
fn figures(folder: &Path, report: &Path) -> Result<Vec<PathBuf>> {
    let html = std::fs::read_to_string(report).context(|| format!("cannot read `{}`", report.display()))?;
    let folder = folder.join("figures");
    std::fs::create_dir_all(&folder).context(|| format!("cannot make `{}`", folder.display()))?;
    let write = |(name, svg): (String, String)| {
        let path = folder.join(format!("{name}.svg"));
        crate::atomic::write(&path, |out| out.write_all(svg.as_bytes()))?;
        Ok(path)
    };
    pictures(&html).into_iter().map(write).collect()
}

/// A layout for Foxglove: the accelerations of each sensor in one plot.
fn layout(folder: &Path, events: &[EventView]) -> Result<PathBuf> {
    let path = folder.join("foxglove.json");
    let mut sensors: Vec<(&str, Vec<&str>)> = Vec::new();
    for sensor in events.iter().flat_map(|e| &e.sensors) {
        if !sensors.iter().any(|(name, _)| *name == sensor.sensor) {
            sensors.push((&sensor.sensor, sensor.models.iter().map(|m| m.model.as_str()).collect()));
        }
    }
    let plot = |paths: Vec<String>, title: &str| {
        let paths: Vec<Value> = paths
            .into_iter()
            .map(|value| json!({ "value": value, "enabled": true, "timestampMethod": "receiveTime" }))
            .collect();
        json!({ "title": title, "paths": paths, "showLegend": true, "isSynced": true, "xAxisVal": "timestamp" })
    };
    let mut configs = serde_json::Map::new();
    configs.insert("Plot!input".into(), plot(vec!["/record/input.acceleration_m_s2".into()], "input"));
    for (i, (sensor, models)) in sensors.iter().enumerate() {
        let paths = models.iter().map(|model| format!("\"/{model}/{sensor}\".acceleration_m_s2")).collect();
        configs.insert(format!("Plot!sensor{i}"), plot(paths, sensor));
    }
    let names: Vec<String> = configs.keys().cloned().collect();
    let stacked = names.iter().rev().fold(Value::Null, |below, name| match below {
        Value::Null => json!(name),
        below => json!({ "first": name, "second": below, "direction": "column" }),
    });
    let value = json!({ "configById": configs, "globalVariables": {}, "userNodes": {}, "layout": stacked });
    crate::atomic::write(&path, |out| {
        out.write_all(serde_json::to_string_pretty(&value).unwrap_or_default().as_bytes())
    })?;
    Ok(path)
}
