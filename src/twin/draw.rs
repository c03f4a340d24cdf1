//! What a twin site and its sensors really are: the declared values moved within their tolerances, as effects.

use crate::effects::{Array, Tolerances, tolerated, velocity_between};
use crate::numerics::random;
use rand_distr::{Distribution, StandardNormal};
use toml::Table;

/// Farthest that the ln of a velocity is drawn.
const LARGEST: f64 = 0.7;

/// Tables of `[[effects]]` that move what `array` declares within `tolerances`, drawn under `seed`: each layer's velocity,
/// the damping, the depth of each boundary, and gain, clock and azimuth of every sensor.
pub fn draw(array: &Array, tolerances: &Tolerances, seed: u64) -> Vec<Table> {
    let mut random = random::stream(seed, "twin draws");
    let mut normal = |sd: f64| -> f64 {
        let mut all = Distribution::<f64>::sample_iter(StandardNormal, &mut random);
        sd * all.find(|z| z.abs() <= Tolerances::FARTHEST).unwrap_or(0.0)
    };
    let mut tables = Vec::new();
    let mut top_m = 0.0;
    for layer in &array.profile.layers {
        let bottom_m = top_m + layer.thickness_m;
        let ln_factor = normal(tolerances.vs_ln).clamp(-LARGEST, LARGEST);
        tables.push(velocity_between([top_m, bottom_m]).table(&[ln_factor]));
        top_m = bottom_m;
    }
    for own in tolerated(array, tolerances).into_iter().filter(|own| own.is_drawn) {
        let zero = own.instance.zero().unwrap_or_default();
        let at: Vec<f64> = zero.iter().map(|zero| zero + normal(own.deviation)).collect();
        tables.push(own.instance.at(&at));
    }
    tables
}
