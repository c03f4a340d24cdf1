//! The kinds of figure the report draws: curves, boxes and dots, all in one style (heat maps stand in `heat`).

use std::fmt::Write as _;
use std::sync::Arc;

use kuva::plot::annotations::{ReferenceLine, ShadedRegion};
use kuva::plot::scatter::MarkerShape;
use kuva::plot::{BoxPlot, LinePlot, LineStyle, ScatterPlot};
use kuva::render::layout::{AxisLabelOverlap, Layout, TickFormat};
use kuva::render::plots::Plot;
use kuva::render::render::render_multiple;
use kuva::render::theme::Theme;
use maud::{Markup, PreEscaped};

use super::{number, svg, thin};

/// Record, finite elements and FLARE-T everywhere: black, vermilion, blue (Okabe and Ito), apart in lightness as well.
pub(super) const RECORD: &str = "#1b1b1b";
/// Finite elements.
pub(super) const FE: &str = "#d55e00";
/// FLARE-T.
pub(super) const FLARE_T: &str = "#0072b2";
/// Boxes that belong to no model.
pub(super) const NEUTRAL: &str = "#5b7f95";
/// Further curves, told apart by dash as well.
pub(super) const SERIES: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#8a5a9e", "#1b1b1b", "#b8860b", "#56b4e9"];

/// One axis: what it shows with its unit, from where to where.
pub(super) struct Axis<'a> {
    pub label: &'a str,
    pub range: (f64, f64),
    pub log: bool,
}

/// Size and axes of a figure, and its description for who cannot see it.
pub(super) struct Frame<'a> {
    pub size: (f64, f64),
    pub x: Axis<'a>,
    pub y: Axis<'a>,
    pub alt: String,
}

/// A curve: its points, colour, width in pixels and dash.
pub(super) struct Curve {
    pub points: Vec<(f64, f64)>,
    pub color: &'static str,
    pub width: f64,
    pub dash: Option<&'static str>,
}

/// A box or a gap: the group it belongs to (written below), its values, its colour.
pub(super) struct Column<'a> {
    pub label: &'a str,
    pub values: &'a [f64],
    pub color: &'static str,
}

/// A cloud of dots of one kind.
pub(super) struct Dots {
    pub points: Vec<(f64, f64)>,
    pub color: &'static str,
    pub shape: MarkerShape,
}

/// Left, right, top, bottom, in pixels.
pub(super) const MARGINS: [f64; 4] = [62.0, 12.0, 10.0, 46.0];

/// The common style of all figures over a given frame.
pub(super) fn layout(frame: &Frame) -> Layout {
    let theme = Theme {
        axis_color: "#8a8f98".into(),
        grid_color: "#e7e9ec".into(),
        tick_color: "#8a8f98".into(),
        box_median: "#ffffff".into(),
        ..Theme::light()
    };
    let [left, right, top, bottom] = MARGINS;
    let mut layout = Layout::new(frame.x.range, frame.y.range)
        .with_width(frame.size.0)
        .with_height(frame.size.1)
        .with_x_label(frame.x.label)
        .with_y_label(frame.y.label)
        .with_x_axis_min(frame.x.range.0)
        .with_x_axis_max(frame.x.range.1)
        .with_y_axis_min(frame.y.range.0)
        .with_y_axis_max(frame.y.range.1)
        .with_force_margins(left, right)
        .with_force_margins_y(top, bottom)
        .with_label_size(13)
        .with_tick_size(12)
        .with_theme(theme);
    if frame.x.log {
        layout = layout.with_log_x().with_x_tick_format(log_ticks(frame.x.range));
    }
    if frame.y.log {
        layout = layout.with_log_y().with_y_tick_format(log_ticks(frame.y.range));
    }
    layout.show_colorbar = false;
    layout.show_legend = false;
    layout
}

/// Plain numbers where they are short, powers of ten beyond.
fn log_ticks(range: (f64, f64)) -> TickFormat {
    let plain = range.0 >= 0.0009 && range.1 <= 2e4 && range.1 / range.0 < 3e3;
    TickFormat::Custom(Arc::new(move |v| if plain { number::plain(v) } else { number::power_of_ten(v) }))
}

fn draw(plots: Vec<Plot>, layout: Layout, alt: &str) -> Markup {
    PreEscaped(svg::write(&render_multiple(plots, layout), "", alt))
}

/// What a figure of curves points out along x.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Marks {
    /// One value, as a dashed line.
    pub at: Option<f64>,
    /// A span, shaded.
    pub span: Option<(f64, f64)>,
}

/// Curves over a common frame with what a pointer held over a place along x reads.
pub(super) fn curves_with_hints(frame: &Frame, curves: &[Curve], hints: &[(f64, String)]) -> Markup {
    let [left, right, top, bottom] = MARGINS;
    let place = |x: f64| {
        let at = |v: f64| if frame.x.log { v.ln() } else { v };
        let share = (at(x) - at(frame.x.range.0)) / (at(frame.x.range.1) - at(frame.x.range.0));
        left + share.clamp(0.0, 1.0) * (frame.size.0 - left - right)
    };
    let middle = |i: usize| 0.5 * (place(hints[i].0) + place(hints[i + 1].0));
    let mut below = String::new();
    for (i, (x, words)) in hints.iter().enumerate() {
        let from = if i == 0 { place(*x) } else { middle(i - 1) };
        let to = if i + 1 == hints.len() { place(*x) } else { middle(i) };
        let (width, height) = (to - from, frame.size.1 - top - bottom);
        let _ =
            write!(below, r#"<rect class="hint" x="{from:.1}" y="{top}" width="{width:.1}" height="{height}"><title>"#);
        svg::escape(&mut below, words);
        below.push_str("</title></rect>");
    }
    drawn(frame, curves, Marks::default(), &below)
}

/// Curves over depth: the frame's y runs over negative depths.
pub(super) fn curves_over_depth(frame: &Frame, curves: &[Curve]) -> Markup {
    let plots = curves.iter().map(|curve| line(curve, curve.points.clone()).into()).collect();
    let layout = layout(frame).with_y_tick_format(TickFormat::Custom(Arc::new(|v| number::plain(v.abs()))));
    draw(plots, layout, &frame.alt)
}

/// A curve that goes back and forth along x, such as a loop of stress over strain, thinned to the resolution of its frame.
pub(super) fn path(frame: &Frame, curve: &Curve) -> Markup {
    let [width, height] = [frame.size.0 - MARGINS[0] - MARGINS[1], frame.size.1 - MARGINS[2] - MARGINS[3]];
    let pixel = |(x, y): (f64, f64)| {
        let place = |v: f64, (low, high): (f64, f64), size: f64| ((v - low) / (high - low) * size * 2.0).round() as i64;
        (place(x, frame.x.range, width), place(y, frame.y.range, height))
    };
    let mut points: Vec<(f64, f64)> =
        curve.points.iter().copied().filter(|p| p.0.is_finite() && p.1.is_finite()).collect();
    points.dedup_by_key(|p| pixel(*p));
    draw(vec![line(curve, points).into()], layout(frame), &frame.alt)
}

fn line(curve: &Curve, points: Vec<(f64, f64)>) -> LinePlot {
    let line = LinePlot::new().with_data(points).with_color(curve.color).with_stroke_width(curve.width);
    match curve.dash {
        Some(dash) => line.with_line_style(LineStyle::Custom(dash.into())),
        None => line,
    }
}

/// Curves over a common frame, thinned to its width and cut at its upper and lower edge.
pub(super) fn curves(frame: &Frame, curves: &[Curve], marks: Marks) -> Markup {
    drawn(frame, curves, marks, "")
}

fn drawn(frame: &Frame, curves: &[Curve], marks: Marks, below: &str) -> Markup {
    let inside = |v: f64, (low, high): (f64, f64)| v >= low && v <= high;
    let mut plots = Vec::new();
    for curve in curves {
        let points: Vec<(f64, f64)> = curve
            .points
            .iter()
            .filter(|p| inside(p.0, frame.x.range) && !(frame.y.log && p.1 <= 0.0))
            .map(|&(x, y)| (x, y.clamp(frame.y.range.0, frame.y.range.1)))
            .collect();
        for piece in thin::curve(&points, (frame.size.0 - MARGINS[0] - MARGINS[1]) as usize) {
            plots.push(line(curve, piece).into());
        }
    }
    let mut layout = layout(frame);
    if let Some(x) = marks.at.filter(|x| inside(*x, frame.x.range)) {
        layout = layout.with_reference_line(ReferenceLine::vertical(x).with_color("#5f6670").with_dasharray("3 3"));
    }
    if let Some((from, to)) = marks.span {
        layout = layout.with_shaded_region(ShadedRegion::vertical(from, to).with_color("#5b7f95").with_opacity(0.13));
    }
    PreEscaped(svg::write(&render_multiple(plots, layout), below, &frame.alt))
}

/// Boxes side by side, with an optional shaded band of values; `tilt` turns the labels below by so many degrees.
pub(super) fn boxes(
    frame: &Frame,
    columns: &[Column],
    band: Option<(f64, f64)>,
    width: f64,
    tilt: Option<f64>,
) -> Markup {
    let mut plot = BoxPlot::new().with_width(width).with_group_colors(columns.iter().map(|c| c.color));
    for column in columns {
        let finite: Vec<f64> = column.values.iter().copied().filter(|v| v.is_finite()).collect();
        plot = plot.with_group(column.label, finite);
    }
    let mut layout = layout(frame).with_x_categories(columns.iter().map(|c| c.label.to_owned()).collect());
    layout = layout.with_tick_length(0.0).with_x_label_overlap(AxisLabelOverlap::Allow);
    if let Some(angle) = tilt {
        layout = layout.with_x_tick_rotate(angle);
    }
    if let Some((low, high)) = band {
        let (low, high) = (low.max(frame.y.range.0), high.min(frame.y.range.1));
        layout =
            layout.with_shaded_region(ShadedRegion::horizontal(low, high).with_color("#f0c94a").with_opacity(0.28));
    }
    draw(vec![plot.into()], layout, &frame.alt)
}

/// The range of boxes from zero to just above the highest upper whisker.
pub(super) fn box_range<'a>(samples: impl IntoIterator<Item = &'a [f64]>, at_least: f64) -> (f64, f64) {
    let mut top = at_least;
    for values in samples {
        let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        if sorted.is_empty() {
            continue;
        }
        let quantile = |q: f64| sorted[((sorted.len() - 1) as f64 * q).ceil() as usize];
        let fence = quantile(0.75) + 1.5 * (quantile(0.75) - quantile(0.25));
        top = top.max(sorted.iter().copied().filter(|v| *v <= fence).fold(quantile(0.75), f64::max));
    }
    (0.0, if top > 0.0 { top * 1.06 } else { 1.0 })
}

/// Clouds of dots, with curves (a line of equality) below them.
pub(super) fn dots(frame: &Frame, clouds: &[Dots], below: &[Curve]) -> Markup {
    let mut plots: Vec<Plot> = Vec::new();
    for curve in below {
        let style = LineStyle::Custom(curve.dash.unwrap_or("none").into());
        let line = LinePlot::new().with_data(curve.points.clone()).with_color(curve.color);
        plots.push(line.with_stroke_width(curve.width).with_line_style(style).into());
    }
    for cloud in clouds.iter().filter(|cloud| !cloud.points.is_empty()) {
        let plot = ScatterPlot::new().with_data(cloud.points.clone()).with_color(cloud.color).with_size(4.5);
        plots.push(plot.with_marker(cloud.shape).with_marker_opacity(0.85).into());
    }
    draw(plots, layout(frame), &frame.alt)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_fit_their_upper_whiskers_not_their_outliers() {
        let mut values: Vec<f64> = (0..100).map(|i| 10.0 + f64::from(i) * 0.1).collect();
        values.push(1e6);
        values.push(f64::NAN);
        let (low, high) = box_range([values.as_slice()], 0.0);
        assert_eq!(low, 0.0);
        assert!((19.9..23.0).contains(&high), "{high}");
        assert_eq!(box_range([[].as_slice()], 26.0).1, 26.0 * 1.06);
    }
}
