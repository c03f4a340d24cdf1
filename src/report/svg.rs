//! Compact inline SVG from a kuva scene.
//!
//! kuva does layout, ticks, boxes and marks; its own SVG writer numbers clip paths from a process-wide counter (so a
//! second rendering differs), gives no `viewBox`, and spends some 20 bytes on a coordinate. This one writes the same
//! primitives with a `viewBox`, coordinates in tenths of a pixel, and no ids.

use std::fmt::Write as _;

use kuva::render::color::Color;
use kuva::render::render::{Primitive, Scene, TextAnchor};

/// The scene as one `<svg>` element that scales with its container; `alt` describes it for who cannot see it; `below` is
/// SVG drawn first, under axes and marks.
pub(super) fn write(scene: &Scene, below: &str, alt: &str) -> String {
    let mut out = String::new();
    let (width, height) = (scene.width.round(), scene.height.round());
    let _ = write!(
        out,
        r#"<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" {} role="img" aria-label=""#,
        legible(width)
    );
    escape(&mut out, alt);
    out.push_str("\">");
    out.push_str(below);
    let mut elements = scene.elements.iter().peekable();
    while let Some(element) = elements.next() {
        if let Primitive::Line { stroke, stroke_width, stroke_dasharray, .. } = element {
            let mut path = Path::default();
            path.line(element);
            while let Some(next) = elements.next_if(|next| same_pen(element, next)) {
                path.line(next);
            }
            stroke_path(&mut out, &path.d, stroke, *stroke_width, stroke_dasharray.as_deref());
        } else {
            primitive(&mut out, element);
        }
    }
    out.push_str("</svg>");
    out
}

fn primitive(out: &mut String, element: &Primitive) {
    match element {
        Primitive::PolyLine { points, stroke, stroke_width, stroke_dasharray } => {
            let mut path = Path::default();
            path.polyline(points);
            stroke_path(out, &path.d, stroke, *stroke_width, stroke_dasharray.as_deref());
        }
        Primitive::Rect { x, y, width, height, fill, opacity, .. } => {
            let mut path = Path::default();
            path.rectangle(*x, *y, *width, *height);
            fill_path(out, &path.d, fill, *opacity);
        }
        Primitive::Path(data) => {
            let fill = data.fill.as_ref().unwrap_or(&Color::None);
            let _ = write!(out, r#"<path d="{}" fill=""#, data.d);
            fill.write_svg(out);
            out.push_str("\" stroke=\"");
            data.stroke.write_svg(out);
            let _ =
                write!(out, r#"" stroke-width="{}" opacity="{}"/>"#, data.stroke_width, data.opacity.unwrap_or(1.0));
        }
        Primitive::Circle { cx, cy, r, fill, fill_opacity, .. } => dots(out, &[*cx], &[*cy], *r, fill, *fill_opacity),
        Primitive::CircleBatch { cx, cy, r, fill, fill_opacity, .. } => dots(out, cx, cy, *r, fill, *fill_opacity),
        Primitive::Text { x, y, content, size, anchor, rotate, bold, .. } => {
            let _ = write!(out, r#"<text x="{}" y="{}" font-size="{size}""#, tenths(*x), tenths(*y));
            match anchor {
                TextAnchor::Start => {}
                TextAnchor::Middle => out.push_str(r#" text-anchor="middle""#),
                TextAnchor::End => out.push_str(r#" text-anchor="end""#),
            }
            if *bold {
                out.push_str(r#" font-weight="bold""#);
            }
            if let Some(angle) = rotate {
                let _ = write!(out, r#" transform="rotate({} {} {})""#, tenths(*angle), tenths(*x), tenths(*y));
            }
            out.push('>');
            escape(out, &true_minus(content));
            out.push_str("</text>");
        }
        // Groups and clips carry nothing the report uses: curves are clipped before they are drawn.
        _ => {}
    }
}

fn dots(out: &mut String, cx: &[f64], cy: &[f64], r: f64, fill: &Color, opacity: Option<f64>) {
    out.push_str("<g fill=\"");
    fill.write_svg(out);
    let _ = write!(out, r#"" fill-opacity="{}">"#, opacity.unwrap_or(1.0));
    for (x, y) in cx.iter().zip(cy) {
        let _ = write!(out, r#"<circle cx="{}" cy="{}" r="{}"/>"#, tenths(*x), tenths(*y), tenths(r));
    }
    out.push_str("</g>");
}

fn same_pen(a: &Primitive, b: &Primitive) -> bool {
    match (a, b) {
        (
            Primitive::Line { stroke: s1, stroke_width: w1, stroke_dasharray: d1, .. },
            Primitive::Line { stroke: s2, stroke_width: w2, stroke_dasharray: d2, .. },
        ) => s1.to_svg_string() == s2.to_svg_string() && w1 == w2 && d1 == d2,
        _ => false,
    }
}

fn stroke_path(out: &mut String, d: &str, stroke: &Color, width: f64, dash: Option<&str>) {
    let _ = write!(out, r#"<path d="{d}" fill="none" stroke=""#);
    stroke.write_svg(out);
    let _ = write!(out, r#"" stroke-width="{width}" stroke-linejoin="round""#);
    if let Some(dash) = dash {
        out.push_str(" stroke-dasharray=\"");
        escape(out, dash);
        out.push('"');
    }
    out.push_str("/>");
}

fn fill_path(out: &mut String, d: &str, fill: &Color, opacity: Option<f64>) {
    let _ = write!(out, r#"<path d="{d}" fill=""#);
    fill.write_svg(out);
    out.push('"');
    if let Some(opacity) = opacity {
        let _ = write!(out, r#" fill-opacity="{opacity}""#);
    }
    out.push_str("/>");
}

/// Path data in tenths of a pixel; steps are differences of rounded positions, so that rounding never adds up.
#[derive(Default)]
struct Path {
    d: String,
}

impl Path {
    fn line(&mut self, element: &Primitive) {
        if let Primitive::Line { x1, y1, x2, y2, .. } = element {
            self.polyline(&[(*x1, *y1), (*x2, *y2)]);
        }
    }

    fn polyline(&mut self, points: &[(f64, f64)]) {
        let mut last = (0, 0);
        for (i, &(x, y)) in points.iter().enumerate() {
            let now = ((x * 10.0).round() as i64, (y * 10.0).round() as i64);
            if i == 0 {
                self.command('M', &[now.0, now.1]);
            } else if now != last {
                self.command('l', &[now.0 - last.0, now.1 - last.1]);
            }
            last = now;
        }
    }

    fn rectangle(&mut self, x: f64, y: f64, width: f64, height: f64) {
        let edge = |v: f64| (v * 10.0).round() as i64;
        let (left, top, right, bottom) = (edge(x), edge(y), edge(x + width), edge(y + height));
        self.command('M', &[left, top]);
        self.command('h', &[right - left]);
        self.command('v', &[bottom - top]);
        self.command('h', &[left - right]);
        self.d.push('z');
    }

    /// One command with its numbers given in tenths, in the shortest form that parses: `l1.2-3.4`.
    fn command(&mut self, letter: char, numbers: &[i64]) {
        self.d.push(letter);
        for (i, &tenths) in numbers.iter().enumerate() {
            if i > 0 && tenths >= 0 {
                self.d.push(' ');
            }
            if tenths < 0 {
                self.d.push('-');
            }
            let (whole, rest) = (tenths.unsigned_abs() / 10, tenths.unsigned_abs() % 10);
            if whole > 0 || rest == 0 {
                let _ = write!(self.d, "{whole}");
            }
            if rest > 0 {
                let _ = write!(self.d, ".{rest}");
            }
        }
    }
}

fn tenths(value: f64) -> f64 {
    let rounded = (value * 10.0).round() / 10.0;
    if rounded == 0.0 { 0.0 } else { rounded }
}

/// Numbers get a true minus sign; other text stays as it is.
fn true_minus(text: &str) -> String {
    match text.strip_prefix('-') {
        Some(rest) if rest.starts_with(|c: char| c.is_ascii_digit()) => format!("−{rest}"),
        _ => text.into(),
    }
}

/// The attribute that keeps a figure of this width from shrinking until its text of 12 px is under 9 px.
pub(super) fn legible(width: f64) -> String {
    format!(r#"style="min-width:{:.0}px""#, (0.75 * width).ceil())
}

/// Appends `text` so that it is text in SVG and HTML.
pub(super) fn escape(out: &mut String, text: &str) {
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            // Characters that no HTML document may hold.
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polylines_are_short_and_do_not_drift() {
        let mut path = Path::default();
        path.polyline(&[(1.0, 2.0), (1.14, 1.96), (1.28, 1.92), (1.42, -0.5)]);
        assert_eq!(path.d, "M1 2l.1 0l.2-.1l.1-2.4");
    }

    #[test]
    fn text_is_escaped() {
        let mut out = String::new();
        escape(&mut out, "<b a=\"&\">\u{0}");
        assert_eq!(out, "&lt;b a=&quot;&amp;&quot;&gt; ");
    }
}
