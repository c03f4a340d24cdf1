//! COSMOS strong-motion format 1.x (raw, uncorrected or corrected acceleration): channels one after another in a file.
//!
//! Each channel has lines of text (the last says what stands for an unknown value), integers, reals, comments and samples; the line before
//! each of these says how many there are and their Fortran format. What is read of the header is named in [`header`].

use super::channel::{Channel, Orientation};
use super::text::{Layout, Lines, leading_number};
use super::{Format, Reading, Source};
use crate::error::{Error, Result};
use crate::registry::{Entry, params};
use crate::units::AccelerationUnit;
use jiff::civil::{Date, DateTime, Time};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Places in the header, the first being 0.
mod header {
    /// Integer: 1 for acceleration.
    pub const PARAMETER: usize = 1;
    /// Integer: unit of the samples.
    pub const UNIT: usize = 2;
    /// Integers: year, month, day, hour, minute of the first sample, UTC.
    pub const START: [usize; 5] = [39, 41, 42, 43, 44];
    /// Integer: number of the channel at the station.
    pub const CHANNEL: usize = 49;
    /// Integer: azimuth, or a code above 360.
    pub const AZIMUTH: usize = 53;
    /// Real: second of the first sample.
    pub const SECOND: usize = 29;
    /// Real: step of the samples, ms.
    pub const STEP_MS: usize = 61;
    /// Real: length of the record, s.
    pub const LENGTH_S: usize = 62;
    /// Real: peak.
    pub const PEAK: usize = 63;
}

/// Codes of channels that point up or down.
const VERTICAL: [i64; 3] = [400, 401, 402];
/// Unit by code, with its factor.
const UNITS: [(i64, AccelerationUnit, f64); 5] = [
    (2, AccelerationUnit::Gravity, 1.0),
    (4, AccelerationUnit::Gal, 1.0),
    (10, AccelerationUnit::Gal, 1.0),
    (11, AccelerationUnit::Gravity, 1e-3),
    (12, AccelerationUnit::Gravity, 1e-6),
];
/// Share by which samples may miss the peak of the header before it is remarked.
const PEAK_SHARE: f64 = 0.01;

pub(super) const ENTRY: Entry<dyn Format> = Entry {
    name: "cosmos",
    about: "COSMOS V0, V1 and V2, all channels of a station or one a file",
    build: |table| Ok(Box::new(params::<Cosmos>(table)?)),
    schema: || schemars::schema_for!(Cosmos),
};

/// COSMOS has no parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cosmos {}

impl Format for Cosmos {
    fn recognises(&self, _: &str, head: &[u8]) -> bool {
        let first = head.split(|byte| *byte == b'\n').next().unwrap_or_default();
        String::from_utf8_lossy(first).to_lowercase().contains("(format v")
    }

    fn read(&self, source: &Source, bytes: &[u8], reading: &Reading) -> Result<Vec<Channel>> {
        let text = String::from_utf8_lossy(bytes);
        Lines::new(&text).channels(|lines, order| channel(lines, source, order, reading))
    }
}

/// The channel that comes next; none where it is no acceleration.
fn channel(lines: &mut Lines, source: &Source, order: usize, reading: &Reading) -> Result<Option<Channel>> {
    let first = lines.take()?;
    let n_text = first.split("with").nth(1).and_then(leading_number).filter(|n| (2.0..=100.0).contains(n));
    let n_text = n_text.ok_or_else(|| lines.wrong("the number of text lines (`with 13 text lines`)", first))?;
    let (mut about, mut last) = (String::new(), "");
    for _ in 1..n_text as usize {
        last = lines.take()?;
        if last.starts_with("Sta Chan") {
            about = last.split_once(':').map_or("", |(_, said)| said).split_whitespace().collect::<Vec<_>>().join(" ");
        }
    }
    let unknown: Vec<f64> = last.rsplit(':').next().unwrap_or("").split(',').filter_map(leading_number).collect();
    let integers = block(lines)?;
    let reals = block(lines)?;
    let comments = lines.take()?;
    for _ in 0..count(lines, comments)? {
        lines.take()?;
    }
    let says = lines.take()?;
    let n_sample = count(lines, says)?;
    let layout = Layout::stated_in(says).ok_or_else(|| lines.wrong("the format of the samples", says))?;
    let samples = lines.numbers(n_sample, layout)?;
    let end = lines.take()?;
    if !end.to_lowercase().trim_start().starts_with("end-of-data") {
        return Err(lines.wrong("the end of the samples (`End-of-data`)", end));
    }
    let integer = |i: usize| integers.get(i).map(|v| *v as i64).filter(|v| Some(*v as f64) != unknown.first().copied());
    let real = |i: usize| reals.get(i).copied().filter(|v| Some(v) != unknown.get(1));
    let is_acceleration = integer(header::PARAMETER).map_or_else(|| says.contains("accel"), |code| code == 1);
    if !is_acceleration {
        return Ok(None);
    }
    let code = says.split_once("units=").and_then(|(_, unit)| leading_number(unit.split_once('(')?.1));
    let code = code.map(|code| code as i64).or(integer(header::UNIT));
    let known = UNITS.iter().find(|(known, ..)| Some(*known) == code);
    let (_, unit, factor) = *known.ok_or_else(|| {
        Error::new(format!("channel {order} is in `{}`, no acceleration", super::text::shown(says)))
            .hint("take the file with corrected accelerations (V2), or one in g or cm/s²")
    })?;
    let m_s2 = reading.unit(Some(unit))?.m_s2() * factor;
    let dt_s = real(header::STEP_MS).map(|ms| 1e-3 * ms).or_else(|| Some(real(header::LENGTH_S)? / n_sample as f64));
    let dt_s = dt_s.filter(|dt_s| (1e-5..=1.0).contains(dt_s));
    let dt_s = dt_s.ok_or_else(|| Error::new(format!("channel {order} does not say its step (real value 62)")))?;
    let peak = samples.iter().fold(0.0f64, |peak, v| peak.max(v.abs()));
    let stated =
        real(header::PEAK).map(f64::abs).filter(|stated| (stated - peak).abs() > PEAK_SHARE * stated.max(peak));
    let name = integer(header::CHANNEL).map_or_else(|| order.to_string(), |number| number.to_string());
    Ok(Some(Channel {
        name,
        about,
        orientation: match integer(header::AZIMUTH) {
            Some(code) if VERTICAL.contains(&code) => Orientation::Vertical,
            Some(azimuth) if (1..=360).contains(&azimuth) => Orientation::azimuth(azimuth as f64),
            _ => Orientation::Unknown,
        },
        start: start(header::START.map(integer), real(header::SECOND)),
        remarks: stated
            .map(|stated| format!("its header states a peak of {stated}, its samples have one of {peak}"))
            .into_iter()
            .collect(),
        ..Channel::alone(&source.name, dt_s, samples.iter().map(|v| v * m_s2).collect())
    }))
}

/// The number at the start of a line that says what follows.
fn count(lines: &Lines, line: &str) -> Result<usize> {
    let count = leading_number(line).filter(|n| (0.0..1e9).contains(n) && n.fract() == 0.0);
    count.map(|n| n as usize).ok_or_else(|| lines.wrong("how many values follow", line))
}

/// Numbers after the line that says how many and how they are written.
fn block(lines: &mut Lines) -> Result<Vec<f64>> {
    let says = lines.take()?;
    let n = count(lines, says)?;
    let layout = Layout::stated_in(says).ok_or_else(|| lines.wrong("the format of a header", says))?;
    lines.numbers(n, layout)
}

fn start(parts: [Option<i64>; 5], second: Option<f64>) -> Option<DateTime> {
    let [year, month, day, hour, minute] = parts;
    let narrow = |part: Option<i64>| i8::try_from(part?).ok();
    let date = Date::new(i16::try_from(year?).ok()?, narrow(month)?, narrow(day)?).ok()?;
    let nanosecond = (second? * 1e9).round() as i64;
    let (whole, rest) = (nanosecond.div_euclid(1_000_000_000), nanosecond.rem_euclid(1_000_000_000));
    let time = Time::new(narrow(hour)?, narrow(minute)?, narrow(Some(whole))?, rest as i32).ok()?;
    Some(date.to_datetime(time))
}
