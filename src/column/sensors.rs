//! What the column says at the depths of sensors: linear interpolation between element centres, the surface node itself.

use super::Column;
use crate::error::{Error, Result};
use crate::motion::Motion;

/// One row of an observation matrix: `(channel, weight)` pairs that add up to one.
pub type Row = Vec<(usize, f64)>;

/// Rows that interpolate linearly from `channel_depth_m` (increasing) to each of `sensor_depth_m`.
///
/// A sensor outside the channels takes the nearest one: above the topmost centre the shear stress, and with it the slope
/// of the response, vanishes towards the free surface.
pub fn interpolation(channel_depth_m: &[f64], sensor_depth_m: &[f64]) -> Vec<Row> {
    let last = channel_depth_m.len().saturating_sub(1);
    sensor_depth_m
        .iter()
        .map(|depth| {
            let below = channel_depth_m.partition_point(|d| d < depth);
            if below == 0 || channel_depth_m.is_empty() {
                return vec![(0, 1.0)];
            }
            if below > last {
                return vec![(last, 1.0)];
            }
            let (upper, lower) = (channel_depth_m[below - 1], channel_depth_m[below]);
            let weight = (depth - upper) / (lower - upper);
            if weight == 1.0 { vec![(below, 1.0)] } else { vec![(below - 1, 1.0 - weight), (below, weight)] }
        })
        .collect()
}

impl Column {
    /// Accelerations at the base and at `depth_m` under `motion`, one history each, base first, m/s², one value an output
    /// step of the analysis.
    ///
    /// # Errors
    /// When the column cannot finish the motion.
    pub fn sensors(&self, motion: &Motion, depth_m: &[f64]) -> Result<Vec<Vec<f64>>> {
        let rows = interpolation(&self.channel_depths_m(), depth_m);
        let mut histories = vec![Vec::new(); depth_m.len() + 1];
        self.run(motion.dt_s, &motion.acceleration_m_s2, &mut |frame| {
            histories[0].push(frame.base_m_s2);
            for ((history, row), depth) in histories[1..].iter_mut().zip(&rows).zip(depth_m) {
                let value = if *depth == 0.0 {
                    frame.surface_m_s2
                } else {
                    row.iter().map(|(channel, weight)| weight * frame.elements_m_s2[*channel]).sum()
                };
                history.push(value);
            }
            Ok(())
        })
        .map_err(|failure| Error::new(failure.to_string()).at(format!("motion `{}`", motion.id)))?;
        Ok(histories)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_reproduce_a_linear_field_and_clamp_outside() {
        let depths = [0.5, 1.5, 2.5];
        let rows = interpolation(&depths, &[0.0, 0.5, 1.75, 2.5, 9.0]);
        let read = |row: &Row| row.iter().map(|(c, w)| w * depths[*c]).sum::<f64>();
        let values: Vec<f64> = rows.iter().map(read).collect();
        assert_eq!(values, [0.5, 0.5, 1.75, 2.5, 2.5]);
        assert!(rows.iter().all(|r| (r.iter().map(|(_, w)| w).sum::<f64>() - 1.0).abs() < 1e-15));
    }
}
