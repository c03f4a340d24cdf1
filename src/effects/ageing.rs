//! Soil that grows stiffer or softer from event to event.

use super::{Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::Profile;
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "ageing",
    about: "shear-wave velocity changes from event to event of the history",
    phrases: &["Vs is {ln_velocity_per_event|lower|higher} from one event to the next"],
    build: |table| Ok(Box::new(registry::params::<Ageing>(table)?.checked()?)),
    schema: || schemars::schema_for!(Ageing),
    catalogue: Catalogue {
        number: 23,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances: |_| vec![Instance::new(ENTRY.name, [], vec![Free::new(&PARAMETERS[0], 0.0)])],
        confused_with: &["nonlinearity", "pore_pressure"],
        key: "apparent velocity follows the order of the events, not their strength",
    },
};

const PARAMETERS: &[Parameter] = &[Parameter {
    name: "ln_velocity_per_event",
    unit: "",
    zero: Some(0.0),
    low: -0.06,
    high: 0.06,
    scale: Scale::Linear,
    prior_sd: 0.015,
    draw: [0.01, 0.03],
    is_signed: true,
}];

/// Changes the velocity with the place of an event in the array's history.
///
/// ```text
/// Vs(e) = Vs · exp(κ (e − ē))                                           (1)
/// ```
///
/// | symbol | field                   | unit | range     |
/// |--------|-------------------------|------|-----------|
/// | κ      | `ln_velocity_per_event` | –    | −0.3…0.3  |
/// | e − ē  | `Situation::order`      | –    | events after the middle of the history |
///
/// Limits: counts events, not days; healing between them is left out. A motion that belongs to no event keeps Vs.
/// Check:  `each_event_has_its_own_velocity`.
/// Source: definition.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Ageing {
    /// ln of the factor on the velocity from one event to the next.
    ln_velocity_per_event: f64,
}

impl Ageing {
    fn checked(self) -> Result<Self> {
        super::ranges(&[("ln_velocity_per_event", self.ln_velocity_per_event, -0.3, 0.3, "")])?;
        Ok(self)
    }
}

impl Effect for Ageing {
    fn edit(&self, profile: &mut Profile, situation: &Situation) {
        let ln = self.ln_velocity_per_event * situation.order.unwrap_or(0.0);
        if ln != 0.0 {
            profile.layers.iter_mut().for_each(|layer| layer.vs_m_s *= ln.exp()); // (1)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::layers::tests::profile;

    #[test]
    fn each_event_has_its_own_velocity() {
        let velocity = |order| {
            let mut profile = profile("elastic");
            Ageing { ln_velocity_per_event: 0.02 }.edit(&mut profile, &Situation { component: None, order });
            profile.layers[0].vs_m_s
        };
        assert!((velocity(Some(3.0)) / velocity(Some(2.0)) - 0.02f64.exp()).abs() < 1e-12);
        assert_eq!([velocity(Some(0.0)), velocity(None)], [150.0; 2]);
    }
}
