//! Sensor noise for twin records.

use super::record::Record;
use crate::metrics::rms;
use crate::numerics::random;
use crate::ranges::{Range, Ranged, range};
use rand_distr::{Distribution, StandardNormal};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// White sensor noise; both parts are independent and add up in power.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Noise {
    /// Standard deviation as a share of the channel's RMS.
    pub rms_share: f64,
    /// Standard deviation, m/s².
    pub floor_m_s2: f64,
}

impl Default for Noise {
    fn default() -> Self {
        Self { rms_share: 0.02, floor_m_s2: 0.0 }
    }
}

impl Noise {
    /// Standard deviation for a channel with the given RMS, m/s².
    pub fn standard_deviation_m_s2(&self, channel_rms_m_s2: f64) -> f64 {
        (self.rms_share * channel_rms_m_s2).hypot(self.floor_m_s2)
    }
}

impl Ranged for Noise {
    const RANGES: &'static [Range<Self>] = &[range!(rms_share, "", 0.0, 1.0), range!(floor_m_s2, "m/s²", 0.0, 1.0)];
}

/// Adds noise to every sensor, input included; the draw depends on seed, event, component and sensor only.
pub fn add_noise(record: &mut Record, noise: &Noise, seed: u64) {
    let label = format!("noise {} {}", record.event, record.component);
    for sensor in std::iter::once(&mut record.input).chain(&mut record.outputs) {
        let mut rng = random::stream(seed, &format!("{label} {}", sensor.name));
        let deviation_m_s2 = noise.standard_deviation_m_s2(rms(&sensor.acceleration_m_s2));
        for value in &mut sensor.acceleration_m_s2 {
            let draw: f64 = StandardNormal.sample(&mut rng);
            *value += deviation_m_s2 * draw;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::records::record::tests::record;

    #[test]
    fn noise_has_the_declared_level_and_depends_on_the_seed_only() {
        let clean = record(20_000, 0.01, 0.3);
        let noisy = |seed| {
            let mut r = clean.clone();
            add_noise(&mut r, &Noise { rms_share: 0.05, floor_m_s2: 0.004 }, seed);
            r
        };
        let (a, b) = (noisy(1), noisy(1));
        assert_eq!(a, b);
        assert_ne!(a, noisy(2));
        for (with, without) in a.sensors().zip(clean.sensors()) {
            let added: Vec<f64> =
                with.acceleration_m_s2.iter().zip(&without.acceleration_m_s2).map(|(x, y)| x - y).collect();
            let expected = (0.05 * rms(&without.acceleration_m_s2)).hypot(0.004);
            assert!((rms(&added) / expected - 1.0).abs() < 0.03);
        }
    }

    #[test]
    fn levels_out_of_range_are_refused() {
        assert!(Noise::default().beyond().is_empty());
        assert_eq!(Noise { rms_share: -0.1, floor_m_s2: f64::NAN }.beyond().len(), 2);
    }
}
