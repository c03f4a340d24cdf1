//! Twins of an array by the dozen: records of a drawn truth, diagnosis, errors on held-out events, each twin cached.

use super::artifact::{read_toml, write_json, write_toml};
use super::correct::correction;
use super::evaluate::{Axis, nrmse};
use super::instrument::by_event;
use super::problem::{Bench, READS};
use super::records;
use crate::diagnosis::{DiagnoseSettings, Diagnosis};
use crate::effects::Tolerances;
use crate::error::{Error, Result};
use crate::inference;
use crate::manifest::ColumnSections;
use crate::metrics::median;
use crate::pipeline::{Item, ItemKind, Stage, Task};
use crate::progress::Quiet;
use crate::records::{Record, RecordSettings, Split};
use crate::twin::{self, Case, Four, Matrix, Outcome, Recovered, Report, Truth};
use rayon::prelude::*;
use std::path::Path;
use toml::{Table, Value};

/// Runs the matrix.
pub struct Twins;

/// Kind and version of the cache entries of single twins.
const TWIN: ItemKind = ItemKind::of_output("twin", 75);
/// For the command; the same is beside it as JSON, where what is open upwards is `null`.
const FILE: &str = "twins.toml";
/// Step at which errors are taken, s.
const STEP_S: f64 = 0.05;

/// What the stage reads: the problem and the section `twins` that the command adds.
const SECTIONS: &[&str] = &{
    let mut all = [""; READS.len() + 1];
    let mut i = 0;
    while i < READS.len() {
        all[i] = READS[i];
        i += 1;
    }
    all[READS.len()] = "twins";
    all
};

impl Stage for Twins {
    fn kind(&self) -> &'static str {
        "twins"
    }

    fn about(&self) -> &'static str {
        "twins with drawn truths, what the diagnosis makes of each, and the tally"
    }

    fn version(&self) -> u32 {
        73
    }

    fn reads(&self) -> &'static [&'static str] {
        SECTIONS
    }

    fn publishes(&self) -> &'static [&'static str] {
        &["twins.json"]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let stand = Stand::of(task)?;
        let array = stand.sections.array(&stand.records.components)?;
        let cases = stand.matrix.cases(&stand.truth, &array, stand.seed)?;
        let items = cases.iter().map(|case| stand.item(task, case)).collect::<Result<Vec<_>>>()?;
        let outcomes =
            task.items(&TWIN, &items, |i, folder| write_toml(&folder.join("twin.toml"), &stand.outcome(&cases[i])?))?;
        let (mut done, mut failed) = (Vec::new(), Vec::new());
        for outcome in outcomes {
            match outcome.output {
                Ok(folder) => done.push(read_toml::<Outcome>(&folder.join("twin.toml"))?),
                Err(reason) => failed.push((outcome.id, reason)),
            }
        }
        let report = Report::new(stand.seed, done, failed);
        write_json(&task.output_dir().join("twins.json"), &report)?;
        write_toml(&task.output_dir().join(FILE), &report)
    }
}

/// The report that stage left in `folder`.
///
/// # Errors
/// When it is not there.
pub fn read(folder: &Path) -> Result<Report> {
    read_toml(&folder.join(FILE))
}

/// What every twin shares.
struct Stand {
    sections: ColumnSections,
    tolerances: Tolerances,
    records: RecordSettings,
    settings: DiagnoseSettings,
    matrix: Matrix,
    truth: Truth,
    seed: u64,
}

impl Stand {
    fn of(task: &Task<'_>) -> Result<Self> {
        Ok(Self {
            sections: records::column(task)?,
            tolerances: task.section("tolerances")?,
            records: task.section("records")?,
            settings: task.section("diagnose")?,
            matrix: task.section("twins.matrix")?,
            truth: task.section("twins.truth")?,
            seed: task.section("twins.seed")?,
        })
    }

    fn item(&self, task: &Task<'_>, case: &Case) -> Result<Item> {
        let text = |e: toml::ser::Error| Error::new("a twin cannot be written as TOML").cause(e);
        let mut parameters = task.parameters().clone();
        parameters.remove("twins");
        parameters.insert("truth".into(), Value::try_from(&case.truth).map_err(text)?);
        Ok(Item { id: format!("{} {}", case.cell, case.number), parameters })
    }

    /// Records of the events of `splits` under `truth`, event by event.
    fn record(&self, truth: &Truth, splits: &[Split]) -> Result<Vec<(Split, Vec<Record>)>> {
        let recorder = twin::recorder(&self.sections, &self.tolerances, truth)?;
        let events: Vec<(&str, Split)> = self.records.events().filter(|(_, split)| splits.contains(split)).collect();
        let record = |(event, split): &(&str, Split)| {
            let records = twin::record_event(&recorder, event, &self.records.components)?;
            Ok(records.into_iter().map(|record| (*split, record)).collect::<Vec<_>>())
        };
        let records: Vec<Vec<(Split, Record)>> = events.par_iter().map(record).collect::<Result<_>>()?;
        Ok(by_event(records.into_iter().flatten().collect()))
    }

    fn bench(&self, events: Vec<(Split, Vec<Record>)>) -> Result<Bench<'static>> {
        Bench::new(None, self.sections.clone(), &self.settings, self.tolerances.clone(), self.records.clone(), events)
    }

    fn outcome(&self, case: &Case) -> Result<Outcome> {
        let start = std::time::Instant::now();
        let seen = self.record(&case.truth, &[Split::Train, Split::Validation])?;
        let bench = self.bench(seen)?;
        let diagnosis = inference::diagnose(&bench.problem, &bench, &self.settings, &Quiet)?;
        let held_out: Vec<Vec<Record>> =
            self.record(&case.truth, &[Split::Test])?.into_iter().map(|(_, records)| records).collect();
        let error = |tables: &[Table]| self.error(&bench, tables, &held_out);
        let with_recalibration = |mut tables: Vec<Table>| -> Result<Option<f64>> {
            tables.extend(inference::recalibrate(&bench.problem, &bench, &self.settings, &tables)?);
            error(&tables)
        };
        let corrected = correction(&diagnosis);
        let truth = case.tables(&bench.problem.array, &self.tolerances);
        let effects = &case.truth.effects;
        let without = |left_out: usize| -> Result<Option<f64>> {
            let mut tables = effects.clone();
            tables.remove(left_out);
            with_recalibration(tables)
        };
        let floor = || match (case.truth.outside.is_empty(), case.is_foreign) {
            (false, _) => Ok(None),
            (true, false) => error(&truth),
            // The declared law cannot be the truth: what it reaches where the effects are known is the least there is.
            (true, true) => with_recalibration(effects.clone()),
        };
        let several = if effects.len() > 1 { 0..effects.len() } else { 0..0 };
        let without_one = several.map(without).collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
        let mut ranked: Vec<String> = Vec::new();
        for candidate in diagnosis.candidates.iter().filter(|c| c.round == 1) {
            if !ranked.contains(&candidate.kind) {
                ranked.push(candidate.kind.clone());
            }
        }
        Ok(Outcome {
            cell: case.cell.clone(),
            number: case.number,
            truth: case.truth.effects.clone(),
            besides: case.truth.kinds_besides(),
            outside: case.truth.outside.iter().filter_map(|t| Some(t.get("kind")?.as_str()?.to_string())).collect(),
            outside_repeats: case.truth.outside_repeats()?,
            verdict: diagnosis.verdict,
            found: diagnosis.effects.iter().map(|e| e.table.clone()).collect(),
            ambiguity: diagnosis.ambiguity.clone(),
            rest: diagnosis.rest.as_ref().map(|rest| rest.verdict),
            ranked,
            gain: diagnosis.candidates.first().map_or(0.0, |c| c.gain),
            explained_share: diagnosis.explained_share,
            parameters: recovered(case, &case.drawn(&bench.problem.array, &self.tolerances), &diagnosis),
            nrmse_percent: Four {
                declared: error(&[])?,
                recalibrated: error(&diagnosis.nuisances)?,
                corrected: if corrected.is_empty() { None } else { error(&corrected)? },
                floor: floor()?,
            },
            without_one_percent: without_one,
            seconds: start.elapsed().as_secs_f64(),
        })
    }

    /// Median NRMSE of the column under `tables` over the sensors of the held-out events, %.
    fn error(&self, bench: &Bench<'_>, tables: &[Table], held_out: &[Vec<Record>]) -> Result<Option<f64>> {
        let axis = Axis { start_s: 0.0, step_s: STEP_S };
        let responses = bench.recorded(tables, held_out)?;
        let mut errors = Vec::new();
        for (record, response) in held_out.iter().flatten().zip(responses) {
            let observed = axis.of_record(record);
            let replayed =
                response.ok().and_then(|h| axis.of_replay(&h, self.sections.analysis.output_step_s, &observed));
            for (predicted, observed) in replayed.iter().flatten().zip(&observed) {
                errors.extend(nrmse(predicted, observed));
            }
        }
        Ok((!errors.is_empty()).then(|| median(&errors)))
    }
}

/// Parameters of the effects that were rightly named, beside what held; places that only shape an effect left out.
fn recovered(case: &Case, drawn: &[Table], diagnosis: &Diagnosis) -> Vec<Recovered> {
    let mut all = Vec::new();
    for found in &diagnosis.effects {
        let is_held = |t: &&Table| t.get("kind").and_then(Value::as_str) == Some(&found.kind);
        let held = case.truth.effects.iter().find(is_held);
        // What is off in all, where that is what was found.
        let besides = if found.is_total { drawn } else { &[] };
        for (name, estimate) in &found.parameters {
            if let Some(value) = held.and_then(|held| twin::total(held, name, besides)) {
                let name = format!("{}.{name}", found.kind);
                all.push(Recovered { name, truth: value, value: estimate.value, ci95: estimate.ci95 });
            }
        }
    }
    all
}
