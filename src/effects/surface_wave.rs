//! A second, slower arrival of the same motion: a surface wave made at the edge of the basin.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale};
use crate::error::Result;
use crate::registry;
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

pub(super) const ENTRY: Entry = Entry {
    name: "surface_wave",
    about: "a later arrival of the same motion that decays with depth",
    phrases: &["a later arrival of {amplitude} times the motion of the base, {delay_s} behind it"],
    build: |table| Ok(Box::new(registry::params::<SurfaceWave>(table)?.checked()?)),
    schema: || schemars::schema_for!(SurfaceWave),
    catalogue: Catalogue {
        number: 21,
        class: Class::Boundary,
        parameters: PARAMETERS,
        instances,
        confused_with: &["structure_interaction"],
        key: "late in time, weaker with depth the higher its frequency",
    },
};

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "amplitude",
        unit: "",
        zero: Some(0.0),
        low: -1.5,
        high: 1.5,
        scale: Scale::Linear,
        prior_sd: 0.5,
        draw: [0.3, 0.8],
        is_signed: true,
    },
    Parameter {
        name: "delay_s",
        unit: "s",
        zero: None,
        low: 0.5,
        high: 8.0,
        scale: Scale::Linear,
        prior_sd: 2.0,
        draw: [1.0, 5.0],
        is_signed: false,
    },
    Parameter {
        name: "velocity_m_s",
        unit: "m/s",
        zero: None,
        low: 30.0,
        high: 1000.0,
        scale: Scale::Log,
        prior_sd: 0.7,
        draw: [80.0, 300.0],
        is_signed: false,
    },
];

/// Distance of the delays from which a fit starts, s.
const APART_S: f64 = 0.5;

fn instances(_: &super::Array) -> Vec<Instance> {
    let at = |i: i32| {
        let delay = Free { size: APART_S, ..Free::new(&PARAMETERS[1], APART_S * f64::from(i)) };
        let free = vec![Free::new(&PARAMETERS[0], 0.0), delay, Free::new(&PARAMETERS[2], 150.0)];
        Instance::new(ENTRY.name, [], free)
    };
    (2..=11).map(at).collect()
}

/// Adds a delayed arrival of the base motion, weaker with depth.
///
/// ```text
/// y(z) = x(z) + F⁻¹[ A exp(−2π f z/c) exp(−i 2π f t_d) U(f) ]           (1)
/// ```
///
/// | symbol | field          | unit | range   |
/// |--------|----------------|------|---------|
/// | A      | `amplitude`    | –    | −10…10  |
/// | t_d    | `delay_s`      | s    | 0…60    |
/// | c      | `velocity_m_s` | m/s  | 10…5000 |
/// | U      | spectrum of the true base motion | m/s | |
///
/// Limits: no dispersion, no vertical motion; the input sensor's record is taken as it is. c stands for the decay with
/// depth of a wave of that velocity.
/// Check:  `the_arrival_is_late_and_weaker_with_depth_and_frequency`.
/// Source: exponential decay of a Rayleigh wave's motion, for example Aki & Richards (2002), chapter 7.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct SurfaceWave {
    /// Amplitude at the surface over that of the base motion.
    amplitude: f64,
    /// Delay behind the base motion, s.
    delay_s: f64,
    /// Velocity that sets the decay with depth, m/s.
    velocity_m_s: f64,
}

impl SurfaceWave {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("amplitude", self.amplitude, -10.0, 10.0, ""),
            ("delay_s", self.delay_s, 0.0, 60.0, "s"),
            ("velocity_m_s", self.velocity_m_s, 10.0, 5000.0, "m/s"),
        ])?;
        Ok(self)
    }
}

impl Effect for SurfaceWave {
    fn is_arrival(&self) -> bool {
        true
    }

    fn arrival(&self, depth_m: f64, frequency_hz: f64) -> Option<Complex<f64>> {
        let omega = TAU * frequency_hz;
        let size = self.amplitude * (-omega * depth_m / self.velocity_m_s).exp();
        (self.amplitude != 0.0).then(|| Complex::from_polar(1.0, -omega * self.delay_s) * size) // (1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arrival_is_late_and_weaker_with_depth_and_frequency() {
        let wave = SurfaceWave { amplitude: 0.5, delay_s: 2.0, velocity_m_s: 100.0 };
        let at = |z, f| wave.arrival(z, f).unwrap();
        assert!((at(0.0, 3.0).norm() - 0.5).abs() < 1e-12);
        assert!((at(10.0, 1.0).norm() - 0.5 * (-TAU * 0.1).exp()).abs() < 1e-12);
        assert!(at(10.0, 2.0).norm() < at(10.0, 1.0).norm() && at(20.0, 1.0).norm() < at(10.0, 1.0).norm());
        assert!((at(0.0, 0.125).arg() + 0.5 * std::f64::consts::PI).abs() < 1e-12);
    }
}
