//! Streaming writer of one trajectory: an MCAP file with one message an output step on each of three topics.

use super::message::{self, Base, Reading, Response, Sensors};
use crate::atomic::Partial;
use crate::error::{Context, Error, Result};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, WriteOptions, Writer};
use prost::Message;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Written into the file instead of the crate's version, so that bytes do not change with a dependency.
const LIBRARY: &str = "flare-pipe";
/// Profile of the file: tells a reader what the topics mean.
const PROFILE: &str = "flare-pipe-trajectory-1";
/// Name of the metadata record.
pub(super) const METADATA: &str = "trajectory";
/// Uncompressed size at which a chunk is closed, bytes.
const CHUNK_BYTES: u64 = 1 << 20;

/// What is known of a trajectory before its first step.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// Case or event.
    pub id: String,
    /// Output step, s.
    pub dt_s: f64,
    /// Depth of the element centres, surface down, m.
    pub depth_m: Vec<f64>,
    /// Names of the sensors.
    pub sensors: Vec<String>,
    /// Further metadata: site, law, motion id, seed, key, …
    pub metadata: BTreeMap<String, String>,
}

/// Accelerations of one output step, m/s².
#[derive(Debug, Clone, Copy)]
pub struct Sample<'a> {
    /// Time since the first sample, s.
    pub time_s: f64,
    /// Base.
    pub base_m_s2: f64,
    /// Element centres, surface down.
    pub response_m_s2: &'a [f64],
    /// Surface node.
    pub surface_m_s2: f64,
    /// Sensors, in the order of [`Header::sensors`].
    pub sensors_m_s2: &'a [f64],
}

/// Writes one trajectory step by step; the file appears under its name only when finished.
pub struct TrajectoryWriter {
    mcap: Writer<BufWriter<File>>,
    partial: Partial,
    path: PathBuf,
    header: Header,
    channels: [u16; 3],
    n_step: u32,
    sensors: Sensors,
    response: Response,
    buffer: Vec<u8>,
}

impl TrajectoryWriter {
    /// Starts the file `path`.
    ///
    /// # Errors
    /// When the folder does not exist or cannot be written.
    pub fn create(path: &Path, header: Header) -> Result<Self> {
        let (partial, file) = Partial::create(path)?;
        let mut mcap = WriteOptions::new()
            .compression(Some(Compression::Zstd))
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .library(LIBRARY)
            .profile(PROFILE)
            .create(BufWriter::with_capacity(1 << 18, file))
            .context(|| unwritable(path))?;
        let schema = message::descriptor_set();
        let mut channel = |topic: &str, name: &str| -> Result<u16> {
            let schema = mcap.add_schema(&message::schema_name(name), "protobuf", &schema);
            schema.and_then(|id| mcap.add_channel(id, topic, "protobuf", &BTreeMap::new())).context(|| unwritable(path))
        };
        let channels = [channel("/base", "Base")?, channel("/response", "Response")?, channel("/sensors", "Sensors")?];
        let reading = |name: &String| Reading { name: name.clone(), acceleration_m_s2: 0.0 };
        let sensors = Sensors { time_s: 0.0, readings: header.sensors.iter().map(reading).collect() };
        let response = Response { time_s: 0.0, acceleration_m_s2: vec![0.0; header.depth_m.len()], surface_m_s2: 0.0 };
        let path = path.to_path_buf();
        Ok(Self { mcap, partial, path, header, channels, n_step: 0, sensors, response, buffer: Vec::new() })
    }

    /// Appends one output step.
    ///
    /// # Errors
    /// When the numbers of elements or sensors differ from the header's, a value is not finite, or the disk is full.
    pub fn push(&mut self, sample: &Sample) -> Result<()> {
        let expect = |what: &str, got: usize, expected: usize| {
            let text = format!("a step holds {got} {what}, the trajectory has {expected}");
            if got == expected { Ok(()) } else { Err(Error::new(text).at(format!("trajectory `{}`", self.header.id))) }
        };
        expect("element accelerations", sample.response_m_s2.len(), self.response.acceleration_m_s2.len())?;
        expect("sensor accelerations", sample.sensors_m_s2.len(), self.sensors.readings.len())?;
        let finite = |x: &[f64]| x.iter().all(|v| v.is_finite());
        if !finite(sample.response_m_s2)
            || !finite(sample.sensors_m_s2)
            || !finite(&[sample.time_s, sample.base_m_s2, sample.surface_m_s2])
        {
            return Err(Error::new(format!("the response is not a finite number at {:.3} s", sample.time_s))
                .at(format!("trajectory `{}`", self.header.id)));
        }
        let time_s = sample.time_s;
        self.send(0, time_s, &Base { time_s, acceleration_m_s2: sample.base_m_s2 })?;
        let mut response = std::mem::take(&mut self.response);
        response.time_s = time_s;
        response.surface_m_s2 = sample.surface_m_s2;
        for (to, from) in response.acceleration_m_s2.iter_mut().zip(sample.response_m_s2) {
            *to = *from as f32;
        }
        self.send(1, time_s, &response)?;
        self.response = response;
        let mut sensors = std::mem::take(&mut self.sensors);
        sensors.time_s = time_s;
        for (to, from) in sensors.readings.iter_mut().zip(sample.sensors_m_s2) {
            to.acceleration_m_s2 = *from;
        }
        self.send(2, time_s, &sensors)?;
        self.sensors = sensors;
        self.n_step += 1;
        Ok(())
    }

    fn send(&mut self, topic: usize, time_s: f64, message: &impl Message) -> Result<()> {
        self.buffer.clear();
        message.encode(&mut self.buffer).context(|| unwritable(&self.path))?;
        let time_ns = (time_s.max(0.0) * 1e9).round() as u64;
        let header = MessageHeader {
            channel_id: self.channels[topic],
            sequence: self.n_step,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.mcap.write_to_known_channel(&header, &self.buffer).context(|| unwritable(&self.path))
    }

    /// Adds or replaces a metadata entry, for what is known only after the run (steps, cuts, iterations).
    pub fn note(&mut self, key: &str, value: impl ToString) {
        self.header.metadata.insert(key.into(), value.to_string());
    }

    /// Writes metadata and index, flushes to disk and gives the file its name.
    ///
    /// # Errors
    /// When the disk is full or the rename is refused; nothing is left behind then.
    pub fn finish(mut self) -> Result<()> {
        let path = self.path.clone();
        let list = |values: Vec<String>| values.join(",");
        let mut metadata = std::mem::take(&mut self.header.metadata);
        metadata.insert("id".into(), self.header.id.clone());
        metadata.insert("dt_s".into(), self.header.dt_s.to_string());
        metadata.insert("n_step".into(), self.n_step.to_string());
        metadata.insert("depth_m".into(), list(self.header.depth_m.iter().map(f64::to_string).collect()));
        metadata.insert("sensors".into(), list(self.header.sensors.clone()));
        metadata.insert("unit".into(), "m/s2".into());
        let metadata = Metadata { name: METADATA.into(), metadata };
        self.mcap.write_metadata(&metadata).context(|| unwritable(&path))?;
        self.mcap.finish().context(|| unwritable(&path))?;
        let mut out = self.mcap.into_inner();
        out.flush().context(|| unwritable(&path))?;
        self.partial.publish(out.get_ref())
    }
}

fn unwritable(path: &Path) -> String {
    format!("cannot write `{}`", path.display())
}
