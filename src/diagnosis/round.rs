//! One round of the forward search: screen, fit the few, judge them on validation events, confirm the best.

use super::anchor::Anchor;
use super::line::hidden;
use super::screen::{Pass, Screened, screen};
use super::search::{Model, Search};
use super::unknowns::TOLERATED;
use crate::effects::{self, Instance};
use crate::error::Result;
use crate::progress::Progress;
use rayon::prelude::*;

/// Steps of a joint fit and of a restart of the base.
const STEPS: [usize; 2] = [6, 8];
/// Share of the best gain above which the runner-up is confirmed too.
const CLOSE_SHARE: f64 = 0.7;
/// Effects that start by taking over what tolerances have in common with them.
const TAKEN_OVER: usize = 4;
/// Most replays of an effect to be confirmed.
const REPLAYS: usize = 6;
/// Effects weaker than this many prior standard deviations are not effects.
const TRIVIAL: f64 = 0.05;

/// An effect fitted on top of the base.
#[derive(Clone)]
pub struct Fitted {
    /// The effect added.
    pub instance: Instance,
    /// The model with it.
    pub model: Model,
    /// Gain after the charge.
    pub gain: f64,
    /// Fall of the validation cost.
    pub validation_gain: f64,
    /// Whether the nonlinear column confirmed it.
    pub is_confirmed: bool,
    /// Costs of the base on training and validation events where it was fitted.
    against: [f64; 2],
    /// Whether it was fitted from the replay of the plain nuisances.
    is_plain: bool,
}

/// A start of a fit: the instance, the unknowns, and which of two anchors.
struct Start {
    instance: usize,
    x: Vec<f64>,
    is_plain: bool,
}

/// What a round found.
pub struct Round {
    /// The base, restarted where an effect's fit led to better nuisances.
    pub base: Model,
    /// Effects, best first.
    pub fitted: Vec<Fitted>,
    /// Anchor of the best one.
    pub anchor: Option<Anchor>,
}

/// Where large effects are looked for: at the nuisances before they could take the place of an effect, and on the fast column
/// alone, because what replays around the base tell does not reach that far.
pub struct Plain<'a> {
    /// The search on the fast column.
    pub search: &'a Search<'a>,
    /// Plain nuisances with the effects found so far.
    pub model: Model,
    /// Its anchor.
    pub anchor: Anchor,
}

/// The start of a round.
pub struct Ground<'a> {
    /// Where large effects are looked for; `None` skips it.
    pub plain: Option<Plain<'a>>,
    /// The best model so far.
    pub base: Model,
    /// Its anchor.
    pub anchor: &'a Anchor,
}

impl Search<'_> {
    /// One round on `ground`.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub fn round(&self, ground: Ground<'_>, progress: &dyn Progress) -> Result<Round> {
        let Ground { plain, mut base, anchor } = ground;
        let unknowns = self.unknowns(&base.effects);
        let open: Vec<Instance> = self.instances.iter().filter(|i| !is_taken(i, &base.effects)).cloned().collect();
        let mut starts: Vec<Start> = Vec::new();
        let mut reference: Option<Model> = None;
        if let Some(Plain { search, model, anchor }) = &plain {
            let alone = search.unknowns(&base.effects);
            let (_, found) = screen(&search.fitter(anchor), &alone, &model.train, &open, Pass::Grid);
            let picked = self.picked(found, &open, self.settings.finalists).into_iter();
            starts.extend(picked.map(|s| Start {
                instance: s.instance,
                x: joined(model.x(), &s.start),
                is_plain: true,
            }));
            reference = Some(search.settle(&base.effects, model.x(), anchor, Some(model), STEPS[1])?);
        }
        let (_, found) = screen(&self.fitter(anchor), &unknowns, &base.train, &open, Pass::Score);
        let few = self.settings.finalists.div_ceil(2) + 1;
        let picked = self.picked(found, &open, few).into_iter();
        starts.extend(picked.map(|s| Start { instance: s.instance, x: joined(base.x(), &s.start), is_plain: false }));
        starts.extend(self.taken_over(&base, anchor, &open)?);
        let fit = |start: &Start| {
            let instance = open[start.instance].clone();
            let mut effects = base.effects.clone();
            effects.push(instance.clone());
            // What is fitted at the plain nuisances is compared with the base fitted there.
            let (search, near, anchor) = match (&plain, &reference) {
                (Some(plain), Some(model)) if start.is_plain => (plain.search, model, &plain.anchor),
                _ => (self, &base, anchor),
            };
            let model = search.settle(&effects, &start.x, anchor, Some(near), STEPS[0]).ok()?;
            let against = [near.train.cost, near.validation_cost()];
            let is_plain = start.is_plain;
            Some(Fitted { instance, model, gain: 0.0, validation_gain: 0.0, is_confirmed: false, against, is_plain })
        };
        let (from_plain, mut fitted): (Vec<_>, Vec<_>) =
            starts.par_iter().filter_map(fit).collect::<Vec<_>>().into_iter().partition(|f| f.is_plain);
        self.restart(&mut base, &fitted, anchor)?;
        for f in &mut fitted {
            f.against = [base.train.cost, base.validation_cost()];
        }
        let near_base = fitted.clone();
        fitted.extend(from_plain);
        self.judge(&mut fitted, &base);
        let anchor = self.confirm(&mut fitted, near_base, (&base, anchor, plain.as_ref()), progress)?;
        Ok(Round { base, fitted, anchor })
    }

    /// Starts with an effect whose velocities take over what those of the tolerances have in common with them; the few of
    /// `open` that cost least.
    ///
    /// # Errors
    /// When an effect cannot be built.
    fn taken_over(&self, base: &Model, anchor: &Anchor, open: &[Instance]) -> Result<Vec<Start>> {
        let mut tried: Vec<(f64, Start)> = Vec::new();
        for (instance, effect) in open.iter().enumerate() {
            let Some(x) = self.instead(base, effect)? else { continue };
            let effects = [&base.effects[..], std::slice::from_ref(effect)].concat();
            let cost = self.fitter(anchor).at(&self.unknowns(&effects), &x, Some(&base.train.responses))?.cost;
            tried.push((cost, Start { instance, x, is_plain: false }));
        }
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(tried.into_iter().take(TAKEN_OVER).map(|(_, start)| start).collect())
    }

    /// Unknowns with `instance` instead of the tolerance of the same kind, or of what velocities have in common with it: the same motions, and
    /// room for more where a tolerance is at its end. `None` where there is nothing to take over.
    ///
    /// # Errors
    /// When the effect cannot be built.
    fn instead(&self, base: &Model, instance: &Instance) -> Result<Option<Vec<f64>>> {
        let (Some(zero), [free]) = (instance.zero(), &instance.free[..]) else { return Ok(None) };
        let step = TRIVIAL * free.parameter.prior_sd;
        let unknowns = self.unknowns(&base.effects);
        if let Some(n) = unknowns.followed_as(instance) {
            let own = zero[0] + base.x()[n] * self.nuisances[n].deviation;
            let mut x = base.x().to_vec();
            x[n] = 0.0;
            x.push(own);
            return Ok(((own - zero[0]).abs() > step).then_some(x));
        }
        let mut effects = effects::build_all(&self.scene.problem.declared)?;
        effects.push(effects::build(&instance.at(&[zero[0] + step]))?);
        let shift: Vec<f64> = self.scene.velocity_shift(&effects).iter().map(|s| s / step).collect();
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let square = dot(&shift, &shift);
        let amount = if square > 0.0 { dot(base.x(), &shift) / square } else { 0.0 };
        let [[low, high]] = instance.bounds()[..] else { return Ok(None) };
        let own = (zero[0] + amount).clamp(low, high);
        if (own - zero[0]).abs() < step {
            return Ok(None);
        }
        let mut x = base.x().to_vec();
        x.iter_mut().zip(&shift).for_each(|(x, s)| *x -= s * (own - zero[0]));
        x.push(own);
        Ok(Some(x))
    }

    /// The best of each kind, at most two places of it, `most` in all.
    fn picked(&self, mut found: Vec<Screened>, open: &[Instance], most: usize) -> Vec<Screened> {
        let charged = |s: &Screened| s.fall - self.charge() * parameters(&open[s.instance]);
        found.sort_by(|a, b| charged(b).total_cmp(&charged(a)).then(a.instance.cmp(&b.instance)));
        let mut picked: Vec<Screened> = Vec::new();
        for screened in found {
            let kind = open[screened.instance].kind;
            if picked.iter().filter(|p| open[p.instance].kind == kind).count() < 2 {
                picked.push(screened);
            }
            if picked.len() == most {
                break;
            }
        }
        picked
    }

    /// Where an effect's fit has led to nuisances that serve the base better than its own, the base moves there: without
    /// that, an effect of no strength would take the credit.
    fn restart(&self, base: &mut Model, fitted: &[Fitted], anchor: &Anchor) -> Result<()> {
        let mut best: Vec<&Fitted> = fitted.iter().filter(|f| f.model.train.cost < base.train.cost - 5.0).collect();
        best.sort_by(|a, b| a.model.train.cost.total_cmp(&b.model.train.cost));
        let restarted: Vec<Model> = best
            .par_iter()
            .take(4)
            .filter_map(|f| {
                let x = &f.model.x()[..base.x().len()];
                self.settle(&base.effects, x, anchor, Some(base), STEPS[1]).ok()
            })
            .collect();
        for model in restarted {
            if model.train.cost < base.train.cost - 1.0 {
                *base = model;
            }
        }
        Ok(())
    }

    /// Gains over `base`, best first; one entry for each instance.
    fn judge(&self, fitted: &mut Vec<Fitted>, base: &Model) {
        let level = fitted.iter().map(|f| f.model.level()).fold(base.level(), f64::min).max(1.0);
        for f in fitted.iter_mut() {
            let fall = (f.against[0] - f.model.train.cost) / level;
            let validation = (f.against[1] - f.model.validation_cost()) / level;
            let charge = self.charge() * parameters(&f.instance);
            let records =
                |groups: &[usize]| groups.iter().map(|g| self.scene.groups[*g].records.len()).sum::<usize>() as f64;
            let hidden = [&self.train, &self.validation].map(|groups| hidden(&f.instance) * records(groups));
            let (fall, validation) = (fall - hidden[0], validation - hidden[1]);
            f.validation_gain = validation;
            f.gain = fall + validation - charge;
            // Before its replay a strong event may say no to what the fast column cannot follow.
            let is_open = self.replay.is_some() && !f.is_confirmed;
            if fall < charge || (validation <= 0.0 && !is_open) || self.is_trivial(f) {
                f.gain = f.gain.min(0.0) - 50.0;
            }
        }
        fitted
            .sort_by(|a, b| b.gain.total_cmp(&a.gain).then_with(|| a.model.train.cost.total_cmp(&b.model.train.cost)));
        let mut seen: Vec<Instance> = Vec::new();
        fitted.retain(|f| {
            let is_new = !seen.contains(&f.instance);
            if is_new {
                seen.push(f.instance.clone());
            }
            is_new
        });
    }

    /// The nuisance that is the same thing as this effect, and its value, prior standard deviations, that would replace both.
    pub(super) fn tolerance(&self, fitted: &Fitted) -> Option<(usize, f64)> {
        let i = self.nuisances.iter().position(|n| n.instance.is_same(&fitted.instance))?;
        let ([zero], x) = (&fitted.instance.zero()?[..], fitted.model.x()) else { return None };
        Some((i, x[i] + (x.last()? - zero) / self.nuisances[i].deviation))
    }

    /// Whether the effect is as good as none, or no more than a declared tolerance allows.
    fn is_trivial(&self, fitted: &Fitted) -> bool {
        let Some(zero) = fitted.instance.zero() else { return false };
        let x = fitted.model.x();
        let own = &x[x.len() - zero.len()..];
        if self.tolerance(fitted).is_some_and(|(_, x)| x.abs() < TOLERATED) {
            return true;
        }
        let free = &fitted.instance.free;
        free.iter()
            .zip(own)
            .zip(&zero)
            .all(|((f, x), zero)| f.zero.is_none() || (x - zero).abs() < TRIVIAL * f.parameter.prior_sd)
    }

    /// Replays the best, and then whatever is close behind or has become the best, and fits again from there; the anchor
    /// of the best. Where none of these keeps what it promised from the declared values, those fitted `near_base` have
    /// their turn, and only what they gain on the replayed base counts.
    fn confirm(
        &self,
        fitted: &mut Vec<Fitted>,
        near_base: Vec<Fitted>,
        from: (&Model, &Anchor, Option<&Plain<'_>>),
        progress: &dyn Progress,
    ) -> Result<Option<Anchor>> {
        let mut anchors: Vec<(Instance, Anchor)> = Vec::new();
        let base = from.0;
        if self.replay.is_none() {
            return Ok(None);
        }
        self.replay_best(fitted, &mut anchors, from, progress)?;
        if fitted.first().is_some_and(|f| f.gain > 0.0 && !f.is_confirmed) {
            fitted.extend(near_base);
            for f in fitted.iter_mut() {
                f.against = [base.train.cost, base.validation_cost()];
            }
            self.judge(fitted, base);
            self.replay_best(fitted, &mut anchors, from, progress)?;
        }
        let best = fitted.first().filter(|f| f.is_confirmed).map(|f| &f.instance);
        Ok(anchors.into_iter().rev().find(|(instance, _)| Some(instance) == best).map(|(_, anchor)| anchor))
    }

    /// Replays the best of `fitted` and what is close behind, as many as may be.
    fn replay_best(
        &self,
        fitted: &mut Vec<Fitted>,
        anchors: &mut Vec<(Instance, Anchor)>,
        (base, near_base, plain): (&Model, &Anchor, Option<&Plain<'_>>),
        progress: &dyn Progress,
    ) -> Result<()> {
        for done in 0..=self.settings.confirmed {
            let Some(index) = self.next_to_confirm(fitted, done) else { break };
            let f = &mut fitted[index];
            let limits = (REPLAYS, base.cost());
            let wanted = f.model.clone();
            let (model, anchor) = match plain.filter(|_| f.is_plain) {
                Some(Plain { search, anchor, .. }) => {
                    let found = search.replayed_until_settled(wanted, (None, anchor), limits, progress)?.0;
                    let anchor = self.anchored(&found.effects, found.x(), None)?;
                    (self.settle(&found.effects, found.x(), &anchor, None, 0)?, anchor)
                }
                None => self.replayed_until_settled(wanted, (None, near_base), limits, progress)?,
            };
            f.model = model;
            f.is_confirmed = true;
            f.against = [base.train.cost, base.validation_cost()];
            anchors.push((f.instance.clone(), anchor));
            self.judge(fitted, base);
        }
        Ok(())
    }

    /// The best if it is not confirmed, else the first of another kind that is close behind.
    fn next_to_confirm(&self, fitted: &[Fitted], done: usize) -> Option<usize> {
        let best = fitted.first().filter(|f| f.gain > 0.0)?;
        if !best.is_confirmed {
            return Some(0);
        }
        let kinds: Vec<&str> = fitted.iter().filter(|f| f.is_confirmed).map(|f| f.instance.kind).collect();
        let is_open = |f: &Fitted| f.gain >= CLOSE_SHARE * best.gain && !kinds.contains(&f.instance.kind);
        if done < self.settings.confirmed { fitted.iter().position(is_open) } else { None }
    }
}

/// Parameters that an effect is charged for: a discrete choice counts as one.
pub fn parameters(instance: &Instance) -> f64 {
    instance.free.len().max(1) as f64
}

fn is_taken(instance: &Instance, effects: &[Instance]) -> bool {
    effects.iter().any(|e| e.is_same(instance))
}

fn joined(x: &[f64], start: &[f64]) -> Vec<f64> {
    x.iter().chain(start).copied().collect()
}
