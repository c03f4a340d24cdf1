//! Stage 3: what calibration on records changed in the latent dynamics.

use maud::{Markup, html};

use super::chart::{Axis, Frame};
use super::content::{Calibration, Content};
use super::figure::{Section, color_bar, figure};
use super::heat::{self, Diverging, HeatLook};
use super::{losses, number};

/// Widest drawing of a matrix, and room for the name of a column, px.
const WIDEST_PX: f64 = 850.0;
const LABEL_PX: f64 = 13.0;

/// The section, if at least one component was calibrated.
pub(super) fn section(content: &Content) -> Option<Section> {
    if content.calibrate.is_empty() {
        return None;
    }
    let anchor = |i: usize| format!("stage-3-{}", i + 1);
    let body = html! {
        p { "Only the coefficients of the latent dynamics move, separately for each component, towards the recorded training "
            "events; encoders and decoder are frozen. A small and local change says that the simulated physics was kept." }
        @for (i, stage) in content.calibrate.iter().enumerate() {
            h3 id=(anchor(i)) { "Component " (stage.component) }
            (matrices(stage))
            (changes(stage))
            (losses::losses(stage.losses.as_ref(), &format!("stage 3, component {}", stage.component)))
        }
    };
    let entries = content.calibrate.iter().enumerate().map(|(i, s)| (anchor(i), s.component.clone())).collect();
    Some(Section { id: "stage-3", title: "Stage 3: calibration on records".into(), entries, body })
}

fn matrices(stage: &Calibration) -> Markup {
    let difference: Vec<Vec<f64>> =
        stage.after.iter().zip(&stage.before).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect()).collect();
    let largest =
        |m: &[Vec<f64>]| m.iter().flatten().filter(|v| v.is_finite()).fold(0.0_f64, |top, v| top.max(v.abs()));
    let limit = largest(&stage.before).max(largest(&stage.after));
    let scale = Diverging { limit, power: 0.5 };
    let n_row = stage.before.len();
    let names: Vec<String> = (1..=n_row).rev().map(|i| format!("ż{}", subscript(i))).collect();
    let picture = |matrix: &[Vec<f64>], what: &str, with_terms: bool| {
        let n_column = stage.terms.len() as f64;
        let rows: Vec<Vec<f64>> = matrix.iter().rev().cloned().collect();
        let frame = Frame {
            size: (
                (n_column * 9.0).clamp(400.0, WIDEST_PX) + 74.0,
                n_row as f64 * 14.0 + if with_terms { 56.0 } else { 20.0 },
            ),
            x: Axis { label: "", range: (0.5, n_column + 0.5), log: false },
            y: Axis { label: "", range: (0.5, n_row as f64 + 0.5), log: false },
            alt: format!("{what}, {n_row} equations by {} library terms", stage.terms.len()),
        };
        // Of many terms every so many is named, or the names would be a black band.
        let every = (n_column * LABEL_PX / WIDEST_PX).ceil().max(1.0) as usize;
        let named = |(i, term): (usize, &String)| if i % every == 0 { term.clone() } else { String::new() };
        let column_names = with_terms.then(|| stage.terms.iter().enumerate().map(named).collect());
        heat::heat(&frame, &rows, scale, HeatLook::Matrix { row_names: names.clone(), column_names })
    };
    let pictures = html! {
        p.panel { b { "a" } " Before (stage 1)" } (picture(&stage.before, "Coefficients before calibration", false))
        p.panel { b { "b" } " After (stage 3)" } (picture(&stage.after, "Coefficients after calibration", false))
        p.panel { b { "c" } " Difference, b − a" } (picture(&difference, "Change of the coefficients", true))
        (color_bar(scale, "Coefficient (normalised units); the same scale in all three"))
    };
    let kept = |m: &[Vec<f64>]| m.iter().flatten().filter(|v| **v != 0.0).count();
    let caption = html! {
        "Coefficients of the latent dynamics, one row an equation, one column a library term (of many, some are named); white is exactly zero. "
        "Terms in use: " (kept(&stage.before)) " before, " (kept(&stage.after)) " after, of " (n_row * stage.terms.len()) "."
        @if let Some(cosine) = stage.cosine_similarity {
            " Cosine similarity of the two: " b { (number::fixed(cosine, 4)) } "."
        }
    };
    figure(&pictures, &caption)
}

fn changes(stage: &Calibration) -> Markup {
    let mut all: Vec<(usize, usize, f64)> = Vec::new();
    for (i, (after, before)) in stage.after.iter().zip(&stage.before).enumerate() {
        all.extend(after.iter().zip(before).enumerate().map(|(j, (a, b))| (i, j, a - b)).filter(|c| c.2 != 0.0));
    }
    all.sort_by(|a, b| b.2.abs().total_cmp(&a.2.abs()));
    html! {
        @if !all.is_empty() {
            details {
                summary { "The largest of " (all.len()) " changes" }
                div.scroll { table.narrow {
                    thead { tr { th scope="col" { "Equation" } th scope="col" { "Term" } th.n scope="col" { "Before" } th.n scope="col" { "After" } th.n scope="col" { "Change" } } }
                    tbody {
                        @for (i, j, change) in all.iter().take(12) {
                            tr {
                                td { "ż" (subscript(i + 1)) } td { (stage.terms[*j]) }
                                td.n { (number::significant(stage.before[*i][*j])) }
                                td.n { (number::significant(stage.after[*i][*j])) }
                                td.n { (number::significant(*change)) }
                            }
                        }
                    }
                } }
            }
        }
    }
}

fn subscript(n: usize) -> String {
    n.to_string().chars().map(|c| char::from_u32('₀' as u32 + c as u32 - '0' as u32).unwrap_or(c)).collect()
}
