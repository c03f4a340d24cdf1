//! Loss terms over training on a logarithmic axis.

use maud::{Markup, html};

use super::chart::{self, Axis, Curve, Frame, Marks};
use super::content::Losses;
use super::figure::{Key, figure, legend};
use super::number;

const DASHES: [Option<&str>; 3] = [None, Some("7 3"), Some("2 2.5")];

/// The figure of a training run, nothing if there is nothing positive to draw.
pub(super) fn losses(losses: Option<&Losses>, of: &str) -> Markup {
    let Some(losses) = losses else { return html! {} };
    let points = || losses.terms.iter().flat_map(|t| &t.points).filter(|p| p.1.is_finite() && p.1 > 0.0);
    let last = points().map(|p| p.0).fold(0.0, f64::max);
    let first = points().map(|p| p.0).fold(last, f64::min);
    let (low, high) = points().fold((f64::INFINITY, 0.0_f64), |(low, high), p| (low.min(p.1), high.max(p.1)));
    if last <= first {
        return html! {};
    }
    let pen = |i: usize| (chart::SERIES[i % chart::SERIES.len()], DASHES[i % DASHES.len()]);
    let curves: Vec<Curve> = losses
        .terms
        .iter()
        .enumerate()
        .map(|(i, term)| Curve { points: term.points.clone(), color: pen(i).0, width: 1.5, dash: pen(i).1 })
        .collect();
    let keys: Vec<Key> = losses
        .terms
        .iter()
        .enumerate()
        .map(|(i, term)| Key { name: &term.name, color: pen(i).0, dash: pen(i).1 })
        .collect();
    let counter = if losses.counter.is_empty() { "Iteration" } else { &losses.counter };
    let frame = Frame {
        size: (1000.0, 300.0),
        x: Axis { label: counter, range: (first, last), log: false },
        y: Axis { label: "Loss (–)", range: decades(low, high), log: true },
        alt: format!("Loss terms of {of} over training, logarithmic axis"),
    };
    let caption = html! {
        "Loss terms of " (of) ", logarithmic axis."
        @if let Some(at) = losses.selected_at {
            " The dashed vertical line marks the state that was kept (" (counter.to_lowercase()) " " (number::fixed(at, 0)) ")."
        }
    };
    html! { (legend(&keys)) (figure(&chart::curves(&frame, &curves, Marks { at: losses.selected_at, span: None }), &caption)) }
}

/// A range of whole decades, or of thirds of them where the values span less than one.
fn decades(low: f64, high: f64) -> (f64, f64) {
    let whole = (10f64.powf(low.log10().floor()), 10f64.powf(high.log10().ceil()));
    if high / low > 10.0 { whole } else { (low / 1.3, high * 1.3) }
}
