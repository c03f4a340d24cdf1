//! A declared boundary between layers lies shallower or deeper.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::{MovedBoundary, Profile};
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "interface_depth",
    about: "a boundary between layers is shallower or deeper than declared",
    phrases: &["the boundary of layers {place} is {offset_m|shallower|deeper} than declared"],
    build: |table| Ok(Box::new(registry::params::<InterfaceDepth>(table)?.checked()?)),
    schema: || schemars::schema_for!(InterfaceDepth),
    catalogue: Catalogue {
        number: 30,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances,
        confused_with: &["layer_velocity", "stiff_crust", "thin_seam"],
        key: "the peaks of the layer above alone, against those of the whole column",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "offset_m",
    unit: "m",
    zero: Some(0.0),
    low: -10.0,
    high: 10.0,
    scale: Scale::Linear,
    prior_sd: 1.0,
    draw: [0.5, 1.5],
    is_signed: true,
}];

/// Impedance contrast below which a boundary is none to be named, in ln.
const LEAST_CONTRAST_LN: f64 = 0.15;
/// Thinnest layer whose boundary is looked for, m: offsets that can be named are about this large.
const THINNEST_M: f64 = 1.0;
/// Typical offset over the thickness of the thinner neighbour.
const TYPICAL_SHARE: f64 = 0.1;
/// Most of a neighbouring layer that a boundary may take.
const MOST: f64 = 0.8;

/// Every interior boundary with a noticeable contrast, deepest last.
fn instances(array: &Array) -> Vec<Instance> {
    let mut depth_m = 0.0;
    let mut found = Vec::new();
    for pair in array.profile.layers.windows(2) {
        depth_m += pair[0].thickness_m;
        let contrast = (pair[1].density_kg_m3 * pair[1].vs_m_s / (pair[0].density_kg_m3 * pair[0].vs_m_s)).ln();
        let thinner_m = pair[0].thickness_m.min(pair[1].thickness_m);
        if contrast.abs() >= LEAST_CONTRAST_LN && thinner_m >= THINNEST_M {
            let free = Free { size: (TYPICAL_SHARE * thinner_m).max(0.3), ..Free::new(&PARAMETERS[0], 0.0) };
            found.push(Instance::new(ENTRY.name, [("depth_m", depth_m.into())], vec![free]));
        }
    }
    found
}

/// Moves a boundary; the layers on both sides keep what they are made of, and the base stays.
///
/// ```text
/// h_above → h_above + offset,   h_below → h_below − offset             (1)
/// ```
///
/// | symbol | field      | unit | range   |
/// |--------|------------|------|---------|
/// |        | `depth_m`  | m    | that of a declared boundary, within 0.02 m |
/// | offset | `offset_m` | m    | −100…100; deeper is positive |
///
/// Limits: at most four fifths of a neighbouring layer are taken, a larger offset counts as that. Both layers keep their
/// elements, which are longer and shorter then: motions would jump where one changes layers.
/// Check:  `the_boundary_moves_and_the_base_stays`, `motions_change_smoothly_with_the_boundary`.
/// Source: the declared profile; for its uncertainty Toro (1995), Probabilistic models of site velocity profiles.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct InterfaceDepth {
    /// Declared depth of the boundary, m.
    depth_m: f64,
    /// How much deeper it really is, m; shallower is negative.
    offset_m: f64,
}

impl InterfaceDepth {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("depth_m", self.depth_m, 0.0, 1e4, "m"), ("offset_m", self.offset_m, -100.0, 100.0, "m")])?;
        Ok(self)
    }

    /// Index of the layer above the boundary, wherever that lies by now.
    fn above(&self, profile: &Profile) -> Option<usize> {
        let lies_m = profile.features.depth_m(self.depth_m);
        let mut depth_m = 0.0;
        let interior = profile.layers.len().saturating_sub(1);
        profile.layers[..interior].iter().position(|layer| {
            depth_m += layer.thickness_m;
            (depth_m - lies_m).abs() <= MovedBoundary::NEAR_M
        })
    }
}

impl Effect for InterfaceDepth {
    fn refusal(&self, profile: &Profile) -> Option<String> {
        let why = || format!("there is no boundary between layers at {} m", self.depth_m);
        self.above(profile).is_none().then(why)
    }

    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.offset_m == 0.0 {
            return;
        }
        let Some(i) = self.above(profile) else { return };
        let [above_m, below_m] = [i, i + 1].map(|k| profile.layers[k].thickness_m);
        let offset_m = self.offset_m.clamp(-MOST * above_m, MOST * below_m);
        let moved_m = [above_m + offset_m, below_m - offset_m]; // (1)
        for (layer, thickness_m) in profile.layers[i..].iter_mut().zip(moved_m) {
            layer.fineness *= layer.thickness_m / thickness_m;
            layer.thickness_m = thickness_m;
        }
        profile.features.boundaries.push(MovedBoundary { declared_m: self.depth_m, offset_m });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::{Analysis, Column, Layer};

    #[test]
    fn the_boundary_moves_and_the_base_stays() {
        let layers = [(2.0, 150.0), (3.0, 300.0), (5.0, 310.0)];
        let layers = layers.map(|(thickness_m, vs_m_s)| Layer::plain("elastic", thickness_m, 1900.0, vs_m_s));
        let declared = Profile { elements: 20, ..Profile::plain(layers.into()) };
        let moved = |depth_m, offset_m| {
            let mut profile = declared.clone();
            InterfaceDepth { depth_m, offset_m }.edit(&mut profile, &Situation::default());
            assert!((profile.depth_m() - 10.0).abs() < 1e-12);
            profile.layers.iter().map(|l| l.thickness_m).collect::<Vec<_>>()
        };
        assert_eq!(moved(2.0, 0.5), [2.5, 2.5, 5.0]);
        assert_eq!(moved(5.01, -1.0), [2.0, 2.0, 6.0]);
        assert_eq!(moved(2.0, -9.0), [2.0 - 0.8 * 2.0, 3.0 + 0.8 * 2.0, 5.0]);
        assert_eq!(moved(3.3, 1.0), [2.0, 3.0, 5.0]);
        assert!(InterfaceDepth { depth_m: 3.3, offset_m: 1.0 }.refusal(&declared).is_some());
        // A boundary that has moved is still that of its declared depth, for itself and for what acts on a range of layers.
        let mut twice = declared.clone();
        for offset_m in [0.4, -0.1] {
            InterfaceDepth { depth_m: 2.0, offset_m }.edit(&mut twice, &Situation::default());
        }
        assert!((twice.layers[0].thickness_m - 2.3).abs() < 1e-12 && (twice.depth_m() - 10.0).abs() < 1e-12);
        assert_eq!(super::super::layers::between(&mut twice, 0.0, 2.0).count(), 1);
        assert_eq!(twice.layers.len(), 3);
        let depths_m = vec![0.0];
        let (input, outputs, components) = ("base".into(), vec!["top".into()], vec!["EW".into()]);
        let array = Array { profile: declared.clone(), input, outputs, depths_m, components };
        let places: Vec<String> = instances(&array).iter().map(Instance::place).collect();
        assert_eq!(places, ["at 2.0 m"]);
    }

    #[test]
    fn motions_change_smoothly_with_the_boundary() {
        let layers = [(4.0, 150.0), (16.0, 300.0)];
        let layers = layers.map(|(thickness_m, vs_m_s)| Layer::plain("elastic", thickness_m, 1900.0, vs_m_s));
        let declared = Profile { elements: 24, ..Profile::plain(layers.into()) };
        let frequency_hz = |offset_m: f64| {
            let mut profile = declared.clone();
            InterfaceDepth { depth_m: 4.0, offset_m }.edit(&mut profile, &Situation::default());
            Column::new(&profile, &Analysis::default()).unwrap().frequency_hz()
        };
        // Second differences are those of a smooth function, where an element that changes layers would bring a jump.
        let step_m = 0.05;
        for k in -20..20 {
            let [a, b, c] = [-1.0, 0.0, 1.0].map(|side| frequency_hz(step_m * (f64::from(k) + side)).ln());
            assert!((a - 2.0 * b + c).abs() < 0.05 * (c - a).abs(), "{k}: {a} {b} {c}");
        }
    }
}
