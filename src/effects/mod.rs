//! Effects a declared site model may lack: one effect a file, registered in [`EFFECTS`].
//!
//! An effect edits the set-up of the column. One definition serves twin truths and corrected manifests; an effect of
//! zero strength leaves the column bit-identical.

mod frequency_dependent_damping;
mod layer_velocity;

use crate::column::Profile;
use crate::error::{Error, Result};
use crate::registry::{self, Entry};

/// Something that acts on the column.
pub trait Effect: Send + Sync {
    /// Edits the set-up of the column.
    fn apply(&self, profile: &mut Profile);
}

/// All effects, by their name in `[[effects]]`.
pub const EFFECTS: &[Entry<dyn Effect>] = &[layer_velocity::ENTRY, frequency_dependent_damping::ENTRY];

/// Builds one `[[effects]]` table.
///
/// # Errors
/// When `kind` is missing or unknown, or a parameter is missing, unknown or out of range.
pub fn build(table: &toml::Table) -> Result<Box<dyn Effect>> {
    let mut table = table.clone();
    match table.remove("kind") {
        Some(toml::Value::String(kind)) => (registry::find("effect", EFFECTS, &kind)?.build)(table),
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

/// Builds and applies `tables` in order.
///
/// # Errors
/// As [`build`].
pub fn apply(tables: &[toml::Table], profile: &mut Profile) -> Result<()> {
    for effect in build_all(tables)? {
        effect.apply(profile);
    }
    Ok(())
}
