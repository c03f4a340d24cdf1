//! The ensemble of base motions that drove the simulations.

use kuva::plot::scatter::MarkerShape;
use maud::{Markup, html};

use super::chart::{self, Axis, Curve, Dots, Frame, Marks};
use super::content::{Content, Motions, Series};
use super::figure::{Section, figure};
use super::number;

/// The section, if there are motions.
pub(super) fn section(content: &Content) -> Option<Section> {
    let motions = content.motions.as_ref()?;
    let body = html! {
        p { (motions.cases.len()) " synthetic base motions of " (number::plain(motions.duration_s)) " s at "
            (number::plain(motions.step_s)) " s." }
        @if !motions.cases.is_empty() { (peaks(motions)) }
        @if !motions.examples.is_empty() { (examples(motions)) }
    };
    Some(Section { id: "motions", title: "Base motions".into(), entries: Vec::new(), body })
}

fn peaks(motions: &Motions) -> Markup {
    let of = |validation: bool| -> Vec<(f64, f64)> {
        let numbered = motions.cases.iter().enumerate();
        numbered
            .filter(|(_, c)| c.validation == validation && c.pga_g > 0.0)
            .map(|(i, c)| (i as f64 + 1.0, c.pga_g))
            .collect()
    };
    let (train, validation) = (of(false), of(true));
    let all = || train.iter().chain(&validation).map(|p| p.1);
    let (low, high) = (all().fold(f64::INFINITY, f64::min), all().fold(0.0, f64::max));
    if high <= 0.0 {
        return html! {};
    }
    let frame = Frame {
        size: (1000.0, 240.0),
        x: Axis { label: "Case number", range: (0.0, motions.cases.len() as f64 + 1.0), log: false },
        y: Axis { label: "PGA (g)", range: (low / 1.4, high * 1.4), log: true },
        alt: format!("Peak ground acceleration of {} base motions", motions.cases.len()),
    };
    let caption = html! {
        "Peak ground acceleration of each base motion, from " (number::significant(low)) " to " (number::significant(high)) " g. "
        span.mark style={ "color:" (chart::NEUTRAL) } { "●" } " training (" (train.len()) "), "
        span.mark style={ "color:" (chart::FE) } { "◆" } " validation (" (validation.len()) ")."
    };
    let clouds = [
        Dots { points: train.clone(), color: chart::NEUTRAL, shape: MarkerShape::Circle },
        Dots { points: validation.clone(), color: chart::FE, shape: MarkerShape::Diamond },
    ];
    figure(&chart::dots(&frame, &clouds, &[]), &caption)
}

fn examples(motions: &Motions) -> Markup {
    let picture = |label: &str, series: &Series| {
        let top = series.values.iter().filter(|v| v.is_finite()).fold(0.0_f64, |top, v| top.max(v.abs()));
        let time = |i: usize| series.start_s + i as f64 * series.step_s;
        let frame = Frame {
            size: (1000.0, 150.0),
            x: Axis { label: "Time (s)", range: (series.start_s, time(series.values.len().max(2) - 1)), log: false },
            y: Axis {
                label: "Acc. (m/s²)",
                range: if top > 0.0 { (-top * 1.05, top * 1.05) } else { (-1.0, 1.0) },
                log: false,
            },
            alt: format!("Base motion {label}, peak {} m/s²", number::significant(top)),
        };
        let points = series.values.iter().enumerate().map(|(i, v)| (time(i), *v)).collect();
        chart::curves(&frame, &[Curve { points, color: chart::RECORD, width: 0.9, dash: None }], Marks::default())
    };
    let pictures = html! { @for (label, series) in &motions.examples { p.panel { (label) } (picture(label, series)) } };
    figure(&pictures, &html! { "Examples of base motions: acceleration over time." })
}
