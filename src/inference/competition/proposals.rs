//! Which candidates are worth a fit beside a model: each at every place, alone and in pairs, by the linear problem around that model.

use super::{Competition, HEATS, Look, TOLD};
use crate::effects::{self, Instance};
use crate::inference::algebra::{self, Quadratic};
use crate::inference::forward::Prediction;
use crate::inference::parameters::{Model, prior_of};
use crate::inference::posterior::{Fit, Fitter, Start, combined, gradient, square};
use crate::inference::weights::{Rows, line_hz};
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
/// Places to either side of a line, within the resolution of the records, at which a frequency is tried.
const LINE_STEPS: i32 = 4;
/// Farthest along a direction, in that of its node.
const FARTHEST: f64 = 1.4;

/// A candidate at one strength.
#[derive(Clone)]
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
    /// Effect of the model whose place they take.
    pub instead_of: Option<usize>,
    /// Coordinates of the model beside them.
    beside: Vec<f64>,
    /// ln of their posterior up to a constant.
    pub log_posterior: f64,
}

impl<'a> Competition<'a> {
    /// The model of `base` with what is proposed, and the coordinates of `base` that are still in it.
    fn model_with(base: &Fit<'a>, set: &Proposal) -> (Model<'a>, Vec<usize>) {
        let left_out = set.instead_of.map_or(0..0, |i| base.model.coordinates_of(i));
        let mut model = base.model.clone();
        set.instead_of.map(|i| model.effects.remove(i));
        model.effects.extend(set.parts.iter().map(|part| part.instance.clone()));
        (model, (0..base.x.len()).filter(|i| !left_out.contains(i)).collect())
    }

    /// Where to start a fit of what takes the place of an effect of `base`: from what is declared, for what stood in for one effect leads
    /// away from the other.
    pub(super) fn from_declared(base: &Fit<'a>, set: Proposal) -> Start<'a> {
        let (model, kept) = Self::model_with(base, &set);
        let declared = base.model.declared.len();
        let mut x: Vec<f64> = kept.iter().map(|i| if *i < declared { 0.0 } else { base.x[*i] }).collect();
        set.parts.iter().for_each(|part| x.extend(part.instance.zero().unwrap_or_else(|| part.start.clone())));
        Start::at(model, x)
    }

    /// The model of `base` with what is proposed, where to start its fit and the slopes that are known there: where the linear problem puts
    /// it, or on the way there, as far as the column agrees.
    pub(super) fn started(by: &Fitter<'a>, base: &Fit<'a>, set: Proposal) -> Start<'a> {
        let (model, kept) = Self::model_with(base, &set);
        let at = |share: f64| {
            let mut x: Vec<f64> = kept.iter().map(|i| base.x[*i] + share * (set.beside[*i] - base.x[*i])).collect();
            set.parts.iter().for_each(|part| x.extend(&part.start));
            x.iter_mut().zip(model.bounds()).for_each(|(x, [low, high])| *x = x.clamp(low, high));
            x
        };
        let cost = |x: &Vec<f64>| {
            let found = by.predict(&model, x);
            found.map_or(f64::INFINITY, |p| by.nll(&p) + Fitter::prior(&model, x))
        };
        let all = [at(1.0), at(0.5), at(0.0)];
        let costs = [cost(&all[0]), cost(&all[1]), cost(&all[2])];
        let best = (0..all.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0);
        let x = all.into_iter().nth(best).unwrap_or_default();
        let slopes =
            kept.iter().map(|i| Some(base.slopes[*i].clone())).chain(set.parts.into_iter().flat_map(|p| p.slopes));
        Start { slopes: slopes.collect(), ..Start::at(model, x) }
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

    /// All candidates beside `base`: singles, pairs of the best, and each in the place of an effect that is there.
    pub(super) fn proposals(&self, by: &Fitter<'a>, base: &Fit<'a>, look: Look) -> Vec<Proposal> {
        let is_far = look == Look::Far;
        let lacking: Vec<Instance> =
            self.instances.iter().filter(|i| !base.model.effects.iter().any(|e| e.is_one(i))).cloned().collect();
        let is_smooth = |i: &Instance| i.zero().is_some() && i.hidden() == 0;
        let (smooth, discrete): (Vec<Instance>, Vec<Instance>) = lacking.into_iter().partition(is_smooth);
        let mut proposals: Vec<Proposal> = Self::nodes(&discrete, NODES[0], false)
            .into_iter()
            .filter_map(|node| self.discrete(by, base, Self::at_line(by, base, node)))
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
        let Some(beside) = Linear::new(by, base, &all, None) else { return proposals };
        let singles = self.singles(&beside);
        let n_effect = base.model.effects.len();
        if n_effect + 2 <= self.max_effects {
            proposals.extend(self.pairs(&beside, &singles));
        }
        if n_effect < self.max_effects {
            proposals.extend(singles.into_iter().map(|(_, single)| single));
        }
        let replaceable = if look == Look::AtRivals { 0..n_effect } else { 0..0 };
        for linear in replaceable.filter_map(|i| Linear::new(by, base, &all, Some(i))) {
            proposals.extend(self.singles(&linear).into_iter().map(|(_, single)| single));
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

    /// `node` where the residuals of `base` stand out most, if it is a line: away from its frequency nothing tells of it.
    fn at_line(by: &Fitter<'a>, base: &Fit<'a>, mut node: Node) -> Node {
        let Some(index) = node.instance.line() else { return node };
        let Some((line_hz, width_hz)) = line_hz(by.forward, &base.rows) else { return node };
        let parameter = node.instance.free[index].parameter;
        let [low, high] = parameter.bounds();
        let mut lowest = f64::INFINITY;
        for step in -LINE_STEPS..=LINE_STEPS {
            let mut there = node.clone();
            there.at[index] =
                parameter.coordinate(line_hz + width_hz * f64::from(step) / f64::from(LINE_STEPS)).clamp(low, high);
            let cost = Self::predicted(by, base, &there).map_or(f64::INFINITY, |p| by.nll(&p));
            if cost < lowest {
                (lowest, node) = (cost, there);
            }
        }
        node
    }

    /// A candidate that is either there or not, or that takes numbers from the records.
    fn discrete(&self, by: &Fitter<'a>, base: &Fit<'a>, node: Node) -> Option<Proposal> {
        let there = Self::predicted(by, base, &node)?;
        let cost = by.nll(&there) + Fitter::prior(&base.model, &base.x);
        let log_posterior = self.log_posterior(base) + base.cost - cost + self.prior_of(&node.instance);
        let slopes = vec![None; node.at.len()];
        let part = Part { instance: node.instance, start: node.at, slopes };
        Some(Proposal { parts: vec![part], instead_of: None, beside: base.x.clone(), log_posterior })
    }

    /// Further nodes of candidates worth another look, the best places of each form, on the side of nothing to which they point.
    fn further(&self, by: &Fitter<'a>, base: &Fit<'a>, directions: &[Direction]) -> Vec<Node> {
        let mut forms: BTreeMap<String, usize> = BTreeMap::new();
        let mut nodes: Vec<Node> = Vec::new();
        let mut found = 0;
        let Some(linear) = Linear::new(by, base, directions, None) else { return nodes };
        for (_, single) in self.singles(&linear) {
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

    /// Each candidate at its best node by the linear problem, best first, and the direction that it is.
    fn singles(&self, linear: &Linear<'_, 'a>) -> Vec<(usize, Proposal)> {
        let instance = |i: usize| &linear.directions[i].node.instance;
        let mut best: Vec<(usize, Proposal)> = Vec::new();
        for i in 0..linear.directions.len() {
            let Some(found) = self.proposal(linear, &[i]) else { continue };
            match best.iter_mut().find(|(k, _)| instance(*k) == instance(i)) {
                Some((_, known)) if known.log_posterior >= found.log_posterior => {}
                Some(known) => *known = (i, found),
                None => best.push((i, found)),
            }
        }
        best.sort_by(|(_, a), (_, b)| b.log_posterior.total_cmp(&a.log_posterior));
        best
    }

    /// Pairs of the best of `singles`, best first.
    fn pairs(&self, linear: &Linear<'_, 'a>, singles: &[(usize, Proposal)]) -> Vec<Proposal> {
        let shortlist: Vec<usize> = singles.iter().take(SHORTLIST).map(|(i, _)| *i).collect();
        let after = |k: usize| shortlist[k + 1..].iter().map(move |other| (k, *other));
        let all = (0..shortlist.len()).flat_map(after);
        let mut pairs: Vec<Proposal> = all.filter_map(|(k, o)| self.proposal(linear, &[shortlist[k], o])).collect();
        pairs.sort_by(|a, b| b.log_posterior.total_cmp(&a.log_posterior));
        pairs.truncate(SHORTLIST);
        pairs
    }

    /// A `set` of directions with the prior of all effects.
    fn proposal(&self, linear: &Linear<'_, 'a>, set: &[usize]) -> Option<Proposal> {
        let mut proposal = linear.proposal(set)?;
        let there = linear.base.model.effects.iter().enumerate().filter(|(i, _)| Some(*i) != linear.instead_of);
        let effects = there.map(|(_, e)| e).chain(proposal.parts.iter().map(|p| &p.instance));
        proposal.log_posterior += effects.map(|e| self.prior_of(e)).sum::<f64>();
        Some(proposal)
    }
}

/// The linear problem of some directions around a point, in which the coordinates of its model give way within their ranges.
struct Linear<'c, 'a> {
    base: &'c Fit<'a>,
    directions: &'c [Direction],
    /// Effect of the model that is taken back to nothing.
    instead_of: Option<usize>,
    /// ln of the density over what is there: coordinates, then directions in units of their nodes.
    density: Quadratic,
    /// Information on the directions where the coordinates have given way.
    left: Mat<f64>,
    /// ln of the share of the prior of the coordinates that the records leave.
    occam: f64,
}

impl<'c, 'a> Linear<'c, 'a> {
    /// None where effect `instead_of` cannot be taken back to nothing along its coordinates, or the linear problem has no solution.
    fn new(by: &Fitter<'a>, base: &'c Fit<'a>, directions: &'c [Direction], instead_of: Option<usize>) -> Option<Self> {
        let (n, count) = (base.x.len(), directions.len());
        let slopes: Vec<Arc<Rows>> =
            base.slopes.iter().cloned().chain(directions.iter().map(|d| Arc::new(d.change.clone()))).collect();
        let own = by.normal(&slopes, &base.rows);
        // The unit of a direction is its node.
        let deviations = base.model.prior().into_iter().map(|[_, sd]| sd);
        let size: Vec<f64> = deviations.chain(directions.iter().map(|d| 1.0 / d.node.distance)).collect();
        let a = |i: usize, j: usize| own[(i, j)] + if i == j { size[i].powi(-2) } else { 0.0 };
        let mut gradient = gradient(&base.model, &base.x, &own);
        gradient.extend((n..n + count).map(|i| own[(i, n + count)]));
        let mut bounds: Vec<[f64; 2]> =
            base.model.bounds().into_iter().zip(&base.x).map(|([low, high], x)| [low - x, high - x]).collect();
        if let Some(index) = instead_of {
            let zero = base.model.effects[index].zero()?;
            base.model.coordinates_of(index).zip(zero).for_each(|(i, zero)| bounds[i] = [zero - base.x[i]; 2]);
        }
        let far = directions.iter().map(|d| [if d.node.is_one_sided { 0.0 } else { -FARTHEST }, FARTHEST]);
        bounds.extend(far);
        let density = Quadratic { a: Mat::from_fn(n + count, n + count, a), gradient, bounds, size };
        // What stands at an end of its range does not give way.
        let (moved, _) = density.of(&(0..n).collect::<Vec<_>>()).highest(f64::INFINITY)?;
        let beside: Vec<usize> = (0..n).filter(|i| !density.bounds[*i].contains(&moved[*i])).collect();
        let kept = [&beside[..], &(n..n + count).collect::<Vec<_>>()].concat();
        let precision: Vec<f64> = beside.iter().map(|i| density.size[*i].powi(-2)).collect();
        let own = Mat::from_fn(kept.len(), kept.len(), |i, j| own[(kept[i], kept[j])]);
        let left = algebra::without(&own, &(0..beside.len()).collect::<Vec<_>>(), &precision)?;
        let information = algebra::ln_determinant(&density.of(&beside).a)?;
        let occam = -0.5 * (information - precision.iter().map(|p| p.ln()).sum::<f64>());
        Some(Self { base, directions, instead_of, density, left, occam })
    }

    /// A `set` of directions as far as the records lead, the coordinates where they give way to that; `None` where the directions are one.
    ///
    /// ```text
    /// ln p = −cost + max − ½ ln det(I + Λ⁻¹ A) − ½ ln det(I + E⁻¹ L)          (1)
    /// ```
    ///
    /// A and Λ are what the records and the prior know of the coordinates, L and E of the directions beside these.
    fn proposal(&self, set: &[usize]) -> Option<Proposal> {
        let (n, k) = (self.base.x.len(), set.len());
        let unknowns: Vec<usize> = (0..n).chain(set.iter().map(|i| n + i)).collect();
        let (moved, gain) = self.density.of(&unknowns).highest(f64::INFINITY)?;
        let distance = |i: usize| self.directions[set[i]].node.distance;
        let told = |i: usize, j: usize| self.left[(set[i], set[j])] / (distance(i) * distance(j));
        let whole = Mat::from_fn(k, k, |i, j| told(i, j) + f64::from(u8::from(i == j)));
        let parts = set.iter().zip(&moved[n..]).map(|(i, share)| self.directions[*i].part(*share));
        Some(Proposal {
            parts: parts.collect(),
            instead_of: self.instead_of,
            beside: self.base.x.iter().zip(&moved).map(|(x, d)| x + d).collect(),
            log_posterior: gain + self.occam - 0.5 * algebra::ln_determinant(&whole)? - self.base.cost,
        })
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

/// Of proposals in the place of an effect of `model`, best first, those that the catalogue knows to be confused with it and its own other
/// places: the best places of each form.
pub(super) fn rivals(model: &Model<'_>, proposals: Vec<Proposal>) -> Vec<Proposal> {
    let mut forms: BTreeMap<(Option<usize>, String), usize> = BTreeMap::new();
    let is_rival = |p: &Proposal| {
        let there = p.instead_of.map(|i| model.effects[i].kind);
        let confused = there.and_then(|kind| effects::find(kind).ok()).map_or(&[][..], |e| e.catalogue.confused_with);
        let kind = p.parts[0].instance.kind;
        there == Some(kind) || confused.contains(&kind)
    };
    let mut is_among_best = |p: &Proposal| {
        let count = forms.entry((p.instead_of, form(&p.parts[0].instance))).or_default();
        *count += 1;
        *count <= PLACES
    };
    proposals.into_iter().filter(is_rival).filter(|p| is_among_best(p)).collect()
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
