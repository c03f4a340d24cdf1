//! `flare-pipe show`: the latent equations.

use super::SiteArguments;
use super::workspace::Workspace;
use crate::error::Result;
use crate::flare::{Calibration, SourceModel};
use crate::pipeline;
use clap::Args;

/// Which site, and before or after calibration.
#[derive(Debug, Args)]
pub struct ShowArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Equations calibrated for this component instead of those of the source model
    #[arg(long, value_name = "C")]
    component: Option<String>,
}

/// Prints one equation a latent variable.
///
/// # Errors
/// When the model is not stored.
pub fn show(arguments: &ShowArguments) -> Result<()> {
    let workspace = Workspace::open(&arguments.site)?;
    let site = workspace.site();
    let (model, _) = SourceModel::load(&pipeline::output(&site, &workspace.graph, "pretrain")?)?;
    let equations = match &arguments.component {
        None => model.equations(),
        Some(component) => {
            let folder = pipeline::output(&site, &workspace.graph, &format!("calibrate.{component}"))?;
            Calibration::load(&folder, &model.shape)?.equations(&model.shape)
        }
    };
    for equation in equations {
        println!("{equation}");
    }
    Ok(())
}
