//! Names that a shell may complete, where others are taken as well: what is not known is told with its context later.

use crate::effects::EFFECTS;
use crate::pipeline::Recipe;
use crate::records::FORMATS;
use crate::soil::LAWS;
use crate::stages::{PIPELINES, STAGES};
use clap::builder::{PossibleValue, TypedValueParser};
use clap::error::ErrorKind;
use std::ffi::OsStr;

/// An argument that may be one of these names.
#[derive(Debug, Clone, Copy)]
pub enum Names {
    /// Stages of the pipelines that come with the program.
    Stages,
    /// Whatever `list` knows.
    Listed,
}

impl Names {
    fn all(self) -> Vec<String> {
        let mut names: Vec<String> = match self {
            Self::Stages => {
                let recipes = PIPELINES.iter().filter_map(|p| Recipe::parse(p.text, p.name).ok());
                recipes.flat_map(|recipe| recipe.stages).map(|stage| stage.name).collect()
            }
            Self::Listed => {
                let laws = LAWS.iter().map(|e| e.name).chain(EFFECTS.iter().map(|e| e.name));
                let others = FORMATS.iter().map(|e| e.name).chain(PIPELINES.iter().map(|p| p.name));
                laws.chain(others).chain(STAGES.iter().map(|stage| stage.kind())).map(String::from).collect()
            }
        };
        names.sort_unstable();
        names.dedup();
        names
    }
}

impl TypedValueParser for Names {
    type Value = String;

    fn parse_ref(&self, _: &clap::Command, _: Option<&clap::Arg>, value: &OsStr) -> Result<String, clap::Error> {
        value.to_str().map(String::from).ok_or_else(|| clap::Error::new(ErrorKind::InvalidUtf8))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.all().into_iter().map(PossibleValue::new)))
    }
}
