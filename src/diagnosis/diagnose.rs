//! The whole diagnosis: declared model, recalibrated model, forward search, backward check, verdict.

use super::anchor::Anchor;
use super::centre::centre;
use super::hygiene::suspicion;
use super::needless::least_gain;
use super::outcome::{Diagnosis, Thresholds, Verdict};
use super::path::Path;
use super::problem::{Problem, Replay};
use super::relaxed::STIFFNESS;
use super::responses::Scene;
use super::round::{Fitted, Ground, Plain};
use super::search::{CLEAN, Model, Search};
use super::settings::DiagnoseSettings;
use super::settling::MAX_ANCHORS;
use super::standing::{Standing, beside, decided, labels, others, standing, tables};
use super::together::together;
use super::unknowns::{MAX_DEVIATIONS, nuisances};
use super::verdict;
use crate::error::{Error, Result};
use crate::progress::{Progress, Quiet};
use std::cmp::Ordering;
use toml::Table;

/// Most steps of a fit.
pub(super) const STEPS: usize = 6;
/// Looks around: the first near the declared soil, the others at the recalibrated one; at least, as a rule, and at most.
const LOOKS: [usize; 3] = [2, 3, 5];
/// Standard deviations by which costs exceed those of noise where the last of them is taken.
const SURPRISE: f64 = 1.0;
/// Share of the excess over noise that a look must leave at most for another to be worth it: more is wrong than tolerances. Beyond
/// the rule it must be on its way to noise.
const WORTHWHILE: [f64; 2] = [0.7, 0.3];
/// Share of the cost of the recalibrated model below which another is a better base.
const BETTER: f64 = 0.9;
/// Most tries of a round.
const MAX_TRIES: usize = 3;

/// Names what the declared model lacks: first what stands whatever the profile, then what else there is on top of it.
///
/// # Errors
/// When an event is unusable, the column cannot be built, or a replay is impossible.
pub fn diagnose(
    problem: &Problem,
    replay: &dyn Replay,
    settings: &DiagnoseSettings,
    thresholds: &Thresholds,
    progress: &dyn Progress,
) -> Result<Diagnosis> {
    let standing = standing(problem, Some(&replay.replay(&[])?), settings)?;
    let standing = decided(standing, problem, replay, settings)?;
    let answer = |standing: Vec<Standing>| -> Result<Diagnosis> {
        if standing.is_empty() {
            return diagnose_rest(problem, replay, settings, thresholds, progress);
        }
        for s in &standing {
            progress.note(&format!("{} {} stands whatever the profile", s.found.kind, s.found.target));
        }
        let (known, beside) = beside(problem, replay, &tables(&standing));
        let rest = diagnose_rest(&known, &beside, settings, thresholds, progress)?;
        together(standing, rest, problem, replay, settings)
    };
    let others = others(&standing, &problem.array);
    let mut best = answer(standing)?;
    for other in others {
        if is_enough(&best) {
            break;
        }
        let found = answer(other)?;
        if is_better(&found, &best) {
            best = found;
        }
    }
    Ok(best)
}

/// Whether what stands needed nothing beside it.
fn is_enough(diagnosis: &Diagnosis) -> bool {
    diagnosis.verdict != Verdict::Unknown && diagnosis.effects.iter().all(|f| f.is_standing)
}

/// Whether `one` explains the records and leaves less than `other`, or no more than noise with fewer effects. Where most of the records
/// has no explanation, what is left says nothing of a sensor, and low frequencies do.
fn is_better(one: &Diagnosis, other: &Diagnosis) -> bool {
    let left = |d: &Diagnosis| d.corrected.train.max(d.corrected.validation).max(CLEAN);
    let order = match left(one).total_cmp(&left(other)) {
        Ordering::Equal => one.effects.len().cmp(&other.effects.len()),
        order => order,
    };
    one.verdict != Verdict::Unknown && order.is_lt()
}

/// Tables of the nuisances of the model that has the effects `known` and is recalibrated beside them.
///
/// # Errors
/// As [`diagnose`].
pub fn recalibrated(
    problem: &Problem,
    replay: &dyn Replay,
    known: &[Table],
    settings: &DiagnoseSettings,
    thresholds: &Thresholds,
) -> Result<Vec<Table>> {
    let (problem, replay) = beside(problem, replay, known);
    let settings = DiagnoseSettings { max_effects: 0, ..settings.clone() };
    Ok(diagnose_rest(&problem, &replay, &settings, thresholds, &Quiet)?.nuisances)
}

/// What the declared model and its `declared` effects lack.
fn diagnose_rest(
    problem: &Problem,
    replay: &dyn Replay,
    settings: &DiagnoseSettings,
    thresholds: &Thresholds,
    progress: &dyn Progress,
) -> Result<Diagnosis> {
    let mut scene = Scene::new(problem, settings)?;
    let declared = scene.declared(Some(replay), nuisances(problem)?.len())?;
    let suspicion = suspicion(&Search::new(&scene, settings, Some(replay))?, &declared)?;
    // Once relabelled, records cannot be suspected of the same again.
    if let Some(labels) = suspicion.map(labels).filter(|l| l.iter().any(|l| !problem.declared.contains(&l.found.table)))
    {
        let (known, beside) = beside(problem, replay, &tables(&labels));
        let rest = diagnose_rest(&known, &beside, settings, thresholds, progress)?;
        return together(labels, rest, problem, replay, settings);
    }
    let plain = centre(&scene, replay, settings, progress)?;
    let mut path = None;
    let mut before = f64::INFINITY;
    let mut around_plain = None;
    for look in 1..=LOOKS[2] {
        let centre = path.as_ref().map_or(&plain, |p: &Path| &p.recalibrated.train.x).clone();
        scene.look_around(replay, settings, (&[], &centre), progress)?;
        around_plain.get_or_insert_with(|| scene.clone());
        let found = Search::new(&scene, settings, Some(replay))?.recalibrated(&plain, &centre, progress)?;
        let [train, validation] = found.recalibrated.surprise();
        progress.note(&format!("recalibrated: {train:.1} and {validation:.1} standard deviations more than noise"));
        let excess = found.recalibrated.excess();
        path = Some(found);
        let worthwhile = WORTHWHILE[usize::from(look >= LOOKS[1])];
        if look >= LOOKS[0] && (train.max(validation) < SURPRISE || excess > worthwhile * before) {
            break;
        }
        before = excess;
    }
    let mut path = path.ok_or_else(|| Error::new("nothing was recalibrated"))?;
    if !path.recalibrated.is_clean() && !path.recalibrated.is_far() {
        // What replays a tolerance away could not tell is not to be credited to an effect that is looked at closely.
        let here = (path.recalibrated.clone(), path.anchor.clone());
        let found = scene.clone().settled_closely(here, replay, settings, progress)?.0;
        scene.look_around(replay, settings, (&[], found.x()), progress)?;
        let found = Search::new(&scene, settings, Some(replay))?.recalibrated(&plain, found.x(), progress)?;
        progress.note(&format!(
            "recalibrated closely: cost {:.0} before, {:.0} now",
            path.recalibrated.cost(),
            found.recalibrated.cost()
        ));
        path = found;
    }
    progress.start("diagnosis", settings.max_effects as u64);
    // Where the recalibrated model leaves no more than noise and is close to what is declared, there is nothing to explain.
    let is_open = path.recalibrated.excess() > 0.0 || path.recalibrated.is_strained();
    let rounds = if is_open { settings.max_effects } else { 0 };
    for number in 1..=rounds {
        let ground = (number, around_plain.take());
        if path.corrected.is_strained() {
            path.stiffen(&mut scene, (STIFFNESS, settings), replay)?;
        }
        let settled = (path.corrected.clone(), path.anchor.clone());
        let is_found = Search::new(&scene, settings, Some(replay))?.step(&mut path, ground, thresholds, progress)?;
        progress.advance(1);
        if !is_found {
            path.stay(&Search::new(&scene, settings, Some(replay))?, settled, progress)?;
            // Something is left that no further effect explains: one of those there may stand in for another that has moved.
            if path.accepted.len() > 1 {
                Search::new(&scene, settings, Some(replay))?.drop_needless(&mut path, thresholds, progress)?;
                path.say_once(&mut scene, settings, replay, progress)?;
            }
            break;
        }
        let base = path.recalibrated.cost();
        let kept = path.accepted.len();
        (path.corrected, path.anchor) = scene.polished(path.corrected.clone(), replay, settings, progress)?;
        Search::new(&scene, settings, Some(replay))?.drop_needless(&mut path, thresholds, progress)?;
        if path.accepted.len() == kept {
            let here = (path.corrected.clone(), path.anchor.clone());
            let here = scene.moved((here, path.rival.take()), replay, settings, progress)?;
            (path.corrected, path.anchor) = scene.beyond_tolerance(here, replay, settings, progress)?;
            let last = path.corrected.effects.last().zip(path.accepted.last_mut());
            last.into_iter().for_each(|(place, accepted)| accepted.instance = place.clone());
        }
        path.stiffen(&mut scene, (1.0, settings), replay)?;
        let here = (path.corrected.clone(), path.anchor.clone());
        (path.corrected, path.anchor) = scene.relaxed(here, replay, settings, progress)?;
        let is_left =
            path.corrected.is_strained() || path.corrected.surprise().into_iter().any(|s| s > thresholds.excess);
        // The search for an effect that was none after all may have led to better tolerances, from which others look different.
        let has_better_base = path.accepted.is_empty() && path.corrected.cost() < BETTER * base;
        if has_better_base {
            path.recalibrated = path.corrected.clone();
        }
        if !is_left || (path.accepted.len() < kept && !has_better_base) {
            break;
        }
    }
    path.stiffen(&mut scene, (1.0, settings), replay)?;
    path.replay(&Search::new(&scene, settings, Some(replay))?, progress)?;
    path.alternatives = scene.alternatives((&path.corrected, &path.anchor), replay, settings, progress)?;
    if !path.accepted.is_empty() {
        path.look_closely(&mut scene, (replay, settings), thresholds, progress)?;
    }
    verdict::assemble(&Search::new(&scene, settings, Some(replay))?, &path, thresholds)
}

impl Search<'_> {
    /// A round on `path`; whether it raised an alarm, and its best effect was added.
    ///
    /// # Errors
    /// When a replay is impossible.
    fn step(
        &self,
        path: &mut Path,
        (number, around_plain): (usize, Option<Scene<'_>>),
        thresholds: &Thresholds,
        progress: &dyn Progress,
    ) -> Result<bool> {
        let fitted = self.fair_round(path, (number, around_plain), progress)?;
        let least = |f: &Fitted| least_gain(path.accepted.iter().map(|f| f.gain), (&f.model, false), thresholds);
        // Where records are described to within noise, no detail of what was found is left for anything to describe.
        let is_alarm = |f: &&Fitted| {
            let [gain, on_validation] = if self.scene.is_stiff() {
                [thresholds.gain, f64::NEG_INFINITY]
            } else {
                [least(f), thresholds.validation_gain]
            };
            f.is_confirmed && f.gain > gain && f.validation_gain > on_validation
        };
        let Some(best) = fitted.first().filter(is_alarm) else { return Ok(false) };
        path.corrected = best.model.clone();
        let alike = fitted[1..].iter().find(|f| f.is_confirmed && f.instance.kind == best.instance.kind);
        path.rival = alike.map(|f| f.model.clone());
        path.accepted.push(best.clone());
        if let Some(confirmed) = path.confirmed.take() {
            path.anchor = confirmed;
        }
        Ok(true)
    }

    /// A round, again from a better base where the best effect's nuisances show that there is one: the effect must not be
    /// credited with what the base had only not found yet.
    fn fair_round(
        &self,
        path: &mut Path,
        (number, around_plain): (usize, Option<Scene<'_>>),
        progress: &dyn Progress,
    ) -> Result<Vec<Fitted>> {
        let open = self.open(&path.corrected.effects);
        let mut plain_scenes = vec![self.scene.alone()];
        plain_scenes.extend(around_plain);
        // From a base that is far from right, effects of the soil are looked for elsewhere.
        let along = match self.replay {
            Some(replay) if !path.corrected.is_far() => self.scene.along_all(replay, &open)?,
            _ => self.scene.clone(),
        };
        let this = Search::new(&along, self.settings, self.replay)?;
        let mut tries = 0;
        loop {
            let mut x = path.corrected.x().to_vec();
            if path.accepted.is_empty() {
                x[..self.nuisances.len()].copy_from_slice(&path.plain);
            }
            let effects = &path.corrected.effects;
            let plain = |scene| -> Result<Plain<'_>> {
                let search = Search::new(scene, self.settings, self.replay)?;
                let anchor = search.anchored(effects, &x, None)?;
                Ok(Plain { model: search.settle(effects, &x, &anchor, None, 0)?, anchor, search })
            };
            let plain = plain_scenes.iter().map(plain).collect::<Result<_>>()?;
            let ground = Ground { plain, base: path.corrected.clone(), anchor: &path.anchor };
            let round = this.round(ground, progress)?;
            path.corrected = round.base;
            tries += 1;
            if tries < MAX_TRIES
                && let Some(best) = round.fitted.first().filter(|f| f.gain > 0.0)
                && let Some((base, anchor)) = this.better_base(path, best, progress)?
            {
                path.corrected = base;
                path.anchor = anchor;
                continue;
            }
            if number == 1 {
                path.recalibrated = path.corrected.clone();
                path.first = round.fitted.clone();
            }
            path.confirmed = round.anchor;
            path.note(&round.fitted, number);
            if let Some(best) = round.fitted.first() {
                progress.note(&format!(
                    "round {number}: {} {} gains {:.0} ({:.0} on validation)",
                    best.instance.kind,
                    best.instance.place(),
                    best.gain,
                    best.validation_gain
                ));
            }
            return Ok(round.fitted);
        }
    }

    /// The base replayed and fitted from the nuisances of `best`, where that is better than the base so far.
    fn better_base(&self, path: &Path, best: &Fitted, progress: &dyn Progress) -> Result<Option<(Model, Anchor)>> {
        if self.replay.is_none() {
            return Ok(None);
        }
        let base = &path.corrected;
        let mut x = best.model.x()[..base.x().len()].to_vec();
        if let Some((nuisance, value)) = self.tolerance(best) {
            x[nuisance] = value.clamp(-MAX_DEVIATIONS, MAX_DEVIATIONS);
        }
        let near = self.settle(&base.effects, &x, &path.anchor, Some(base), STEPS)?;
        let anchor = self.anchored(&base.effects, near.x(), Some(&path.anchor))?;
        let model = self.settle(&base.effects, near.x(), &anchor, Some(&near), STEPS)?;
        progress.note(&format!("base: {:.0} so far, {:.0} from the effect's nuisances", base.cost(), model.cost()));
        let is_better = base.cost() - model.cost() > 0.3 * best.gain.max(self.charge());
        Ok(is_better.then_some((model, anchor)))
    }

    /// The declared model, and recalibrated: a fit from the `centre`, a replay there, and again as long as that helps. `plain`
    /// are the declared nuisances with the damping found for them.
    ///
    /// # Errors
    /// When a replay is impossible.
    fn recalibrated(&self, plain: &[f64], centre: &[f64], progress: &dyn Progress) -> Result<Path> {
        let zero = vec![0.0; self.nuisances.len()];
        let declared = self.settle(&[], &zero, &self.anchored(&[], &zero, None)?, None, 0)?;
        let before = self.anchored(&[], plain, None)?;
        let anchor = self.anchored(&[], centre, Some(&before))?;
        let (recalibrated, anchor) = self.settled(&[], centre, (anchor, MAX_ANCHORS), progress)?;
        Ok(Path {
            declared,
            corrected: recalibrated.clone(),
            recalibrated,
            accepted: Vec::new(),
            candidates: Vec::new(),
            first: Vec::new(),
            anchor,
            plain: plain.to_vec(),
            alternatives: Vec::new(),
            confirmed: None,
            rival: None,
            stand_ins: Vec::new(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn low_frequencies_give_way_only_to_what_explains_the_records() {
        let of = |verdict: &str, left: f64| -> Diagnosis {
            let excess = json!({ "train": left, "validation": left });
            Diagnosis::made_up(json!({ "verdict": verdict, "corrected": excess }))
        };
        let stands = of("unknown", 5000.0);
        assert!(is_better(&of("known", 4000.0), &stands) && !is_better(&of("known", 6000.0), &stands));
        assert!(!is_better(&of("unknown", 4000.0), &stands), "neither explains the records");
        assert!(!is_better(&of("none", 1.0), &of("known", 0.0)), "both leave noise, and neither names more");
    }
}
