//! `flare-pipe schema`: JSON Schemas of the files that people write, laws and effects included, for editors.

use super::output::write_json;
use crate::effects::EFFECTS;
use crate::error::Result;
use crate::manifest;
use crate::pipeline::Recipe;
use crate::ranges;
use crate::records::Noise;
use crate::soil::LAWS;
use crate::twin::{Matrix, Truth};
use clap::ValueEnum;
use serde_json::{Value, json};

/// A kind of file.
#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
pub enum SchemaOf {
    /// The manifest of a site
    Site,
    /// What holds at a twin
    Truth,
    /// Twins to be drawn
    Matrix,
    /// The stages of a pipeline
    Pipeline,
}

/// Prints the schema of a kind of file.
///
/// # Errors
/// When it cannot be written as JSON.
pub fn schema(of: SchemaOf) -> Result<()> {
    let mut schema = match of {
        SchemaOf::Site => manifest::schema(),
        SchemaOf::Truth => schemars::schema_for!(Truth),
        SchemaOf::Matrix => schemars::schema_for!(Matrix),
        SchemaOf::Pipeline => schemars::schema_for!(Recipe),
    }
    .to_value();
    if of == SchemaOf::Truth {
        ranges::describe::<Noise>(&mut schema, "Noise");
    }
    if of == SchemaOf::Site {
        let laws = LAWS.iter().map(|entry| of_kind(entry.name, (entry.schema)(), false));
        // What a law lacks may be said of each layer that follows it.
        schema["properties"]["law"]["additionalProperties"] = json!({ "oneOf": laws.collect::<Vec<_>>() });
    }
    if matches!(of, SchemaOf::Site | SchemaOf::Truth) {
        let effects = EFFECTS.iter().map(|entry| {
            let mut schema = of_kind(entry.name, (entry.schema)(), true);
            let parameters = entry.catalogue.parameters.iter().filter(|parameter| !parameter.unit.is_empty());
            parameters.for_each(|p| schema["properties"][p.name][ranges::UNIT] = p.unit.into());
            schema
        });
        schema["properties"]["effects"]["items"] = json!({ "oneOf": effects.collect::<Vec<_>>() });
    }
    if of == SchemaOf::Truth {
        // What one truth does not say may be said by another that it is like.
        let needed = schema["required"].take();
        schema["anyOf"] = json!([{ "required": ["like"] }, { "required": needed }]);
        schema.as_object_mut().map(|table| table.remove("required"));
    }
    write_json(&schema)
}

/// The schema of a table with `kind` besides.
fn of_kind(kind: &str, schema: schemars::Schema, is_whole: bool) -> Value {
    let mut schema = schema.to_value();
    schema["properties"]["kind"] = json!({ "const": kind });
    let own = schema["required"].as_array().cloned().unwrap_or_default();
    let required = own.into_iter().filter(|_| is_whole).chain([json!("kind")]);
    schema["required"] = required.collect();
    if let Some(table) = schema.as_object_mut() {
        table.remove("$schema");
    }
    schema
}
