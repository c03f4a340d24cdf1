//! CSMIP volume 2: corrected acceleration, velocity and displacement of one or more channels in a file; the acceleration is read.
//!
//! Each channel has lines of text, among them its number and the time of its first sample, a header of integers and reals, and three blocks of
//! samples, each after a line such as `7500 points of accel data equally spaced at .010 sec, in cm/sec2. (8f10.6)`. The azimuth is integer 27
//! and the step real 61 of the header.

use super::channel::{Channel, Orientation};
use super::text::{Layout, Lines, leading_number};
use super::{Format, Reading, Source};
use crate::error::{Error, Result};
use crate::registry::{Entry, params};
use crate::units::AccelerationUnit;
use jiff::ToSpan as _;
use jiff::civil::{Date, DateTime, Time};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

const N_TEXT: usize = 25;
const INTEGERS: (usize, Layout) = (100, Layout { columns: 16, width: 5 });
const REALS: (usize, Layout) = (100, Layout { columns: 8, width: 10 });
const AZIMUTH: usize = 26;
const STEP_S: usize = 60;
/// Codes of channels that point up or down.
const VERTICAL: [i64; 2] = [500, 600];

pub(super) const ENTRY: Entry<dyn Format> = Entry {
    name: "csmip",
    about: "CSMIP volume 2 (corrected), one or more channels a file",
    build: |table| Ok(Box::new(params::<Csmip>(table)?)),
    schema: || schemars::schema_for!(Csmip),
};

/// CSMIP has no parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Csmip {}

impl Format for Csmip {
    fn recognises(&self, _: &str, head: &[u8]) -> bool {
        let first = head.split(|byte| *byte == b'\n').next().unwrap_or_default();
        let first = String::from_utf8_lossy(first).to_lowercase();
        first.contains("corrected accelerogram") && !first.trim_start().starts_with(|c: char| c.is_ascii_digit())
    }

    fn read(&self, source: &Source, bytes: &[u8], reading: &Reading) -> Result<Vec<Channel>> {
        let text = String::from_utf8_lossy(bytes);
        Lines::new(&text).channels(|lines, order| channel(lines, source, order, reading).map(Some))
    }
}

fn channel(lines: &mut Lines, source: &Source, order: usize, reading: &Reading) -> Result<Channel> {
    let first = lines.take()?;
    let kind = first.to_lowercase();
    if !kind.contains("corrected accelerogram") || kind.contains("uncorrected") {
        return Err(lines.wrong("`Corrected accelerogram`: volume 2 is read, and not volume 1 or 3", first));
    }
    let (mut number, mut about, mut start) = (None, String::new(), None);
    for _ in 1..N_TEXT {
        let line = lines.take()?;
        let lower = line.trim_start().to_lowercase();
        if number.is_none()
            && let Some(rest) = lower.strip_prefix("chan")
        {
            number = leading_number(rest);
            let said = line.split_once(':').map_or("", |(_, said)| said);
            about = said.split_whitespace().collect::<Vec<_>>().join(" ");
        }
        if start.is_none() && (lower.contains("start time") || lower.contains("trigger time")) {
            start = time(line);
        }
    }
    let integers = lines.numbers(INTEGERS.0, INTEGERS.1)?;
    let reals = lines.numbers(REALS.0, REALS.1)?;
    let dt_s = Some(reals[STEP_S]).filter(|dt_s| (1e-5..=1.0).contains(dt_s));
    let dt_s = dt_s.ok_or_else(|| {
        Error::new(format!("channel {order} has a step of {} s (real value 61), 0.00001…1 is possible", reals[STEP_S]))
    })?;
    let mut acceleration_m_s2 = None;
    loop {
        lines.skip_empty();
        let line = lines.take()?;
        let says = line.to_lowercase();
        if says.trim_start().starts_with("/&") || says.contains("end of data") {
            break;
        }
        let count = leading_number(&says).filter(|n| (0.0..1e9).contains(n) && n.fract() == 0.0);
        let (Some(count), Some(layout)) = (count, Layout::stated_in(&says)) else {
            return Err(lines.wrong("number and format of samples, or the end of the channel (`/&`)", line));
        };
        let samples = lines.numbers(count as usize, layout)?;
        if says.contains("accel") {
            let stated = match says.split_once(" in ").map(|(_, unit)| unit.trim_start()) {
                Some(unit) if unit.starts_with("cm/sec2") || unit.starts_with("cm/sec/sec") => AccelerationUnit::Gal,
                Some(unit) if unit.starts_with('g') => AccelerationUnit::Gravity,
                _ => return Err(lines.wrong("accelerations in cm/sec2 or g", line)),
            };
            let unit = reading.unit(Some(stated))?;
            acceleration_m_s2 = Some(samples.iter().map(|v| v * unit.m_s2()).collect());
        }
    }
    let none = || Error::new(format!("channel {order} has no accelerations")).hint("take the file of volume 2");
    let samples = acceleration_m_s2.ok_or_else(none)?;
    Ok(Channel {
        name: number.map_or_else(|| order.to_string(), |n| n.to_string()),
        about,
        orientation: match integers[AZIMUTH] as i64 {
            code if VERTICAL.contains(&code) => Orientation::Vertical,
            azimuth if (1..=360).contains(&azimuth) => Orientation::azimuth(azimuth as f64),
            _ => Orientation::Unknown,
        },
        start,
        ..Channel::alone(&source.name, dt_s, samples)
    })
}

/// Date (`8/24/14`) and time (`10:20:33.0`) of a line, in UTC.
fn time(line: &str) -> Option<DateTime> {
    let words = || line.split([' ', ',']).filter(|word| !word.is_empty());
    let parts = |mark: char| {
        let word =
            words().find(|word| word.matches(mark).count() == 2 && word.starts_with(|c: char| c.is_ascii_digit()))?;
        let mut numbers = word.split(mark).map(|part| part.parse::<f64>().ok());
        Some([numbers.next()??, numbers.next()??, numbers.next()??])
    };
    let ([month, day, year], [hour, minute, second]) = (parts('/')?, parts(':')?);
    // Two digits of a year: the first digital records are of the seventies.
    let year = if year < 70.0 {
        year + 2000.0
    } else if year < 100.0 {
        year + 1900.0
    } else {
        year
    };
    let date = Date::new(year as i16, month as i8, day as i8).ok()?;
    let nanosecond = ((second.fract() * 1e6).round() * 1e3) as i32;
    let time = Time::new(hour as i8, minute as i8, second as i8, nanosecond).ok()?;
    let behind_hours = match words().find(|word| ["PST", "PDT"].contains(word)) {
        Some("PST") => 8,
        Some(_) => 7,
        None => 0,
    };
    date.to_datetime(time).checked_add(behind_hours.hours()).ok()
}
