//! Figures and the self-contained HTML report.
//!
//! [`render`] turns plain data ([`content::Content`]) into one HTML document that loads nothing from elsewhere: style and
//! figures (inline SVG) are inside, there is no script. The same content gives the same bytes. Text is escaped throughout.
//!
//! One file a section (`summary`, `site`, `closing`, `events`, `spectra`, `depth`, `scores`, `held_out`, `pretrain`, `distill`, `calibrate`, `motions`, `provenance`), all
//! drawn with the few kinds of figure in `chart` and `heat`; `page` puts them together.

mod answer;
mod bitmap;
mod calibrate;
mod chart;
mod check;
mod closing;
mod closing_content;
mod closing_field;
mod closing_rest;
pub mod content;
mod curves;
mod depth;
mod distill;
mod events;
mod execution;
mod figure;
mod fleet;
mod heat;
mod held_out;
mod losses;
mod models;
mod motions;
mod number;
mod page;
mod phrase;
mod pictures;
mod pretrain;
mod provenance;
mod scores;
mod site;
mod site_content;
mod spectra;
mod study;
mod summary;
mod svg;
mod thin;
mod traces;

pub use answer::answer;
pub use content::Content;
pub use execution::{ExecutedStage, Execution, executed};
pub use fleet::{FleetRow, fleet_csv, fleet_page};
pub use pictures::pictures;

use crate::Result;

/// The report as one HTML document.
///
/// ```
/// use flare_pipe::report::{self, Content, content::{Pair, Score}};
///
/// let score = Score {
///     event: "LSST07".into(),
///     component: "EW".into(),
///     sensor: "FA1-5".into(),
///     nrmse_percent: Pair { fe: Some(61.2), flare_t: Some(38.9) },
///     ..Score::default()
/// };
/// let content = Content { site: "lotung".into(), scores: vec![score], ..Content::default() };
/// let html = report::render(&content)?;
/// assert!(html.contains("median NRMSE 38.9 % against 61.2 % for FE"));
/// # Ok::<(), flare_pipe::Error>(())
/// ```
///
/// # Errors
/// If arrays that belong together differ in length (a field and its depths, two coefficient matrices, a spectrum and its
/// periods) or a time step is not positive; the message names the place.
pub fn render(content: &Content) -> Result<String> {
    check::lengths(content)?;
    let sections = [
        summary::section(content),
        closing::section(content),
        events::section(content),
        spectra::section(content),
        depth::section(content),
        curves::section(content),
        site::section(content),
        scores::section(content),
        study::section(content),
        held_out::section(content),
        pretrain::section(content),
        distill::section(content),
        calibrate::section(content),
        motions::section(content),
        provenance::section(content),
    ];
    Ok(page::page(content, sections.into_iter().flatten().collect()).into_string())
}
