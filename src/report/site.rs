//! The site: soil column with velocities and sensors, what the profile says in numbers, and the events.

use maud::{Markup, PreEscaped, html};
use std::fmt::Write as _;

use super::closing::words;
use super::closing_content::NamedEffect;
use super::content::Content;
use super::figure::{Key, Section, figure, legend, listed};
use super::site_content::{ProfileView, SiteView};
use super::{models, number};

/// Size of the drawing, px.
const SIZE: [f64; 2] = [520.0, 430.0];
/// Left and right end of the column, and of the velocities, px.
const COLUMN_PX: [f64; 2] = [58.0, 150.0];
const VELOCITY_PX: [f64; 2] = [262.0, 500.0];
/// Top and bottom of both, px.
const DEPTH_PX: [f64; 2] = [14.0, 380.0];
/// Middle of the sensors, px.
const SENSOR_PX: f64 = COLUMN_PX[1] + 10.0;
/// Colours of layers by law.
const TINTS: [&str; 4] = ["#efe3cf", "#dfe6d2", "#d5dfe8", "#e8d8d8"];
/// Colour of what is named.
const MARK: &str = "#cc0033";
/// Height of a line of text, px.
const LINE_PX: f64 = 13.0;

/// The section, if the site is known.
pub(super) fn section(content: &Content) -> Option<Section> {
    let site = content.site_view.as_ref()?;
    let body = html! {
        @if !site.facts.is_empty() { dl.facts { @for (name, value) in &site.facts { dt { (name) } dd { (value) } } } }
        @if !site.events.is_empty() { h3 id="events-table" { "Events" } (events(site)) }
    };
    let entries = vec![("events-table".to_string(), "Events".to_string())];
    Some(Section { id: "site", title: "The site and its events".into(), entries, body })
}

/// The soil column beside its velocities, the places of named effects marked.
pub(super) fn picture(content: &Content) -> Option<Markup> {
    let site = content.site_view.as_ref()?;
    let keys: Vec<Key> =
        models::among(site.profiles.iter().map(|p| p.model.as_str())).into_iter().map(|m| m.key()).collect();
    let effects = content.closing.as_ref().map_or(&[][..], |closing| &closing.effects);
    let elsewhere: Vec<String> =
        effects.iter().filter(|e| place(site, e) == Place::Elsewhere).map(|e| words(&e.kind)).collect();
    let is_marked = elsewhere.len() < effects.len();
    let caption = html! {
        "Layers with their laws and sensors (● output, ▲ input, which shakes the base), and shear-wave velocity over depth"
        @if site.profiles.iter().any(|p| !p.bands.is_empty()) { ", shaded within its 95 % interval" }
        @if site.water_table_m.is_some() { "; the blue line is the water table" }
        @if is_marked { "; a named effect is marked in red where it sits" } "."
        @if !elsewhere.is_empty() { " Of the whole column or its base: " (listed(&elsewhere)) "." }
    };
    Some(html! { (legend(&keys)) (figure(&PreEscaped(column(site, effects)), &caption)) })
}

/// Where a named effect sits in the drawing.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    /// At the sensor of that number.
    Sensor(usize),
    /// Between two depths, or at one, m.
    Depths([f64; 2]),
    /// Everywhere, or at the base.
    Elsewhere,
}

fn place(site: &SiteView, effect: &NamedEffect) -> Place {
    if let Some(i) = site.sensors.iter().position(|s| s.name == effect.target) {
        return Place::Sensor(i);
    }
    let numbers: Vec<f64> =
        effect.target.split(|c: char| !(c.is_ascii_digit() || c == '.')).filter_map(|text| text.parse().ok()).collect();
    match numbers[..] {
        [depth_m] if effect.target.contains(" m") && depth_m <= site.depth_m => Place::Depths([depth_m; 2]),
        [top_m, bottom_m] if top_m < bottom_m && bottom_m <= site.depth_m => Place::Depths([top_m, bottom_m]),
        _ => Place::Elsewhere,
    }
}

/// Depth in px.
fn y_px(site: &SiteView, depth_m: f64) -> f64 {
    DEPTH_PX[0] + depth_m / site.depth_m.max(1e-9) * (DEPTH_PX[1] - DEPTH_PX[0])
}

/// A drawing in the making.
struct Drawing {
    svg: String,
}

impl Drawing {
    fn text(&mut self, x: f64, y: f64, anchor: &str, words: &str) {
        let _ = write!(self.svg, r#"<text x="{x:.1}" y="{y:.1}" font-size="12" text-anchor="{anchor}">"#);
        super::svg::escape(&mut self.svg, words);
        self.svg.push_str("</text>");
    }

    fn line(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], color: &str, width: f64) {
        let _ = write!(
            self.svg,
            r#"<path d="M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}" stroke="{color}" stroke-width="{width}" fill="none"/>"#
        );
    }
}

fn column(site: &SiteView, effects: &[NamedEffect]) -> String {
    let names: Vec<String> =
        site.sensors.iter().map(|s| format!("{} at {} m", s.name, number::plain(s.depth_m))).collect();
    let alt = format!(
        "Soil column of {} m with {} layers; sensors {}",
        number::plain(site.depth_m),
        site.layers.len(),
        names.join(", ")
    );
    let mut drawing = Drawing { svg: String::new() };
    let _ = write!(
        drawing.svg,
        r#"<svg viewBox="0 0 {} {}" width="{0}" height="{1}" {} role="img" aria-label=""#,
        SIZE[0],
        SIZE[1],
        super::svg::legible(SIZE[0])
    );
    super::svg::escape(&mut drawing.svg, &alt);
    drawing.svg.push_str("\">");
    layers(&mut drawing, site);
    sensors(&mut drawing, site);
    marks(&mut drawing, site, effects);
    velocities(&mut drawing, site);
    drawing.svg.push_str("</svg>");
    drawing.svg
}

/// Layers with their laws and depths, and the water table.
fn layers(drawing: &mut Drawing, site: &SiteView) {
    let mut laws: Vec<&str> = Vec::new();
    let mut labelled_to = DEPTH_PX[0];
    for layer in &site.layers {
        if !laws.contains(&layer.law.as_str()) {
            laws.push(&layer.law);
        }
        // Layers of one law share a tint.
        let tint = TINTS[laws.iter().position(|l| *l == layer.law).unwrap_or(0) % TINTS.len()];
        let (top, bottom) = (y_px(site, layer.top_m), y_px(site, layer.bottom_m));
        let _ = write!(
            drawing.svg,
            r##"<rect x="{}" y="{top:.1}" width="{}" height="{:.1}" fill="{tint}" stroke="#8a8f98" stroke-width=".8"/>"##,
            COLUMN_PX[0],
            COLUMN_PX[1] - COLUMN_PX[0],
            bottom - top
        );
        if bottom - top > LINE_PX {
            drawing.svg.push_str(r#"<g class="on-tint">"#);
            let x = 0.5 * (COLUMN_PX[0] + COLUMN_PX[1]);
            // The water table is not to cross the name.
            let middle = 0.5 * (top + bottom);
            let is_crossed = site.water_table_m.is_some_and(|depth_m| (y_px(site, depth_m) - middle).abs() < LINE_PX);
            let y = middle + if is_crossed && bottom - middle > LINE_PX { LINE_PX } else { 4.0 };
            drawing.text(x, y, "middle", &layer.law.replace('_', " "));
            drawing.svg.push_str("</g>");
        }
        if bottom - labelled_to > LINE_PX || layer.bottom_m >= site.depth_m {
            labelled_to = bottom;
            drawing.text(COLUMN_PX[0] - 5.0, bottom + 4.0, "end", &number::plain(layer.bottom_m));
        }
    }
    drawing.text(COLUMN_PX[0] - 5.0, DEPTH_PX[0] + 4.0, "end", "0 m");
    if let Some(depth_m) = site.water_table_m {
        let y = y_px(site, depth_m);
        drawing.line([COLUMN_PX[0] - 3.0, y], [COLUMN_PX[1] + 3.0, y], "#0072b2", 2.0);
    }
}

/// Sensors with their names, which keep a line's distance from one another.
fn sensors(drawing: &mut Drawing, site: &SiteView) {
    let mut last = f64::NEG_INFINITY;
    let mut sensors: Vec<_> = site.sensors.iter().collect();
    sensors.sort_by(|a, b| a.depth_m.total_cmp(&b.depth_m));
    for sensor in sensors {
        let (x, y) = (SENSOR_PX, y_px(site, sensor.depth_m));
        let shape = if sensor.is_input {
            format!("M{x:.1} {:.1}l5.5 10h-11z", y - 6.0)
        } else {
            format!("M{:.1} {y:.1}a5 5 0 1 0 10 0a5 5 0 1 0 -10 0z", x - 5.0)
        };
        let _ = write!(drawing.svg, r##"<path d="{shape}" fill="#d55e00"/>"##);
        last = (y + 4.0).max(last + LINE_PX);
        let cut: String = sensor.name.chars().take(12).collect();
        drawing.text(x + 9.0, last, "start", &cut);
    }
}

/// Where named effects sit.
fn marks(drawing: &mut Drawing, site: &SiteView, effects: &[NamedEffect]) {
    for effect in effects {
        match place(site, effect) {
            Place::Sensor(i) => {
                let y = y_px(site, site.sensors[i].depth_m);
                let _ = write!(
                    drawing.svg,
                    r##"<circle cx="{SENSOR_PX}" cy="{y:.1}" r="9" fill="none" stroke="{MARK}" stroke-width="2"/>"##
                );
            }
            Place::Depths([top_m, bottom_m]) => {
                let (x, top, bottom) = (COLUMN_PX[1] + 2.0, y_px(site, top_m), y_px(site, bottom_m));
                drawing.line([x, top - 1.0], [x, bottom + 1.0], MARK, 4.0);
                if top == bottom {
                    drawing.line([COLUMN_PX[0], top], [x, top], MARK, 2.5);
                }
            }
            Place::Elsewhere => {}
        }
    }
}

/// Shear-wave velocities of the models over depth.
fn velocities(drawing: &mut Drawing, site: &SiteView) {
    let of =
        |p: &ProfileView| p.tops.iter().map(|t| t[1]).chain(p.bands.iter().map(|b| b.vs_m_s[1])).fold(0.0, f64::max);
    let largest = site.profiles.iter().map(of).fold(0.0, f64::max);
    let top_m_s = nice(largest * 1.05);
    let x_px = |vs: f64| VELOCITY_PX[0] + vs / top_m_s * (VELOCITY_PX[1] - VELOCITY_PX[0]);
    drawing.line([VELOCITY_PX[0], DEPTH_PX[0]], [VELOCITY_PX[0], DEPTH_PX[1]], "#8a8f98", 1.0);
    drawing.line([VELOCITY_PX[0], DEPTH_PX[1]], [VELOCITY_PX[1], DEPTH_PX[1]], "#8a8f98", 1.0);
    for i in 0..=4 {
        let vs = top_m_s * f64::from(i) / 4.0;
        drawing.line([x_px(vs), DEPTH_PX[1]], [x_px(vs), DEPTH_PX[1] + 4.0], "#8a8f98", 1.0);
        drawing.text(x_px(vs), DEPTH_PX[1] + 18.0, "middle", &number::plain(vs));
    }
    let middle = 0.5 * (VELOCITY_PX[0] + VELOCITY_PX[1]);
    drawing.text(middle, DEPTH_PX[1] + 38.0, "middle", "Shear-wave velocity (m/s)");
    for profile in &site.profiles {
        let Some(model) = models::of(&profile.model) else { continue };
        for band in &profile.bands {
            let [low, high] = band.vs_m_s.map(x_px);
            let (top, bottom) = (y_px(site, band.top_m), y_px(site, band.bottom_m));
            let _ = write!(
                drawing.svg,
                r#"<rect x="{low:.1}" y="{top:.1}" width="{:.1}" height="{:.1}" fill="{}" fill-opacity=".18"/>"#,
                high - low,
                bottom - top,
                model.color
            );
        }
        let ends = profile.tops.iter().skip(1).map(|t| t[0]).chain([site.depth_m]);
        let mut path = String::new();
        for (i, (top, end)) in profile.tops.iter().zip(ends).enumerate() {
            let (x, y) = (x_px(top[1]), y_px(site, top[0]));
            let _ = write!(path, "{}{x:.1} {y:.1}V{:.1}", if i == 0 { 'M' } else { 'L' }, y_px(site, end));
        }
        let dash = model.dash.map(|dash| format!(r#" stroke-dasharray="{dash}""#)).unwrap_or_default();
        let _ =
            write!(drawing.svg, r#"<path d="{path}" stroke="{}" stroke-width="2"{dash} fill="none"/>"#, model.color);
    }
}

/// A round number of at least `value`.
fn nice(value: f64) -> f64 {
    let power = 10f64.powf(value.max(1.0).log10().floor());
    [1.0, 1.2, 1.6, 2.0, 2.4, 3.2, 4.0, 6.0, 8.0, 10.0]
        .into_iter()
        .map(|k| k * power)
        .find(|v| *v >= value)
        .unwrap_or(value)
}

fn events(site: &SiteView) -> Markup {
    html! {
        div.scroll { table {
            caption { "All events by name, what each was used for, and peak accelerations (g)." }
            thead { tr {
                th scope="col" { "Event" } th scope="col" { "Component" } th scope="col" { "Used for" } th.n scope="col" { "Length" }
                @for sensor in &site.sensors { th.n scope="col" { (sensor.name) } }
            } }
            tbody { @for row in &site.events { tr {
                td { (row.event) } td { (row.component) } td { (row.split) } td.n { (number::fixed(row.duration_s, 0)) " s" }
                @for pga in &row.pga_g { td.n { (number::significant(*pga)) } }
            } } }
        } }
    }
}
