//! `flare-pipe records`: what is in the record files of a site.

use super::SiteArguments;
use super::output::{data, say, write_json};
use super::workspace::Workspace;
use crate::diagnosis::signal_band_hz;
use crate::error::{Error, Result};
use crate::manifest::Manifest;
use crate::records::{self, Record, Split};
use crate::units::G_M_S2;
use serde::Serialize;
use std::collections::BTreeMap;

/// One component of one event.
#[derive(Debug, Serialize)]
pub struct Row {
    event: String,
    component: String,
    split: Split,
    /// Time of the first sample, UTC, where the files say it.
    #[serde(skip_serializing_if = "Option::is_none")]
    start: Option<String>,
    #[serde(flatten)]
    content: Option<Content>,
    /// What is odd, or missing.
    pub remarks: Vec<String>,
}

impl Row {
    /// Time step of the record, s; none of one that is not there.
    pub fn step_s(&self) -> Option<f64> {
        self.content.as_ref().map(|content| content.step_s)
    }

    /// Its remarks as sentences that stand alone.
    pub fn sentences(&self) -> impl Iterator<Item = String> {
        self.remarks.iter().map(|remark| format!("{}, {}: {remark}", self.event, self.component))
    }
}

/// What its files hold.
#[derive(Debug, Serialize)]
struct Content {
    step_s: f64,
    duration_s: f64,
    /// Largest acceleration by sensor.
    peak_m_s2: BTreeMap<String, f64>,
    /// Where every sensor has three times its noise.
    band_hz: Option<[f64; 2]>,
}

/// Prints event, component, split, start, step, duration, peaks, band with signal and remarks of every record.
///
/// # Errors
/// Everything that is wrong with the files at once.
pub fn records(arguments: &SiteArguments, json: bool) -> Result<()> {
    let workspace = Workspace::open(arguments)?;
    let rows = inventory(&workspace.manifest)?;
    if json {
        return write_json(&rows);
    }
    print(&workspace.manifest, &rows)?;
    doubted_unit(&workspace.manifest, &rows).iter().for_each(|sentence| say!("{sentence}"));
    Ok(())
}

/// All records of a manifest in files; none where they are computed.
///
/// # Errors
/// Everything that is wrong with the files at once.
pub fn inventory(manifest: &Manifest) -> Result<Vec<Row>> {
    let (Some(settings), Some(dir)) = (&manifest.site.records, &manifest.records_dir) else { return Ok(Vec::new()) };
    let sensors = &manifest.site.sensors;
    if settings.format == "twin" {
        return Ok(Vec::new());
    }
    let read = records::load(settings, dir, &sensors.input, &sensors.names()).map_err(Error::usage)?;
    let row = |split, event: &str, component: &String| {
        let mut of_record = read.records.iter().map(|(_, r)| r).zip(&read.origins);
        let (record, origin) = of_record.find(|(r, _)| r.event == event && r.component == *component).unzip();
        let missing = read.missing.iter().filter(|m| m.event == event && m.component == *component);
        let absent = missing.map(|m| format!("not there: `{}`", m.file.display()));
        let of_files = origin.map(|origin| origin.remarks.iter().cloned()).into_iter().flatten();
        Row {
            event: event.into(),
            component: component.clone(),
            split,
            start: origin.and_then(|origin| origin.start).map(|start| start.to_string()),
            content: record.map(|record| content(record, settings)),
            remarks: record.map(records::remarks).into_iter().flatten().chain(of_files).chain(absent).collect(),
        }
    };
    let of_event = |(event, split)| settings.components.iter().map(move |component| (split, event, component));
    let rows: Vec<Row> =
        settings.events().flat_map(of_event).map(|(split, event, component)| row(split, event, component)).collect();
    let is_absent = |name: &&String| !rows.iter().any(|row| row.component == **name && row.content.is_some());
    let absent = settings.components.iter().filter(is_absent).map(|name| {
        Error::new(format!("component `{name}` has no record of any event in `{}`", dir.display()))
            .hint("check `records.components` and the names of files, or take the component out")
            .usage()
    });
    Error::all(absent.collect()).map(|()| rows)
}

/// Largest peak of all records of a site up to which a unit may be a mistake, m/s²: as many g are a usual strong motion.
const WEAK_M_S2: f64 = 0.3;

/// A sentence where a unit that the manifest declares makes all motions weak.
pub fn doubted_unit(manifest: &Manifest, rows: &[Row]) -> Option<String> {
    let unit = manifest.site.records.as_ref()?.unit?;
    let peaks = rows.iter().filter_map(|row| row.content.as_ref()).flat_map(|content| content.peak_m_s2.values());
    let largest_m_s2 = peaks.copied().fold(0.0, f64::max);
    (largest_m_s2 > 0.0 && largest_m_s2 < WEAK_M_S2).then(|| {
        let value = largest_m_s2 / unit.m_s2();
        format!(
            "`records.unit` is {unit}, by which the largest peak of all is {:.4} g; the files hold {value:.3}: is that g, gal or m/s²?",
            largest_m_s2 / G_M_S2
        )
    })
}

fn content(record: &Record, settings: &records::RecordSettings) -> Content {
    let peak = |x: &[f64]| x.iter().fold(0.0f64, |peak, v| peak.max(v.abs()));
    let bands: Option<Vec<[f64; 2]>> = signal_band_hz(record, settings.noise).into_iter().collect();
    let common = |all: Vec<[f64; 2]>| all.into_iter().reduce(|a, b| [a[0].max(b[0]), a[1].min(b[1])]);
    Content {
        step_s: record.dt_s,
        duration_s: record.duration_s(),
        peak_m_s2: record.sensors().map(|s| (s.name.clone(), peak(&s.acceleration_m_s2))).collect(),
        band_hz: bands.and_then(common).filter(|[low, high]| low < high),
    }
}

fn print(manifest: &Manifest, rows: &[Row]) -> Result<()> {
    let sensors: Vec<&str> = std::iter::once(manifest.site.sensors.input.as_str())
        .chain(manifest.site.sensors.output.iter().map(|s| s.name.as_str()))
        .collect();
    if rows.is_empty() {
        return data!("no record files: records are computed, or the manifest has none");
    }
    let width = rows.iter().map(|row| row.event.chars().count()).max().unwrap_or(0).max(5);
    let peaks: Vec<String> = sensors.iter().map(|name| format!("{name:>9}")).collect();
    data!(
        "{:width$}  {:4}  {:10}  {:19}  {:>7}  {:>8}  {}  {:>12}  remarks",
        "event",
        "comp",
        "split",
        "start UTC",
        "step s",
        "length s",
        peaks.join("  "),
        "band Hz"
    )?;
    for Row { event, component, split, start, content, remarks } in rows {
        let split = format!("{split:?}").to_lowercase();
        let remarks = remarks.join("; ");
        let Some(Content { step_s, duration_s, peak_m_s2, band_hz }) = content else {
            data!("{event:width$}  {component:4}  {split:10}  {remarks}")?;
            continue;
        };
        let start = start.as_deref().unwrap_or("–");
        let start = start.get(..19).unwrap_or(start);
        let peaks: Vec<String> =
            sensors.iter().map(|name| format!("{:>w$.3}", peak_m_s2[*name], w = name.chars().count().max(9))).collect();
        let band = band_hz.map_or("–".to_string(), |[low, high]| format!("{low:.1}–{high:.1}"));
        data!(
            "{event:width$}  {component:4}  {split:10}  {start:19}  {step_s:>7}  {duration_s:>8.1}  {}  {band:>12}  {remarks}",
            peaks.join("  ")
        )?;
    }
    data!("peaks in m/s²; the band is where every sensor has three times its noise, declared or before the event")
}
