//! Heat maps with a diverging colour scale: acceleration over depth and time, and coefficient matrices.

use std::iter::repeat_n;
use std::sync::Arc;

use kuva::plot::LinePlot;
use kuva::render::layout::{AxisLabelOverlap, TickFormat};
use kuva::render::plots::Plot;
use kuva::render::render::render_multiple;
use maud::{Markup, PreEscaped};

use super::chart::{Frame, MARGINS, layout};
use super::{bitmap, number, svg};

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
                layout.with_y_categories(row_names).with_tick_length(0.0).with_tick_size(12).with_x_tick_rotate(-90.0);
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
}
