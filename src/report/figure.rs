//! The frame of every figure: picture, legend and caption; and the section around them.

use maud::{Markup, PreEscaped, html};

use super::chart;
use super::heat::Diverging;
use super::number;

/// A section of the page: its anchor, its title, entries below it in the table of contents, and what it holds.
pub(super) struct Section {
    pub id: &'static str,
    pub title: String,
    pub entries: Vec<(String, String)>,
    pub body: Markup,
}

/// A figure with what to see in it.
pub(super) fn figure(picture: &Markup, caption: &Markup) -> Markup {
    html! { figure { div.picture { (picture) } figcaption { (caption) } } }
}

/// What a legend shows for one curve.
pub(super) struct Key<'a> {
    pub name: &'a str,
    pub color: &'a str,
    pub dash: Option<&'a str>,
}

/// A piece of a curve, for a legend.
pub(super) fn swatch(color: &str, dash: Option<&str>) -> Markup {
    html! {
        svg viewBox="0 0 26 10" width="26" height="10" aria-hidden="true" {
            path d="M1 5H25" stroke=(color) stroke-width="2.6" stroke-dasharray=[dash] {}
        }
    }
}

/// A legend of curves.
pub(super) fn legend(keys: &[Key]) -> Markup {
    html! {
        ul.legend {
            @for key in keys {
                li {
                    (swatch(key.color, key.dash))
                    (key.name)
                }
            }
        }
    }
}

/// The keys of the models that appear; `record` names the reference.
pub(super) fn model_keys<'a>(record: Option<&'a str>, fe: bool, flare_t: bool) -> Vec<Key<'a>> {
    let record = record.map(|name| Key { name, color: chart::RECORD, dash: None });
    let fe = fe.then_some(Key { name: "FE", color: chart::FE, dash: Some("5 2") });
    let flare_t = flare_t.then_some(Key { name: "FLARE-T", color: chart::FLARE_T, dash: None });
    record.into_iter().chain(fe).chain(flare_t).collect()
}

/// A horizontal colour bar from `-limit` to `limit`, ticks where the colours are.
pub(super) fn color_bar(scale: Diverging, label: &str) -> Markup {
    let ticks = [-1.0, -0.5, 0.0, 0.5, 1.0];
    let value = |place: f64| place.signum() * place.abs().powf(1.0 / scale.power) * scale.limit;
    let mut cells = String::new();
    for i in 0..66 {
        let place = (f64::from(i) + 0.5) / 33.0 - 1.0;
        cells += &format!(r#"<rect x="{}" width="5" height="12" fill="{}"/>"#, 30 + i * 5, scale.color(value(place)));
    }
    html! {
        div.colorbar {
            svg viewBox="0 0 390 32" width="390" height="32" role="img" aria-label={ "Colour scale, " (label) } {
                (PreEscaped(cells))
                @for tick in ticks {
                    text x=(195.0 + tick * 165.0) y="27" font-size="11" text-anchor="middle" {
                        (if tick == 0.0 { "0".into() } else { number::significant(value(tick)) })
                    }
                }
            }
            span { (label) }
        }
    }
}

/// Words joined as in a sentence, "a, b and c"; of a long list only the first six and how many more.
pub(super) fn listed(words: &[String]) -> String {
    match words {
        many if many.len() > 7 => format!("{} and {} more", many[..6].join(", "), many.len() - 6),
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_read_as_sentences_and_do_not_run_on() {
        let words: Vec<String> = ('a'..='i').map(String::from).collect();
        assert_eq!(listed(&words[..0]), "");
        assert_eq!(listed(&words[..1]), "a");
        assert_eq!(listed(&words[..3]), "a, b and c");
        assert_eq!(listed(&words), "a, b, c, d, e, f and 3 more");
    }
}
