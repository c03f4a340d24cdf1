//! Histories and spectra of one sensor; used for stage 2 and for the held-out events.

use maud::{Markup, html};

use super::chart::{self, Axis, Curve, Frame, Marks};
use super::content::{Series, Spectrum, Trace};
use super::number;

/// What the rows of one figure share.
pub(super) struct Look {
    /// Where the traces come from, for the description: "in LSST07 EW".
    pub about: String,
    /// The strong part, shown enlarged, s; `None` if the histories are short.
    pub strong_s: Option<(f64, f64)>,
    /// Periods of the spectra, s.
    pub periods_s: (f64, f64),
}

/// The rows of one sensor: heading with errors, history, strong part beside the spectrum.
pub(super) fn row(trace: &Trace, look: &Look, note: &Markup) -> Markup {
    let spectrum = trace.spectrum.as_ref().map(|spectrum| spectra(spectrum, trace, look));
    html! {
        div.sensor {
            h4 {
                (trace.sensor)
                @if let Some(depth) = trace.depth_m {
                    " " span.soft { @if depth == 0.0 { "surface" } @else { (number::plain(depth)) " m deep" } }
                }
                (note)
            }
            @if let Some(strong) = look.strong_s {
                div.picture { (history(trace, look, None, (1000.0, 180.0))) }
                div.pair {
                    div.picture { (history(trace, look, Some(strong), (600.0, 200.0))) }
                    @if let Some(picture) = spectrum { div.picture { (picture) } }
                }
            } @else {
                div.pair {
                    div.picture { (history(trace, look, None, (600.0, 200.0))) }
                    @if let Some(picture) = spectrum { div.picture { (picture) } }
                }
            }
        }
    }
}

/// The ten seconds that hold most of the energy of the last sensor (the uppermost as sensors are listed from below), if
/// the history is at least twice as long.
pub(super) fn strong_part(traces: &[Trace]) -> Option<(f64, f64)> {
    const LENGTH_S: f64 = 10.0;
    let series = traces.iter().rev().find_map(|t| t.record.as_ref().or(t.fe.as_ref()))?;
    let n = (LENGTH_S / series.step_s).round() as usize;
    if n == 0 || series.values.len() < 2 * n {
        return None;
    }
    let energy = |i: usize| if series.values[i].is_finite() { series.values[i].powi(2) } else { 0.0 };
    let mut sum: f64 = (0..n).map(energy).sum();
    let (mut best, mut start) = (sum, 0);
    for i in n..series.values.len() {
        sum += energy(i) - energy(i - n);
        if sum > best {
            (best, start) = (sum, i + 1 - n);
        }
    }
    // Whole seconds read better on the axis.
    let from = (series.start_s + start as f64 * series.step_s).floor().max(series.start_s);
    Some((from, from + LENGTH_S))
}

/// Record, FE and FLARE-T in the order they are drawn, thick to thin.
fn of_models<T: ?Sized>(trace: [Option<&T>; 3]) -> Vec<(&T, &'static str, f64)> {
    let pens = [(chart::RECORD, 1.5), (chart::FE, 1.0), (chart::FLARE_T, 1.0)];
    trace.into_iter().zip(pens).filter_map(|(series, (color, width))| Some((series?, color, width))).collect()
}

/// The peak of a series over its finite samples.
pub(super) fn peak(series: &Series) -> f64 {
    series.values.iter().filter(|v| v.is_finite()).fold(0.0, |top, v| v.abs().max(top))
}

/// Largest ordinate shown: a prediction beyond three times the record's peak runs out of the figure.
fn limit(trace: &Trace) -> f64 {
    let all = [&trace.record, &trace.fe, &trace.flare_t].into_iter().flatten().map(peak).fold(0.0, f64::max);
    let reference = trace.record.as_ref().or(trace.fe.as_ref()).map_or(all, peak);
    let top = if reference > 0.0 { all.min(3.0 * reference) } else { all };
    if top > 0.0 { top * 1.05 } else { 1.0 }
}

/// Whether some prediction runs out of the figure or stops being a number.
pub(super) fn is_cut(trace: &Trace) -> bool {
    let series = [&trace.record, &trace.fe, &trace.flare_t];
    let broken = |s: &&Series| peak(s) > limit(trace) || s.values.iter().any(|v| !v.is_finite());
    series.into_iter().flatten().any(|s| broken(&s))
}

fn history(trace: &Trace, look: &Look, part_s: Option<(f64, f64)>, size: (f64, f64)) -> Markup {
    let series = of_models([trace.record.as_ref(), trace.fe.as_ref(), trace.flare_t.as_ref()]);
    let end = |s: &Series| s.start_s + s.step_s * s.values.len().saturating_sub(1) as f64;
    let first = series.iter().map(|(s, ..)| s.start_s).fold(f64::INFINITY, f64::min);
    let last = series.iter().map(|(s, ..)| end(s)).fold(f64::NEG_INFINITY, f64::max);
    if last <= first {
        return html! { p.soft { "No history." } };
    }
    let top = limit(trace);
    let curves: Vec<Curve> = series
        .iter()
        .map(|(s, color, width)| Curve {
            points: s.values.iter().enumerate().map(|(i, v)| (s.start_s + i as f64 * s.step_s, *v)).collect(),
            color,
            width: *width,
            dash: None,
        })
        .collect();
    let peaks: Vec<String> = series.iter().map(|(s, ..)| number::significant(peak(s))).collect();
    let marks = Marks { at: None, span: if part_s.is_none() { look.strong_s } else { None } };
    let frame = Frame {
        size,
        x: Axis { label: "Time (s)", range: part_s.unwrap_or((first, last)), log: false },
        y: Axis { label: "Acc. (m/s²)", range: (-top, top), log: false },
        alt: format!(
            "Acceleration histories at {} {}{}; peaks {} m/s²",
            trace.sensor,
            look.about,
            if part_s.is_some() { ", strong part" } else { "" },
            peaks.join(", ")
        ),
    };
    chart::curves(&frame, &curves, marks)
}

fn spectra(spectrum: &Spectrum, trace: &Trace, look: &Look) -> Markup {
    let lists = [&spectrum.record_m_s2, &spectrum.fe_m_s2, &spectrum.flare_t_m_s2];
    let some = lists.map(|list| (!list.is_empty()).then_some(list.as_slice()));
    let finite_top = |list: &[f64]| list.iter().copied().filter(|v| v.is_finite()).fold(0.0, f64::max);
    let reference = some.iter().flatten().next().map_or(0.0, |list| finite_top(list));
    let top = some.iter().flatten().map(|list| finite_top(list)).fold(0.0, f64::max);
    let top = if reference > 0.0 { top.min(3.0 * reference) } else { top };
    let curves: Vec<Curve> = of_models(some)
        .into_iter()
        .map(|(list, color, width)| Curve {
            points: spectrum.period_s.iter().copied().zip(list.iter().copied()).collect(),
            color,
            width: width + 0.5,
            dash: (color == chart::FE).then_some("6 3"),
        })
        .collect();
    let frame = Frame {
        size: (400.0, 200.0),
        x: Axis { label: "Period (s)", range: look.periods_s, log: true },
        y: Axis { label: "5 % PSA (m/s²)", range: (0.0, if top > 0.0 { top * 1.07 } else { 1.0 }), log: false },
        alt: format!("5 % damped pseudo-acceleration spectra at {} {}", trace.sensor, look.about),
    };
    chart::curves(&frame, &curves, Marks::default())
}

/// The common range of periods of a set of traces, 0.1 to 5 s if there are none.
pub(super) fn period_range<'a>(traces: impl IntoIterator<Item = &'a Trace>) -> (f64, f64) {
    let mut range = (f64::INFINITY, 0.0_f64);
    for period in traces.into_iter().filter_map(|t| t.spectrum.as_ref()).flat_map(|s| &s.period_s) {
        range = (range.0.min(*period), range.1.max(*period));
    }
    if range.1 > range.0 { range } else { (0.1, 5.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace(values: Vec<f64>) -> Trace {
        Trace { record: Some(Series { start_s: 0.0, step_s: 0.1, values }), ..Trace::default() }
    }

    #[test]
    fn the_strong_part_holds_the_energy() {
        let values = (0..600).map(|i| if (250..330).contains(&i) { 1.0 } else { 0.01 }).collect();
        let (from, to) = strong_part(&[trace(values)]).unwrap();
        assert!(from <= 25.0 && to >= 33.0 && (to - from - 10.0).abs() < 1e-9, "{from} to {to} s");
        assert_eq!(strong_part(&[trace(vec![1.0; 150])]), None, "a short history needs no enlargement");
    }

    #[test]
    fn a_runaway_prediction_does_not_flatten_the_record() {
        let mut one = trace(vec![0.0, 1.0, -1.0, 0.5]);
        assert!(!is_cut(&one));
        one.flare_t = Some(Series { start_s: 0.0, step_s: 0.1, values: vec![0.0, 1e9, f64::NAN, 0.0] });
        assert!(is_cut(&one) && limit(&one) <= 3.0 * 1.05);
    }
}
