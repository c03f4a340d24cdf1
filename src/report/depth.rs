//! The strongest held-out motion over depth: peaks of acceleration, strain, stress and pore pressure, and stress–strain loops.

use maud::{Markup, html};

use super::chart::{self, Axis, Curve, Frame};
use super::content::Content;
use super::figure::{Key, Section, figure, legend};
use super::models::{self, Model};
use super::number;
use super::site_content::{DepthModel, DepthView};

/// Ratio of pore pressure below which there is nothing to draw.
const LEAST_RATIO: f64 = 0.005;

/// A quantity over depth: label, and the values of a model.
type Panel = (&'static str, fn(&DepthModel) -> &Vec<f64>);

/// The section, if a column was run for it.
pub(super) fn section(content: &Content) -> Option<Section> {
    let view = content.depth.as_ref()?;
    let shown: Vec<(&DepthModel, Model)> =
        models::MODELS.iter().filter_map(|m| Some((view.models.iter().find(|d| d.model == m.key)?, *m))).collect();
    if shown.is_empty() {
        return None;
    }
    let keys: Vec<Key> = shown.iter().map(|(_, m)| m.key()).collect();
    let has_pressure = shown.iter().flat_map(|(d, _)| &d.pore_ratio).any(|r| *r > LEAST_RATIO);
    let mut panels: Vec<Panel> = vec![
        ("Peak acceleration (g)", |d| &d.pga_g),
        ("Peak shear strain (%)", |d| &d.strain_percent),
        ("Peak shear stress (kPa)", |d| &d.stress_kpa),
    ];
    if has_pressure {
        panels.push(("Pore pressure ratio r_u", |d| &d.pore_ratio));
    }
    let pictures = html! {
        div.narrow-grid { @for (label, of) in panels { div.picture { (over_depth(view, &shown, label, of)) } } }
    };
    let caption = html! {
        "Largest absolute values over depth under the strongest motion of the held-out events, " (view.event) " " (view.component) " (input "
        (number::significant(view.pga_g)) " g)" @if !has_pressure { ". Excess pore pressure stays below " (number::plain(LEAST_RATIO)) " of the effective stress" } "."
    };
    let loops = html! { div.grid { @for (depth, model) in &shown { div { (stress_strain(depth, *model, view)) } } } };
    let body = html! {
        (legend(&keys))
        (figure(&pictures, &caption))
        figure { (loops) figcaption { "Stress over strain in the element with the largest strain." } }
    };
    Some(Section { id: "depth", title: "The strongest motion over depth".into(), entries: Vec::new(), body })
}

fn over_depth(
    view: &DepthView,
    shown: &[(&DepthModel, Model)],
    label: &str,
    of: fn(&DepthModel) -> &Vec<f64>,
) -> Markup {
    let deepest = shown.iter().flat_map(|(d, _)| &d.depth_m).fold(0.0, |m: f64, v| m.max(*v));
    let top = shown.iter().flat_map(|(d, _)| of(d)).copied().filter(|v| v.is_finite()).fold(0.0, f64::max);
    let curves: Vec<Curve> = shown
        .iter()
        .map(|(d, m)| Curve {
            points: of(d).iter().zip(&d.depth_m).map(|(v, z)| (*v, -z)).collect(),
            color: m.color,
            width: m.width + 0.6,
            dash: m.dash,
        })
        .collect();
    let frame = Frame {
        size: (300.0, 340.0),
        x: Axis { label, range: (0.0, if top > 0.0 { 1.08 * top } else { 1.0 }), log: false },
        y: Axis { label: "Depth (m)", range: (-1.02 * deepest, 0.0), log: false },
        alt: format!("{label} over depth in {} {}", view.event, view.component),
    };
    chart::curves_over_depth(&frame, &curves)
}

fn stress_strain(depth: &DepthModel, model: Model, view: &DepthView) -> Markup {
    let largest = |of: fn(&(f64, f64)) -> f64| depth.stress_strain.iter().map(of).fold(0.0f64, |m, v| m.max(v.abs()));
    let [strain, stress] = [largest(|p| p.0), largest(|p| p.1)];
    if strain <= 0.0 || stress <= 0.0 {
        return html! {};
    }
    let frame = Frame {
        size: (420.0, 300.0),
        x: Axis { label: "Shear strain (%)", range: (-1.08 * strain, 1.08 * strain), log: false },
        y: Axis { label: "Shear stress (kPa)", range: (-1.08 * stress, 1.08 * stress), log: false },
        alt: format!(
            "Stress over strain of {} at {} m in {} {}",
            model.name,
            number::plain(depth.loop_depth_m),
            view.event,
            view.component
        ),
    };
    let curve = Curve { points: depth.stress_strain.clone(), color: model.color, width: 0.9, dash: None };
    html! {
        h3 { (model.name) ", " (number::significant(depth.loop_depth_m)) " m" }
        div.picture { (chart::path(&frame, &curve)) }
    }
}
