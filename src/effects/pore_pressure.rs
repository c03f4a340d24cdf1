//! Softening within an event by excess pore pressure that the declared law does not produce.

use super::{Array, Catalogue, Class, Effect, Entry, Free, Instance, Parameter, Scale, Situation};
use crate::column::{Profile, SofteningZone};
use crate::error::Result;
use crate::registry;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry = Entry {
    name: "pore_pressure",
    about: "shear stiffness falls within strong events as pore pressure builds up",
    phrases: &[
        "pore pressure softens {place} in strong events, {ru_at_reference} of the effective stress at the reference motion",
    ],
    build: |table| Ok(Box::new(registry::params::<PorePressure>(table)?.checked()?)),
    schema: || schemars::schema_for!(PorePressure),
    catalogue: Catalogue {
        number: 6,
        class: Class::Soil,
        parameters: PARAMETERS,
        instances,
        confused_with: &["nonlinearity", "ageing", "interface_slip"],
        key: "softer after the strong phase than before it, and recovered by the next event",
    },
};

const PARAMETERS: &[Parameter] = &[
    Parameter {
        name: "ru_at_reference",
        unit: "",
        zero: Some(0.0),
        low: 0.0,
        high: 3.0,
        scale: Scale::Linear,
        prior_sd: 0.5,
        draw: [0.5, 1.2],
        is_signed: false,
    },
    Parameter {
        name: "exponent",
        unit: "",
        zero: None,
        low: 0.5,
        high: 4.0,
        scale: Scale::Log,
        prior_sd: 0.4,
        draw: [1.2, 2.0],
        is_signed: false,
    },
];

/// Deepest ground taken to build up pore pressure, m.
const DEEPEST_M: f64 = 20.0;

/// The wet ground to 20 m as a whole, and each part of it between neighbouring sensors.
fn instances(array: &Array) -> Vec<Instance> {
    let wet = |depth: f64| depth.max(array.profile.water_table_m).min(DEEPEST_M);
    let cuts = array.cuts_m();
    let deepest = cuts.last().copied().unwrap_or(0.0);
    let mut ranges = vec![(wet(0.0), wet(deepest))];
    if cuts.len() > 2 {
        ranges.extend(cuts.windows(2).map(|pair| (wet(pair[0]), wet(pair[1]))));
    }
    let thick = ranges.into_iter().filter(|(top, bottom)| bottom - top > 0.5);
    let at = |(top, bottom): (f64, f64)| {
        let target = [("top_m", top.into()), ("bottom_m", bottom.into()), ("exponent", 1.5.into())];
        Instance::new(ENTRY.name, target, vec![Free::new(&PARAMETERS[0], 0.3)])
    };
    thick.map(at).collect()
}

/// Softens the shear of a depth range as cyclic shear stress accumulates; the equations are
/// [`crate::soil::Softening`]'s.
///
/// | symbol | field                | unit | range |
/// |--------|----------------------|------|-------|
/// | a      | `ru_at_reference`    | –    | 0…5   |
/// | n      | `exponent`           | –    | 0.5…4 |
/// | range  | `top_m`, `bottom_m`  | m    | element centres |
///
/// It comes on top of any law. A law with pore pressure of its own keeps it: then this is what that law still misses.
///
/// Limits: those of the softening: no drainage, so no recovery within an event.
/// Check:  `tests/verification/around_a_law.rs`: pore pressure ratio in closed form; later motion is slower.
/// Source: Zeghal, Elgamal, Tang & Stepp (1995), doi 10.1061/(ASCE)0733-9410(1995)121:4(363), at Lotung.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct PorePressure {
    /// Pore pressure ratio a after the reference stress path; zero is none.
    ru_at_reference: f64,
    /// Exponent n of the growth with the motion.
    #[serde(default = "usual_exponent")]
    exponent: f64,
    /// Top of the range, m.
    #[serde(default)]
    top_m: f64,
    /// Bottom of the range, m.
    #[serde(default = "super::bottomless")]
    bottom_m: f64,
}

fn usual_exponent() -> f64 {
    1.5
}

impl PorePressure {
    fn checked(self) -> Result<Self> {
        super::ranges(&[
            ("ru_at_reference", self.ru_at_reference, 0.0, 5.0, ""),
            ("exponent", self.exponent, 0.5, 4.0, ""),
            ("top_m", self.top_m, 0.0, 1e4, "m"),
            ("bottom_m", self.bottom_m, self.top_m, 1e4, "m"),
        ])?;
        Ok(self)
    }
}

impl Effect for PorePressure {
    fn edit(&self, profile: &mut Profile, _: &Situation) {
        if self.ru_at_reference > 0.0 {
            profile.features.softenings.push(SofteningZone {
                top_m: self.top_m,
                bottom_m: self.bottom_m,
                ru_at_reference: self.ru_at_reference,
                exponent: self.exponent,
            });
        }
    }
}
