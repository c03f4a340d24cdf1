//! `flare-pipe schema`: the JSON Schema of a site manifest, laws and effects included.

use super::output::write_json;
use crate::effects::EFFECTS;
use crate::error::Result;
use crate::manifest;
use crate::soil::LAWS;
use serde_json::json;

/// Prints the schema; `definitions-by-kind` holds the tables of laws and effects by their `kind`.
///
/// # Errors
/// When it cannot be written as JSON.
pub fn schema() -> Result<()> {
    let mut schema = manifest::schema().to_value();
    let laws: serde_json::Map<_, _> = LAWS.iter().map(|e| (e.name.to_string(), (e.schema)().to_value())).collect();
    let effects: serde_json::Map<_, _> =
        EFFECTS.iter().map(|e| (e.name.to_string(), (e.schema)().to_value())).collect();
    schema["definitions-by-kind"] = json!({ "law": laws, "effect": effects });
    write_json(&schema)
}
