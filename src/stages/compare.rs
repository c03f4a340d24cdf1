//! Six errors side by side on every recorded event, and `loop.json`. Here, and in the evaluation, held-out events are opened.

use super::artifact::{read_json, write_json};
use super::evaluate::{self, Axis, Evaluation};
use super::generic::{Channel, Generic};
use super::{correct, diagnose, extend, records, replay};
use crate::diagnosis::{self, Change, Diagnosis, ErrorRow, Six, Summary, Verdict, noise_deviation_m_s2};
use crate::effects::Class;
use crate::error::Result;
use crate::manifest::SensorsSection;
use crate::metrics::rms;
use crate::numerics::resample::resample_band_limited;
use crate::pipeline::{Stage, Task};
use crate::records::{Record, RecordSettings, Split};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// Compares the passes.
pub struct Compare;

const FILE: &str = "loop.json";

/// `loop.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Loop {
    /// The answer in a word.
    pub verdict: Verdict,
    /// Effects that the records ask for.
    pub effects: Vec<Named>,
    /// Kinds that explain the records about as well.
    pub ambiguity: Vec<String>,
    /// Effects that were tried, best first.
    pub candidates: Vec<Tried>,
    /// Share of the recalibrated model's excess that the named effects explain.
    pub explained_share: Option<f64>,
    /// Share of the recalibrated model's residual that is coherent with the recorded input.
    pub input_coherent_share: Option<f64>,
    /// Six errors of each event, component and sensor.
    pub errors: Vec<ErrorRow>,
    /// What the held-out events say.
    pub summary: Summary,
    /// Where the verdict is unknown: corrections that are no physics.
    pub generic: Option<Generic>,
    /// Remarks for people.
    pub notes: Vec<String>,
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
    /// Fall of the cost less the charge for its parameters.
    pub gain: f64,
    /// Share of the excess it explains.
    pub explained_share: f64,
}

impl Stage for Compare {
    fn kind(&self) -> &'static str {
        "compare"
    }

    fn about(&self) -> &'static str {
        "six errors before and after the correction, and what of it may be claimed: loop.json"
    }

    fn version(&self) -> u32 {
        3
    }

    fn reads(&self) -> &'static [&'static str] {
        &[
            "sensors",
            "analysis.output_step_s",
            "pretrain.step_s",
            "diagnose.seed",
            "diagnose.band_hz",
            "records.format",
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
        let diagnosis = diagnose::read(task.input("diagnose")?)?;
        let passes = Passes::read(task, !correct::correction(&diagnosis).is_empty())?;
        let is_unknown = diagnosis.verdict == Verdict::Unknown;
        let mut errors = Vec::new();
        let mut ablation = Vec::new();
        let mut channels = Vec::new();
        for (split, record) in records::read(task.input("records")?, &settings, &sensors)?.records {
            errors.extend(passes.errors(&record, split)?);
            ablation.extend(record.outputs.iter().map(|s| passes.ablation(&record, &s.name)));
            if is_unknown {
                channels.extend(passes.channels(&record, split)?);
            }
        }
        let seed = task.section("diagnose.seed")?;
        let summary = Summary::of(&errors, &ablation, seed);
        let mut notes = diagnosis.notes.clone();
        notes.extend(summary.changes.iter().map(claim));
        let mut generic = None;
        if is_unknown {
            let terms = if task.has_input("extension") {
                let read = |(component, folder): (&str, &Path)| Ok((component.to_string(), extend::read(folder)?));
                task.inputs("extension")?.map(read).collect::<Result<_>>()?
            } else {
                BTreeMap::new()
            };
            let found = Generic::of(&channels, passes.axis.step_s, task.section("diagnose.band_hz")?, terms, seed);
            notes.extend(found.notes());
            notes.extend(found.changes.iter().map(|change| format!("without physical meaning: {}", claim(change))));
            generic = Some(found);
        }
        write_json(&task.output_dir().join(FILE), &Loop { generic, ..Loop::new(&diagnosis, errors, summary, notes) })
    }
}

impl Loop {
    fn new(diagnosis: &Diagnosis, errors: Vec<ErrorRow>, summary: Summary, notes: Vec<String>) -> Self {
        let place = |target: &String| Some(target.clone()).filter(|t| !t.is_empty());
        let named = diagnosis.effects.iter().map(|e| Named {
            kind: e.kind.clone(),
            target: place(&e.target),
            parameters: e.parameters.clone(),
        });
        let tried = diagnosis.candidates.iter().map(|c| Tried {
            kind: c.kind.clone(),
            target: place(&c.target),
            class: c.class,
            gain: c.gain,
            explained_share: c.explained_share,
        });
        Self {
            verdict: diagnosis.verdict,
            effects: named.collect(),
            ambiguity: diagnosis.ambiguity.clone(),
            candidates: tried.collect(),
            explained_share: diagnosis.explained_share,
            input_coherent_share: diagnosis.input_coherent_share,
            errors,
            summary,
            generic: None,
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
        let (before, axis) = evaluation("before", true)?.unzip();
        Ok(Self {
            before,
            after: evaluation("after", is_corrected)?.map(|(e, _)| e),
            ablation: evaluation("ablation", is_corrected)?.map(|(e, _)| e),
            extended: evaluation("extended", true)?.map(|(e, _)| e),
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

    fn errors(&self, record: &Record, split: Split) -> Result<Vec<ErrorRow>> {
        let observed = self.axis.of_record(record);
        let replayed = |folder: &Path| replay::read(folder, &record.event, &record.component);
        let [declared, recalibrated] = [replayed(self.declared)?, replayed(self.recalibrated)?];
        let corrected = self.corrected.map(replayed).transpose()?.flatten();
        let best = if self.corrected.is_some() { &corrected } else { &recalibrated };
        let [on_declared, on_recalibrated, on_corrected] = [&declared, &recalibrated, &corrected]
            .map(|h| h.as_ref().and_then(|h| self.axis.of_replay(h, self.output_step_s, &observed)));
        let rows = record.outputs.iter().enumerate().map(|(j, sensor)| {
            let fe = |h: &Option<Vec<Vec<f64>>>| evaluate::nrmse(&h.as_ref()?[j], &observed[j]);
            let flare = |e: &Option<Evaluation>| nrmse(e.as_ref()?, record, &sensor.name)?.flare_t;
            let nrmse_percent = Six {
                declared: fe(&on_declared),
                recalibrated: fe(&on_recalibrated),
                corrected: fe(&on_corrected),
                flare_before: flare(&self.before),
                flare_after: flare(&self.after),
                noise_floor: best.as_ref().and_then(|h| self.floor(record, j, &h[j], &observed[j])),
            };
            ErrorRow {
                event: record.event.clone(),
                component: record.component.clone(),
                sensor: sensor.name.clone(),
                split,
                nrmse_percent,
            }
        });
        Ok(rows.collect())
    }

    fn ablation(&self, record: &Record, sensor: &str) -> Option<f64> {
        nrmse(self.ablation.as_ref()?, record, sensor)?.flare_t
    }

    /// NRMSE that noise leaves to the right model, %, with the amplification of the best model there is.
    fn floor(&self, record: &Record, sensor: usize, response: &[f64], observed: &[f64]) -> Option<f64> {
        let noise = diagnosis::noise(record);
        let response = resample_band_limited(response, self.output_step_s, record.dt_s);
        let pair = [noise.first()?, noise.get(sensor + 1)?];
        let nyquist_hz = 0.5 / self.axis.step_s;
        let deviation = noise_deviation_m_s2(&record.input.acceleration_m_s2, &response, record.dt_s, pair, nyquist_hz);
        Some(100.0 * deviation / rms(observed)).filter(|v| v.is_finite())
    }
}

fn nrmse(evaluation: &Evaluation, record: &Record, sensor: &str) -> Option<evaluate::Both> {
    let is_meant =
        |s: &&evaluate::Score| s.event == record.event && s.component == record.component && s.sensor == sensor;
    evaluation.scores.iter().find(is_meant).map(|s| s.nrmse_percent)
}

/// What a difference allows to say.
fn claim(change: &Change) -> String {
    let Change { from, to, median_points, ci95_points: [low, high], n_event, .. } = change;
    let numbers = format!("{median_points:+.1} points of NRMSE [{low:+.1}, {high:+.1}] over {n_event} held-out events");
    if change.is_improved {
        format!("{to} improves on {from}: {numbers}")
    } else {
        format!("no improvement of {to} on {from} can be claimed: {numbers}")
    }
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
