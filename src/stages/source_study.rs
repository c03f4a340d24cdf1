//! Held-out accuracy of two source models of one site side by side, and `study.json`.

use super::artifact::{read_json, write_json};
use super::evaluate::{self, Both, Evaluation};
use super::other_source;
use crate::error::Result;
use crate::metrics::median;
use crate::pipeline::{Stage, Task};
use crate::records::Split;
use crate::report::content::{Pair, Study, StudyRow};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Compares two source models.
pub struct SourceStudy;

const FILE: &str = "study.json";

/// `study.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Names of the two source models: that of the site, then the other.
    pub sources: [String; 2],
    /// One for each held-out event and component.
    pub held_out: Vec<Row>,
    /// Median over them of the pooled R², in the order of the sources.
    pub median_r2: [Both; 2],
    /// Median NRMSE over all held-out events, components and sensors (%), in the order of the sources.
    pub median_nrmse_percent: [Both; 2],
}

/// One held-out event and component.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// R² over all sensors, in the order of the sources.
    pub r2: [Both; 2],
}

impl Stage for SourceStudy {
    fn kind(&self) -> &'static str {
        "source-study"
    }

    fn about(&self) -> &'static str {
        "held-out accuracy with two source models side by side: study.json"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        &["name"]
    }

    fn publishes(&self) -> &'static [&'static str] {
        &[FILE]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let sources = [task.section("name")?, other_source::name(task.input("source")?)?];
        let both = [evaluate::read(task.input("own")?)?.0, evaluate::read(task.input("other")?)?.0];
        write_json(&task.output_dir().join(FILE), &Found::new(sources, &both))
    }
}

impl Found {
    fn new(sources: [String; 2], both: &[Evaluation; 2]) -> Self {
        let held_out: Vec<Row> = both[0]
            .pooled
            .iter()
            .filter(|p| p.split == Split::Test)
            .map(|p| {
                let r2 = both.each_ref().map(|evaluation| {
                    let same = |q: &&evaluate::Pooled| q.event == p.event && q.component == p.component;
                    evaluation.pooled.iter().find(same).map_or(Both { fe: None, flare_t: None }, |q| q.r2)
                });
                Row { event: p.event.clone(), component: p.component.clone(), r2 }
            })
            .collect();
        let median_r2 = [0, 1].map(|i| medians(held_out.iter().map(|row| row.r2[i])));
        let errors = |evaluation: &Evaluation| {
            medians(evaluation.scores.iter().filter(|s| s.split == Split::Test).map(|s| s.nrmse_percent))
        };
        let median_nrmse_percent = both.each_ref().map(errors);
        Self { sources, held_out, median_r2, median_nrmse_percent }
    }
}

fn medians(list: impl Iterator<Item = Both> + Clone) -> Both {
    let of = |values: Vec<f64>| (!values.is_empty()).then(|| median(&values));
    Both { fe: of(list.clone().filter_map(|b| b.fe).collect()), flare_t: of(list.filter_map(|b| b.flare_t).collect()) }
}

/// The report's section, where the pipeline compares source models.
///
/// # Errors
/// When `study.json` cannot be read.
pub fn content(task: &Task<'_>) -> Result<Option<Study>> {
    if !task.has_input("study") {
        return Ok(None);
    }
    let found = read(task.input("study")?)?;
    let pair = |both: Both| Pair { fe: both.fe, flare_t: both.flare_t };
    let row = |row: Row| StudyRow { event: row.event, component: row.component, r2: row.r2.map(pair) };
    Ok(Some(Study {
        sources: found.sources,
        rows: found.held_out.into_iter().map(row).collect(),
        median_r2: found.median_r2.map(pair),
        median_nrmse_percent: found.median_nrmse_percent.map(pair),
    }))
}

fn read(folder: &Path) -> Result<Found> {
    read_json(&folder.join(FILE))
}
