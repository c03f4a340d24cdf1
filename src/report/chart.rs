//! The kinds of figure the report draws: curves, boxes, dots and heat maps, all in one style.

use std::iter::repeat_n;
use std::sync::Arc;

use kuva::plot::annotations::{ReferenceLine, ShadedRegion};
use kuva::plot::scatter::MarkerShape;
use kuva::plot::{BoxPlot, LinePlot, LineStyle, ScatterPlot};
use kuva::render::layout::{AxisLabelOverlap, Layout, TickFormat};
use kuva::render::plots::Plot;
use kuva::render::render::render_multiple;
use kuva::render::theme::Theme;
use maud::{Markup, PreEscaped};

use super::{bitmap, number, svg, thin};

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

const MARGINS: [f64; 4] = [62.0, 12.0, 10.0, 46.0];

fn layout(frame: &Frame) -> Layout {
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

/// Curves over a common frame, thinned to its width and cut at its upper and lower edge.
pub(super) fn curves(frame: &Frame, curves: &[Curve], marks: Marks) -> Markup {
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
            let mut line = LinePlot::new().with_data(piece).with_color(curve.color).with_stroke_width(curve.width);
            if let Some(dash) = curve.dash {
                line = line.with_line_style(LineStyle::Custom(dash.into()));
            }
            plots.push(line.into());
        }
    }
    let mut layout = layout(frame);
    if let Some(x) = marks.at.filter(|x| inside(*x, frame.x.range)) {
        layout = layout.with_reference_line(ReferenceLine::vertical(x).with_color("#5f6670").with_dasharray("3 3"));
    }
    if let Some((from, to)) = marks.span {
        layout = layout.with_shaded_region(ShadedRegion::vertical(from, to).with_color("#5b7f95").with_opacity(0.13));
    }
    draw(plots, layout, &frame.alt)
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

/// A diverging colour scale through white: blue for negative, red for positive, full at `±limit`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Diverging {
    pub limit: f64,
    /// Colour grows with `|v|^power`: 1 is linear, ½ shows small values too.
    pub power: f64,
}

impl Diverging {
    /// Levels on either side of white.
    const LEVELS: i32 = 100;

    /// Level of a value from −100 to 100; zero only for exactly nothing; none where there is no number.
    fn level(&self, value: f64) -> Option<i32> {
        if !value.is_finite() {
            return None;
        }
        let share = if self.limit > 0.0 { (value.abs() / self.limit).min(1.0).powf(self.power) } else { 0.0 };
        let level = (share * f64::from(Self::LEVELS)).ceil() as i32;
        Some(if value < 0.0 { -level } else { level })
    }

    fn shade(level: i32) -> [u8; 3] {
        let stops: [[f64; 3]; 4] = if level < 0 {
            [[255.0; 3], [146.0, 197.0, 222.0], [33.0, 102.0, 172.0], [5.0, 34.0, 80.0]]
        } else {
            [[255.0; 3], [244.0, 165.0, 130.0], [178.0, 24.0, 43.0], [84.0, 0.0, 24.0]]
        };
        let position = f64::from(level.abs()) / f64::from(Self::LEVELS) * 3.0;
        let lower = (position.floor() as usize).min(2);
        let mix = position - lower as f64;
        std::array::from_fn(|i| (stops[lower][i] * (1.0 - mix) + stops[lower + 1][i] * mix).round() as u8)
    }

    /// All colours in the order of [`Self::index`], grey last.
    fn palette() -> Vec<[u8; 3]> {
        (-Self::LEVELS..=Self::LEVELS).map(Self::shade).chain([[154, 160, 166]]).collect()
    }

    fn index(&self, value: f64) -> u8 {
        self.level(value).map_or(2 * Self::LEVELS + 1, |level| level + Self::LEVELS) as u8
    }

    /// Colour of a value for the colour bar.
    pub(super) fn color(&self, value: f64) -> String {
        let [red, green, blue] = Self::palette()[usize::from(self.index(value))];
        format!("#{red:02x}{green:02x}{blue:02x}")
    }
}

/// A heat map `[row][column]` that fills the frame's ranges, first row at the bottom.
pub(super) fn heat(frame: &Frame, rows: &[Vec<f64>], scale: Diverging, look: HeatLook) -> Markup {
    // A matrix has few cells: each gets several pixels, so that a viewer that smooths bitmaps keeps its edges.
    let repeat = if matches!(look, HeatLook::Matrix { .. }) { 4 } else { 1 };
    let wide = |row: &Vec<f64>| row.iter().flat_map(|v| repeat_n(scale.index(*v), repeat)).collect::<Vec<u8>>();
    let pixels: Vec<Vec<u8>> = rows.iter().flat_map(|row| repeat_n(wide(row), repeat)).collect();
    let mut layout = layout(frame).with_show_grid(false).with_x_label_overlap(AxisLabelOverlap::Allow);
    let [left, right, top, mut bottom] = MARGINS;
    match look {
        HeatLook::Depth => layout = layout.with_y_tick_format(TickFormat::Custom(Arc::new(|v| number::plain(v.abs())))),
        HeatLook::Matrix { row_names, column_names } => {
            layout =
                layout.with_y_categories(row_names).with_tick_length(0.0).with_tick_size(9).with_x_tick_rotate(-90.0);
            layout.suppress_x_ticks = column_names.is_none();
            match column_names {
                Some(names) => layout = layout.with_x_categories(names),
                None => bottom = top,
            }
            layout = layout.with_force_margins_y(top, bottom);
        }
    }
    let image = format!(
        r#"<image x="{left}" y="{top}" width="{}" height="{}" preserveAspectRatio="none" href="{}"/>"#,
        frame.size.0 - left - right,
        frame.size.1 - top - bottom,
        bitmap::data_url(&pixels, &Diverging::palette())
    );
    let nothing: Vec<Plot> = vec![LinePlot::new().with_data(Vec::<(f64, f64)>::new()).into()];
    PreEscaped(svg::write(&render_multiple(nothing, layout), &image, &frame.alt))
}

/// What the axes of a heat map carry.
pub(super) enum HeatLook {
    /// Depth downwards: the frame's y runs over negative depths.
    Depth,
    /// Names of rows (bottom first) and, below the last matrix of a set, of columns.
    Matrix { row_names: Vec<String>, column_names: Option<Vec<String>> },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_zero_is_white_signs_differ_and_gaps_are_grey() {
        let scale = Diverging { limit: 2.0, power: 0.5 };
        assert_eq!(scale.color(0.0), "#ffffff");
        assert_ne!(scale.color(1e-9), "#ffffff");
        assert_ne!(scale.color(1e-9), scale.color(-1e-9));
        assert_eq!(scale.color(5.0), scale.color(2.0), "beyond the limit the colour stays full");
        assert_eq!(scale.color(f64::NAN), "#9aa0a6");
        assert!(Diverging::palette().len() <= 256);
    }

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
