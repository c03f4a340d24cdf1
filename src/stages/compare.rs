//! Six errors and the field's measures on every recorded event, their ceiling, and `loop.json`. Here, and in the evaluation, held-out
//! events are opened.

use super::artifact::{read_json, write_json};
use super::evaluate::{self, Axis, Evaluation};
use super::generic::{Channel, Generic};
use super::side_by_side::{self, Histories, judged};
use super::{correct, diagnose, extend, histories, records, replay, report_closing};
use crate::dataset::Coarse;
use crate::diagnosis::{
    self, Change, Diagnosis, ErrorRow, NoiseSource, NoiseSpectrum, Six, Summary, Verdict, noise_deviation_m_s2,
};
use crate::effects::Class;
use crate::error::Result;
use crate::manifest::SensorsSection;
use crate::metrics::rms;
use crate::numerics::resample::resample_band_limited;
use crate::pipeline::{Stage, Task};
use crate::records::{Record, RecordSettings, Sensor, Split};
use crate::report;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Compares the passes.
pub struct Compare;

const FILE: &str = "loop.json";

/// `loop.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Loop {
    /// The answer in sentences: what is named, what remains, errors before and after, what to do next.
    pub answer: Vec<String>,
    /// The answer in a word.
    pub verdict: Verdict,
    /// Effects that the records ask for.
    pub effects: Vec<Named>,
    /// Every declared value that may be off, beside what is named.
    pub declared: Vec<diagnosis::DeclaredValue>,
    /// Kinds that could be there unnoticed beside the answer, the best hidden first.
    pub hidden: Vec<diagnosis::Hidden>,
    /// What elements and steps half as large would change of the strongest event's motions under the model of the answer, a share.
    #[serde(default)]
    pub discretisation_share: Option<f64>,
    /// Kinds that explain the records about as well.
    pub ambiguity: Vec<String>,
    /// Effects that were tried, best first.
    pub candidates: Vec<Tried>,
    /// Share of the power of the recalibrated model's residual that the named effects explain.
    pub explained_share: Option<f64>,
    /// Six errors of each event, component and sensor.
    pub errors: Vec<ErrorRow>,
    /// What the held-out events say.
    pub summary: Summary,
    /// Where the verdict is unknown: corrections that are no physics.
    pub generic: Option<Generic>,
    /// What remains beside what is named, where the diagnosis says it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rest: Option<diagnosis::Rest>,
    /// What tells the noise of the sensors, record by record.
    pub noise: Vec<RecordNoise>,
    /// Remarks for people.
    pub notes: Vec<String>,
}

/// Noise of one record.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordNoise {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// What tells it.
    pub source: NoiseSource,
}

/// A named effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Named {
    /// Name of the effect.
    pub kind: String,
    /// Where it sits; `None` for the whole column.
    pub target: Option<String>,
    /// Its parameters by name.
    pub parameters: BTreeMap<String, diagnosis::Estimate>,
    /// Probability that chance brings as much, where that is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p_value: Option<f64>,
}

/// An effect that was tried.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tried {
    /// Name of the effect.
    pub kind: String,
    /// Where it would sit; `None` for the whole column.
    pub target: Option<String>,
    /// What it acts on.
    pub class: Class,
    /// ln of the odds against what is declared.
    pub gain: f64,
    /// Share of the residual power that it explains.
    pub explained_share: f64,
}

impl Stage for Compare {
    fn kind(&self) -> &'static str {
        "compare"
    }

    fn about(&self) -> &'static str {
        "six errors and the field's measures before and after the correction, their ceiling, and what may be claimed: loop.json"
    }

    fn version(&self) -> u32 {
        14
    }

    fn reads(&self) -> &'static [&'static str] {
        &[
            "sensors",
            "analysis.output_step_s",
            "pretrain.step_s",
            "diagnose.band_hz",
            "records.format",
            "records.noise",
            "records.components",
            "records.train",
            "records.validation",
            "records.test",
        ]
    }

    fn publishes(&self) -> &'static [&'static str] {
        &[FILE]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let settings: RecordSettings = task.section("records")?;
        let sensors: SensorsSection = task.section("sensors")?;
        let band_hz: [f64; 2] = task.section("diagnose.band_hz")?;
        let diagnosis = diagnose::read(task.input("diagnose")?)?;
        let passes = Passes::read(task, !correct::correction(&diagnosis).is_empty())?;
        let is_unknown = diagnosis.verdict == Verdict::Unknown;
        let mut beside = Vec::new();
        let mut ablation = Vec::new();
        let mut channels = Vec::new();
        let mut noise = Vec::new();
        for (split, record) in records::read(task.input("records")?, &settings, &sensors)?.records {
            let spectra = diagnosis::noise(&record, settings.noise);
            beside.extend(passes.beside(&record, &spectra, split)?);
            ablation.extend(record.outputs.iter().map(|s| passes.ablation(&record, &s.name)));
            let (event, component) = (record.event.clone(), record.component.clone());
            noise.push(RecordNoise { event, component, source: spectra[0].source });
            if is_unknown {
                channels.extend(passes.channels(&record, split)?);
            }
        }
        histories::write(task.output_dir(), &beside, passes.axis.start_s)?;
        let (errors, transfer) = judged(&beside, &coherence(&diagnosis), band_hz[0]);
        let summary = Summary::of(&errors, &ablation, transfer);
        let mut notes = diagnosis.notes.clone();
        notes.extend(diagnosis::missing_predictions(&errors));
        notes.extend(summary.changes.iter().filter(|change| change.is_told()).map(Change::claim));
        let mut generic = None;
        if is_unknown {
            let terms = if task.has_input("extension") {
                let read = |(component, folder): (&str, &Path)| Ok((component.to_string(), extend::read(folder)?));
                task.inputs("extension")?.map(read).collect::<Result<_>>()?
            } else {
                BTreeMap::new()
            };
            let found = Generic::of(&channels, passes.axis.step_s, band_hz, terms);
            notes.extend(found.notes());
            notes.extend(found.changes.iter().map(|change| format!("without physical meaning: {}", change.claim())));
            generic = Some(found);
        }
        let answer = report::answer(&report_closing::closing(&diagnosis, &errors, &summary, generic.as_ref()));
        let found = Loop { answer, generic, noise, ..Loop::new(&diagnosis, errors, summary, notes) };
        write_json(&task.output_dir().join(FILE), &found)
    }
}

/// Pairs of frequency (Hz) and coherence by sensor, where the diagnosis knows them; the coherent band is the whole one elsewhere.
fn coherence(diagnosis: &Diagnosis) -> BTreeMap<String, Vec<[f64; 2]>> {
    diagnosis.rest.as_ref().map_or_else(BTreeMap::new, |rest| rest.coherence.clone())
}

impl Loop {
    fn new(diagnosis: &Diagnosis, errors: Vec<ErrorRow>, summary: Summary, notes: Vec<String>) -> Self {
        let place = |target: &String| Some(target.clone()).filter(|t| !t.is_empty());
        let named = diagnosis.effects.iter().map(|e| Named {
            kind: e.kind.clone(),
            target: place(&e.target),
            parameters: e.parameters.clone(),
            p_value: e.p_value,
        });
        let tried = diagnosis.candidates.iter().map(|c| Tried {
            kind: c.kind.clone(),
            target: place(&c.target),
            class: c.class,
            gain: c.gain,
            explained_share: c.explained_share,
        });
        Self {
            answer: Vec::new(),
            verdict: diagnosis.verdict,
            effects: named.collect(),
            declared: diagnosis.declared.clone(),
            hidden: diagnosis.hidden.clone(),
            discretisation_share: diagnosis.discretisation_share,
            ambiguity: diagnosis.ambiguity.clone(),
            candidates: tried.collect(),
            explained_share: diagnosis.explained_share,
            errors,
            summary,
            generic: None,
            rest: diagnosis.rest.clone(),
            noise: Vec::new(),
            notes,
        }
    }
}

/// What the passes left; FLARE-T's part is missing where the pipeline does not train it.
struct Passes<'a> {
    before: Option<Evaluation>,
    after: Option<Evaluation>,
    ablation: Option<Evaluation>,
    /// With more terms in the latent equations.
    extended: Option<Evaluation>,
    /// Where the predictions of the first two lie.
    before_dir: Option<&'a Path>,
    after_dir: Option<&'a Path>,
    axis: Axis,
    output_step_s: f64,
    /// Replays of the manifest as declared, recalibrated and, where something was corrected, corrected.
    declared: &'a Path,
    recalibrated: &'a Path,
    corrected: Option<&'a Path>,
}

impl<'a> Passes<'a> {
    fn read(task: &'a Task<'_>, is_corrected: bool) -> Result<Self> {
        let evaluation = |role: &str, is_wanted: bool| -> Result<Option<(Evaluation, Axis)>> {
            if is_wanted && task.has_input(role) { evaluate::read(task.input(role)?).map(Some) } else { Ok(None) }
        };
        let folder = |role: &str, is_wanted: bool| -> Result<Option<&Path>> {
            (is_wanted && task.has_input(role)).then(|| task.input(role)).transpose()
        };
        let (before, axis) = evaluation("before", true)?.unzip();
        Ok(Self {
            before,
            after: evaluation("after", is_corrected)?.map(|(e, _)| e),
            ablation: evaluation("ablation", is_corrected)?.map(|(e, _)| e),
            extended: evaluation("extended", true)?.map(|(e, _)| e),
            before_dir: folder("before", true)?,
            after_dir: folder("after", is_corrected)?,
            axis: match axis {
                Some(axis) => axis,
                None => Axis { start_s: 0.0, step_s: task.section("pretrain.step_s")? },
            },
            output_step_s: task.section("analysis.output_step_s")?,
            declared: task.input("declared")?,
            recalibrated: task.input("recalibrated")?,
            corrected: is_corrected.then(|| task.input("corrected")).transpose()?,
        })
    }

    /// The best that there is without a correction that is no physics, and with one in FLARE-T.
    fn channels(&self, record: &Record, split: Split) -> Result<Vec<Channel>> {
        let observed = self.axis.of_record(record);
        let replayed = replay::read(self.corrected.unwrap_or(self.recalibrated), &record.event, &record.component)?;
        let fe = replayed.and_then(|h| self.axis.of_replay(&h, self.output_step_s, &observed));
        let of = |(j, observed): (usize, Vec<f64>)| {
            let sensor = record.outputs[j].name.clone();
            let flare = |e: &Option<Evaluation>| nrmse(e.as_ref()?, record, &sensor)?.flare_t;
            let plain = if self.after.is_some() { &self.after } else { &self.before };
            Channel {
                event: record.event.clone(),
                component: record.component.clone(),
                split,
                observed,
                fe: fe.as_ref().map(|h| h[j].clone()),
                flare_t: [flare(plain), flare(&self.extended)],
                sensor,
            }
        };
        Ok(observed.into_iter().enumerate().map(of).collect())
    }

    /// What was recorded and predicted at every output sensor; `noise` is that of all sensors, the input sensor first.
    fn beside(&self, record: &Record, noise: &[NoiseSpectrum], split: Split) -> Result<Vec<side_by_side::Channel>> {
        let on_axis = Coarse::of_record(record, self.axis.step_s);
        let observed = self.axis.of_coarse(&on_axis);
        let input = on_axis.base_m_s2;
        let mut fine = BTreeMap::new();
        let mut coarse = BTreeMap::new();
        let mut best = None;
        for (model, folder) in [
            ("declared", Some(self.declared)),
            ("recalibrated", Some(self.recalibrated)),
            ("corrected", self.corrected),
        ] {
            let Some(folder) = folder else { continue };
            // The best model is the last one there should be, whether or not its column finished this event.
            best = replay::read(folder, &record.event, &record.component)?;
            let Some(replayed) = &best else { continue };
            if let Some(on_axis) = self.axis.of_replay(replayed, self.output_step_s, &observed) {
                coarse.insert(model, on_axis);
            }
            if let Some(at_step) = at_step_of(record, replayed, self.output_step_s) {
                fine.insert(model, at_step);
            }
        }
        for (model, folder) in [("flare_before", self.before_dir), ("flare_after", self.after_dir)] {
            let predicted = folder.map(|folder| evaluate::predicted(folder, record)).transpose()?.flatten();
            if let Some(predicted) = predicted.filter(|p| p.iter().zip(&observed).all(|(p, a)| p.len() == a.len())) {
                coarse.insert(model, predicted);
            }
        }
        let channel = |(j, sensor): (usize, &Sensor)| {
            let of = |all: &BTreeMap<&'static str, Vec<Vec<f64>>>| {
                all.iter().map(|(model, histories)| (*model, histories[j].clone())).collect()
            };
            let fine = Histories {
                dt_s: record.dt_s,
                input: record.input.acceleration_m_s2.clone(),
                observed: sensor.acceleration_m_s2.clone(),
                predicted: of(&fine),
            };
            let coarse = Histories {
                dt_s: self.axis.step_s,
                input: input.clone(),
                observed: observed[j].clone(),
                predicted: of(&coarse),
            };
            let flare = |e: &Option<Evaluation>| nrmse(e.as_ref()?, record, &sensor.name)?.flare_t;
            let nrmse_percent = Six {
                declared: coarse.nrmse("declared"),
                recalibrated: coarse.nrmse("recalibrated"),
                corrected: coarse.nrmse("corrected"),
                flare_before: flare(&self.before),
                flare_after: flare(&self.after),
                noise_floor: best
                    .as_ref()
                    .and_then(|h| self.floor(record, [&noise[0], &noise[j + 1]], &h[j], &observed[j])),
                ceiling: None,
            };
            let (event, component) = (record.event.clone(), record.component.clone());
            side_by_side::Channel { event, component, sensor: sensor.name.clone(), split, fine, coarse, nrmse_percent }
        };
        Ok(record.outputs.iter().enumerate().map(channel).collect())
    }

    fn ablation(&self, record: &Record, sensor: &str) -> Option<f64> {
        nrmse(self.ablation.as_ref()?, record, sensor)?.flare_t
    }

    /// NRMSE that `noise` of the input and of the output sensor leaves to the right model, %, with the amplification of the best model
    /// there is.
    fn floor(&self, record: &Record, noise: [&NoiseSpectrum; 2], response: &[f64], observed: &[f64]) -> Option<f64> {
        let response = resample_band_limited(response, self.output_step_s, record.dt_s);
        let nyquist_hz = 0.5 / self.axis.step_s;
        let deviation =
            noise_deviation_m_s2(&record.input.acceleration_m_s2, &response, record.dt_s, noise, nyquist_hz);
        Some(100.0 * deviation / rms(observed)).filter(|v| v.is_finite())
    }
}

fn nrmse(evaluation: &Evaluation, record: &Record, sensor: &str) -> Option<evaluate::Both> {
    let is_meant =
        |s: &&evaluate::Score| s.event == record.event && s.component == record.component && s.sensor == sensor;
    evaluation.scores.iter().find(is_meant).map(|s| s.nrmse_percent)
}

/// A replay at the step of the record, as long as it; `None` where it ends early.
fn at_step_of(record: &Record, replayed: &[Vec<f64>], dt_s: f64) -> Option<Vec<Vec<f64>>> {
    let n = record.n_step();
    let at_step = |x: &Vec<f64>| {
        let mut at_step = resample_band_limited(x, dt_s, record.dt_s);
        // Where the steps are no multiples of each other the last sample may fall behind the end.
        let last = at_step.last().copied().filter(|_| at_step.len() + 1 >= n)?;
        at_step.resize(n, last);
        Some(at_step)
    };
    replayed.iter().map(at_step).collect()
}

/// Of `loop.json` what no diagnosis says.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Compared {
    /// Six errors of each event, component and sensor.
    pub errors: Vec<ErrorRow>,
    /// What the held-out events say.
    pub summary: Summary,
    /// Corrections that are no physics, where they were asked for.
    pub generic: Option<Generic>,
}

/// What that stage left in `folder`.
///
/// # Errors
/// When it is not there.
pub fn read(folder: &Path) -> Result<Compared> {
    read_json(&folder.join(FILE))
}
