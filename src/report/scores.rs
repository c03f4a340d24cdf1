//! The table of errors on the held-out events.

use std::cmp::Ordering;

use maud::{Markup, html};

use super::content::{Content, Pair, Score};
use super::figure::Section;
use super::number;

/// Whether FLARE-T does better (`Less`), as well (`Equal`) or worse (`Greater`) than FE; nothing where one is missing.
pub(super) fn compare(pair: Pair, higher_is_better: bool) -> Option<Ordering> {
    let (fe, flare_t) = (pair.fe.filter(|v| v.is_finite())?, pair.flare_t.filter(|v| v.is_finite())?);
    let order = flare_t.total_cmp(&fe);
    Some(if higher_is_better { order.reverse() } else { order })
}

/// The section, if there are scores.
pub(super) fn section(content: &Content) -> Option<Section> {
    if content.scores.is_empty() {
        return None;
    }
    let body = html! {
        div.scroll {
            table.scores {
                caption { "Bold with a triangle ▸ marks the better of the two models. NRMSE and PSA error: lower is better; R²: higher. "
                    "The ceiling is what a filter fitted to the training events reaches, or nothing where that is better: what is left above "
                    "zero there differs from event to event, and no model that is the same in all of them removes it. PSA error is the root-mean-square difference of ln PSA over the periods of the spectra, at 5 % damping." }
                thead {
                    tr { th scope="col" rowspan="2" { "Event" } th scope="col" rowspan="2" { "Component" } th scope="col" rowspan="2" { "Sensor" }
                         th.g scope="col" colspan="3" { "NRMSE (%)" } th.g scope="col" colspan="2" { "R² (–)" } th.g scope="col" colspan="2" { "PSA error (ln)" } }
                    tr { @for k in 0..3 { th.n.g scope="col" { "FE" } th.n scope="col" { "FLARE-T" } @if k == 0 { th.n scope="col" { "Ceiling" } } } }
                }
                tbody {
                    @for (i, score) in content.scores.iter().enumerate() {
                        (row(score, i > 0 && content.scores[i - 1].event != score.event))
                    }
                }
                tfoot { (medians(&content.scores)) }
            }
        }
    };
    Some(Section { id: "scores", title: "Errors on held-out events".into(), entries: Vec::new(), body })
}

fn row(score: &Score, new_event: bool) -> Markup {
    html! {
        tr.new[new_event] {
            td { (score.event) } td { (score.component) } td { (score.sensor) }
            (cells(score.nrmse_percent, 1, false)) (ceiling(score.ceiling_nrmse_percent)) (cells(score.r2, 3, true)) (cells(score.psa_ln_rmse, 3, false))
        }
    }
}

fn medians(scores: &[Score]) -> Markup {
    let of = |pick: fn(&Score) -> Pair| median_pair(scores, pick);
    html! {
        tr {
            th colspan="3" { "Median" }
            (cells(of(|s| s.nrmse_percent), 1, false)) (ceiling(median_ceiling(scores))) (cells(of(|s| s.r2), 3, true)) (cells(of(|s| s.psa_ln_rmse), 3, false))
        }
    }
}

/// Median of the ceilings, %.
pub(super) fn median_ceiling(scores: &[Score]) -> Option<f64> {
    number::median(scores.iter().filter_map(|s| s.ceiling_nrmse_percent))
}

fn ceiling(percent: Option<f64>) -> Markup {
    html! { td.n { (number::optional(percent, 1)) } }
}

/// Medians over the rows where both models have a value.
pub(super) fn median_pair(scores: &[Score], pick: fn(&Score) -> Pair) -> Pair {
    let both: Vec<Pair> = scores.iter().map(pick).filter(|p| compare(*p, false).is_some()).collect();
    Pair {
        fe: number::median(both.iter().filter_map(|p| p.fe)),
        flare_t: number::median(both.iter().filter_map(|p| p.flare_t)),
    }
}

fn cells(pair: Pair, digits: usize, higher_is_better: bool) -> Markup {
    let order = compare(pair, higher_is_better);
    let cell = |value: Option<f64>, better: bool| {
        html! { @if better { "▸ " b { (number::optional(value, digits)) } } @else { (number::optional(value, digits)) } }
    };
    html! {
        td.n.g { (cell(pair.fe, order == Some(Ordering::Greater))) }
        td.n { (cell(pair.flare_t, order == Some(Ordering::Less))) }
    }
}
