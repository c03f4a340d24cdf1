//! Stage 1: the simulated field beside its rollout, and the error of every validation case.

use maud::{Markup, html};

use super::chart::{self, Axis, Column, Frame};
use super::content::{Content, FieldPair, Guard, Pretrain, Sample};
use super::figure::{Section, color_bar, figure};
use super::heat::{self, Diverging, HeatLook};
use super::{losses, number, thin};

/// The section, if stage 1 has run.
pub(super) fn section(content: &Content) -> Option<Section> {
    let stage = content.pretrain.as_ref()?;
    let body = html! {
        p { "The latent model learns from finite-element simulations alone. The validation cases were not used in training; "
            "each is predicted from its first samples and the base motion over its whole length (rollout)." }
        @if let Some(field) = &stage.field { (fields(field)) }
        @if !stage.cases.is_empty() { (cases(stage)) }
        @if !stage.guards.is_empty() { (guards(&stage.guards)) }
        (losses::losses(stage.losses.as_ref(), "stage 1"))
    };
    Some(Section { id: "stage-1", title: "Stage 1: simulation pretraining".into(), entries: Vec::new(), body })
}

fn fields(field: &FieldPair) -> Markup {
    let n_depth = field.depth_m.len();
    let duration = field.step_s * (field.fe_m_s2.len() / n_depth) as f64;
    let mut order: Vec<usize> = (0..n_depth).collect();
    order.sort_by(|a, b| field.depth_m[*b].total_cmp(&field.depth_m[*a]));
    // Rows from the deepest channel up, columns in time, thinned to what the figure can show.
    let rows = |values: &[f32]| {
        let all: Vec<Vec<f64>> =
            order.iter().map(|j| values.iter().skip(*j).step_by(n_depth).map(|v| f64::from(*v)).collect()).collect();
        thin::block_mean(&all, 128, 800)
    };
    let (fe, model) = (rows(&field.fe_m_s2), rows(&field.model_m_s2));
    let difference: Vec<Vec<f64>> =
        model.iter().zip(&fe).map(|(m, f)| m.iter().zip(f).map(|(m, f)| m - f).collect()).collect();
    let limit = fe.iter().flatten().filter(|v| v.is_finite()).fold(0.0_f64, |top, v| top.max(v.abs()));
    let scale = Diverging { limit, power: 0.6 };
    let picture = |rows: &[Vec<f64>], what: &str| {
        let frame = Frame {
            size: (1000.0, 230.0),
            x: Axis { label: "Time (s)", range: (0.0, duration), log: false },
            y: Axis { label: "Depth (m)", range: (-lowest(&field.depth_m), 0.0), log: false },
            alt: format!("{what}, case {}: acceleration over time and depth", field.case),
        };
        heat::heat(&frame, rows, scale, HeatLook::Depth)
    };
    let picture_of = html! {
        p.panel { b { "a" } " Finite elements" } (picture(&fe, "Finite-element field"))
        p.panel { b { "b" } " Rollout of the latent model" } (picture(&model, "Rollout"))
        p.panel { b { "c" } " Difference, b − a" } (picture(&difference, "Difference of rollout and finite elements"))
        (color_bar(scale, "Acceleration (m/s²); the same scale in all three"))
    };
    let caption = html! {
        "Validation case " (field.case) ": acceleration over time and depth. Where b repeats the bands of a and c stays pale, "
        "the model has learnt how waves travel through this column. Small values are lifted (see the colour scale)."
    };
    figure(&picture_of, &caption)
}

/// Bottom of the deepest channel: half a spacing below its centre.
fn lowest(depth_m: &[f64]) -> f64 {
    let deepest = depth_m.iter().copied().fold(0.0, f64::max);
    let spacing = if depth_m.len() > 1 {
        (deepest - depth_m.iter().copied().fold(f64::MAX, f64::min)) / (depth_m.len() - 1) as f64
    } else {
        deepest
    };
    deepest + spacing / 2.0
}

fn cases(stage: &Pretrain) -> Markup {
    let medians = stage.cases.iter().filter_map(|case| number::median(case.values.iter().copied()));
    let caption = html! {
        "Depthwise NRMSE of every validation case (%): box from lower to upper quartile over all depths, white line at the "
        "median, whiskers to the furthest value within 1.5 box heights."
        @if let Some(median) = number::median(medians) { " Median of the case medians: " b { (number::fixed(median, 1)) " %" } "." }
        (band_words(stage.published_range_percent))
    };
    figure(&sample_boxes(&stage.cases, stage.published_range_percent, "Validation case", "NRMSE per depth"), &caption)
}

fn guards(list: &[Guard]) -> Markup {
    let words = |what: &str| match what {
        "doubled" => ("Motion and window twice as strong", "peak against the plain rollout"),
        _ => ("Motion ten times in a row", "last repetition against the first (RMS)"),
    };
    html! {
        p { "Beyond the training: rollouts of the validation motions where nothing was learnt must stay finite; whether they are "
            "right is not claimed." }
        div.scroll { table.narrow {
            thead { tr { th scope="col" { "Rollout" } th.n scope="col" { "Finite" } th scope="col" { "Response" } th.n scope="col" { "Median" } th.n scope="col" { "Largest" } th.n scope="col" { "Limited" } } }
            tbody {
                @for guard in list {
                    tr {
                        td { (words(&guard.what).0) }
                        td.n { (guard.finite) " of " (guard.of) }
                        td { (words(&guard.what).1) }
                        td.n { @if let Some(m) = number::median(guard.ratios.iter().copied()) { (number::significant(m)) } }
                        td.n { @if let Some(m) = guard.ratios.last() { (number::significant(*m)) } }
                        td.n { (number::fixed(100.0 * guard.limited_share, 1)) " %" }
                    }
                }
            }
        } }
    }
}

/// Boxes of NRMSE with the published band; also used for the sensors of stage 2.
pub(super) fn sample_boxes(samples: &[Sample], band: Option<(f64, f64)>, x_label: &str, about: &str) -> Markup {
    let columns: Vec<Column> =
        samples.iter().map(|s| Column { label: &s.label, values: &s.values, color: chart::NEUTRAL }).collect();
    let at_least = band.map_or(0.0, |b| b.1);
    let wide = samples.len() > 8;
    let frame = Frame {
        size: (if wide { 1000.0 } else { 240.0 + 95.0 * samples.len() as f64 }, 280.0),
        x: Axis { label: x_label, range: (0.5, samples.len() as f64 + 0.5), log: false },
        y: Axis {
            label: "NRMSE (%)",
            range: chart::box_range(samples.iter().map(|s| s.values.as_slice()), at_least),
            log: false,
        },
        alt: format!("Box plots: {about} for {} groups", samples.len()),
    };
    let tilt = (wide && samples.iter().any(|s| s.label.chars().count() > 5)).then_some(-45.0);
    chart::boxes(&frame, &columns, band, if wide { 0.62 } else { 0.45 }, tilt)
}

/// The sentence about the published band.
pub(super) fn band_words(band: Option<(f64, f64)>) -> Markup {
    html! {
        @if let Some((low, high)) = band {
            " The yellow band is the range of medians in the published application, "
            (number::fixed(low, 0)) "–" (number::fixed(high, 0)) " %."
        }
    }
}
