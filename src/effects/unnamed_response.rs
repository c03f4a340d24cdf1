//! A smooth response of a sensor to which no other effect gives a name.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Operator, Parameter, Place, Scale};
use crate::error::Result;
use crate::registry;
use realfft::num_complex::Complex;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "unnamed_response",
    about: "a smooth factor and phase of one output sensor by frequency, the same in all events, without a physical meaning",
    phrases: &["{place} has a response that is the same in all events and has no physical meaning"],
    build: |table| Ok(Box::new(registry::params::<UnnamedResponse>(table)?.checked()?)),
    schema: || schemars::schema_for!(UnnamedResponse),
    catalogue: Catalogue {
        number: 32,
        class: Class::Field,
        parameters: PARAMETERS,
        instances,
        confused_with: &["sensor_gain", "clock_offset", "instrument_low_pass"],
        key: "no effect with a name leaves as little",
    },
};

/// Frequencies between which the response is linear over ln f, in fundamental frequencies of the column; it goes on beyond the last.
const KNOTS: [f64; N_KNOT] = [0.5, 1.0, 2.0, 4.0, 8.0];
const N_KNOT: usize = 5;
/// Largest ln of a factor, and largest phase, rad.
const FARTHEST: [f64; 2] = [1.5, 3.0];

const fn parameter(name: &'static str, unit: &'static str, farthest: f64) -> Parameter {
    Parameter {
        name,
        unit,
        zero: Some(0.0),
        low: -farthest,
        high: farthest,
        scale: Scale::Linear,
        prior_sd: 0.2,
        draw: [0.1, 0.4],
        is_signed: true,
    }
}

const PARAMETERS: &[Parameter] = &[
    parameter("ln_1", "", FARTHEST[0]),
    parameter("ln_2", "", FARTHEST[0]),
    parameter("ln_3", "", FARTHEST[0]),
    parameter("ln_4", "", FARTHEST[0]),
    parameter("ln_5", "", FARTHEST[0]),
    parameter("phase_1_rad", "rad", FARTHEST[1]),
    parameter("phase_2_rad", "rad", FARTHEST[1]),
    parameter("phase_3_rad", "rad", FARTHEST[1]),
    parameter("phase_4_rad", "rad", FARTHEST[1]),
    parameter("phase_5_rad", "rad", FARTHEST[1]),
];

/// One for each output sensor.
fn instances(array: &Array) -> Vec<Instance> {
    let free: Vec<Free> = PARAMETERS.iter().map(|p| Free::new(p, 0.0)).collect();
    let fundamental_hz = array.profile.fundamental_hz();
    let at = |sensor: &String| {
        let target = [("sensor", sensor.as_str().into()), ("fundamental_hz", fundamental_hz.into())];
        Instance::new(ENTRY.name, target, free.clone())
    };
    array.outputs.iter().map(at).collect()
}

/// Multiplies what a sensor records by a smooth complex factor.
///
/// ```text
/// Y(f) = X(f) exp(Σ (a_k + i φ_k) h_k(f))                               (1)
/// ```
///
/// h_k are hat functions over ln f with knots at ½, 1, 2, 4 and 8 f₁; below the first knot h₁ goes with f²: shaken slowly, soil strays from
/// its base by what its acceleration strains it, whatever it is made of, and what a sensor then does to the motion has a name.
///
/// | symbol | field               | unit | range    |
/// |--------|---------------------|------|----------|
/// | f₁     | `fundamental_hz`    | Hz   | 0.01…50  |
/// | a_k    | `ln_1` … `ln_5`     | –    | −1.5…1.5 |
/// | φ_k    | `phase_1_rad` …     | rad  | −3…3     |
///
/// What a diagnosis compares every named effect with: where the records ask for this one, what is missing has no name, and no
/// correction is made of it.
///
/// Limits: the same in all events and components; no narrower than a knot's distance.
/// Check:  `it_is_the_factor_and_the_phase_of_its_knots`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct UnnamedResponse {
    /// Name of the sensor.
    sensor: String,
    /// Fundamental frequency of the declared column, Hz.
    fundamental_hz: f64,
    #[serde(default)]
    ln_1: f64,
    #[serde(default)]
    ln_2: f64,
    #[serde(default)]
    ln_3: f64,
    #[serde(default)]
    ln_4: f64,
    #[serde(default)]
    ln_5: f64,
    #[serde(default)]
    phase_1_rad: f64,
    #[serde(default)]
    phase_2_rad: f64,
    #[serde(default)]
    phase_3_rad: f64,
    #[serde(default)]
    phase_4_rad: f64,
    #[serde(default)]
    phase_5_rad: f64,
}

impl UnnamedResponse {
    fn checked(self) -> Result<Self> {
        let names = PARAMETERS.iter().map(|p| (p.name, p.low, p.high, p.unit));
        let values = self.knots().into_iter().flatten();
        let mut checks: Vec<_> =
            names.zip(values).map(|((name, low, high, unit), v)| (name, v, low, high, unit)).collect();
        checks.push(("fundamental_hz", self.fundamental_hz, 0.01, 50.0, "Hz"));
        super::ranges(&checks)?;
        Ok(self)
    }

    /// ln of the factor and phase at the knots.
    fn knots(&self) -> [[f64; N_KNOT]; 2] {
        [
            [self.ln_1, self.ln_2, self.ln_3, self.ln_4, self.ln_5],
            [self.phase_1_rad, self.phase_2_rad, self.phase_3_rad, self.phase_4_rad, self.phase_5_rad],
        ]
    }
}

impl Effect for UnnamedResponse {
    fn sensors(&self) -> Vec<&str> {
        vec![&self.sensor]
    }

    fn response(&self, place: &Place<'_>, frequency_hz: f64) -> Option<Operator> {
        let knots = self.knots();
        if place.sensor != self.sensor || knots == [[0.0; N_KNOT]; 2] {
            return None;
        }
        let modes = frequency_hz / self.fundamental_hz;
        let above = KNOTS.partition_point(|knot| *knot <= modes).min(N_KNOT - 1);
        let between = |knots: [f64; N_KNOT]| {
            if above == 0 {
                return knots[0] * (modes / KNOTS[0]).powi(2);
            }
            let share = (modes / KNOTS[above - 1]).ln() / (KNOTS[above] / KNOTS[above - 1]).ln();
            knots[above - 1] + share.min(1.0) * (knots[above] - knots[above - 1])
        };
        let [ln, phase] = knots.map(between);
        Some(Operator::scalar(Complex::from_polar(ln.exp(), phase))) // (1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_factor_and_the_phase_of_its_knots() {
        let table = "sensor = 'top'\nfundamental_hz = 2.0\nln_2 = 0.4\nphase_3_rad = -0.6";
        let effect = (ENTRY.build)(table.parse().expect("TOML")).expect("in range");
        let place = Place { sensor: "top", components: &[] };
        let at = |f: f64| effect.response(&place, f).unwrap().0[0][0];
        assert!((at(2.0) - Complex::from(0.4f64.exp())).norm() < 1e-12);
        assert!((at(4.0) - Complex::from_polar(1.0, -0.6)).norm() < 1e-12);
        let between = at((2.0f64 * 4.0).sqrt());
        assert!((between - Complex::from_polar(0.2f64.exp(), -0.3)).norm() < 1e-12);
        assert!([0.0, 0.2, 1.0, 8.0, 50.0].iter().all(|f| at(*f) == Complex::from(1.0)));
        let table = "sensor = 'top'\nfundamental_hz = 2.0\nln_1 = 0.4\nphase_5_rad = -0.6";
        let effect = (ENTRY.build)(table.parse().expect("TOML")).expect("in range");
        let at = |f: f64| effect.response(&place, f).unwrap().0[0][0];
        assert!((at(0.5) - Complex::from(0.1f64.exp())).norm() < 1e-12);
        assert_eq!(at(0.0), Complex::from(1.0));
        assert!((at(80.0) - Complex::from_polar(1.0, -0.6)).norm() < 1e-12);
        assert!((ENTRY.build)("sensor = 'top'\nfundamental_hz = 2.0\nln_1 = 2.0".parse().expect("TOML")).is_err());
        assert!((ENTRY.build)("sensor = 'top'\nln_1 = 0.2".parse().expect("TOML")).is_err());
    }
}
