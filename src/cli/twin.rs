//! `flare-pipe twin`: the records of a twin site as files.

use super::output::{data, write_json};
use crate::error::{Context, Result};
use crate::manifest::Manifest;
use crate::records::{self, Record, RecordSettings};
use crate::stages::measured;
use crate::twin::{self, Truth};
use crate::units::AccelerationUnit;
use clap::Args;
use rayon::prelude::*;
use serde_json::json;
use std::path::PathBuf;

/// Which truth and where to.
#[derive(Debug, Args)]
pub struct TwinArguments {
    /// Truth file, for example configs/truth/lotung.toml
    truth: PathBuf,
    /// Folder for the records
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

/// Records every event of the truth, or alters every measured record of its site, and writes one CSV file an event and
/// component, in m/s².
///
/// # Errors
/// When the truth or its site manifest is wrong, a record is not sound, or the truth column does not finish.
pub fn twin(arguments: &TwinArguments, json: bool) -> Result<()> {
    let truth = Truth::load(&arguments.truth)?;
    let site = arguments.truth.parent().unwrap_or(std::path::Path::new(".")).join(&truth.site);
    let manifest = Manifest::load(&site, &[])?;
    std::fs::create_dir_all(&arguments.output).context(|| format!("cannot make `{}`", arguments.output.display()))?;
    let written = match &manifest.site.records {
        Some(settings) if settings.format != "twin" => altered(arguments, &manifest, settings.clone())?,
        _ => recorded(arguments, &manifest, &truth)?,
    };
    if json {
        return write_json(&json!({ "files": written }));
    }
    written.iter().try_for_each(|path| data!("{}", path.display()))
}

/// What the truth column's sensors record.
fn recorded(arguments: &TwinArguments, manifest: &Manifest, truth: &Truth) -> Result<Vec<PathBuf>> {
    let sections = manifest.site.column();
    let recorder = twin::recorder(&sections, &manifest.site.tolerances, truth)?;
    let components = manifest.site.records.as_ref().map_or_else(|| truth.components(), |r| r.components.clone());
    let of_event = |event: &twin::EventSection| -> Result<Vec<PathBuf>> {
        let records = twin::record_event(&recorder, &event.name, &components)?;
        records.iter().map(|r| written(arguments, r, "synthetic twin record")).collect()
    };
    let paths: Vec<Vec<PathBuf>> = truth.event.par_iter().map(of_event).collect::<Result<_>>()?;
    Ok(paths.concat())
}

/// What the sensors of the truth would have made of what was measured.
fn altered(arguments: &TwinArguments, manifest: &Manifest, settings: RecordSettings) -> Result<Vec<PathBuf>> {
    let text = |path: &PathBuf| path.display().to_string();
    let settings = RecordSettings {
        dir: manifest.records_dir.as_ref().map(text),
        truth: Some(text(&arguments.truth)),
        ..settings
    };
    let found = measured(&settings, &manifest.site.column())?.records;
    found.iter().map(|(_, r)| written(arguments, r, "measured, altered by a truth")).collect()
}

fn written(arguments: &TwinArguments, record: &Record, origin: &str) -> Result<PathBuf> {
    records::csv::write(&arguments.output, record, AccelerationUnit::MetrePerSecondSquared, &[origin, "unit: m/s2"])
}
