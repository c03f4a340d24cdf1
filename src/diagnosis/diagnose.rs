//! The whole diagnosis: declared model, recalibrated model, forward search, backward check, verdict.

use super::anchor::Anchor;
use super::hygiene::suspicion;
use super::outcome::{Candidate, Diagnosis, Thresholds};
use super::problem::{Problem, Replay};
use super::responses::Scene;
use super::round::{Fitted, Ground, parameters};
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use super::standing::{beside, decided, labels, standing, together};
use super::unknowns::nuisances;
use super::verdict;
use crate::effects;
use crate::error::Result;
use crate::progress::Progress;

/// Most steps of the recalibration, and after a new anchor.
const STEPS: [usize; 2] = [12, 6];
/// Most replays of a recalibration.
const MAX_ANCHORS: usize = 6;
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
    if standing.is_empty() {
        return diagnose_rest(problem, replay, settings, thresholds, progress);
    }
    for s in &standing {
        progress.note(&format!("{} {} stands whatever the profile", s.found.kind, s.found.target));
    }
    let (known, beside) = beside(problem, replay, &standing);
    let rest = diagnose_rest(&known, &beside, settings, thresholds, progress)?;
    together(standing, rest, problem, replay, settings)
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
    let search = Search::new(&scene, settings, Some(replay))?;
    let path = search.walk(declared, thresholds, progress)?;
    verdict::assemble(&search, &path, thresholds)
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
    /// Anchor of the best effect of the last round.
    confirmed: Option<Anchor>,
}

impl Search<'_> {
    /// Declared, recalibrated, and as many rounds as raise alarms.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn walk(
        &self,
        declared_anchor: Anchor,
        thresholds: &Thresholds,
        progress: &dyn Progress,
    ) -> Result<Path> {
        progress.start("diagnosis", 3 + self.settings.max_effects as u64);
        let zero = vec![0.0; self.nuisances.len()];
        let declared = self.settle(&[], &zero, &declared_anchor, None, 0)?;
        progress.advance(1);
        let (recalibrated, anchor) = self.recalibrated(&declared, &declared_anchor, progress)?;
        progress.advance(1);
        let mut path = Path {
            declared,
            recalibrated: recalibrated.clone(),
            corrected: recalibrated,
            accepted: Vec::new(),
            candidates: Vec::new(),
            first: Vec::new(),
            anchor,
            confirmed: None,
        };
        for number in 1..=self.settings.max_effects {
            let fitted = self.fair_round(&mut path, number, &declared_anchor, progress)?;
            progress.advance(1);
            let Some(best) = fitted.first() else { break };
            let is_kept = best.is_confirmed || self.replay.is_none();
            if !is_kept || best.gain <= thresholds.gain || best.validation_gain <= thresholds.validation_gain {
                break;
            }
            path.corrected = best.model.clone();
            path.accepted.push(best.clone());
            if let Some(confirmed) = path.confirmed.take() {
                path.anchor = confirmed;
            }
            self.drop_needless(&mut path)?;
            if path.corrected.excess() <= 0.0 {
                break;
            }
        }
        progress.advance(1);
        Ok(path)
    }

    /// A round, again from a better base where the best effect's nuisances show that there is one: the effect must not be
    /// credited with what the base had only not found yet.
    fn fair_round(
        &self,
        path: &mut Path,
        number: usize,
        declared_anchor: &Anchor,
        progress: &dyn Progress,
    ) -> Result<Vec<Fitted>> {
        let mut tries = 0;
        loop {
            let from_declared = path.declared_with_effects(self, declared_anchor)?;
            let at = if number == 1 { declared_anchor } else { &path.anchor };
            let ground =
                Ground { declared: Some((&from_declared, at)), base: path.corrected.clone(), anchor: &path.anchor };
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
        let x = &best.model.x()[..base.x().len()];
        let near = self.settle(&base.effects, x, &path.anchor, Some(base), STEPS[1])?;
        let anchor = self.anchored(&base.effects, near.x(), Some(&path.anchor))?;
        let model = self.settle(&base.effects, near.x(), &anchor, Some(&near), STEPS[1])?;
        progress.note(&format!("base: {:.0} so far, {:.0} from the effect's nuisances", base.cost(), model.cost()));
        let is_better = base.cost() - model.cost() > 0.3 * best.gain.max(self.charge());
        Ok(is_better.then_some((model, anchor)))
    }

    /// Recalibrates, replays there, and recalibrates again, as long as that helps.
    fn recalibrated(&self, declared: &Model, anchor: &Anchor, progress: &dyn Progress) -> Result<(Model, Anchor)> {
        let fitted = self.settle(&[], declared.x(), anchor, Some(declared), STEPS[0])?;
        if self.replay.is_none() {
            return Ok((fitted, anchor.clone()));
        }
        let declared = Some((declared.clone(), anchor.clone()));
        self.replayed_until_settled(fitted, declared, (MAX_ANCHORS, f64::INFINITY), progress)
    }

    /// Replays `wanted`, fits from there, and again as long as that helps, at most `most` times; gives up where the second
    /// replay still costs more than twice what is at stake. `best` is what is known already.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn replayed_until_settled(
        &self,
        mut wanted: Model,
        mut best: Option<(Model, Anchor)>,
        (most, at_stake): (usize, f64),
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let effects = wanted.effects.clone();
        for number in 0..most {
            let next = self.anchored(&effects, wanted.x(), best.as_ref().map(|b| &b.1))?;
            let seen = self.settle(&effects, wanted.x(), &next, Some(&wanted), 0)?;
            let name = effects.last().map_or("recalibration", |e| e.kind);
            progress.note(&format!("{name}: cost {:.0} expected, {:.0} found", wanted.cost(), seen.cost()));
            let before = best.as_ref().map_or(f64::INFINITY, |b| b.0.cost());
            if seen.cost() < before {
                let is_done = seen.cost() > 0.995 * before || (number > 0 && seen.cost() > 2.0 * at_stake);
                wanted = self.settle(&effects, seen.x(), &next, Some(&seen), STEPS[1])?;
                best = Some((seen, next));
                if is_done {
                    break;
                }
            } else if let Some((best, anchor)) = &best {
                // The fast column promised what the nonlinear one does not keep: half the way.
                let x: Vec<f64> = best.x().iter().zip(wanted.x()).map(|(a, b)| 0.5 * (a + b)).collect();
                wanted = self.settle(&effects, &x, anchor, Some(best), 0)?;
            }
        }
        let Some((best, anchor)) = best else { return Ok((wanted, Anchor::fast(self.scene))) };
        let fitted = self.settle(&effects, best.x(), &anchor, Some(&best), STEPS[1])?;
        Ok((fitted, anchor))
    }

    /// Takes out effects that later ones have made needless.
    fn drop_needless(&self, path: &mut Path) -> Result<()> {
        let mut index = 0;
        while path.accepted.len() > 1 && index + 1 < path.accepted.len() {
            let mut effects = path.corrected.effects.clone();
            let dropped = effects.remove(index);
            let at = self.nuisances.len() + effects[..index].iter().map(|e| e.free.len()).sum::<usize>();
            let mut x = path.corrected.x().to_vec();
            x.drain(at..at + dropped.free.len());
            let without = self.settle(&effects, &x, &path.anchor, Some(&path.corrected), STEPS[1])?;
            let level = path.corrected.level().max(1.0);
            if (without.cost() - path.corrected.cost()) / level < self.charge() * parameters(&dropped) {
                path.corrected = without;
                path.accepted.remove(index);
            } else {
                index += 1;
            }
        }
        Ok(())
    }
}

impl Path {
    /// The effects so far with nuisances at their declared values.
    fn declared_with_effects(&self, search: &Search<'_>, declared: &Anchor) -> Result<Model> {
        let mut x = self.corrected.x().to_vec();
        x[..search.nuisances.len()].fill(0.0);
        let anchor = if self.accepted.is_empty() { declared } else { &self.anchor };
        search.settle(&self.corrected.effects, &x, anchor, Some(&self.corrected), 0)
    }

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
