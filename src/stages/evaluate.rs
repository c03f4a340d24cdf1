//! Predictions of every recorded event, finite elements beside FLARE-T, and all errors against the records as measured.

use super::artifact::{read_json, read_table, write_json, write_table};
use super::ceiling;
use super::instrument::{Concern, Instrument, by_event, narrow};
use super::predict::Predictor;
use super::{records, replay};
use crate::dataset::Coarse;
use crate::effects::Channels;
use crate::error::{Error, Result};
use crate::manifest::SensorsSection;
use crate::metrics::{Quartiles, nrmse_percent, psa_ln_rmse, r2, r2_pooled, timewise_error_percent};
use crate::numerics::resample::resample_band_limited;
use crate::pipeline::{Stage, Task};
use crate::records::{Record, RecordSettings, Sensor, Split};
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
    /// The same of a filter fitted to the other training events or of nothing, whichever is better on these; `None` with fewer than two.
    #[serde(default)]
    pub ceiling_nrmse_percent: Option<f64>,
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
        2
    }

    fn reads(&self) -> &'static [&'static str] {
        &[
            "sensors",
            "site.depth_m",
            "effects",
            "analysis.output_step_s",
            "records.format",
            "records.components",
            "records.train",
            "records.validation",
            "records.test",
        ]
    }

    fn narrow(&self, parameters: &mut toml::Table) {
        narrow(parameters, Concern::Sensors);
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let settings: RecordSettings = task.section("records")?;
        let sensors: SensorsSection = task.section("sensors")?;
        let output_step_s: f64 = task.section("analysis.output_step_s")?;
        let instrument = Instrument::of(task)?;
        let predictors = predictors(task)?;
        let (mut evaluation, mut sides) = (Evaluation::default(), Vec::new());
        let found = records::read(task.input("records")?, &settings, &sensors)?.records;
        for (split, event) in by_event(found) {
            for (record, flare_t) in event.iter().zip(predict(&predictors, &instrument, &event)?) {
                let replayed = replay::read(task.input("replay")?, &record.event, &record.component)?;
                if flare_t.is_none() {
                    let what = format!("FLARE-T has no finite prediction of {} {}", record.event, record.component);
                    task.progress().warn(&what);
                }
                let predictor = &predictors[&record.component];
                let axis = Axis::after(predictor.window(), predictor.step_s());
                let coarse = Coarse::of_record(record, axis.step_s);
                let observed = axis.of_coarse(&coarse);
                sides.extend(ceiling::sides(record, split, &coarse, &observed));
                let fe = replayed.and_then(|h| axis.of_replay(&h, output_step_s, &observed));
                let comparison = Comparison { axis, observed, fe, flare_t };
                comparison.judge(record, split, &mut evaluation);
                comparison.write(task.output_dir(), record)?;
            }
        }
        let ceilings = ceiling::filter_nrmse_percent(&sides);
        evaluation.scores.iter_mut().zip(ceilings).for_each(|(score, ceiling)| score.ceiling_nrmse_percent = ceiling);
        write_json(&task.output_dir().join("evaluation.json"), &evaluation)
    }
}

/// What FLARE-T says the sensors record in the event of `records`, component by component: its predictions of the true
/// motions from the records undone, as the sensors see them, after the initial window.
fn predict(
    predictors: &BTreeMap<String, Predictor>,
    instrument: &Instrument,
    records: &[Record],
) -> Result<Vec<Option<Vec<Vec<f64>>>>> {
    let mut motions: Vec<Channels> = vec![Vec::new(); records.first().map_or(0, |r| r.outputs.len()) + 1];
    let (mut is_predicted, mut window, mut step_s) = (Vec::new(), 0, 0.0);
    for undone in instrument.undone(records) {
        let uncalibrated = || Error::new(format!("component `{}` is not calibrated", undone.component));
        let predictor = predictors.get(&undone.component).ok_or_else(uncalibrated)?;
        (window, step_s) = (predictor.window(), predictor.step_s());
        let coarse = Coarse::of_record(&undone, step_s);
        let mut histories = coarse.sensors();
        let predicted = predictor.predict(&histories, &coarse.base_m_s2, &coarse.base_half_m_s2).ok();
        is_predicted.push(predicted.is_some());
        for (history, predicted) in histories.iter_mut().zip(predicted.into_iter().flatten()) {
            history.truncate(window);
            history.extend(predicted);
        }
        motions[0].push(coarse.base_m_s2);
        motions[1..].iter_mut().zip(histories).for_each(|(channels, history)| channels.push(history));
    }
    let recorded = instrument.recorded(records, step_s, &motions);
    let after = |c: usize| recorded[1..].iter().map(|channels| channels[c][window..].to_vec()).collect();
    Ok(is_predicted.iter().enumerate().map(|(c, known)| known.then(|| after(c))).collect())
}

/// One predictor a component.
fn predictors(task: &Task<'_>) -> Result<BTreeMap<String, Predictor>> {
    let (dataset, pretrain, distill) = (task.input("dataset")?, task.input("pretrain")?, task.input("distill")?);
    task.inputs("calibrate")?
        .map(|(component, folder)| Ok((component.to_string(), Predictor::load(dataset, pretrain, distill, folder)?)))
        .collect()
}

/// One event and component after the initial window, at the step of the latent model.
struct Comparison {
    axis: Axis,
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
                ceiling_nrmse_percent: None,
                r2: both(&r2),
                psa_ln_rmse: both(&|p, o| psa_ln_rmse(p, o, self.axis.step_s)),
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
        write_table(&folder.join(format!("{}.{}.csv", record.event, record.component)), self.axis.step_s, &columns)?;
        write_json(&folder.join("axis.json"), &self.axis)
    }
}

/// What FLARE-T predicted of `record`, one history a sensor on the axis of the tables, m/s²; `None` where it did not.
///
/// # Errors
/// When the table that stage left in `folder` is not there.
pub fn predicted(folder: &Path, record: &Record) -> Result<Option<Vec<Vec<f64>>>> {
    let columns = read_table(&folder.join(format!("{}.{}.csv", record.event, record.component)))?;
    let of = |sensor: &Sensor| {
        let name = format!("{} flare_t", sensor.name);
        columns.iter().find(|(column, _)| *column == name).map(|(_, history)| history.clone())
    };
    Ok(record.outputs.iter().map(of).collect())
}

/// NRMSE, %, where both histories give a finite one.
pub fn nrmse(predicted: &[f64], observed: &[f64]) -> Option<f64> {
    Some(nrmse_percent(predicted, observed)).filter(|v| v.is_finite())
}

/// Time axis of the tables.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Axis {
    /// Time of the first row after the start of the record, s.
    pub start_s: f64,
    /// Step, s.
    pub step_s: f64,
}

impl Axis {
    /// The axis after `window` samples of the record.
    fn after(window: usize, step_s: f64) -> Self {
        Self { start_s: window as f64 * step_s, step_s }
    }

    /// What of a history at this step lies after the window: the response up to there was given, the rest is predicted.
    fn cut(&self, history: &[f64]) -> Vec<f64> {
        history.iter().skip((self.start_s / self.step_s).round() as usize).copied().collect()
    }

    /// The output sensors of a record on this axis.
    pub fn of_record(&self, record: &Record) -> Vec<Vec<f64>> {
        self.of_coarse(&Coarse::of_record(record, self.step_s))
    }

    /// The same of a record at the step of this axis.
    pub fn of_coarse(&self, coarse: &Coarse) -> Vec<Vec<f64>> {
        coarse.sensors().iter().map(|h| self.cut(h)).collect()
    }

    /// A replay with step `dt_s` on this axis, as long as the record on it; `None` where it ends early.
    pub fn of_replay(&self, histories: &[Vec<f64>], dt_s: f64, observed: &[Vec<f64>]) -> Option<Vec<Vec<f64>>> {
        let n = observed.first().map_or(0, Vec::len);
        let coarse = histories.iter().map(|x| self.cut(&resample_band_limited(x, dt_s, self.step_s)));
        let coarse: Vec<Vec<f64>> = coarse.map(|x| x.into_iter().take(n).collect()).collect();
        coarse.iter().all(|x: &Vec<f64>| x.len() == n).then_some(coarse)
    }
}

/// Errors and time axis that stage left in `folder`.
///
/// # Errors
/// When they are not there.
pub fn read(folder: &Path) -> Result<(Evaluation, Axis)> {
    Ok((read_json(&folder.join("evaluation.json"))?, read_json(&folder.join("axis.json"))?))
}
