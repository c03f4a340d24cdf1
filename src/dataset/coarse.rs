//! A trajectory at the step of the latent model: band-limited, base also at half steps, chosen channels only.

use super::reader::Trajectory;
use crate::numerics::resample::{half_steps, resample_band_limited};
use crate::records::Record;

/// Input and response at the model's step, m/s²; matrices are row-major, one row a step.
///
/// Base, response and sensors pass the same zero-phase kernel, so that the relation between them is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct Coarse {
    /// Case or event.
    pub id: String,
    /// Time step, s.
    pub dt_s: f64,
    /// Base at the steps, `[n_step]`.
    pub base_m_s2: Vec<f64>,
    /// Base half a step later, `[n_step − 1]`, taken from the finer series.
    pub base_half_m_s2: Vec<f64>,
    /// Number of dense channels; zero for a record.
    pub n_dense: usize,
    /// Dense response, `[n_step · n_dense]`.
    pub dense_m_s2: Vec<f64>,
    /// Number of sensors.
    pub n_sparse: usize,
    /// Sensor response, `[n_step · n_sparse]`.
    pub sparse_m_s2: Vec<f64>,
}

impl Coarse {
    /// A simulated trajectory at the step `dt_s`, keeping the element centres `channels` (see [`pick_channels`]).
    pub fn of_trajectory(trajectory: &Trajectory, dt_s: f64, channels: &[usize]) -> Self {
        let dense = channels.iter().map(|c| resample_band_limited(&trajectory.response_at(*c), trajectory.dt_s, dt_s));
        let sparse = trajectory.sensors.iter().map(|(_, a)| resample_band_limited(a, trajectory.dt_s, dt_s));
        Self::new(&trajectory.id, trajectory.dt_s, dt_s, &trajectory.base_m_s2, dense.collect(), sparse.collect())
    }

    /// A record at the step `dt_s`; it has no dense channels.
    pub fn of_record(record: &Record, dt_s: f64) -> Self {
        let sparse = record.outputs.iter().map(|s| resample_band_limited(&s.acceleration_m_s2, record.dt_s, dt_s));
        Self::new(&record.event, record.dt_s, dt_s, &record.input.acceleration_m_s2, Vec::new(), sparse.collect())
    }

    /// Number of steps.
    pub fn n_step(&self) -> usize {
        self.base_m_s2.len()
    }

    /// One history a sensor, m/s².
    pub fn sensors(&self) -> Vec<Vec<f64>> {
        (0..self.n_sparse).map(|j| self.sparse_m_s2.iter().skip(j).step_by(self.n_sparse).copied().collect()).collect()
    }

    fn new(id: &str, dt_in_s: f64, dt_s: f64, base: &[f64], dense: Vec<Vec<f64>>, sparse: Vec<Vec<f64>>) -> Self {
        Self {
            id: id.into(),
            dt_s,
            base_m_s2: resample_band_limited(base, dt_in_s, dt_s),
            base_half_m_s2: half_steps(base, dt_in_s, dt_s),
            n_dense: dense.len(),
            dense_m_s2: by_rows(&dense),
            n_sparse: sparse.len(),
            sparse_m_s2: by_rows(&sparse),
        }
    }
}

/// About `n` uniformly spaced channels out of `n_total`, first and last included.
pub fn pick_channels(n_total: usize, n: usize) -> Vec<usize> {
    if n >= n_total {
        return (0..n_total).collect();
    }
    match n {
        0 => Vec::new(),
        1 => vec![0],
        _ => (0..n).map(|i| (i * (n_total - 1) + (n - 1) / 2) / (n - 1)).collect(),
    }
}

fn by_rows(columns: &[Vec<f64>]) -> Vec<f64> {
    let n_step = columns.first().map_or(0, Vec::len);
    (0..n_step).flat_map(|i| columns.iter().map(move |column| column[i])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn picked_channels_are_uniform_and_hold_both_ends() {
        assert_eq!(pick_channels(5, 3), [0, 2, 4]);
        assert_eq!(pick_channels(4, 9), [0, 1, 2, 3]);
        let picked = pick_channels(200, 100);
        assert_eq!((picked.len(), picked[0], picked[99]), (100, 0, 199));
        assert!(picked.windows(2).all(|w| (2..=3).contains(&(w[1] - w[0]))));
    }

    #[test]
    fn input_and_response_keep_their_relation_and_half_steps_fit_between() {
        let wave = |t: f64| (11.0 * t).sin() * (-((t - 7.0) / 3.0).powi(2)).exp();
        let fine = |lag_s: f64| (0..3001).map(|i| wave(i as f64 * 0.005 - lag_s)).collect::<Vec<f64>>();
        let rows: Vec<f32> =
            (0..3001).flat_map(|i| [wave(i as f64 * 0.005) as f32, wave(i as f64 * 0.005 - 0.1) as f32]).collect();
        let trajectory = Trajectory {
            id: "001".into(),
            dt_s: 0.005,
            depth_m: vec![0.5, 1.5],
            base_m_s2: fine(0.0),
            response_m_s2: rows,
            surface_m_s2: fine(0.0),
            sensors: vec![("a".into(), fine(0.2))],
            metadata: BTreeMap::new(),
        };
        let c = Coarse::of_trajectory(&trajectory, 0.05, &[0, 1]);
        assert_eq!((c.n_step(), c.base_half_m_s2.len(), c.dense_m_s2.len(), c.sparse_m_s2.len()), (301, 300, 602, 301));
        for i in 0..300 {
            let t = i as f64 * 0.05;
            assert!((c.base_half_m_s2[i] - wave(t + 0.025)).abs() < 1e-4);
            assert!((c.dense_m_s2[2 * i] - c.base_m_s2[i]).abs() < 1e-6);
            assert!((c.dense_m_s2[2 * i + 1] - wave(t - 0.1)).abs() < 1e-4);
            assert!((c.sparse_m_s2[i] - wave(t - 0.2)).abs() < 1e-4);
        }
    }
}
