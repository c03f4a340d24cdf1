//! SMC of the US Geological Survey: one component a file, cm/s².
//!
//! Eleven lines of text, six of eight integers, ten of five reals, comments, then eight values a line. Integers hold start, azimuth, number of
//! comments and of samples, the first real but one the sampling rate; the first of both is what stands for an unknown value.

use super::channel::{Channel, Orientation};
use super::text::{Layout, Lines};
use super::{Format, Reading, Source};
use crate::error::{Error, Result};
use crate::registry::{Entry, params};
use crate::units::AccelerationUnit;
use jiff::ToSpan as _;
use jiff::civil::{DateTime, date};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// First lines of files with accelerations, after their number.
const KINDS: [&str; 2] = ["1 UNCORRECTED ACCELEROGRAM", "2 CORRECTED ACCELEROGRAM"];
const N_TEXT: usize = 11;
const INTEGERS: (usize, Layout) = (48, Layout { columns: 8, width: 10 });
const REALS: (usize, Layout) = (50, Layout { columns: 5, width: 15 });
const SAMPLES: Layout = Layout { columns: 8, width: 10 };

pub(super) const ENTRY: Entry<dyn Format> = Entry {
    name: "smc",
    about: "SMC of the US Geological Survey, one component a file",
    build: |table| Ok(Box::new(params::<Smc>(table)?)),
    schema: || schemars::schema_for!(Smc),
};

/// SMC has no parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Smc {}

impl Format for Smc {
    fn recognises(&self, name: &str, head: &[u8]) -> bool {
        name.to_lowercase().ends_with(".smc") || KINDS.iter().any(|kind| head.starts_with(kind.as_bytes()))
    }

    fn read(&self, source: &Source, bytes: &[u8], reading: &Reading) -> Result<Vec<Channel>> {
        let unit = reading.unit(Some(AccelerationUnit::Gal))?;
        let text = String::from_utf8_lossy(bytes);
        let mut lines = Lines::new(&text);
        let kind = lines.take()?.trim();
        if !KINDS.contains(&kind) {
            return Err(lines.wrong("`2 CORRECTED ACCELEROGRAM`: velocities and spectra are no records", kind));
        }
        let mut about = "";
        for i in 2..=N_TEXT {
            let line = lines.take()?.trim();
            if i == 6 {
                about = line;
            }
        }
        let integers = lines.numbers(INTEGERS.0, INTEGERS.1)?;
        let reals = lines.numbers(REALS.0, REALS.1)?;
        let integer = |i: usize| Some(integers[i]).filter(|v| *v != integers[0]);
        let rate_hz = Some(reals[1]).filter(|rate| *rate != reals[0] && (1.0..=1e5).contains(rate));
        let rate_hz = rate_hz.ok_or_else(|| lines.wrong("a sampling rate in 1…100000 Hz as second real", ""))?;
        let count = integer(16).filter(|n| (3.0..1e9).contains(n));
        let count = count.ok_or_else(|| lines.wrong("a number of samples above 2 as seventeenth integer", ""))?;
        for _ in 0..integer(15).unwrap_or(0.0).max(0.0) as usize {
            lines.take()?;
        }
        let values = lines.numbers(count as usize, SAMPLES)?;
        if let Some(null) = values.iter().position(|v| *v == reals[0]) {
            let what = format!("sample {} is what stands for an unknown value, {:e}", null + 1, reals[0]);
            return Err(Error::new(what).hint("cut the record before the gap"));
        }
        let orientation = match (integer(13), integer(12)) {
            (Some(azimuth), _) if (0.0..=360.0).contains(&azimuth) => Orientation::azimuth(azimuth),
            (None, Some(_)) => Orientation::Vertical,
            _ => Orientation::Unknown,
        };
        let start = start(&[1, 2, 3, 4].map(integer), integer(5).unwrap_or(0.0), integer(6).unwrap_or(0.0));
        let values = values.into_iter().map(|v| v * unit.m_s2()).collect();
        let about = about.split_whitespace().collect::<Vec<_>>().join(" ");
        Ok(vec![Channel { about, orientation, start, ..Channel::alone(&source.name, 1.0 / rate_hz, values) }])
    }
}

/// Time by year, day of the year, hour and minute, seconds and milliseconds.
fn start(parts: &[Option<f64>; 4], second: f64, millisecond: f64) -> Option<DateTime> {
    let [year, day, hour, minute] = (*parts).map(|part| part.map(|v| v as i64));
    let year = i16::try_from(year?).ok().filter(|y| (1900..=2200).contains(y))?;
    let (day, hour, minute) = (day?, hour?, minute?);
    if !(1..=366).contains(&day) || !(0..=23).contains(&hour) || !(0..=59).contains(&minute) {
        return None;
    }
    let midnight = date(year, 1, 1).at(0, 0, 0, 0);
    let span = (day - 1).days().hours(hour).minutes(minute).seconds(second as i64).milliseconds(millisecond as i64);
    midnight.checked_add(span).ok()
}
