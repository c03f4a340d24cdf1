//! The held-out events with all models: histories, what is left, spectra with their ratio, and peaks in a table.

use maud::{Markup, PreEscaped, html};

use super::chart::{self, Axis, Curve, Frame, Marks};
use super::content::{Content, Series};
use super::figure::{Section, swatch};
use super::models::{self, Model};
use super::number;
use super::site_content::{EventView, ModelView, SensorView};
use super::traces::peak;
use crate::metrics::arias_build_up_m_s;
use crate::units::G_M_S2;

/// Length of the strong part, s.
const STRONG_S: f64 = 12.0;
/// Ratios that are drawn, predicted over recorded.
const RATIOS: (f64, f64) = (0.25, 4.0);

/// The section, if there are events.
pub(super) fn section(content: &Content) -> Option<Section> {
    if content.events.is_empty() {
        return None;
    }
    let keys = content.events.iter().flat_map(|e| &e.sensors).flat_map(|s| &s.models).map(|m| m.model.as_str());
    let all = models::among(keys);
    let anchor = |i: usize| format!("event-{}", i + 1);
    let title = |e: &EventView| format!("{} {}", e.event, e.component);
    let body = html! {
        p { "No event of this section took part in calibration, diagnosis or selection. Choose an event by its name and what is drawn by the boxes." }
        (style(&all))
        fieldset.choice {
            legend { "Shown" }
            @for model in &all {
                label {
                    input type="checkbox" id={ "show-" (model.key) } checked[model.is_shown];
                    (swatch(model.color, model.dash))
                    (model.name)
                }
            }
        }
        @for (i, event) in content.events.iter().enumerate() {
            details.event name="event" id=(anchor(i)) open[i == 0] {
                summary { h3 { (title(event)) " " span.soft { (peaks(event)) } } }
                (view(event, content))
            }
        }
    };
    let entries = content.events.iter().enumerate().map(|(i, e)| (anchor(i), title(e))).collect();
    Some(Section { id: "held-out", title: "Held-out events".into(), entries, body })
}

/// A box without its mark hides the curves of its colour.
fn style(models: &[Model]) -> Markup {
    let rule = |m: &Model| {
        format!("body:has(#show-{}:not(:checked)) .event .curves path[stroke=\"{}\"]{{display:none}}", m.key, m.color)
    };
    html! { style { (PreEscaped(models.iter().map(rule).collect::<String>())) } }
}

fn peaks(event: &EventView) -> String {
    let at = |name: &str, series: &Series| format!("{name} {} g", number::significant(peak(series) / G_M_S2));
    let sensors = event.sensors.iter().filter_map(|s| Some(at(&s.sensor, &recorded(s)?.history)));
    std::iter::once(at("input", &event.input)).chain(sensors).collect::<Vec<_>>().join(", ")
}

fn recorded(sensor: &SensorView) -> Option<&ModelView> {
    sensor.models.iter().find(|m| m.model == "record")
}

fn view(event: &EventView, content: &Content) -> Markup {
    let strong = strong_part(event);
    let whole = (0.0, event.input.step_s * event.input.values.len().saturating_sub(1) as f64);
    let about = format!("in {} {}", event.event, event.component);
    let input = Frame {
        size: (1000.0, 130.0),
        x: Axis { label: "Time (s)", range: whole, log: false },
        y: symmetric("Input (m/s²)", peak(&event.input)),
        alt: format!("Input motion {about}, peak {} m/s²", number::significant(peak(&event.input))),
    };
    let curve = curve(&event.input, models::of("record"));
    html! {
        figure {
            div.picture { (chart::curves(&input, &[curve], Marks { at: None, span: Some(strong) })) }
            @for sensor in &event.sensors { (rows(sensor, event, strong, &about, content)) }
            figcaption {
                "The input motion with its strong part shaded; at each sensor the strong part, below it what the best model leaves of the record, "
                "and 5 % damped pseudo-acceleration with the ratio of predicted to recorded. A pointer held over a spectrum reads its values."
            }
        }
    }
}

fn symmetric(label: &str, peak: f64) -> Axis<'_> {
    let top = if peak > 0.0 { 1.06 * peak } else { 1.0 };
    Axis { label, range: (-top, top), log: false }
}

fn curve(series: &Series, model: Option<Model>) -> Curve {
    let model = model.unwrap_or(models::MODELS[0]);
    let points = series.values.iter().enumerate().map(|(i, v)| (series.start_s + i as f64 * series.step_s, *v));
    Curve { points: points.collect(), color: model.color, width: model.width, dash: model.dash }
}

fn rows(sensor: &SensorView, event: &EventView, strong: (f64, f64), about: &str, content: &Content) -> Markup {
    let Some(record) = recorded(sensor) else { return html! {} };
    let shown: Vec<(&ModelView, Model)> =
        models::MODELS.iter().filter_map(|m| Some((sensor.models.iter().find(|v| v.model == m.key)?, *m))).collect();
    // A model that runs away does not flatten the others.
    let top = shown.iter().map(|(v, _)| peak(&v.history)).fold(0.0, f64::max).min(3.0 * peak(&record.history));
    let places = format!("at {} {about}", sensor.sensor);
    let history = Frame {
        size: (640.0, 210.0),
        x: Axis { label: "Time (s)", range: strong, log: false },
        y: symmetric("Acc. (m/s²)", top),
        alt: format!("Accelerations of the strong part {places}"),
    };
    let curves: Vec<Curve> = shown.iter().rev().map(|(v, m)| curve(&v.history, Some(*m))).collect();
    html! {
        div.sensor {
            h4 {
                (sensor.sensor)
                @if let Some(depth_m) = sensor.depth_m { " " span.soft { @if depth_m == 0.0 { @if sensor.sensor != "surface" { "surface" } } @else { (number::plain(depth_m)) " m deep" } } }
            }
            div.pair {
                div {
                    div.picture.curves { (chart::curves(&history, &curves, Marks::default())) }
                    @if let Some((best, model)) = shown.iter().rev().find(|(v, m)| m.key != "record" && v.history.step_s == record.history.step_s) {
                        div.picture { (left(&record.history, best, *model, strong, top, &places)) }
                    }
                }
                div.picture.curves { (spectra(sensor, &shown, &places)) }
            }
            (table(sensor, event, content))
        }
    }
}

/// What the best model leaves of the record, on the scale of the histories.
fn left(record: &Series, best: &ModelView, model: Model, strong: (f64, f64), top: f64, places: &str) -> Markup {
    let values = record.values.iter().zip(&best.history.values).map(|(a, p)| a - p).collect();
    let series = Series { values, ..record.clone() };
    let label = format!("Record − {}", model.name);
    let frame = Frame {
        size: (640.0, 150.0),
        x: Axis { label: "Time (s)", range: strong, log: false },
        y: symmetric("Left (m/s²)", top),
        alt: format!("{label} {places}, peak {} m/s²", number::significant(peak(&series))),
    };
    let mut curve = curve(&series, Some(model));
    (curve.color, curve.dash) = (chart::NEUTRAL, None);
    html! { (chart::curves(&frame, &[curve], Marks::default())) p.soft.small { (label) } }
}

fn spectra(sensor: &SensorView, shown: &[(&ModelView, Model)], places: &str) -> Markup {
    let Some(record) = recorded(sensor) else { return html! {} };
    let range = (sensor.period_s.first().copied().unwrap_or(0.01), sensor.period_s.last().copied().unwrap_or(10.0));
    let values = || shown.iter().flat_map(|(v, _)| &v.psa_m_s2).copied().filter(|v| v.is_finite() && *v > 0.0);
    let highest = values().fold(0.0, f64::max);
    if highest <= 0.0 {
        return html! {};
    }
    let lowest = values().fold(f64::INFINITY, f64::min).max(1e-4 * highest);
    let x = || Axis { label: "Period (s)", range, log: true };
    let of = |ratio: bool| -> Vec<Curve> {
        shown
            .iter()
            .rev()
            .filter(|(_, m)| !ratio || m.key != "record")
            .map(|(v, m)| {
                let value = |k: usize| if ratio { v.psa_m_s2[k] / record.psa_m_s2[k] } else { v.psa_m_s2[k] };
                let points = (0..v.psa_m_s2.len()).map(|k| (sensor.period_s[k], value(k))).collect();
                Curve { points, color: m.color, width: m.width + 0.4, dash: m.dash }
            })
            .collect()
    };
    let psa = Frame {
        size: (420.0, 240.0),
        x: x(),
        y: Axis { label: "5 % PSA (m/s²)", range: (0.8 * lowest, 1.3 * highest), log: true },
        alt: format!("5 % damped pseudo-acceleration spectra {places}"),
    };
    let ratio = Frame {
        size: (420.0, 140.0),
        x: x(),
        y: Axis { label: "Over record", range: RATIOS, log: true },
        alt: format!("Ratio of predicted to recorded spectra {places}"),
    };
    let hints: Vec<(f64, String)> = sensor
        .period_s
        .iter()
        .enumerate()
        .map(|(k, period)| {
            let of =
                |(v, m): &(&ModelView, Model)| Some(format!("{} {}", m.name, number::significant(*v.psa_m_s2.get(k)?)));
            let values: Vec<String> = shown.iter().filter_map(of).collect();
            (*period, format!("{} s: {} m/s²", number::significant(*period), values.join(", ")))
        })
        .collect();
    let unity = Curve { points: vec![(range.0, 1.0), (range.1, 1.0)], color: "#8a8f98", width: 1.0, dash: None };
    let ratios: Vec<Curve> = std::iter::once(unity).chain(of(true)).collect();
    html! {
        (chart::curves_with_hints(&psa, &of(false), &hints))
        (chart::curves_with_hints(&ratio, &ratios, &hints))
    }
}

fn table(sensor: &SensorView, event: &EventView, content: &Content) -> Markup {
    let floor = |name: &str| {
        let closing = content.closing.as_ref()?;
        let i = closing.models.iter().position(|m| m.name == name)?;
        let is_row = |r: &&super::closing_content::ErrorRow| {
            r.event == event.event && r.component == event.component && r.sensor == sensor.sensor
        };
        *closing.errors.iter().find(is_row)?.nrmse_percent.get(i)?
    };
    html! {
        div.scroll { table.peaks {
            thead { tr { th scope="col" { "" } th.n scope="col" { "PGA (g)" } th.n scope="col" { "PGV (cm/s)" } th.n scope="col" { "Arias (m/s)" } th.n scope="col" { "NRMSE (%)" } } }
            tbody {
                @for (view, model) in models::MODELS.iter().filter_map(|m| Some((sensor.models.iter().find(|v| v.model == m.key)?, m))) {
                    tr {
                        th scope="row" { (model.name) }
                        td.n { (number::significant(peak(&view.history) / G_M_S2)) }
                        td.n { (number::significant(100.0 * view.pgv_m_s)) }
                        td.n { (number::significant(view.arias_m_s)) }
                        td.n { (number::optional(view.nrmse_percent, 1)) }
                    }
                }
                @for name in ["Ceiling", "Noise floor"] {
                    @if let Some(percent) = floor(name) {
                        tr { th scope="row" { (name) } td {} td {} td {} td.n { (number::fixed(percent, 1)) } }
                    }
                }
            }
        } }
    }
}

/// The part of an event from just before a twentieth of the energy of its input has arrived.
fn strong_part(event: &EventView) -> (f64, f64) {
    let series = &event.input;
    let last = series.step_s * series.values.len().saturating_sub(1) as f64;
    if last <= STRONG_S {
        return (0.0, last);
    }
    let build_up = arias_build_up_m_s(&series.values, series.step_s);
    let whole = build_up.last().copied().unwrap_or(0.0);
    let first = build_up.iter().position(|energy| *energy >= 0.05 * whole).unwrap_or(0);
    // Whole seconds read better, and what comes first should not lie at the edge.
    let from = (first as f64 * series.step_s - 1.0).floor().clamp(0.0, last - STRONG_S);
    (from, from + STRONG_S)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_strong_part_holds_the_energy_and_lies_in_the_record() {
        let event = |from: usize, n: usize| {
            let values = (0..n).map(|i| if (from..from + 500).contains(&i) { 1.0 } else { 0.01 }).collect();
            EventView { input: Series { start_s: 0.0, step_s: 0.01, values }, ..EventView::default() }
        };
        for from in [0, 1000, 3000, 5500] {
            let (start, end) = strong_part(&event(from, 6000));
            assert!(
                start <= 0.01 * from as f64 && end >= 0.01 * (from + 500) as f64 - 0.02,
                "{from}: {start} to {end}"
            );
            assert!(start >= 0.0 && end <= 60.0);
        }
        assert_eq!(strong_part(&event(0, 800)), (0.0, 7.99));
    }
}
