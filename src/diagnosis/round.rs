//! One round of the forward search: screen, fit the few, judge them on validation events, confirm the best.

use super::anchor::Anchor;
use super::axes::is_followable;
use super::line::hidden;
use super::responses::Scene;
use super::screen::{Pass, Screened, screen};
use super::search::{Model, Search};
use super::unknowns::TOLERATED;
use crate::effects::Instance;
use crate::error::Result;
use crate::progress::Progress;
use rayon::prelude::*;

/// Steps of a joint fit and of a restart of the base.
const STEPS: [usize; 2] = [6, 8];
/// Steps of the joint fit where replays and further fits follow.
const FAR_STEPS: usize = 3;
/// Effects that start by taking over what tolerances have in common with them.
const TAKEN_OVER: usize = 4;
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
    pub(super) against: [f64; 2],
    /// Which of [`Ground::plain`] it was fitted from; the base where none.
    pub(super) plain: Option<usize>,
}

/// A start of a fit: the instance, the unknowns, and where it is made.
struct Start {
    instance: usize,
    x: Vec<f64>,
    plain: Option<usize>,
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

/// Where large effects are looked for: at the nuisances before they could take the place of an effect. What replays around the
/// base tell does not reach that far: replays around this one do, or the fast column alone. Their fits end in different places.
pub struct Plain<'a> {
    /// The search there.
    pub search: Search<'a>,
    /// Plain nuisances with the effects found so far.
    pub model: Model,
    /// Its anchor.
    pub anchor: Anchor,
}

/// The start of a round.
pub struct Ground<'a> {
    /// Where large effects are looked for.
    pub plain: Vec<Plain<'a>>,
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
        let open = self.open(&base.effects);
        let mut starts: Vec<Start> = Vec::new();
        let mut looked = Vec::new();
        for (i, plain) in plain.iter().enumerate() {
            let (more, scene, reference) = self.plain_starts((i, plain), &base, (&open, &starts))?;
            starts.extend(more);
            looked.push((scene, reference));
        }
        let (_, found) = screen(&self.fitter(anchor), &unknowns, &base.train, &open, Pass::Score);
        let few = self.settings.finalists.div_ceil(2) + 1;
        let picked = self.picked(found, &open, (few, 0));
        let near = picked.into_iter();
        let mut near: Vec<Start> =
            near.map(|s| Start { instance: s.instance, x: joined(base.x(), &s.start), plain: None }).collect();
        near.extend(self.taken_over(&base, anchor, &open)?);
        let along = self.along(self.scene, &near, &open)?;
        starts.extend(near);
        let this = &Search::new(&along, self.settings, self.replay)?;
        let mut searches = Vec::new();
        for (plain, (scene, _)) in plain.into_iter().zip(&looked) {
            searches.push(Plain { search: Search::new(scene, self.settings, self.replay)?, ..plain });
        }
        let plain = searches;
        let fit = |start: &Start| {
            let instance = open[start.instance].clone();
            let mut effects = base.effects.clone();
            effects.push(instance.clone());
            // What is fitted at the plain nuisances is compared with the base fitted there.
            let (search, near, anchor) = match start.plain {
                Some(i) => (&plain[i].search, &looked[i].1, &plain[i].anchor),
                None => (this, &base, anchor),
            };
            let steps = if base.is_far() && is_followable(&instance) { FAR_STEPS } else { STEPS[0] };
            let model = search.settle(&effects, &start.x, anchor, Some(near), steps).ok()?;
            // Replays around the plain nuisances tell costs as they are.
            let near = if search.scene.neighbours.is_some() { &base } else { near };
            let against = near.costs();
            let plain = start.plain;
            Some(Fitted { instance, model, gain: 0.0, validation_gain: 0.0, is_confirmed: false, against, plain })
        };
        let (from_plain, mut fitted): (Vec<_>, Vec<_>) =
            starts.par_iter().filter_map(fit).collect::<Vec<_>>().into_iter().partition(|f| f.plain.is_some());
        self.restart(&mut base, &fitted, anchor)?;
        for f in &mut fitted {
            f.against = base.costs();
        }
        let near_base = fitted.clone();
        fitted.extend(from_plain);
        self.judge(&mut fitted, &base);
        let anchor = this.confirm(&mut fitted, near_base, (&base, anchor, &plain), progress)?;
        let mut seen: Vec<Instance> = Vec::new();
        fitted.retain(|f| {
            let is_new = !seen.contains(&f.instance);
            seen.extend(is_new.then(|| f.instance.clone()));
            is_new
        });
        Ok(Round { base, fitted, anchor })
    }

    /// Starts of fits from `plain`, which is number `i` and may look for those of `open` that others have `known`; its scene with
    /// replays along them, and the base fitted there.
    ///
    /// # Errors
    /// When a replay is impossible.
    fn plain_starts<'s>(
        &self,
        (i, Plain { search, model, anchor }): (usize, &Plain<'s>),
        base: &Model,
        (open, known): (&[Instance], &[Start]),
    ) -> Result<(Vec<Start>, Scene<'s>, Model)> {
        // Replays are dear: they go along what the fast column has found worth a start.
        let worth = |instance: &&Instance| known.is_empty() || known.iter().any(|s| open[s.instance] == **instance);
        let wanted: Vec<Instance> = open.iter().filter(worth).cloned().collect();
        let along = self.replay.map_or(Ok(search.scene.clone()), |r| search.scene.along_all(r, &wanted))?;
        let search = Search::new(&along, self.settings, self.replay)?;
        let unknowns = search.unknowns(&base.effects);
        let (_, mut found) = screen(&search.fitter(anchor), &unknowns, &model.train, open, Pass::Grid);
        found.retain(|s| wanted.contains(&open[s.instance]));
        let places = if !base.is_far() {
            0
        } else if known.is_empty() {
            2
        } else {
            1
        };
        let picked = self.picked(found, open, (self.settings.finalists, places)).into_iter();
        let start = |s: Screened| Start { instance: s.instance, x: joined(model.x(), &s.start), plain: Some(i) };
        let starts: Vec<Start> = picked.map(start).collect();
        let reference = search.settle(&base.effects, model.x(), anchor, Some(model), STEPS[1])?;
        let scene = self.along(&along, &starts, open)?;
        Ok((starts, scene, reference))
    }

    /// Starts with an effect whose velocities take over what those of the tolerances have in common with them; the few of
    /// `open` that cost least.
    ///
    /// # Errors
    /// When an effect cannot be built.
    fn taken_over(&self, base: &Model, anchor: &Anchor, open: &[Instance]) -> Result<Vec<Start>> {
        let mut tried: Vec<(f64, Start)> = Vec::new();
        for (instance, effect) in open.iter().enumerate() {
            let Some(x) = self.instead(&base.effects, base.x(), effect)? else { continue };
            let effects = [&base.effects[..], std::slice::from_ref(effect)].concat();
            let cost = self.fitter(anchor).at(&self.unknowns(&effects), &x, Some(&base.train.responses))?.cost;
            tried.push((cost, Start { instance, x, plain: None }));
        }
        tried.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(tried.into_iter().take(TAKEN_OVER).map(|(_, start)| start).collect())
    }

    /// Unknowns `x` with `instance` instead of the tolerance of the same kind, or of what velocities have in common with it: the same
    /// motions, and room for more where a tolerance is at its end. `None` where there is nothing to take over.
    ///
    /// # Errors
    /// When the effect cannot be built.
    pub(super) fn instead(&self, effects: &[Instance], from: &[f64], instance: &Instance) -> Result<Option<Vec<f64>>> {
        let (Some(zero), [free]) = (instance.zero(), &instance.free[..]) else { return Ok(None) };
        let step = TRIVIAL * free.size;
        let unknowns = self.unknowns(effects);
        if let Some(n) = unknowns.followed_as(instance) {
            let own = zero[0] + from[n] * self.nuisances[n].deviation;
            let mut x = from.to_vec();
            x[n] = 0.0;
            x.push(own);
            return Ok(((own - zero[0]).abs() > step).then_some(x));
        }
        let shift = self.scene.velocity_shift_with(&instance.at(&[zero[0] + step]))?;
        let shift: Vec<f64> = shift.iter().map(|s| s / step).collect();
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let square = dot(&shift, &shift);
        let amount = if square > 0.0 { dot(from, &shift) / square } else { 0.0 };
        let [[low, high]] = instance.bounds()[..] else { return Ok(None) };
        let own = (zero[0] + amount).clamp(low, high);
        if (own - zero[0]).abs() < step {
            return Ok(None);
        }
        let mut x = from.to_vec();
        x.iter_mut().zip(&shift).for_each(|(x, s)| *x -= s * (own - zero[0]));
        x.push(own);
        Ok(Some(x))
    }

    /// What could be added to `effects`.
    pub(super) fn open(&self, effects: &[Instance]) -> Vec<Instance> {
        self.instances.iter().filter(|i| !effects.contains(i)).cloned().collect()
    }

    /// The `scene` with replays along the effects of `open` that start somewhere.
    fn along<'s>(&self, scene: &Scene<'s>, starts: &[Start], open: &[Instance]) -> Result<Scene<'s>> {
        let Some(replay) = self.replay else { return Ok(scene.clone()) };
        let wanted: Vec<(&Instance, f64)> =
            starts.iter().filter_map(|s| Some((&open[s.instance], *s.x.last()?))).collect();
        scene.along(replay, &wanted)
    }

    /// The best, at most two places of a kind, `most` in all; and the best `places` of every kind that replays can follow, where the
    /// screening cannot be trusted to see them.
    fn picked(&self, mut found: Vec<Screened>, open: &[Instance], (most, places): (usize, usize)) -> Vec<Screened> {
        let charged = |s: &Screened| s.fall - self.charge() * parameters(&open[s.instance]);
        found.sort_by(|a, b| charged(b).total_cmp(&charged(a)).then(a.instance.cmp(&b.instance)));
        let mut picked: Vec<Screened> = Vec::new();
        for screened in found {
            let instance = &open[screened.instance];
            let alike = picked.iter().filter(|p| open[p.instance].kind == instance.kind).count();
            if (picked.len() < most && alike < 2) || (is_followable(instance) && alike < places) {
                picked.push(screened);
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

    /// Gains over `base`, best first; one entry for each instance and place it was fitted from, one for each that is confirmed.
    pub(super) fn judge(&self, fitted: &mut Vec<Fitted>, base: &Model) {
        let level = fitted.iter().map(|f| f.model.level()).fold(base.level(), f64::min).max(1.0);
        for f in fitted.iter_mut() {
            if self.scene.is_stiff() {
                (f.validation_gain, f.gain) = (0.0, self.plainer(base, &f.model, &f.instance));
                continue;
            }
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
        let mut seen: Vec<Fitted> = Vec::new();
        for f in fitted.drain(..) {
            let is_known = |s: &Fitted| s.instance == f.instance && (s.is_confirmed || s.plain == f.plain);
            if !seen.iter().any(is_known) {
                seen.push(f);
            }
        }
        *fitted = seen;
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
        // A range of depths of its own may be off by as much as those that are declared.
        let alike = self.nuisances.iter().filter(|n| n.instance.kind == fitted.instance.kind);
        let declared = alike.map(|n| n.deviation).fold(0.0, f64::max);
        let free = &fitted.instance.free;
        free.iter()
            .zip(own)
            .zip(&zero)
            .all(|((f, x), zero)| f.zero.is_none() || (x - zero).abs() < declared.max(TRIVIAL * f.size))
    }
}

/// Parameters that an effect is charged for: a discrete choice counts as one.
pub fn parameters(instance: &Instance) -> f64 {
    instance.free.len().max(1) as f64
}

fn joined(x: &[f64], start: &[f64]) -> Vec<f64> {
    x.iter().chain(start).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::super::made_up::judged;
    use super::*;
    use crate::diagnosis::DiagnoseSettings;

    #[test]
    fn what_a_tolerance_allows_is_no_effect() {
        let (problem, settings) = (judged(""), DiagnoseSettings::default());
        let scene = Scene::new(&problem, &settings).unwrap();
        let search = Search::new(&scene, &settings, None).unwrap();
        let is_trivial = |kind: &str, x: &[f64]| {
            let instance = search.instances.iter().find(|i| i.kind == kind).unwrap().clone();
            let all = [&vec![0.0; search.nuisances.len()], x].concat();
            let model = search.settle(std::slice::from_ref(&instance), &all, &Anchor::fast(&scene), None, 0).unwrap();
            let (against, plain) = (model.costs(), None);
            let (gain, validation_gain, is_confirmed) = (0.0, 0.0, false);
            search.is_trivial(&Fitted { instance, model, gain, validation_gain, is_confirmed, against, plain })
        };
        // Half of the depth may be off by a standard deviation of what is declared, all of the damping by three.
        assert_eq!(
            [0.03, -0.03, 0.06, -0.15].map(|ln| is_trivial("layer_velocity", &[ln])),
            [true, true, false, false]
        );
        assert_eq!([1.8, 3.0].map(|f: f64| is_trivial("small_strain_damping", &[f.ln()])), [true, false]);
        assert!(!is_trivial("sensor_polarity", &[]));
    }
}
