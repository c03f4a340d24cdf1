//! MCAP as `flare-pipe export` writes it: a topic `/MODEL/SENSOR` with messages `{"acceleration_m_s2": …}`, one component of one event a file.
//!
//! A channel is named by its topic, `record/surface`. The files are called `EVENT.COMPONENT.mcap`; of a manifest's sensors the record is taken
//! (`record/input` is the input sensor) unless `[records.channels]` says otherwise. Other topics are left alone.

use super::channel::Channel;
use super::folder::LARGEST_BYTES;
use super::{Format, Reading, Role, Source, Usual};
use crate::error::{Context, Error, Result};
use crate::registry::{Entry, params};
use crate::units::AccelerationUnit;
use ::mcap::records::{Record, op};
use ::mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// First bytes of a file.
const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// Share of a step by which a message may be early or late.
const JITTER: f64 = 0.01;

pub(super) const ENTRY: Entry<dyn Format> = Entry {
    name: "mcap",
    about: "MCAP of `flare-pipe export`, one component of an event a file",
    build: |table| Ok(Box::new(params::<Mcap>(table)?)),
    schema: || schemars::schema_for!(Mcap),
};

/// MCAP has no parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mcap {}

/// A message of an acceleration; others lack it.
#[derive(Deserialize)]
struct Sample {
    acceleration_m_s2: Option<f64>,
}

impl Format for Mcap {
    fn recognises(&self, _: &str, head: &[u8]) -> bool {
        head.starts_with(MAGIC)
    }

    fn usual(&self, role: &Role) -> Result<Option<Usual>> {
        let sensor = if role.is_input { "input" } else { role.sensor };
        let file = format!("{}.{}.mcap", role.event, role.component);
        Ok(Some(Usual { file, channel: format!("record/{sensor}") }))
    }

    fn read(&self, source: &Source, bytes: &[u8], reading: &Reading) -> Result<Vec<Channel>> {
        reading.unit(Some(AccelerationUnit::MetrePerSecondSquared))?;
        channels(&source.name, bytes, reading.is_wanted)
    }
}

/// Hands every channel, message and metadata record of an MCAP file to `on`, all checksums verified. Lengths inside of the file are looked
/// at before anything is made of them.
///
/// # Errors
/// When the file is damaged, or its chunks expand to more than a file of records can hold.
pub fn visit(bytes: &[u8], on: &mut dyn FnMut(Record<'_>) -> Result<()>) -> Result<()> {
    let unsound = || "the file is no whole MCAP".to_string();
    check_chunks(bytes)?;
    let mut reader = LinearReader::new_with_options(
        LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true)
            .with_validate_summary_section_crc(true)
            .with_check_finishes_after_end_magic(true)
            .with_record_length_limit(LARGEST_BYTES as usize),
    );
    let mut rest = bytes;
    while let Some(event) = reader.next_event() {
        match event.context(unsound)? {
            LinearReadEvent::ReadRequest(wanted) => {
                let (now, later) = rest.split_at(wanted.min(rest.len()));
                reader.insert(now.len())[..now.len()].copy_from_slice(now);
                reader.notify_read(now.len());
                rest = later;
            }
            LinearReadEvent::Record { opcode, data } => {
                let is_whole = match opcode {
                    op::CHANNEL => Fields(data).skip(4).text().text().map().is_whole(),
                    op::METADATA => Fields(data).text().map().is_whole(),
                    op::MESSAGE => true,
                    _ => continue,
                };
                if !is_whole {
                    return Err(Error::new(unsound()).cause("a text is longer than its record"));
                }
                on(::mcap::parse_record(opcode, data).context(unsound)?)?;
            }
        }
    }
    Ok(())
}

/// What is left of a record when some of its fields are passed; longer than it is once one did not fit.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    /// Stands for a field that does not fit.
    const BROKEN: Self = Fields(&[u8::MAX; 4]);

    fn skip(self, n: usize) -> Self {
        self.0.get(n..).map_or(Self::BROKEN, Fields)
    }

    /// A length and as many bytes.
    fn text(self) -> Self {
        match self.0.first_chunk().map(|b| u32::from_le_bytes(*b) as usize) {
            Some(length) => self.skip(4).skip(length),
            None => Self::BROKEN,
        }
    }

    /// A length and as many bytes of texts.
    fn map(self) -> Self {
        let Some(length) = self.0.first_chunk().map(|b| u32::from_le_bytes(*b) as usize) else { return Self::BROKEN };
        let Some(inside) = self.0.get(4..4 + length) else { return Self::BROKEN };
        let mut texts = Fields(inside);
        while !texts.0.is_empty() {
            let before = texts.0.len();
            texts = texts.text();
            if texts.0.len() >= before {
                return Self::BROKEN;
            }
        }
        self.skip(4 + length)
    }

    fn is_whole(&self) -> bool {
        self.0.is_empty()
    }
}

/// Refuses a file whose chunks say that they expand to more than a file of records can hold: a few compressed bytes may stand for
/// gigabytes.
fn check_chunks(bytes: &[u8]) -> Result<()> {
    let mut rest = bytes.get(MAGIC.len()..).unwrap_or_default();
    let mut expanded: u64 = 0;
    // Each record is an opcode, its length, and that many bytes; those of a chunk begin with two times, its size, a checksum, a text.
    while let (Some(opcode), Some(length)) = (rest.first(), rest.get(1..).and_then(number)) {
        let (body, after) =
            rest[9..].split_at_checked(usize::try_from(length).unwrap_or(usize::MAX)).unwrap_or_default();
        if *opcode == op::CHUNK {
            expanded = expanded.saturating_add(body.get(16..).and_then(number).unwrap_or(0));
            let compression =
                body.get(28..).and_then(|text| text.first_chunk()).map(|b| u32::from_le_bytes(*b) as usize);
            if compression.is_none_or(|length| length > body.len()) {
                return Err(Error::new("the file is no whole MCAP").cause("a chunk ends in its header"));
            }
            // What is not compressed is handed out record by record, its checksum notwithstanding: that is as wrong as who wrote it.
            let records = || {
                let length = usize::try_from(body.get(32..).and_then(number)?).ok()?;
                body.get(40..)?.get(..length)
            };
            if compression == Some(0) && !records().is_some_and(holds_whole_records) {
                return Err(Error::new("the file is no whole MCAP").cause("a record is longer than its chunk"));
            }
        }
        rest = after;
    }
    if expanded > LARGEST_BYTES {
        let most = LARGEST_BYTES >> 20;
        return Err(Error::new(format!("the file expands to {} MiB, at most {most} MiB are read", expanded >> 20)));
    }
    Ok(())
}

/// The number that `bytes` begin with.
fn number(bytes: &[u8]) -> Option<u64> {
    bytes.first_chunk().map(|b| u64::from_le_bytes(*b))
}

/// Whether `bytes` are records one after the other, each an opcode, its length, and that many bytes.
fn holds_whole_records(mut bytes: &[u8]) -> bool {
    while let Some(length) = bytes.get(1..).and_then(number) {
        let Some(rest) = usize::try_from(length).ok().and_then(|n| bytes[9..].get(n..)) else { return false };
        bytes = rest;
    }
    bytes.is_empty()
}

/// The wanted channels of a `file`.
fn channels(file: &str, bytes: &[u8], is_wanted: &dyn Fn(&str) -> bool) -> Result<Vec<Channel>> {
    let mut names: BTreeMap<u16, String> = BTreeMap::new();
    let mut histories: BTreeMap<String, Vec<(u64, f64)>> = BTreeMap::new();
    visit(bytes, &mut |record| {
        match record {
            Record::Channel(channel) => {
                let name = channel.topic.trim_start_matches('/');
                if channel.message_encoding == "json" && is_wanted(name) {
                    names.insert(channel.id, name.to_string());
                }
            }
            Record::Message { header, data } => {
                let Some(name) = names.get(&header.channel_id) else { return Ok(()) };
                let sample: Sample = serde_json::from_slice(&data)
                    .context(|| format!("a message of `{name}` at {} ns is no JSON", header.log_time))?;
                if let Some(value) = sample.acceleration_m_s2.filter(|v| v.is_finite()) {
                    histories.entry(name.clone()).or_default().push((header.log_time, value));
                }
            }
            _ => {}
        }
        Ok(())
    })?;
    histories.into_iter().map(|(name, history)| channel(file, name, history)).collect()
}

fn channel(file: &str, name: String, mut history: Vec<(u64, f64)>) -> Result<Channel> {
    history.sort_by_key(|(time_ns, _)| *time_ns);
    let (Some(first), Some(last), true) = (history.first(), history.last(), history.len() > 2) else {
        return Err(Error::new(format!("`{name}` has {} samples, 3 or more are needed", history.len())));
    };
    if first.0 > 0 {
        let what = format!("`{name}` begins {} s after the motion of the base", 1e-9 * first.0 as f64);
        return Err(Error::new(what).hint("a record begins with it: take the topics of `record` or of finite elements"));
    }
    let (start_ns, step_ns) = (first.0, (last.0 - first.0) as f64 / (history.len() - 1) as f64);
    let is_off = |(i, (time_ns, _)): (usize, &(u64, f64))| {
        ((time_ns - start_ns) as f64 - i as f64 * step_ns).abs() > JITTER * step_ns
    };
    if let Some(i) = history.iter().enumerate().position(is_off) {
        let what = format!("`{name}` has no uniform step: sample {} is at {} s", i + 1, 1e-9 * history[i].0 as f64);
        return Err(Error::new(what).hint("resample it, or cut it at the gap"));
    }
    let samples = history.iter().map(|(_, value)| *value).collect();
    Ok(Channel { name, ..Channel::alone(file, 1e-9 * step_ns, samples) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::mcap::WriteOptions;
    use ::mcap::records::MessageHeader;

    fn read(times_ns: &[u64]) -> Result<Vec<Channel>> {
        channels("E1.NS.mcap", &written(times_ns), &|_| true)
    }

    fn written(times_ns: &[u64]) -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut writer = WriteOptions::new().compression(None).create(&mut bytes).unwrap();
        let topics = ["/record/surface", "/declared/depth/1.00 m"];
        let schema = writer.add_schema("Any", "jsonschema", b"{}").unwrap();
        let ids = topics.map(|topic| writer.add_channel(schema, topic, "json", &BTreeMap::new()).unwrap());
        for (i, time_ns) in times_ns.iter().enumerate() {
            let contents = [format!("{{\"acceleration_m_s2\": {i}}}"), "{\"strain\": 1e-3}".into()];
            for (channel_id, content) in ids.into_iter().zip(contents) {
                let (log_time, publish_time) = (*time_ns, *time_ns);
                let header = MessageHeader { channel_id, sequence: i as u32, log_time, publish_time };
                writer.write_to_known_channel(&header, content.as_bytes()).unwrap();
            }
        }
        writer.finish().unwrap();
        drop(writer);
        bytes.into_inner()
    }

    #[test]
    fn a_record_that_is_longer_than_its_chunk_is_refused() {
        let sound = written(&[0, 5_000_000, 10_000_000]);
        let mut chunk = MAGIC.len();
        while sound[chunk] != op::CHUNK {
            chunk += 9 + u64::from_le_bytes(sound[chunk + 1..chunk + 9].try_into().unwrap()) as usize;
        }
        // Without a checksum, as a writer may leave it.
        let body = chunk + 9;
        let damaged = |length: u64| {
            let mut bytes = sound.clone();
            bytes[body + 24..body + 28].fill(0);
            bytes[body + 41..body + 49].copy_from_slice(&length.to_le_bytes());
            channels("E1.NS.mcap", &bytes, &|_| true)
        };
        let own = u64::from_le_bytes(sound[body + 41..body + 49].try_into().unwrap());
        // The records of this chunk are more than the first.
        for length in [1, own - 1, own + 1, 1 << 20, u64::MAX - 8] {
            let error = damaged(length).unwrap_err();
            assert!(format!("{error}").contains("no whole MCAP"), "{length}: {error}");
        }
    }

    #[test]
    fn accelerations_are_read_and_gaps_refused() {
        let found = read(&[0, 5_000_000, 10_000_000]).unwrap();
        assert_eq!(found.len(), 1, "strains are no accelerations");
        assert_eq!((found[0].name.as_str(), found[0].dt_s), ("record/surface", 0.005));
        assert_eq!(found[0].acceleration_m_s2, [0.0, 1.0, 2.0]);
        let refused = |times_ns: &[u64]| read(times_ns).unwrap_err().to_string();
        assert!(refused(&[0, 5_000_000, 20_000_000]).contains("sample 2 is at 0.005 s"));
        assert!(refused(&[5_000_000, 10_000_000, 15_000_000]).contains("begins 0.005 s after"));
        assert!(refused(&[0, 5_000_000]).contains("has 2 samples"));
    }
}
