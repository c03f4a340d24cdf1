//! Which effects the records ask for: every effect at every place, alone and in pairs, against what is declared, by evidence.
//!
//! Beside a fitted model every candidate is tried by the surrogate column at strengths on both sides of nothing, or by replays where the
//! column foretells less than half of how these change ([`FORETOLD`]). How residuals change towards such a node is a direction; beside it
//! the coordinates of the model give way, so that the evidence of each candidate, and of each pair, is a small linear problem
//! ([`Competition::expand`]), whose best are fitted by the surrogate. What may be strong is also fitted from
//! declared values ([`scan`]). The best of all are then fitted by replays. The search of a model goes on to its end where it promises to
//! count ([`Competition::settle_close`]): most models are far behind wherever theirs would end. What could be taken for the effects of the
//! model that leads is fitted in their place ([`rivals`]), at once or, where something is lacking in all models, when nothing is left to
//! look around; where declared values may be so far off that there are other modes, that model is fitted from elsewhere as well ([`modes`]).
//! The competition goes on around the best model, around it less each of its effects, and around what is nearly as probable, or, where
//! something is lacking, around the best of each number of effects, the fewest first ([`agenda`]), until that changes nothing. What the
//! records say of the field and of the column's error is read off beside the model that leaves least, under each labelling of the channels,
//! and the models under it are compared by that ([`expectation`]).
//!
//! Source: Bandler et al. (2004), doi 10.1109/TMTT.2003.820904, for a cheap model, right where it is tuned, in the search for the best of a
//! dear one.

mod agenda;
mod expansion;
mod expectation;
#[cfg(test)]
mod linear_gaussian;
mod modes;
mod null;
mod prior;
mod proposals;
mod rivals;
mod scan;

use super::forward::{Forward, Label, Prediction};
use super::parameters::Model;
use super::posterior::{Fit, Fitter, Slope, Start, Stop, foretold};
use super::power::hidden;
use super::recalibration::recalibrated;
use super::weights::Expected;
use crate::diagnosis::Hidden;
use crate::effects::{self, Instance};
use crate::error::Result;
use crate::numerics::threads::on_threads;
use crate::progress::Progress;
use null::Null;
pub(super) use prior::{acting, ln_prior};
use std::borrow::Borrow;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Single effects and pairs that are fitted around one model by the surrogate column, and how many of these by replays.
const HEATS: usize = 4;
const FINALS: usize = 6;
/// ln of the odds against the best within which models are fitted by replays, and kept when what is expected of residuals has changed,
/// unless something is lacking in all.
const FAR: f64 = 30.0;
/// The same within which candidates are looked for around a model, and models fitted to the end: odds of 20 to 1.
///
/// Source: Madigan and Raftery (1994), doi 10.1080/01621459.1994.10476894, Occam's window.
const WINDOW: f64 = 3.0;
/// Most rounds of the competition, and rounds under each of the labels that may be right before the more probable half of them goes on to
/// twice as many.
///
/// Source: Jamieson and Talwalkar (2016), arXiv:1502.07943, successive halving.
const ROUNDS: usize = 24;
const LABEL_ROUNDS: usize = 2;
/// Most rounds at the end.
const SETTLINGS: usize = 3;
/// Share of the power of how replays change above which the equivalent-linear column stands for them: more of it is right than wrong.
const FORETOLD: f64 = 0.5;
/// Change of ln of the density that records tell.
const TOLD: f64 = 0.5;

/// Fitted models by their effects.
pub struct Competition<'a> {
    fitter: Fitter<'a>,
    /// The column by which candidates are looked for.
    surrogate: &'a Forward<'a>,
    instances: Vec<Instance>,
    /// ln of the prior of an effect at a place, by kind.
    ln_prior: BTreeMap<&'static str, f64>,
    max_effects: usize,
    /// Everything that was fitted, what is declared first.
    pub fits: Vec<Fit<'a>>,
    /// Other modes of the posterior of the most probable model.
    pub modes: Vec<Fit<'a>>,
    expanded: Vec<Vec<Instance>>,
    /// What chance brings to models that were looked around.
    nulls: Vec<(Vec<Instance>, Null)>,
    challenged: Vec<Vec<Instance>>,
    explored: Vec<Vec<Instance>>,
}

impl<'a> Competition<'a> {
    /// Prepares the competition around `declared`, the fit without effects; candidates are looked for by the `surrogate` of its column, and
    /// what they do is told by replays where that tells too little of how these change.
    pub fn new(mut fitter: Fitter<'a>, declared: Fit<'a>, surrogate: &'a Forward<'a>, max_effects: usize) -> Self {
        let array = &fitter.forward.problem.array;
        let instances = acting(array);
        let unnamed = effects::unnamed(array);
        fitter.is_led &= foretold(&declared.slopes, &declared.model.prior()).is_none_or(|share| share > FORETOLD);
        let ln_prior = ln_prior(fitter.forward, instances.iter().chain(&unnamed));
        Self {
            fitter,
            surrogate,
            instances,
            ln_prior,
            max_effects,
            fits: vec![declared],
            modes: Vec::new(),
            expanded: Vec::new(),
            nulls: Vec::new(),
            challenged: Vec::new(),
            explored: Vec::new(),
        }
    }

    /// What fits by the surrogate column as it is around `fit`, and that fit by it.
    fn around(&self, fit: &Fit<'a>) -> Result<(Fitter<'a>, Fit<'a>)> {
        self.surrogate.follow(self.fitter.forward, &fit.model.tables(&fit.x))?;
        let by = self.fitter.through(self.surrogate);
        let own = by.fit(Start::from(fit.clone()), Stop::WHERE_IT_IS)?;
        Ok((by, own))
    }

    /// ln of the posterior of a fitted model up to a constant.
    pub fn log_posterior(&self, fit: &Fit<'_>) -> f64 {
        fit.log_evidence() + fit.model.effects.iter().map(|e| self.prior_of(e)).sum::<f64>()
    }

    /// The same with what its search is expected to gain yet.
    fn promise(&self, fit: &Fit<'_>) -> f64 {
        self.log_posterior(fit) + fit.expected_gain()
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

    /// Sorts fits, the most probable first.
    fn best_first<F: Borrow<Fit<'a>>>(&self, fits: &mut [F]) {
        fits.sort_by(|a, b| self.log_posterior(b.borrow()).total_cmp(&self.log_posterior(a.borrow())));
    }

    /// The same by what their searches are expected to gain yet.
    fn most_promising_first(&self, fits: &mut [Fit<'a>]) {
        fits.sort_by(|a, b| self.promise(b).total_cmp(&self.promise(a)));
    }

    fn best_named(&self) -> &Fit<'a> {
        self.best_of(|fit| fit.model.is_named()).unwrap_or(&self.fits[0])
    }

    /// The most probable model of named effects under `labels`.
    fn leading(&self, labels: &[Label]) -> &Fit<'a> {
        let is_meant = |fit: &Fit<'a>| fit.model.is_named() && fit.labels() == labels;
        self.best_of(is_meant).unwrap_or(&self.fits[0])
    }

    fn known(&self, effects: &[Instance]) -> Option<usize> {
        self.fits.iter().position(|f| is_same_set(&f.model.effects, effects))
    }

    /// Runs the competition to its end: candidates are looked for under all labels that may be right, longest under those that do best,
    /// then under the most probable.
    ///
    /// # Errors
    /// When an effect cannot be built.
    pub fn run(&mut self, progress: &dyn Progress) -> Result<()> {
        self.exchange_labels(progress)?;
        let mut all: Vec<Vec<Label>> = self.fits.iter().map(|fit| fit.labels().to_vec()).collect();
        all.sort_unstable();
        all.dedup();
        // What is expected of residuals is far off at first, and candidates by it: the labels that lead then need not be right.
        let mut rounds = LABEL_ROUNDS;
        while all.len() > 1 {
            for labels in &all {
                self.rounds(labels, rounds, progress)?;
            }
            self.compare(&mut all, progress)?;
            all.truncate(all.len().div_ceil(2));
            rounds *= 2;
        }
        let mut labels = self.best_named().labels().to_vec();
        for _ in 0..ROUNDS {
            if !self.round(&labels, progress)? {
                break;
            }
            let ahead = self.best_named().labels().to_vec();
            if ahead != labels {
                let mut both = [labels, ahead];
                self.compare(&mut both, progress)?;
                [labels, _] = both;
            }
        }
        self.settle(progress)
    }

    /// Sorts labels, the most probable first, when what is expected under each is read off beside its best model: a round may have found
    /// what tells most of that, and what is expected beside anything else favours other labels.
    fn compare(&mut self, all: &mut [Vec<Label>], progress: &dyn Progress) -> Result<()> {
        for labels in &*all {
            self.renew(labels, progress)?;
        }
        let reached = |labels: &Vec<Label>| self.log_posterior(self.leading(labels));
        all.sort_by(|a, b| reached(b).total_cmp(&reached(a)));
        Ok(())
    }

    /// Looks for candidates under `labels` in so many `rounds`, or until nothing is left to look around.
    fn rounds(&mut self, labels: &[Label], rounds: usize, progress: &dyn Progress) -> Result<()> {
        for _ in 0..rounds {
            if !self.round(labels, progress)? {
                break;
            }
        }
        Ok(())
    }

    /// Recalibrates the declared model under every exchange of labels that does better than none where nothing is recalibrated: what was
    /// recalibrated under wrong labels is far from what holds under the right ones.
    fn exchange_labels(&mut self, progress: &dyn Progress) -> Result<()> {
        let (forward, declared) = (self.fitter.forward, self.fits[0].model.declared);
        let as_declared = |effects: &[Instance]| -> Result<f64> {
            let model = Model { declared, effects: effects.to_vec() };
            let prediction = Arc::new(forward.predict(&model.tables(&vec![0.0; model.len()]))?);
            Ok(Fitter::new(forward, Expected::of(forward, prediction.clone())).nll(&prediction))
        };
        let none = as_declared(&[])?;
        let exchanges: Vec<Instance> = self.instances.iter().filter(|i| i.exchanges_labels()).cloned().collect();
        for exchange in exchanges {
            if as_declared(std::slice::from_ref(&exchange))? - self.prior_of(&exchange) > none {
                continue;
            }
            let labels = vec![exchange];
            forward.anchor(&Model { declared, effects: labels.clone() }.tables(&vec![0.0; declared.len()]))?;
            let (expected, (model, x)) = recalibrated(forward, declared, labels)?;
            self.fitter = self.fitter.expecting(expected);
            self.finish(Start::at(model, x), progress);
        }
        Ok(())
    }

    /// Fits to the end whatever counts for the answer, what could be taken for its effects among it.
    fn settle(&mut self, progress: &dyn Progress) -> Result<()> {
        for _ in 0..SETTLINGS {
            let labels = self.best().labels().to_vec();
            self.renew_anchor(&labels, Stop::EXACT)?;
            self.renew_parts(&labels)?;
            self.exchange_modes(&labels, progress)?;
            self.challenge(&labels, progress)?;
            self.explored.clear();
            self.explore(&labels, progress)?;
            let leading = self.best().model.effects.clone();
            let highest = self.log_posterior(self.best());
            let counts = |i: &usize| *i == 0 || self.promise(&self.fits[*i]) > highest - WINDOW;
            let counting: Vec<usize> = (0..self.fits.len()).filter(counts).collect();
            let of = |k: usize| self.fitter.fit(Start::from(self.fits[counting[k]].clone()), Stop::EXACT);
            for (i, found) in counting.iter().zip(on_threads(counting.len(), of)) {
                self.fits[*i] = found?;
                progress.note(&self.described(&self.fits[*i]));
            }
            if is_same_set(&leading, &self.best().model.effects) {
                break;
            }
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

    /// The fit of a model of `effects`, its search at its end.
    fn settled(&mut self, effects: &[Instance]) -> Result<Fit<'a>> {
        let known = self.known(effects);
        let fit = match known.map(|index| &self.fits[index]) {
            Some(fit) if fit.is_settled => return Ok(fit.clone()),
            Some(fit) => self.fitter.fit(Start::from(fit.clone()), Stop::CLOSE)?,
            None => self.fitter.fit(self.part(effects), Stop::CLOSE)?,
        };
        match known {
            Some(index) => self.fits[index] = fit.clone(),
            None => self.fits.push(fit.clone()),
        }
        Ok(fit)
    }

    /// Goes on with the searches of models under `labels` until none that has not come to its end promises more than the most probable
    /// that has, but for what counts: most models are far behind, wherever their searches end.
    fn settle_close(&mut self, labels: &[Label], progress: &dyn Progress) -> Result<()> {
        for is_named in [true, false] {
            loop {
                let own = |fit: &Fit<'a>| fit.labels() == labels && fit.model.is_named() == is_named;
                let highest = self.best_of(|fit| own(fit) && fit.is_settled).map(|fit| self.log_posterior(fit));
                let open = (0..self.fits.len()).filter(|i| own(&self.fits[*i]) && !self.fits[*i].is_settled);
                let open = open.map(|i| (self.promise(&self.fits[i]), i)).max_by(|a, b| a.0.total_cmp(&b.0));
                let Some((_, next)) = open.filter(|(promise, _)| highest.is_none_or(|h| *promise > h - WINDOW)) else {
                    break;
                };
                self.fits[next] = self.fitter.fit(Start::from(self.fits[next].clone()), Stop::CLOSE)?;
                progress.note(&self.described(&self.fits[next]));
            }
        }
        Ok(())
    }

    /// Fits from each of `starts` as far as its stop says, side by side, and keeps these.
    fn begin(&mut self, starts: &[(Start<'a>, Stop)]) {
        let fitted = |i: usize| self.fitter.fit(starts[i].0.clone(), starts[i].1).ok();
        let found = on_threads(starts.len(), fitted);
        found.into_iter().flatten().for_each(|fit| self.keep(fit));
    }

    /// Fits from `start` and keeps that; what was found, if anything.
    fn finish(&mut self, start: Start<'a>, progress: &dyn Progress) -> Option<Fit<'a>> {
        let found = self.fitter.fit(start, Stop::CLOSE).ok()?;
        progress.note(&self.described(&found));
        self.keep(found.clone());
        Some(found)
    }

    /// Where a fit with `effects` starts: where the most probable model of named effects is that has all of them.
    fn part(&self, effects: &[Instance]) -> Start<'a> {
        let has_all = |fit: &Fit<'a>| fit.model.is_named() && effects.iter().all(|e| fit.model.index_of(e).is_some());
        let best = self.best_of(has_all).unwrap_or(&self.fits[0]);
        let x = coordinates(best, effects, |i| effects[i].start());
        let model = Model { declared: best.model.declared, effects: effects.to_vec() };
        let slopes = Self::slopes_of(best, &model);
        Start::at(model, x).carrying(slopes)
    }

    /// Slopes of `fit` by the coordinates of another model, as far as the two share them.
    fn slopes_of(fit: &Fit<'a>, model: &Model<'a>) -> Vec<Option<Slope>> {
        let of_effect = |effect: &Instance| match fit.model.index_of(effect) {
            Some(index) => fit.model.coordinates_of(index).map(|i| Some(fit.slopes[i].clone())).collect(),
            None => vec![None; effect.free.len()],
        };
        let declared = fit.slopes[..fit.model.declared.len()].iter().cloned().map(Some);
        declared.chain(model.effects.iter().flat_map(of_effect)).collect()
    }

    /// Kinds of effects that could be there beside `fit` unnoticed.
    pub fn hidden(&self, fit: &Fit<'a>) -> Vec<Hidden> {
        let Ok((by, base)) = self.around(fit) else { return Vec::new() };
        let open: Vec<Instance> = self.instances.iter().filter(|i| base.model.index_of(i).is_none()).cloned().collect();
        hidden(&by, &base, &open, |instance| Some(self.prior_of(instance)))
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
        format!("{} replays, {} by the surrogate", self.fitter.forward.replays(), self.surrogate.replays())
    }

    fn described(&self, fit: &Fit<'_>) -> String {
        let table = |i: usize| fit.model.effect_table(&fit.x, i).to_string().replace('\n', ", ");
        let named: Vec<String> = (0..fit.model.effects.len()).map(table).collect();
        let gained = self.log_posterior(fit) - self.log_posterior(&self.fits[0]);
        format!("{}: ln odds {gained:+.1} against nothing missing; {}", named.join("+ "), self.replays())
    }
}

/// Coordinates of a model of `effects` as in `from`, and `otherwise` those of effects that it does not have.
fn coordinates(from: &Fit<'_>, effects: &[Instance], otherwise: impl Fn(usize) -> Vec<f64>) -> Vec<f64> {
    let of = |(i, effect): (usize, &Instance)| match from.model.index_of(effect) {
        Some(index) => from.x[from.model.coordinates_of(index)].to_vec(),
        None => otherwise(i),
    };
    let declared = from.x[..from.model.declared.len()].iter().copied();
    declared.chain(effects.iter().enumerate().flat_map(of)).collect()
}

/// Whether two sets hold the same effects in any order.
fn is_same_set(one: &[Instance], other: &[Instance]) -> bool {
    one.len() == other.len() && one.iter().all(|a| other.iter().any(|b| a.is_one(b)))
}

/// Whether `sets` hold a set of effects.
fn has_set(sets: &[Vec<Instance>], set: &[Instance]) -> bool {
    sets.iter().any(|known| is_same_set(known, set))
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Truth, Uniform, as_declared, in_competition, problem};
    use super::*;
    use crate::progress::Quiet;

    #[test]
    fn labels_are_compared_by_what_is_expected_beside_the_best_model_of_each() {
        let table = "kind = 'sensor_orientation'\nsensor = 'top'\nazimuth_deg = 20.0";
        let problem = problem(&Truth { table, events: 4, ..Truth::default() });
        in_competition(&problem, &Uniform(&problem), as_declared, |mut competition| {
            let at_top = |kind: &'static str| {
                let is_meant =
                    move |i: &&Instance| i.kind == kind && i.target.values().any(|at| at.as_str() == Some("top"));
                competition.instances.iter().find(is_meant).cloned().expect("a candidate")
            };
            let (turned, crossed) = (at_top("sensor_orientation"), at_top("swapped_channels"));
            let declared = competition.fits[0].model.declared;
            let start = |effects: Vec<Instance>, azimuth_deg: f64| {
                let mut x = vec![0.0; declared.len()];
                x.push(azimuth_deg);
                Start::at(Model { declared, effects }, x)
            };
            let right = competition.finish(start(vec![turned.clone()], 10.0), &Quiet).expect("a fit");
            let wrong = competition.finish(start(vec![crossed, turned], -40.0), &Quiet).expect("a fit");
            let mut both = [&wrong, &right].map(|fit| fit.labels().to_vec());
            assert!(both[0] != both[1]);
            let coherence = |competition: &Competition<'_>| {
                let spread = competition.fitter.spread(&right.prediction).expect("an expectation");
                spread.coherence[1].iter().copied().fold(f64::INFINITY, f64::min)
            };
            // That of the right labels was read off where the turn was taken for a field that strays.
            assert!(coherence(&competition) < 0.97, "{}", coherence(&competition));
            competition.compare(&mut both, &Quiet).expect("fits");
            assert!(coherence(&competition) > 0.99, "{}", coherence(&competition));
            assert_eq!(both[0], right.labels());
        });
    }
}
