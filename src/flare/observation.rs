//! The observation matrix C: sensors as weighted neighbours among the dense channels, with both normalisations.

use crate::dataset::observation_matrix;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// `a_s = C a_d`, each row a coincident channel or the linear interpolation between two.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Observation {
    /// Sensor names, `[n_sensor]`.
    pub sensors: Vec<String>,
    /// Depths of the dense channels from the surface down (m), `[n_channel]`.
    pub channel_depth_m: Vec<f64>,
    /// Depths of the sensors (m), `[n_sensor]`.
    pub sensor_depth_m: Vec<f64>,
    /// Standard deviation of each dense channel over the training simulations, `[n_channel]`.
    pub dense_std_m_s2: Vec<f64>,
    /// Standard deviation of each sensor over the training simulations, `[n_sensor]`.
    pub sparse_std_m_s2: Vec<f64>,
}

impl Observation {
    /// Checks that the lengths belong together.
    ///
    /// # Errors
    /// When they do not, when depths do not increase, or when a standard deviation is not positive.
    pub fn check(&self) -> Result<()> {
        let (n_channel, n_sensor) = (self.channel_depth_m.len(), self.sensor_depth_m.len());
        if n_channel == 0 || self.dense_std_m_s2.len() != n_channel {
            return Err(Error::new(format!(
                "{} standard deviations for {n_channel} channels",
                self.dense_std_m_s2.len()
            )));
        }
        if n_sensor == 0 || self.sparse_std_m_s2.len() != n_sensor || self.sensors.len() != n_sensor {
            return Err(Error::new(format!(
                "{} standard deviations for {n_sensor} sensors",
                self.sparse_std_m_s2.len()
            )));
        }
        if let Some(w) =
            self.channel_depth_m.windows(2).find(|w| w[1].partial_cmp(&w[0]) != Some(std::cmp::Ordering::Greater))
        {
            return Err(Error::new(format!("channel depths must increase, got {} m after {} m", w[1], w[0])));
        }
        match self.dense_std_m_s2.iter().chain(&self.sparse_std_m_s2).find(|s| !(s.is_finite() && **s > 0.0)) {
            Some(s) => Err(Error::new(format!("a standard deviation must be positive, got {s} m/s²"))
                .hint("a channel that never moves cannot be normalised")),
            None => Ok(()),
        }
    }

    /// Number of sensors.
    pub fn n_sensor(&self) -> usize {
        self.sensor_depth_m.len()
    }

    /// C in physical units, `[n_sensor · n_channel]`; beyond the outermost channels the nearest one stands.
    pub fn matrix(&self) -> Vec<f64> {
        let n_channel = self.channel_depth_m.len();
        let mut matrix = vec![0.0; self.n_sensor() * n_channel];
        let rows = observation_matrix(&self.channel_depth_m, &self.sensor_depth_m);
        for (dense, row) in matrix.chunks_exact_mut(n_channel).zip(rows) {
            for (channel, weight) in row.channels.into_iter().zip(row.weights) {
                dense[channel] += weight;
            }
        }
        matrix
    }

    /// C from normalised dense channels to normalised sensors, `[n_sensor · n_channel]`.
    pub fn normalised_matrix(&self) -> Vec<f32> {
        let mut matrix = self.matrix();
        for (row, sparse) in matrix.chunks_exact_mut(self.channel_depth_m.len()).zip(&self.sparse_std_m_s2) {
            row.iter_mut().zip(&self.dense_std_m_s2).for_each(|(w, dense)| *w *= dense / sparse);
        }
        matrix.into_iter().map(|w| w as f32).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_interpolate_linearly_and_hold_the_outermost_channel() {
        let observation = Observation {
            sensors: ["top", "middle", "bottom"].map(String::from).to_vec(),
            channel_depth_m: vec![0.5, 1.5, 2.5],
            sensor_depth_m: vec![0.0, 1.75, 3.0],
            dense_std_m_s2: vec![2.0, 1.0, 1.0],
            sparse_std_m_s2: vec![4.0, 0.5, 1.0],
        };
        assert!(observation.check().is_ok());
        assert_eq!(observation.matrix(), [1.0, 0.0, 0.0, 0.0, 0.75, 0.25, 0.0, 0.0, 1.0]);
        assert_eq!(observation.normalised_matrix(), [0.5, 0.0, 0.0, 0.0, 1.5, 0.5, 0.0, 0.0, 1.0]);
    }
}
