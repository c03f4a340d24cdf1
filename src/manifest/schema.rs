//! Structure of a manifest against its JSON Schema: every unknown key, missing key and wrong type, not just the first.

use super::{Problem, Site};
use crate::column::{Analysis, Layer, Rayleigh};
use crate::diagnosis::DiagnoseSettings;
use crate::flare::{CalibrateSettings, DistillSettings, PretrainSettings};
use crate::motion::MotionSettings;
use crate::pipeline::SlurmSettings;
use crate::{ranges, registry};
use serde_json::Value as Json;

/// The JSON Schema of a site manifest, ranges of its numbers included.
pub fn schema() -> schemars::Schema {
    let mut schema = schemars::schema_for!(Site).to_value();
    ranges::describe::<Layer>(&mut schema, "LayerSection");
    ranges::describe::<Rayleigh>(&mut schema, "Rayleigh");
    ranges::describe::<MotionSettings>(&mut schema, "MotionSettings");
    ranges::describe::<Analysis>(&mut schema, "Analysis");
    ranges::describe::<PretrainSettings>(&mut schema, "PretrainSettings");
    ranges::describe::<DistillSettings>(&mut schema, "DistillSettings");
    ranges::describe::<CalibrateSettings>(&mut schema, "CalibrateSettings");
    ranges::describe::<DiagnoseSettings>(&mut schema, "DiagnoseSettings");
    ranges::describe::<SlurmSettings>(&mut schema, "SlurmSettings");
    schemars::Schema::try_from(schema).expect("a schema with ranges is one")
}

/// Every structural difference between `table` and the schema of [`Site`]; ranges are checked where it can be read, with what needs more
/// than one section.
pub fn compare(table: &toml::Table) -> Vec<Problem> {
    compare_with(schemars::schema_for!(Site), table, "")
}

/// Every structural difference between the table at `key` and the `schema` of what it builds.
pub fn compare_with(schema: schemars::Schema, table: &toml::Table, key: &str) -> Vec<Problem> {
    let schema = schema.to_value();
    let mut problems = Vec::new();
    walk(&schema, &schema, &toml::Value::Table(table.clone()), key.to_string(), &mut problems);
    problems
}

fn walk(root: &Json, schema: &Json, value: &toml::Value, key: String, problems: &mut Vec<Problem>) {
    let schema = resolve(root, schema);
    if let Some(options) = schema.get("anyOf").or_else(|| schema.get("oneOf")).and_then(Json::as_array) {
        let options: Vec<&Json> =
            options.iter().filter(|o| o.get("type").and_then(Json::as_str) != Some("null")).collect();
        let attempts: Vec<Vec<Problem>> = options
            .iter()
            .map(|option| {
                let mut found = Vec::new();
                walk(root, option, value, key.clone(), &mut found);
                found
            })
            .collect();
        let constants: Vec<&str> = options.iter().filter_map(|o| o.get("const").and_then(Json::as_str)).collect();
        if constants.len() == options.len() {
            one_of(&constants, value, &key, problems);
        } else if !attempts.iter().any(Vec::is_empty)
            && let Some(closest) = attempts.into_iter().min_by_key(Vec::len)
        {
            problems.extend(closest);
        }
        return;
    }
    if let Some(names) = schema.get("enum").and_then(Json::as_array) {
        let names: Vec<&str> = names.iter().filter_map(Json::as_str).collect();
        one_of(&names, value, &key, problems);
        return;
    }
    if let Some(expected) = expected_type(schema)
        && !fits(&expected, value)
    {
        let article = expected.join(" or ");
        problems
            .push(Problem::new(&key, format!("`{}` must be {article}, got {} `{value}`", last(&key), describe(value))));
        return;
    }
    if let Some(what) = out_of_range(schema, value) {
        problems.push(Problem::new(&key, format!("`{}` must be {what}", last(&key))));
        return;
    }
    match value {
        toml::Value::Table(table) => walk_table(root, schema, table, &key, problems),
        toml::Value::Array(items) => {
            if let Some(item) = schema.get("items") {
                for (i, v) in items.iter().enumerate() {
                    walk(root, item, v, format!("{key}[{}]", i + 1), problems);
                }
            }
        }
        _ => {}
    }
}

fn walk_table(root: &Json, schema: &Json, table: &toml::Table, key: &str, problems: &mut Vec<Problem>) {
    let join = |name: &str| if key.is_empty() { name.to_string() } else { format!("{key}.{name}") };
    let place = if key.is_empty() { "the manifest".to_string() } else { format!("`{key}`") };
    let properties = schema.get("properties").and_then(Json::as_object);
    let known: Vec<&str> = properties.map(|p| p.keys().map(String::as_str).collect()).unwrap_or_default();
    for (name, value) in table {
        match properties.and_then(|p| p.get(name)) {
            Some(child) => walk(root, child, value, join(name), problems),
            None => match schema.get("additionalProperties") {
                Some(Json::Bool(false)) => {
                    let problem = Problem::new(join(name), format!("unknown key `{name}` in {place}"));
                    problems.push(problem.hint(registry::known(&known, name)));
                }
                Some(child @ Json::Object(_)) => walk(root, child, value, join(name), problems),
                _ => {}
            },
        }
    }
    for name in schema.get("required").and_then(Json::as_array).into_iter().flatten().filter_map(Json::as_str) {
        if !table.contains_key(name) {
            let about = properties.and_then(|p| p.get(name)).and_then(|p| p.get("description")).and_then(Json::as_str);
            let mut problem = Problem::new(join(name), format!("{place} lacks the key `{name}`"));
            if let Some(about) = about {
                problem = problem.hint(format!("`{name}`: {}", first_paragraph(about).trim_end_matches('.')));
            }
            problems.push(problem);
        }
    }
}

/// The first paragraph of a description in one line.
fn first_paragraph(text: &str) -> String {
    text.lines().take_while(|line| !line.trim().is_empty()).map(str::trim).collect::<Vec<_>>().join(" ")
}

/// What `value` must be by the range of `schema`, where it is a number beyond it.
fn out_of_range(schema: &Json, value: &toml::Value) -> Option<String> {
    let number = value.as_float().or_else(|| value.as_integer().map(|i| i as f64))?;
    let (ends, unit) = ranges::of_schema(schema);
    ranges::outside(ends, unit, number)
}

fn resolve<'a>(root: &'a Json, schema: &'a Json) -> &'a Json {
    match schema.get("$ref").and_then(Json::as_str).and_then(|r| r.strip_prefix('#')) {
        Some(pointer) => root.pointer(pointer).unwrap_or(schema),
        None => schema,
    }
}

fn one_of(names: &[&str], value: &toml::Value, key: &str, problems: &mut Vec<Problem>) {
    let typed = value.as_str().map_or_else(|| value.to_string(), str::to_string);
    if !names.contains(&typed.as_str()) {
        let problem = Problem::new(key, format!("`{}` has no value `{typed}`", last(key)));
        problems.push(problem.hint(registry::known(names, &typed)));
    }
}

fn last(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}

fn expected_type(schema: &Json) -> Option<Vec<String>> {
    let names: Vec<&str> = match schema.get("type")? {
        Json::String(name) => vec![name],
        Json::Array(names) => names.iter().filter_map(Json::as_str).collect(),
        _ => return None,
    };
    Some(names.into_iter().filter(|n| *n != "null").map(article).collect())
}

fn article(name: &str) -> String {
    match name {
        "integer" => "a whole number",
        "number" => "a number",
        "string" => "a string",
        "boolean" => "`true` or `false`",
        "array" => "a list",
        "object" => "a table",
        other => other,
    }
    .to_string()
}

fn describe(value: &toml::Value) -> &'static str {
    match value {
        toml::Value::String(_) => "the string",
        toml::Value::Integer(_) | toml::Value::Float(_) => "the number",
        toml::Value::Boolean(_) => "the boolean",
        toml::Value::Datetime(_) => "the date",
        toml::Value::Array(_) => "the list",
        toml::Value::Table(_) => "the table",
    }
}

fn fits(expected: &[String], value: &toml::Value) -> bool {
    let names: &[&str] = match value {
        toml::Value::String(_) | toml::Value::Datetime(_) => &["a string"],
        toml::Value::Integer(_) => &["a whole number", "a number"],
        toml::Value::Float(_) => &["a number"],
        toml::Value::Boolean(_) => &["`true` or `false`"],
        toml::Value::Array(_) => &["a list"],
        toml::Value::Table(_) => &["a table"],
    };
    expected.iter().any(|e| names.contains(&e.as_str()))
}
