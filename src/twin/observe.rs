//! The observation operator of a twin: gain, clock, azimuth and noise of each sensor.

use super::{Draw, Noise, SensorDraw};
use crate::error::Result;
use crate::numerics::delay;
use crate::records::white_noise;

/// Accelerations of one sensor, one history a component, m/s².
pub type Channels = Vec<Vec<f64>>;

/// What the sensors record of the true motions `truth` (`[sensor][component][step]`, the input sensor first).
///
/// # Errors
/// When the Fourier transform refuses a length.
pub fn observe(truth: &[Channels], dt_s: f64, draw: &Draw, noise: &Noise, seed: u64, event: &str) -> Result<Vec<Channels>> {
    truth
        .iter()
        .zip(&draw.sensors)
        .enumerate()
        .map(|(sensor, (channels, drawn))| {
            let fraction = if sensor == 0 { noise.input_fraction } else { noise.output_fraction };
            let turned = turn(channels, drawn);
            turned
                .iter()
                .enumerate()
                .map(|(component, history)| {
                    let mut recorded = delay::delay(history, dt_s, drawn.clock_s);
                    recorded.iter_mut().for_each(|a| *a *= drawn.gain_ln.exp());
                    let level = fraction * rms(&recorded);
                    let label = format!("twin noise {event} sensor {sensor} component {component}");
                    for (a, n) in recorded.iter_mut().zip(white_noise(history.len(), level, seed, &label)) {
                        *a += n;
                    }
                    Ok(recorded)
                })
                .collect()
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

fn rms(x: &[f64]) -> f64 {
    (x.iter().map(|v| v * v).sum::<f64>() / x.len().max(1) as f64).sqrt()
}
