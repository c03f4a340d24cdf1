//! `flare-pipe predict`: the response to one new event.

use super::SiteArguments;
use super::output::write_json;
use super::workspace::Workspace;
use crate::atomic;
use crate::dataset::{Header, Sample, TrajectoryWriter};
use crate::error::{Error, Result};
use crate::numerics::resample::{half_steps, resample_band_limited};
use crate::pipeline::Results;
use crate::records::csv as csv_records;
use crate::stages::predict::Predictor;
use crate::units::AccelerationUnit;
use clap::Args;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Which site, component and event.
#[derive(Debug, Args)]
pub struct PredictArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Component whose calibration is used
    #[arg(long, value_name = "C")]
    component: String,
    /// Base motion over the whole event: `time_s,<input sensor>`
    #[arg(long, value_name = "FILE")]
    input: PathBuf,
    /// Initial window: `time_s` and every output sensor, starting with the base motion
    #[arg(long, value_name = "FILE")]
    window: PathBuf,
    /// Where the prediction goes: `.csv` or `.mcap`, m/s²
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

/// Predicts one event from its base motion and initial window.
///
/// # Errors
/// When the model is not stored, a file does not hold what it should, or the latent state leaves its bounds.
pub fn predict(arguments: &PredictArguments, json: bool) -> Result<()> {
    let written = arguments.output.canonicalize().ok();
    let is_read = |path: &&PathBuf| written.is_some() && path.canonicalize().ok() == written;
    if let Some(path) = [&arguments.input, &arguments.window].into_iter().find(is_read) {
        let what = format!("`--output` is `{}`, which is read", path.display());
        return Err(Error::new(what).hint("give the prediction a name of its own").usage());
    }
    let workspace = Workspace::open(&arguments.site)?;
    let site = workspace.site();
    let results = Results::of(&site, &workspace.graph)?;
    let folder = |stage: &str| results.output(stage);
    let calibration = folder(&format!("calibrate.{}", arguments.component))?;
    let model = Predictor::load(&folder("dataset")?, &folder("pretrain")?, &folder("distill")?, &calibration)?;
    let sections = &workspace.manifest.site;
    let unit = sections.records.as_ref().and_then(|r| r.unit);
    let names = sections.sensors.names();
    let outputs: Vec<&str> = names.iter().map(String::as_str).collect();
    let base = read(&arguments.input, &[&sections.sensors.input], unit)?;
    let window = read(&arguments.window, &outputs, unit)?;
    let step_s = model.step_s();
    let coarse: Vec<Vec<f64>> = window.channels.iter().map(|c| resample_band_limited(c, window.dt_s, step_s)).collect();
    let base_m_s2 = resample_band_limited(&base.channels[0], base.dt_s, step_s);
    let half_m_s2 = half_steps(&base.channels[0], base.dt_s, step_s);
    let predicted = model
        .predict(&coarse, &base_m_s2, &half_m_s2)
        .map_err(|e| e.at(format!("`{}`", arguments.window.display())))?;
    let start = model.window();
    let event =
        Event { site: &sections.name, names: &names, step_s, start, base_m_s2: &base_m_s2, predicted: &predicted };
    match arguments.output.extension().and_then(|e| e.to_str()) {
        Some("mcap") => event.write_mcap(&arguments.output)?,
        Some("csv") => event.write_csv(&arguments.output)?,
        _ => return Err(Error::new(format!("`{}` must end in `.csv` or `.mcap`", arguments.output.display())).usage()),
    }
    if json { write_json(&json!({ "output": arguments.output, "sensors": names, "step_s": step_s })) } else { Ok(()) }
}

/// Columns of a file in the unit that it says, or in the `declared` one.
fn read(path: &Path, names: &[&str], declared: Option<AccelerationUnit>) -> Result<csv_records::Table> {
    let unit = csv_records::unit_in(path).map_err(Error::usage)?.or(declared);
    csv_records::read(path, names, unit).map_err(Error::usage)
}

/// A predicted event.
struct Event<'a> {
    site: &'a str,
    names: &'a [String],
    step_s: f64,
    /// Sample of the first prediction.
    start: usize,
    base_m_s2: &'a [f64],
    /// One history a sensor from `start` on, m/s².
    predicted: &'a [Vec<f64>],
}

impl Event<'_> {
    fn write_csv(&self, path: &Path) -> Result<()> {
        atomic::write(path, |out| {
            let mut writer = csv::Writer::from_writer(out);
            writer.write_record(std::iter::once("time_s").chain(self.names.iter().map(String::as_str)))?;
            for k in 0..self.predicted.first().map_or(0, Vec::len) {
                let time = format!("{:.6}", (self.start + k) as f64 * self.step_s);
                let row = self.predicted.iter().map(|h| h[k].to_string());
                writer.write_record(std::iter::once(time).chain(row))?;
            }
            writer.flush()
        })
    }

    fn write_mcap(&self, path: &Path) -> Result<()> {
        let header = Header {
            id: "prediction".into(),
            dt_s: self.step_s,
            depth_m: Vec::new(),
            sensors: self.names.to_vec(),
            metadata: BTreeMap::from([("site".to_string(), self.site.to_string())]),
        };
        let mut writer = TrajectoryWriter::create(path, header)?;
        for k in 0..self.predicted.first().map_or(0, Vec::len) {
            let sensors_m_s2: Vec<f64> = self.predicted.iter().map(|h| h[k]).collect();
            writer.push(&Sample {
                time_s: (self.start + k) as f64 * self.step_s,
                base_m_s2: self.base_m_s2[self.start + k],
                response_m_s2: &[],
                surface_m_s2: 0.0,
                sensors_m_s2: &sensors_m_s2,
            })?;
        }
        writer.finish()
    }
}
