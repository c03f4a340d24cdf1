//! Alarm thresholds from null twins: what the search finds in this very array when there is nothing to find.

use super::anchor::Anchor;
use super::outcome::Thresholds;
use super::problem::{Problem, Replay};
use super::responses::Scene;
use super::round::Ground;
use super::search::Search;
use super::settings::DiagnoseSettings;
use super::simulated::Disturbance;
use super::unknowns::{Nuisance, nuisances};
use crate::effects;
use crate::error::{Error, Result};
use crate::numerics::random;
use crate::progress::{Progress, Quiet};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Effects fitted in a null twin: the search there starts from the truth's neighbourhood and needs fewer.
const FINALISTS: usize = 3;
/// Steps of a null twin's recalibration.
const STEPS: usize = 15;
/// Distance from the declared value that no null twin excuses, in prior standard deviations.
const LEAST_DEVIATIONS: f64 = 3.0;

/// Runs the search on null twins of `problem`: recorded inputs, split, noise and tolerances are its own, the truth differs
/// from the declared model within the tolerances only. The most favourable effect of the whole catalogue is in the
/// statistic, so the number of effects tried is accounted for.
///
/// Twins come from the fast column. What the nonlinear column does beyond it at the declared values is replayed once: it is
/// distrusted here as in a diagnosis, and a random share of it is an error of every twin.
///
/// Limits: a twin is recalibrated against the fast column that made it, up to that error.
/// Check:  `tests/diagnosis.rs`: fresh null twins stay below.
///
/// # Errors
/// When no twin can be computed.
pub fn thresholds(
    problem: &Problem,
    replay: Option<&dyn Replay>,
    settings: &DiagnoseSettings,
    progress: &dyn Progress,
) -> Result<Thresholds> {
    let mut scene = Scene::new(problem, settings)?;
    let declared = scene.declared(replay, nuisances(problem)?.len())?;
    progress.start("null twins", settings.null_twins as u64);
    let outcomes: Vec<Option<Null>> = (0..settings.null_twins)
        .into_par_iter()
        .map(|index| {
            let null = null(&scene, &declared, settings, random_seed(settings.seed, index));
            progress.advance(1);
            null.ok()
        })
        .collect();
    let nulls: Vec<Null> = outcomes.into_iter().flatten().collect();
    if nulls.len() * 2 < settings.null_twins {
        let what = format!("only {} of {} null twins could be computed", nulls.len(), settings.null_twins);
        return Err(Error::new(what));
    }
    let rising = |of: fn(&Null) -> f64| {
        let mut values: Vec<f64> = nulls.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let gains = rising(|n| n.gain);
    let share = 1.0 - settings.false_alarm_share;
    let charge = Search::new(&scene, settings, None)?.charge();
    Ok(Thresholds {
        gain: quantile(&gains, share).max(0.0),
        validation_gain: 0.5 * charge,
        excess: quantile(&rising(|n| n.excess), share).max(3.0),
        deviations: quantile(&rising(|n| n.deviations), share).max(LEAST_DEVIATIONS),
        twins: nulls.len(),
        null_gains: gains,
    })
}

/// What the search found where there is nothing.
struct Null {
    gain: f64,
    excess: f64,
    deviations: f64,
}

fn null(scene: &Scene<'_>, declared: &Anchor, settings: &DiagnoseSettings, seed: u64) -> Result<Null> {
    let nuisances = nuisances(scene.problem)?;
    let truth = effects::build_all(&drawn(&nuisances, seed))?;
    let disturbance = Disturbance { seed: Some(seed), model_error: settings.model_error, beyond: Some(declared) };
    let problem = scene.simulated(&truth, disturbance)?;
    let mut twin = scene.sharing(&problem, settings)?;
    twin.distrust(declared);
    let few = DiagnoseSettings { finalists: FINALISTS, ..settings.clone() };
    let search = Search::new(&twin, &few, None)?;
    let anchor = Anchor::fast(&twin);
    let zero = vec![0.0; nuisances.len()];
    let base = search.settle(&[], &zero, &anchor, None, STEPS)?;
    let round = search.round(Ground { declared: None, base, anchor: &anchor }, &Quiet)?;
    let n = round.base.expected[1];
    Ok(Null {
        gain: round.fitted.first().map_or(0.0, |f| f.gain),
        excess: (round.base.validation_cost() - n) / (2.0 * n).sqrt(),
        deviations: round.base.x().iter().fold(0.0, |m, x| m.max(x.abs())),
    })
}

/// `[[effects]]` of nuisances drawn from their priors.
pub fn drawn(nuisances: &[Nuisance], seed: u64) -> Vec<toml::Table> {
    let mut random = random::stream(seed, "null twin");
    nuisances.iter().map(|n| n.table(StandardNormal.sample(&mut random))).collect()
}

fn random_seed(seed: u64, index: usize) -> u64 {
    seed.wrapping_mul(1_000_003).wrapping_add(index as u64)
}

/// The value below which a `share` of the rising `values` lies.
fn quantile(values: &[f64], share: f64) -> f64 {
    let at = share * (values.len() - 1) as f64;
    let (i, rest) = (at.floor() as usize, at - at.floor());
    let next = values[(i + 1).min(values.len() - 1)];
    values[i] + rest * (next - values[i])
}
