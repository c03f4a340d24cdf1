//! How far declared values may be off: the manifest's `[tolerances]`, and the parameters of effects that move them.

use super::{Array, Instance};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Prior standard deviations of what is declared, normal up to [`Tolerances::FARTHEST`]: the nuisances of a diagnosis and the draws of a
/// twin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Tolerances {
    /// ln of the shear-wave velocity of a layer.
    pub vs_ln: f64,
    /// Depth of a boundary between layers, m.
    pub boundary_m: f64,
    /// ln of the small-strain damping.
    pub damping_ln: f64,
    /// ln of a sensor's gain.
    pub gain_ln: f64,
    /// Clock of a sensor, s.
    pub clock_s: f64,
    /// Azimuth of a sensor, degrees.
    pub orientation_deg: f64,
    /// Depth of an output sensor, m.
    pub depth_m: f64,
    /// Error of the column itself that is no parameter's, as a share of what the column adds to its base motion: what another program's
    /// column of the same site would differ by.
    pub model: f64,
}

impl Tolerances {
    /// Farthest that a declared value is within its tolerance, standard deviations: what is farther off is an effect.
    pub const FARTHEST: f64 = 2.5;
}

/// Prior standard deviation of the depth of a boundary in a log that tells velocities metre by metre: equally likely anywhere in that metre,
/// 1/√12 of it.
///
/// Source: Nigbor and Imai (1994), The suspension P-S velocity logging method, for receivers a metre apart.
const BOUNDARY_M: f64 = 0.3;

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            vs_ln: 0.05,
            boundary_m: BOUNDARY_M,
            damping_ln: 0.3,
            gain_ln: 0.01,
            clock_s: 0.001,
            orientation_deg: 1.0,
            depth_m: 0.1,
            model: 0.05,
        }
    }
}

/// A declared value that may be off, wherever the effect that moves it has a place. Velocities are apart: what is known of those of
/// neighbouring layers goes together ([`super::velocity_between`]).
struct Inaccuracy {
    /// The effect.
    kind: &'static str,
    /// Its parameter.
    parameter: &'static str,
    /// Prior standard deviation of the parameter's coordinate.
    deviation: fn(&Tolerances) -> f64,
    /// That of the damping ratio of the column beside it.
    damping_ratio: f64,
    /// Whether a twin has it drawn.
    is_drawn: bool,
}

/// Prior standard deviation of the ln of a reference strain.
const NONLINEARITY_LN: f64 = 0.15;
/// The same of the curvature of a backbone and of the damping of its loops: curves of one soil scatter in shape as they do in reference
/// strain, by a third of what counts as an effect.
///
/// Source: Darendeli (2001), chapter 10, for the scatter of curves around their means, which is larger.
const CURVATURE_LN: f64 = 0.05;
const HYSTERESIS_LN: f64 = 0.1;
/// Prior standard deviation of the damping ratio of a column beside a declared one that is exactly met: what its idealisation, and the
/// time steps of the program that has it, make of a ratio.
///
/// Source: Régnier et al. (2016), doi 10.1785/0120150284, for programs given the same column; Darendeli (2001) has 0.008 for a ratio of
/// 0.01 in the laboratory alone.
const DAMPING_RATIO: f64 = 0.003;

/// Everything declared that may be off, but velocities: what is of the column first.
const INACCURACIES: &[Inaccuracy] = &[
    Inaccuracy {
        damping_ratio: DAMPING_RATIO,
        ..Inaccuracy::drawn("small_strain_damping", "multiplier", |t| t.damping_ln)
    },
    Inaccuracy::drawn("interface_depth", "offset_m", |t| t.boundary_m),
    Inaccuracy::kept("nonlinearity", "ln_gamma_ref", |_| NONLINEARITY_LN),
    Inaccuracy::kept("curve_shape", "ln_curvature", |_| CURVATURE_LN),
    Inaccuracy::kept("curve_shape", "ln_hysteresis", |_| HYSTERESIS_LN),
    Inaccuracy::drawn("sensor_gain", "ln_gain", |t| t.gain_ln),
    Inaccuracy::drawn("clock_offset", "offset_s", |t| t.clock_s),
    Inaccuracy::kept("sensor_depth", "offset_m", |t| t.depth_m),
    Inaccuracy::drawn("sensor_orientation", "azimuth_deg", |t| t.orientation_deg),
];

impl Inaccuracy {
    const fn kept(kind: &'static str, parameter: &'static str, deviation: fn(&Tolerances) -> f64) -> Self {
        Self { kind, parameter, deviation, damping_ratio: 0.0, is_drawn: false }
    }

    const fn drawn(kind: &'static str, parameter: &'static str, deviation: fn(&Tolerances) -> f64) -> Self {
        Self { is_drawn: true, ..Self::kept(kind, parameter, deviation) }
    }
}

/// A declared value of an array that may be off.
#[derive(Debug, Clone, PartialEq)]
pub struct Tolerated {
    /// The effect that moves it; one free parameter.
    pub instance: Instance,
    /// Prior standard deviation of its coordinate.
    pub deviation: f64,
    /// That of the damping ratio of the column beside it; nothing where it is no damping.
    pub damping_ratio: f64,
    /// Whether a twin has it drawn.
    pub is_drawn: bool,
}

/// What of `array` may be off within `tolerances`, but velocities: what is of the column, then sensor by sensor. What has nothing to act on
/// is none of it.
pub fn tolerated(array: &Array, tolerances: &Tolerances) -> Vec<Tolerated> {
    let of = |row: &'static Inaccuracy| {
        let places = super::find(row.kind).map_or_else(|_| Vec::new(), |entry| (entry.catalogue.instances)(array));
        let own = places.into_iter().filter(|i| i.free.len() == 1 && i.free[0].parameter.name == row.parameter);
        let Inaccuracy { damping_ratio, is_drawn, .. } = *row;
        let deviation = (row.deviation)(tolerances);
        own.map(move |instance| Tolerated { instance, deviation, damping_ratio, is_drawn })
    };
    let sensor = |t: &Tolerated| {
        let own = t.instance.target.get("sensor").and_then(toml::Value::as_str);
        own.and_then(|name| array.sensors().position(|sensor| sensor == name))
    };
    let acts = |t: &Tolerated| {
        let zero = t.instance.zero().unwrap_or_default();
        let moved: Vec<f64> = zero.iter().map(|z| z + t.deviation).collect();
        t.instance.acts_on(&array.profile, &moved)
    };
    let mut all: Vec<Tolerated> = INACCURACIES.iter().flat_map(of).filter(|t| t.deviation > 0.0 && acts(t)).collect();
    all.sort_by_key(sensor);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::{Layer, Profile};

    #[test]
    fn every_declared_value_has_an_effect_that_moves_it() {
        let array = |depths_m: &[f64], components: &[&str]| Array {
            profile: Profile { elements: 20, ..Profile::plain(vec![Layer::plain("hyperbolic", 20.0, 1900.0, 200.0)]) },
            input: "base".into(),
            outputs: depths_m.iter().map(|d| format!("at {d}")).collect(),
            depths_m: depths_m.to_vec(),
            components: components.iter().map(ToString::to_string).collect(),
        };
        let names = |array: &Array, tolerances: &Tolerances| -> Vec<String> {
            let of = |t: &Tolerated| format!("{} {}", t.instance.free[0].parameter.name, t.instance.place());
            tolerated(array, tolerances).iter().map(of).collect()
        };
        let all = names(&array(&[6.0, 0.0], &["EW", "NS"]), &Tolerances::default());
        let column = ["multiplier ", "ln_gamma_ref ", "ln_curvature ", "ln_hysteresis "];
        let base = ["ln_gain base", "offset_s base", "azimuth_deg base"];
        let buried = ["ln_gain at 6", "offset_s at 6", "offset_m at 6", "azimuth_deg at 6"];
        // The free surface is where the ground ends.
        let surface = ["ln_gain at 0", "offset_s at 0", "azimuth_deg at 0"];
        assert_eq!(all, [&column[..], &base, &buried, &surface].concat());
        // One component tells no azimuth, and what is exactly known is not off.
        let exact = Tolerances { gain_ln: 0.0, ..Tolerances::default() };
        let few = names(&array(&[0.0], &["EW"]), &exact);
        assert_eq!(few, [&column[..], &["offset_s base", "offset_s at 0"]].concat());
        // Every boundary that may be named may be off.
        let mut layered = array(&[0.0], &["EW"]);
        layered.profile.layers[0].thickness_m = 8.0;
        layered.profile.layers.push(Layer::plain("hyperbolic", 12.0, 1900.0, 300.0));
        let layered = names(&layered, &exact);
        assert_eq!(layered[..2], ["multiplier ", "offset_m at 8.0 m"]);
    }
}
