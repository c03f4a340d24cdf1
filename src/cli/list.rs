//! `flare-pipe list`: what a manifest can name, with parameters, units, ranges and priors.

use super::names::Names;
use super::output::{data, write_json};
use crate::effects::{self, EFFECTS};
use crate::error::Result;
use crate::pipeline::Recipe;
use crate::records::{ANY, FORMATS};
use crate::registry;
use crate::soil::LAWS;
use crate::stages::{PIPELINES, STAGES};
use clap::{Args, ValueEnum};
use serde::Serialize;

/// What to list.
#[derive(Debug, Args)]
pub struct ListArguments {
    /// What to list
    what: What,
    /// Only this one, with its parameters
    #[arg(value_parser = Names::Listed, hide_possible_values = true)]
    name: Option<String>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum What {
    /// Constitutive laws
    Laws,
    /// Effects a site model may lack
    Effects,
    /// Formats of record files
    Formats,
    /// Stages of a pipeline
    Stages,
    /// Pipelines that come with the program
    Pipelines,
}

/// Something that a manifest can name.
#[derive(Debug, Serialize)]
struct Named {
    name: &'static str,
    about: String,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    parameters: Vec<Parameter>,
}

/// A parameter of it.
#[derive(Debug, Serialize)]
struct Parameter {
    name: String,
    about: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    unit: Option<&'static str>,
    /// Smallest and largest plausible value.
    #[serde(skip_serializing_if = "Option::is_none")]
    range: Option<[f64; 2]>,
    /// Prior of its strength, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    prior: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    default: Option<serde_json::Value>,
}

/// Prints one line an entry: name and what it is; with a name, or as JSON, parameters too.
///
/// # Errors
/// When there is no such name, or stdout cannot be written.
pub fn list(arguments: &ListArguments, json: bool) -> Result<()> {
    let mut all = match arguments.what {
        What::Laws => LAWS.iter().map(|e| of_schema(e.name, e.about, &(e.schema)())).collect(),
        What::Effects => EFFECTS.iter().map(effect).collect(),
        What::Formats => FORMATS
            .iter()
            .map(|e| of_schema(e.name, e.about, &(e.schema)()))
            .chain([
                plain(ANY, "all of these, each file told by its content"),
                plain("twin", "synthetic records of a truth the manifest does not declare"),
            ])
            .collect(),
        What::Stages => STAGES.iter().map(|s| plain(s.kind(), s.about())).collect(),
        What::Pipelines => {
            let about = |text: &str| Recipe::parse(text, "built in").map(|recipe| recipe.about);
            PIPELINES.iter().map(|p| Ok(plain(p.name, &about(p.text)?))).collect::<Result<Vec<_>>>()?
        }
    };
    if let Some(name) = &arguments.name {
        let names: Vec<&str> = all.iter().map(|n| n.name).collect();
        let unknown = || {
            let what = format!("there is no `{name}` among these");
            crate::Error::new(what).hint(registry::known(&names, name)).usage()
        };
        let index = names.iter().position(|n| n == name).ok_or_else(unknown)?;
        all = vec![all.swap_remove(index)];
    }
    if json {
        return write_json(&all);
    }
    let width = all.iter().map(|n| n.name.len()).max().unwrap_or(0);
    for Named { name, about, parameters } in &all {
        data!("{name:width$}  {about}")?;
        if arguments.name.is_some() {
            parameters.iter().try_for_each(line)?;
        }
    }
    Ok(())
}

fn line(parameter: &Parameter) -> Result<()> {
    let Parameter { name, about, unit, range, prior, default } = parameter;
    let unit = unit.map_or(String::new(), |unit| format!(" {unit}"));
    let parts = [
        range.map(|[low, high]| format!("{low}…{high}{unit}")),
        prior.as_ref().map(|prior| format!("prior {prior}")),
        default.as_ref().map(|default| format!("default {default}")),
        Some(about.clone()).filter(|about| !about.is_empty()),
    ];
    data!("  {name:24}  {}", parts.into_iter().flatten().collect::<Vec<_>>().join("; "))
}

fn plain(name: &'static str, about: &str) -> Named {
    Named { name, about: about.into(), parameters: Vec::new() }
}

/// Parameters by the schema of a table.
fn of_schema(name: &'static str, about: &str, schema: &schemars::Schema) -> Named {
    let properties = schema.get("properties").and_then(serde_json::Value::as_object);
    let parameter = |(name, of): (&String, &serde_json::Value)| Parameter {
        name: name.clone(),
        about: of
            .get("description")
            .and_then(serde_json::Value::as_str)
            .unwrap_or_default()
            .trim_end_matches('.')
            .into(),
        unit: None,
        range: None,
        prior: None,
        default: of.get("default").filter(|v| !v.is_null()).cloned(),
    };
    Named { parameters: properties.into_iter().flatten().map(parameter).collect(), ..plain(name, about) }
}

/// Parameters by the schema, with range and prior of those that a diagnosis finds.
fn effect(entry: &effects::Entry) -> Named {
    let mut named = of_schema(entry.name, entry.about, &(entry.schema)());
    for found in entry.catalogue.parameters {
        let Some(own) = named.parameters.iter_mut().find(|p| p.name == found.name) else { continue };
        own.unit = Some(found.unit).filter(|unit| !unit.is_empty());
        own.range = Some([found.low, found.high]);
        own.prior = Some(found.prior());
    }
    named
}
