//! `flare-pipe show`: what is inside the trained model of a site, and where the files of a stage lie.

use super::SiteArguments;
use super::names::Names;
use super::output::{data, write_json};
use super::workspace::Workspace;
use crate::error::{Error, Result};
use crate::flare::{Calibration, SourceModel};
use crate::pipeline::Results;
use clap::{Args, Subcommand};
use serde_json::json;

/// What to show.
#[derive(Debug, Args)]
pub struct ShowArguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// The latent equations of the source model and of each calibrated component, term by term in 1/s
    Model(ModelArguments),
    /// The paths of what a stage has stored: trajectories of `simulate` as MCAP, the model of `pretrain` as safetensors, say
    Files(FilesArguments),
}

/// Which site, and which stage.
#[derive(Debug, Args)]
struct FilesArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Stage whose files are listed; one with several instances by `stage.instance`
    #[arg(value_name = "STAGE", value_parser = Names::Stages)]
    stage: String,
}

/// Which site, and which component.
#[derive(Debug, Args)]
struct ModelArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Only the equations calibrated for this component
    #[arg(long, value_name = "C")]
    component: Option<String>,
}

/// Prints what is asked for.
///
/// # Errors
/// When what is asked for is not stored.
pub fn show(arguments: &ShowArguments, json: bool) -> Result<()> {
    match &arguments.what {
        What::Model(arguments) => model(arguments, json),
        What::Files(arguments) => files(arguments, json),
    }
}

/// Prints one path a line.
fn files(arguments: &FilesArguments, json: bool) -> Result<()> {
    let workspace = Workspace::open(&arguments.site)?;
    let files = Results::of(&workspace.site(), &workspace.graph)?.files(&arguments.stage)?;
    if json {
        return write_json(&files);
    }
    files.iter().try_for_each(|path| data!("{}", path.display()))
}

/// Prints one equation a latent variable, each block under a line that starts with `#`.
fn model(arguments: &ModelArguments, json: bool) -> Result<()> {
    let workspace = Workspace::open(&arguments.site)?;
    let site = workspace.site();
    let results = Results::of(&site, &workspace.graph)?;
    let (model, _) = SourceModel::load(&results.output("pretrain")?)?;
    let n_term = model.shape.library().n_coefficient();
    let mut all = Vec::new();
    let kept = model.mask.iter().filter(|k| **k).count();
    if json && arguments.component.is_none() {
        all.push(json!({ "component": null, "kept": kept, "of": n_term, "equations_1_s": model.equations() }));
    } else if arguments.component.is_none() {
        data!("# source model: {kept} of {n_term} coefficients, 1/s")?;
        model.equations().iter().try_for_each(|line| data!("{line}"))?;
    }
    let calibrated = workspace.graph.nodes().iter().filter(|n| n.family == "calibrate");
    let mut is_found = false;
    for node in calibrated {
        let component = node.instance.as_deref().unwrap_or_default();
        if arguments.component.as_deref().is_some_and(|c| c != component) {
            continue;
        }
        is_found = true;
        let folder = match results.output(&node.name) {
            Ok(folder) => folder,
            Err(error) if arguments.component.is_some() => return Err(error),
            Err(_) if json => continue,
            Err(_) => {
                data!("\n# component {component}: not calibrated yet")?;
                continue;
            }
        };
        let calibration = Calibration::load(&folder, &model.shape)?;
        let (kept, cosine) = (calibration.terms_kept(), calibration.cosine_similarity);
        if json {
            let equations = calibration.equations(&model.shape);
            all.push(json!({ "component": component, "kept": kept, "of": n_term, "cosine_similarity": cosine,
                "equations_1_s": equations }));
            continue;
        }
        let gap = if arguments.component.is_none() { "\n" } else { "" };
        data!("{gap}# component {component}: {kept} of {n_term} coefficients, cosine similarity {cosine:.5}, 1/s")?;
        calibration.equations(&model.shape).iter().try_for_each(|line| data!("{line}"))?;
    }
    match &arguments.component {
        Some(component) if !is_found => {
            Err(Error::new(format!("the pipeline calibrates no component `{component}`")).usage())
        }
        _ if json => write_json(&all),
        _ => Ok(()),
    }
}
