//! A line of constant frequency on one sensor: a machine nearby, or the mains.

use super::{Array, Catalogue, Channel, Class, Effect, Entry, Free, Instance, Parameter, Scale};
use crate::error::Result;
use crate::numerics::random;
use crate::numerics::smooth::running_mean;
use crate::registry;
use rand::RngExt;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

pub(super) const ENTRY: Entry = Entry {
    name: "machine_hum",
    about: "one sensor records a line of constant frequency, from a machine or the mains",
    phrases: &["{place} records a line of {amplitude_m_s2} at {frequency_hz}"],
    build: |table| Ok(Box::new(registry::params::<MachineHum>(table)?.checked()?)),
    schema: || schemars::schema_for!(MachineHum),
    catalogue: Catalogue {
        number: 20,
        class: Class::Sensor,
        parameters: PARAMETERS,
        instances,
        confused_with: &[],
        key: "a line of constant envelope, incoherent with the input and there before the event",
    },
};

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "amplitude_m_s2",
        unit: "m/s²",
        zero: Some(0.0),
        low: 0.0,
        high: 0.5,
        scale: Scale::Linear,
        prior_sd: 0.05,
        draw: [0.02, 0.06],
        is_signed: false,
    },
    Parameter {
        name: "frequency_hz",
        unit: "Hz",
        zero: None,
        low: 0.5,
        high: 20.0,
        scale: Scale::Linear,
        prior_sd: 5.0,
        draw: [2.0, 9.0],
        is_signed: false,
    },
];

/// One instance a sensor, the input sensor too.
fn instances(array: &Array) -> Vec<Instance> {
    array.one_each(ENTRY.name, &[Free::new(&PARAMETERS[0], 0.0), Free::new(&PARAMETERS[1], 5.0)])
}

/// Adds a sine whose phase is another in each event and component.
///
/// ```text
/// y(t) = x(t) + A sin(2π f t + φ)                                       (1)
/// φ    : Σ w (y − a cos 2π f t − b sin 2π f t)² least, tan φ = a/b, 1/w the mean square of y within 0.5 s or a period  (2)
/// ```
///
/// | symbol | field            | unit | range |
/// |--------|------------------|------|-------|
/// | A      | `amplitude_m_s2` | m/s² | 0…10  |
/// | f      | `frequency_hz`   | Hz   | 0…200 |
///
/// φ of a twin comes from the names of event, component and sensor; otherwise it is that of (2), which listens where the record
/// is quiet: the shaking has a motion of its own at f.
///
/// Limits: records of many periods, some of them quiet.
/// Check:  `a_hum_is_taken_out_of_the_record_that_carries_it`, `shaking_at_the_frequency_of_the_hum_does_not_hide_it`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct MachineHum {
    /// Name of the sensor.
    sensor: String,
    /// Frequency, Hz.
    frequency_hz: f64,
    /// Amplitude, m/s².
    amplitude_m_s2: f64,
}

impl MachineHum {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("frequency_hz", self.frequency_hz, 0.0, 200.0, "Hz"),
            ("amplitude_m_s2", self.amplitude_m_s2, 0.0, 10.0, "m/s²"),
        ])?;
        Ok(self)
    }

    fn acts_on(&self, channel: &Channel<'_>) -> bool {
        self.amplitude_m_s2 > 0.0 && channel.sensor == self.sensor
    }

    /// (1) without x.
    fn sine(&self, channel: &Channel<'_>, phase: f64) -> Vec<f64> {
        let angle = |i: usize| TAU * self.frequency_hz * i as f64 * channel.dt_s + phase;
        (0..channel.acceleration_m_s2.len()).map(|i| self.amplitude_m_s2 * angle(i).sin()).collect()
    }
}

impl Effect for MachineHum {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn interference(&self, channel: &Channel<'_>) -> Option<Vec<f64>> {
        let label = format!("hum {} {} {}", channel.event, channel.component, channel.sensor);
        let phase = TAU * random::stream(0, &label).random::<f64>();
        self.acts_on(channel).then(|| self.sine(channel, phase))
    }

    fn estimated_interference(&self, channel: &Channel<'_>) -> Option<Vec<f64>> {
        let phase = || line_phase(channel.acceleration_m_s2, self.frequency_hz, channel.dt_s);
        self.acts_on(channel).then(|| self.sine(channel, phase()))
    }

    /// The phase.
    fn hidden(&self) -> usize {
        1
    }
}

/// How far around a sample its power is taken, s.
const AROUND_S: f64 = 0.5;

/// The phase of (2).
fn line_phase(y: &[f64], frequency_hz: f64, dt_s: f64) -> f64 {
    let half = ((AROUND_S.max(1.0 / frequency_hz) / dt_s) as usize).min(y.len());
    let power = running_mean(&y.iter().map(|y| y * y).collect::<Vec<_>>(), half);
    let (mut cc, mut cs, mut ss, mut yc, mut ys) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (i, (y, power)) in y.iter().zip(power).enumerate() {
        let weight = 1.0 / power.max(f64::MIN_POSITIVE);
        let (sin, cos) = (TAU * frequency_hz * i as f64 * dt_s).sin_cos();
        cc += weight * cos * cos;
        cs += weight * cos * sin;
        ss += weight * sin * sin;
        yc += weight * y * cos;
        ys += weight * y * sin;
    }
    f64::atan2(yc * ss - ys * cs, ys * cc - yc * cs) // (2), both times the determinant
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hum_is_taken_out_of_the_record_that_carries_it() {
        let effect = MachineHum { sensor: "top".into(), frequency_hz: 3.7, amplitude_m_s2: 0.04 };
        let motion: Vec<f64> =
            (0..3000).map(|i| 0.3 * (-((i as f64 - 900.0) / 200.0).powi(2)).exp() * (0.14 * i as f64).sin()).collect();
        let channel = |x| Channel { sensor: "top", component: "EW", event: "E1", dt_s: 0.01, acceleration_m_s2: x };
        let hum = effect.interference(&channel(&motion)).unwrap();
        let record: Vec<f64> = motion.iter().zip(&hum).map(|(x, h)| x + h).collect();
        let found = effect.estimated_interference(&channel(&record)).unwrap();
        let worst = found.iter().zip(&hum).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 0.002, "{worst}");
        let other = Channel { event: "E2", ..channel(&motion) };
        assert_ne!(effect.interference(&other).unwrap()[0], hum[0]);
        assert!(effect.interference(&Channel { sensor: "base", ..other }).is_none());
    }

    #[test]
    fn shaking_at_the_frequency_of_the_hum_does_not_hide_it() {
        let effect = MachineHum { sensor: "top".into(), frequency_hz: 3.7, amplitude_m_s2: 0.04 };
        let envelope = |i: usize| (-((i as f64 - 900.0) / 200.0).powi(2)).exp();
        let motion: Vec<f64> = (0..2000).map(|i| envelope(i) * (TAU * 3.7 * 0.01 * i as f64).sin()).collect();
        let channel = |x| Channel { sensor: "top", component: "EW", event: "E1", dt_s: 0.01, acceleration_m_s2: x };
        let hum = effect.interference(&channel(&motion)).unwrap();
        let record: Vec<f64> = motion.iter().zip(&hum).map(|(x, h)| x + h).collect();
        let found = effect.estimated_interference(&channel(&record)).unwrap();
        let left: f64 = found.iter().zip(&hum).map(|(a, b)| (a - b).powi(2)).sum();
        let there: f64 = hum.iter().map(|h| h * h).sum();
        assert!((left / there).sqrt() < 0.2, "{}", (left / there).sqrt());
    }
}
