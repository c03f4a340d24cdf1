//! Effects a declared site model may lack: one effect a file, registered in [`EFFECTS`].
//!
//! A soil or boundary effect edits the set-up of the column; a sensor effect acts between the true motion and the
//! record. One definition serves twin truths, diagnosis and corrected manifests; an effect of zero strength leaves
//! everything bit-identical.

mod catalogue;
mod operator;
mod situation;

mod compliant_base;
mod container_boundary;
mod frequency_dependent_damping;
mod interface_slip;
mod layer_velocity;
mod pore_pressure;
mod rate_dependence;
mod structure_interaction;

pub use catalogue::{Array, Catalogue, Class, Free, Instance, Parameter, Scale, place};
pub use operator::{Operator, Place};
pub use situation::Situation;

use crate::column::Profile;
use crate::error::{Error, Result};
use crate::registry::{self, Named};
use realfft::num_complex::Complex;

/// Something that acts on the column or on what its sensors record; each effect overrides what it does and no more.
pub trait Effect: Send + Sync {
    /// Edits the set-up of the column.
    fn edit(&self, _profile: &mut Profile, _situation: &Situation) {}

    /// The depth at which `sensor` really sits when it is declared at `depth_m`.
    fn depth_m(&self, _sensor: &str, depth_m: f64) -> f64 {
        depth_m
    }

    /// What the sensor makes of the motion; `None` where it is untouched.
    fn response(&self, _place: &Place<'_>, _frequency_hz: f64) -> Option<Operator> {
        None
    }

    /// Two sensors whose channels are exchanged.
    fn exchange(&self) -> Option<(&str, &str)> {
        None
    }

    /// A further arrival at depth `depth_m`, as a factor on the spectrum of the true base motion.
    fn arrival(&self, _depth_m: f64, _frequency_hz: f64) -> Option<Complex<f64>> {
        None
    }

    /// What the instrument adds to one channel, beside and after its response.
    fn interference(&self, _channel: &Channel<'_>) -> Option<Vec<f64>> {
        None
    }

    /// The same, estimated from the record that carries it.
    fn estimated_interference(&self, _channel: &Channel<'_>) -> Option<Vec<f64>> {
        None
    }
}

/// One history of one sensor.
#[derive(Debug, Clone, Copy)]
pub struct Channel<'a> {
    /// Name of the sensor.
    pub sensor: &'a str,
    /// Name of the component.
    pub component: &'a str,
    /// Name of the event.
    pub event: &'a str,
    /// Time step, s.
    pub dt_s: f64,
    /// Acceleration, m/s².
    pub acceleration_m_s2: &'a [f64],
}

/// A registered effect.
pub struct Entry {
    /// Name as typed in `[[effects]]` and printed by `flare-pipe list effects`.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// Builds the effect from its table; unknown keys are refused.
    pub build: fn(toml::Table) -> Result<Box<dyn Effect>>,
    /// JSON Schema of that table.
    pub schema: fn() -> schemars::Schema,
    /// What is known about it before any data.
    pub catalogue: Catalogue,
}

impl Named for Entry {
    fn name(&self) -> &'static str {
        self.name
    }
}

/// All effects, by their name in `[[effects]]`.
pub const EFFECTS: &[Entry] = &[
    layer_velocity::ENTRY,
    frequency_dependent_damping::ENTRY,
    pore_pressure::ENTRY,
    interface_slip::ENTRY,
    compliant_base::ENTRY,
    structure_interaction::ENTRY,
    container_boundary::ENTRY,
    rate_dependence::ENTRY,
];

/// The registered effect `kind`.
///
/// # Errors
/// When there is none of this name.
pub fn find(kind: &str) -> Result<&'static Entry> {
    registry::find("effect", EFFECTS, kind)
}

/// Every place of every effect in `array`.
pub fn instances(array: &Array) -> Vec<Instance> {
    EFFECTS.iter().flat_map(|e| (e.catalogue.instances)(array)).collect()
}

/// Builds one `[[effects]]` table.
///
/// # Errors
/// When `kind` is missing or unknown, or a parameter is missing, unknown or out of range.
pub fn build(table: &toml::Table) -> Result<Box<dyn Effect>> {
    let mut table = table.clone();
    match table.remove("kind") {
        Some(toml::Value::String(kind)) => (find(&kind)?.build)(table),
        _ => {
            let names: Vec<&str> = EFFECTS.iter().map(|e| e.name).collect();
            Err(Error::new("an effect needs a `kind`").hint(registry::known(&names, "")).usage())
        }
    }
}

/// Builds every table, in order.
///
/// # Errors
/// As [`build`].
pub fn build_all(tables: &[toml::Table]) -> Result<Vec<Box<dyn Effect>>> {
    tables.iter().enumerate().map(|(i, table)| build(table).map_err(|e| e.at(format!("effect {}", i + 1)))).collect()
}

/// Builds `tables` and edits `profile` by them, in order.
///
/// # Errors
/// As [`build`].
pub fn apply(tables: &[toml::Table], profile: &mut Profile, situation: &Situation) -> Result<()> {
    for effect in build_all(tables)? {
        effect.edit(profile, situation);
    }
    Ok(())
}

/// Checks ranges of a table's numbers: (name, value, lowest, highest, unit).
fn ranges(checks: &[(&str, f64, f64, f64, &str)]) -> Result<()> {
    let mut problems = checks
        .iter()
        .filter(|(_, value, low, high, _)| !(value >= low && value <= high))
        .map(|(name, value, low, high, unit)| {
            let unit = if unit.is_empty() { String::new() } else { format!(" {unit}") };
            format!("`{name}` must be in {low}…{high}{unit}, got {value}")
        })
        .peekable();
    if problems.peek().is_none() {
        return Ok(());
    }
    Err(Error::new(problems.collect::<Vec<_>>().join("; ")).usage())
}
