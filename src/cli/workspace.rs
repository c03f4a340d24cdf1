//! A manifest, its pipeline and its run directory, ready for any command.

use super::SiteArguments;
use crate::error::{Error, Result};
use crate::manifest::Manifest;
use crate::pipeline::{Graph, Recipe, Site};
use crate::registry;
use crate::stages::STAGES;
use std::path::{Path, PathBuf};

/// What commands on a site work with.
pub struct Workspace {
    /// The checked manifest.
    pub manifest: Manifest,
    /// Its canonical table.
    pub table: toml::Table,
    /// The unfolded pipeline.
    pub graph: Graph,
    manifest_dir: PathBuf,
    run_dir: PathBuf,
}

impl Workspace {
    /// Loads manifest and pipeline.
    ///
    /// # Errors
    /// Usage errors of either.
    pub fn open(arguments: &SiteArguments) -> Result<Self> {
        let manifest = Manifest::load(&arguments.site, &arguments.set)?;
        let table = manifest.canonical()?;
        let name = arguments.pipeline.as_deref().unwrap_or(&manifest.site.pipeline);
        let recipe = Recipe::load(&find_pipeline(name, &arguments.site)?)?;
        let graph = Graph::new(&recipe, STAGES, &table)?;
        let manifest_dir = arguments.site.parent().unwrap_or(Path::new(".")).to_path_buf();
        Ok(Self { manifest, table, graph, manifest_dir, run_dir: arguments.run_dir.clone() })
    }

    /// The site as the pipeline knows it.
    pub fn site(&self) -> Site<'_> {
        Site {
            name: &self.manifest.site.name,
            manifest: &self.table,
            manifest_dir: &self.manifest_dir,
            run_dir: &self.run_dir,
        }
    }
}

/// A pipeline by path, or by name in `pipelines/` beside the manifest's folder or in the working directory.
fn find_pipeline(name: &str, manifest: &Path) -> Result<PathBuf> {
    if name.ends_with(".toml") {
        return Ok(PathBuf::from(name));
    }
    let file = format!("pipelines/{name}.toml");
    let beside = manifest.parent().unwrap_or(Path::new(".")).join("..").join(&file);
    let candidates = [PathBuf::from(&file), beside];
    if let Some(found) = candidates.iter().find(|p| p.is_file()) {
        return Ok(found.clone());
    }
    let mut names: Vec<String> = Vec::new();
    for folder in candidates.iter().filter_map(|c| c.parent()) {
        names.extend(std::fs::read_dir(folder).into_iter().flatten().filter_map(|entry| {
            let path = entry.ok()?.path();
            Some(path.file_stem()?.to_str()?.to_string())
        }));
    }
    names.sort();
    names.dedup();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    Err(Error::new(format!("there is no pipeline `{name}`")).hint(registry::known(&names, name)).usage())
}
