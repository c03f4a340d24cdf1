//! The water table lies elsewhere than declared.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

const WATER_KG_M3: f64 = 1000.0;

pub(super) const ENTRY: Entry = Entry {
    name: "water_table",
    about: "the water table lies elsewhere than declared",
    phrases: &["the water table is at {depth_m}"],
    build: |table| Ok(Box::new(registry::params::<WaterTable>(table)?.checked()?)),
    schema: || schemars::schema_for!(WaterTable),
    catalogue: Catalogue {
        number: 24,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances,
        confused_with: &["layer_velocity", "stiff_crust"],
        key: "piezometers or compressional-wave velocity; without them it is a layer's velocity",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "depth_m",
    unit: "m",
    zero: None,
    low: 0.0,
    high: 10.0,
    scale: Scale::Linear,
    prior_sd: 1.0,
    draw: [2.0, 5.0],
    is_signed: false,
}];

/// One instance where the column has water.
fn instances(array: &Array) -> Vec<Instance> {
    let declared_m = array.profile.water_table_m;
    let depth = Free { zero: Some(declared_m), ..Free::new(&PARAMETERS[0], declared_m) };
    let is_wet = declared_m < array.profile.depth_m();
    is_wet.then(|| Instance::new(ENTRY.name, [], vec![depth])).into_iter().collect()
}

/// Moves the water table; soil whose effective stress changes is stiffer or softer for it.
///
/// ```text
/// G ∝ (p')^½:   Vs → Vs · (σ'_v / σ'_v,declared)^¼                       (1)
/// ```
///
/// at the middle of each layer; what lies above the new table drains, what lies below is undrained.
///
/// | symbol | field     | unit | range  |
/// |--------|-----------|------|--------|
/// |        | `depth_m` | m    | 0…2000 |
///
/// Limits: densities stay; layers are not cut at the table.
/// Check:  `a_lower_table_stiffens_what_it_leaves_and_the_declared_one_changes_nothing`.
/// Source: Hardin & Richart (1963) for the exponent of (1).
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct WaterTable {
    /// Depth of the water table, m.
    depth_m: f64,
}

impl WaterTable {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("depth_m", self.depth_m, 0.0, 2000.0, "m")])?;
        Ok(self)
    }
}

impl Effect for WaterTable {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.depth_m == profile.water_table_m {
            return;
        }
        let uplift = |middle: f64, table: f64| WATER_KG_M3 * (middle - table).max(0.0);
        let (mut top, mut above) = (0.0, 0.0); // m, kg/m²
        for layer in &mut profile.layers {
            let middle = top + 0.5 * layer.thickness_m;
            let total = above + 0.5 * layer.thickness_m * layer.density_kg_m3;
            let [declared, new] = [profile.water_table_m, self.depth_m].map(|table| total - uplift(middle, table));
            layer.vs_m_s *= (new / declared).powf(0.25); // (1), stresses over g
            top += layer.thickness_m;
            above += layer.thickness_m * layer.density_kg_m3;
        }
        profile.water_table_m = self.depth_m;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::layers::tests::profile;

    #[test]
    fn a_lower_table_stiffens_what_it_leaves_and_the_declared_one_changes_nothing() {
        let mut edited = profile("elastic");
        WaterTable { depth_m: 1.0 }.edit(&mut edited, &Situation::default());
        assert_eq!(edited, profile("elastic"));
        WaterTable { depth_m: 2.0 }.edit(&mut edited, &Situation::default());
        assert_eq!((edited.layers[0].vs_m_s, edited.water_table_m), (150.0, 2.0));
        let expected = 150.0 * ((3.0 * 1900.0 - 1000.0) / (3.0 * 1900.0 - 2000.0f64)).powf(0.25);
        assert!((edited.layers[1].vs_m_s - expected).abs() < 1e-9);
    }
}
