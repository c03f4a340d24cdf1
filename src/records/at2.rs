//! PEER AT2: four header lines, then values in free form, one component a file.
//!
//! The fourth line says number and step of the samples (`NPTS=  7995, DT=  .0050 SEC`, or the two numbers alone), the third the unit; the
//! second ends with the azimuth. There is no time of the first sample: the channels of an event are taken to begin together.

use super::channel::{Channel, Orientation};
use super::text::{Lines, leading_number};
use super::{Format, Reading, Source};
use crate::error::{Error, Result};
use crate::registry::{Entry, params};
use crate::units::AccelerationUnit;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry<dyn Format> = Entry {
    name: "at2",
    about: "PEER AT2, one component a file",
    build: |table| Ok(Box::new(params::<At2>(table)?)),
    schema: || schemars::schema_for!(At2),
};

/// PEER AT2 has no parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct At2 {}

impl Format for At2 {
    fn recognises(&self, name: &str, _: &[u8]) -> bool {
        name.to_lowercase().ends_with(".at2")
    }

    fn read(&self, source: &Source, bytes: &[u8], reading: &Reading) -> Result<Vec<Channel>> {
        let text = String::from_utf8_lossy(bytes);
        let mut lines = Lines::new(&text);
        lines.take()?;
        let about = lines.take()?.trim();
        let unit = lines.take()?.to_uppercase();
        let stated = match unit.split_once("UNITS OF").map(|(_, unit)| unit.trim()) {
            Some(unit) if unit.starts_with("CM") || unit.starts_with("GAL") => Some(AccelerationUnit::Gal),
            Some(unit) if unit.starts_with('M') => Some(AccelerationUnit::MetrePerSecondSquared),
            Some(unit) if unit.starts_with('G') => Some(AccelerationUnit::Gravity),
            _ => None,
        };
        let unit = reading.unit(stated)?;
        let line = lines.take()?;
        let (count, dt_s) = samples(line).ok_or_else(|| lines.wrong("number and step of the samples", line))?;
        let mut values = Vec::new();
        while lines.peek().is_some() {
            for word in lines.take()?.split_whitespace() {
                let value: f64 = word.parse().map_err(|_| lines.wrong("numbers", word))?;
                values.push(value * unit.m_s2());
            }
        }
        if values.len() != count || values.iter().any(|v| !v.is_finite()) {
            let what = format!("line 4 says {count} samples, {} came", values.len());
            return Err(Error::new(what).hint("download the file again; was it cut off?"));
        }
        let said = about.rsplit(',').next().unwrap_or("").trim().to_uppercase();
        let orientation = match leading_number(&said) {
            Some(azimuth) if (0.0..=360.0).contains(&azimuth) => Orientation::azimuth(azimuth),
            _ if ["UP", "DWN", "DOWN", "VER", "V"].iter().any(|name| said.starts_with(name)) => Orientation::Vertical,
            _ => Orientation::Unknown,
        };
        Ok(vec![Channel { about: about.into(), orientation, ..Channel::alone(&source.name, dt_s, values) }])
    }
}

/// Number and step of the samples, whichever comes first.
fn samples(line: &str) -> Option<(usize, f64)> {
    let numbers = |text: &str| -> Vec<f64> {
        text.split(|c: char| c.is_whitespace() || c == ',' || c == '=').filter_map(leading_number).collect()
    };
    let (count, dt_s) = match numbers(line)[..] {
        [a, b, ..] if a.fract() == 0.0 && a >= 3.0 => (a, b),
        [a, b, ..] => (b, a),
        _ => return None,
    };
    ((3.0..1e9).contains(&count) && count.fract() == 0.0 && (1e-5..=1.0).contains(&dt_s))
        .then_some((count as usize, dt_s))
}
