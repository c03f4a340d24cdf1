//! The report and `metrics.json`.

use super::artifact::{read_json, read_table, write_json};
use super::evaluate::{self, Both, Evaluation};
use super::motions::MotionSummary;
use super::{compare, dataset, distill, motions, pretrain, report_closing, report_events, source_study};
use crate::dataset::Index;
use crate::error::{Context, Result};
use crate::flare::{Calibration, Guard, SourceModel, SparseEncoder, reconstruct};
use crate::metrics::{DAMPING, Quartiles, log_periods_s, median, psa, timewise_error_percent};
use crate::motion::{MotionSettings, parse_cases};
use crate::numerics::resample::resample_band_limited;
use crate::numerics::spill::Spill;
use crate::pipeline::{Stage, Task};
use crate::records::Split;
use crate::report::content::{
    Calibration as CalibrationContent, Content, Distill as DistillContent, FieldPair, Guard as GuardContent, LossTerm,
    Losses, MotionCase, Motions as MotionsContent, Pair, Prediction, Pretrain as PretrainContent, Provenance, Sample,
    Score, Series, Spectrum, StageOrigin, TimewiseError, Trace,
};
use crate::report::render;
use serde_json::{Map, Value, json};
use std::fs;
use std::path::Path;

/// Writes `report.html` and `metrics.json`.
pub struct Report;

/// Finest step spectra are computed at, s.
const SPECTRUM_STEP_S: f64 = 0.005;

impl Stage for Report {
    fn kind(&self) -> &'static str {
        "report"
    }

    fn about(&self) -> &'static str {
        "report.html and metrics.json"
    }

    fn version(&self) -> u32 {
        10
    }

    fn reads(&self) -> &'static [&'static str] {
        &["*"]
    }

    fn unkeyed(&self) -> &'static [&'static str] {
        &["records.dir", "records.truth"]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let trained = task.has_input("evaluate").then(|| evaluate::read(task.input("evaluate")?)).transpose()?;
        let metrics = match &trained {
            Some((evaluation, _)) => metrics(task, evaluation)?,
            None => {
                let compared = compare::read(task.input("compare")?)?;
                let test: Vec<_> = compared.errors.iter().filter(|row| row.split == Split::Test).collect();
                json!({ "site": task.section::<String>("name")?, "test": test })
            }
        };
        write_json(&task.output_dir().join("metrics.json"), &metrics)?;
        let content = content(task, trained)?;
        let path = task.output_dir().join("report.html");
        fs::write(&path, render(&content)?).context(|| format!("cannot write `{}`", path.display()))
    }
}

/// `metrics.json` but for the timings, which the run adds.
fn metrics(task: &Task<'_>, evaluation: &Evaluation) -> Result<Value> {
    let cases = pretrain::validation(task.input("pretrain")?)?;
    let all: Vec<f64> = cases.iter().flat_map(|c| c.nrmse_percent.iter().copied()).collect();
    let validation: Vec<Value> = cases
        .iter()
        .map(|c| {
            let q = Quartiles::of(&c.nrmse_percent);
            json!({ "case": c.case, "nrmse_percent": { "median": q.median, "q25": q.q25, "q75": q.q75 } })
        })
        .collect();
    let (encoder, observation) = SparseEncoder::load(task.input("distill")?)?;
    let reconstructions = distill::validation(task.input("distill")?)?;
    let sensors: Map<String, Value> = (0..encoder.n_sensor)
        .map(|j| {
            let errors: Vec<f64> = reconstructions.iter().map(|r| r.nrmse_percent[j]).collect();
            (observation.sensors[j].clone(), json!({ "median_nrmse_percent": median(&errors) }))
        })
        .collect();
    let (model, _) = SourceModel::load(task.input("pretrain")?)?;
    let mut components = Map::new();
    for (component, folder) in task.inputs("calibrate")? {
        let calibration = Calibration::load(folder, &model.shape)?;
        components.insert(
            component.to_string(),
            json!({ "cosine_similarity": calibration.cosine_similarity, "terms_kept": calibration.terms_kept() }),
        );
    }
    let pair = |both: &Both| json!({ "fe": both.fe, "flare_t": both.flare_t });
    let test: Vec<Value> = evaluation
        .scores
        .iter()
        .filter(|s| s.split == Split::Test)
        .map(|s| {
            json!({
                "event": s.event, "component": s.component, "sensor": s.sensor,
                "nrmse_percent": pair(&s.nrmse_percent), "r2": pair(&s.r2), "psa_ln_rmse": pair(&s.psa_ln_rmse),
                "timewise_median_percent": pair(&s.timewise_median_percent),
                "ceiling_nrmse_percent": s.ceiling_nrmse_percent,
            })
        })
        .collect();
    let pooled: Vec<Value> = evaluation
        .pooled
        .iter()
        .filter(|p| p.split == Split::Test)
        .map(|p| json!({ "event": p.event, "component": p.component, "r2": pair(&p.r2) }))
        .collect();
    Ok(json!({
        "site": task.section::<String>("name")?,
        "stages": {
            "pretrain": {
                "validation": validation,
                "median_nrmse_percent": median(&all),
                "guards": guards(&cases).iter().map(guard_metrics).collect::<Vec<Value>>(),
            },
            "distill": { "sensors": sensors },
            "calibrate": components,
        },
        "test": test,
        "test_pooled": pooled,
    }))
}

/// Rollouts beyond the training.
fn guards(cases: &[pretrain::ValidationCase]) -> [GuardContent; 2] {
    let kind = |what: &str, of: &dyn Fn(&pretrain::ValidationCase) -> Guard| {
        let list: Vec<Guard> = cases.iter().map(of).collect();
        let mut ratios: Vec<f64> = list.iter().filter_map(|g| g.ratio).collect();
        ratios.sort_by(f64::total_cmp);
        GuardContent {
            what: what.to_string(),
            finite: list.iter().filter(|g| g.is_finite).count(),
            of: list.len(),
            ratios,
            limited_share: list.iter().map(|g| g.limited_share).fold(0.0, f64::max),
        }
    };
    [kind("doubled", &|c| c.doubled), kind("tenfold", &|c| c.tenfold)]
}

fn guard_metrics(guard: &GuardContent) -> Value {
    json!({
        "what": guard.what,
        "finite": guard.finite,
        "of": guard.of,
        "median_ratio": if guard.ratios.is_empty() { None } else { Some(median(&guard.ratios)) },
        "largest_ratio": guard.ratios.last(),
        "largest_limited_share": guard.limited_share,
    })
}

/// The content; of what is `trained` where the pipeline trains something.
fn content(task: &Task<'_>, trained: Option<(Evaluation, evaluate::Axis)>) -> Result<Content> {
    let is_twin = task.optional::<String>("records.format")?.as_deref() == Some("twin");
    let mut notices = Vec::new();
    if is_twin {
        let text = "The records of this site are synthetic twins: computed by a column with parameters, noise and effects of \
                    its own that the manifest does not declare. They are not measurements, whatever their names.";
        notices.push(text.to_string());
    }
    notices.extend(unfinished(task)?);
    let content = Content {
        site: task.section("name")?,
        description: vec![task.optional("about")?.unwrap_or_default()],
        notices,
        closing: report_closing::content(task)?,
        study: source_study::content(task)?,
        provenance: provenance(task)?,
        ..Content::default()
    };
    let content = report_events::added(task, content)?;
    let Some((evaluation, axis)) = trained else { return Ok(content) };
    Ok(Content {
        motions: Some(motions_content(task)?),
        pretrain: Some(pretrain_content(task)?),
        distill: Some(distill_content(task)?),
        calibrate: calibrate_content(task)?,
        held_out: held_out(task, &evaluation, axis)?,
        scores: scores(&evaluation),
        ..content
    })
}

/// Says which motions of the ensemble the column did not finish: nothing was learned from them.
fn unfinished(task: &Task<'_>) -> Result<Option<String>> {
    if !task.has_input("simulate") {
        return Ok(None);
    }
    let index = Index::read(&task.input("simulate")?.join("index.json"))?;
    let ids: Vec<&str> = index.failures().map(|(id, _)| id).collect();
    let text = || {
        let [n, of, ids] = [ids.len().to_string(), index.cases.len().to_string(), ids.join(", ")];
        format!("The column did not finish under {n} of {of} motions, from which nothing was learned: {ids}.")
    };
    Ok((!ids.is_empty()).then(text))
}

fn motions_content(task: &Task<'_>) -> Result<MotionsContent> {
    let settings: MotionSettings = task.section("motions")?;
    let folder = task.input("motions")?;
    let summaries: Vec<MotionSummary> = read_json(&folder.join("motions.json"))?;
    let validation = parse_cases(&settings.validation)?;
    let cases = summaries.iter().enumerate().map(|(i, s)| MotionCase {
        case: s.id.clone(),
        pga_g: s.pga_g,
        validation: validation.contains(&(i + 1)),
    });
    let examples = motions::read(folder, settings.step_s)?.into_iter().take(3).map(|m| {
        let label = format!("motion {}", m.id);
        (label, Series { start_s: 0.0, step_s: m.dt_s, values: m.acceleration_m_s2 })
    });
    Ok(MotionsContent {
        duration_s: settings.duration_s,
        step_s: settings.step_s,
        cases: cases.collect(),
        examples: examples.collect(),
    })
}

fn pretrain_content(task: &Task<'_>) -> Result<PretrainContent> {
    let folder = task.input("pretrain")?;
    let data = task.input("dataset")?;
    let card = dataset::card(data)?;
    let (model, _) = SourceModel::load(folder)?;
    let cases = pretrain::validation(folder)?;
    let shown: Vec<String> = card.validation.iter().take(1).cloned().collect();
    let mut field = None;
    for case in dataset::cases(data, &shown, &Spill::none())? {
        let skip = (model.shape.window - 1) * model.shape.channels;
        let physical = |rows: &[f32]| -> Vec<f32> {
            card.normalisation.dense_to_m_s2(rows).into_iter().map(|v| v as f32).collect()
        };
        field = Some(FieldPair {
            case: case.id.clone(),
            step_s: card.step_s,
            depth_m: card.channel_depth_m.clone(),
            fe_m_s2: physical(&case.dense[skip..]),
            model_m_s2: physical(&model.roll_out(&case)?),
        });
    }
    let guards = guards(&cases).to_vec();
    let samples = cases.into_iter().map(|c| Sample { label: c.case, values: c.nrmse_percent });
    Ok(PretrainContent {
        field,
        cases: samples.collect(),
        guards,
        published_range_percent: None,
        losses: losses(&folder.join("history.csv"))?,
    })
}

fn distill_content(task: &Task<'_>) -> Result<DistillContent> {
    let folder = task.input("distill")?;
    let data = task.input("dataset")?;
    let card = dataset::card(data)?;
    let (model, _) = SourceModel::load(task.input("pretrain")?)?;
    let (encoder, observation) = SparseEncoder::load(folder)?;
    let errors = distill::validation(folder)?;
    let sensors = observation
        .sensors
        .iter()
        .enumerate()
        .map(|(j, name)| Sample { label: name.clone(), values: errors.iter().map(|e| e.nrmse_percent[j]).collect() });
    let shown: Vec<String> = card.validation.iter().take(1).cloned().collect();
    let n = encoder.n_sensor;
    let mut traces = Vec::new();
    for case in dataset::cases(data, &shown, &Spill::none())? {
        let target = card.normalisation.sparse_to_m_s2(&case.sparse[(encoder.window - 1) * n..]);
        let seen = card.normalisation.sparse_to_m_s2(&reconstruct(&model, &encoder, &observation, &case.sparse));
        for (j, sensor) in observation.sensors.iter().enumerate() {
            let series = |rows: &[f64]| Series {
                start_s: (encoder.window - 1) as f64 * card.step_s,
                step_s: card.step_s,
                values: rows.iter().skip(j).step_by(n).copied().collect(),
            };
            traces.push(trace(sensor, observation.sensor_depth_m[j], None, Some(series(&target)), Some(series(&seen))));
        }
    }
    Ok(DistillContent {
        sensors: sensors.collect(),
        published_range_percent: None,
        case: shown.into_iter().next().unwrap_or_default(),
        traces,
        losses: losses(&folder.join("history.csv"))?,
    })
}

fn calibrate_content(task: &Task<'_>) -> Result<Vec<CalibrationContent>> {
    let (model, _) = SourceModel::load(task.input("pretrain")?)?;
    let r = model.shape.library().latent;
    let matrix = |xi: &[f32]| -> Vec<Vec<f64>> {
        let per_second = 1.0 / model.shape.step_s;
        (0..r).map(|k| xi.iter().skip(k).step_by(r).map(|v| f64::from(*v) * per_second).collect()).collect()
    };
    task.inputs("calibrate")?
        .map(|(component, folder)| {
            let calibration = Calibration::load(folder, &model.shape)?;
            Ok(CalibrationContent {
                component: component.to_string(),
                terms: model.shape.library().names(),
                before: matrix(model.coefficients()),
                after: matrix(&calibration.coefficients),
                cosine_similarity: Some(calibration.cosine_similarity),
                losses: losses(&folder.join("history.csv"))?,
            })
        })
        .collect()
}

fn held_out(task: &Task<'_>, evaluation: &Evaluation, axis: evaluate::Axis) -> Result<Vec<Prediction>> {
    let depths: Vec<f64> = dataset::card(task.input("dataset")?)?.sensor_depth_m;
    let folder = task.input("evaluate")?;
    let tests = evaluation.pooled.iter().filter(|p| p.split == Split::Test);
    tests
        .map(|p| {
            let table = read_table(&folder.join(format!("{}.{}.csv", p.event, p.component)))?;
            let sensors: Vec<&str> = table.iter().filter_map(|(name, _)| name.strip_suffix(" record")).collect();
            let history = |sensor: &str, what: &str| {
                let name = format!("{sensor} {what}");
                table.iter().find(|(n, _)| *n == name).map(|(_, values)| values.clone())
            };
            let mut prediction =
                Prediction { event: p.event.clone(), component: p.component.clone(), ..Default::default() };
            for (sensor, depth_m) in sensors.into_iter().zip(&depths) {
                let series = |what: &str| {
                    history(sensor, what).map(|values| Series { start_s: axis.start_s, step_s: axis.step_s, values })
                };
                let observed = history(sensor, "record").unwrap_or_default();
                let timewise = |what: &str| {
                    history(sensor, what).map(|h| timewise_error_percent(&h, &observed)).unwrap_or_default()
                };
                prediction.timewise_percent.push(TimewiseError {
                    sensor: sensor.to_string(),
                    fe: timewise("fe"),
                    flare_t: timewise("flare_t"),
                });
                prediction.traces.push(trace(sensor, *depth_m, series("record"), series("fe"), series("flare_t")));
            }
            Ok(prediction)
        })
        .collect()
}

fn trace(sensor: &str, depth_m: f64, record: Option<Series>, fe: Option<Series>, flare_t: Option<Series>) -> Trace {
    let period_s = log_periods_s();
    let spectrum = |series: &Option<Series>| -> Vec<f64> {
        let Some(s) = series else { return Vec::new() };
        psa(&resample_band_limited(&s.values, s.step_s, SPECTRUM_STEP_S), SPECTRUM_STEP_S, DAMPING, &period_s)
    };
    let spectrum =
        Spectrum { record_m_s2: spectrum(&record), fe_m_s2: spectrum(&fe), flare_t_m_s2: spectrum(&flare_t), period_s };
    Trace { sensor: sensor.to_string(), depth_m: Some(depth_m), record, fe, flare_t, spectrum: Some(spectrum) }
}

fn scores(evaluation: &Evaluation) -> Vec<Score> {
    let pair = |both: &Both| Pair { fe: both.fe, flare_t: both.flare_t };
    let tests = evaluation.scores.iter().filter(|s| s.split == Split::Test);
    tests
        .map(|s| Score {
            event: s.event.clone(),
            component: s.component.clone(),
            sensor: s.sensor.clone(),
            nrmse_percent: pair(&s.nrmse_percent),
            ceiling_nrmse_percent: s.ceiling_nrmse_percent,
            r2: pair(&s.r2),
            psa_ln_rmse: pair(&s.psa_ln_rmse),
        })
        .collect()
}

/// The columns of a loss history; the first counts.
fn losses(path: &Path) -> Result<Option<Losses>> {
    let what = || format!("cannot read `{}`", path.display());
    let mut reader = csv::Reader::from_path(path).context(what)?;
    let names: Vec<String> = reader.headers().context(what)?.iter().map(str::to_string).collect();
    let Some((counter, names)) = names.split_first() else { return Ok(None) };
    let mut terms: Vec<LossTerm> = names.iter().map(|n| LossTerm { name: n.clone(), points: Vec::new() }).collect();
    for row in reader.records() {
        let row = row.context(what)?;
        let number = |i: usize| row.get(i).and_then(|cell| cell.parse::<f64>().ok());
        for (i, term) in terms.iter_mut().enumerate() {
            if let (Some(x), Some(y)) = (number(0), number(i + 1)) {
                term.points.push((x, y));
            }
        }
    }
    Ok(Some(Losses { counter: counter.clone(), terms, selected_at: None }))
}

fn provenance(task: &Task<'_>) -> Result<Provenance> {
    let mut manifest = task.parameters().clone();
    if let Some(toml::Value::Table(records)) = manifest.get_mut("records") {
        records.remove("dir");
        records.remove("truth");
    }
    let mut stages = Vec::new();
    for role in [
        "motions",
        "simulate",
        "dataset",
        "pretrain",
        "distill",
        "calibrate",
        "evaluate",
        "records",
        "diagnose",
        "recalibrate",
        "correct",
        "compare",
        "study",
    ] {
        if !task.has_input(role) {
            continue;
        }
        for (instance, folder) in task.inputs(role)? {
            let name = |p: Option<&std::ffi::OsStr>| p.and_then(|n| n.to_str()).unwrap_or_default().to_string();
            let kind = name(folder.parent().and_then(Path::file_name));
            let version = kind.rsplit_once("-v").and_then(|(_, v)| v.parse().ok()).unwrap_or_default();
            let stage = if instance.is_empty() { role.to_string() } else { format!("{role}.{instance}") };
            stages.push(StageOrigin { stage, version, key: name(folder.file_name()) });
        }
    }
    Ok(Provenance {
        program: format!("flare-pipe {}", env!("CARGO_PKG_VERSION")),
        manifest: manifest.to_string(),
        stages,
        seeds: vec![("motions and training".into(), task.section("motions.seed")?)],
        facts: Vec::new(),
    })
}
