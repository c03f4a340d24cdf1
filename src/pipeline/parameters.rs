//! From a manifest to the parameters of one stage: the sections it reads, as a table and as dotted leaves.

use std::collections::BTreeMap;
use toml::{Table, Value};

/// Dotted leaf → value: `calibrate.penalty` → `0.1`, `site.layer[3].vs_m_s` → `142.4`.
pub(super) type Leaves = BTreeMap<String, Value>;

/// The part of `manifest` under the dotted `sections` (`"*"`: all of it).
pub(super) fn select(manifest: &Table, sections: &[&str]) -> Table {
    if sections.contains(&"*") {
        return manifest.clone();
    }
    let mut selected = Table::new();
    for section in sections {
        let path: Vec<&str> = section.split('.').collect();
        if let Some(value) = lookup(manifest, section) {
            insert(&mut selected, &path, value.clone());
        }
    }
    selected
}

/// The value at a dotted name.
pub(super) fn lookup<'a>(table: &'a Table, dotted: &str) -> Option<&'a Value> {
    let mut names = dotted.split('.');
    let mut value = table.get(names.next()?)?;
    for name in names {
        value = value.as_table()?.get(name)?;
    }
    Some(value)
}

fn insert(table: &mut Table, path: &[&str], value: Value) {
    let [name, rest @ ..] = path else { return };
    if rest.is_empty() {
        table.insert((*name).to_string(), value);
        return;
    }
    let inner = table.entry(*name).or_insert_with(|| Value::Table(Table::new()));
    if let Value::Table(inner) = inner {
        insert(inner, rest, value);
    }
}

/// All leaves of `table`, less those under the `unkeyed` names.
pub(super) fn leaves(table: &Table, unkeyed: &[&str]) -> Leaves {
    let mut leaves = Leaves::new();
    for (name, value) in table {
        flatten(name, value, &mut leaves);
    }
    leaves.retain(|leaf, _| !unkeyed.iter().any(|name| is_under(leaf, name)));
    leaves
}

fn is_under(leaf: &str, name: &str) -> bool {
    leaf.strip_prefix(name).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
}

fn flatten(name: &str, value: &Value, leaves: &mut Leaves) {
    match value {
        Value::Table(table) if !table.is_empty() => {
            for (inner, value) in table {
                flatten(&format!("{name}.{inner}"), value, leaves);
            }
        }
        Value::Array(array) if !array.is_empty() && array.iter().all(Value::is_table) => {
            for (number, value) in array.iter().enumerate() {
                flatten(&format!("{name}[{}]", number + 1), value, leaves);
            }
        }
        leaf => {
            leaves.insert(name.to_string(), leaf.clone());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest() -> Table {
        toml::from_str(
            "name = 'x'\n[site]\ndepth_m = 2.0\n[[site.layer]]\nvs_m_s = 100.0\n[[site.layer]]\nvs_m_s = 200.0\n\
             [records]\ndir = 'a'\ntrain = ['1', '2']\n[empty]\n",
        )
        .expect("the text is TOML")
    }

    #[test]
    fn a_stage_sees_only_the_sections_it_reads() {
        let selected = select(&manifest(), &["site", "records.train", "absent"]);
        assert_eq!(selected.keys().collect::<Vec<_>>(), ["site", "records"]);
        assert!(lookup(&selected, "records.dir").is_none());
        assert_eq!(select(&manifest(), &["*"]), manifest());
    }

    #[test]
    fn leaves_name_layers_by_number_and_keep_lists_and_empty_tables_whole() {
        let names: Vec<String> = leaves(&manifest(), &["records.dir", "nam"]).into_keys().collect();
        assert_eq!(
            names,
            ["empty", "name", "records.train", "site.depth_m", "site.layer[1].vs_m_s", "site.layer[2].vs_m_s"]
        );
    }
}
