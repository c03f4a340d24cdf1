//! Two source models of one site: what prior calibration of the simulations is worth on held-out events.

use maud::{Markup, html};

use super::content::{Content, Pair};
use super::figure::Section;
use super::number;

/// The section, if two source models were compared.
pub(super) fn section(content: &Content) -> Option<Section> {
    let study = content.study.as_ref()?;
    let [own, other] = &study.sources;
    let body = html! {
        p { "Two source models of the same site go through the same three stages and are calibrated on the same records. If the "
            "held-out accuracy of FLARE-T differs less than that of the finite elements, the records have made up for part of "
            "what the simulations lack." }
        div.scroll { table {
            thead {
                tr { th scope="col" { } th scope="col" { } th.n scope="col" colspan="2" { (own) } th.n scope="col" colspan="2" { (other) } }
                tr { th scope="col" { "Event" } th scope="col" { "Component" } @for _ in 0..2 { th.n scope="col" { "R² FE" } th.n scope="col" { "R² FLARE-T" } } }
            }
            tbody {
                @for row in &study.rows {
                    tr { td { (row.event) } td { (row.component) } (cells(&row.r2, 3)) }
                }
                tr { td { b { "Median" } } td { } (cells(&study.median_r2, 3)) }
                tr { td { b { "Median NRMSE (%)" } } td { } (cells(&study.median_nrmse_percent, 1)) }
            }
        } }
    };
    Some(Section { id: "source-study", title: "Two source models".into(), entries: Vec::new(), body })
}

fn cells(pairs: &[Pair; 2], digits: usize) -> Markup {
    html! {
        @for pair in pairs {
            td.n { (number::optional(pair.fe, digits)) }
            td.n { b { (number::optional(pair.flare_t, digits)) } }
        }
    }
}
