//! Editing layers: cutting them at a depth, and numbers in a layer's law.

use crate::column::{Layer, Profile};
use std::sync::Arc;

/// Layers thinner than this are not made: a cut this close to a boundary is that boundary, m.
const THINNEST_M: f64 = 0.02;

/// Makes a layer boundary at `depth_m`, unless there is one or it lies outside the column; a profile keeps its number of
/// elements unless it would have fewer than layers.
pub(super) fn cut(profile: &mut Profile, depth_m: f64) {
    let mut top = 0.0;
    for i in 0..profile.layers.len() {
        let bottom = top + profile.layers[i].thickness_m;
        if depth_m - top > THINNEST_M && bottom - depth_m > THINNEST_M {
            let mut lower = profile.layers[i].clone();
            profile.layers[i].thickness_m = depth_m - top;
            lower.thickness_m = bottom - depth_m;
            profile.layers.insert(i + 1, lower);
            profile.elements = profile.elements.max(profile.layers.len());
            return;
        }
        top = bottom;
    }
}

/// The layers between two depths, cut there.
pub(super) fn between(profile: &mut Profile, top_m: f64, bottom_m: f64) -> impl Iterator<Item = &mut Layer> {
    cut(profile, top_m);
    cut(profile, bottom_m);
    let mut depth = 0.0;
    profile.layers.iter_mut().filter(move |layer| {
        let middle = depth + 0.5 * layer.thickness_m;
        depth += layer.thickness_m;
        (top_m..bottom_m).contains(&middle)
    })
}

/// Why an effect on laws of these `kinds` between two depths has nothing to act on; `what` names what the others lack.
pub(super) fn refusal(profile: &Profile, top_m: f64, bottom_m: f64, kinds: &[&str], what: &str) -> Option<String> {
    let mut depth = 0.0;
    let is_met = profile.layers.iter().any(|layer| {
        let top = depth;
        depth += layer.thickness_m;
        top < bottom_m && depth > top_m && kinds.contains(&layer.law_kind.as_str())
    });
    let range = format!("{top_m}…{} m", bottom_m.min(profile.depth_m()));
    (!is_met).then(|| format!("no layer in {range} follows a law with {what} ({})", kinds.join(", ")))
}

/// A number of a layer's law, `default` where the law does not give it.
pub(super) fn number(layer: &Layer, key: &str, default: f64) -> f64 {
    let value = layer.law.get(key);
    value.and_then(|v| v.as_float().or(v.as_integer().map(|i| i as f64))).unwrap_or(default)
}

/// Sets a number of a layer's law.
pub(super) fn set(layer: &mut Layer, key: &str, value: f64) {
    Arc::make_mut(&mut layer.law).insert(key.into(), toml::Value::Float(value));
}

/// Multiplies a number of a layer's law, `default` where the law does not give it.
pub(super) fn scale(layer: &mut Layer, key: &str, default: f64, factor: f64) {
    let value = number(layer, key, default);
    set(layer, key, factor * value);
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::column::{Features, Rayleigh, Vertical};

    /// Two layers of 2 m.
    pub(crate) fn profile(law_kind: &str) -> Profile {
        let layer = Layer::plain(law_kind, 2.0, 1900.0, 150.0);
        Profile {
            layers: vec![layer.clone(), layer],
            water_table_m: 1.0,
            vertical: Vertical::Free,
            rayleigh: Rayleigh::default(),
            elements: 10,
            features: Features::default(),
        }
    }

    #[test]
    fn cuts_keep_the_depth_and_leave_no_slivers() {
        let thickness = |p: &Profile| p.layers.iter().map(|l| l.thickness_m).collect::<Vec<_>>();
        let mut p = profile("elastic");
        for depth in [0.0, 0.01, 1.99, 2.0, 2.015, 4.0, 7.0, -1.0] {
            cut(&mut p, depth);
        }
        assert_eq!(thickness(&p), [2.0, 2.0]);
        cut(&mut p, 2.5);
        assert_eq!(thickness(&p), [2.0, 0.5, 1.5]);
        p.elements = 3;
        let picked: Vec<f64> = between(&mut p, 1.0, 2.5).map(|l| l.thickness_m).collect();
        assert_eq!(picked, [1.0, 0.5]);
        assert_eq!((p.depth_m(), p.elements), (4.0, 4));
    }
}
