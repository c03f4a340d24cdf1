//! An interface that slips in strong motion.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::{Profile, Slip};
use crate::error::Result;
use crate::registry;
use crate::units::{G_M_S2, KPA};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "interface_slip",
    about: "the shear stress across one depth is capped: what lies above slips",
    phrases: &["what lies above slips {place} from a shear stress of {tau_max_kpa}"],
    build: |table| Ok(Box::new(registry::params::<InterfaceSlip>(table)?.checked()?)),
    schema: || schemars::schema_for!(InterfaceSlip),
    catalogue: Catalogue {
        number: 7,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances,
        confused_with: &["nonlinearity", "pore_pressure", "rate_dependence"],
        key: "accelerations above the depth stop at one level in all strong events",
    },
};

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "tau_max_kpa",
        unit: "kPa",
        zero: Some(f64::INFINITY),
        low: 0.5,
        high: f64::INFINITY,
        scale: Scale::Inverse,
        prior_sd: 0.2,
        draw: [3.0, 15.0],
        is_signed: false,
    },
    Parameter {
        name: "depth_m",
        unit: "m",
        zero: None,
        low: 0.0,
        high: 1000.0,
        scale: Scale::Linear,
        prior_sd: 1.0,
        draw: [2.0, 12.0],
        is_signed: false,
    },
];

/// Depths of at most eight interfaces, each started where a tenth of g above it would make it slip.
fn instances(array: &Array) -> Vec<Instance> {
    let depth_m = array.profile.depth_m();
    let spacing = (depth_m / 9.0).max(1.0);
    let at = |i: usize| {
        let depth = i as f64 * spacing;
        let density = array.profile.layers.first().map_or(1800.0, |l| l.density_kg_m3);
        let start_kpa = 0.1 * G_M_S2 * density * depth / KPA;
        // The deeper, the heavier what slips: one size for all depths would never be reached by some and crush others.
        let free = vec![Free { size: PARAMETERS[0].coordinate(start_kpa), ..Free::new(&PARAMETERS[0], start_kpa) }];
        Instance::new(ENTRY.name, [("depth_m", depth.into())], free)
    };
    (1..).take_while(|i| (*i as f64 + 0.5) * spacing <= depth_m + 1e-6).map(at).collect()
}

/// Caps the shear stress of the element at a depth; the equations are [`crate::soil::Slider`]'s.
///
/// | symbol | field         | unit | range    |
/// |--------|---------------|------|----------|
/// | τ_max  | `tau_max_kpa` | kPa  | 0.1…∞    |
/// | z      | `depth_m`     | m    | ≥ 0      |
///
/// τ_max = ∞ (TOML `inf`) is no interface. The soil above cannot be accelerated by more than τ_max over its mass.
///
/// Limits: nothing where the depth lies below the column. The element that slips has no viscous damping, which would
/// carry what the slider does not.
/// Check:  `tests/verification/boundaries.rs`: plateau of the acceleration, sliding block in closed form.
/// Source: Newmark (1965), doi 10.1680/geot.1965.15.2.139.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct InterfaceSlip {
    /// Largest shear stress τ_max, kPa.
    tau_max_kpa: f64,
    /// Depth of the interface, m.
    depth_m: f64,
}

impl InterfaceSlip {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("tau_max_kpa", self.tau_max_kpa, 0.1, f64::INFINITY, "kPa"),
            ("depth_m", self.depth_m, 0.0, 1e4, "m"),
        ])?;
        Ok(self)
    }
}

/// Shear stress that no soil reaches, kPa: a cap beyond it is none.
const BEYOND_KPA: f64 = 1e5;

impl Effect for InterfaceSlip {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.tau_max_kpa < BEYOND_KPA && self.depth_m < profile.depth_m() {
            profile.features.slips.push(Slip { depth_m: self.depth_m, tau_max_pa: self.tau_max_kpa * KPA });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::layers::tests::profile;

    #[test]
    fn a_typical_interface_stops_one_acceleration_at_every_depth() {
        let profile = profile("elastic");
        let density = profile.layers[0].density_kg_m3;
        let array = Array {
            profile,
            input: "base".into(),
            outputs: vec!["top".into()],
            depths_m: vec![0.0],
            components: vec!["EW".into()],
        };
        let all = instances(&array);
        assert!(all.len() > 2);
        for (i, instance) in all.iter().enumerate() {
            let tau_max_pa = KPA * instance.free[0].parameter.value(instance.free[0].size);
            let above_kg_m2 = density * (i + 1) as f64 * (array.profile.depth_m() / 9.0).max(1.0);
            assert!((tau_max_pa / above_kg_m2 - 0.1 * G_M_S2).abs() < 1e-9, "{}", instance.place());
        }
    }
}
