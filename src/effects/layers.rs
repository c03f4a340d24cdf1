//! Layers: the ranges of depth that records tell apart, cutting at a depth, and numbers in a layer's law.

use super::Array;
use crate::column::{Layer, MovedBoundary, Profile};
use std::sync::Arc;

/// Velocities of one group of layers differ by this factor from its first one's at most, in ln.
const ALIKE_LN: f64 = 0.25;
/// Groups that waves cross in a smaller share of the whole travel time are no places of their own.
const LEAST_TRAVEL: f64 = 0.05;

/// Ranges of depth, m, that records can tell apart: between each two neighbouring sensors; where no sensor lies between base and surface,
/// also the groups of declared layers, since nothing else divides the column.
pub(super) fn ranges_m(array: &Array) -> Vec<[f64; 2]> {
    let cuts = array.cuts_m();
    let between = |cuts: &[f64]| -> Vec<[f64; 2]> { cuts.windows(2).map(|pair| [pair[0], pair[1]]).collect() };
    let mut found = between(&cuts);
    let groups = group_cuts_m(&array.profile);
    if cuts.len() == 2 && groups.len() > 2 {
        found.extend(between(&groups));
    }
    found
}

/// A stretch of neighbouring layers of about one velocity.
struct Group {
    bottom_m: f64,
    travel_s: f64,
    first_m_s: f64,
}

impl Group {
    fn distance_ln(&self, other: &Self) -> f64 {
        (self.first_m_s / other.first_m_s).ln().abs()
    }
}

/// Depths that cut the column between groups of layers of about one velocity: 0, the boundaries, the base.
fn group_cuts_m(profile: &Profile) -> Vec<f64> {
    let mut groups: Vec<Group> = Vec::new();
    let mut bottom_m = 0.0;
    for layer in &profile.layers {
        bottom_m += layer.thickness_m;
        let own = Group { bottom_m, travel_s: layer.thickness_m / layer.vs_m_s, first_m_s: layer.vs_m_s };
        match groups.last_mut().filter(|last| last.distance_ln(&own) <= ALIKE_LN) {
            Some(last) => (last.bottom_m, last.travel_s) = (bottom_m, last.travel_s + own.travel_s),
            None => groups.push(own),
        }
    }
    let whole_s: f64 = groups.iter().map(|g| g.travel_s).sum();
    while let Some(i) = groups.iter().position(|g| g.travel_s < LEAST_TRAVEL * whole_s && groups.len() > 1) {
        // What is too quick to be seen goes with the neighbour that is more like it.
        let distance =
            |k: Option<usize>| k.and_then(|k| groups.get(k)).map_or(f64::INFINITY, |g| g.distance_ln(&groups[i]));
        let is_upper = distance(i.checked_sub(1)) < distance(Some(i + 1));
        let quick = groups.remove(i);
        let neighbour = &mut groups[if is_upper { i - 1 } else { i }];
        neighbour.travel_s += quick.travel_s;
        neighbour.bottom_m = neighbour.bottom_m.max(quick.bottom_m);
    }
    std::iter::once(0.0).chain(groups.iter().map(|g| g.bottom_m)).collect()
}

/// Makes a layer boundary at `depth_m`, unless there is one or it lies outside the column; a profile keeps its number of
/// elements unless it would have fewer than layers.
pub(super) fn cut(profile: &mut Profile, depth_m: f64) {
    let mut top = 0.0;
    for i in 0..profile.layers.len() {
        let bottom = top + profile.layers[i].thickness_m;
        if depth_m - top > MovedBoundary::NEAR_M && bottom - depth_m > MovedBoundary::NEAR_M {
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

/// The layers between two declared depths, cut there.
pub(super) fn between(profile: &mut Profile, top_m: f64, bottom_m: f64) -> impl Iterator<Item = &mut Layer> {
    let [top_m, bottom_m] = [top_m, bottom_m].map(|declared_m| profile.features.depth_m(declared_m));
    cut(profile, top_m);
    cut(profile, bottom_m);
    let mut depth = 0.0;
    profile.layers.iter_mut().filter(move |layer| {
        let middle = depth + 0.5 * layer.thickness_m;
        depth += layer.thickness_m;
        (top_m..bottom_m).contains(&middle)
    })
}

/// Laws that an effect acts on, in a range of depth.
pub struct Laws {
    /// Names of the laws.
    pub kinds: Vec<&'static str>,
    /// What they have and others lack.
    pub what: &'static str,
    /// Top of the range, m.
    pub top_m: f64,
    /// Bottom of the range, m.
    pub bottom_m: f64,
}

impl Laws {
    fn range(&self, profile: &Profile) -> String {
        format!("{}…{} m", self.top_m, self.bottom_m.min(profile.depth_m()))
    }

    /// Laws of the layers in the range that it does not act on, and whether there are others.
    fn others(&self, profile: &Profile) -> (Vec<String>, bool) {
        let (mut depth, mut others, mut is_met) = (0.0, Vec::new(), false);
        for layer in &profile.layers {
            let top = depth;
            depth += layer.thickness_m;
            if top >= self.bottom_m || depth <= self.top_m {
                continue;
            }
            if self.kinds.contains(&layer.law_kind.as_str()) {
                is_met = true;
            } else if !others.contains(&layer.law_kind) {
                others.push(layer.law_kind.clone());
            }
        }
        (others, is_met)
    }

    /// Why there is nothing to act on in `profile`, where that is so.
    pub(super) fn refusal(&self, profile: &Profile) -> Option<String> {
        let (what, kinds) = (self.what, self.kinds.join(", "));
        let is_met = self.others(profile).1;
        (!is_met).then(|| format!("no layer in {} follows a law with {what} ({kinds})", self.range(profile)))
    }

    /// Which layers of the range stay as they are, where there are such.
    pub(super) fn left_alone(&self, profile: &Profile) -> Option<String> {
        let (others, is_met) = self.others(profile);
        (is_met && !others.is_empty()).then(|| {
            let (range, others, kinds) = (self.range(profile), others.join(", "), self.kinds.join(", "));
            format!("in {range}, layers of {others} stay as they are: it acts on {} ({kinds})", self.what)
        })
    }
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

/// Multiplies the small-strain damping that a layer has of its own, declared or by its curves.
pub(super) fn scale_damping(layer: &mut Layer, factor: f64) {
    if layer.law_kind == "hyperbolic" {
        scale(layer, "damping_multiplier", 1.0, factor);
    } else {
        scale(layer, "damping_ratio", 0.0, factor);
    }
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

    #[test]
    fn layers_that_an_effect_stops_short_of_are_told() {
        let mut profile = profile("hyperbolic");
        let laws = |top_m: f64| Laws { kinds: vec!["hyperbolic"], what: "a backbone", top_m, bottom_m: f64::INFINITY };
        assert_eq!((laws(0.0).left_alone(&profile), laws(0.0).refusal(&profile)), (None, None));
        profile.layers[1] = Layer::plain("elastic", 2.0, 1900.0, 150.0);
        let told = laws(0.0).left_alone(&profile).unwrap();
        assert_eq!(told, "in 0…4 m, layers of elastic stay as they are: it acts on a backbone (hyperbolic)");
        assert!(laws(2.0).left_alone(&profile).is_none() && laws(2.0).refusal(&profile).is_some());
    }
}
