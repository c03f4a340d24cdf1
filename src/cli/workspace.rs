//! A manifest, its pipeline, its project and its run folder, ready for any command.

use super::SiteArguments;
use crate::error::{Error, Result};
use crate::manifest::Manifest;
use crate::pipeline::{Graph, Recipe, Site};
use crate::registry;
use crate::stages::{PIPELINES, STAGES};
use std::path::{Path, PathBuf};

/// What commands on a site work with.
pub struct Workspace {
    /// The checked manifest.
    pub manifest: Manifest,
    /// Its canonical table.
    pub table: toml::Table,
    /// The unfolded pipeline.
    pub graph: Graph,
    /// Where the pipeline is from: a file, or that it is built in.
    pub pipeline: String,
    manifest_dir: PathBuf,
    run_dir: PathBuf,
    folder: Option<String>,
}

impl Workspace {
    /// Loads manifest and pipeline.
    ///
    /// # Errors
    /// Usage errors of either.
    pub fn open(arguments: &SiteArguments) -> Result<Self> {
        let manifest = Manifest::load(&arguments.site, &arguments.set)?;
        let table = manifest.canonical()?;
        let manifest_dir = arguments.site.parent().unwrap_or(Path::new(".")).to_path_buf();
        let root = project_root(&manifest_dir);
        let recipe = match &arguments.pipeline {
            Some(name) => find_pipeline(name, Path::new(""), &manifest_dir, &root)?,
            None => find_pipeline(&manifest.site.pipeline, &manifest_dir, &manifest_dir, &root)
                .map_err(|e| e.at(place_of_pipeline(arguments)))?,
        };
        let graph = Graph::new(&recipe, STAGES, &table)?;
        let run_dir = arguments.run_dir.clone().unwrap_or_else(|| root.join("runs"));
        Ok(Self { manifest, table, graph, pipeline: recipe.source, manifest_dir, run_dir, folder: None })
    }

    /// The same with its results in another folder of the run directory than that of its site, if one is given.
    #[must_use]
    pub fn in_folder(self, folder: Option<String>) -> Self {
        Self { folder, ..self }
    }

    /// The site as the pipeline knows it.
    pub fn site(&self) -> Site<'_> {
        Site {
            name: self.folder.as_deref().unwrap_or(&self.manifest.site.name),
            manifest: &self.table,
            manifest_dir: &self.manifest_dir,
            run_dir: &self.run_dir,
        }
    }
}

/// Where the name of the pipeline is from, for people.
fn place_of_pipeline(arguments: &SiteArguments) -> String {
    let is_set = arguments.set.iter().any(|assignment| assignment.split('=').next().map(str::trim) == Some("pipeline"));
    if is_set { "`pipeline` of `--set`".into() } else { format!("`pipeline` of `{}`", arguments.site.display()) }
}

/// A folder for results and cache: the one `asked` for, or that of the project of the working directory.
///
/// # Errors
/// When what is asked for is none.
pub fn results_folder(asked: Option<&Path>) -> Result<PathBuf> {
    let Some(asked) = asked else { return Ok(project_root(Path::new("")).join("runs")) };
    if !asked.join("cache").is_dir() {
        let hint = "it is the folder that has `cache` and a folder of each site that was run";
        return Err(Error::new(format!("`{}` is no folder of results", asked.display())).hint(hint).usage());
    }
    Ok(asked.to_path_buf())
}

/// The folder of the project that `dir` is in, as a path from the working directory where it is below that: the nearest one up that holds
/// `pipelines` or results; `dir` itself where there is none.
pub fn project_root(dir: &Path) -> PathBuf {
    let Ok(here) = std::env::current_dir() else { return dir.to_path_buf() };
    let absolute = here.join(dir);
    let absolute = absolute.canonicalize().unwrap_or(absolute);
    let is_root = |dir: &&Path| dir.join("pipelines").is_dir() || dir.join("runs").join("cache").is_dir();
    let root = absolute.ancestors().find(is_root).unwrap_or(&absolute);
    let here = here.canonicalize().unwrap_or(here);
    root.strip_prefix(&here).unwrap_or(root).to_path_buf()
}

/// A pipeline by path `from` a folder, or by name: a file beside the manifest, one in `pipelines` of the project, or one that is built in.
fn find_pipeline(name: &str, from: &Path, manifest_dir: &Path, root: &Path) -> Result<Recipe> {
    let file = format!("{name}.toml");
    let is_path = name.ends_with(".toml") || Path::new(name).components().count() > 1;
    if is_path {
        let found = [from.join(name), from.join(&file)].into_iter().find(|path| path.is_file());
        let missing = || {
            let hint = "a path is taken from the folder of the manifest; `flare-pipe list pipelines` names those that are built in";
            Error::new(format!("there is no pipeline file `{}`", from.join(name).display())).hint(hint).usage()
        };
        return Recipe::load(&found.ok_or_else(missing)?);
    }
    // A site manifest beside this one may have the name of a pipeline.
    if let Ok(recipe) = Recipe::load(&manifest_dir.join(&file)) {
        return Ok(recipe);
    }
    let own = root.join("pipelines").join(&file);
    if own.is_file() {
        return Recipe::load(&own);
    }
    if let Some(entry) = PIPELINES.iter().find(|p| p.name == name) {
        return Recipe::parse(entry.text, &format!("{name} (built in)"));
    }
    let own = std::fs::read_dir(root.join("pipelines")).into_iter().flatten();
    let mut names: Vec<String> = own.filter_map(|e| Some(e.ok()?.path().file_stem()?.to_str()?.to_string())).collect();
    names.extend(PIPELINES.iter().map(|p| p.name.to_string()));
    names.sort();
    names.dedup();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    Err(Error::new(format!("there is no pipeline `{name}`")).hint(registry::known(&names, name)).usage())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_project_begins_where_pipelines_or_results_are() {
        let folder = tempfile::tempdir().unwrap();
        let top = folder.path().canonicalize().unwrap();
        let sites = top.join("sites/one");
        std::fs::create_dir_all(&sites).unwrap();
        assert_eq!(project_root(&sites), sites);
        std::fs::create_dir_all(top.join("runs/cache")).unwrap();
        assert_eq!(project_root(&sites), top);
        std::fs::create_dir_all(top.join("sites/pipelines")).unwrap();
        assert_eq!(project_root(&sites), top.join("sites"));
    }

    #[test]
    fn a_file_stands_in_for_the_pipeline_of_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let found = |name: &str| find_pipeline(name, root, root, root);
        assert_eq!(found("diagnose").unwrap().source, "diagnose (built in)");
        std::fs::write(root.join("diagnose.toml"), "name = 'a site called so'").unwrap();
        assert_eq!(found("diagnose").unwrap().source, "diagnose (built in)");
        std::fs::create_dir(root.join("pipelines")).unwrap();
        std::fs::write(root.join("pipelines/diagnose.toml"), "about = 'own'").unwrap();
        assert_eq!(found("diagnose").unwrap().about, "own");
        std::fs::write(root.join("pipelines/diagnose.toml"), "abuot = 'own'").unwrap();
        assert!(found("diagnose").unwrap_err().to_string().contains("abuot"));
        let message = found("diagnos").unwrap_err().to_string();
        assert!(message.contains("nearest: `diagnose`") && message.contains("`flare-t`"), "{message}");
        let message = found("nowhere/own").unwrap_err().to_string();
        assert!(message.contains("no pipeline file") && message.contains("nowhere/own`"), "{message}");
    }
}
