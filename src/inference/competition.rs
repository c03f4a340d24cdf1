//! Which effects the records ask for: every effect at every place, alone and in pairs, against what is declared, by evidence.
//!
//! Around a fitted model each candidate is a direction in which its prediction changes; tolerances, discrepancy and the effects that
//! are there already are marginalised beside it, so that its evidence is a small linear problem. The best of each kind are then fitted
//! with the column itself, and the competition goes on around the best of these, and around it less each of its effects, until that
//! changes nothing.

use super::algebra::{self, Marginal};
use super::forward::{Forward, Prediction};
use super::likelihood::Slope;
use super::parameters::{Model, is_replayed, prior_of};
use super::posterior::{Fit, Fitter, Start, Stop, difference};
use crate::effects::{self, Instance};
use crate::error::Result;
use crate::progress::Progress;
use faer::Mat;
use std::collections::BTreeMap;

/// Kinds that are fitted around one model, alone and in pairs.
const KINDS: usize = 4;
/// Steps of the first fits from a point, and of those that go on; how many go on.
const HEAT: usize = 4;
const STEPS: usize = 24;
const FINALS: usize = 3;
/// Expected gain in ln of the evidence below which a fit of the search has converged.
const CONVERGED: f64 = 0.3;
/// ln of the odds against the best within which models are fitted exactly at the end: fits of the search are no better than that.
const CLOSE: f64 = 30.0;
/// Share of what the best model has over another that a candidate beside that one must promise to be fitted.
const HOPEFUL: f64 = 0.3;
/// Candidates whose directions are taken anew at a point, and places of one kind among them.
const SHORTLIST: usize = 16;
const PLACES: usize = 3;
/// Pairs that get hyperparameters of their own.
const PAIRS: usize = 8;
/// Farthest strength along a direction, in that of its node.
const FARTHEST: f64 = 3.0;
/// Shares of the way to where the linear problem puts a set at which its fit may start.
const SHARES: [f64; 3] = [1.0, 0.5, 0.2];
/// Most rounds of the competition.
const ROUNDS: usize = 12;
/// Sizes of a strength at which a candidate is tried, in typical sizes: by replay where all are, by replay where few are, and by a
/// sensor's operator.
const NODES: [&[f64]; 3] = [&[0.5], &[0.5, 1.5], &[0.25, 1.0, 2.0]];
/// Prior probability of one effect more.
const ONE_MORE: f64 = 0.25;

/// A candidate at one strength, beside a model.
struct Node {
    instance: Instance,
    /// Coordinates of its parameters there.
    at: Vec<f64>,
    /// Strength there over the deviation of its prior.
    distance: f64,
    is_one_sided: bool,
}

/// A candidate's node and how the prediction of a point changes towards it.
struct Direction {
    node: Node,
    slope: Slope,
}

/// Candidates that the linear problem finds worth a fit.
struct Proposal {
    /// Effects, and coordinates to start from.
    parts: Vec<(Instance, Vec<f64>)>,
    /// Coordinates of the model at the point from which they are proposed, and what these move beside them.
    from: Vec<f64>,
    beside: Vec<f64>,
    log_evidence: f64,
}

/// What the linear problem says of one node.
struct Linear {
    /// Its place among the directions.
    index: usize,
    /// Strength where the linear problem puts it, in that of its node.
    share: f64,
    log_evidence: f64,
}

/// Fitted models by their effects.
pub struct Competition<'a> {
    fitter: Fitter<'a>,
    instances: Vec<Instance>,
    /// ln of the prior of an effect at a place, by kind.
    ln_place: BTreeMap<&'static str, f64>,
    max_effects: usize,
    /// Everything that was fitted, what is declared first.
    pub fits: Vec<Fit<'a>>,
    expanded: Vec<Vec<Instance>>,
    /// Models that were fitted without each of their effects.
    lessened: Vec<Vec<Instance>>,
    /// Directions of all candidates that are replayed, at the two points of what is declared.
    known_directions: [Vec<Direction>; 2],
}

impl<'a> Competition<'a> {
    /// Prepares the competition around `declared`, the fit without effects.
    pub fn new(fitter: Fitter<'a>, declared: Fit<'a>, max_effects: usize) -> Self {
        let instances = effects::instances(&fitter.forward.problem.array);
        let mut places: BTreeMap<&'static str, f64> = BTreeMap::new();
        instances.iter().for_each(|i| *places.entry(i.kind).or_default() += 1.0);
        let kinds = places.len() as f64;
        let ln_place = places.iter().map(|(kind, n)| (*kind, -(kinds * n).ln())).collect();
        Self {
            fitter,
            instances,
            ln_place,
            max_effects,
            fits: vec![declared],
            expanded: Vec::new(),
            lessened: Vec::new(),
            known_directions: Default::default(),
        }
    }

    /// ln of the posterior of a fitted model up to a constant.
    pub fn log_posterior(&self, fit: &Fit<'_>) -> f64 {
        let places: f64 = fit.model.effects.iter().map(|e| self.ln_place.get(e.kind).copied().unwrap_or(-10.0)).sum();
        fit.log_evidence(self.design_effect()) + places + fit.model.effects.len() as f64 * ONE_MORE.ln()
    }

    /// How many times less the records say than the likelihood makes of them.
    pub fn design_effect(&self) -> f64 {
        self.fitter.design_effect
    }

    /// The most probable model.
    pub fn best(&self) -> &Fit<'a> {
        let better = |a: &&Fit<'a>, b: &&Fit<'a>| self.log_posterior(a).total_cmp(&self.log_posterior(b));
        self.fits.iter().max_by(better).unwrap_or(&self.fits[0])
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
            self.renew_design_effect();
            let best = self.best().clone();
            let mut open = vec![best.model.effects.clone()];
            for left_out in 0..best.model.effects.len() {
                open.push(self.fit_less(&best, left_out)?);
            }
            if !self.lessened.iter().any(|set| is_same_set(set, &best.model.effects)) {
                self.lessened.push(best.model.effects.clone());
            }
            // A model without one of its effects may be better from here than what was found of it.
            if !is_same_set(&self.best().model.effects, &best.model.effects) {
                continue;
            }
            for effect in &best.model.effects {
                if best.model.effects.len() > 2 && self.known(std::slice::from_ref(effect)).is_some() {
                    open.push(vec![effect.clone()]);
                }
            }
            let Some(next) = open
                .into_iter()
                .find(|set| set.len() < self.max_effects && !self.expanded.iter().any(|e| is_same_set(e, set)))
            else {
                break;
            };
            self.expand(next, progress)?;
        }
        self.settle(progress)
    }

    /// The design effect is that beside the best model.
    fn renew_design_effect(&mut self) {
        self.fitter.design_effect = self.best().design_effect(self.fitter.likelihood);
    }

    /// Fits exactly whatever is close to the best.
    fn settle(&mut self, progress: &dyn Progress) -> Result<()> {
        loop {
            let highest = self.log_posterior(self.best());
            let is_open = |f: &Fit<'a>| !f.is_exact && self.log_posterior(f) > highest - CLOSE;
            let Some(open) = self.fits.iter().position(is_open) else { return Ok(()) };
            let mut found = self.fitter.settled(&self.fits[open])?;
            if self.log_posterior(&found) < self.log_posterior(&self.fits[open]) {
                found = Fit { is_exact: true, ..self.fits[open].clone() };
            }
            self.fits[open] = found;
            progress.note(&format!("exactly: {}", self.described(&self.fits[open])));
            self.renew_design_effect();
        }
    }

    /// Fits `fit` without one of its effects from where that one is: no model may lose to a larger one because it was fitted worse.
    fn fit_less(&mut self, fit: &Fit<'a>, left_out: usize) -> Result<Vec<Instance>> {
        let mut effects = fit.model.effects.clone();
        let gone = effects.remove(left_out);
        if self.lessened.iter().any(|set| is_same_set(set, &fit.model.effects)) {
            return Ok(effects);
        }
        let start = fit.model.start(left_out);
        let range = start..start + gone.free.len();
        let kept = |i: &usize| !range.contains(i);
        let x = (0..fit.x.len()).filter(kept).map(|i| fit.x[i]).collect();
        let slopes = (0..fit.x.len()).filter(kept).map(|i| Some(fit.slopes[i].clone())).collect();
        let model = Model { declared: fit.model.declared, effects: effects.clone() };
        let stop = Stop { steps: STEPS, gain: CONVERGED, cost: f64::INFINITY, is_exact: false };
        let found = self.fitter.fit(Start { model, x, hyper: fit.hyper.clone(), slopes }, stop)?;
        self.keep(found);
        Ok(effects)
    }

    /// Fits the most promising candidates beside the fitted model with `effects`.
    fn expand(&mut self, effects: Vec<Instance>, progress: &dyn Progress) -> Result<()> {
        let Some(index) = self.known(&effects) else { return Ok(()) };
        self.expanded.push(effects.clone());
        let base = self.fits[index].clone();
        let cost = base.cost(self.design_effect());
        let known = self.log_posterior(self.best()) - self.log_posterior(&base);
        let stop = Stop { steps: HEAT, gain: CONVERGED, cost: cost - HOPEFUL * known, is_exact: false };
        let mut heats = Vec::new();
        for (i, point) in [base.clone(), self.relaxed(&base)?].iter().enumerate() {
            if self.known_directions[i].is_empty() {
                let is_linear = |n: &Node| !n.at.is_empty() && !Forward::is_interference(&n.instance);
                let sizes = |i: &Instance| if self.is_replayed(i) { NODES[0] } else { &[] };
                let mut nodes: Vec<Node> = self.nodes(point, sizes).into_iter().filter(is_linear).collect();
                // One direction serves both signs.
                nodes.dedup_by(|b, a| a.instance == b.instance && a.distance * b.distance < 0.0);
                self.known_directions[i] = nodes.into_iter().filter_map(|node| self.direction(point, node)).collect();
            }
            let mut proposals = self.proposals(point, cost, &self.known_directions[i]);
            proposals.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
            if i == 0 {
                proposals.retain(|p| p.log_evidence >= HOPEFUL * known);
            }
            heats.extend(self.heats(&base, proposals, stop));
        }
        self.finals(heats, Stop { steps: STEPS, ..stop }, progress);
        Ok(())
    }

    /// `fit` with all tolerances as declared: where they were made to stand in for an effect, they lead away from it.
    fn relaxed(&self, fit: &Fit<'a>) -> Result<Fit<'a>> {
        let mut x = fit.x.clone();
        x[..fit.model.declared.len()].fill(0.0);
        let prediction = std::sync::Arc::new(self.fitter.forward.predict(&fit.model.tables(&x))?);
        let hyper = self.fitter.likelihood.tuned(&prediction, &fit.hyper, 2);
        Ok(Fit { x, prediction, hyper, ..fit.clone() })
    }

    fn is_replayed(&self, instance: &Instance) -> bool {
        is_replayed(instance, &self.fitter.forward.problem.array.input)
    }

    /// Fits of a few steps from each of `proposals`.
    fn heats(&self, base: &Fit<'a>, proposals: Vec<Proposal>, stop: Stop) -> Vec<Fit<'a>> {
        let mut found = Vec::new();
        for set in chosen(proposals) {
            let mut all = base.model.effects.clone();
            all.extend(set.parts.iter().map(|(instance, _)| instance.clone()));
            if all.len() > self.max_effects {
                continue;
            }
            let slopes = base.slopes.iter().cloned().map(Some).collect();
            let model = Model { declared: base.model.declared, effects: all };
            let x = self.started(base, &model, &set);
            found.extend(self.fitter.fit(Start { model, x, hyper: base.hyper.clone(), slopes }, stop));
        }
        found
    }

    /// Goes on with the best of `heats`.
    fn finals(&mut self, mut heats: Vec<Fit<'a>>, stop: Stop, progress: &dyn Progress) {
        heats.sort_by(|a, b| self.log_posterior(b).total_cmp(&self.log_posterior(a)));
        let mut chosen: Vec<Fit<'a>> = Vec::new();
        for heat in heats {
            if chosen.len() < FINALS && !chosen.iter().any(|c| is_same_set(&c.model.effects, &heat.model.effects)) {
                chosen.push(heat);
            }
        }
        for Fit { model, x, hyper, slopes, .. } in chosen {
            let slopes = slopes.into_iter().map(Some).collect();
            let Ok(found) = self.fitter.fit(Start { model, x, hyper, slopes }, stop) else { continue };
            progress.note(&self.described(&found));
            self.keep(found);
        }
    }

    /// Keeps the better fit of each model.
    fn keep(&mut self, found: Fit<'a>) {
        match self.known(&found.model.effects) {
            Some(i) if self.log_posterior(&self.fits[i]) >= self.log_posterior(&found) => {}
            Some(i) => self.fits[i] = found,
            None => self.fits.push(found),
        }
    }

    fn described(&self, fit: &Fit<'_>) -> String {
        let table = |i: usize| fit.model.effect_table(&fit.x, i).to_string().replace('\n', ", ");
        let named: Vec<String> = (0..fit.model.effects.len()).map(table).collect();
        let gained = self.log_posterior(fit) - self.log_posterior(&self.fits[0]);
        let levels = [fit.hyper.levels.wide, fit.hyper.levels.narrow, fit.hyper.levels.own];
        format!(
            "{}: ln odds {gained:+.1} against nothing missing; levels {:.4?}, design effect {:.2}; {} replays",
            named.join("+ "),
            levels.map(f64::exp),
            fit.design_effect(self.fitter.likelihood),
            self.fitter.forward.replays()
        )
    }

    /// Where to start a fit of `set` beside `base`: on the way to where the linear problem puts it, as far as the column agrees.
    fn started(&self, base: &Fit<'a>, model: &Model<'a>, set: &Proposal) -> Vec<f64> {
        let at = |share: f64| {
            let mut x: Vec<f64> = set.from.iter().zip(&set.beside).map(|(x, d)| x + share * d).collect();
            for (instance, start) in &set.parts {
                let zero = instance.zero().unwrap_or_default();
                x.extend(zero.iter().zip(start).map(|(a, b)| a + share * (b - a)));
            }
            let bounds = model.bounds();
            x.iter_mut().zip(bounds).for_each(|(x, [low, high])| *x = x.clamp(low, high));
            x
        };
        let cost = |x: &Vec<f64>| {
            let found = self.fitter.forward.predict(&model.tables(x));
            found.map_or(f64::INFINITY, |p| {
                self.fitter.likelihood.nll(&p, &base.hyper) / self.design_effect() + Fitter::prior(model, x)
            })
        };
        let all: Vec<Vec<f64>> = SHARES.iter().map(|share| at(*share)).collect();
        let costs: Vec<f64> = all.iter().map(cost).collect();
        let best = (0..all.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0);
        all.into_iter().nth(best).unwrap_or_default()
    }

    /// Candidates that the model lacks, at the nodes of the given sizes.
    fn nodes(&self, base: &Fit<'a>, sizes: impl Fn(&Instance) -> &'static [f64]) -> Vec<Node> {
        let mut nodes = Vec::new();
        for instance in &self.instances {
            if base.model.effects.iter().any(|e| is_one(e, instance)) {
                continue;
            }
            let Some(zero) = instance.zero() else {
                nodes.push(Node { instance: instance.clone(), at: Vec::new(), distance: 1.0, is_one_sided: true });
                continue;
            };
            let bounds = instance.bounds();
            for (i, free) in instance.free.iter().enumerate().filter(|(_, f)| f.zero.is_some()) {
                let is_one_sided = bounds[i].iter().any(|b| (b - zero[i]).abs() < 1e-12);
                for size in sizes(instance) {
                    for sign in [1.0, -1.0] {
                        let at = (zero[i] + sign * size * free.size).clamp(bounds[i][0], bounds[i][1]);
                        if (at - zero[i]).abs() < 1e-3 * size * free.size {
                            continue;
                        }
                        let mut all = zero.clone();
                        all[i] = at;
                        let distance = (at - zero[i]) / prior_of(free)[1];
                        nodes.push(Node { instance: instance.clone(), at: all, distance, is_one_sided });
                    }
                }
            }
        }
        nodes
    }

    /// All candidates beside `base`, each at its best node, against a `cost`; `known` are directions of those that are replayed, from another point.
    fn proposals(&self, base: &Fit<'a>, cost: f64, known: &[Direction]) -> Vec<Proposal> {
        let mut proposals = Vec::new();
        let mut analytic = Vec::new();
        for node in self.nodes(base, |i| if self.is_replayed(i) { &[] } else { NODES[2] }) {
            if node.at.is_empty() || Forward::is_interference(&node.instance) {
                let mut all = base.model.tables(&base.x);
                all.push(node.instance.at(&node.at));
                if let Ok(there) = self.fitter.forward.predict(&all) {
                    proposals.extend(self.discrete(base, node, &there, cost));
                }
                continue;
            }
            analytic.extend(self.direction(base, node));
        }
        let is_lacking = |d: &&Direction| !base.model.effects.iter().any(|e| is_one(e, &d.node.instance));
        let all: Vec<&Direction> = known.iter().filter(is_lacking).chain(&analytic).collect();
        let (singles, _) = self.linear(base, &all);
        let promising = shortlist(&all, &singles);
        // Which way each of them goes is known by now.
        let toward = |instance: &Instance| {
            let found = singles.iter().find(|s| all[s.index].node.instance == *instance)?;
            Some((found.share * all[found.index].node.distance).signum())
        };
        let is_meant =
            |n: &Node| self.is_replayed(&n.instance) && toward(&n.instance).is_none_or(|t| t * n.distance > 0.0);
        let sizes = |i: &Instance| if promising.contains(i) { NODES[1] } else { &[] };
        let renewed =
            self.nodes(base, sizes).into_iter().filter(is_meant).filter_map(|node| self.direction(base, node));
        let renewed: Vec<Direction> = renewed.collect();
        let kept = analytic.iter().filter(|d| promising.contains(&d.node.instance));
        let anew: Vec<&Direction> = renewed.iter().chain(kept).collect();
        let (singles, pairs) = self.linear(base, &anew);
        proposals.extend(singles.iter().filter_map(|s| self.tuned(base, &[anew[s.index]], cost)));
        if base.model.effects.len() + 2 <= self.max_effects {
            proposals.extend(pairs.iter().filter_map(|pair| self.tuned(base, &pair.map(|i| anew[i]), cost)));
        }
        proposals
    }

    /// How the prediction of `base` changes towards a node.
    fn direction(&self, base: &Fit<'a>, node: Node) -> Option<Direction> {
        let mut all = base.model.tables(&base.x);
        all.push(node.instance.at(&node.at));
        let there = self.fitter.forward.predict(&all).ok()?;
        let slope = difference(&base.prediction, &there, 1.0);
        Some(Direction { node, slope })
    }

    /// Candidates together by the linear prediction with hyperparameters of their own: what they explain is no discrepancy any more.
    fn tuned(&self, base: &Fit<'a>, set: &[&Direction], against: f64) -> Option<Proposal> {
        let likelihood = self.fitter.likelihood;
        let slopes: Vec<Slope> = base.slopes.iter().cloned().chain(set.iter().map(|d| d.slope.clone())).collect();
        let prior = base.model.prior();
        let n = base.x.len();
        let mut precision: Vec<f64> = prior.iter().map(|[_, sd]| 1.0 / (sd * sd)).collect();
        precision.extend(set.iter().map(|d| d.node.distance * d.node.distance));
        let mut z: Vec<f64> = base.x.iter().zip(&prior).map(|(x, [mean, _])| x - mean).collect();
        z.resize(n + set.len(), 0.0);
        let mut prediction = (*base.prediction).clone();
        let mut hyper = likelihood.sharpened(&base.hyper);
        let (mut cost, mut occam) = (0.0, 0.0);
        for _ in 0..2 {
            let reduced = likelihood.at(&prediction, &slopes, &hyper)?.thinned(self.design_effect());
            let held = |i: usize, step: f64| {
                let Some(Direction { node, .. }) = i.checked_sub(n).and_then(|i| set.get(i)) else { return step };
                let least = if node.is_one_sided { 0.0 } else { -FARTHEST };
                (z[i] + step).clamp(least, FARTHEST) - z[i]
            };
            let step = solved(&reduced.g, &z, &precision, held)?;
            for (slope, dx) in slopes.iter().zip(&step) {
                for (p, change) in prediction.iter_mut().zip(slope.iter()) {
                    for (y, d) in p.outputs.iter_mut().flatten().zip(change.iter().flatten()) {
                        *y += d * *dx;
                    }
                }
            }
            z.iter_mut().zip(&step).for_each(|(z, d)| *z += d);
            hyper = likelihood.tuned(&prediction, &hyper, 2);
            let distance: f64 = z.iter().zip(&precision).map(|(z, p)| 0.5 * z * z * p).sum();
            cost = likelihood.nll(&prediction, &hyper) / self.design_effect() + distance;
            occam = (n..z.len()).map(|i| -0.5 * (1.0 + reduced.g[(i, i)] / precision[i]).ln()).sum();
        }
        let place: f64 = set.iter().map(|d| self.prior_of(&d.node.instance)).sum();
        let part = |(i, Direction { node, .. }): (usize, &&Direction)| {
            let zero = node.instance.zero().unwrap_or_default();
            let start = zero.iter().zip(&node.at).map(|(a, b)| a + z[n + i] * (b - a));
            let start = start.zip(node.instance.bounds()).map(|(x, [low, high])| x.clamp(low, high)).collect();
            (node.instance.clone(), start)
        };
        let beside = (0..n).map(|i| prior[i][0] + z[i] - base.x[i]).collect();
        let from = base.x.clone();
        let log_evidence = against - cost + occam + place;
        Some(Proposal { parts: set.iter().enumerate().map(part).collect(), from, beside, log_evidence })
    }

    /// A candidate that is either there or not, or that changes the records themselves.
    fn discrete(&self, base: &Fit<'a>, node: Node, there: &Prediction, against: f64) -> Option<Proposal> {
        let likelihood = self.fitter.likelihood;
        let hyper = likelihood.tuned(there, &base.hyper, 1);
        let cost = likelihood.nll(there, &hyper) / self.design_effect() + Fitter::prior(&base.model, &base.x);
        let hidden = if node.at.is_empty() { 0.0 } else { self.fitter.forward.records.len() as f64 };
        let log_evidence = against - cost - hidden / self.design_effect() + self.prior_of(&node.instance);
        Some(Proposal {
            parts: vec![(node.instance, node.at)],
            from: base.x.clone(),
            beside: vec![0.0; base.x.len()],
            log_evidence,
        })
    }

    fn prior_of(&self, instance: &Instance) -> f64 {
        self.ln_place.get(instance.kind).copied().unwrap_or(-10.0) + ONE_MORE.ln()
    }

    /// The best node of each candidate by the linear problem around `base`, and the best pairs of these.
    fn linear(&self, base: &Fit<'a>, nodes: &[&Direction]) -> (Vec<Linear>, Vec<[usize; 2]>) {
        let slopes: Vec<Slope> = base.slopes.iter().cloned().chain(nodes.iter().map(|d| d.slope.clone())).collect();
        let Some(reduced) =
            self.fitter.likelihood.at(&base.prediction, &slopes, &self.fitter.likelihood.sharpened(&base.hyper))
        else {
            return (Vec::new(), Vec::new());
        };
        let reduced = reduced.thinned(self.design_effect());
        let prior = base.model.prior();
        let precision: Vec<f64> = prior.iter().map(|[_, sd]| 1.0 / (sd * sd)).collect();
        // The base is where its posterior is highest: beside it, only what the prior holds is added to the information.
        let Some(Marginal { left, .. }) = centred(&reduced.g, base, &precision) else {
            return (Vec::new(), Vec::new());
        };
        let last = left.nrows() - 1;
        let mut best: Vec<Linear> = Vec::new();
        let held = |node: &Node, share: f64| {
            // Beyond its node and far from it a direction says little.
            share.clamp(if node.is_one_sided { 0.0 } else { -FARTHEST }, FARTHEST)
        };
        for (index, Direction { node, .. }) in nodes.iter().enumerate() {
            let (a, b) = (left[(index, index)], left[(index, last)]);
            let total = a + node.distance * node.distance;
            let share = held(node, b / total);
            let gain = b * share - 0.5 * total * share * share - 0.5 * (total / (node.distance * node.distance)).ln();
            let found = Linear { index, share, log_evidence: gain + self.prior_of(&node.instance) };
            match best.iter_mut().find(|p| nodes[p.index].node.instance == node.instance) {
                Some(known) if known.log_evidence >= found.log_evidence => {}
                Some(known) => *known = found,
                None => best.push(found),
            }
        }
        best.sort_by(|a, b| b.log_evidence.total_cmp(&a.log_evidence));
        let mut pairs: Vec<([usize; 2], f64)> = Vec::new();
        for (n, one) in best.iter().enumerate().take(SHORTLIST) {
            for other in best.iter().take(SHORTLIST).skip(n + 1) {
                let pair = [one.index, other.index];
                let [p, q] = pair.map(|i| &nodes[i].node);
                let [a, d] = pair.map(|i| left[(i, i)] + nodes[i].node.distance.powi(2));
                let (c, [e, f]) = (left[(pair[0], pair[1])], pair.map(|i| left[(i, last)]));
                let determinant = a * d - c * c;
                if determinant <= 1e-9 * a * d {
                    continue;
                }
                let shares = [held(p, (d * e - c * f) / determinant), held(q, (a * f - c * e) / determinant)];
                let linear = e * shares[0] + f * shares[1];
                let square = a * shares[0] * shares[0] + d * shares[1] * shares[1] + 2.0 * c * shares[0] * shares[1];
                let occam = 0.5 * (determinant / (p.distance * q.distance).powi(2)).ln();
                pairs.push((pair, linear - 0.5 * square - occam));
            }
        }
        pairs.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut known: Vec<[String; 2]> = Vec::new();
        let is_new = |(pair, _): &([usize; 2], f64)| {
            let mut kinds = pair.map(|i| form(&nodes[i].node.instance));
            kinds.sort_unstable();
            let is_new = !known.contains(&kinds);
            known.push(kinds);
            is_new
        };
        let pairs = pairs.into_iter().filter(is_new).take(PAIRS).map(|(pair, _)| pair).collect();
        (best, pairs)
    }
}

/// Normal equations of what is beside the coordinates of `base`, these eliminated.
fn centred(g: &Mat<f64>, base: &Fit<'_>, precision: &[f64]) -> Option<Marginal> {
    let n = base.x.len();
    let last = g.nrows() - 1;
    let mut own = g.clone();
    for (i, [mean, _]) in base.model.prior().iter().enumerate() {
        let pull = (base.x[i] - mean) * precision[i];
        own[(i, last)] -= pull;
        own[(last, i)] -= pull;
    }
    algebra::without(&own, &(0..n).collect::<Vec<_>>(), precision)
}

/// Candidates worth another look: the best places of the best kinds.
fn shortlist(directions: &[&Direction], ranked: &[Linear]) -> Vec<Instance> {
    let mut kinds: BTreeMap<String, usize> = BTreeMap::new();
    let mut found: Vec<Instance> = Vec::new();
    for linear in ranked {
        let instance = &directions[linear.index].node.instance;
        let count = kinds.entry(form(instance)).or_default();
        *count += 1;
        if *count <= PLACES && found.len() < SHORTLIST {
            found.push(instance.clone());
        }
    }
    found
}

/// The step of coordinates `z` from the means of their prior that normal equations ask for, where `held` gives how far a coordinate may
/// follow it; the others make the best of what is held.
fn solved(g: &Mat<f64>, z: &[f64], precision: &[f64], held: impl Fn(usize, f64) -> f64) -> Option<Vec<f64>> {
    let n = z.len();
    let mut step = vec![0.0; n];
    let mut free: Vec<usize> = (0..n).collect();
    loop {
        let left: Vec<f64> = free
            .iter()
            .map(|i| {
                let fixed = (0..n).filter(|j| !free.contains(j)).map(|j| g[(*i, j)] * step[j]).sum::<f64>();
                g[(*i, n)] - z[*i] * precision[*i] - fixed
            })
            .collect();
        let m = free.len();
        let a = Mat::from_fn(m, m, |i, j| g[(free[i], free[j])] + if i == j { precision[free[i]] } else { 0.0 });
        let found = algebra::solved(&a, &left)?;
        free.iter().zip(&found).for_each(|(i, dx)| step[*i] = held(*i, *dx));
        let is_followed: Vec<bool> = free.iter().zip(&found).map(|(i, dx)| (step[*i] - dx).abs() < 1e-12).collect();
        if is_followed.iter().all(|followed| *followed) {
            return Some(step);
        }
        let mut followed = is_followed.into_iter();
        free.retain(|_| followed.next().unwrap_or(true));
    }
}

/// Sets of candidates to be fitted: the best place of each set of kinds.
fn chosen(proposals: Vec<Proposal>) -> Vec<Proposal> {
    let mut known: Vec<Vec<String>> = Vec::new();
    let mut sets = Vec::new();
    for proposal in proposals {
        let mut kinds: Vec<String> = proposal.parts.iter().map(|(i, _)| form(i)).collect();
        kinds.sort_unstable();
        if sets.len() < KINDS && !known.contains(&kinds) {
            known.push(kinds);
            sets.push(proposal);
        }
    }
    sets
}

/// Kind and parameters of a candidate: one effect may have several forms.
fn form(instance: &Instance) -> String {
    let names = instance.free.iter().map(|f| f.parameter.name);
    std::iter::once(instance.kind).chain(names).collect::<Vec<_>>().join(" ")
}

/// Whether two candidates are the same parameters of the same effect at the same place.
fn is_one(a: &Instance, b: &Instance) -> bool {
    a.is_same(b) && a.is_alike(b)
}

/// Whether two sets hold the same effects in any order.
pub fn is_same_set(one: &[Instance], other: &[Instance]) -> bool {
    one.len() == other.len() && one.iter().all(|a| other.iter().any(|b| is_one(a, b)))
}
