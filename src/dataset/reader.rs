//! Reads a trajectory back and refuses one that is cut off or inconsistent.

use super::message::{Base, Response, Sensors};
use super::writer::METADATA;
use crate::error::{Context, Error, Result};
use prost::Message;
use std::collections::BTreeMap;
use std::path::Path;

/// A trajectory in memory; accelerations in m/s².
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// Case or event.
    pub id: String,
    /// Output step, s.
    pub dt_s: f64,
    /// Depth of the element centres, surface down, m.
    pub depth_m: Vec<f64>,
    /// Base, `[n_step]`.
    pub base_m_s2: Vec<f64>,
    /// Element centres, row-major `[n_step · n_depth]`.
    pub response_m_s2: Vec<f32>,
    /// Surface node, `[n_step]`.
    pub surface_m_s2: Vec<f64>,
    /// Sensors by name, each `[n_step]`.
    pub sensors: Vec<(String, Vec<f64>)>,
    /// All entries of the metadata record.
    pub metadata: BTreeMap<String, String>,
}

impl Trajectory {
    /// Number of output steps.
    pub fn n_step(&self) -> usize {
        self.base_m_s2.len()
    }

    /// Number of element centres.
    pub fn n_depth(&self) -> usize {
        self.depth_m.len()
    }

    /// History of element centre `channel`.
    pub fn response_at(&self, channel: usize) -> Vec<f64> {
        self.response_m_s2.iter().skip(channel).step_by(self.n_depth().max(1)).map(|v| f64::from(*v)).collect()
    }
}

/// Reads the trajectory of `path`.
///
/// # Errors
/// When the file is missing, cut off, damaged or not a trajectory.
pub fn read_trajectory(path: &Path) -> Result<Trajectory> {
    let bytes = std::fs::read(path).context(|| format!("cannot read `{}`", path.display()))?;
    decode(&bytes).map_err(|e| {
        e.at(format!("`{}`", path.display()))
            .hint("the file is damaged: delete it and run again, it will be computed anew")
    })
}

fn decode(bytes: &[u8]) -> Result<Trajectory> {
    let unsound = || "the file is not a whole MCAP file".to_string();
    let metadata = metadata(bytes)?;
    let entry =
        |key: &str| metadata.get(key).ok_or_else(|| Error::new(format!("the metadata record has no entry `{key}`")));
    let number = |key: &str, text: &str| {
        text.parse::<f64>()
            .ok()
            .filter(|v| v.is_finite())
            .ok_or_else(|| Error::new(format!("metadata entry `{key}` holds `{text}`, a number is needed")))
    };
    let depth_m = listed(entry("depth_m")?).map(|text| number("depth_m", text)).collect::<Result<Vec<f64>>>()?;
    let names: Vec<String> = listed(entry("sensors")?).map(Into::into).collect();
    let n_step = number("n_step", entry("n_step")?)? as usize;
    let mut t = Trajectory {
        id: entry("id")?.clone(),
        dt_s: number("dt_s", entry("dt_s")?)?,
        depth_m,
        base_m_s2: Vec::new(),
        response_m_s2: Vec::new(),
        surface_m_s2: Vec::new(),
        sensors: names.into_iter().map(|name| (name, Vec::new())).collect(),
        metadata: metadata.clone(),
    };
    for message in mcap::MessageStream::new(bytes).context(unsound)? {
        let message = message.context(unsound)?;
        let step = |n: usize| {
            if message.sequence as usize == n { Ok(()) } else { Err(Error::new(format!("step {n} is missing"))) }
        };
        let undecodable = || format!("a message on `{}` cannot be decoded", message.channel.topic);
        match message.channel.topic.as_str() {
            "/base" => {
                step(t.base_m_s2.len())?;
                t.base_m_s2.push(Base::decode(&*message.data).context(undecodable)?.acceleration_m_s2);
            }
            "/response" => {
                step(t.surface_m_s2.len())?;
                let response = Response::decode(&*message.data).context(undecodable)?;
                if response.acceleration_m_s2.len() != t.depth_m.len() {
                    return Err(Error::new(format!(
                        "a step holds {} element accelerations, the metadata names {} depths",
                        response.acceleration_m_s2.len(),
                        t.depth_m.len()
                    )));
                }
                t.response_m_s2.extend_from_slice(&response.acceleration_m_s2);
                t.surface_m_s2.push(response.surface_m_s2);
            }
            "/sensors" => {
                let sensors = Sensors::decode(&*message.data).context(undecodable)?;
                let same = sensors.readings.iter().map(|r| &r.name).eq(t.sensors.iter().map(|(name, _)| name));
                if !same {
                    return Err(Error::new("a step holds other sensors than the metadata names"));
                }
                for ((_, history), reading) in t.sensors.iter_mut().zip(&sensors.readings) {
                    history.push(reading.acceleration_m_s2);
                }
            }
            _ => {}
        }
    }
    let sensors_differ = t.sensors.iter().any(|(_, history)| history.len() != n_step);
    if t.base_m_s2.len() != n_step || t.surface_m_s2.len() != n_step || sensors_differ {
        return Err(Error::new(format!("the file holds {} steps, its metadata names {n_step}", t.base_m_s2.len())));
    }
    Ok(t)
}

/// Entries of a comma-separated list; none for an empty text.
fn listed(text: &str) -> impl Iterator<Item = &str> {
    text.split(',').filter(|part| !part.is_empty())
}

fn metadata(bytes: &[u8]) -> Result<BTreeMap<String, String>> {
    let unsound = || "the file is not a whole MCAP file".to_string();
    let summary = mcap::Summary::read(bytes).context(unsound)?.ok_or_else(|| Error::new(unsound()))?;
    let index = summary.metadata_indexes.iter().find(|i| i.name == METADATA);
    let index = index.ok_or_else(|| Error::new(format!("the file has no metadata record `{METADATA}`")))?;
    // The reader slices by these numbers, which a damaged file can make arbitrary.
    if index.offset.checked_add(index.length).is_none_or(|end| end > bytes.len() as u64) {
        return Err(Error::new(unsound()));
    }
    Ok(mcap::read::metadata(bytes, index).context(unsound)?.metadata)
}
