//! Which candidates are worth a fit beside a model: each at every place, alone and in pairs, by the linear problem around that model.

use super::{Competition, HEATS, TOLD};
use crate::effects::Instance;
use crate::inference::algebra;
use crate::inference::forward::{Forward, Prediction};
use crate::inference::parameters::{Model, prior_of};
use crate::inference::posterior::{Fit, Fitter, combined, gradient, square};
use crate::inference::weights::Rows;
use faer::Mat;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Candidates that are replayed at further strengths, pairs of which are looked at, and places of one form among them.
const SHORTLIST: usize = 12;
const PLACES: usize = 3;
/// Strengths at which candidates are tried, in typical sizes: all of them, and those worth another look.
pub(super) const NODES: [f64; 2] = [0.6, 1.8];
/// The same for the slope at nothing: what is well told by the records may lack little, and is not linear up to a typical size.
const SLIGHT: f64 = 0.05;
/// How much stronger a candidate is tried that does nothing the records could tell, and how often: some need a motion of some strength.
const STRONGER: f64 = 3.0;
const STRONGER_TIMES: usize = 2;
/// Farthest along a direction, in that of its node.
const FARTHEST: f64 = 1.4;

/// A candidate at one strength.
struct Node {
    instance: Instance,
    /// Coordinates of its parameters there.
    at: Vec<f64>,
    /// Strength there over the deviation of its prior.
    distance: f64,
    /// Whether what lies beyond nothing is no effect, or another node's.
    is_one_sided: bool,
}

/// A candidate's node and how the residuals of a point change towards it.
struct Direction {
    node: Node,
    change: Rows,
}

/// An effect of a proposal.
pub(super) struct Part {
    pub instance: Instance,
    /// Coordinates to start from.
    start: Vec<f64>,
    /// Slopes along them, as far as they are known.
    pub slopes: Vec<Option<Arc<Rows>>>,
}

/// Candidates that are worth a fit.
pub(super) struct Proposal {
    pub parts: Vec<Part>,
    /// Coordinates of the model beside them.
    beside: Vec<f64>,
    /// ln of their posterior up to a constant.
    pub log_posterior: f64,
}

impl<'a> Competition<'a> {
    /// Where to start a fit of `set` beside the point `base`: where the linear problem puts it, or on the way there, as far as the
    /// column agrees.
    pub(super) fn started(by: &Fitter<'a>, base: &Fit<'a>, model: &Model<'a>, set: &Proposal) -> Vec<f64> {
        let at = |share: f64| {
            let mut x: Vec<f64> = base.x.iter().zip(&set.beside).map(|(x, to)| x + share * (to - x)).collect();
            set.parts.iter().for_each(|part| x.extend(&part.start));
            x.iter_mut().zip(model.bounds()).for_each(|(x, [low, high])| *x = x.clamp(low, high));
            x
        };
        let cost = |x: &Vec<f64>| {
            let found = by.predict(model, x);
            found.map_or(f64::INFINITY, |p| by.nll(&p) + Fitter::prior(model, x))
        };
        let all = [at(1.0), at(0.5), at(0.0)];
        let costs = [cost(&all[0]), cost(&all[1]), cost(&all[2])];
        let best = (0..all.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0);
        all.into_iter().nth(best).unwrap_or_default()
    }

    /// Candidates at a strength of this many typical sizes, on one side of nothing or on each.
    fn nodes(instances: &[Instance], size: f64, on_each_side: bool) -> Vec<Node> {
        let mut nodes: Vec<Node> = Vec::new();
        for instance in instances {
            let Some(zero) = instance.zero() else {
                nodes.push(Node { instance: instance.clone(), at: Vec::new(), distance: 1.0, is_one_sided: true });
                continue;
            };
            let sides: Vec<Vec<f64>> = [1.0, -1.0].iter().filter_map(|s| away(instance, &zero, size, *s)).collect();
            let is_one_sided = on_each_side || sides.len() == 1;
            for at in sides.into_iter().take(if on_each_side { 2 } else { 1 }) {
                let square = |i: usize| ((at[i] - zero[i]) / prior_of(&instance.free[i])[1]).powi(2);
                let strengths = (0..zero.len()).filter(|i| instance.free[*i].zero.is_some());
                let distance = strengths.map(square).sum::<f64>().sqrt();
                nodes.push(Node { instance: instance.clone(), at, distance, is_one_sided });
            }
        }
        nodes
    }

    /// All candidates beside `base`: singles, and pairs of the best.
    pub(super) fn proposals(&self, by: &Fitter<'a>, base: &Fit<'a>, is_far: bool) -> Vec<Proposal> {
        let lacking: Vec<Instance> =
            self.instances.iter().filter(|i| !base.model.effects.iter().any(|e| e.is_one(i))).cloned().collect();
        let is_smooth = |i: &Instance| i.zero().is_some() && !Forward::is_interference(i);
        let (smooth, discrete): (Vec<Instance>, Vec<Instance>) = lacking.into_iter().partition(is_smooth);
        let mut proposals: Vec<Proposal> = Self::nodes(&discrete, NODES[0], false)
            .into_iter()
            .filter_map(|node| self.discrete(by, base, node))
            .collect();
        let along = |nodes: Vec<Node>| nodes.into_iter().filter_map(|n| Self::direction(by, base, n)).collect();
        // Where something strong is missing, what is linear beside a model that lacks it says little of places: each is looked at where
        // it would be strong. Elsewhere what is promising is, for a strong effect is not linear.
        // Further nodes are multiples of these, which come first.
        let nodes = Self::nodes(&smooth, NODES[usize::from(is_far)], is_far);
        let mut all: Vec<Direction> = nodes.into_iter().filter_map(|n| Self::told(by, base, n)).collect();
        if !is_far {
            all.extend::<Vec<Direction>>(along(Self::nodes(&smooth, SLIGHT, false)));
            let further = self.further(by, base, &all);
            all.extend::<Vec<Direction>>(along(further));
        }
        let (singles, pairs) = self.linear(by, base, &all);
        proposals.extend(singles);
        if base.model.effects.len() + 2 <= self.max_effects {
            proposals.extend(pairs);
        }
        proposals
    }

    /// What the model of `base` predicts with a node besides.
    fn predicted(by: &Fitter<'a>, base: &Fit<'a>, node: &Node) -> Option<Arc<Prediction>> {
        let mut model = base.model.clone();
        model.effects.push(node.instance.clone());
        let x: Vec<f64> = base.x.iter().chain(&node.at).copied().collect();
        by.predict(&model, &x).ok()
    }

    /// How the residuals of `base` change towards a node.
    fn direction(by: &Fitter<'a>, base: &Fit<'a>, node: Node) -> Option<Direction> {
        let there = Self::predicted(by, base, &node)?;
        let change = combined(&by.rows(&there).0, &base.rows, 1.0, -1.0);
        Some(Direction { node, change })
    }

    /// [`Self::direction`] towards the node, or towards one so strong that the records tell what it does.
    fn told(by: &Fitter<'a>, base: &Fit<'a>, node: Node) -> Option<Direction> {
        let mut found = Self::direction(by, base, node)?;
        for _ in 0..STRONGER_TIMES {
            if 0.5 * square(&found.change) > TOLD {
                break;
            }
            let Some(stronger) = Self::direction(by, base, found.node.times(STRONGER)) else { break };
            found = stronger;
        }
        Some(found)
    }

    /// A candidate that is either there or not, or that changes the records themselves.
    fn discrete(&self, by: &Fitter<'a>, base: &Fit<'a>, node: Node) -> Option<Proposal> {
        let there = Self::predicted(by, base, &node)?;
        let cost = by.nll(&there) + Fitter::prior(&base.model, &base.x);
        let log_posterior = self.prior_of(&node.instance) - cost;
        let slopes = vec![None; node.at.len()];
        let part = Part { instance: node.instance, start: node.at, slopes };
        Some(Proposal { parts: vec![part], beside: base.x.clone(), log_posterior })
    }

    /// Further nodes of candidates worth another look, the best places of each form, on the side of nothing to which they point.
    fn further(&self, by: &Fitter<'a>, base: &Fit<'a>, directions: &[Direction]) -> Vec<Node> {
        let mut forms: BTreeMap<String, usize> = BTreeMap::new();
        let mut nodes: Vec<Node> = Vec::new();
        let mut found = 0;
        for single in self.linear(by, base, directions).0 {
            let Part { instance, start: toward, .. } = &single.parts[0];
            let count = forms.entry(form(instance)).or_default();
            *count += 1;
            if *count > PLACES || found == SHORTLIST {
                continue;
            }
            found += 1;
            let Some(known) = directions.iter().find(|d| d.node.instance == *instance) else { continue };
            let zero = instance.zero().unwrap_or_default();
            let is_opposite = zero.iter().zip(toward).zip(&known.node.at).any(|((z, t), at)| (t - z) * (at - z) < 0.0);
            let strengths = if is_opposite { vec![-NODES[0], -NODES[1]] } else { vec![NODES[1]] };
            for strength in strengths {
                nodes.push(Node { is_one_sided: true, ..known.node.times(strength / NODES[0]) });
            }
        }
        nodes
    }

    /// Each candidate at its best node by the linear problem around `base`, best first, and pairs of the best of these.
    fn linear(&self, by: &Fitter<'a>, base: &Fit<'a>, directions: &[Direction]) -> (Vec<Proposal>, Vec<Proposal>) {
        let Some(problem) = Linear::new(by, base, directions) else { return (Vec::new(), Vec::new()) };
        let place = |i: usize| self.prior_of(&directions[i].node.instance);
        let mut best: Vec<(usize, f64, f64)> = Vec::new();
        for (i, direction) in directions.iter().enumerate() {
            let (share, gain) = problem.single(i);
            let log_posterior = problem.level + gain + place(i);
            match best.iter_mut().find(|b| directions[b.0].node.instance == direction.node.instance) {
                Some(known) if known.2 >= log_posterior => {}
                Some(known) => *known = (i, share, log_posterior),
                None => best.push((i, share, log_posterior)),
            }
        }
        best.sort_by(|a, b| b.2.total_cmp(&a.2));
        let singles = best.iter().map(|(i, share, value)| problem.proposal(&[(*i, *share)], *value)).collect();
        let mut pairs: Vec<([(usize, f64); 2], f64)> = Vec::new();
        for (k, one) in best.iter().enumerate().take(SHORTLIST) {
            for other in best.iter().take(SHORTLIST).skip(k + 1) {
                let [p, q] = [one.0, other.0];
                let Some((shares, gain)) = problem.pair(p, q) else { continue };
                pairs.push(([(p, shares[0]), (q, shares[1])], problem.level + gain + place(p) + place(q)));
            }
        }
        pairs.sort_by(|a, b| b.1.total_cmp(&a.1));
        let pairs = pairs.into_iter().take(SHORTLIST).map(|(set, value)| problem.proposal(&set, value)).collect();
        (singles, pairs)
    }
}

/// The linear problem of some directions around a point, in which the coordinates of its model give way.
struct Linear<'c, 'a> {
    base: &'c Fit<'a>,
    directions: &'c [Direction],
    /// Normal equations of coordinates and directions, the pull of the prior in the right-hand side.
    own: Mat<f64>,
    /// Those of the directions where the coordinates have given way.
    left: Mat<f64>,
    precision: Vec<f64>,
    /// ln of the density of the point where its coordinates have given way to nothing: that is no merit of a candidate.
    level: f64,
}

impl<'c, 'a> Linear<'c, 'a> {
    fn new(by: &Fitter<'a>, base: &'c Fit<'a>, directions: &'c [Direction]) -> Option<Self> {
        let n = base.x.len();
        let slopes: Vec<Arc<Rows>> =
            base.slopes.iter().cloned().chain(directions.iter().map(|d| Arc::new(d.change.clone()))).collect();
        let mut own = by.normal(&slopes, &base.rows);
        let precision: Vec<f64> = base.model.prior().iter().map(|[_, sd]| 1.0 / (sd * sd)).collect();
        let side = own.nrows() - 1;
        let pushed = base.pushed(&own);
        for (i, slope) in gradient(&base.model, &base.x, &own).into_iter().enumerate() {
            (own[(i, side)], own[(side, i)]) = (slope, slope);
        }
        // What the records push against an end of its range does not give way.
        for i in pushed {
            (0..=side).for_each(|j| (own[(i, j)], own[(j, i)]) = (0.0, 0.0));
        }
        let beside: Vec<usize> = (0..n).collect();
        let left = algebra::without(&own, &beside, &precision)?;
        let last = left.nrows() - 1;
        let level = -(base.cost - 0.5 * (own[(side, side)] - left[(last, last)]));
        Some(Self { base, directions, own, left, precision, level })
    }

    /// Precision of the prior of direction `i`, whose unit is its node.
    fn evidence(&self, i: usize) -> f64 {
        self.directions[i].node.distance.powi(2)
    }

    /// How far along direction `i` the records lead.
    fn toward(&self, i: usize) -> f64 {
        self.left[(i, self.left.nrows() - 1)]
    }

    fn held(&self, i: usize, share: f64) -> f64 {
        share.clamp(if self.directions[i].node.is_one_sided { 0.0 } else { -FARTHEST }, FARTHEST)
    }

    /// Best share of direction `i`, and what that gains in ln of the evidence.
    fn single(&self, i: usize) -> (f64, f64) {
        let total = self.left[(i, i)] + self.evidence(i);
        let share = self.held(i, self.toward(i) / total);
        let gain = self.toward(i) * share - 0.5 * total * share * share - 0.5 * (total / self.evidence(i)).ln();
        (share, gain)
    }

    /// The same of two directions; `None` where they are one.
    fn pair(&self, p: usize, q: usize) -> Option<([f64; 2], f64)> {
        let (a, d) = (self.left[(p, p)] + self.evidence(p), self.left[(q, q)] + self.evidence(q));
        let (c, e, f) = (self.left[(p, q)], self.toward(p), self.toward(q));
        let determinant = a * d - c * c;
        if determinant <= 1e-9 * a * d {
            return None;
        }
        let [x, y] = [self.held(p, (d * e - c * f) / determinant), self.held(q, (a * f - c * e) / determinant)];
        let gain = e * x + f * y
            - 0.5 * (a * x * x + d * y * y)
            - c * x * y
            - 0.5 * (determinant / (self.evidence(p) * self.evidence(q))).ln();
        Some(([x, y], gain))
    }

    /// Shares of directions as a proposal, the coordinates where they give way to these.
    fn proposal(&self, set: &[(usize, f64)], log_posterior: f64) -> Proposal {
        let (n, side) = (self.base.x.len(), self.own.nrows() - 1);
        let against = |i: usize| set.iter().map(|(d, share)| self.own[(i, n + d)] * share).sum::<f64>();
        let right: Vec<f64> = (0..n).map(|i| self.own[(i, side)] - against(i)).collect();
        let whole = Mat::from_fn(n, n, |i, j| self.own[(i, j)] + if i == j { self.precision[i] } else { 0.0 });
        let moved = algebra::solved(&whole, &right).unwrap_or_else(|| vec![0.0; n]);
        Proposal {
            parts: set.iter().map(|(d, share)| self.directions[*d].part(*share)).collect(),
            beside: self.base.x.iter().zip(moved).map(|(x, d)| x + d).collect(),
            log_posterior,
        }
    }
}

impl Node {
    /// The same so many times as far from nothing, as far as its range goes.
    fn times(&self, ratio: f64) -> Self {
        let zero = self.instance.zero().unwrap_or_default();
        let at = zero.iter().zip(&self.at).map(|(z, at)| z + (at - z) * ratio);
        let at = at.zip(self.instance.bounds()).map(|(x, [low, high])| x.clamp(low, high)).collect();
        Self { at, distance: self.distance * ratio.abs(), instance: self.instance.clone(), ..*self }
    }
}

impl Direction {
    /// The candidate at this share of its node.
    fn part(&self, share: f64) -> Part {
        let Self { node, change } = self;
        let zero = node.instance.zero().unwrap_or_default();
        let at = zero.iter().zip(&node.at).map(|(a, b)| a + share * (b - a));
        let start = at.zip(node.instance.bounds()).map(|(x, [low, high])| x.clamp(low, high)).collect();
        // Along the one coordinate that differs at the node.
        let along = |(a, b): (&f64, &f64)| (a != b).then(|| Arc::new(combined(change, change, 1.0 / (b - a), 0.0)));
        Part { instance: node.instance.clone(), start, slopes: zero.iter().zip(&node.at).map(along).collect() }
    }
}

/// Coordinates of `instance` with its first strength `size` typical sizes away from nothing; `None` where there is no such side.
pub(super) fn away(instance: &Instance, zero: &[f64], size: f64, sign: f64) -> Option<Vec<f64>> {
    let first = instance.free.iter().position(|f| f.zero.is_some())?;
    let [low, high] = instance.bounds()[first];
    let step = size * instance.free[first].size;
    let at = (zero[first] + sign * step).clamp(low, high);
    let mut all = zero.to_vec();
    all[first] = at;
    ((at - zero[first]).abs() > 1e-3 * step).then_some(all)
}

/// The best place of each set of forms.
pub(super) fn distinct(proposals: Vec<Proposal>) -> Vec<Proposal> {
    let mut known: Vec<Vec<String>> = Vec::new();
    let mut sets = Vec::new();
    for proposal in proposals {
        let mut forms: Vec<String> = proposal.parts.iter().map(|p| form(&p.instance)).collect();
        forms.sort_unstable();
        if sets.len() < HEATS && !known.contains(&forms) {
            known.push(forms);
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
