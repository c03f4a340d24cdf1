//! Which candidates are worth a fit beside a model: each at every place, alone and in pairs, by the linear problem around that model.

use super::{Competition, HEATS, TOLD};
use crate::effects::Instance;
use crate::inference::algebra::{self, Quadratic};
use crate::inference::parameters::prior_of;
use crate::inference::posterior::{Fit, Fitter, Slope, Start, combined, dot, gradient, rows_of, square};
use crate::inference::weights::{Rows, lines_hz};
use crate::numerics::threads::on_threads;
use faer::Mat;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Candidates that are replayed at further strengths, pairs of which are looked at, and places of one form among them.
pub(super) const SHORTLIST: usize = 12;
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
/// Places to either side of a delay, up to halfway to the next that a fit starts from, at which it is tried.
const DELAY_STEPS: i32 = 5;
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
pub(super) struct Direction {
    node: Node,
    pub change: Arc<Rows>,
}

/// An effect of a proposal.
#[derive(Clone)]
pub(super) struct Part {
    pub instance: Instance,
    /// Coordinates to start from.
    start: Vec<f64>,
    /// Coordinates of the node that the linear problem took it along, and how residuals change towards that.
    along: Option<(Vec<f64>, Arc<Rows>)>,
}

impl Part {
    /// Slopes of its coordinates as far as they are known: along the one that differs at its node.
    fn slopes(&self) -> Vec<Option<Slope>> {
        let zero = self.instance.zero().unwrap_or_default();
        let Some((at, change)) = &self.along else { return vec![None; self.start.len()] };
        let of = |(a, b): (&f64, &f64)| (a != b).then(|| Slope::new(combined(change, change, 1.0 / (b - a), 0.0)));
        zero.iter().zip(at).map(of).collect()
    }
}

/// Candidates that are worth a fit.
#[derive(Clone)]
pub(super) struct Proposal {
    pub parts: Vec<Part>,
    /// Coordinates of the model beside them.
    beside: Vec<f64>,
    /// ln of their posterior up to a constant.
    pub log_posterior: f64,
}

impl<'a> Competition<'a> {
    /// The model of `base` with what is proposed, where to start its fit and the slopes that are known there: where the linear problem puts
    /// it, or on the way there, as far as the column agrees.
    pub(super) fn started(by: &Fitter<'a>, base: &Fit<'a>, set: &Proposal) -> Start<'a> {
        let mut model = base.model.clone();
        model.effects.extend(set.parts.iter().map(|part| part.instance.clone()));
        let at = |share: f64| {
            let mut x: Vec<f64> = base.x.iter().zip(&set.beside).map(|(x, to)| x + share * (to - x)).collect();
            set.parts.iter().for_each(|part| x.extend(&part.start));
            x.iter_mut().zip(model.bounds()).for_each(|(x, [low, high])| *x = x.clamp(low, high));
            x
        };
        let cost = |x: &Vec<f64>| by.cost_at(&model, x.clone()).unwrap_or(f64::INFINITY);
        let all = [at(1.0), at(0.5), at(0.0)];
        let costs = [cost(&all[0]), cost(&all[1]), cost(&all[2])];
        let best = (0..all.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).unwrap_or(0);
        let x = all.into_iter().nth(best).unwrap_or_default();
        let slopes = base.slopes.iter().cloned().map(Some).chain(set.parts.iter().flat_map(Part::slopes));
        Start::at(model, x).carrying(slopes)
    }

    /// Candidates at a strength of this many typical sizes, on one side of nothing.
    fn nodes(instances: &[Instance], size: f64) -> Vec<Node> {
        let mut nodes: Vec<Node> = Vec::new();
        for instance in instances {
            let Some(zero) = instance.zero() else {
                nodes.push(Node { instance: instance.clone(), at: Vec::new(), distance: 1.0, is_one_sided: true });
                continue;
            };
            let sides: Vec<Vec<f64>> = [1.0, -1.0].iter().filter_map(|s| away(instance, &zero, size, *s)).collect();
            let is_one_sided = sides.len() == 1;
            if let Some(at) = sides.into_iter().next() {
                let square = |i: usize| ((at[i] - zero[i]) / prior_of(&instance.free[i])[1]).powi(2);
                let strengths = (0..zero.len()).filter(|i| instance.free[*i].zero.is_some());
                let distance = strengths.map(square).sum::<f64>().sqrt();
                nodes.push(Node { instance: instance.clone(), at, distance, is_one_sided });
            }
        }
        nodes
    }

    /// Candidates that `base` lacks: those of which the linear problem says something, and those that are there or not or take numbers from
    /// the records.
    fn lacking(&self, base: &Fit<'a>) -> [Vec<Instance>; 2] {
        let lacking = self.instances.iter().filter(|i| base.model.index_of(i).is_none());
        let (smooth, discrete): (Vec<&Instance>, Vec<&Instance>) = lacking.partition(|i| is_linear(i));
        [smooth, discrete].map(|all| all.into_iter().cloned().collect())
    }

    /// How residuals change towards each candidate that `base` lacks and the linear problem says something of.
    pub(super) fn directions(&self, by: &Fitter<'a>, base: &Fit<'a>) -> Vec<Direction> {
        if base.model.effects.len() >= self.max_effects {
            return Vec::new();
        }
        let [smooth, _] = self.lacking(base);
        let smooth = on_threads(smooth.len(), |i| Self::at_delay(by, base, smooth[i].clone()));
        let told = |nodes: &[Node]| -> Vec<Direction> {
            on_threads(nodes.len(), |i| Self::told(by, base, nodes[i].clone())).into_iter().flatten().collect()
        };
        // Further nodes are multiples of these, which come first.
        let mut all = told(&Self::nodes(&smooth, NODES[0]));
        let again = told(&self.shortlist(by, base, &all));
        all.retain(|d| !again.iter().any(|n| n.node.instance == d.node.instance));
        all.extend(again);
        let slight = Self::nodes(&smooth, SLIGHT);
        let slight = on_threads(slight.len(), |i| Self::direction(by, base, slight[i].clone()));
        all.extend(slight.into_iter().flatten());
        all
    }

    /// All candidates beside `base`, and pairs of the best, by the `linear` problem there.
    pub(super) fn proposals(&self, by: &Fitter<'a>, base: &Fit<'a>, linear: Option<&Linear<'_, 'a>>) -> Vec<Proposal> {
        let n_open = self.max_effects.saturating_sub(base.model.effects.len());
        if n_open == 0 {
            return Vec::new();
        }
        let [_, discrete] = self.lacking(base);
        let discrete = Self::nodes(&discrete, NODES[0]);
        let discrete =
            on_threads(discrete.len(), |i| self.discrete(by, base, Self::at_line(by, base, discrete[i].clone())));
        let mut proposals: Vec<Proposal> = discrete.into_iter().flatten().collect();
        let Some(beside) = linear else { return proposals };
        let singles = self.singles(beside);
        if n_open > 1 {
            proposals.extend(self.pairs(beside, &singles));
        }
        proposals.extend(singles.into_iter().map(|(_, single)| single));
        proposals
    }

    /// ln of the prior of the effect along each direction.
    pub(super) fn ln_priors(&self, linear: &Linear<'_, 'a>) -> Vec<f64> {
        linear.directions.iter().map(|d| self.prior_of(&d.node.instance)).collect()
    }

    /// How the residuals of `base` change towards a node.
    fn direction(by: &Fitter<'a>, base: &Fit<'a>, node: Node) -> Option<Direction> {
        let change = by.change_with(base, &node.instance, &node.at).ok()?;
        Some(Direction { node, change: Arc::new(change) })
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

    /// `node` where it explains most of what stands out of the residuals of `base`, if it is a line: away from its frequency nothing tells of
    /// it.
    fn at_line(by: &Fitter<'a>, base: &Fit<'a>, node: Node) -> Node {
        let Some(index) = node.instance.line() else { return node };
        let parameter = node.instance.free[index].parameter;
        let [low, high] = parameter.bounds();
        let (lines_hz, width_hz) = lines_hz(by.forward, &base.rows, [parameter.low, parameter.high]);
        let at = |(line_hz, step): (&f64, i32)| {
            let mut there = node.clone();
            there.at[index] =
                parameter.coordinate(line_hz + width_hz * f64::from(step) / f64::from(LINE_STEPS)).clamp(low, high);
            let predicted = by.predict_with(base, &there.instance, &there.at);
            (predicted.map_or(f64::INFINITY, |p| by.nll(&p)), there)
        };
        let all = lines_hz.iter().flat_map(|line_hz| (-LINE_STEPS..=LINE_STEPS).map(move |step| (line_hz, step)));
        let best = all.map(at).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, there)| there);
        best.unwrap_or(node)
    }

    /// `instance` starting at the delay along which the residuals of `base` lie most, if it has one: a fit only finds the nearest period.
    fn at_delay(by: &Fitter<'a>, base: &Fit<'a>, instance: Instance) -> Instance {
        let Some(index) = instance.delay() else { return instance };
        let apart = instance.free[index].size;
        let at = |step: i32| {
            let mut there = instance.clone();
            there.free[index].start += 0.5 * apart * f64::from(step) / f64::from(DELAY_STEPS);
            there
        };
        let along = |there: &Instance| {
            let change = by.change_with(base, there, &away(there, &there.zero()?, NODES[0], 1.0)?).ok()?;
            Some(dot(&change, &base.rows).powi(2) / square(&change).max(f64::MIN_POSITIVE))
        };
        let all = (-DELAY_STEPS..=DELAY_STEPS).map(at).filter_map(|there| Some((along(&there)?, there)));
        let best = all.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, there)| there);
        best.unwrap_or(instance)
    }

    /// A candidate that is either there or not, or that takes numbers from the records.
    fn discrete(&self, by: &Fitter<'a>, base: &Fit<'a>, node: Node) -> Option<Proposal> {
        let there = by.predict_with(base, &node.instance, &node.at).ok()?;
        let cost = by.nll(&there) + Fitter::prior(&base.model, &base.x);
        let log_posterior = self.log_posterior(base) + base.cost - cost + self.prior_of(&node.instance);
        let part = Part { instance: node.instance, start: node.at, along: None };
        Some(Proposal { parts: vec![part], beside: base.x.clone(), log_posterior })
    }

    /// Nodes of candidates worth another look, the best places of each form, on the side of nothing to which they point: where they were
    /// looked at, and a stronger one.
    fn shortlist(&self, by: &Fitter<'a>, base: &Fit<'a>, directions: &[Direction]) -> Vec<Node> {
        let mut places: BTreeMap<String, usize> = BTreeMap::new();
        let mut nodes: Vec<Node> = Vec::new();
        let mut found = 0;
        let Some(linear) = Linear::new(by, base, directions) else { return nodes };
        for (index, single) in self.singles(&linear) {
            let Part { instance, start: toward, .. } = &single.parts[0];
            if !is_among_best(&mut places, instance) || found == SHORTLIST {
                continue;
            }
            found += 1;
            let known = &directions[index].node;
            let zero = instance.zero().unwrap_or_default();
            let is_opposite = zero.iter().zip(toward).zip(&known.at).any(|((z, t), at)| (t - z) * (at - z) < 0.0);
            let side = if is_opposite { -1.0 } else { 1.0 };
            for strength in [1.0, NODES[1] / NODES[0]] {
                nodes.push(Node { is_one_sided: true, ..known.times(side * strength) });
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
        let instance = |i: usize| &linear.directions[i].node.instance;
        let after = |k: usize| shortlist[k + 1..].iter().map(move |other| (k, *other));
        let is_two = |(k, other): &(usize, usize)| !instance(shortlist[*k]).is_one(instance(*other));
        let all = (0..shortlist.len()).flat_map(after).filter(is_two);
        let mut pairs: Vec<Proposal> = all.filter_map(|(k, o)| self.proposal(linear, &[shortlist[k], o])).collect();
        pairs.sort_by(|a, b| b.log_posterior.total_cmp(&a.log_posterior));
        pairs.truncate(SHORTLIST);
        pairs
    }

    /// A `set` of directions with the prior of all effects.
    fn proposal(&self, linear: &Linear<'_, 'a>, set: &[usize]) -> Option<Proposal> {
        let mut proposal = linear.proposal(set)?;
        let effects = linear.base.model.effects.iter().chain(proposal.parts.iter().map(|p| &p.instance));
        proposal.log_posterior += effects.map(|e| self.prior_of(e)).sum::<f64>();
        Some(proposal)
    }
}

/// The linear problem of some directions around a point, in which the coordinates of its model give way within their ranges.
pub(super) struct Linear<'c, 'a> {
    pub base: &'c Fit<'a>,
    pub directions: &'c [Direction],
    /// ln of the density over what is there: coordinates, then directions in units of their nodes.
    pub density: Quadratic,
    /// Coordinates that give way: what stands at an end of its range does not.
    pub beside: Vec<usize>,
}

impl<'c, 'a> Linear<'c, 'a> {
    /// None where the linear problem has no solution.
    pub fn new(by: &Fitter<'a>, base: &'c Fit<'a>, directions: &'c [Direction]) -> Option<Self> {
        let (n, count) = (base.x.len(), directions.len());
        let slopes: Vec<Arc<Rows>> =
            rows_of(&base.slopes).into_iter().chain(directions.iter().map(|d| d.change.clone())).collect();
        let own = by.normal(&slopes, &base.rows);
        // The unit of a direction is its node.
        let deviations = base.model.prior().into_iter().map(|[_, sd]| sd);
        let size: Vec<f64> = deviations.chain(directions.iter().map(|d| 1.0 / d.node.distance)).collect();
        let a = |i: usize, j: usize| own[(i, j)] + if i == j { size[i].powi(-2) } else { 0.0 };
        let mut gradient = gradient(&base.model, &base.x, &own);
        gradient.extend((n..n + count).map(|i| own[(i, n + count)]));
        let mut bounds = base.model.room(&base.x);
        bounds.extend(directions.iter().map(|d| [if d.node.is_one_sided { 0.0 } else { -FARTHEST }, FARTHEST]));
        Self::of(base, directions, Quadratic { a: Mat::from_fn(n + count, n + count, a), gradient, bounds, size })
    }

    pub fn of(base: &'c Fit<'a>, directions: &'c [Direction], density: Quadratic) -> Option<Self> {
        let all: Vec<usize> = (0..base.x.len()).collect();
        let (moved, _) = density.of(&all).highest(f64::INFINITY)?;
        let beside = all.into_iter().filter(|i| !density.bounds[*i].contains(&moved[*i])).collect();
        Some(Self { base, directions, density, beside })
    }

    /// A `set` of directions as far as the records lead, the coordinates where they give way to that; `None` where the directions are one.
    ///
    /// ```text
    /// ln p = −cost + max − ½ ln det(I + Λ⁻¹ A)                                 (1)
    /// ```
    ///
    /// A and Λ are what the records and the prior know of the coordinates that give way and of the directions.
    pub fn proposal(&self, set: &[usize]) -> Option<Proposal> {
        let n = self.base.x.len();
        let directions = || set.iter().map(|i| n + i);
        let (moved, gain) = self.density.of(&(0..n).chain(directions()).collect::<Vec<_>>()).highest(f64::INFINITY)?;
        let free = self.density.of(&self.beside.iter().copied().chain(directions()).collect::<Vec<_>>());
        let occam = -0.5 * algebra::ln_determinant(&free.a)? - free.size.iter().map(|size| size.ln()).sum::<f64>();
        let parts = set.iter().zip(&moved[n..]).map(|(i, share)| self.directions[*i].part(*share));
        Some(Proposal {
            parts: parts.collect(),
            beside: self.base.x.iter().zip(&moved).map(|(x, d)| x + d).collect(),
            log_posterior: gain + occam - self.base.cost,
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
        let Self { node, change, .. } = self;
        let zero = node.instance.zero().unwrap_or_default();
        let at = zero.iter().zip(&node.at).map(|(a, b)| a + share * (b - a));
        let start = at.zip(node.instance.bounds()).map(|(x, [low, high])| x.clamp(low, high)).collect();
        Part { instance: node.instance.clone(), start, along: Some((node.at.clone(), change.clone())) }
    }
}

/// Whether the linear problem says something of an effect: it has a strength and takes no numbers from records.
pub(super) fn is_linear(instance: &Instance) -> bool {
    instance.zero().is_some() && instance.hidden() == 0
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

/// Whether `instance` is at one of the best places of its form, where they come best first; `places` are those of each form so far.
pub(super) fn is_among_best(places: &mut BTreeMap<String, usize>, instance: &Instance) -> bool {
    let count = places.entry(form(instance)).or_default();
    *count += 1;
    *count <= PLACES
}

/// The best place of each set of forms among `all`, best first, whose candidates are those that `of` says.
pub(super) fn distinct<T>(all: Vec<T>, of: impl Fn(&T) -> Vec<Instance>) -> Vec<T> {
    let mut known: Vec<Vec<String>> = Vec::new();
    let mut sets = Vec::new();
    for one in all {
        let mut forms: Vec<String> = of(&one).iter().map(form).collect();
        forms.sort_unstable();
        if sets.len() < HEATS && !known.contains(&forms) {
            known.push(forms);
            sets.push(one);
        }
    }
    sets
}

/// Kind and parameters of a candidate: one effect may have several forms.
fn form(instance: &Instance) -> String {
    let names = instance.free.iter().map(|f| f.parameter.name);
    std::iter::once(instance.kind).chain(names).collect::<Vec<_>>().join(" ")
}
