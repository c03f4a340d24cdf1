//! Shear-wave velocity of a depth range differs from the declared one.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation, layers};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "layer_velocity",
    about: "shear-wave velocity of a depth range is faster or slower than declared",
    build: |table| Ok(Box::new(registry::params::<LayerVelocity>(table)?.checked()?)),
    schema: || schemars::schema_for!(LayerVelocity),
    catalogue: Catalogue {
        number: 1,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances,
        confused_with: &["thin_seam", "water_table", "stiff_crust", "sensor_depth", "clock_offset"],
        key: "transfer functions between neighbouring sensors: only those across the range change",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "ln_factor",
    unit: "",
    zero: Some(0.0),
    low: -1.2,
    high: 1.2,
    scale: Scale::Linear,
    prior_sd: 0.2,
    draw: [0.08, 0.2],
    is_signed: true,
}];

/// Largest ln of a factor that a table may have.
pub const LAYER_VELOCITY_LN: f64 = 1.5;
/// Velocities of one group of layers differ by this factor from its first one's at most, in ln.
const ALIKE_LN: f64 = 0.25;
/// Groups that waves cross in a smaller share of the whole travel time are no places of their own.
const LEAST_TRAVEL: f64 = 0.05;

/// One instance between each two neighbouring sensors; where no sensor lies between base and surface, also one for each
/// group of declared layers, since nothing else divides the column.
fn instances(array: &Array) -> Vec<Instance> {
    let between = |pair: &[f64]| {
        let target = [("top_m", pair[0].into()), ("bottom_m", pair[1].into())];
        Instance::new(ENTRY.name, target, vec![Free::new(&PARAMETERS[0], 0.0)])
    };
    let cuts = array.cuts_m();
    let mut found: Vec<Instance> = cuts.windows(2).map(between).collect();
    let groups = group_cuts_m(&array.profile);
    if cuts.len() == 2 && groups.len() > 2 {
        found.extend(groups.windows(2).map(between));
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

/// Scales the shear-wave velocity of a depth range; layers are cut at its ends.
///
/// ```text
/// Vs → Vs · exp(ln_factor)                                              (1)
/// ```
///
/// | symbol    | field       | unit | range      |
/// |-----------|-------------|------|------------|
/// | ln_factor | `ln_factor` | –    | −1.5…1.5   |
/// | top       | `top_m`     | m    | ≥ 0        |
/// | bottom    | `bottom_m`  | m    | > `top_m`  |
///
/// Limits: strength and curves keep their parameters.
/// Check:  `zero_strength_is_identical_and_only_the_range_changes`.
/// Source: Thompson et al. (2009) on velocity bias at vertical arrays.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct LayerVelocity {
    ln_factor: f64,
    #[serde(default)]
    top_m: f64,
    #[serde(default = "super::bottomless")]
    bottom_m: f64,
}

impl LayerVelocity {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("ln_factor", self.ln_factor, -LAYER_VELOCITY_LN, LAYER_VELOCITY_LN, "")])?;
        super::depth_range(self.top_m, self.bottom_m)?;
        Ok(self)
    }
}

impl Effect for LayerVelocity {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.ln_factor == 0.0 {
            return;
        }
        for layer in layers::between(profile, self.top_m, self.bottom_m) {
            layer.vs_m_s *= self.ln_factor.exp(); // (1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::Layer;
    use crate::effects::layers::tests::profile;

    #[test]
    fn two_sensors_have_groups_of_layers_as_places_and_three_have_their_intervals() {
        let layers = [(1.0, 110.0), (33.0, 250.0), (22.0, 1200.0), (30.0, 490.0), (29.0, 560.0)];
        let layers = layers.map(|(thickness_m, vs_m_s)| Layer::plain("elastic", thickness_m, 1900.0, vs_m_s));
        let array = |depths_m: Vec<f64>| Array {
            profile: Profile { elements: 40, ..Profile::plain(layers.to_vec()) },
            input: "base".into(),
            outputs: depths_m.iter().map(|d| format!("at {d}")).collect(),
            depths_m,
            components: vec!["EW".into()],
        };
        let places = |depths_m| instances(&array(depths_m)).iter().map(Instance::place).collect::<Vec<_>>();
        assert_eq!(places(vec![0.0]), ["0.0–115.0 m", "0.0–34.0 m", "34.0–56.0 m", "56.0–115.0 m"]);
        assert_eq!(places(vec![20.0, 0.0]), ["0.0–20.0 m", "20.0–115.0 m"]);
    }

    #[test]
    fn zero_strength_is_identical_and_only_the_range_changes() {
        let mut edited = profile("elastic");
        let effect = |ln_factor, top_m, bottom_m| LayerVelocity { ln_factor, top_m, bottom_m };
        effect(0.0, 0.0, 9.0).edit(&mut edited, &Situation::default());
        assert_eq!(edited, profile("elastic"));
        effect(0.1, 1.5, 4.0).edit(&mut edited, &Situation::default());
        let fast = 150.0 * 0.1f64.exp();
        let seen: Vec<_> = edited.layers.iter().map(|l| (l.thickness_m, l.vs_m_s)).collect();
        assert_eq!(seen, [(1.5, 150.0), (0.5, fast), (2.0, fast)]);
    }
}
