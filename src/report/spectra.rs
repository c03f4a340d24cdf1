//! Transfer functions recorded and modelled, and what remains of response spectra, over all events.

use maud::{Markup, html};

use super::chart::{self, Axis, Curve, Frame};
use super::content::Content;
use super::figure::{Section, figure, legend};
use super::models::{self, Model};
use super::number;
use super::site_content::{ResidualView, TransferView};

/// The section, if there is something to show.
pub(super) fn section(content: &Content) -> Option<Section> {
    if content.transfers.is_empty() && content.residuals.is_empty() {
        return None;
    }
    let keys = content.transfers.iter().flat_map(|t| &t.predicted_ln).map(|(m, _)| m.as_str());
    let keys = keys.chain(content.residuals.iter().flat_map(|r| &r.models).map(|(m, ..)| m.as_str())).chain(["record"]);
    let of = Model::key;
    let keys = models::among(keys);
    let body = html! {
        (legend(&keys.iter().map(of).collect::<Vec<_>>()))
        @if !content.transfers.is_empty() { h3 id="transfer" { "Transfer functions" } (transfers(content)) }
        @if !content.residuals.is_empty() { h3 id="residual" { "Response spectra over periods" } (residuals(&content.residuals)) }
    };
    let entries = [
        ("transfer", "Transfer functions", content.transfers.is_empty()),
        ("residual", "Response spectra", content.residuals.is_empty()),
    ];
    let entries = entries.iter().filter(|e| !e.2).map(|e| (e.0.to_string(), e.1.to_string())).collect();
    Some(Section { id: "spectra", title: "Transfer functions and spectra".into(), entries, body })
}

fn transfers(content: &Content) -> Markup {
    let caption = html! {
        "Fourier amplitude of each sensor over that of the input, smoothed, as the geometric mean over weak events; thin lines are one "
        "standard deviation of the recorded one between events. Letters after Thompson et al. (2012): L low, H high variability; G good, P poor fit."
    };
    let all = html! { div.grid { @for view in &content.transfers { div { (transfer(view, content)) } } } };
    html! { figure { div.curves { (all) } figcaption { (caption) } } }
}

fn transfer(view: &TransferView, content: &Content) -> Markup {
    let f = &view.frequencies_hz;
    let (Some(first), Some(last)) = (f.first(), f.last()) else { return html! {} };
    let record = models::MODELS[0];
    let line = |values: &dyn Fn(usize) -> f64, m: &Model, width: f64| Curve {
        points: f.iter().enumerate().map(|(k, f)| (*f, values(k).exp())).filter(|p| p.1.is_finite()).collect(),
        color: m.color,
        width,
        dash: m.dash,
    };
    let mut curves = Vec::new();
    let drawn = models::MODELS.iter().rev().filter(|m| m.is_shown);
    for (model, (_, ln)) in drawn.filter_map(|m| Some((m, view.predicted_ln.iter().find(|(key, _)| key == m.key)?))) {
        curves.push(line(&|k| ln[k], model, 1.5));
    }
    if !view.sigma_ln.is_empty() {
        for sign in [-1.0, 1.0] {
            curves.push(line(&|k| view.recorded_ln[k] + sign * view.sigma_ln[k], &record, 0.6));
        }
    }
    curves.push(line(&|k| view.recorded_ln[k], &record, 1.7));
    let values = || curves.iter().flat_map(|c| &c.points).map(|p| p.1).filter(|v| *v > 0.0);
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max));
    if high <= 0.0 {
        return html! {};
    }
    let frame = Frame {
        size: (480.0, 250.0),
        x: Axis { label: "Frequency (Hz)", range: (*first, *last), log: true },
        y: Axis { label: "Amplification", range: (0.8 * low.max(1e-3 * high), 1.3 * high), log: true },
        alt: format!("Transfer function of {} in {}, {} weak events", view.sensor, view.component, view.n_event),
    };
    let hints: Vec<(f64, String)> = f
        .iter()
        .enumerate()
        .map(|(k, f)| {
            let models = view.predicted_ln.iter().filter_map(|(key, ln)| {
                Some(format!("{} {}", models::of(key)?.name, number::significant(ln[k].exp())))
            });
            let all: Vec<String> =
                std::iter::once(format!("Record {}", number::significant(view.recorded_ln[k].exp())))
                    .chain(models)
                    .collect();
            (*f, format!("{} Hz: {}", number::significant(*f), all.join(", ")))
        })
        .collect();
    let letters = content.closing.as_ref().map_or_else(Vec::new, |c| {
        let is_here =
            |row: &&super::closing_content::TransferRow| row.component == view.component && row.sensor == view.sensor;
        c.transfer.iter().filter(is_here).map(|row| format!("{} {}", row.model, row.letters)).collect()
    });
    html! {
        h4 { (view.sensor) " " span.soft { (view.component) ", " (view.n_event) " events" @if !letters.is_empty() { "; " (letters.join(", ")) } } }
        div.picture { (chart::curves_with_hints(&frame, &curves, &hints)) }
    }
}

fn residuals(residuals: &[ResidualView]) -> Markup {
    html! { div.grid { @for view in residuals { div { (residual(view)) } } } }
}

fn residual(view: &ResidualView) -> Markup {
    let (Some(first), Some(last)) = (view.period_s.first(), view.period_s.last()) else { return html! {} };
    let mut curves =
        vec![Curve { points: vec![(*first, 0.0), (*last, 0.0)], color: "#8a8f98", width: 1.0, dash: None }];
    let drawn = models::MODELS.iter().filter(|m| m.is_shown);
    for (model, (_, bias, sigma)) in drawn.filter_map(|m| Some((m, view.models.iter().find(|(key, ..)| key == m.key)?)))
    {
        let line = |sign: f64, width: f64| Curve {
            points: view.period_s.iter().enumerate().map(|(k, t)| (*t, bias[k] + sign * sigma[k])).collect(),
            color: model.color,
            width,
            dash: model.dash,
        };
        curves.extend([line(0.0, 1.8), line(-1.0, 0.6), line(1.0, 0.6)]);
    }
    let top = curves.iter().flat_map(|c| &c.points).map(|p| p.1.abs()).filter(|v| v.is_finite()).fold(0.5, f64::max);
    let frame = Frame {
        size: (480.0, 250.0),
        x: Axis { label: "Period (s)", range: (*first, *last), log: true },
        y: Axis { label: "ln predicted/recorded", range: (-1.05 * top, 1.05 * top), log: false },
        alt: format!("ln ratio of predicted and recorded response spectra at {}", view.sensor),
    };
    let hints: Vec<(f64, String)> = view
        .period_s
        .iter()
        .enumerate()
        .map(|(k, t)| {
            let of = |(key, bias, sigma): &(String, Vec<f64>, Vec<f64>)| {
                Some(format!(
                    "{} {} ± {}",
                    models::of(key)?.name,
                    number::fixed(bias[k], 2),
                    number::fixed(sigma[k], 2)
                ))
            };
            (
                *t,
                format!(
                    "{} s: {}",
                    number::significant(*t),
                    view.models.iter().filter_map(of).collect::<Vec<_>>().join(", ")
                ),
            )
        })
        .collect();
    let caption = html! {
        "Mean (thick) and one standard deviation (thin) of the ln ratio over " (view.n) " held-out records: 0.7 is a factor of two."
    };
    html! { h4 { (view.sensor) } (figure(&chart::curves_with_hints(&frame, &curves, &hints), &caption)) }
}
