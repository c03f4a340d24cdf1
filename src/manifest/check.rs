//! Range checks of the profile and checks across sections.

use super::{Problem, Site, SiteSection, schema};
use crate::ranges::Ranged as _;
use crate::registry;
use crate::{column, effects, soil};
use std::collections::BTreeMap;

/// Every problem that needs more than one section, and the sections' own range checks.
pub fn across(site: &Site, problems: &mut Vec<Problem>) {
    name(site, problems);
    profile_ranges(&site.site, problems);
    laws(site, problems);
    sensors(site, problems);
    let sections = [
        ("motions", site.motions.problems()),
        ("analysis", site.analysis.problems()),
        ("pretrain", site.pretrain.problems()),
        ("distill", site.distill.beyond()),
        ("calibrate", site.calibrate.problems()),
        ("diagnose", site.diagnose.problems()),
        ("randomisation", site.randomisation.as_ref().map(|r| r.beyond()).unwrap_or_default()),
        ("training", site.training.beyond()),
        ("executor.slurm", site.executor.slurm.beyond()),
        ("records", site.records.as_ref().map(|r| r.problems()).unwrap_or_default()),
    ];
    for (section, found) in sections {
        problems.extend(found.into_iter().map(|(key, what)| named_problem(format!("{section}.{key}"), &what)));
    }
    if site.pretrain.channels > site.site.elements {
        problems.push(Problem::new(
            "pretrain.channels",
            format!(
                "`channels` must be at most `site.elements` = {}, got {}",
                site.site.elements, site.pretrain.channels
            ),
        ));
    }
    tolerances(site, problems);
    for (i, table) in site.effects.iter().enumerate() {
        let key = format!("effects[{}]", i + 1);
        let kind = table.get("kind").and_then(toml::Value::as_str).unwrap_or_default();
        let own: toml::Table =
            table.iter().filter(|(name, _)| *name != "kind").map(|(n, v)| (n.clone(), v.clone())).collect();
        let structure =
            effects::find(kind).map_or_else(|_| Vec::new(), |e| schema::compare_with((e.schema)(), &own, &key));
        if structure.is_empty()
            && let Err(error) = effects::build(table)
        {
            problems.push(from_error(place_in(&key, table, &error), &error));
        }
        problems.extend(structure);
    }
    let components = site.records.as_ref().map(|r| r.components.clone()).unwrap_or_default();
    if problems.is_empty()
        && let Err(error) = site.column().array(&components).and_then(|a| effects::check(&site.effects, &a))
    {
        problems.push(from_error("effects".into(), &error));
    }
    if problems.is_empty()
        && let Err(error) = site.column().profile().and_then(|p| column::Column::new(&p, &site.analysis).map(|_| ()))
    {
        problems.push(from_error("site".into(), &error));
    }
}

/// A problem whose text begins with the name of its key.
pub(super) fn named_problem(key: String, what: &str) -> Problem {
    let name = key.rsplit('.').next().unwrap_or(&key);
    let what = if what.starts_with("must") { format!("`{name}` {what}") } else { what.into() };
    Problem::new(key, what)
}

/// The key of `table` that an error begins with, below `key`; `key` itself where it is none.
fn place_in(key: &str, table: &toml::Table, error: &crate::Error) -> String {
    match error.what().split('`').nth(1).filter(|name| table.contains_key(*name)) {
        Some(name) => format!("{key}.{name}"),
        None => key.into(),
    }
}

fn from_error(key: String, error: &crate::Error) -> Problem {
    let problem = Problem::new(key, error.what());
    match error.hint_text() {
        Some(hint) => problem.hint(hint),
        None => problem,
    }
}

/// Longest name of a site: files are named by it, and a name of a file has 255 bytes at the most.
pub const LONGEST_NAME: usize = 100;

/// Whether `name` may be that of a site: some lower-case letters, digits and hyphens.
pub fn is_site_name(name: &str) -> bool {
    (1..=LONGEST_NAME).contains(&name.len())
        && name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-')
}

fn name(site: &Site, problems: &mut Vec<Problem>) {
    if !is_site_name(&site.name) {
        let what =
            format!("`name` must be 1…{LONGEST_NAME} lower-case letters, digits and hyphens, got `{}`", site.name);
        problems.push(Problem::new("name", what).hint("it names the run folder: `lotung`, `fksh11-ns`"));
    }
}

/// Range checks of `[site]` and its layers: the column's own, and whether the layers make up the depth.
pub fn profile_ranges(site: &SiteSection, problems: &mut Vec<Problem>) {
    // Whether the laws exist is another question.
    let Ok(profile) = site.column(|layer| Ok((layer.law.clone(), toml::Table::new()))) else { return };
    problems.extend(profile.problems().into_iter().map(|(key, what)| named_problem(format!("site.{key}"), &what)));
    if !is_depth(site.depth_m) {
        let what = format!("`depth_m` must be above 0 m, got {}", site.depth_m);
        problems
            .push(Problem::new("site.depth_m", what).hint("the base of the column is the depth of the input sensor"));
        return;
    }
    let total = profile.depth_m();
    if !site.layer.is_empty() && (total - site.depth_m).abs() > 1e-3 {
        let what = format!("the layers add up to {total:.4} m, but `site.depth_m` = {} m", site.depth_m);
        problems
            .push(Problem::new("site.depth_m", what).hint("the base of the column is the depth of the input sensor"));
    }
}

/// Whether a column may be so deep.
fn is_depth(depth_m: f64) -> bool {
    depth_m > 0.0 && depth_m.is_finite()
}

fn laws(site: &Site, problems: &mut Vec<Problem>) {
    let kinds: Vec<&str> = soil::LAWS.iter().map(|e| e.name).collect();
    let names: Vec<&str> = site.law.keys().map(String::as_str).collect();
    for (name, table) in &site.law {
        match table.get("kind").and_then(toml::Value::as_str) {
            None => problems.push(
                Problem::new(format!("law.{name}"), format!("law `{name}` has no `kind`"))
                    .hint(registry::known(&kinds, "")),
            ),
            Some(kind) if !kinds.contains(&kind) => problems.push(
                Problem::new(format!("law.{name}.kind"), format!("unknown soil law `{kind}`"))
                    .hint(registry::known(&kinds, kind)),
            ),
            Some(_) => {}
        }
    }
    let column = site.column();
    for (i, layer) in site.site.layer.iter().enumerate() {
        let place = format!("site.layer[{}]", i + 1);
        match site.law.get(&layer.law) {
            None => problems.push(
                Problem::new(format!("{place}.law"), format!("there is no `[law.{}]`", layer.law))
                    .hint(registry::known(&names, &layer.law)),
            ),
            Some(_) => {
                if let Ok((kind, table)) = column.layer_law(layer)
                    && let Ok(entry) = registry::find("soil law", soil::LAWS, &kind)
                {
                    let law = format!("law.{}", layer.law);
                    let mut found = schema::compare_with((entry.schema)(), &table, &law);
                    if found.is_empty()
                        && let Err(error) = (entry.build)(table.clone())
                    {
                        found.push(from_error(place_in(&law, &table, &error), &error));
                    }
                    // What is wrong with the law itself is said once, not for every layer that uses it.
                    problems.extend(found.into_iter().map(|problem| {
                        let name = problem.key.rsplit('.').next().unwrap_or_default();
                        let is_own = layer.parameters.contains_key(name);
                        if is_own { Problem { key: format!("{place}.{name}"), ..problem } } else { problem }
                    }));
                }
            }
        }
    }
}

fn sensors(site: &Site, problems: &mut Vec<Problem>) {
    if site.sensors.output.is_empty() {
        problems.push(Problem::new("sensors.output", "there is no output sensor").hint("add `[[sensors.output]]`"));
    }
    let mut seen: BTreeMap<&str, usize> = BTreeMap::from([(site.sensors.input.as_str(), 0)]);
    for (i, sensor) in site.sensors.output.iter().enumerate() {
        if seen.insert(&sensor.name, i).is_some() {
            problems.push(Problem::new(
                format!("sensors.output[{}].name", i + 1),
                format!("two sensors are named `{}`", sensor.name),
            ));
        }
        if is_depth(site.site.depth_m) && !(0.0..site.site.depth_m).contains(&sensor.depth_m) {
            let what =
                format!("`depth_m` must lie in 0…{} m, above the base, got {}", site.site.depth_m, sensor.depth_m);
            problems.push(Problem::new(format!("sensors.output[{}].depth_m", i + 1), what));
        }
    }
}

fn tolerances(site: &Site, problems: &mut Vec<Problem>) {
    let t = &site.tolerances;
    let values = [
        ("vs_ln", t.vs_ln, 0.5),
        ("boundary_m", t.boundary_m, 10.0),
        ("damping_ln", t.damping_ln, 2.0),
        ("gain_ln", t.gain_ln, 1.0),
        ("clock_s", t.clock_s, 1.0),
        ("orientation_deg", t.orientation_deg, 90.0),
        ("depth_m", t.depth_m, 10.0),
        ("model", t.model, 1.0),
    ];
    for (name, value, highest) in values {
        if !(0.0..=highest).contains(&value) {
            problems.push(Problem::new(
                format!("tolerances.{name}"),
                format!("`{name}` must be in 0…{highest}, got {value}"),
            ));
        }
    }
}
