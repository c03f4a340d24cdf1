//! Modulus reduction and damping of the soil over shear strain, as the columns have them.

use maud::{Markup, html};

use super::chart::{self, Axis, Curve, Frame};
use super::closing::words;
use super::content::Content;
use super::figure::{Key, Section, figure, legend};
use super::models;
use super::number;
use super::site_content::SoilCurve;

/// The section, if there is a curve.
pub(super) fn section(content: &Content) -> Option<Section> {
    let all = &content.soil_curves;
    let mut depths_m: Vec<f64> = all.iter().map(|c| c.depth_m).collect();
    depths_m.sort_by(f64::total_cmp);
    depths_m.dedup();
    let shown = models::among(all.iter().map(|c| c.model.as_str()));
    if shown.is_empty() {
        return None;
    }
    let keys: Vec<Key> = shown.iter().map(models::Model::key).collect();
    let largest = all.iter().flat_map(|c| &c.damping_percent).copied().fold(1.0, f64::max);
    let pictures = html! {
        @for depth_m in &depths_m {
            @let here: Vec<&SoilCurve> = all.iter().filter(|c| c.depth_m == *depth_m).collect();
            h3 { (words(&here[0].law)) ", " (number::significant(*depth_m)) " m" }
            div.grid {
                div.picture { (panel(&here, "G/G₀", 1.05, |c| &c.modulus_ratio)) }
                div.picture { (panel(&here, "Damping ratio (%)", 1.08 * largest, |c| &c.damping_percent)) }
            }
        }
    };
    let caption = html! {
        "Secant shear modulus over the small-strain one, and damping ratio with what is declared for small strains at 1 Hz, measured on the \
         laws of the columns by cycles of each strain, at the surface, where the strongest motion strains most, and at the base."
    };
    let body = html! { (legend(&keys)) (figure(&pictures, &caption)) };
    Some(Section { id: "curves", title: "Modulus reduction and damping".into(), entries: Vec::new(), body })
}

fn panel(curves: &[&SoilCurve], label: &str, top: f64, of: fn(&SoilCurve) -> &Vec<f64>) -> Markup {
    let drawn = curves.iter().filter_map(|curve| {
        let model = models::of(&curve.model)?;
        let points = curve.strain_percent.iter().copied().zip(of(curve).iter().copied()).collect();
        Some(Curve { points, color: model.color, width: model.width + 0.6, dash: model.dash })
    });
    let strains = curves.iter().flat_map(|c| &c.strain_percent).copied();
    let (least, most) = strains.fold((f64::INFINITY, 0.0f64), |(a, b), x| (a.min(x), b.max(x)));
    let frame = Frame {
        size: (420.0, 260.0),
        x: Axis { label: "Shear strain (%)", range: (least, most), log: true },
        y: Axis { label, range: (0.0, top), log: false },
        alt: format!("{label} over shear strain at {} m", number::plain(curves[0].depth_m)),
    };
    chart::curves(&frame, &drawn.collect::<Vec<_>>(), chart::Marks::default())
}
