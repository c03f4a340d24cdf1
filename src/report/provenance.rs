//! Where the numbers come from: program, manifest, cached outputs, seeds, and how long everything took.

use maud::{Markup, html};

use super::content::{Content, Provenance, Timing};
use super::figure::Section;
use super::number;

/// The section, if anything is known.
pub(super) fn section(content: &Content) -> Option<Section> {
    let origin = &content.provenance;
    if *origin == Provenance::default() && content.timings.is_empty() {
        return None;
    }
    let body = html! {
        @if !content.timings.is_empty() { (timings(&content.timings)) }
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

fn timings(timings: &[Timing]) -> Markup {
    let total: f64 = timings.iter().map(|t| t.seconds).filter(|s| s.is_finite()).sum();
    let longest = timings.iter().map(|t| t.seconds).filter(|s| s.is_finite()).fold(0.0, f64::max);
    html! {
        h3 { "Time spent" }
        div.scroll {
            table {
                thead { tr { th scope="col" { "Stage" } th.n scope="col" { "Wall clock" } th scope="col" { "" } th scope="col" { "" } } }
                tbody {
                    @for timing in timings {
                        tr {
                            td { (timing.stage) } td.n { (number::duration(timing.seconds)) }
                            td { @if longest > 0.0 && timing.seconds.is_finite() {
                                span.bar style={ "width:" (number::fixed((timing.seconds / longest * 9.0).max(0.05), 2)) "em" } {}
                            } }
                            td.soft { (timing.note) }
                        }
                    }
                }
                tfoot { tr { th { "Sum" } td.n { (number::duration(total)) } td {} td {} } }
            }
        }
    }
}
