//! Alarm thresholds from null twins: what the search finds in this very array when there is nothing to find.

use super::anchor::Anchor;
use super::centre::centre;
use super::outcome::Thresholds;
use super::problem::{Problem, Replay};
use super::responses::Scene;
use super::round::Ground;
use super::search::Search;
use super::settings::DiagnoseSettings;
use super::simulated::Disturbance;
use super::unknowns::{Nuisance, TOLERATED, Unknowns, nuisances};
use crate::error::{Error, Result};
use crate::numerics::random;
use crate::progress::{Progress, Quiet};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Effects fitted in a null twin: the search there starts from the truth and needs fewer.
const FINALISTS: usize = 3;
/// Steps of a null twin's recalibration.
const STEPS: usize = 15;

/// Runs the search on null twins of `problem`: recorded inputs, split, noise and tolerances are its own, the truth differs
/// from the declared model within the tolerances only. The most favourable effect of the whole catalogue is in the
/// statistic, so the number of effects tried is accounted for.
///
/// Twins come from replays of the nonlinear column around the declared values; without a replay, from the fast column.
///
/// Limits: a twin is recalibrated from its truth and between the replays that made it: thresholds hold noise and tolerances, not
/// what a recalibration with replays leaves.
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
    let mut anchor = scene.declared(replay, nuisances(problem)?.len())?;
    if let Some(replay) = replay {
        let centre = centre(&scene, replay, settings, progress)?;
        anchor = scene.look_around(replay, settings, (&[], &centre), progress)?;
    }
    progress.start("null twins", settings.null_twins as u64);
    let outcomes: Vec<Option<Null>> = (0..settings.null_twins)
        .into_par_iter()
        .map(|index| {
            let null = null(&scene, &anchor, settings, random_seed(settings.seed, index));
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
        gain: quantile(&gains, share).max(charge),
        validation_gain: 0.5 * charge,
        excess: quantile(&rising(|n| n.excess), share).max(3.0),
        deviations: quantile(&rising(|n| n.deviations), share).max(TOLERATED),
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

fn null(scene: &Scene<'_>, centre: &Anchor, settings: &DiagnoseSettings, seed: u64) -> Result<Null> {
    let nuisances = nuisances(scene.problem)?;
    let deviations = drawn(&nuisances, seed);
    let is_followed = scene.neighbours.is_some();
    let axes = scene.neighbours.as_ref().map(|n| &n.axes[..]);
    let truth = Unknowns { nuisances: &nuisances, effects: Vec::new(), axes }.build(&[], &deviations)?;
    let disturbance =
        Disturbance { seed: Some(seed), model_error: settings.model_error, deviations: Some(&deviations) };
    let problem = scene.simulated(&truth, disturbance)?;
    let twin = scene.sharing(&problem, settings)?;
    let few = DiagnoseSettings { finalists: FINALISTS, ..settings.clone() };
    let search = Search::new(&twin, &few, None)?;
    let anchor = if is_followed { centre.clone() } else { Anchor::fast(&twin) };
    let anchor = &anchor.heard_in(&twin, &truth);
    // From the truth: what is measured is what noise and tolerances look like, not how far the way to them is.
    let base = search.settle(&[], &deviations, anchor, None, STEPS)?;
    let round = search.round(Ground { plain: Vec::new(), base, anchor }, &Quiet)?;
    let n = round.base.expected[1];
    Ok(Null {
        gain: round.fitted.first().map_or(0.0, |f| f.gain),
        excess: (round.base.validation_cost() - n) / (2.0 * n).sqrt(),
        deviations: round.base.x().iter().fold(0.0, |m, x| m.max(x.abs())),
    })
}

/// Nuisances drawn from their priors, in prior standard deviations.
pub fn drawn(nuisances: &[Nuisance], seed: u64) -> Vec<f64> {
    let mut random = random::stream(seed, "null twin");
    nuisances.iter().map(|_| StandardNormal.sample(&mut random)).collect()
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
