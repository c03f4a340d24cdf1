//! The manifest of a study of two source models: the site's own with the column of another manifest in its place.

use crate::error::{Context, Error, Result};
use crate::manifest::{Manifest, StudySection};
use crate::pipeline::{Stage, Task};
use std::fs;
use std::path::{Path, PathBuf};
use toml::Table;

/// Takes the column from another manifest.
pub struct OtherSource;

/// Sections that make a source model; all else stays that of the site.
const SECTIONS: [&str; 3] = ["site", "law", "effects"];

impl Stage for OtherSource {
    fn kind(&self) -> &'static str {
        "other-source"
    }

    fn about(&self) -> &'static str {
        "the manifest with the column of another one (`study.other`): a second source model of the same site"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        &["study"]
    }

    fn unkeyed(&self) -> &'static [&'static str] {
        &["study.other"]
    }

    fn files(&self, parameters: &Table, manifest_dir: &Path) -> Result<Vec<PathBuf>> {
        let study = parameters.get("study").cloned().ok_or_else(|| {
            Error::new("the manifest has no `[study]`")
                .hint("name the manifest of the other source model: `[study]` with `other = \"FILE\"`")
                .usage()
        })?;
        let study: StudySection = study.try_into().context(|| "`[study]` is not understood".into())?;
        Ok(vec![manifest_dir.join(study.other)])
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let study: StudySection = task.section("study")?;
        let other = Manifest::load(&task.manifest_dir().join(study.other), &[])?;
        let table = other.canonical()?;
        let mut manifest = Table::new();
        for section in SECTIONS {
            // an empty list stands in for effects of the site that the other source does not have
            let value = table.get(section).cloned().unwrap_or_else(|| toml::Value::Array(Vec::new()));
            manifest.insert(section.into(), value);
        }
        let write = |name: &str, text: String| {
            let path = task.output_dir().join(name);
            fs::write(&path, text).context(|| format!("cannot write `{}`", path.display()))
        };
        write(NAME, other.site.name.clone())?;
        write("manifest.toml", manifest.to_string())
    }
}

const NAME: &str = "name.txt";

/// Name of the other source model that stage left in `folder`.
///
/// # Errors
/// When it is not there.
pub fn name(folder: &Path) -> Result<String> {
    let path = folder.join(NAME);
    fs::read_to_string(&path).context(|| format!("cannot read `{}`", path.display()))
}
