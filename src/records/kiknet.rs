//! Raw KiK-net ASCII: six files an event, `<event>.<component>1` in the borehole and `<event>.<component>2` at the surface.
//!
//! Seventeen header lines (label to column 18, value after it), then integer counts, eight a line:
//! `acceleration (gal) = count × scale − mean`. The header's peak is checked against the one that comes out.

use super::channel::{Channel, Orientation};
use super::text::{leading_number, shown};
use super::{Format, Reading, Role, Source, Usual};
use crate::error::{Error, Result};
use crate::registry::{Entry, params};
use crate::units::AccelerationUnit;
use jiff::ToSpan as _;
use jiff::civil::DateTime;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Lines before the counts.
const N_HEADER: usize = 17;
/// By how much the time in the header is later than the first sample, s.
const TRIGGER_DELAY_S: i64 = 15;
/// Columns of a header line taken by its label.
const LABEL_WIDTH: usize = 18;

pub(super) const ENTRY: Entry<dyn Format> = Entry {
    name: "kiknet",
    about: "raw KiK-net ASCII: `.NS1 .EW1` borehole, `.NS2 .EW2` surface",
    build: |table| Ok(Box::new(params::<Kiknet>(table)?)),
    schema: || schemars::schema_for!(Kiknet),
};

/// Raw KiK-net ASCII; the event name of the manifest is the file stem, with or without the station code.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Kiknet {
    /// Station code put before the event names, such as `NIGH18`.
    #[serde(default)]
    pub station: String,
}

impl Format for Kiknet {
    fn recognises(&self, name: &str, head: &[u8]) -> bool {
        let extension = name.rsplit_once('.').map_or("", |(_, extension)| extension);
        let component = extension.strip_suffix(['1', '2']).unwrap_or(extension);
        ["NS", "EW", "UD"].contains(&component) || head.starts_with(b"Origin Time ")
    }

    fn stem(&self, event: &str) -> String {
        format!("{}{event}", self.station)
    }

    fn usual(&self, role: &Role) -> Result<Option<Usual>> {
        if role.n_output != 1 {
            let what =
                format!("a KiK-net station has one output sensor, the surface; the manifest names {}", role.n_output);
            return Err(Error::new(what).hint("leave one `[[sensors.output]]` at depth 0"));
        }
        let place = if role.is_input { 1 } else { 2 };
        let file = format!("{}.{}{place}", self.stem(role.event), role.component);
        Ok(Some(Usual { channel: file.clone(), file }))
    }

    fn read(&self, source: &Source, bytes: &[u8], reading: &Reading) -> Result<Vec<Channel>> {
        reading.unit(Some(AccelerationUnit::Gal))?;
        let parsed = parse(&String::from_utf8_lossy(bytes))?;
        let orientation = match source.name.rsplit_once('.').map_or("", |(_, e)| e.trim_end_matches(['1', '2'])) {
            "NS" => Orientation::azimuth(0.0),
            "EW" => Orientation::azimuth(90.0),
            "UD" => Orientation::Vertical,
            _ => Orientation::Unknown,
        };
        let start = parsed.start();
        Ok(vec![Channel {
            about: parsed.station,
            orientation,
            start,
            ..Channel::alone(&source.name, parsed.dt_s, parsed.acceleration_m_s2)
        }])
    }
}

/// Depth of the sensor in the borehole by the heights that two files of an event state, m; `path` is one of them.
pub fn borehole_depth_m(path: &Path) -> Option<f64> {
    let name = path.to_str()?.strip_suffix(['1', '2'])?;
    let height_m = |place: u8| {
        let bytes = std::fs::read(format!("{name}{place}")).ok()?;
        let text = String::from_utf8_lossy(&bytes);
        leading_number(text.lines().nth(8)?.strip_prefix("Station Height(m)")?.trim())
    };
    Some(height_m(2)? - height_m(1)?).filter(|depth| *depth > 0.0)
}

/// One parsed file.
#[derive(Debug, Clone, PartialEq)]
pub struct Parsed {
    /// Station code of the header.
    pub station: String,
    /// `Record Time` of the header (JST, 15 s trigger delay included).
    pub record_time: String,
    /// Time step, s.
    pub dt_s: f64,
    /// `Max. Acc.` of the header, m/s².
    pub stated_peak_m_s2: f64,
    /// Acceleration with its mean removed, m/s².
    pub acceleration_m_s2: Vec<f64>,
}

impl Parsed {
    /// Time of the first sample, UTC: the header's is Japanese, and later by the delay of the trigger.
    fn start(&self) -> Option<DateTime> {
        let stated = DateTime::strptime("%Y/%m/%d %H:%M:%S", self.record_time.trim()).ok()?;
        stated.checked_sub(9.hours().seconds(TRIGGER_DELAY_S)).ok()
    }
}

/// Parses the text of one file.
///
/// # Errors
/// When a header line or a count is not what the format says, or the peak is not the stated one; the line is named.
pub fn parse(text: &str) -> Result<Parsed> {
    let lines: Vec<&str> = text.lines().collect();
    if lines.len() <= N_HEADER {
        return Err(Error::new(format!(
            "the file has {} lines, {N_HEADER} of header and then counts are needed",
            lines.len()
        ))
        .hint("download the file again; was it cut off?"));
    }
    let value = |line: usize, label: &str| -> Result<&str> {
        let text = lines[line - 1];
        match (text.get(..label.len()), text.get(LABEL_WIDTH..)) {
            (Some(found), Some(value)) if found == label => Ok(value.trim()),
            _ => Err(Error::new(format!("line {line} must start with `{label}`, got `{}`", shown(text)))
                .hint("only raw KiK-net ASCII is read here; is it a K-NET or a converted file?")),
        }
    };
    let rate_hz = leading_number(value(11, "Sampling Freq(Hz)")?).filter(|f| (1.0..=1000.0).contains(f));
    let rate_hz = rate_hz.ok_or_else(|| wrong(11, "a sampling frequency in 1…1000 Hz", lines[10]))?;
    let scale_gal =
        scale(value(14, "Scale Factor")?).ok_or_else(|| wrong(14, "a scale such as `3923(gal)/8224838`", lines[13]))?;
    let stated_gal =
        leading_number(value(15, "Max. Acc. (gal)")?).ok_or_else(|| wrong(15, "a peak in gal", lines[14]))?;
    let mut counts: Vec<f64> = Vec::with_capacity(8 * (lines.len() - N_HEADER));
    for (i, line) in lines.iter().enumerate().skip(N_HEADER) {
        for word in line.split_whitespace() {
            let count: i32 = word.parse().map_err(|_| wrong(i + 1, "integer counts", word))?;
            counts.push(f64::from(count));
        }
    }
    if counts.len() < 3 {
        return Err(Error::new(format!("the file has {} counts, at least 3 are needed", counts.len()))
            .hint("download the file again; was it cut off?"));
    }
    let length_s =
        leading_number(value(12, "Duration Time(s)")?).ok_or_else(|| wrong(12, "a duration in s", lines[11]))?;
    let expected = length_s * rate_hz;
    if (counts.len() as f64 - expected).abs() > rate_hz {
        let what = format!("the file has {} counts, {length_s} s at {rate_hz} Hz are {expected:.0}", counts.len());
        return Err(Error::new(what).hint("download the file again; was it cut off?"));
    }
    let mean = counts.iter().sum::<f64>() / counts.len() as f64;
    let peak_gal = counts.iter().fold(0.0f64, |m, c| m.max((c - mean).abs())) * scale_gal;
    if (peak_gal - stated_gal.abs()).abs() > 0.01 + 0.005 * stated_gal.abs() {
        return Err(Error::new(format!(
            "the counts peak at {peak_gal:.3} gal, but line 15 states {stated_gal:.3} gal"
        ))
        .hint("the file is damaged or cut off: download it again"));
    }
    let m_s2 = scale_gal * AccelerationUnit::Gal.m_s2();
    Ok(Parsed {
        station: value(6, "Station Code")?.into(),
        record_time: value(10, "Record Time")?.into(),
        dt_s: 1.0 / rate_hz,
        stated_peak_m_s2: stated_gal * AccelerationUnit::Gal.m_s2(),
        acceleration_m_s2: counts.iter().map(|c| (c - mean) * m_s2).collect(),
    })
}

fn wrong(line: usize, needed: &str, got: &str) -> Error {
    Error::new(format!("line {line} must hold {needed}, got `{}`", shown(got)))
        .hint("only raw KiK-net ASCII is read here; download the file again")
}

/// `3923(gal)/8224838` in gal a count.
fn scale(text: &str) -> Option<f64> {
    let (full, counts) = text.split_once('/')?;
    let scale = leading_number(full)? / leading_number(counts.trim())?;
    (scale.is_finite() && scale > 0.0 && full.contains("gal")).then_some(scale)
}
