//! One page for many sites, or for one with many settings: what to look at first, then everything.

use super::number::{duration, significant};
use super::page::head;
use maud::{DOCTYPE, html};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// One site under one set of settings.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct FleetRow {
    /// What tells it from the others: the name of its site, or its settings.
    pub label: String,
    /// Settings beside those of its manifest, by key.
    pub settings: BTreeMap<String, String>,
    /// Why it could not be run to its end.
    pub error: Option<String>,
    /// The verdict of its diagnosis.
    pub verdict: Option<String>,
    /// What it ends with, sentence by sentence.
    pub answer: Vec<String>,
    /// Its numbers by their place in `loop.json` and `metrics.json`.
    pub numbers: BTreeMap<String, f64>,
    /// What should be looked at, the weightiest first.
    pub attention: Vec<String>,
    /// Stages that were computed this time.
    pub computed: usize,
    /// Wall time of all its stages whenever they ran, s.
    pub stages_s: f64,
    /// Its report, relative to the page; none where there is none.
    pub report: Option<String>,
}

/// Places of all numbers of `rows`, sorted.
fn places(rows: &[FleetRow]) -> Vec<&str> {
    let all: BTreeSet<&str> = rows.iter().flat_map(|row| row.numbers.keys()).map(String::as_str).collect();
    all.into_iter().collect()
}

/// Keys of all settings of `rows`, sorted.
fn keys(rows: &[FleetRow]) -> Vec<&str> {
    let all: BTreeSet<&str> = rows.iter().flat_map(|row| row.settings.keys()).map(String::as_str).collect();
    all.into_iter().collect()
}

/// The table as CSV: a row each, numbers in full.
///
/// # Errors
/// When a text cannot be written.
pub fn fleet_csv(rows: &[FleetRow]) -> Result<Vec<u8>, csv::Error> {
    let (places, keys) = (places(rows), keys(rows));
    let mut writer = csv::Writer::from_writer(Vec::new());
    let ends = ["verdict", "attention", "error", "stages_s"];
    let head = std::iter::once("label").chain(keys.iter().copied()).chain(places.iter().copied()).chain(ends);
    writer.write_record(head)?;
    for row in rows {
        let settings = keys.iter().map(|key| row.settings.get(*key).cloned().unwrap_or_default());
        let numbers = places.iter().map(|place| row.numbers.get(*place).map(f64::to_string).unwrap_or_default());
        let ends = [
            row.verdict.clone().unwrap_or_default(),
            row.attention.join("; "),
            row.error.as_deref().and_then(|error| error.lines().next()).unwrap_or_default().to_string(),
            row.stages_s.to_string(),
        ];
        writer.write_record(std::iter::once(row.label.clone()).chain(settings).chain(numbers).chain(ends))?;
    }
    writer.into_inner().map_err(|e| e.into_error().into())
}

/// The page: what needs attention first, then a table of all.
pub fn fleet_page(title: &str, rows: &[FleetRow]) -> String {
    let mut first: Vec<&FleetRow> =
        rows.iter().filter(|row| row.error.is_some() || !row.attention.is_empty()).collect();
    first.sort_by_key(|row| (row.error.is_none(), std::cmp::Reverse(row.attention.len())));
    let failed = rows.iter().filter(|row| row.error.is_some()).count();
    let (places, keys) = (places(rows), keys(rows));
    let linked = |row: &FleetRow| {
        html! { @match &row.report { Some(report) => a href=(report) { (row.label) }, None => (row.label) } }
    };
    let number = |row: &FleetRow, place: &str| row.numbers.get(place).map_or("–".to_string(), |v| significant(*v));
    html! {
        (DOCTYPE)
        html lang="en" {
            (head(title))
            body.wide {
                main {
                    header { h1 { (title) } p.lead { (rows.len()) " runs, " (failed) " of them failed" } }
                    section {
                        h2 { "What to look at first" }
                        @if first.is_empty() { p { "Nothing: every run came to its end, and none of the answers asks for more." } }
                        ul {
                            @for row in &first {
                                li {
                                    strong { (linked(row)) } ": "
                                    @if let Some(error) = &row.error { (error.lines().next().unwrap_or_default()) "; " }
                                    (row.attention.join("; "))
                                }
                            }
                        }
                    }
                    section {
                        h2 { "All" }
                        div.scroll tabindex="0" {
                            table {
                                thead { tr {
                                    th scope="col" { "run" }
                                    @for key in &keys { th scope="col" { (key) } }
                                    th scope="col" { "verdict" }
                                    @for place in &places { th scope="col" { (place) } }
                                    th scope="col" { "stages" }
                                } }
                                tbody {
                                    @for row in rows {
                                        tr {
                                            th scope="row" { (linked(row)) }
                                            @for key in &keys { td { (row.settings.get(*key).map_or("", String::as_str)) } }
                                            td { @match (&row.error, &row.verdict) {
                                                (Some(_), _) => "failed",
                                                (None, Some(verdict)) => (verdict),
                                                (None, None) => "–",
                                            } }
                                            @for place in &places { td { (number(row, place)) } }
                                            td { (duration(row.stages_s)) }
                                        }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
    .into_string()
}
