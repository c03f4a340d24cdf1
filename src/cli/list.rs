//! `flare-pipe list`: laws, effects, formats and stages by name.

use crate::effects::EFFECTS;
use crate::error::Result;
use crate::records::FORMATS;
use crate::soil::LAWS;
use crate::stages::STAGES;
use clap::{Args, ValueEnum};

/// What to list.
#[derive(Debug, Args)]
pub struct ListArguments {
    /// What to list
    what: What,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum What {
    /// Constitutive laws
    Laws,
    /// Effects a site model may lack
    Effects,
    /// Formats of record files
    Formats,
    /// Stages of a pipeline
    Stages,
}

/// Prints one line an entry: name, tab, what it is.
///
/// # Errors
/// None today.
pub fn list(arguments: &ListArguments) -> Result<()> {
    let lines: Vec<(&str, &str)> = match arguments.what {
        What::Laws => LAWS.iter().map(|e| (e.name, e.about)).collect(),
        What::Effects => EFFECTS.iter().map(|e| (e.name, e.about)).collect(),
        What::Formats => FORMATS
            .iter()
            .map(|e| (e.name, e.about))
            .chain([("twin", "synthetic records of a truth the manifest does not declare")])
            .collect(),
        What::Stages => STAGES.iter().map(|s| (s.kind(), s.about())).collect(),
    };
    let width = lines.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    for (name, about) in lines {
        println!("{name:width$}  {about}");
    }
    Ok(())
}
