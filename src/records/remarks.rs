//! What is odd about a record that can be read, in sentences for people.

use super::record::{Record, Sensor};
use crate::metrics::rms;

/// Offset over the RMS about it from which a channel is not centred.
const OFFSET: f64 = 0.5;
/// Samples in a row at the peak of a channel that make it clipped.
const CLIPPED: usize = 3;
/// Lowest sampling rate at which the band of engineering interest is whole, Hz.
const LEAST_RATE_HZ: f64 = 40.0;

/// What is odd about `record`: channels without motion, offsets, peaks that are cut off, a coarse step.
pub fn remarks(record: &Record) -> Vec<String> {
    let mut found: Vec<String> = record.sensors().flat_map(of_sensor).collect();
    let rate_hz = 1.0 / record.dt_s;
    if rate_hz < LEAST_RATE_HZ {
        found.push(format!("{rate_hz:.0} samples/s: nothing above {:.1} Hz", 0.5 * rate_hz));
    }
    found
}

fn of_sensor(sensor: &Sensor) -> Vec<String> {
    let (x, name) = (&sensor.acceleration_m_s2, &sensor.name);
    let [low, high] = x.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(*v), b.max(*v)]);
    if low == high {
        return vec![format!("`{name}` is dead: {low} m/s² throughout")];
    }
    let mut found = Vec::new();
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    let about: Vec<f64> = x.iter().map(|v| v - mean).collect();
    let spread = rms(&about);
    if mean.abs() > OFFSET * spread {
        found.push(format!("`{name}` has an offset of {mean:.3} m/s², {:.1} × its RMS", mean.abs() / spread));
    }
    let longest = [low, high].map(|end| longest_run(x, end)).into_iter().max().unwrap_or(0);
    if longest >= CLIPPED {
        found.push(format!("`{name}` may be clipped: {longest} samples in a row at its peak"));
    }
    found
}

fn longest_run(x: &[f64], value: f64) -> usize {
    x.split(|v| *v != value).map(<[f64]>::len).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::record;
    use super::*;

    #[test]
    fn what_is_odd_is_told_and_what_is_sound_is_not() {
        let sound = record(2000, 0.01, 0.5);
        assert!(remarks(&sound).is_empty(), "{:?}", remarks(&sound));
        let with = |change: &dyn Fn(&mut Vec<f64>)| {
            let mut odd = sound.clone();
            change(&mut odd.outputs[1].acceleration_m_s2);
            remarks(&odd)
        };
        assert_eq!(with(&|x| x.fill(0.2)), ["`surface` is dead: 0.2 m/s² throughout"]);
        assert!(with(&|x| x.iter_mut().for_each(|v| *v += 49.0))[0].contains("offset of 49.0"));
        assert!(with(&|x| x.iter_mut().for_each(|v| *v = v.clamp(-1.4, 1.4)))[0].contains("may be clipped"));
        assert!(remarks(&record(200, 0.05, 0.5))[0].contains("20 samples/s: nothing above 10.0 Hz"));
    }
}
