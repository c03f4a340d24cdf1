//! What a twin site and its sensors really are: the declared values moved within their tolerances, as effects.

use crate::diagnosis::Tolerances;
use crate::effects::Array;
use crate::numerics::random;
use rand_distr::{Distribution, StandardNormal};
use toml::{Table, Value};

/// Tables of `[[effects]]` that move what `array` declares within `tolerances`, drawn under `seed`: each layer's velocity,
/// the damping, and gain, clock and azimuth of every sensor.
pub fn draw(array: &Array, tolerances: &Tolerances, seed: u64) -> Vec<Table> {
    let mut random = random::stream(seed, "twin draws");
    let mut normal = |sd: f64| -> f64 {
        let mut all = Distribution::<f64>::sample_iter(StandardNormal, &mut random);
        sd * all.find(|z| z.abs() <= Tolerances::FARTHEST).unwrap_or(0.0)
    };
    let mut tables = Vec::new();
    let mut add = |kind: &str, keys: &[(&str, Value)]| {
        let mut table = Table::from_iter([("kind".to_string(), Value::from(kind))]);
        table.extend(keys.iter().map(|(k, v)| (k.to_string(), v.clone())));
        tables.push(table);
    };
    let mut top_m = 0.0;
    for layer in &array.profile.layers {
        let bottom_m = top_m + layer.thickness_m;
        let ln_factor = normal(tolerances.vs_ln).clamp(-0.7, 0.7);
        let range = [("top_m", top_m.into()), ("bottom_m", bottom_m.into()), ("ln_factor", ln_factor.into())];
        add("layer_velocity", &range);
        top_m = bottom_m;
    }
    add("small_strain_damping", &[("multiplier", normal(tolerances.damping_ln).exp().into())]);
    for sensor in array.sensors() {
        for (kind, key, sd) in [
            ("sensor_gain", "ln_gain", tolerances.gain_ln),
            ("clock_offset", "offset_s", tolerances.clock_s),
            ("sensor_orientation", "azimuth_deg", tolerances.orientation_deg),
        ] {
            add(kind, &[("sensor", sensor.into()), (key, normal(sd).into())]);
        }
    }
    tables
}
