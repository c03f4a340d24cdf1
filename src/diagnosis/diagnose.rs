//! The whole diagnosis: declared model, recalibrated model, forward search, backward check, verdict.

use super::anchor::Anchor;
use super::centre::centre;
use super::hygiene::suspicion;
use super::outcome::{Candidate, Diagnosis, Thresholds, Verdict};
use super::problem::{Problem, Replay};
use super::responses::Scene;
use super::round::{Fitted, Ground, Plain, parameters};
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use super::standing::{Standing, beside, decided, labels, others, standing};
use super::together::together;
use super::unknowns::{MAX_DEVIATIONS, nuisances};
use super::verdict;
use crate::effects::{self, Instance};
use crate::error::{Error, Result};
use crate::progress::Progress;
use std::cmp::Ordering;

/// Most steps of the recalibration, and after a new anchor.
const STEPS: [usize; 2] = [12, 6];
/// Most replays of a recalibration.
const MAX_ANCHORS: usize = 10;
/// Looks around, at least and at most: the first near the declared soil, the others at the recalibrated one.
const LOOKS: [usize; 2] = [2, 3];
/// Standard deviations by which costs exceed those of noise where the last of them is taken.
const SURPRISE: f64 = 1.0;
/// Share of the excess over noise that a look must leave at most for another to be worth it: more is wrong than tolerances.
const WORTHWHILE: f64 = 0.7;
/// Replays in a row that end a recalibration by being no better than the best one.
const MAX_FAILURES: usize = 3;
/// Hold on a fit after the first replay that did not keep what the fit promised, and its growth with each more.
const HOLD: [f64; 2] = [10.0, 10.0];
/// Standard deviations beyond noise up to which nothing is left.
const CLEAN: f64 = 3.0;
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
    let standing = decided(standing(problem, settings), problem, replay, settings)?;
    let answer = |standing: Vec<Standing>| -> Result<Diagnosis> {
        if standing.is_empty() {
            return diagnose_rest(problem, replay, settings, thresholds, progress);
        }
        for s in &standing {
            progress.note(&format!("{} {} stands whatever the profile", s.found.kind, s.found.target));
        }
        let (known, beside) = beside(problem, replay, &standing);
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

/// Whether `one` leaves less than `other`, or no more than noise with fewer effects.
fn is_better(one: &Diagnosis, other: &Diagnosis) -> bool {
    let left = |d: &Diagnosis| d.corrected.train.max(d.corrected.validation).max(CLEAN);
    match left(one).total_cmp(&left(other)) {
        Ordering::Equal => one.effects.len() < other.effects.len(),
        order => order.is_lt(),
    }
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
        let (known, beside) = beside(problem, replay, &labels);
        let rest = diagnose_rest(&known, &beside, settings, thresholds, progress)?;
        return together(labels, rest, problem, replay, settings);
    }
    let plain = centre(&scene, replay, settings, progress)?;
    let mut path = None;
    let mut before = f64::INFINITY;
    for look in 1..=LOOKS[1] {
        let centre = path.as_ref().map_or(&plain, |p: &Path| &p.recalibrated.train.x).clone();
        scene.look_around(replay, settings, (&[], &centre), progress)?;
        let found = Search::new(&scene, settings, Some(replay))?.recalibrated(&plain, &centre, progress)?;
        let [train, validation] = found.recalibrated.surprise();
        progress.note(&format!("recalibrated: {train:.1} and {validation:.1} standard deviations more than noise"));
        let excess = found.recalibrated.excess();
        path = Some(found);
        if look >= LOOKS[0] && (train.max(validation) < SURPRISE || excess > WORTHWHILE * before) {
            break;
        }
        before = excess;
    }
    let mut path = path.ok_or_else(|| Error::new("nothing was recalibrated"))?;
    progress.start("diagnosis", settings.max_effects as u64);
    // Where the recalibrated model leaves no more than noise, there is nothing to explain.
    let rounds = if path.recalibrated.excess() > 0.0 { settings.max_effects } else { 0 };
    for number in 1..=rounds {
        let is_found = Search::new(&scene, settings, Some(replay))?.step(&mut path, number, thresholds, progress)?;
        progress.advance(1);
        if !is_found {
            break;
        }
        let corrected = &path.corrected;
        let anchor = scene.look_around(replay, settings, (&corrected.effects, corrected.x()), progress)?;
        let kept = path.accepted.len();
        Search::new(&scene, settings, Some(replay))?.polish(&mut path, anchor, thresholds, progress)?;
        if path.corrected.excess() <= 0.0 || path.accepted.len() < kept {
            break;
        }
    }
    verdict::assemble(&Search::new(&scene, settings, Some(replay))?, &path, thresholds)
}

/// What a diagnosis went through.
pub(super) struct Path {
    /// The model as declared.
    pub declared: Model,
    /// Recalibrated within the tolerances, restarted from better nuisances where a fit found them.
    pub recalibrated: Model,
    /// With every accepted effect.
    pub corrected: Model,
    /// Accepted effects as they were when accepted.
    pub accepted: Vec<Fitted>,
    /// Everything fitted, round by round.
    pub candidates: Vec<Candidate>,
    /// The first round, best first.
    pub first: Vec<Fitted>,
    /// What the corrected model was settled against.
    pub anchor: Anchor,
    /// Declared nuisances but for the damping: an effect that is strong is seen from there, before nuisances have taken its
    /// place.
    plain: Vec<f64>,
    /// Anchor of the best effect of the last round.
    confirmed: Option<Anchor>,
}

impl Search<'_> {
    /// A round on `path`; whether it raised an alarm, and its best effect was added.
    ///
    /// # Errors
    /// When a replay is impossible.
    fn step(&self, path: &mut Path, number: usize, thresholds: &Thresholds, progress: &dyn Progress) -> Result<bool> {
        let fitted = self.fair_round(path, number, progress)?;
        let is_alarm =
            |f: &&Fitted| f.is_confirmed && f.gain > thresholds.gain && f.validation_gain > thresholds.validation_gain;
        let Some(best) = fitted.first().filter(is_alarm) else { return Ok(false) };
        path.corrected = best.model.clone();
        path.accepted.push(best.clone());
        if let Some(confirmed) = path.confirmed.take() {
            path.anchor = confirmed;
        }
        Ok(true)
    }

    /// Fits the corrected model once more with the replays around it, from its `anchor` there, and takes out what that makes
    /// needless.
    ///
    /// # Errors
    /// When a replay is impossible.
    fn polish(&self, path: &mut Path, anchor: Anchor, thresholds: &Thresholds, progress: &dyn Progress) -> Result<()> {
        let (effects, x) = (path.corrected.effects.clone(), path.corrected.x().to_vec());
        (path.corrected, path.anchor) = self.settled(&effects, &x, anchor, progress)?;
        self.drop_needless(path, thresholds, progress)
    }

    /// Fits from `x` and its `anchor`, replays, and fits again as long as that helps.
    ///
    /// # Errors
    /// When a replay is impossible.
    fn settled(
        &self,
        effects: &[Instance],
        x: &[f64],
        anchor: Anchor,
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let start = self.settle(effects, x, &anchor, None, 0)?;
        let fitted = self.settle(effects, x, &anchor, Some(&start), STEPS[0])?;
        let best = Some((start, anchor.clone()));
        self.replayed_until_settled(fitted, (best, &anchor), (MAX_ANCHORS, f64::INFINITY), progress)
    }

    /// A round, again from a better base where the best effect's nuisances show that there is one: the effect must not be
    /// credited with what the base had only not found yet.
    fn fair_round(&self, path: &mut Path, number: usize, progress: &dyn Progress) -> Result<Vec<Fitted>> {
        let alone = self.scene.alone();
        let search = Search::new(&alone, self.settings, self.replay)?;
        let mut tries = 0;
        loop {
            let mut x = path.corrected.x().to_vec();
            if path.accepted.is_empty() {
                x[..self.nuisances.len()].copy_from_slice(&path.plain);
            }
            let effects = &path.corrected.effects;
            let anchor = search.anchored(effects, &x, None)?;
            let model = search.settle(effects, &x, &anchor, None, 0)?;
            let plain = Some(Plain { search: &search, model, anchor });
            let ground = Ground { plain, base: path.corrected.clone(), anchor: &path.anchor };
            let round = self.round(ground, progress)?;
            path.corrected = round.base;
            tries += 1;
            if tries < MAX_TRIES
                && let Some(best) = round.fitted.first().filter(|f| f.gain > 0.0)
                && let Some((base, anchor)) = self.better_base(path, best, progress)?
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
        let near = self.settle(&base.effects, &x, &path.anchor, Some(base), STEPS[1])?;
        let anchor = self.anchored(&base.effects, near.x(), Some(&path.anchor))?;
        let model = self.settle(&base.effects, near.x(), &anchor, Some(&near), STEPS[1])?;
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
        let (recalibrated, anchor) = self.settled(&[], centre, anchor, progress)?;
        Ok(Path {
            declared,
            corrected: recalibrated.clone(),
            recalibrated,
            accepted: Vec::new(),
            candidates: Vec::new(),
            first: Vec::new(),
            anchor,
            plain: plain.to_vec(),
            confirmed: None,
        })
    }

    /// Replays `wanted`, fits from there, and again as long as that helps, at most `most` times; gives up where a replay still
    /// costs more than twice what is at stake and half of the one before. `best` is what is known already, `from` the anchor of
    /// `wanted`.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn replayed_until_settled(
        &self,
        mut wanted: Model,
        (mut best, from): (Option<(Model, Anchor)>, &Anchor),
        (most, at_stake): (usize, f64),
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let effects = wanted.effects.clone();
        let mut failures = 0;
        let mut hold = 0.0;
        for number in 0..most {
            let next = self.anchored(&effects, wanted.x(), Some(best.as_ref().map_or(from, |b| &b.1)))?;
            let seen = self.settle(&effects, wanted.x(), &next, Some(&wanted), 0)?;
            let name = effects.last().map_or("recalibration", |e| e.kind);
            progress.note(&format!(
                "{name}: cost {:.0} + {:.0} expected, {:.0} + {:.0} found, {:.0} + {:.0} noise",
                wanted.train.cost,
                wanted.validation_cost(),
                seen.train.cost,
                seen.validation_cost(),
                seen.expected[0],
                seen.expected[1]
            ));
            let before = best.as_ref().map_or(f64::INFINITY, |b| b.0.cost());
            if seen.cost() < before {
                let is_done =
                    seen.cost() > 0.995 * before || (number > 0 && seen.cost() > (2.0 * at_stake).max(0.5 * before));
                hold = loosened(hold);
                wanted = self.settle_held(&effects, seen.x(), (&next, Some(&seen)), STEPS[1], hold)?;
                best = Some((seen, next));
                failures = 0;
                if is_done {
                    break;
                }
            } else if let Some((best, anchor)) = &mut best {
                // Not what was promised: what this replay has told keeps the next step from going there.
                anchor.secants.learn(&next.secants);
                hold = tightened(hold);
                wanted = self.settle_held(&effects, best.x(), (anchor, Some(best)), STEPS[1], hold)?;
                failures += 1;
                if failures == MAX_FAILURES {
                    break;
                }
            }
        }
        let Some((best, anchor)) = best else { return Ok((wanted, Anchor::fast(self.scene))) };
        let fitted = self.settle(&effects, best.x(), &anchor, Some(&best), STEPS[1])?;
        Ok((fitted, anchor))
    }

    /// Takes out effects that would raise no alarm any more: later ones, or the replays around them, have made them needless.
    fn drop_needless(&self, path: &mut Path, thresholds: &Thresholds, progress: &dyn Progress) -> Result<()> {
        let mut index = 0;
        while index < path.accepted.len() {
            let mut effects = path.corrected.effects.clone();
            let dropped = effects.remove(index);
            let at = self.nuisances.len() + effects[..index].iter().map(|e| e.free.len()).sum::<usize>();
            let mut x = path.corrected.x().to_vec();
            x.drain(at..at + dropped.free.len());
            let without = self.settle(&effects, &x, &path.anchor, Some(&path.corrected), STEPS[1])?;
            let level = path.corrected.level().max(1.0);
            let gain = (without.cost() - path.corrected.cost()) / level - self.charge() * parameters(&dropped);
            if gain < thresholds.gain {
                progress.note(&format!("{} {} gains {gain:.0} no more", dropped.kind, dropped.place()));
                path.corrected = without;
                path.accepted.remove(index);
            } else {
                index += 1;
            }
        }
        Ok(())
    }
}

/// The hold on the next fit after a replay that kept its promise.
fn loosened(hold: f64) -> f64 {
    if hold > HOLD[0] { 0.3 * hold } else { 0.0 }
}

/// The same after one that did not.
fn tightened(hold: f64) -> f64 {
    (HOLD[1] * hold).max(HOLD[0])
}

impl Path {
    fn note(&mut self, fitted: &[Fitted], round: usize) {
        let excess = self.recalibrated.excess().max(1.0);
        self.candidates.extend(fitted.iter().map(|f| {
            let x = f.model.x();
            let own = &x[x.len() - f.instance.free.len()..];
            Candidate {
                kind: f.instance.kind.to_string(),
                target: f.instance.place(),
                class: effects::find(f.instance.kind).map_or(effects::Class::Soil, |e| e.catalogue.class),
                gain: f.gain,
                validation_gain: f.validation_gain,
                explained_share: ((self.recalibrated.cost() - f.model.cost()) / excess).clamp(0.0, 1.0),
                round,
                is_confirmed: f.is_confirmed,
                table: f.instance.at(own),
            }
        }));
    }
}
