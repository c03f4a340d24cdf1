//! From the output depths of a column to the depths of the sensors: rows of the observation matrix C.

/// A sensor's acceleration as weighted sum of two output channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Index of the upper channel and of the lower one.
    pub channels: [usize; 2],
    /// Their weights; they add up to one.
    pub weights: [f64; 2],
}

impl Observation {
    /// The observed value of one step of channels.
    pub fn of(&self, values: &[f64]) -> f64 {
        self.channels.iter().zip(self.weights).map(|(c, w)| w * values[*c]).sum()
    }
}

/// Rows of C: linear interpolation between adjacent channels, the nearest channel beyond the first and the last.
///
/// ```text
/// a_s = C a_d
/// ```
///
/// | symbol | argument        | shape       | unit |
/// |--------|-----------------|-------------|------|
/// |        | channel_depth_m | `[n_channel]` | m    |
/// |        | sensor_depth_m  | `[n_sensor]`  | m    |
///
/// For a simulated step, put the surface node (depth 0) before and the base after the element centres, and every sensor
/// lies between two channels.
///
/// Limits: `channel_depth_m` must rise and not be empty.
/// Check:  `sensors_between_channels_are_interpolated_and_outside_take_the_nearest`.
pub fn observation_matrix(channel_depth_m: &[f64], sensor_depth_m: &[f64]) -> Vec<Observation> {
    let last = channel_depth_m.len().saturating_sub(1);
    sensor_depth_m
        .iter()
        .map(|&depth_m| {
            let below = channel_depth_m.partition_point(|d| *d < depth_m).min(last);
            let above = below.saturating_sub(1);
            let span_m = channel_depth_m[below] - channel_depth_m[above];
            let share = if span_m > 0.0 { ((depth_m - channel_depth_m[above]) / span_m).clamp(0.0, 1.0) } else { 1.0 };
            Observation { channels: [above, below], weights: [1.0 - share, share] }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sensors_between_channels_are_interpolated_and_outside_take_the_nearest() {
        let depth_m = [0.5, 1.5, 2.5];
        let field = [10.0, 20.0, 40.0];
        let c = observation_matrix(&depth_m, &[0.0, 0.5, 1.0, 2.0, 2.5, 9.0]);
        let seen: Vec<f64> = c.iter().map(|row| row.of(&field)).collect();
        assert_eq!(seen, [10.0, 10.0, 15.0, 30.0, 40.0, 40.0]);
        assert!(c.iter().all(|row| (row.weights[0] + row.weights[1] - 1.0).abs() < 1e-15));
        assert_eq!(observation_matrix(&[3.0], &[1.0])[0].of(&[7.0]), 7.0);
    }
}
