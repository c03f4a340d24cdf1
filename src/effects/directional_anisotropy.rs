//! Soil that is stiffer in one horizontal direction.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "directional_anisotropy",
    about: "shear-wave velocity differs between the two components",
    phrases: &["Vs of the first component is {ln_velocity_difference|lower|higher} than of the second"],
    build: |table| Ok(Box::new(registry::params::<DirectionalAnisotropy>(table)?.checked()?)),
    schema: || schemars::schema_for!(DirectionalAnisotropy),
    catalogue: Catalogue {
        number: 10,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances,
        confused_with: &["sensor_orientation", "structure_interaction"],
        key: "opposite shifts of the peaks in the two components, without leakage between them",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "ln_velocity_difference",
    unit: "",
    zero: Some(0.0),
    low: -0.8,
    high: 0.8,
    scale: Scale::Linear,
    prior_sd: 0.1,
    draw: [0.05, 0.12],
    is_signed: true,
}];

/// One instance where two components are recorded.
fn instances(array: &Array) -> Vec<Instance> {
    let whole = || Instance::new(ENTRY.name, [], vec![Free::new(&PARAMETERS[0], 0.0)]);
    if array.components.len() < 2 { Vec::new() } else { vec![whole()] }
}

/// Raises the velocity in the first component and lowers it in the second.
///
/// ```text
/// Vs₁ = Vs · exp(+δ/2),   Vs₂ = Vs · exp(−δ/2)                          (1)
/// ```
///
/// | symbol | field                    | unit | range |
/// |--------|--------------------------|------|-------|
/// | δ      | `ln_velocity_difference` | –    | −1…1  |
///
/// Limits: principal directions are those of the components; a motion that belongs to no component keeps Vs.
/// Check:  `components_move_apart_and_their_geometric_mean_stays`.
/// Source: Chen & Hsu (2007) on two directions at Hualien.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct DirectionalAnisotropy {
    /// ln of the ratio of the velocities in the first and the second component.
    ln_velocity_difference: f64,
}

impl DirectionalAnisotropy {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("ln_velocity_difference", self.ln_velocity_difference, -1.0, 1.0, "")])?;
        Ok(self)
    }
}

impl Effect for DirectionalAnisotropy {
    fn edit(&self, profile: &mut Profile, situation: &Situation) {
        let half = match situation.component {
            Some(0) => 0.5 * self.ln_velocity_difference,
            Some(1) => -0.5 * self.ln_velocity_difference,
            _ => return,
        };
        if half != 0.0 {
            profile.layers.iter_mut().for_each(|layer| layer.vs_m_s *= half.exp()); // (1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::layers::tests::profile;

    #[test]
    fn components_move_apart_and_their_geometric_mean_stays() {
        let velocity = |component| {
            let mut profile = profile("elastic");
            let effect = DirectionalAnisotropy { ln_velocity_difference: 0.1 };
            effect.edit(&mut profile, &Situation { component, order: None });
            profile.layers[1].vs_m_s
        };
        let [one, two] = [velocity(Some(0)), velocity(Some(1))];
        assert!((one / two - 0.1f64.exp()).abs() < 1e-12 && ((one * two).sqrt() - 150.0).abs() < 1e-9);
        assert_eq!(velocity(None), 150.0);
    }
}
