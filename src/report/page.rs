//! The page around the sections: head, style, table of contents.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::content::Content;
use super::figure::Section;

const STYLE: &str = include_str!("style.css");

/// The head of a document.
pub(super) fn head(title: &str) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta name="viewport" content="width=device-width, initial-scale=1";
            // Nothing may be loaded or run, whatever a name in the content says.
            meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:";
            title { (title) }
            link rel="icon" href="data:,";
            style { (PreEscaped(STYLE)) }
        }
    }
}

/// The whole document.
pub(super) fn page(content: &Content, sections: Vec<Section>) -> Markup {
    let title = format!("{} – site response report", content.site);
    html! {
        (DOCTYPE)
        html lang="en" {
            (head(&title))
            body {
                a.skip href="#summary" { "Skip to the summary" }
                nav.toc aria-label="Contents" {
                    p.brand { (content.site) }
                    ol {
                        @for section in &sections {
                            li {
                                a href={ "#" (section.id) } { (section.title) }
                                @if !section.entries.is_empty() {
                                    ol { @for (id, name) in &section.entries { li { a href={ "#" (id) } { (name) } } } }
                                }
                            }
                        }
                    }
                }
                main {
                    header { h1 { (content.site) } p.lead { "Site response: finite elements, learned latent dynamics and records" } }
                    @for section in &sections {
                        section id=(section.id) { h2 { (section.title) } (section.body) }
                    }
                    footer { @if !content.provenance.program.is_empty() { (content.provenance.program) } }
                }
            }
        }
    }
}
