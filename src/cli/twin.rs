//! `flare-pipe twin`: the records of a twin site as files.

use crate::error::{Context, Result};
use crate::manifest::Manifest;
use crate::records;
use crate::twin::{self, Truth};
use crate::units::AccelerationUnit;
use clap::Args;
use rayon::prelude::*;
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

/// Records every event of the truth and writes one CSV file an event and component, in m/s².
///
/// # Errors
/// When the truth or its site manifest is wrong, or the truth column does not finish.
pub fn twin(arguments: &TwinArguments) -> Result<()> {
    let truth = Truth::load(&arguments.truth)?;
    let site = arguments.truth.parent().unwrap_or(std::path::Path::new(".")).join(&truth.site);
    let manifest = Manifest::load(&site, &[])?;
    let sections = manifest.site.column();
    let recorder = twin::recorder(&sections, &manifest.site.tolerances, &truth)?;
    std::fs::create_dir_all(&arguments.output).context(|| format!("cannot make `{}`", arguments.output.display()))?;
    let components = manifest.site.records.as_ref().map_or_else(|| truth.components(), |r| r.components.clone());
    let written: Vec<Vec<PathBuf>> = truth
        .event
        .par_iter()
        .map(|event| {
            let unit = AccelerationUnit::MetrePerSecondSquared;
            twin::record_event(&recorder, &event.name, &components)?
                .iter()
                .map(|r| records::csv::write(&arguments.output, r, unit, &["synthetic twin record", "unit: m/s2"]))
                .collect::<Result<_>>()
        })
        .collect::<Result<_>>()?;
    for path in written.into_iter().flatten() {
        println!("{}", path.display());
    }
    Ok(())
}
