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

/// Value of the parameter `name` of the effect `held` together with what `drawn` tolerances do of the same, over its range of depths where
/// it has one.
pub fn total(held: &Table, name: &str, drawn: &[Table]) -> Option<f64> {
    let text = |table: &Table| table.get("kind").and_then(toml::Value::as_str).map(String::from);
    let number = |table: &Table, key: &str| table.get(key).and_then(toml::Value::as_float);
    let value = number(held, name)?;
    let parameters = crate::effects::find(&text(held)?).ok()?.catalogue.parameters;
    let parameter = parameters.iter().find(|p| p.name == name)?;
    let range_m = |table: &Table| Some([number(table, "top_m")?, number(table, "bottom_m")?]);
    let is_elsewhere = |key: &String, table: &Table| {
        key != name && !["top_m", "bottom_m"].contains(&key.as_str()) && table.get(key) != held.get(key)
    };
    let share = |table: &Table| match (range_m(held), range_m(table)) {
        _ if table.keys().any(|key| is_elsewhere(key, table)) => 0.0,
        (Some(own), Some(other)) => (own[1].min(other[1]) - own[0].max(other[0])).max(0.0) / (own[1] - own[0]),
        _ => 1.0,
    };
    // What only shapes an effect adds up to nothing.
    let Some(zero) = parameter.zero else { return Some(value) };
    let none = parameter.coordinate(zero);
    let moved = |table: &Table| Some(share(table) * (parameter.coordinate(number(table, name)?) - none));
    let besides: f64 = drawn.iter().filter_map(moved).sum();
    Some(if besides == 0.0 { value } else { parameter.value(parameter.coordinate(value) + besides) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_off_in_all_is_the_effect_and_what_was_drawn_of_the_same() {
        let table = |text: &str| -> Table { toml::from_str(text).expect("a table") };
        let layer = |top_m: f64, bottom_m: f64, ln: f64| {
            table(&format!("kind = 'layer_velocity'\ntop_m = {top_m:?}\nbottom_m = {bottom_m:?}\nln_factor = {ln:?}"))
        };
        let gain =
            |sensor: &str, ln: f64| table(&format!("kind = 'sensor_gain'\nsensor = '{sensor}'\nln_gain = {ln:?}"));
        let damping = |m: f64| table(&format!("kind = 'small_strain_damping'\nmultiplier = {m:?}"));
        let drawn = [layer(0.0, 4.0, 0.1), layer(4.0, 10.0, -0.05), gain("a", 0.01), gain("b", -0.02), damping(0.8)];
        let near = |held: &Table, name: &str, value: f64| {
            let found = total(held, name, &drawn).expect("a value");
            assert!((found - value).abs() < 1e-12, "{held}: {found}, {value}");
        };
        near(&layer(0.0, 4.0, 0.3), "ln_factor", 0.4);
        near(&layer(0.0, 10.0, 0.3), "ln_factor", 0.3 + 0.4 * 0.1 - 0.6 * 0.05);
        near(&gain("b", 0.2), "ln_gain", 0.18);
        near(&damping(3.0), "multiplier", 2.4);
        near(&table("kind = 'thin_seam'\ndepth_m = 3.0\nthickness_m = 1.0\nln_factor = -0.5"), "ln_factor", -0.5);
        near(&table("kind = 'thin_seam'\ndepth_m = 3.0\nthickness_m = 1.0\nln_factor = -0.5"), "depth_m", 3.0);
        assert_eq!(total(&damping(3.0), "multiplier", &[]), Some(3.0));
    }
}
