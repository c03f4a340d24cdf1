//! The trait by which work meets the pipeline.

use super::Task;
use crate::error::Result;
use std::path::{Path, PathBuf};

/// One kind of work: reads inputs by role and the manifest sections it declares, writes files into an empty folder.
///
/// A stage sees neither the cache nor the graph nor other stages. The same parameters, inputs and outside files must give the
/// same bytes, on any number of threads and any machine.
pub trait Stage: Send + Sync {
    /// Name as typed in a pipeline file; also the folder of the cache.
    fn kind(&self) -> &'static str;

    /// One line for people.
    fn about(&self) -> &'static str;

    /// Bump when the same inputs would give other numbers.
    fn version(&self) -> u32;

    /// Dotted manifest sections or leaves it reads (`"pretrain"`, `"records.train"`; `"*"` is everything). They are its
    /// parameters: each leaf enters the key. A section the manifest does not have is skipped.
    fn reads(&self) -> &'static [&'static str];

    /// Dotted leaves handed to the stage that cannot change its output and stay out of the key: where outside files lie
    /// (their content enters through [`Stage::files`]), memory budgets.
    fn unkeyed(&self) -> &'static [&'static str] {
        &[]
    }

    /// Takes out of its parameters what cannot change its output: entries of a list that do not concern it.
    fn narrow(&self, parameters: &mut toml::Table) {
        let _ = parameters;
    }

    /// Outside files whose content enters the key, in an order that the parameters determine. Relative paths in the
    /// manifest are relative to `manifest_dir`.
    ///
    /// # Errors
    /// When the parameters do not lead to files.
    fn files(&self, parameters: &toml::Table, manifest_dir: &Path) -> Result<Vec<PathBuf>> {
        let _ = (parameters, manifest_dir);
        Ok(Vec::new())
    }

    /// Files of its output that are copied to the folder of the site. One that the output does not have is removed there.
    fn publishes(&self) -> &'static [&'static str] {
        &[]
    }

    /// Whether those who read its output read its items too: what is damaged of these is then found before they do.
    fn hands_on_items(&self) -> bool {
        false
    }

    /// Does the work.
    ///
    /// # Errors
    /// When it cannot; stages that depend on it are then skipped, the others finish.
    fn run(&self, task: &Task<'_>) -> Result<()>;
}
