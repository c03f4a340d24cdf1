//! A pipeline file as typed: which stages there are and who reads whose output.

use crate::error::{Context, Error, Result};
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// A file of `pipelines/`.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// One line for people.
    pub about: String,
    /// Its stages, in the order they are told to people.
    #[serde(default, rename = "stage")]
    pub stages: Vec<RecipeStage>,
    /// Where the recipe was read, for messages.
    #[serde(skip)]
    pub source: String,
}

/// One `[[stage]]` of a pipeline file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecipeStage {
    /// Its name in this pipeline.
    pub name: String,
    /// Kind of stage; the name, if not given.
    kind: Option<String>,
    /// Role → name of the stage whose output plays it (all instances of a stage with `each`, or one: `calibrate.EW`).
    #[serde(default)]
    pub inputs: BTreeMap<String, String>,
    /// Dotted name of a list of texts in the manifest: one instance of the stage for each, seen as parameter `each`.
    pub each: Option<String>,
    /// A stage whose output holds `manifest.toml`: its sections stand in for those of the given manifest.
    pub manifest: Option<String>,
    /// Whether files of its output are copied to the folder of the site; `false` for all but one of those that would share
    /// a name.
    #[serde(default = "yes")]
    pub publish: bool,
}

fn yes() -> bool {
    true
}

impl RecipeStage {
    /// Kind of stage.
    pub fn kind(&self) -> &str {
        self.kind.as_deref().unwrap_or(&self.name)
    }
}

impl Recipe {
    /// Reads a pipeline file.
    ///
    /// # Errors
    /// When it cannot be read or a key is unknown, missing or of the wrong type.
    pub fn load(path: &Path) -> Result<Self> {
        let source = path.display().to_string();
        let text = std::fs::read_to_string(path).context(|| format!("cannot read pipeline `{source}`"));
        Self::parse(&text.map_err(Error::usage)?, &source)
    }

    /// Reads the text of a pipeline file; `source` names it in messages.
    ///
    /// # Errors
    /// As [`Recipe::load`].
    pub fn parse(text: &str, source: &str) -> Result<Self> {
        let mut recipe: Self = toml::from_str(text).map_err(|e| {
            let line = e.span().map_or(1, |span| text[..span.start.min(text.len())].matches('\n').count() + 1);
            Error::new(e.message().trim().to_string()).at(format!("line {line} of `{source}`")).usage()
        })?;
        recipe.source = source.to_string();
        Ok(recipe)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misspelt_key_is_refused_with_its_line() {
        let error =
            Recipe::parse("about = 'x'\n[[stage]]\nname = 'a'\nkin = 'b'\n", "p.toml").expect_err("unknown key");
        assert!(error.to_string().contains("line 4 of `p.toml`"), "{error}");
        assert_eq!(error.exit_status(), 2);
    }
}
