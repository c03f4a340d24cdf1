//! The observation operator of a twin: gain, clock and azimuth of each sensor.

use super::{Draw, SensorDraw};
use crate::numerics::delay;

/// Accelerations of one sensor, one history a component, m/s².
pub type Channels = Vec<Vec<f64>>;

/// What the sensors record, noise apart, of the true motions `truth` (`[sensor][component][step]`, the input sensor first).
pub fn observe(truth: &[Channels], dt_s: f64, draw: &Draw) -> Vec<Channels> {
    truth
        .iter()
        .zip(&draw.sensors)
        .map(|(channels, drawn)| {
            let gain = drawn.gain_ln.exp();
            let recorded = |history: &Vec<f64>| -> Vec<f64> {
                delay::delay(history, dt_s, drawn.clock_s).into_iter().map(|a| gain * a).collect()
            };
            turn(channels, drawn).iter().map(recorded).collect()
        })
        .collect()
}

/// Turns the first two components by the azimuth error; a single component only loses the cosine.
fn turn(channels: &Channels, drawn: &SensorDraw) -> Channels {
    let (sin, cos) = drawn.azimuth_rad.sin_cos();
    match channels.as_slice() {
        [first, second, rest @ ..] => {
            let a = first.iter().zip(second).map(|(x, y)| cos * x + sin * y).collect();
            let b = first.iter().zip(second).map(|(x, y)| cos * y - sin * x).collect();
            [a, b].into_iter().chain(rest.iter().cloned()).collect()
        }
        _ => channels.iter().map(|c| c.iter().map(|x| cos * x).collect()).collect(),
    }
}
