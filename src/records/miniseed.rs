//! miniSEED 2: records of 128 bytes to 1 MiB, each with a fixed header, blockettes and samples of one channel.
//!
//! Counts become accelerations by the sensitivity in a StationXML file of the same folder; where there is none, the samples are taken to be
//! accelerations in the declared unit. A channel is named by its code, `NETWORK.STATION.LOCATION.CHANNEL`. Segments must follow one another
//! without a gap.
//!
//! Source: SEED Reference Manual 2.4 (FDSN), chapter 8 (fixed header, blockettes 100, 1000, 1001) and appendix B (Steim).

use super::channel::{Channel, Orientation};
use super::stationxml::Responses;
use super::{Format, Reading, Source};
use crate::error::{Error, Result};
use crate::registry::{Entry, params};
use jiff::civil::{DateTime, Time, date};
use jiff::{SignedDuration, ToSpan as _};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Bytes of the fixed header.
const HEADER: usize = 48;
/// Share of a step by which the next record may begin early or late.
const JITTER: f64 = 0.5;

pub(super) const ENTRY: Entry<dyn Format> = Entry {
    name: "miniseed",
    about: "miniSEED 2 with a StationXML file, or in a declared unit",
    build: |table| Ok(Box::new(params::<MiniSeed>(table)?)),
    schema: || schemars::schema_for!(MiniSeed),
};

/// miniSEED has no parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MiniSeed {}

impl Format for MiniSeed {
    fn recognises(&self, _: &str, head: &[u8]) -> bool {
        let is_number = |byte: &u8| byte.is_ascii_digit() || *byte == b' ';
        head.len() >= HEADER && head[..6].iter().all(is_number) && b"DRQM".contains(&head[6]) && head[7] == b' '
    }

    fn is_companion(&self, name: &str) -> bool {
        name.to_lowercase().ends_with(".xml")
    }

    fn read(&self, source: &Source, bytes: &[u8], reading: &Reading) -> Result<Vec<Channel>> {
        let mut traces: BTreeMap<String, Vec<Segment>> = BTreeMap::new();
        let mut at = 0;
        while at < bytes.len() {
            let place = |e: Error| e.at(format!("byte {at}"));
            let (code, segment, length) = record(&bytes[at..]).map_err(place)?;
            at += length;
            // Records of logs and of clocks hold no samples.
            let Some(segment) = segment else { continue };
            traces.entry(code).or_default().push(segment);
        }
        let responses = (reading.responses)()?;
        let channel = |(code, segments): (String, Vec<Segment>)| channel(source, code, segments, responses, reading);
        traces.into_iter().map(channel).collect()
    }
}

/// Samples that follow one another.
#[derive(Debug)]
struct Segment {
    start: DateTime,
    dt_s: f64,
    samples: Vec<f64>,
}

impl Segment {
    /// Time of the sample that would come next.
    fn end(&self) -> Option<DateTime> {
        let length = SignedDuration::try_from_secs_f64(self.dt_s * self.samples.len() as f64).ok()?;
        self.start.checked_add(length).ok()
    }
}

fn channel(
    source: &Source,
    code: String,
    mut segments: Vec<Segment>,
    responses: &Responses,
    reading: &Reading,
) -> Result<Channel> {
    let place = |e: Error| e.at(format!("channel `{code}`"));
    segments.sort_by_key(|segment| segment.start);
    let mut segments = segments.into_iter();
    let mut whole = segments.next().ok_or_else(|| place(Error::new("there are no samples")))?;
    for next in segments {
        let end = whole.end().ok_or_else(|| place(Error::new("its times are out of range")))?;
        let gap_s = next.start.duration_since(end).as_secs_f64();
        if next.dt_s != whole.dt_s {
            let what = format!("its step changes from {} to {} s at {}", whole.dt_s, next.dt_s, next.start);
            return Err(place(Error::new(what).hint("cut the record before it")));
        }
        if gap_s.abs() > JITTER * whole.dt_s {
            let what = if gap_s > 0.0 { "a gap" } else { "an overlap" };
            let what = format!("it has {what} of {:.3} s at {}", gap_s.abs(), next.start);
            return Err(place(Error::new(what).hint("cut the record there, or leave the event out of the split")));
        }
        whole.samples.extend(next.samples);
    }
    let response = responses.get(&code);
    let m_s2 = match response {
        Some(response) => 1.0 / response.counts_per_m_s2().map_err(place)?,
        None => reading
            .unit(None)
            .map_err(|e| {
                place(e.hint(format!(
                    "put StationXML with the sensitivity of `{code}` into the folder, or set `records.unit`"
                )))
            })?
            .m_s2(),
    };
    Ok(Channel {
        name: code,
        orientation: response.map_or(Orientation::Unknown, |r| r.orientation),
        depth_m: response.and_then(|r| r.depth_m),
        start: Some(whole.start),
        ..Channel::alone(&source.name, whole.dt_s, whole.samples.iter().map(|v| v * m_s2).collect())
    })
}

/// Numbers of a record in its byte order.
struct Words<'a> {
    bytes: &'a [u8],
    is_little: bool,
}

impl Words<'_> {
    fn array<const N: usize>(&self, at: usize) -> Result<[u8; N]> {
        let bytes = at.checked_add(N).and_then(|end| self.bytes.get(at..end)).and_then(|b| <[u8; N]>::try_from(b).ok());
        let mut bytes = bytes.ok_or_else(cut)?;
        if self.is_little {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn u16(&self, at: usize) -> Result<u16> {
        self.array(at).map(u16::from_be_bytes)
    }

    fn i16(&self, at: usize) -> Result<i16> {
        self.array(at).map(i16::from_be_bytes)
    }

    fn i32(&self, at: usize) -> Result<i32> {
        self.array(at).map(i32::from_be_bytes)
    }

    fn f32(&self, at: usize) -> Result<f32> {
        self.array(at).map(f32::from_be_bytes)
    }
}

fn cut() -> Error {
    Error::new("a record ends in its middle").hint("download the file again; was it cut off?")
}

fn damaged(what: impl Into<String>) -> Error {
    Error::new(what).hint("the file is damaged, or is no miniSEED 2: download it again")
}

/// The record that `bytes` begin with: code of its channel, samples, number of bytes.
fn record(bytes: &[u8]) -> Result<(String, Option<Segment>, usize)> {
    if bytes.len() < HEADER {
        return Err(cut());
    }
    // The byte order is that in which the year makes sense.
    let is_year = |words: &Words| words.u16(20).is_ok_and(|year| (1900..=2200).contains(&year));
    let orders = [false, true].map(|is_little| Words { bytes, is_little });
    let words = orders.into_iter().find(is_year).ok_or_else(|| damaged("a record has no year"))?;
    let text = |from: usize, to: usize| String::from_utf8_lossy(&bytes[from..to]).trim().to_string();
    let code = format!("{}.{}.{}.{}", text(18, 20), text(8, 13), text(13, 15), text(15, 18));
    let n_sample = usize::from(words.u16(30)?);
    let mut rate_hz = rate(words.i16(32)?, words.i16(34)?);
    let (mut encoding, mut exponent, mut microseconds, mut is_little) = (None, None, 0, words.is_little);
    let mut at = usize::from(words.u16(46)?);
    while at != 0 {
        let next = usize::from(words.u16(at + 2)?);
        match words.u16(at)? {
            100 => rate_hz = f64::from(words.f32(at + 4)?),
            1000 => {
                let [code, order, length] = *bytes.get(at + 4..at + 7).ok_or_else(cut)? else { return Err(cut()) };
                (encoding, exponent, is_little) = (Some(code), Some(length), order == 0);
            }
            1001 => microseconds = i64::from(*bytes.get(at + 5).ok_or_else(cut)? as i8),
            _ => {}
        }
        if next != 0 && next <= at {
            return Err(damaged("its blockettes go in a circle"));
        }
        at = next;
    }
    let (Some(encoding), Some(exponent)) = (encoding, exponent.filter(|e| (7..=20).contains(e))) else {
        return Err(damaged("a record does not say its length and encoding (blockette 1000)"));
    };
    let length = 1usize << exponent;
    if bytes.len() < length {
        return Err(cut());
    }
    if n_sample == 0 || !rate_hz.is_finite() || rate_hz <= 0.0 {
        return Ok((code, None, length));
    }
    let start = start(&words, microseconds)?;
    let data_at = usize::from(words.u16(44)?);
    let data = bytes[..length]
        .get(data_at..)
        .filter(|_| data_at >= HEADER)
        .ok_or_else(|| damaged("a record has no samples"))?;
    let samples = decode(encoding, &Words { bytes: data, is_little }, n_sample)?;
    Ok((code, Some(Segment { start, dt_s: 1.0 / rate_hz, samples }), length))
}

/// Sampling rate of factor and multiplier, Hz.
fn rate(factor: i16, multiplier: i16) -> f64 {
    let of = |value: i16| if value > 0 { f64::from(value) } else { -1.0 / f64::from(value) };
    if factor == 0 { 0.0 } else { of(factor) * if multiplier == 0 { 1.0 } else { of(multiplier) } }
}

fn start(words: &Words, microseconds: i64) -> Result<DateTime> {
    let (year, day) = (words.u16(20)?, words.u16(22)?);
    let [hour, minute, second] = [24, 25, 26].map(|at| i8::try_from(words.bytes[at]).unwrap_or(-1));
    let fraction = words.u16(28)?;
    let wrong = || damaged(format!("a record begins on day {day} of {year} at {hour}:{minute}:{second}"));
    // The correction is in the time only where bit 1 of the activity flags says so.
    let correction = if words.bytes[36] & 2 == 0 { words.i32(40)? } else { 0 };
    // A leap second is the sixtieth of its minute.
    let time = Time::new(hour, minute, second.min(59), 0).map_err(|_| wrong())?;
    let first = date(i16::try_from(year).unwrap_or(0), 1, 1).to_datetime(time);
    let tenths = i64::from(fraction) + i64::from(correction) + if second > 59 { 10_000 } else { 0 };
    let span = (i64::from(day) - 1).days().microseconds(100 * tenths + microseconds);
    first.checked_add(span).map_err(|_| wrong())
}

fn decode(encoding: u8, words: &Words, n: usize) -> Result<Vec<f64>> {
    let each = |size: usize, value: &dyn Fn(usize) -> Result<f64>| (0..n).map(|i| value(i * size)).collect();
    match encoding {
        1 => each(2, &|at| words.i16(at).map(f64::from)),
        3 => each(4, &|at| words.i32(at).map(f64::from)),
        4 => each(4, &|at| words.f32(at).map(f64::from)),
        5 => each(8, &|at| words.array(at).map(f64::from_be_bytes)),
        10 | 11 => steim(words, n, encoding == 11),
        other => Err(Error::new(format!("its samples have encoding {other}"))
            .hint("16- and 32-bit integers, floats and Steim 1 and 2 are read: write the file in one of these")),
    }
}

/// Differences of integers in frames of sixteen words; the first word of a frame says how the others are divided.
fn steim(words: &Words, n: usize, is_second: bool) -> Result<Vec<f64>> {
    let mut differences: Vec<i64> = Vec::with_capacity(n);
    let (first, last) = (i64::from(words.i32(4)?), i64::from(words.i32(8)?));
    let mut frame = 0;
    while differences.len() < n {
        let control = words.i32(64 * frame)? as u32;
        for i in 1..16 {
            let at = 64 * frame + 4 * i;
            let code = (control >> (30 - 2 * i)) & 3;
            if code == 0 || (frame == 0 && i < 3) {
                continue;
            }
            if code == 1 {
                let bytes = words.bytes.get(at..at + 4).ok_or_else(cut)?;
                differences.extend(bytes.iter().map(|byte| i64::from(*byte as i8)));
                continue;
            }
            let word = words.i32(at)? as u32;
            let (count, bits) = match (is_second, code, word >> 30) {
                (false, 2, _) => {
                    differences.extend([words.i16(at)?, words.i16(at + 2)?].map(i64::from));
                    continue;
                }
                (false, ..) => (1, 32),
                (true, 2, 1) => (1, 30),
                (true, 2, 2) => (2, 15),
                (true, 2, 3) => (3, 10),
                (true, 3, 0) => (5, 6),
                (true, 3, 1) => (6, 5),
                (true, 3, 2) => (7, 4),
                _ => return Err(damaged("a word of its samples is divided in a way that Steim does not have")),
            };
            for k in (0..count).rev() {
                let shifted = i64::from(word >> (k * bits)) << (64 - bits);
                differences.push(shifted >> (64 - bits));
            }
        }
        frame += 1;
    }
    differences.truncate(n);
    let mut value = first;
    let samples: Vec<f64> = (0..n)
        .map(|i| {
            // The first difference is to the last sample of the record before.
            value = if i == 0 { first } else { value + differences[i] };
            value as f64
        })
        .collect();
    if samples.last() != Some(&(last as f64)) {
        return Err(damaged(format!("its samples end at {value}, but {last} is stated")));
    }
    Ok(samples)
}
