//! The end of the loop: declared values out of tolerance, what could still hide, and what structure remains.

use maud::{Markup, html};

use kuva::plot::scatter::MarkerShape;

use super::chart::{self, Axis, Curve, Dots, Frame, Marks};
use super::closing::{claim, interval, words};
use super::closing_content::{Bound, Closing, Generic, Interval, Remainder, SensorEvidence};
use super::figure::{Key, figure, legend};
use super::number;

/// Whether there is anything to say.
pub(super) fn is_any(closing: &Closing) -> bool {
    !closing.bounds.is_empty()
        || !closing.out_of_tolerance.is_empty()
        || closing.remainder.is_some()
        || closing.input_coherent_share.is_some()
        || !closing.evidence.is_empty()
        || closing.generic.is_some()
}

/// The subsection.
pub(super) fn rest(closing: &Closing) -> Markup {
    if !is_any(closing) {
        return html! {};
    }
    html! {
        h3 id="loop-rest" { "What could still hide" }
        @if let Some(share) = closing.input_coherent_share {
            p { "Of the residual of the recalibrated model " b { (number::fixed(100.0 * share, 0)) " %" }
                " is coherent with the recorded input: that much a better model of the site could explain, the rest is noise or has another source." }
        }
        @if !closing.out_of_tolerance.is_empty() { (tolerance(&closing.out_of_tolerance)) }
        @if !closing.bounds.is_empty() { (bounds(&closing.bounds)) }
        @if !closing.evidence.is_empty() { (evidence(&closing.evidence)) }
        @if let Some(remainder) = &closing.remainder { (structure(remainder)) }
        @if let Some(generic) = &closing.generic { (without_a_name(generic)) }
    }
}

fn without_a_name(generic: &Generic) -> Markup {
    html! {
        p { "Nothing that has a name explains the records. Corrections " b { "without physical meaning" }
            ", fitted and chosen on training and validation events and judged on held-out ones:" }
        div.scroll { table {
            caption { "Median NRMSE (%) over held-out events." }
            thead { tr { th { "Model" } th.n { "Without" } th.n { "With" } } }
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

fn tolerance(alarms: &[(String, f64, Interval)]) -> Markup {
    html! {
        p { "Declared values that the records put outside their tolerance:" }
        ul { @for (what, deviations, estimate) in alarms {
            li { (what) ": " (interval(estimate)) ", " (number::fixed(*deviations, 1)) " standard deviations from the declared value" }
        } }
    }
}

fn evidence(sensors: &[SensorEvidence]) -> Markup {
    html! {
        div.scroll { table {
            caption {
                "The residuals by themselves. Repeatable: share of the amplitude error that is the same in all events; below 30 % "
                "hardly any correction of the site helps. Dependence: largest cross-correlation with the input over the bound for "
                "independent ones; above 1 the residual still follows the input. Factor: what a smooth complex factor "
                b { "without physical meaning" } " would leave of the residual power on validation events."
            }
            thead { tr { th { "Sensor" } th.n { "Repeatable" } th.n { "Dependence" } th.n { "Factor" } } }
            tbody { @for s in sensors {
                tr {
                    td { (s.sensor) }
                    td.n { (number::optional(s.repeatable_share.map(|v| 100.0 * v), 0)) " %" }
                    td.n { (number::optional(s.dependence, 2)) }
                    td.n { @match s.generic {
                        Some([before, after]) => { (number::fixed(100.0 * before, 1)) " → " (number::fixed(100.0 * after, 1)) " %" }
                        None => "no gain",
                    } }
                }
            } }
        } }
    }
}

fn bounds(bounds: &[Bound]) -> Markup {
    html! {
        details open[bounds.len() <= 14] {
            summary { "Upper bounds: what of each effect the records leave open" }
            div.scroll { table {
                caption { "No effect of this strength or more is compatible with the records at 95 %; a weaker one could hide." }
                thead { tr { th { "Effect" } th { "Where" } th { "Parameter" } th.n { "Bound" } } }
                tbody { @for bound in bounds {
                    tr { td { (words(&bound.kind)) } td { (bound.target) } td { code { (bound.parameter) } }
                         td.n { (number::significant(bound.value)) " " (bound.unit) } }
                } }
            } }
        }
    }
}

fn structure(remainder: &Remainder) -> Markup {
    html! {
        @if remainder.edges_hz.len() > 1 { (by_frequency(remainder)) }
        @if !remainder.phases.is_empty() { (by_phase(remainder)) }
        @if !remainder.events.is_empty() { (by_event(remainder)) }
    }
}

fn by_phase(remainder: &Remainder) -> Markup {
    html! {
        div.scroll { table {
            caption { "The same by phases of the events, which end where the input has brought 5, 75 and 95 % of its energy: level, 1 where only noise is left." }
            thead { tr { th { "Sensor" } @for phase in ["Beginning", "Strong phase", "After it", "Coda"] { th.n { (phase) } } } }
            tbody { @for (sensor, levels) in &remainder.phases {
                tr { td { (sensor) } @for level in levels { td.n { (number::significant(*level)) } } }
            } }
        } }
    }
}

/// One and all levels, with room on either side.
fn level_range(levels: impl Iterator<Item = f64>) -> (f64, f64) {
    let seen = levels.filter(|v| v.is_finite() && *v > 0.0);
    let (low, high) = seen.fold((0.5, 2.0), |(a, b), v| (f64::min(a, v), f64::max(b, v)));
    (low / 1.5, high * 1.5)
}

fn by_frequency(remainder: &Remainder) -> Markup {
    // The last band is open: it is drawn as wide as the one before.
    let mut edges_hz = remainder.edges_hz.clone();
    if let [.., a, b, last] = edges_hz.as_mut_slice() {
        *last = last.min(*b + (*b - *a));
    }
    let (first, last) = (edges_hz[0], edges_hz[edges_hz.len() - 1]);
    let mut curves = vec![level_one(first, last)];
    let mut keys = Vec::new();
    for (i, (sensor, levels)) in remainder.sensors.iter().enumerate() {
        let color = chart::SERIES[i % chart::SERIES.len()];
        let dash = [None, Some("5 2"), Some("2 2")][i / chart::SERIES.len() % 3];
        let steps = levels.iter().zip(edges_hz.windows(2));
        let points = steps.flat_map(|(level, edges)| [(edges[0], *level), (edges[1], *level)]).collect();
        curves.push(Curve { points, color, width: 1.8, dash });
        keys.push(Key { name: sensor, color, dash });
    }
    let frame = Frame {
        size: (760.0, 260.0),
        x: Axis { label: "Frequency (Hz)", range: (first, last), log: false },
        y: Axis {
            label: "Level (1 = noise)",
            range: level_range(remainder.sensors.iter().flat_map(|s| s.1.iter().copied())),
            log: true,
        },
        alt: "Mean squared whitened residual over frequency, one curve a sensor; one is noise".into(),
    };
    let picture = html! { (legend(&keys)) (chart::curves(&frame, &curves, Marks::default())) };
    figure(
        &picture,
        &html! { "Structure that remains after the correction, by frequency: mean squared residual over what noise explains. Near 1 only noise is left." },
    )
}

fn level_one(first: f64, last: f64) -> Curve {
    Curve { points: vec![(first, 1.0), (last, 1.0)], color: "#5f6670", width: 1.0, dash: Some("4 3") }
}

fn by_event(remainder: &Remainder) -> Markup {
    let points: Vec<(f64, f64)> =
        remainder.events.iter().map(|(_, pga, level)| (*pga, *level)).filter(|p| p.0 > 0.0 && p.1 > 0.0).collect();
    if points.is_empty() {
        return html! {};
    }
    let (low, high) = points.iter().fold((f64::INFINITY, 0.0f64), |(a, b), p| (a.min(p.0), b.max(p.0)));
    let range = (low / 1.3, high * 1.3);
    let frame = Frame {
        size: (460.0, 260.0),
        x: Axis { label: "Peak input acceleration (g)", range, log: true },
        y: Axis { label: "Level (1 = noise)", range: level_range(points.iter().map(|p| p.1)), log: true },
        alt: "Mean squared whitened residual of each record over its peak input acceleration".into(),
    };
    let cloud = Dots { points, color: chart::NEUTRAL, shape: MarkerShape::Circle };
    let picture = chart::dots(&frame, &[cloud], &[level_one(range.0, range.1)]);
    figure(
        &picture,
        &html! { "The same record by record, over the strength of the motion: a trend would speak of nonlinearity." },
    )
}
