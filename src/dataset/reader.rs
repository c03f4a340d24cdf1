//! Reads a trajectory back and refuses one that is cut off or inconsistent.

use super::message::{Base, Response, Sensors};
use super::writer::METADATA;
use crate::error::{Context, Error, Result};
use crate::records::visit_mcap;
use mcap::records::Record;
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
    let mut topics: BTreeMap<u16, String> = BTreeMap::new();
    let mut steps = Steps::default();
    let mut metadata = None;
    visit_mcap(bytes, &mut |record| {
        match record {
            Record::Channel(channel) => {
                topics.insert(channel.id, channel.topic);
            }
            Record::Message { header, data } => {
                if let Some(topic) = topics.get(&header.channel_id) {
                    steps.push(topic, header.sequence as usize, &data)?;
                }
            }
            Record::Metadata(found) if found.name == METADATA => metadata = Some(found.metadata),
            _ => {}
        }
        Ok(())
    })?;
    let missing = || Error::new(format!("the file has no metadata record `{METADATA}`"));
    steps.into_trajectory(metadata.ok_or_else(missing)?)
}

/// What the messages hold, before the metadata tells whether it is all.
#[derive(Default)]
struct Steps {
    base_m_s2: Vec<f64>,
    response_m_s2: Vec<f32>,
    surface_m_s2: Vec<f64>,
    n_depth: usize,
    sensors: Vec<(String, Vec<f64>)>,
    n_sensor_step: usize,
}

impl Steps {
    fn push(&mut self, topic: &str, step: usize, data: &[u8]) -> Result<()> {
        let undecodable = || format!("step {step} of `{topic}` cannot be decoded");
        let next = match topic {
            "/base" => self.base_m_s2.len(),
            "/response" => self.surface_m_s2.len(),
            "/sensors" => self.n_sensor_step,
            _ => return Ok(()),
        };
        if step != next {
            return Err(Error::new(format!("step {next} of `{topic}` is missing")));
        }
        match topic {
            "/base" => self.base_m_s2.push(Base::decode(data).context(undecodable)?.acceleration_m_s2),
            "/response" => {
                let response = Response::decode(data).context(undecodable)?;
                let n = response.acceleration_m_s2.len();
                if step == 0 {
                    self.n_depth = n;
                } else if n != self.n_depth {
                    return Err(Error::new(format!("step {step} holds {n} depths, those before {}", self.n_depth)));
                }
                self.response_m_s2.extend_from_slice(&response.acceleration_m_s2);
                self.surface_m_s2.push(response.surface_m_s2);
            }
            _ => {
                let readings = Sensors::decode(data).context(undecodable)?.readings;
                if step == 0 {
                    self.sensors = readings.iter().map(|r| (r.name.clone(), Vec::new())).collect();
                }
                if !readings.iter().map(|r| &r.name).eq(self.sensors.iter().map(|(name, _)| name)) {
                    return Err(Error::new(format!("step {step} holds other sensors than those before")));
                }
                for ((_, history), reading) in self.sensors.iter_mut().zip(&readings) {
                    history.push(reading.acceleration_m_s2);
                }
                self.n_sensor_step += 1;
            }
        }
        Ok(())
    }

    fn into_trajectory(self, metadata: BTreeMap<String, String>) -> Result<Trajectory> {
        let entry = |key: &str| {
            metadata.get(key).ok_or_else(|| Error::new(format!("the metadata record has no entry `{key}`")))
        };
        let number = |key: &str, text: &str| {
            let value = text.parse::<f64>().ok().filter(|v| v.is_finite());
            value.ok_or_else(|| Error::new(format!("metadata entry `{key}` holds `{text}`, a number is needed")))
        };
        let depths = entry("depth_m")?.split(',').filter(|text| !text.is_empty());
        let depth_m = depths.map(|text| number("depth_m", text)).collect::<Result<Vec<f64>>>()?;
        let n_step = number("n_step", entry("n_step")?)? as usize;
        if [self.base_m_s2.len(), self.surface_m_s2.len(), self.n_sensor_step] != [n_step; 3] {
            let found = self.base_m_s2.len();
            return Err(Error::new(format!("the file holds {found} steps, its metadata names {n_step}")));
        }
        if n_step > 0 && self.n_depth != depth_m.len() {
            let named = depth_m.len();
            return Err(Error::new(format!("the file holds {} depths, its metadata names {named}", self.n_depth)));
        }
        Ok(Trajectory {
            id: entry("id")?.clone(),
            dt_s: number("dt_s", entry("dt_s")?)?,
            depth_m,
            base_m_s2: self.base_m_s2,
            response_m_s2: self.response_m_s2,
            surface_m_s2: self.surface_m_s2,
            sensors: self.sensors,
            metadata,
        })
    }
}
