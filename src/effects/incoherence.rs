//! A field that strays from its base on the way to a sensor: what no motion at one point tells of another.

use super::{Array, Catalogue, Channel, Class, Effect, Entry, Free, Instance, Parameter, Scale};
use crate::error::Result;
use crate::numerics::smooth::running_mean;
use crate::numerics::{random, spectrum};
use crate::registry;
use rand_distr::{Distribution, StandardNormal};
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "incoherence",
    about: "above a frequency, part of the motion of a sensor does not follow the base: its power stays, its phases are any",
    phrases: &["a share of {share} of the motion of {place} does not follow the base above {corner_hz}"],
    build: |table| Ok(Box::new(registry::params::<Incoherence>(table)?.checked()?)),
    schema: || schemars::schema_for!(Incoherence),
    catalogue: Catalogue {
        number: 31,
        class: Class::Field,
        parameters: PARAMETERS,
        instances,
        confused_with: &["small_strain_damping", "instrument_low_pass"],
        key: "the coherence with the base falls with frequency, the power does not",
    },
};

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "share",
        unit: "",
        zero: Some(0.0),
        low: 0.0,
        high: 1.0,
        scale: Scale::Linear,
        prior_sd: 0.5,
        draw: [0.3, 0.6],
        is_signed: false,
    },
    Parameter {
        name: "corner_hz",
        unit: "Hz",
        zero: None,
        low: 0.1,
        high: 50.0,
        scale: Scale::Log,
        prior_sd: 0.7,
        draw: [2.0, 6.0],
        is_signed: false,
    },
];

/// Where a corner is looked for first, Hz.
const START_HZ: f64 = 4.0;
/// How far around a sample and around a frequency powers are taken.
const AROUND_S: f64 = 0.5;
const AROUND_HZ: f64 = 0.25;

/// One for each output sensor.
fn instances(array: &Array) -> Vec<Instance> {
    let free = [Free::new(&PARAMETERS[0], 0.0), Free::new(&PARAMETERS[1], START_HZ)];
    array.one_each_output(ENTRY.name, &free)
}

/// Replaces part of the motion of a sensor by one of the same power that has nothing to do with it.
///
/// ```text
/// Y(f) = c(f) X(f) + √(1 − c²) N(f) √(⟨|X|²⟩/⟨|N|²⟩),   c(f) = 1 − s (1 − exp(−(f/f_c)²))        (1)
/// ```
///
/// N is normal noise with the envelope of x, drawn by the names of event, component and sensor; ⟨ ⟩ are means around a frequency.
///
/// | symbol | field       | unit | range  |
/// |--------|-------------|------|--------|
/// | s      | `share`     | –    | 0…1    |
/// | f_c    | `corner_hz` | Hz   | 0.1…50 |
///
/// No candidate of a diagnosis: a coherence below one is part of what is expected of the residuals of every model, and is reported
/// beside the verdict as what remains. Who declares it changes no prediction.
///
/// Limits: sensors stray independently; the same coherence in all events.
/// Check:  `what_strays_keeps_its_power_and_has_the_coherence_that_is_asked_for`.
/// Source: definition; Luco and Wong (1986), doi 10.1002/eqe.4290140606, for a coherence that falls as exp(−(f/f_c)²).
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Incoherence {
    /// Name of the sensor.
    sensor: String,
    /// What the coherence has lost far above the corner.
    share: f64,
    /// Corner frequency, Hz.
    corner_hz: f64,
}

impl Incoherence {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("share", self.share, 0.0, 1.0, ""), ("corner_hz", self.corner_hz, 0.1, 50.0, "Hz")])?;
        Ok(self)
    }

    fn coherence(&self, frequency_hz: f64) -> f64 {
        1.0 - self.share * (1.0 - (-(frequency_hz / self.corner_hz).powi(2)).exp()) // (1)
    }
}

impl Effect for Incoherence {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn interference(&self, channel: &Channel<'_>) -> Option<Vec<f64>> {
        if self.share == 0.0 || channel.sensor != self.sensor {
            return None;
        }
        let (x, dt_s) = (channel.acceleration_m_s2, channel.dt_s);
        let half = ((AROUND_S / dt_s) as usize).min(x.len());
        let envelope = running_mean(&x.iter().map(|x| x * x).collect::<Vec<_>>(), half);
        let label = format!("incoherence {} {} {}", channel.event, channel.component, channel.sensor);
        let mut stream = random::stream(0, &label);
        let normal = |power: &f64| -> f64 {
            let sample: f64 = StandardNormal.sample(&mut stream);
            power.sqrt() * sample
        };
        let noise: Vec<f64> = envelope.iter().map(normal).collect();
        let (mut step_hz, mut powers) = (f64::INFINITY, [Vec::new(), Vec::new()]);
        let zero = Complex::new(0.0, 0.0);
        spectrum::respond([x, &noise], dt_s, |f, both| {
            // The constant is asked about twice.
            if f > 0.0 {
                step_hz = step_hz.min(f);
                powers.iter_mut().zip(both).for_each(|(p, value)| p.push(value.norm_sqr()));
            }
            [zero; 2]
        });
        let [own, drawn] = powers.map(|p| running_mean(&p, (AROUND_HZ / step_hz).ceil() as usize));
        let [added, _] = spectrum::respond([x, &noise], dt_s, |f, [x, noise]| {
            let k = ((f / step_hz).round() as usize).saturating_sub(1).min(own.len() - 1);
            let c = self.coherence(f);
            let scale = (own[k] / drawn[k].max(f64::MIN_POSITIVE)).sqrt();
            [x * (c - 1.0) + noise * ((1.0 - c * c).max(0.0).sqrt() * scale), zero]
        });
        Some(added)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_strays_keeps_its_power_and_has_the_coherence_that_is_asked_for() {
        let effect = Incoherence { sensor: "top".into(), share: 0.6, corner_hz: 3.0 };
        let mut stream = random::stream(3, "incoherence");
        let mut sample = || -> f64 { StandardNormal.sample(&mut stream) };
        let (n, dt_s) = (4096, 0.01);
        let mut sums = vec![[0.0; 3]; 3];
        let bands_hz = [[0.3, 1.0], [2.0, 4.0], [8.0, 16.0]];
        for event in 0..20 {
            let x: Vec<f64> = (0..n).map(|i| sample() * (-((i as f64 - 1500.0) / 600.0).powi(2)).exp()).collect();
            let name = format!("E{event}");
            let channel = Channel { sensor: "top", component: "EW", event: &name, dt_s, acceleration_m_s2: &x };
            let added = effect.interference(&channel).unwrap();
            let y: Vec<f64> = x.iter().zip(added).map(|(x, a)| x + a).collect();
            spectrum::respond([&x, &y], dt_s, |f, [x, y]| {
                for (band, sum) in bands_hz.iter().zip(&mut sums).filter(|([low, high], _)| (*low..*high).contains(&f))
                {
                    assert!(band[0] > 0.0);
                    *sum = [sum[0] + x.norm_sqr(), sum[1] + y.norm_sqr(), sum[2] + (y * x.conj()).re];
                }
                [x, y]
            });
        }
        for ([low, high], [own, recorded, cross]) in bands_hz.iter().zip(&sums) {
            let expected = effect.coherence((low * high).sqrt());
            let (power, coherence) = (recorded / own, cross / (own * recorded).sqrt());
            assert!((power - 1.0).abs() < 0.15, "{low}-{high} Hz: power {power}");
            assert!((coherence - expected).abs() < 0.08, "{low}-{high} Hz: {coherence} {expected}");
        }
        let nothing = Incoherence { share: 0.0, ..effect };
        let channel = Channel { sensor: "top", component: "EW", event: "E", dt_s, acceleration_m_s2: &[1.0, 2.0] };
        assert!(nothing.interference(&channel).is_none());
    }
}
