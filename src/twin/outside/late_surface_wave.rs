//! A surface wave from a source of its own: late, dispersive, not coherent with the base motion.

use super::{Outside, own_motion, ranges};
use crate::effects::{Channels, Recording};
use crate::error::Result;
use crate::metrics::rms;
use crate::numerics::spectrum;
use crate::registry::{self, Entry};
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

pub(super) const ENTRY: Entry<dyn Outside> = Entry {
    name: "late_surface_wave",
    about: "a late, dispersive surface wave with a source of its own",
    build: |table| Ok(Box::new(registry::params::<LateSurfaceWave>(table)?.checked()?)),
    schema: || schemars::schema_for!(LateSurfaceWave),
};

/// Adds a narrow-band wave train to the output sensors.
///
/// ```text
/// y(z, t) = x(z, t) + F⁻¹[ W(f) B(f) exp(−2π f z/c − i 2π f (t_d + D (f − f_b))) ]
/// B(f)    = exp(−½ ((f − f_b)/(0.35 f_b))²)                             (1)
/// ```
///
/// W is a motion of its own in each event and component; the train's RMS at the surface is `amplitude` times that of the
/// motion there. Lower frequencies come later (D < 0 s/Hz).
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LateSurfaceWave {
    /// RMS of the train over that of the surface motion.
    amplitude: f64,
    /// Delay t_d behind the main motion, s.
    delay_s: f64,
    /// Middle f_b of its band, Hz.
    #[serde(default = "default_frequency")]
    frequency_hz: f64,
    /// Velocity c that sets the decay with depth, m/s.
    #[serde(default = "default_velocity")]
    velocity_m_s: f64,
}

fn default_frequency() -> f64 {
    1.5
}

fn default_velocity() -> f64 {
    120.0
}

/// D of (1), s/Hz.
const DISPERSION_S_HZ: f64 = -0.4;

impl LateSurfaceWave {
    fn checked(self) -> Result<Self> {
        ranges(&[
            ("amplitude", self.amplitude, 0.0, 10.0, ""),
            ("delay_s", self.delay_s, 0.0, 60.0, " s"),
            ("frequency_hz", self.frequency_hz, 0.2, 20.0, " Hz"),
            ("velocity_m_s", self.velocity_m_s, 10.0, 5000.0, " m/s"),
        ])?;
        Ok(self)
    }
}

impl Outside for LateSurfaceWave {
    fn add(&self, recording: &Recording<'_>, _: f64, seed: u64, motions: &mut [Channels]) -> Result<()> {
        let train = |own: &[f64], depth_m: f64| {
            let shaped = |f: f64| {
                let band = (-0.5 * ((f - self.frequency_hz) / (0.35 * self.frequency_hz)).powi(2)).exp();
                let lag_s = self.delay_s + DISPERSION_S_HZ * (f - self.frequency_hz);
                Complex::from_polar(band * (-TAU * f * depth_m / self.velocity_m_s).exp(), -TAU * f * lag_s) // (1)
            };
            let [wave] = spectrum::respond([own], recording.dt_s, |f, [w]| [w * shaped(f)]);
            wave
        };
        for (c, component) in recording.components.iter().enumerate() {
            let n = motions[0][c].len();
            let own = own_motion(recording, seed, &format!("surface wave {component}"), n, [0.3, 10.0]);
            let largest = motions[1..].iter().map(|s| rms(&s[c])).fold(0.0, f64::max);
            let scale = self.amplitude * largest / rms(&train(&own, 0.0)).max(f64::MIN_POSITIVE);
            for (channels, depth_m) in motions.iter_mut().zip(recording.depths_m).skip(1) {
                channels[c].iter_mut().zip(train(&own, *depth_m)).for_each(|(x, w)| *x += scale * w);
            }
        }
        Ok(())
    }
}
