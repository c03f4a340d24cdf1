//! Predictions of every recorded event, finite elements beside FLARE-T, and all errors.

use super::artifact::{read_json, write_json, write_table};
use super::predict::Predictor;
use super::{records, replay};
use crate::dataset::Coarse;
use crate::error::{Error, Result};
use crate::manifest::SensorsSection;
use crate::metrics::{Quartiles, nrmse_percent, psa_ln_rmse, r2, r2_pooled, timewise_error_percent};
use crate::numerics::resample::resample_band_limited;
use crate::pipeline::{Stage, Task};
use crate::records::{Record, RecordSettings, Split};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Predicts the recorded events.
pub struct Evaluate;

/// A measure of both models; `None` where a model gave no finite answer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Both {
    /// Finite elements.
    pub fe: Option<f64>,
    /// FLARE-T.
    pub flare_t: Option<f64>,
}

/// Errors at one sensor of one event and component.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// Sensor.
    pub sensor: String,
    /// What the event was used for.
    pub split: Split,
    /// NRMSE, %.
    pub nrmse_percent: Both,
    /// Coefficient of determination.
    pub r2: Both,
    /// Root-mean-square difference of the ln of the 5 % spectra over 0.10–5.00 s.
    pub psa_ln_rmse: Both,
    /// Median of the timewise error, %.
    pub timewise_median_percent: Both,
}

/// R² over all sensors of one event and component.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pooled {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// What the event was used for.
    pub split: Split,
    /// Pooled coefficient of determination.
    pub r2: Both,
}

/// `evaluation.json`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// One for each event, component and sensor.
    pub scores: Vec<Score>,
    /// One for each event and component.
    pub pooled: Vec<Pooled>,
}

impl Stage for Evaluate {
    fn kind(&self) -> &'static str {
        "evaluate"
    }

    fn about(&self) -> &'static str {
        "predictions of every recorded event and their errors, finite elements beside FLARE-T"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        &[
            "sensors",
            "analysis.output_step_s",
            "records.format",
            "records.components",
            "records.train",
            "records.validation",
            "records.test",
        ]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let settings: RecordSettings = task.section("records")?;
        let sensors: SensorsSection = task.section("sensors")?;
        let output_step_s: f64 = task.section("analysis.output_step_s")?;
        let predictors = predictors(task)?;
        let mut evaluation = Evaluation::default();
        for (split, record) in records::read(task.input("records")?, &settings, &sensors)?.records {
            let uncalibrated = || Error::new(format!("component `{}` is not calibrated", record.component));
            let predictor = predictors.get(&record.component).ok_or_else(uncalibrated)?;
            let replayed = replay::read(task.input("replay")?, &record.event, &record.component)?;
            let comparison = compare(predictor, &record, replayed, output_step_s);
            comparison.judge(&record, split, &mut evaluation);
            comparison.write(task.output_dir(), &record)?;
        }
        write_json(&task.output_dir().join("evaluation.json"), &evaluation)
    }
}

/// One predictor a component.
fn predictors(task: &Task<'_>) -> Result<BTreeMap<String, Predictor>> {
    let (dataset, pretrain, distill) = (task.input("dataset")?, task.input("pretrain")?, task.input("distill")?);
    task.inputs("calibrate")?
        .map(|(component, folder)| Ok((component.to_string(), Predictor::load(dataset, pretrain, distill, folder)?)))
        .collect()
}

/// Lays finite elements and FLARE-T beside one record.
fn compare(predictor: &Predictor, record: &Record, replayed: Option<Vec<Vec<f64>>>, output_step_s: f64) -> Comparison {
    let (window, step_s) = (predictor.window(), predictor.step_s());
    let coarse = Coarse::of_record(record, step_s);
    let histories: Vec<Vec<f64>> = (0..coarse.n_sparse)
        .map(|j| coarse.sparse_m_s2.iter().skip(j).step_by(coarse.n_sparse).copied().collect())
        .collect();
    let flare_t = predictor.predict(&histories, &coarse.base_m_s2, &coarse.base_half_m_s2).ok();
    // The response up to sample `window` − 1 was given; everything after it is predicted.
    let after = |h: &[f64]| -> Vec<f64> { h.iter().skip(window).copied().collect() };
    let observed: Vec<Vec<f64>> = histories.iter().map(|h| after(h)).collect();
    let n = observed.first().map_or(0, Vec::len);
    let fe = replayed
        .map(|h| {
            let coarse = h.iter().map(|x| resample_band_limited(x, output_step_s, step_s));
            coarse.map(|x| after(&x).into_iter().take(n).collect::<Vec<f64>>()).collect::<Vec<_>>()
        })
        .filter(|h| h.iter().all(|x| x.len() == n));
    Comparison { start_s: window as f64 * step_s, step_s, observed, fe, flare_t }
}

/// One event and component after the initial window, at the step of the latent model.
struct Comparison {
    start_s: f64,
    step_s: f64,
    observed: Vec<Vec<f64>>,
    fe: Option<Vec<Vec<f64>>>,
    flare_t: Option<Vec<Vec<f64>>>,
}

impl Comparison {
    fn judge(&self, record: &Record, split: Split, evaluation: &mut Evaluation) {
        let (event, component) = (record.event.clone(), record.component.clone());
        for (j, sensor) in record.outputs.iter().enumerate() {
            let observed = &self.observed[j];
            let both = |measure: &dyn Fn(&[f64], &[f64]) -> f64| {
                let of = |h: &Option<Vec<Vec<f64>>>| {
                    h.as_ref().map(|h| measure(&h[j], observed)).filter(|value| value.is_finite())
                };
                Both { fe: of(&self.fe), flare_t: of(&self.flare_t) }
            };
            evaluation.scores.push(Score {
                event: event.clone(),
                component: component.clone(),
                sensor: sensor.name.clone(),
                split,
                nrmse_percent: both(&nrmse_percent),
                r2: both(&r2),
                psa_ln_rmse: both(&|p, o| psa_ln_rmse(p, o, self.step_s)),
                timewise_median_percent: both(&|p, o| Quartiles::of(&timewise_error_percent(p, o)).median),
            });
        }
        let pooled = |h: &Option<Vec<Vec<f64>>>| {
            h.as_ref().map(|h| {
                let pairs: Vec<(&[f64], &[f64])> =
                    h.iter().zip(&self.observed).map(|(p, o)| (p.as_slice(), o.as_slice())).collect();
                r2_pooled(&pairs)
            })
        };
        let r2 = Both { fe: pooled(&self.fe), flare_t: pooled(&self.flare_t) };
        evaluation.pooled.push(Pooled { event, component, split, r2 });
    }

    /// One table an event and component: record, finite elements and FLARE-T of each sensor, m/s².
    fn write(&self, folder: &Path, record: &Record) -> Result<()> {
        let mut columns: Vec<(String, &[f64])> = Vec::new();
        for (j, sensor) in record.outputs.iter().enumerate() {
            columns.push((format!("{} record", sensor.name), &self.observed[j]));
            for (model, histories) in [("fe", &self.fe), ("flare_t", &self.flare_t)] {
                if let Some(histories) = histories {
                    columns.push((format!("{} {model}", sensor.name), &histories[j]));
                }
            }
        }
        let columns: Vec<(&str, &[f64])> = columns.iter().map(|(n, c)| (n.as_str(), *c)).collect();
        write_table(&folder.join(format!("{}.{}.csv", record.event, record.component)), self.step_s, &columns)?;
        write_json(&folder.join("axis.json"), &Axis { start_s: self.start_s, step_s: self.step_s })
    }
}

/// Time axis of the tables.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Axis {
    /// Time of the first row after the start of the record, s.
    pub start_s: f64,
    /// Step, s.
    pub step_s: f64,
}

/// Errors and time axis that stage left in `folder`.
///
/// # Errors
/// When they are not there.
pub fn read(folder: &Path) -> Result<(Evaluation, Axis)> {
    Ok((read_json(&folder.join("evaluation.json"))?, read_json(&folder.join("axis.json"))?))
}
