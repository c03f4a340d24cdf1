//! Soil that varies sideways: a smooth random change of every transfer function, another one in each event.

use super::{Outside, ranges};
use crate::effects::{Channels, Recording};
use crate::error::Result;
use crate::numerics::{random, spectrum};
use crate::registry::{self, Entry};
use rand_distr::{Distribution, StandardNormal};
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry<dyn Outside> = Entry {
    name: "lateral_scattering",
    about: "smooth random changes of every sensor's transfer function, partly the same in all events",
    build: |table| Ok(Box::new(registry::params::<LateralScattering>(table)?.checked()?)),
    schema: || schemars::schema_for!(LateralScattering),
};

/// Multiplies the spectrum of each output sensor by a smooth random complex function.
///
/// ```text
/// Y(f) = X(f) exp(r(f) (a(f) + i b(f))),   a, b linear between random knots 0.9 Hz apart      (1)
/// ```
///
/// r = (f / f₁)² below the fundamental frequency f₁ and 1 from there on: soil that is shaken slowly strays from its base by what its
/// acceleration strains it.
/// A share `repeatable` of the variance of a and b is common to all events and both components.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LateralScattering {
    /// Standard deviation of a at the knots.
    ln_amplitude: f64,
    /// Standard deviation of b at the knots, rad.
    phase_rad: f64,
    /// Share of the variance that is the same in all events and components.
    #[serde(default = "default_repeatable")]
    repeatable: f64,
}

fn default_repeatable() -> f64 {
    0.6
}

/// Distance of the knots of (1), Hz.
const KNOT_HZ: f64 = 0.9;
/// Number of knots; beyond the last one (1) stays constant.
const KNOTS: usize = 30;

impl LateralScattering {
    fn checked(self) -> Result<Self> {
        ranges(&[
            ("ln_amplitude", self.ln_amplitude, 0.0, 2.0, ""),
            ("phase_rad", self.phase_rad, 0.0, 3.0, " rad"),
            ("repeatable", self.repeatable, 0.0, 1.0, ""),
        ])?;
        Ok(self)
    }

    /// Knots of a + ib from 0 Hz on for one sensor in one event and component.
    fn knots(&self, seed: u64, sensor: &str, event: &str, component: &str) -> Vec<Complex<f64>> {
        let draws = |label: String| {
            let mut stream = random::stream(seed, &label);
            let mut normal = move || -> f64 { StandardNormal.sample(&mut stream) };
            (0..KNOTS).map(|_| Complex::new(normal(), normal())).collect::<Vec<_>>()
        };
        let common = draws(format!("scattering {sensor}"));
        let own = draws(format!("scattering {sensor} {event} {component}"));
        let [x, y] = [self.repeatable.sqrt(), (1.0 - self.repeatable).sqrt()];
        let knot = |(c, o): (&Complex<f64>, &Complex<f64>)| {
            let mixed = c * x + o * y;
            Complex::new(self.ln_amplitude * mixed.re, self.phase_rad * mixed.im)
        };
        common.iter().zip(&own).map(knot).collect()
    }
}

impl Outside for LateralScattering {
    fn add(&self, recording: &Recording<'_>, fundamental_hz: f64, seed: u64, motions: &mut [Channels]) -> Result<()> {
        for (sensor, channels) in recording.sensors.iter().zip(motions).skip(1) {
            for (component, history) in recording.components.iter().zip(channels) {
                let knots = self.knots(seed, sensor, recording.event, component);
                let factor = |f: f64| {
                    let x = (f / KNOT_HZ).min((KNOTS - 1) as f64 - 1e-9);
                    let i = x as usize;
                    let share = (f / fundamental_hz).powi(2).min(1.0);
                    (share * (knots[i] + (knots[i + 1] - knots[i]) * (x - i as f64))).exp()
                };
                [*history] = spectrum::respond([history], recording.dt_s, |f, [v]| [v * factor(f)]); // (1)
            }
        }
        Ok(())
    }

    fn repeats(&self) -> bool {
        self.repeatable > 0.0
    }
}
