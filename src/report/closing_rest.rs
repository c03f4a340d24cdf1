//! The end of the loop: what the records say of declared values, and what remains.

use maud::{Markup, html};

use super::chart::{self, Axis, Curve, Frame, Marks};
use super::closing::{claim, interval, words};
use super::closing_content::{Closing, DeclaredRow, Generic, Rest};
use super::figure::{Key, figure, legend};
use super::number;
use crate::diagnosis::Hidden;

/// Whether there is anything to say.
pub(super) fn is_any(closing: &Closing) -> bool {
    !closing.declared.is_empty() || !closing.hidden.is_empty() || closing.rest.is_some() || closing.generic.is_some()
}

/// The subsection.
pub(super) fn rest(closing: &Closing) -> Markup {
    if !is_any(closing) {
        return html! {};
    }
    html! {
        h3 id="loop-rest" { "What remains" }
        @if !closing.declared.is_empty() { (declared(&closing.declared)) }
        @if let Some(rest) = &closing.rest { (remains(rest)) }
        @if !closing.hidden.is_empty() { (hidden(&closing.hidden)) }
        @if let Some(generic) = &closing.generic { (without_a_name(generic)) }
    }
}

fn without_a_name(generic: &Generic) -> Markup {
    html! {
        p { "Nothing that has a name explains the records. Corrections " b { "without physical meaning" }
            ", fitted and chosen on training and validation events and judged on held-out ones:" }
        div.scroll { table {
            caption { "Median NRMSE (%) over held-out events." }
            thead { tr { th scope="col" { "Model" } th.n scope="col" { "Without" } th.n scope="col" { "With" } } }
            tbody { @for (name, [without, with]) in &generic.models {
                tr { td { (name) } td.n { (number::optional(*without, 1)) } td.n { (number::optional(*with, 1)) } }
            } }
        } }
        ul {
            @for change in &generic.changes { (claim(change)) }
            @for note in &generic.notes { li { (note) } }
        }
    }
}

fn declared(rows: &[DeclaredRow]) -> Markup {
    html! {
        p { "What the records say of each declared value that may be off, beside the answer: with its tolerance, and by the records alone where they tell it." }
        div.scroll { table {
            caption { "Declared values; in brackets 95 % intervals." }
            thead { tr { th scope="col" { "Declared" } th scope="col" { "Parameter" } th scope="col" { "With its tolerance" } th scope="col" { "By the records alone" } } }
            tbody { @for row in rows {
                tr {
                    td { (words(&row.kind)) " " (row.target) }
                    td { (words(&row.parameter)) }
                    td { (interval(&row.estimate)) @if row.is_at_end { " (at its end)" } }
                    td { @if let Some(alone) = &row.by_records { (interval(alone)) } }
                }
            } }
        } }
    }
}

fn hidden(rows: &[Hidden]) -> Markup {
    html! {
        h4 { "What could still hide" }
        p { "Of each kind of effect, the place where these records would show it least, and the strength from which it would be named there in four cases of five." }
        div.scroll { table {
            caption { "Effects that could be there unnoticed, the best hidden first." }
            thead { tr { th scope="col" { "Effect" } th scope="col" { "Where" } th scope="col" { "Named from" } } }
            tbody { @for row in rows {
                tr {
                    td { (words(&row.kind)) }
                    td { @if row.target.is_empty() { "whole column" } @else { (row.target) } }
                    td {
                        @match row.least {
                            Some(least) => { code { (row.parameter) } " " (number::significant(least)) " " (row.unit) },
                            None => "not at twice the typical strength",
                        }
                    }
                }
            } }
        } }
    }
}

fn remains(rest: &Rest) -> Markup {
    html! {
        p { (rest.sentence) " It is " (number::fixed(100.0 * rest.share, 1)) " % of the recorded power, "
            (number::fixed(100.0 * rest.repeatable_share, 1)) " % the same in all events." }
        @if !rest.coherence.is_empty() { (coherence(&rest.coherence)) }
    }
}

fn coherence(sensors: &[(String, Vec<[f64; 2]>)]) -> Markup {
    let mut curves = Vec::new();
    let mut keys = Vec::new();
    let frequencies_hz = sensors.iter().flat_map(|(_, c)| c.iter().map(|[f, _]| *f));
    let (first, last) = frequencies_hz.fold((f64::INFINITY, 0.0f64), |(a, b), f| (a.min(f), b.max(f)));
    for (i, (sensor, values)) in sensors.iter().enumerate() {
        let color = chart::SERIES[i % chart::SERIES.len()];
        let dash = [None, Some("5 2"), Some("2 2")][i / chart::SERIES.len() % 3];
        curves.push(Curve { points: values.iter().map(|[f, c]| (*f, *c)).collect(), color, width: 1.8, dash });
        keys.push(Key { name: sensor, color, dash });
    }
    let frame = Frame {
        size: (760.0, 260.0),
        x: Axis { label: "Frequency (Hz)", range: (first, last), log: true },
        y: Axis { label: "Coherence", range: (0.0, 1.05), log: false },
        alt:
            "Coherence of each output sensor with the prediction over frequency; one where the motion follows its base"
                .into(),
    };
    let picture = html! { (legend(&keys)) (chart::curves(&frame, &curves, Marks::default())) };
    figure(
        &picture,
        &html! { "Coherence of each output sensor with what the last model predicts. Where it is well below 1, amplitudes can be predicted and waveforms cannot." },
    )
}
