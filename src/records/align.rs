//! Channels of one event brought to one azimuth, one step and one time axis.

use super::channel::{Channel, Orientation};
use crate::error::{Error, Result};
use crate::numerics::resample::{resampled_len, sample_band_limited};
use jiff::SignedDuration;
use jiff::civil::DateTime;

/// Azimuths that differ by less are the same, degrees.
const AZIMUTH_DEG: f64 = 0.5;
/// Largest distance from a right angle of two channels that are turned together, degrees.
const SQUARE_DEG: f64 = 2.0;
/// Share of a step by which samples of two channels may lie apart and still count as taken together.
const TOGETHER: f64 = 0.01;

/// Histories on one time axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Aligned {
    /// Time of the first sample, where the files say it, UTC.
    pub start: Option<DateTime>,
    /// Time step, s.
    pub dt_s: f64,
    /// Accelerations, m/s², one history a channel in the order given.
    pub acceleration_m_s2: Vec<Vec<f64>>,
    /// What was done.
    pub remarks: Vec<String>,
}

/// Brings `channels` to the coarsest of their steps and to the time that all of them cover.
///
/// Channels of which none has a time are taken to begin together.
///
/// # Errors
/// When some have a time and others none, or there is no time that all cover.
pub fn aligned(channels: &[Channel]) -> Result<Aligned> {
    let dt_s = channels.iter().map(|c| c.dt_s).fold(0.0, f64::max);
    let timed: Vec<DateTime> = channels.iter().filter_map(|c| c.start).collect();
    let first = timed.iter().min().copied();
    if let Some(untimed) = channels.iter().find(|c| c.start.is_none())
        && first.is_some()
    {
        let what = format!("`{}` does not say when it begins, other sensors do", untimed.path());
        return Err(Error::new(what).hint("take all sensors of an event from files with a time, or from files without"));
    }
    let after_s = |c: &Channel| match (c.start, first) {
        (Some(start), Some(first)) => start.duration_since(first).as_secs_f64(),
        _ => 0.0,
    };
    let end_s = |c: &Channel| after_s(c) + (c.acceleration_m_s2.len() as f64 - 1.0) * c.dt_s;
    let start_s = channels.iter().map(after_s).fold(0.0, f64::max);
    let until_s = channels.iter().map(end_s).fold(f64::INFINITY, f64::min);
    let n = if until_s > start_s { resampled_len(2, until_s - start_s, dt_s) } else { 0 };
    if n < 3 {
        let times = channels.iter().map(|c| format!("`{}` {}", c.path(), span(c))).collect::<Vec<_>>().join(", ");
        return Err(Error::new(format!("there is no time that all sensors cover: {times}"))
            .hint("are these files of one event, and their clocks in one time zone?"));
    }
    let mut remarks = Vec::new();
    let early_s = channels.iter().map(after_s).fold(f64::INFINITY, f64::min);
    if start_s - early_s > TOGETHER * dt_s {
        remarks.push(format!("sensors begin {:.2} s apart: cut to what all cover", start_s - early_s));
    }
    let finest_s = channels.iter().map(|c| c.dt_s).fold(f64::INFINITY, f64::min);
    if finest_s < dt_s * (1.0 - 1e-9) {
        remarks.push(format!("{:.0} samples/s brought to the {:.0} of other sensors", 1.0 / finest_s, 1.0 / dt_s));
    }
    let history = |c: &Channel| {
        let from_s = start_s - after_s(c);
        let first = (from_s / c.dt_s).round();
        if c.dt_s == dt_s && (from_s / c.dt_s - first).abs() < TOGETHER {
            let first = first as usize;
            return c.acceleration_m_s2[first..(first + n).min(c.acceleration_m_s2.len())].to_vec();
        }
        sample_band_limited(&c.acceleration_m_s2, c.dt_s, from_s, dt_s, n, dt_s)
    };
    let mut acceleration_m_s2: Vec<Vec<f64>> = channels.iter().map(history).collect();
    let shortest = acceleration_m_s2.iter().map(Vec::len).min().unwrap_or(0);
    acceleration_m_s2.iter_mut().for_each(|history| history.truncate(shortest));
    let start = first.and_then(|first| first.checked_add(SignedDuration::try_from_secs_f64(start_s).ok()?).ok());
    Ok(Aligned { start, dt_s, acceleration_m_s2, remarks })
}

fn span(c: &Channel) -> String {
    let length_s = c.acceleration_m_s2.len() as f64 * c.dt_s;
    c.start.map_or_else(|| format!("{length_s:.1} s"), |start| format!("{length_s:.1} s from {start}"))
}

/// Azimuth of a component by its name, degrees; none where the name does not say it.
pub fn azimuth_deg(component: &str) -> Option<f64> {
    match component.to_uppercase().as_str() {
        "N" | "NS" | "HNN" | "BNN" | "ENN" => Some(0.0),
        "E" | "EW" | "HNE" | "BNE" | "ENE" => Some(90.0),
        _ => None,
    }
}

/// A channel as it would have recorded at `target_deg`; `other` is the second horizontal channel of the same sensor.
///
/// # Errors
/// When it points elsewhere and there is no other to turn it with, or the two are not at a right angle.
pub fn turned(channel: &Channel, other: Option<&Channel>, target_deg: f64) -> Result<Channel> {
    let azimuth_deg = match channel.orientation {
        Orientation::AzimuthDeg(azimuth_deg) => azimuth_deg,
        Orientation::Unknown => return Ok(channel.clone()),
        Orientation::Vertical => {
            return Err(Error::new(format!("`{}` is vertical", channel.path())).hint("take a horizontal channel"));
        }
    };
    if apart_deg(azimuth_deg, target_deg).abs() < AZIMUTH_DEG {
        return Ok(channel.clone());
    }
    let points = format!("`{}` points to {azimuth_deg}°, the component is at {target_deg}°", channel.path());
    let other = other.and_then(|other| match other.orientation {
        Orientation::AzimuthDeg(deg) => Some((other, deg)),
        _ => None,
    });
    let mut found = channel.clone();
    if apart_deg(azimuth_deg, target_deg + 180.0).abs() < AZIMUTH_DEG {
        found.acceleration_m_s2.iter_mut().for_each(|v| *v = -*v);
    } else {
        let hint = "name both horizontal channels of the sensor, so that it can be turned";
        let (other, other_deg) = other.ok_or_else(|| Error::new(points.clone()).hint(hint))?;
        let between_deg = apart_deg(other_deg, azimuth_deg);
        if (between_deg.abs() - 90.0).abs() > SQUARE_DEG {
            let what = format!("{points}, and the other horizontal channel, `{}`, to {other_deg}°", other.path());
            return Err(Error::new(what).hint("two channels at a right angle are needed to turn a sensor"));
        }
        let both = aligned(&[channel.clone(), other.clone()])?;
        let (sine, cosine) = apart_deg(target_deg, azimuth_deg).to_radians().sin_cos();
        let sine = sine * between_deg.signum();
        let [x, y] = [&both.acceleration_m_s2[0], &both.acceleration_m_s2[1]];
        found.acceleration_m_s2 = x.iter().zip(y).map(|(x, y)| cosine * x + sine * y).collect();
        (found.start, found.dt_s) = (both.start, both.dt_s);
    }
    found.orientation = Orientation::azimuth(target_deg);
    found.remarks.push(format!("`{}` turned from {azimuth_deg}° to {target_deg}°", channel.path()));
    Ok(found)
}

/// From `b` to `a` the shorter way, degrees.
fn apart_deg(a: f64, b: f64) -> f64 {
    (a - b + 180.0).rem_euclid(360.0) - 180.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Ground motion at time `t` towards an azimuth: 0.4 m/s² at 1.3 Hz to the north, 0.7 m/s² at 0.9 Hz to the east.
    fn ground(t: f64, azimuth_deg: f64) -> f64 {
        let (east, north) = azimuth_deg.to_radians().sin_cos();
        north * 0.4 * (TAU * 1.3 * t).sin() + east * 0.7 * (TAU * 0.9 * t).cos()
    }

    fn channel(start_s: f64, dt_s: f64, n: usize, azimuth_deg: f64) -> Channel {
        let first: DateTime = "2020-01-01T00:00:00".parse().unwrap();
        let at = first.checked_add(SignedDuration::from_secs_f64(start_s)).unwrap();
        let values = (0..n).map(|i| ground(start_s + i as f64 * dt_s, azimuth_deg)).collect();
        Channel { orientation: Orientation::azimuth(azimuth_deg), start: Some(at), ..Channel::alone("x", dt_s, values) }
    }

    #[test]
    fn channels_are_brought_to_one_axis() {
        let channels =
            [channel(0.0, 0.01, 3000, 0.0), channel(1.2345, 0.005, 5000, 0.0), channel(0.5, 0.01, 4000, 0.0)];
        let found = aligned(&channels).unwrap();
        assert_eq!(found.dt_s, 0.01);
        assert_eq!(found.start.unwrap().to_string(), "2020-01-01T00:00:01.2345");
        assert!(
            found.remarks[0].contains("1.23 s apart") && found.remarks[1].contains("200 samples/s"),
            "{:?}",
            found.remarks
        );
        let n = found.acceleration_m_s2[0].len();
        assert_eq!(n, 2500, "from 1.2345 s to the end of the second channel");
        for history in &found.acceleration_m_s2 {
            for (i, v) in history.iter().enumerate().take(n - 100).skip(100) {
                assert!((v - ground(1.2345 + i as f64 * 0.01, 0.0)).abs() < 1e-5, "{i}");
            }
        }
        assert!(aligned(&[channel(0.0, 0.01, 100, 0.0), channel(60.0, 0.01, 100, 0.0)]).is_err());
        let untimed = Channel { start: None, ..channel(0.0, 0.01, 100, 0.0) };
        assert!(aligned(&[untimed.clone(), channel(0.0, 0.01, 100, 0.0)]).is_err());
        assert_eq!(aligned(&[untimed.clone(), untimed]).unwrap().start, None);
    }

    #[test]
    fn a_sensor_is_turned_by_both_of_its_channels() {
        for (x_deg, y_deg) in [(35.0, 125.0), (35.0, 305.0), (350.0, 80.0)] {
            let [x, y] = [x_deg, y_deg].map(|deg| channel(0.0, 0.01, 500, deg));
            for (first, second, target_deg) in [(&x, &y, 0.0), (&y, &x, 90.0), (&x, &y, 200.0)] {
                let found = turned(first, Some(second), target_deg).unwrap();
                let exact = channel(0.0, 0.01, 500, target_deg);
                for (a, b) in found.acceleration_m_s2.iter().zip(&exact.acceleration_m_s2) {
                    assert!((a - b).abs() < 1e-12, "{x_deg} {y_deg} {target_deg}");
                }
                assert!(found.remarks[0].contains("turned from"));
            }
        }
        let [west, north] = [270.0, 0.0].map(|deg| channel(0.0, 0.01, 500, deg));
        assert_eq!(turned(&north, None, 0.0).unwrap(), north);
        let east = turned(&west, None, 90.0).unwrap();
        assert!((east.acceleration_m_s2[7] - ground(0.07, 90.0)).abs() < 1e-12);
        assert!(turned(&channel(0.0, 0.01, 500, 20.0), None, 0.0).is_err());
        assert!(turned(&channel(0.0, 0.01, 500, 20.0), Some(&north), 0.0).is_err());
        assert!(turned(&Channel { orientation: Orientation::Vertical, ..west }, None, 0.0).is_err());
    }
}
