//! The site manifest: typed TOML, every problem at once with file, line, caret and hint.
//!
//! [`Manifest::load`] reads a file, applies `--set` overrides, compares its structure with the JSON Schema of [`Site`],
//! builds the typed sections, and runs each section's own range checks and the checks across sections.

mod check;
mod document;
mod draft;
mod randomisation;
mod resolve;
mod schema;
mod sections;
pub mod strata;
mod table;

pub use check::{LONGEST_NAME, is_site_name};
pub use document::{Document, Problem};
pub use draft::{Draft, DraftRecords};
pub use randomisation::{Randomisation, SiteClass};
pub use schema::schema;
pub use sections::{
    ColumnSections, LayerSection, OutputSection, SensorsSection, Site, SiteSection, StudySection, TrainingSection,
};

pub use table::{LayerRow, layers as profile_table};

use crate::error::{Context, Error, Result};
use std::path::{Path, PathBuf};

/// A manifest that passed every check.
#[derive(Debug, Clone)]
pub struct Manifest {
    /// The typed sections, defaults filled in.
    pub site: Site,
    /// The file it came from.
    pub path: PathBuf,
    /// The text of that file, for the report.
    pub text: String,
    /// Folder of the records (`records.dir`), resolved.
    pub records_dir: Option<PathBuf>,
    /// Truth file of twin records (`records.truth`), resolved.
    pub truth: Option<PathBuf>,
}

impl Manifest {
    /// Reads and checks `path` with `overrides` of the form `key=value` (dotted key, TOML value or bare string).
    ///
    /// # Errors
    /// One usage error that shows every problem found.
    pub fn load(path: &Path, overrides: &[String]) -> Result<Self> {
        let text = std::fs::read_to_string(path)
            .context(|| format!("cannot read the manifest `{}`", path.display()))
            .map_err(|e| e.usage().hint("give the path of a site manifest, for example `configs/smoke.toml`"))?;
        let document = Document::parse(path, &text)?;
        let mut table = document.table().clone();
        let mut overridden = Vec::new();
        for assignment in overrides {
            overridden.push(document::apply_override(&mut table, assignment)?);
        }
        let mut problems = schema::compare(&table);
        let mut site = sections::build(&table, &mut problems).map(|site| site.completed(&table));
        if let Some(site) = &site {
            check::across(site, &mut problems);
        }
        if problems.is_empty() {
            site = site.map(|site| realised(site, &mut problems));
        }
        // What is filled in follows from what is said: where that is wrong, the other is no news.
        let is_filled_in = |p: &Problem| {
            sections::FILLED_IN.iter().any(|s| p.key.starts_with(s)) && !document::is_said(&table, &p.key)
        };
        if !problems.iter().all(is_filled_in) {
            problems.retain(|p| !is_filled_in(p));
        }
        match site {
            Some(site) if problems.is_empty() => {
                let base = path.parent().unwrap_or(Path::new("."));
                let resolve = |key: &str, value: &str| {
                    if overridden.iter().any(|k| k == key) { PathBuf::from(value) } else { base.join(value) }
                };
                let records_dir = site.records.as_ref().and_then(|r| r.dir.as_ref()).map(|d| resolve("records.dir", d));
                let truth = site.records.as_ref().and_then(|r| r.truth.as_ref()).map(|d| resolve("records.truth", d));
                Ok(Self { site: site.with_recipe(), path: path.to_path_buf(), text, records_dir, truth })
            }
            _ => Err(document.error(problems, &overridden)),
        }
    }

    /// The manifest with every default filled in and its outside paths resolved: the table that stages read their
    /// parameters from.
    ///
    /// # Errors
    /// When a section cannot be written as TOML.
    pub fn canonical(&self) -> Result<toml::Table> {
        let mut site = self.site.clone();
        if let Some(records) = &mut site.records {
            let text = |path: &PathBuf| path.canonicalize().unwrap_or_else(|_| path.clone()).display().to_string();
            records.dir = self.records_dir.as_ref().map(text);
            records.truth = self.truth.as_ref().map(text);
        }
        toml::Table::try_from(&site).map_err(|e| Error::new("cannot write the manifest as TOML").cause(e))
    }
}

/// The realisation of a site that says of which it is one, with what is wrong with that.
fn realised(site: Site, problems: &mut Vec<Problem>) -> Site {
    let Some(randomisation) = site.randomisation.clone() else { return site };
    let realised = randomisation.realised(site);
    let mut found = Vec::new();
    check::across(&realised, &mut found);
    let of_realisation = |p: Problem| Problem {
        key: "randomisation".into(),
        what: format!("this realisation of the site cannot be: {} at `{}`", p.what, p.key),
        ..p
    };
    problems.extend(found.into_iter().map(of_realisation));
    realised
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_recipe_of_a_manifest_is_what_its_stages_train_by() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/smoke.toml");
        let load = |overrides: &[String]| Manifest::load(&path, overrides).map(|m| m.site);
        let own = load(&[]).expect("a sound site");
        assert_eq!(own, load(&["recipe=tuned".into()]).expect("the default by name"));
        let published = load(&["recipe=published".into()]).expect("a sound site");
        assert!(published.pretrain == own.pretrain.as_published() && published.pretrain != own.pretrain);
        assert!(published.calibrate == own.calibrate.as_published() && published.distill == own.distill.as_published());
        let refused = load(&["recipe=secret".into()]).expect_err("no such recipe").to_string();
        assert!(refused.contains("recipe") && refused.contains("published"), "{refused}");
    }
}
