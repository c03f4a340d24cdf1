//! How a report came about: what may differ between two runs of the same manifest, and is therefore put into the page where it is
//! published.

use super::number;
use maud::{Markup, html};

/// Where it goes in a page.
pub(super) const PLACE: &str = r#"<div id="execution"></div>"#;

/// How the results of a site were computed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Execution {
    /// The command, as it was typed.
    pub command: String,
    /// Commit of the folder of the manifest, if it is under version control.
    pub commit: Option<String>,
    /// Its stages, whenever they were computed.
    pub stages: Vec<ExecutedStage>,
    /// Files from outside with their hashes.
    pub files: Vec<(String, String)>,
}

/// The computation of one stage.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ExecutedStage {
    /// Its name.
    pub stage: String,
    /// When it was done, in words.
    pub date: String,
    /// Name of the machine; empty where it is not known.
    pub host: String,
    /// How long it took, s of wall time.
    pub duration_s: f64,
}

/// The page of a report with how it came about.
pub fn executed(page: &str, execution: &Execution) -> String {
    page.replacen(PLACE, &shown(execution).into_string(), 1)
}

fn shown(execution: &Execution) -> Markup {
    let total_s: f64 = execution.stages.iter().map(|s| s.duration_s).sum();
    html! {
        h3 { "How it was run" }
        dl.facts {
            dt { "Command" } dd { code { (execution.command) } }
            @if let Some(commit) = &execution.commit { dt { "Commit of the manifest's folder" } dd { code { (commit) } } }
        }
        @if !execution.stages.is_empty() {
            div.scroll { table {
                caption { "When, where and how long each stage was computed; what was cached is of an earlier run." }
                thead { tr { th scope="col" { "Stage" } th scope="col" { "Done" } th scope="col" { "Host" } th.n scope="col" { "Duration" } } }
                tbody { @for stage in &execution.stages {
                    tr { td { (stage.stage) } td { (stage.date) } td { (stage.host) } td.n { (number::duration(stage.duration_s)) } }
                } }
                tfoot { tr { th scope="row" { "Sum" } td {} td {} td.n { (number::duration(total_s)) } } }
            } }
        }
        @if !execution.files.is_empty() {
            details {
                summary { "Record files and their hashes (" (execution.files.len()) ")" }
                div.scroll { table {
                    thead { tr { th scope="col" { "File" } th scope="col" { "BLAKE3" } } }
                    tbody { @for (name, hash) in &execution.files { tr { td { (name) } td { code { (hash) } } } } }
                } }
            }
        }
    }
}
