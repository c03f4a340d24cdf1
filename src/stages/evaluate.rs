//! Predictions of every recorded event, finite elements beside FLARE-T, and all errors.

use super::artifact::{read_json, write_json, write_table};
use super::{calibrate, dataset, records, replay};
use crate::dataset::Coarse;
use crate::error::{Error, Result};
use crate::flare::{Calibration, Event, Observation, SourceModel, SparseEncoder, predict};
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
        &["sensors", "analysis.output_step_s", "records.format", "records.components", "records.train",
          "records.validation", "records.test"]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let settings: RecordSettings = task.section("records")?;
        let sensors: SensorsSection = task.section("sensors")?;
        let output_step_s: f64 = task.section("analysis.output_step_s")?;
        let predictor = Predictor::load(task)?;
        let mut evaluation = Evaluation::default();
        for (split, record) in records::read(task.input("records")?, &settings, &sensors)?.records {
            let place = |e: Error| e.at(format!("event `{}`, component `{}`", record.event, record.component));
            let replayed = replay::read(task.input("replay")?, &record.event, &record.component)?;
            let fe = replayed.map(|h| {
                h.iter().map(|x| resample_band_limited(x, output_step_s, predictor.card.step_s)).collect::<Vec<_>>()
            });
            let comparison = predictor.compare(&record, fe).map_err(place)?;
            comparison.judge(&record, split, &mut evaluation);
            comparison.write(task.output_dir(), &record)?;
        }
        write_json(&task.output_dir().join("evaluation.json"), &evaluation)
    }
}

struct Predictor {
    card: dataset::Card,
    model: SourceModel,
    encoder: SparseEncoder,
    observation: Observation,
    calibrations: BTreeMap<String, Calibration>,
}

impl Predictor {
    fn load(task: &Task<'_>) -> Result<Self> {
        let card = dataset::card(task.input("dataset")?)?;
        let (model, _) = SourceModel::load(task.input("pretrain")?)?;
        let (encoder, observation) = SparseEncoder::load(task.input("distill")?)?;
        let calibrations = task
            .inputs("calibrate")?
            .map(|(component, folder)| Ok((component.to_string(), Calibration::load(folder, &model.shape)?)))
            .collect::<Result<_>>()?;
        Ok(Self { card, model, encoder, observation, calibrations })
    }

    fn compare(&self, record: &Record, fe: Option<Vec<Vec<f64>>>) -> Result<Comparison> {
        let window = self.encoder.window;
        let n_sensor = self.observation.n_sensor();
        let coarse = Coarse::of_record(record, self.card.step_s);
        let Event { u, u_half, sparse, .. } = calibrate::event(record, self.card.step_s, &self.card.normalisation);
        let calibration = self
            .calibrations
            .get(&record.component)
            .ok_or_else(|| Error::new(format!("component `{}` is not calibrated", record.component)))?;
        let initial = &sparse[..(window * n_sensor).min(sparse.len())];
        let xi = &calibration.coefficients;
        let predicted = predict(&self.model, &self.encoder, xi, &self.observation, initial, &u, &u_half).ok();
        let column = |rows: &[f64], j: usize, skip: usize| -> Vec<f64> {
            rows.iter().skip(skip * n_sensor + j).step_by(n_sensor).copied().collect()
        };
        // The response up to sample `window` − 1 was given; everything after it is predicted.
        let observed: Vec<Vec<f64>> = (0..n_sensor).map(|j| column(&coarse.sparse_m_s2, j, window)).collect();
        let flare_t = predicted.map(|rows| {
            let rows = self.card.normalisation.sparse_to_m_s2(&rows);
            (0..n_sensor).map(|j| column(&rows, j, 1)).collect::<Vec<_>>()
        });
        let n = observed.first().map_or(0, Vec::len);
        let fe = fe.map(|h| h.iter().map(|x| x.iter().skip(window).take(n).copied().collect()).collect::<Vec<Vec<f64>>>());
        let fe = fe.filter(|h| h.iter().all(|x| x.len() == n));
        Ok(Comparison { start_s: window as f64 * self.card.step_s, step_s: self.card.step_s, observed, fe, flare_t })
    }
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

