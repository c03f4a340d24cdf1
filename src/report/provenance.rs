//! Where the numbers come from: program, manifest, cached outputs and seeds.

use maud::{PreEscaped, html};

use super::content::{Content, Provenance};
use super::execution;
use super::figure::Section;

/// The section, if anything is known.
pub(super) fn section(content: &Content) -> Option<Section> {
    let origin = &content.provenance;
    if *origin == Provenance::default() {
        return None;
    }
    let body = html! {
        (PreEscaped(execution::PLACE))
        @if !origin.program.is_empty() { p { "Made by " (origin.program) "." } }
        @if !origin.stages.is_empty() {
            h3 { "Stage outputs" }
            div.scroll {
                table {
                    thead { tr { th scope="col" { "Stage" } th.n scope="col" { "Version" } th scope="col" { "Key" } } }
                    tbody {
                        @for stage in &origin.stages { tr { td { (stage.stage) } td.n { (stage.version) } td { code { (stage.key) } } } }
                    }
                }
            }
        }
        @if !origin.seeds.is_empty() || !origin.facts.is_empty() {
            h3 { "Seeds and sources" }
            dl.facts {
                @for (name, seed) in &origin.seeds { dt { "Seed, " (name) } dd { (seed) } }
                @for (name, value) in &origin.facts { dt { (name) } dd { (value) } }
            }
        }
        @if !origin.manifest.is_empty() {
            h3 { "Manifest" }
            details open { summary { "The manifest as it was run" } pre { code { (origin.manifest) } } }
        }
    };
    Some(Section { id: "provenance", title: "Provenance".into(), entries: Vec::new(), body })
}
