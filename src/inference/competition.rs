//! Which effects the records ask for: every effect at every place, alone and in pairs, against what is declared, by evidence.
//!
//! Beside a fitted model every candidate is replayed at strengths on both sides of nothing. How residuals change towards such a node
//! is a direction; beside it the coordinates of the model give way, so that the evidence of each candidate, and of each pair, is a
//! small linear problem ([`Competition::expand`]). The best of them are fitted with the column itself. The competition goes on around
//! the best model, and around it less each of its effects, until that changes nothing. What the records say of the field and of the
//! column's error is read off beside the best model, and all models are compared by that.

mod proposals;

use super::few::Few;
use super::forward::{Forward, Prediction, channels};
use super::parameters::Model;
use super::posterior::{Fit, Fitter, Replays, Start, Stop, combined, square};
use super::spread::Spread;
use super::weights::{Rows, Weights};
use crate::effects::{self, Array, Instance};
use crate::error::Result;
use crate::numerics::threads::on_threads;
use crate::progress::Progress;
use proposals::{NODES, Proposal, away, distinct};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Single effects and pairs that are fitted around one model in few events, and how many of these in all.
const HEATS: usize = 4;
const FINALS: usize = 3;
/// Steps of the first fits.
const HEAT: Stop = Stop { steps: 8, replays: Replays::Nowhere, ..Stop::CLOSE };
/// The same from what is declared, where tolerances have to find back from where they stood in for an effect.
const FAR_HEAT: Stop = Stop { steps: 24, ..HEAT };
/// ln of the odds against the best within which models count for the answer, and within which they are fitted to all events and kept when
/// what is expected of residuals has changed.
const COUNTS: f64 = 5.0;
const FAR: f64 = 30.0;
/// Most rounds of the competition.
const ROUNDS: usize = 12;
/// Most rounds at the end.
const SETTLINGS: usize = 3;
/// Most times that what few elements leave wrong is taken out anew, and the change of ln of the density that still matters.
const ANCHORS: usize = 6;
const TOLD: f64 = 0.5;
/// Prior standard deviations that a tolerance may move for slopes to be carried along.
const NEAR: f64 = 1.0;
/// Prior probability of one effect more.
const ONE_MORE: f64 = 0.25;
/// Change of the column's level (ln) and of a coherence from which models are compared anew.
const CHANGED: [f64; 2] = [0.05, 0.02];
/// The same from which candidates are looked for anew.
const OTHER: [f64; 2] = [0.7, 0.2];

/// What is looked at around a model.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Look {
    /// Candidates besides.
    Near,
    /// The same where strong ones lead when tolerances are taken back to what is declared.
    Far,
    /// Candidates besides, and in the place of what the model has.
    AtRivals,
}

/// Fitted models by their effects.
pub struct Competition<'a> {
    fitter: Fitter<'a>,
    few: Few<'a>,
    instances: Vec<Instance>,
    /// ln of the prior of an effect at a place, by kind.
    ln_prior: BTreeMap<&'static str, f64>,
    max_effects: usize,
    /// Everything that was fitted, what is declared first.
    pub fits: Vec<Fit<'a>>,
    expanded: Vec<Vec<Instance>>,
}

impl<'a> Competition<'a> {
    /// Prepares the competition around `declared`, the fit without effects; candidates are looked at in `few` events.
    pub fn new(fitter: Fitter<'a>, declared: Fit<'a>, few: Few<'a>, max_effects: usize) -> Self {
        let array = &fitter.forward.problem.array;
        let instances = acting(array);
        let unnamed = effects::unnamed(array);
        let ln_prior = ln_prior(fitter.forward, instances.iter().chain(&unnamed));
        Self { fitter, few, instances, ln_prior, max_effects, fits: vec![declared], expanded: Vec::new() }
    }

    /// ln of the posterior of a fitted model up to a constant.
    pub fn log_posterior(&self, fit: &Fit<'_>) -> f64 {
        fit.log_evidence() + fit.model.effects.iter().map(|e| self.prior_of(e)).sum::<f64>()
    }

    /// ln of the prior of an effect.
    fn prior_of(&self, instance: &Instance) -> f64 {
        self.ln_prior.get(instance.kind).copied().unwrap_or(f64::NEG_INFINITY)
    }

    /// What a model predicts by its named effects alone.
    pub fn named(&self, fit: &Fit<'a>) -> Arc<Prediction> {
        if fit.model.is_named() {
            return fit.prediction.clone();
        }
        let n = fit.model.declared.len();
        let mut x = fit.x[..n].to_vec();
        let mut model = Model { declared: fit.model.declared, effects: Vec::new() };
        for (i, effect) in fit.model.effects.iter().enumerate().filter(|(_, e)| e.is_named()) {
            let start = fit.model.start(i);
            x.extend(&fit.x[start..start + effect.free.len()]);
            model.effects.push(effect.clone());
        }
        self.fitter.predict(&model, &x).unwrap_or_else(|_| fit.prediction.clone())
    }

    /// The most probable model.
    pub fn best(&self) -> &Fit<'a> {
        self.best_of(|_| true).unwrap_or(&self.fits[0])
    }

    /// The most probable of the models that `is_meant` takes.
    pub fn best_of(&self, is_meant: impl Fn(&Fit<'a>) -> bool) -> Option<&Fit<'a>> {
        let more = |a: &&Fit<'a>, b: &&Fit<'a>| self.log_posterior(a).total_cmp(&self.log_posterior(b));
        self.fits.iter().filter(|fit| is_meant(fit)).max_by(more)
    }

    fn best_named(&self) -> &Fit<'a> {
        self.best_of(|fit| fit.model.is_named()).unwrap_or(&self.fits[0])
    }

    fn known(&self, effects: &[Instance]) -> Option<usize> {
        self.fits.iter().position(|f| is_same_set(&f.model.effects, effects))
    }

    /// Runs the competition to its end.
    ///
    /// # Errors
    /// When an effect cannot be built.
    pub fn run(&mut self, progress: &dyn Progress) -> Result<()> {
        for _ in 0..ROUNDS {
            self.renew_anchor(Stop::CLOSE)?;
            self.renew_spread(progress)?;
            self.renew_parts()?;
            // A response without a name is what named effects are compared with, and nothing to look further from: it takes up what
            // they would explain.
            let best = self.best_named().model.effects.clone();
            let without = |i: usize| [&best[..i], &best[i + 1..]].concat();
            // What is simpler first: it may do as well.
            let open = (0..best.len()).map(without).chain([best.clone()]);
            let is_open = |set: &Vec<Instance>| !self.expanded.iter().any(|e| is_same_set(e, set));
            let Some(next) = open.into_iter().find(is_open) else { break };
            self.expand(next, progress)?;
        }
        self.settle(progress)
    }

    /// Fits to the end whatever counts for the answer.
    fn settle(&mut self, progress: &dyn Progress) -> Result<()> {
        for _ in 0..SETTLINGS {
            self.renew_anchor(Stop::EXACT)?;
            let leading = self.best().model.effects.clone();
            let highest = self.log_posterior(self.best());
            for i in 0..self.fits.len() {
                let fit = &self.fits[i];
                if i == 0 || self.log_posterior(fit) > highest - COUNTS {
                    self.fits[i] = self.fitter.fit(Start::from(fit.clone()), Stop::EXACT)?;
                    progress.note(&self.described(&self.fits[i]));
                }
            }
            if is_same_set(&leading, &self.best().model.effects) {
                break;
            }
        }
        Ok(())
    }

    /// Takes out what few elements leave wrong beside the best model and fits that anew, until the records cannot tell what is left of it.
    fn renew_anchor(&mut self, stop: Stop) -> Result<()> {
        for _ in 0..ANCHORS {
            let best = self.best().clone();
            self.fitter.forward.anchor(&best.model.tables(&best.x))?;
            let old = std::mem::take(&mut self.fits);
            let evaluated = |fit: Fit<'a>| self.fitter.fit(Start::from(fit), Stop::WHERE_IT_IS);
            self.fits = old.into_iter().map(evaluated).collect::<Result<_>>()?;
            let Some(index) = self.known(&best.model.effects) else { break };
            let there = self.fits[index].clone();
            let moved = combined(&there.rows, &best.rows, 1.0, -1.0);
            if 0.5 * square(&moved) < TOLD && (there.axes.is_some() || stop.replays != Replays::AtTheEnd) {
                break;
            }
            self.fits[index] = self.fitter.fit(Start::from(there), stop)?;
        }
        Ok(())
    }

    /// What is expected of the residuals of `forward` beside a fitted model, and ln of the determinant of that.
    fn supported(forward: &Forward<'_>, fit: &Fit<'_>) -> (Spread, f64) {
        let spread = Spread::estimated(forward, &fit.prediction);
        let ln_determinant = Weights::new(forward, &spread, &fit.prediction).constant;
        (spread, ln_determinant)
    }

    /// Reads off what is expected of residuals, and fits again whatever is close, if that has changed. What the column has wrong and what
    /// strays is what no model explains: the model beside which least of it is left tells how much it is, for all of them.
    fn renew_spread(&mut self, progress: &dyn Progress) -> Result<()> {
        // Models that take other channels for the same sensors predict other records: that comparison is the evidence's alone.
        let own = channels(&self.best().prediction);
        let supported = self
            .fits
            .iter()
            .filter(|f| channels(&f.prediction) == own)
            .map(|f| (f, Self::supported(self.fitter.forward, f)));
        let least = supported.min_by(|a, b| a.1.1.total_cmp(&b.1.1));
        let Some((best, (found, _))) = least.map(|(f, s)| (f.clone(), s)) else { return Ok(()) };
        let now = self.fitter.spread();
        let coherences = found.coherence.iter().flatten().zip(now.coherence.iter().flatten());
        let moved = coherences.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        if (found.level / now.level).ln().abs() < CHANGED[0] && moved < CHANGED[1] {
            return Ok(());
        }
        let is_other = (found.level / now.level).ln().abs() > OTHER[0] || moved > OTHER[1];
        progress.note(&format!("level {:.2}, coherence {:.2?}", found.level, found.coherence));
        // What few elements leave wrong is taken out where it matters now.
        self.fitter.forward.anchor(&best.model.tables(&best.x))?;
        let reference = self.fitter.predict(&best.model, &best.x)?;
        self.fitter = Fitter::new(self.fitter.forward, found, reference);
        let own = best.model.effects;
        let old = std::mem::take(&mut self.fits);
        let cost = |fit: &Fit<'a>| self.fitter.nll(&fit.prediction) + Fitter::prior(&fit.model, &fit.x);
        let costs: Vec<f64> = old.iter().map(cost).collect();
        // What has a name is kept by what else has one: a response without takes up all of that at once.
        let lowest = |is_named: bool| {
            let alike = old.iter().zip(&costs).filter(|(fit, _)| fit.model.is_named() == is_named);
            alike.map(|(_, cost)| *cost).fold(f64::INFINITY, f64::min)
        };
        let lowest = [lowest(false), lowest(true)];
        for (i, (fit, cost)) in old.into_iter().zip(costs).enumerate() {
            let is_close = cost < lowest[usize::from(fit.model.is_named())] + FAR;
            if i == 0 || is_close || is_same_set(&fit.model.effects, &own) {
                self.fits.push(self.fitter.fit(Start::weighed_anew(fit), Stop::CLOSE)?);
            }
        }
        // What was found beside other models may be found anew; what leads away from it does so by any weights.
        if is_other {
            let fits = &self.fits;
            let is_strained =
                |set: &Vec<Instance>| fits.iter().any(|f| is_same_set(&f.model.effects, set) && f.is_strained());
            self.expanded.retain(is_strained);
        }
        Ok(())
    }

    /// Fits some of the effects of the best model to the end.
    ///
    /// # Errors
    /// When an effect cannot be built.
    pub fn fit_part(&mut self, effects: &[Instance]) -> Result<()> {
        let fit = self.fitter.fit(self.part(effects), Stop::EXACT)?;
        self.keep(fit);
        Ok(())
    }

    /// Fits the most promising candidates beside the fitted model with `effects`.
    fn expand(&mut self, effects: Vec<Instance>, progress: &dyn Progress) -> Result<()> {
        let base = match self.known(&effects) {
            Some(index) => self.fits[index].clone(),
            None => {
                let fit = self.fitter.fit(self.part(&effects), Stop::CLOSE)?;
                self.keep(fit.clone());
                fit
            }
        };
        let look = if is_same_set(&effects, &self.best_named().model.effects) { Look::AtRivals } else { Look::Near };
        self.expanded.push(effects);
        let by = self.few.fitter(&self.fitter);
        let start = self.few.of(&by, &base)?;
        let is_open = start.model.effects.len() < self.max_effects;
        let mut heats = self.heats(&by, &by, &start, &start, look);
        heats.extend(self.unnamed(&by, &start));
        if is_open && base.is_strained() {
            // Far from what the records say only the lowest modes tell where to go.
            let lowest = by.of_lowest_modes();
            heats.extend(self.heats(&by, &lowest, &start, &Self::relaxed(&lowest, &start)?, Look::Far));
        }
        heats.sort_by(|a, b| self.log_posterior(b).total_cmp(&self.log_posterior(a)));
        let mut finals: Vec<Fit<'a>> = Vec::new();
        let is_new = |finals: &[Fit<'a>], heat: &Fit<'a>| {
            !finals.iter().any(|f| is_same_set(&f.model.effects, &heat.model.effects))
        };
        // What could stand in the place of an effect is a rival wherever it is nearly as probable.
        let least = self.log_posterior(&start) - COUNTS;
        let (instead, more): (Vec<_>, Vec<_>) =
            heats.iter().partition(|heat| heat.model.effects.len() == start.model.effects.len());
        let rivals = instead.into_iter().filter(|heat| self.log_posterior(heat) > least);
        // What is far behind in a few events is not worth all of them; a response without a name is compared with nothing here.
        let highest = more.iter().filter(|heat| heat.model.is_named()).map(|heat| self.log_posterior(heat));
        let worth = highest.fold(f64::NEG_INFINITY, f64::max) - FAR;
        for heat in more.into_iter().filter(|heat| self.log_posterior(heat) > worth) {
            if finals.len() < FINALS && is_new(&finals, heat) {
                finals.push(heat.clone());
            }
        }
        for heat in rivals {
            if is_new(&finals, heat) {
                finals.push(heat.clone());
            }
        }
        // One that leaves little tells most of what to expect, even where what is expected now does not favour it.
        let alike = heats.into_iter().filter(|h| channels(&h.prediction) == channels(&base.prediction));
        let least = alike.map(|h| (Self::supported(by.forward, &h).1, h)).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((_, heat)) = least
            && is_new(&finals, &heat)
        {
            finals.push(heat);
        }
        for heat in finals {
            let model = Model { declared: base.model.declared, effects: heat.model.effects.clone() };
            // Slopes where the heat began lead on from where it ended, unless that is far.
            let is_near = Self::is_near(&base, &heat);
            let start = Start::at(model, heat.x);
            let slopes = base.slopes.iter().cloned().map(Some);
            self.finish(if is_near { start.carrying(slopes, &base) } else { start }, progress);
        }
        self.move_places(progress);
        Ok(())
    }

    /// First fits, by `fitter`, of the most promising candidates beside `point`, the model of `base`, by what `by` says of them.
    fn heats(&self, fitter: &Fitter<'a>, by: &Fitter<'a>, base: &Fit<'a>, point: &Fit<'a>, look: Look) -> Vec<Fit<'a>> {
        let mut proposals = self.proposals(by, point, look);
        proposals.sort_by(|a, b| b.log_posterior.total_cmp(&a.log_posterior));
        // A pair that holds what a single one holds is always as good before it is fitted. Where tolerances stand in for something, what
        // comes on top of a pair is sought when one of the two is in the model.
        let (instead, more): (Vec<_>, Vec<_>) = proposals.into_iter().partition(|p| p.instead_of.is_some());
        let (singles, pairs): (Vec<_>, Vec<_>) = more.into_iter().partition(|p| p.parts.len() == 1);
        let pairs = if base.is_strained() { Vec::new() } else { distinct(pairs) };
        let beside: Vec<Proposal> = distinct(singles).into_iter().chain(pairs).chain(instead).collect();
        let fitted = |i: usize| {
            let set = beside[i].clone();
            if set.instead_of.is_some() {
                return by.fit_from_afar(Self::from_declared(base, set), FAR_HEAT).ok();
            }
            let start = Self::started(by, point, set);
            let is_far = look == Look::Far;
            if is_far { fitter.fit_from_afar(start, FAR_HEAT) } else { fitter.fit(start, HEAT) }.ok()
        };
        on_threads(beside.len(), fitted).into_iter().flatten().collect()
    }

    /// The best first fit of what has no name beside `base`: a response of one sensor, or of each.
    fn unnamed(&self, by: &Fitter<'a>, base: &Fit<'a>) -> Option<Fit<'a>> {
        if !base.model.is_named() {
            return None;
        }
        let all = effects::unnamed(&by.forward.problem.array);
        let alone = all.iter().map(|response| vec![response.clone()]);
        let together = Some(all.clone()).filter(|all| all.len() > 1);
        let all: Vec<Vec<Instance>> = alone.chain(together).collect();
        let fitted = |i: usize| {
            let effects = [&base.model.effects[..], &all[i]].concat();
            let model = Model { declared: base.model.declared, effects };
            let mut x = base.x.clone();
            x.resize(model.len(), 0.0);
            by.fit(Start::at(model, x).carrying(base.slopes.iter().cloned().map(Some), base), HEAT).ok()
        };
        let fits = on_threads(all.len(), fitted).into_iter().flatten();
        fits.max_by(|a, b| self.log_posterior(a).total_cmp(&self.log_posterior(b)))
    }

    /// Whether the tolerances of `heat` are where slopes at `base` are of use.
    fn is_near(base: &Fit<'_>, heat: &Fit<'_>) -> bool {
        let declared = base.model.declared.len();
        base.x.iter().zip(&heat.x).take(declared).all(|(a, b)| (a - b).abs() < NEAR)
    }

    /// Fits from `start` and keeps that.
    fn finish(&mut self, start: Start<'a>, progress: &dyn Progress) {
        let Ok(found) = self.fitter.fit(start, Stop::CLOSE) else { return };
        progress.note(&self.described(&found));
        self.keep(found);
    }

    /// Tries the effects of the best model at all their other places, as long as that makes it better: what is linear beside a model
    /// that lacks a strong effect points only near its place.
    fn move_places(&mut self, progress: &dyn Progress) {
        let mut tried: Vec<Vec<Instance>> = Vec::new();
        let by = self.few.fitter(&self.fitter);
        loop {
            let best = self.best().clone();
            if tried.iter().any(|t| is_same_set(t, &best.model.effects)) {
                return;
            }
            tried.push(best.model.effects.clone());
            for index in 0..best.model.effects.len() {
                let own = &best.model.effects[index];
                let is_other = |i: &&Instance| i.is_alike(own) && !best.model.effects.iter().any(|e| e.is_one(i));
                let others = self.instances.iter().filter(is_other);
                let moved = others.filter_map(|other| {
                    let mut model = best.model.clone();
                    model.effects[index] = other.clone();
                    let is_open = self.known(&model.effects).is_none();
                    let bounds = model.bounds();
                    let x: Vec<f64> = best.x.iter().zip(bounds).map(|(x, [low, high])| x.clamp(low, high)).collect();
                    let in_few = Model { declared: self.few.declared, effects: model.effects.clone() };
                    let prediction = is_open.then(|| by.predict(&in_few, &x).ok()).flatten()?;
                    Some((by.nll(&prediction), model, x))
                });
                let Some((_, model, x)) = moved.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
                let slopes = best.slopes[..best.model.declared.len()].iter().cloned().map(Some);
                if let Ok(heat) = self.fitter.fit(Start::at(model, x).carrying(slopes, &best), HEAT) {
                    self.finish(Start::from(heat), progress);
                }
            }
        }
    }

    /// Fits parts of the best model anew that do better from where it is: what ended on the way there is no match for it.
    fn renew_parts(&mut self) -> Result<()> {
        loop {
            let best = self.best_named().model.effects.clone();
            for part in (0..best.len()).map(|i| [&best[..i], &best[i + 1..]].concat()) {
                let Some(index) = self.known(&part) else { continue };
                let start = self.part(&part);
                let there = self.fitter.cost_at(&start.model, start.x.clone());
                if there.is_ok_and(|cost| cost < self.fits[index].cost) {
                    let fit = self.fitter.fit(start, Stop::CLOSE)?;
                    self.keep(fit);
                }
            }
            if is_same_set(&best, &self.best_named().model.effects) {
                return Ok(());
            }
        }
    }

    /// Where a fit with `effects`, some of those of the best model, starts from where that one is.
    fn part(&self, effects: &[Instance]) -> Start<'a> {
        let best = self.best_named();
        let n = best.model.declared.len();
        let mut x = best.x[..n].to_vec();
        let mut slopes: Vec<Option<Arc<Rows>>> = best.slopes[..n].iter().cloned().map(Some).collect();
        for effect in effects {
            let index = best.model.effects.iter().position(|e| e.is_one(effect));
            let own = index.map(|i| best.model.start(i)..best.model.start(i) + effect.free.len());
            x.extend(own.clone().map_or_else(|| effect.start(), |own| best.x[own].to_vec()));
            slopes.extend((0..effect.free.len()).map(|k| own.clone().map(|own| best.slopes[own.start + k].clone())));
        }
        let model = Model { declared: best.model.declared, effects: effects.to_vec() };
        Start::at(model, x).carrying(slopes, best)
    }

    /// `fit` with all tolerances as declared: where they were made to stand in for an effect, they lead away from it.
    fn relaxed(by: &Fitter<'a>, fit: &Fit<'a>) -> Result<Fit<'a>> {
        let mut x = fit.x.clone();
        x[..fit.model.declared.len()].fill(0.0);
        by.fit(Start::at(fit.model.clone(), x), Stop::WHERE_IT_IS)
    }

    /// Keeps the better fit of each model.
    fn keep(&mut self, found: Fit<'a>) {
        match self.known(&found.model.effects) {
            Some(i) if self.log_posterior(&self.fits[i]) >= self.log_posterior(&found) => {}
            Some(i) => self.fits[i] = found,
            None => self.fits.push(found),
        }
    }

    /// What was replayed so far, in words.
    pub fn replays(&self) -> String {
        format!("{} replays, {} of few events", self.fitter.forward.replays(), self.few.forward.replays())
    }

    fn described(&self, fit: &Fit<'_>) -> String {
        let table = |i: usize| fit.model.effect_table(&fit.x, i).to_string().replace('\n', ", ");
        let named: Vec<String> = (0..fit.model.effects.len()).map(table).collect();
        let gained = self.log_posterior(fit) - self.log_posterior(&self.fits[0]);
        format!("{}: ln odds {gained:+.1} against nothing missing; {}", named.join("+ "), self.replays())
    }
}

/// Effects of the catalogue at every place of `array` where they have something to act on.
pub(super) fn acting(array: &Array) -> Vec<Instance> {
    let acts = |i: &Instance| {
        let at = i.zero().map_or_else(Vec::new, |zero| away(i, &zero, NODES[0], 1.0).unwrap_or(i.start()));
        effects::build(&i.at(&at)).is_ok_and(|e| e.refusal(&array.profile).is_none())
    };
    effects::instances(array).into_iter().filter(acts).collect()
}

/// ln of the prior of an effect at one of its places among `all` of them, by kind: kinds are as probable as each other, and so are the
/// places of each. Each number that an effect takes from a record is one more that is fitted to it.
///
/// Source: Schwarz (1978), doi 10.1214/aos/1176344136, for ½ ln n a fitted number.
pub(super) fn ln_prior<'i>(
    forward: &Forward<'_>,
    all: impl Iterator<Item = &'i Instance>,
) -> BTreeMap<&'static str, f64> {
    let mut places: BTreeMap<&'static str, (f64, f64)> = BTreeMap::new();
    for instance in all {
        places.entry(instance.kind).or_insert((0.0, instance.hidden() as f64)).0 += 1.0;
    }
    let values = forward.records.iter().map(|at| 2.0 * forward.frequencies_hz(*at).len() as f64);
    let by_number: f64 = values.map(|n| 0.5 * n.ln()).sum();
    let kinds = places.len() as f64;
    places
        .into_iter()
        .map(|(kind, (n, hidden))| (kind, -(kinds * n).ln() - hidden * by_number + ONE_MORE.ln()))
        .collect()
}

/// Whether two sets hold the same effects in any order.
fn is_same_set(one: &[Instance], other: &[Instance]) -> bool {
    one.len() == other.len() && one.iter().all(|a| other.iter().any(|b| a.is_one(b)))
}
