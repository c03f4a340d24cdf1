//! What a running column says at the depths of sensors.

use super::observation::{Observation, observation_matrix};
use crate::column::{BaseMotion, Column, Failure, Frame};
use crate::error::{Error, Result};

/// Reads sensors from frames: linear in depth between the nodes of the mesh.
pub struct Sampler {
    rows: Vec<Observation>,
}

impl Sampler {
    /// A sampler of `column` at `sensor_depth_m`.
    pub fn new(column: &Column, sensor_depth_m: &[f64]) -> Self {
        Self { rows: observation_matrix(&column.node_depths_m(), sensor_depth_m) }
    }

    /// Accelerations of the sensors at one frame into `readings_m_s2`, m/s².
    pub fn read(&self, frame: &Frame<'_>, readings_m_s2: &mut [f64]) {
        for (reading, row) in readings_m_s2.iter_mut().zip(&self.rows) {
            *reading = row.of(frame.nodes_m_s2);
        }
    }
}

/// Histories at the base and at `sensor_depth_m`, base first, m/s², one value an output step, under a base motion.
///
/// # Errors
/// When the column cannot finish the motion.
pub fn sensor_histories(column: &Column, motion: BaseMotion<'_>, sensor_depth_m: &[f64]) -> Result<Vec<Vec<f64>>> {
    all_sensor_histories(column, &[motion], sensor_depth_m).pop().unwrap_or_else(|| Ok(Vec::new()))
}

/// [`sensor_histories`] under each of the motions.
pub fn all_sensor_histories(
    column: &Column,
    motions: &[BaseMotion<'_>],
    sensor_depth_m: &[f64],
) -> Vec<Result<Vec<Vec<f64>>>> {
    let sampler = Sampler::new(column, sensor_depth_m);
    let mut readings = vec![0.0; sensor_depth_m.len()];
    let mut histories = vec![vec![Vec::new(); sensor_depth_m.len() + 1]; motions.len()];
    let runs = column.run_all(motions, &mut |motion, frame| {
        sampler.read(frame, &mut readings);
        let histories = &mut histories[motion];
        histories[0].push(frame.base_m_s2);
        for (history, reading) in histories[1..].iter_mut().zip(&readings) {
            history.push(*reading);
        }
        Ok(())
    });
    let finished = |(run, histories): (std::result::Result<_, Failure>, _)| {
        run.map(|_| histories).map_err(|failure| Error::new(failure.to_string()).of_model())
    };
    runs.into_iter().zip(histories).map(finished).collect()
}
