//! The held-out events: record, finite elements and FLARE-T at every sensor.

use maud::{Markup, html};

use super::chart::{self, Axis, Column, Frame};
use super::content::{Content, Pair, Prediction};
use super::figure::{Section, figure, legend, listed, model_keys};
use super::number;
use super::traces::{self, Look};

/// The section, if there are predictions.
pub(super) fn section(content: &Content) -> Option<Section> {
    if content.held_out.is_empty() || !content.events.is_empty() {
        return None;
    }
    let anchor = |i: usize| format!("event-{}", i + 1);
    let title = |p: &Prediction| format!("{} {}", p.event, p.component);
    let body = html! {
        p { "No event of this section took part in training or selection. FLARE-T sees the sensors over its initial window "
            "only, and from then on the base motion alone; FE is the site model driven by the same base motion." }
        @for (i, prediction) in content.held_out.iter().enumerate() {
            article.event id=(anchor(i)) {
                h3 { (title(prediction)) }
                (event(prediction, content))
            }
        }
    };
    let entries = content.held_out.iter().enumerate().map(|(i, p)| (anchor(i), title(p))).collect();
    Some(Section { id: "held-out", title: "Held-out events in detail".into(), entries, body })
}

fn event(prediction: &Prediction, content: &Content) -> Markup {
    let all = &prediction.traces;
    let keys = model_keys(
        all.iter().any(|t| t.record.is_some()).then_some("Record"),
        all.iter().any(|t| t.fe.is_some()),
        all.iter().any(|t| t.flare_t.is_some()),
    );
    let look = Look {
        about: format!("in {} {}", prediction.event, prediction.component),
        strong_s: traces::strong_part(all),
        periods_s: traces::period_range(content.held_out.iter().flat_map(|p| &p.traces)),
    };
    let cut: Vec<String> = all.iter().filter(|t| traces::is_cut(t)).map(|t| t.sensor.clone()).collect();
    html! {
        @if !all.is_empty() {
            (legend(&keys))
            figure {
                @for trace in all {
                    (traces::row(trace, &look, &errors(content, prediction, &trace.sensor)))
                }
                figcaption {
                    "Acceleration histories"
                    @if look.strong_s.is_some() { ", the shaded part enlarged below," }
                    " and 5 % damped pseudo-acceleration spectra. Phase and amplitude of the strong part, and the height of the spectral peak, are what to compare."
                    @if !cut.is_empty() {
                        " " b { "At " (listed(&cut)) " a prediction leaves the figure or stops being a finite number." }
                    }
                }
            }
        }
        @if !prediction.timewise_percent.is_empty() { (timewise(prediction)) }
    }
}

/// The NRMSE of both models beside the sensor name.
fn errors(content: &Content, prediction: &Prediction, sensor: &str) -> Markup {
    let score = content
        .scores
        .iter()
        .find(|s| s.event == prediction.event && s.component == prediction.component && s.sensor == sensor);
    let Some(score) = score else { return html! {} };
    let Pair { fe, flare_t } = score.nrmse_percent;
    html! {
        span.errors {
            "NRMSE " span.fe { "FE " (number::optional(fe, 1)) " %" } ", "
            span.flare { "FLARE-T " (number::optional(flare_t, 1)) " %" }
        }
    }
}

fn timewise(prediction: &Prediction) -> Markup {
    // Three slots a sensor (FE, name, FLARE-T) and a gap, so that the name stands below the middle of its pair.
    let mut columns: Vec<Column> = Vec::new();
    for sensor in &prediction.timewise_percent {
        if !columns.is_empty() {
            columns.push(Column { label: "", values: &[], color: chart::NEUTRAL });
        }
        columns.push(Column { label: "", values: &sensor.fe, color: chart::FE });
        columns.push(Column { label: &sensor.sensor, values: &[], color: chart::NEUTRAL });
        columns.push(Column { label: "", values: &sensor.flare_t, color: chart::FLARE_T });
    }
    let samples = prediction.timewise_percent.iter().flat_map(|s| [s.fe.as_slice(), s.flare_t.as_slice()]);
    let medians: Vec<String> = prediction
        .timewise_percent
        .iter()
        .map(|s| {
            let median = |values: &[f64]| number::optional(number::median(values.iter().copied()), 1);
            format!("{}: FE {} %, FLARE-T {} %", s.sensor, median(&s.fe), median(&s.flare_t))
        })
        .collect();
    let frame = Frame {
        size: ((220.0 + 170.0 * prediction.timewise_percent.len() as f64).min(1000.0), 250.0),
        x: Axis { label: "Sensor", range: (0.0, columns.len() as f64 + 1.0), log: false },
        y: Axis { label: "Timewise error (%)", range: chart::box_range(samples, 0.0), log: false },
        alt: format!(
            "Box plots of the timewise error in {} {}; medians {}",
            prediction.event,
            prediction.component,
            medians.join("; ")
        ),
    };
    let caption = html! {
        "Timewise error (%): at each sensor FE on the left (orange), FLARE-T on the right (blue); lower is better."
        @if medians.len() <= 6 { " Medians: " (medians.join("; ")) "." }
    };
    figure(&chart::boxes(&frame, &columns, None, 1.5, None), &caption)
}
