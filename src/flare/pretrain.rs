//! Stage 1: encoder, sparse latent equations and decoder from dense simulations.

use super::adam::cosine;
use super::case::{Case, amplitude_weights};
use super::history::History;
use super::memory::Drive;
use super::model::{Shape, SourceModel};
use super::objective::{Objective, Scratch, Segment, Terms};
use super::polish::polish;
use super::resume::{TrainingState, fingerprint};
use super::settings::PretrainSettings;
use super::start::{linear_start, oscillators, wake_hidden};
use super::training::Training;
use super::validation::{Score, judge};
use crate::error::{Error, Result};
use crate::numerics::random::stream;
use crate::numerics::spill::Spill;
use rand::RngExt;
use rand::seq::SliceRandom;

/// Longest gradient an optimiser step may follow.
const CLIP: f64 = 10.0;

/// Columns of the stage-1 history.
const COLUMNS: [&str; 12] = [
    "epoch",
    "total",
    "reconstruction",
    "rollout",
    "latent",
    "equation",
    "sparsity",
    "terms",
    "validation_score",
    "validation_rollout",
    "validation_reconstruction",
    "validation_nrmse_percent",
];

/// Trains a source model and returns the candidate with the lowest validation score, with the loss history.
///
/// # Errors
/// When a case does not fit the settings, its state or what is made of the cases cannot be kept, or no candidate survives the
/// validation motions.
pub fn pretrain(
    train: &[Case],
    validation: &[Case],
    settings: &PretrainSettings,
    seed: u64,
    training: &Training<'_>,
) -> Result<(SourceModel, History)> {
    let Training { checkpoint_dir, spill, progress } = training;
    check(train, validation, settings)?;
    let shape = Shape::new(settings);
    let case_weight = amplitude_weights(train.iter().map(|c| &c.dense[..]), settings.amplitude_weighting);
    let judge_weight = amplitude_weights(validation.iter().map(|c| &c.dense[..]), settings.amplitude_weighting);
    let judge = |model: &SourceModel| {
        let mut limited = model.clone(); // judged as it will be used
        limited.limit_softly(train, settings.limit_factor);
        judge(&limited, validation, &judge_weight, settings.stress_factor, settings.state_bound)
    };
    let drive = |c: &Case| shape.drive(&c.u, &c.u_half, 1.0).kept(spill);
    let drives = train.iter().map(drive).collect::<Result<Vec<Drive>>>()?;
    let objective = Objective {
        shape: &shape,
        cases: train,
        drives: &drives,
        case_weight: &case_weight,
        weights: settings.loss,
        bound: settings.state_bound as f32,
    };

    let print = fingerprint(settings, seed, train.iter().chain(validation));
    let mut state = match checkpoint_dir.and_then(|dir| TrainingState::load(dir, &print)) {
        Some(state) => state,
        None => TrainingState::new(initial(&objective, settings, seed, spill)?, History::new(&COLUMNS)),
    };
    progress.start("pretrain", settings.epochs as u64);
    progress.advance(state.epoch as u64);
    if state.epoch == 0 {
        let score = judge(&state.model);
        state.consider(score.score);
        state.history.rows.push(row(0, &objective, &[f64::NAN; 5], &state.model, Some(score)));
    }
    let mut scratch = Vec::new();
    while state.epoch < settings.epochs {
        let terms = epoch(&objective, train, settings, seed, &mut state, &mut scratch);
        state.epoch += 1;
        if thresholds_after(state.epoch, settings.epochs, settings.threshold_every) {
            prune(&mut state.model, settings.threshold);
            state.adam.restart();
        }
        if polishes_after(state.epoch, settings) {
            polished(&objective, settings, &judge, &mut state, training)?;
        }
        let is_last = state.epoch == settings.epochs;
        let is_judged = is_last || state.epoch.is_multiple_of(settings.validate_every);
        let score = is_judged.then(|| judge(&state.model));
        state.history.rows.push(row(state.epoch, &objective, &terms, &state.model, score));
        if let Some(score) = score {
            let fate = if score.score.is_finite() { "" } else { " (diverges)" };
            progress.note(&format!("validation {:.1} %{fate}", score.nrmse_percent));
            state.consider(score.score);
        }
        if let Some(dir) = checkpoint_dir
            && state.epoch.is_multiple_of(settings.validate_every * settings.checkpoint_every)
        {
            state.save(dir, &print)?;
        }
        progress.advance(1);
    }
    let best = state.best.ok_or_else(|| {
        Error::new("no candidate of the source model survives the validation motions")
            .hint("lower `learning_rate` or `stress_factor`, or train for more `epochs`")
    })?;
    Ok((best.model, state.history))
}

fn check(train: &[Case], validation: &[Case], settings: &PretrainSettings) -> Result<()> {
    if let Some((key, problem)) = settings.problems().into_iter().next() {
        return Err(Error::new(format!("`{key}` {problem}")).usage());
    }
    for (cases, what) in [(train, "training"), (validation, "validation")] {
        let Some(first) = cases.first() else {
            return Err(Error::new(format!("there is no {what} case")));
        };
        let n_sensor = first.sparse.len() / first.u.len().max(1);
        cases.iter().try_for_each(|c| c.check(settings.channels, n_sensor, settings.window + 2))?;
    }
    Ok(())
}

/// Whether coefficients are polished after `epoch` epochs: every so often in the second half, and at the end.
fn polishes_after(epoch: usize, settings: &PretrainSettings) -> bool {
    let is_due = settings.polish_every > 0 && (settings.epochs - epoch).is_multiple_of(settings.polish_every);
    settings.polish_steps > 0 && 2 * epoch >= settings.epochs && is_due
}

/// Polishes the coefficients of the model as it stands; every step is judged and enters the history.
fn polished(
    objective: &Objective<'_>,
    settings: &PretrainSettings,
    judge: &dyn Fn(&SourceModel) -> Score,
    state: &mut TrainingState,
    training: &Training<'_>,
) -> Result<()> {
    let mut model = state.model.clone();
    polish(&mut model, objective.cases, &training.spill, settings, settings.polish_steps, &mut |model, error| {
        state.model = model.clone();
        let score = judge(model);
        training.progress.note(&format!("polish: training error {error:.4}, validation {:.1} %", score.nrmse_percent));
        let mut terms = [f64::NAN; 5];
        terms[1] = error;
        state.history.rows.push(row(state.epoch, objective, &terms, model, Some(score)));
        state.consider(score.score);
    })?;
    state.adam.restart();
    Ok(())
}

/// A model before the first epoch.
fn initial(objective: &Objective<'_>, settings: &PretrainSettings, seed: u64, spill: &Spill) -> Result<SourceModel> {
    let shape = objective.shape;
    let mut random = stream(seed, "pretrain start");
    let mut parameters = oscillators(shape.library(), shape.latent, &mut random);
    parameters.extend(shape.encoder().initial(&mut random));
    parameters.extend(shape.decoder().initial(&mut random));
    let mask = vec![true; shape.library().n_coefficient()];
    let mut model = SourceModel { shape: shape.clone(), parameters, mask };
    if settings.linear_start {
        linear_start(&mut model, objective.cases, objective.case_weight, spill)?;
    }
    wake_hidden(&mut model, &mut stream(seed, "pretrain hidden start"));
    Ok(model)
}

/// One pass over the training segments.
fn epoch(
    objective: &Objective<'_>,
    train: &[Case],
    settings: &PretrainSettings,
    seed: u64,
    state: &mut TrainingState,
    scratch: &mut Vec<Scratch>,
) -> Terms {
    let is_late = 2 * state.epoch >= settings.epochs;
    let n_segment = if is_late { settings.final_segments } else { settings.segments };
    let (segments, n_step) = segments(train, settings, n_segment, seed, state.epoch);
    // longer segments, fewer a step: the samples in a step of the optimiser stay about the same
    let batch = (settings.batch * n_segment / settings.segments).clamp(1, settings.batch);
    let shape = objective.shape;
    let factor = cosine(state.epoch as f64 / settings.epochs as f64, settings.final_rate_share);
    let dynamics = shape.coefficient_range();
    let networks = dynamics.end..state.model.parameters.len();
    let groups = [(dynamics, factor * settings.dynamics_learning_rate), (networks, factor * settings.learning_rate)];
    let mut gradient = vec![0.0; state.model.parameters.len()];
    let mut mean = [0.0; 5];
    for batch in segments.chunks(batch) {
        let terms = objective.evaluate(&state.model.parameters, batch, n_step, scratch, &mut gradient);
        gradient.iter_mut().zip(&state.model.mask).filter(|(_, keep)| !**keep).for_each(|(g, _)| *g = 0.0);
        state.adam.update(&mut state.model.parameters, &gradient, &groups, CLIP);
        let share = batch.len() as f64 / segments.len() as f64;
        mean.iter_mut().zip(&terms).for_each(|(m, t)| *m += share * t);
    }
    mean
}

/// The segments of an epoch in their random order, and their common length in samples.
fn segments(
    train: &[Case],
    settings: &PretrainSettings,
    n_segment: usize,
    seed: u64,
    epoch: usize,
) -> (Vec<Segment>, usize) {
    let mut random = stream(seed, &format!("pretrain epoch {epoch}"));
    let usable = |case: &Case| case.u.len() + 1 - settings.window;
    let shortest = train.iter().map(usable).min().unwrap_or(0);
    let n_step = shortest.div_ceil(n_segment).clamp(3.min(shortest), shortest);
    let mut list = Vec::new();
    for (i, case) in train.iter().enumerate() {
        let slack = usable(case) - n_step;
        let n = usable(case).div_ceil(n_step);
        for k in 0..n {
            let even = if n > 1 { (k * slack) as f64 / (n - 1) as f64 } else { 0.5 * slack as f64 };
            let shift = if settings.jitter { (random.random::<f64>() - 0.5) * n_step as f64 } else { 0.0 };
            let place = (even + shift).round().clamp(0.0, slack as f64) as usize;
            let sign = if settings.mirror && random.random::<bool>() { -1.0 } else { 1.0 };
            list.push(Segment { case: i, start: settings.window - 1 + place, sign });
        }
    }
    list.shuffle(&mut random);
    (list, n_step)
}

/// Whether coefficients are thresholded after `epoch` epochs of `epochs`; not in the last quarter.
pub(super) fn thresholds_after(epoch: usize, epochs: usize, every: usize) -> bool {
    every > 0 && epoch.is_multiple_of(every) && 4 * epoch <= 3 * epochs
}

/// Removes coefficients smaller than `threshold` for good.
fn prune(model: &mut SourceModel, threshold: f64) {
    for (c, keep) in model.parameters.iter_mut().zip(&mut model.mask) {
        *keep &= f64::from(c.abs()) >= threshold;
        if !*keep {
            *c = 0.0;
        }
    }
}

fn row(epoch: usize, objective: &Objective<'_>, terms: &Terms, model: &SourceModel, score: Option<Score>) -> Vec<f64> {
    let mut row = vec![epoch as f64, objective.total(terms)];
    row.extend(terms);
    row.push(model.mask.iter().filter(|k| **k).count() as f64);
    let none = f64::NAN;
    row.extend(score.map_or([none; 4], |s| [s.score, s.rollout, s.reconstruction, s.nrmse_percent]));
    row
}
