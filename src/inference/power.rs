//! Before any data: which effects this array, its events and its noise could reveal, and which look alike in it.

use super::answer::NOTHING;
use super::competition::{acting, ln_prior};
use super::forward::Forward;
use super::parameters::{Declared, Model, prior_of};
use super::posterior::{Fit, Fitter, Start, Stop, dot, square};
use super::weights::{Expected, Rows};
use crate::diagnosis::{DiagnoseSettings, Hidden, Problem, Replay};
use crate::effects::Instance;
use crate::error::{Error, Result};
use crate::numerics::threads::on_threads;
use faer::Mat;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Normal quantile of a power of 80 %.
const POWER_QUANTILE: f64 = 0.842;
/// Largest strength looked at, in typical ones.
const LARGEST: f64 = 2.0;
/// Collinearity above which two effects cannot be told apart, and from which it is told.
const ALIKE: f64 = 0.9;
const SIMILAR: f64 = 0.5;

/// What could be seen of one effect at one place.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sensitivity {
    /// Name of the effect.
    pub kind: String,
    /// Where it sits.
    pub target: String,
    /// Its strength parameter; empty for a discrete effect.
    pub parameter: String,
    /// Unit of the parameter.
    pub unit: String,
    /// A typical strength.
    pub typical: Option<f64>,
    /// Expected squared distance of the records at the typical strength from what the declared values can be within their tolerances, in
    /// deviations of what is expected of residuals.
    pub expected_score: f64,
    /// The score at which the effect is named in 80 % of cases.
    pub needed_score: f64,
    /// The smallest strength, up to twice the typical one, that would be named in 80 % of cases.
    pub detectable: Option<f64>,
    /// Whether the typical strength would be named.
    pub is_visible: bool,
}

/// Two effects that look alike.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Confusion {
    /// One effect.
    pub one: String,
    /// The other.
    pub other: String,
    /// Cosine of the angle between their marks on the records, declared values free to follow.
    pub collinearity: f64,
}

/// What an array could reveal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Power {
    /// Most visible first.
    pub effects: Vec<Sensitivity>,
    /// Pairs of kinds that look alike, most alike first.
    pub confusions: Vec<Confusion>,
    /// Kinds that this array cannot tell apart.
    pub classes: Vec<Vec<String>>,
}

/// What `problem` could reveal; of its records only the input motions count.
///
/// ```text
/// λ = mᵀ (I + J Λ Jᵀ)⁻¹ m                                                 (1)
/// λ + 2 z √λ > 2 (ln odds + ½ ln(1 + λ w²) − ln prior)                    (2)
/// ```
///
/// m is what an effect changes of the residuals, J the same of the declared values and Λ their prior; w is the deviation of the prior of
/// its strength over the strength. (2) is what the competition asks for, at a normal quantile z of −0.842.
///
/// # Errors
/// When the declared column cannot be built or replayed or an event is unusable.
pub fn power(problem: &Problem, replay: &dyn Replay, settings: &DiagnoseSettings) -> Result<Power> {
    // What the declared column makes of the inputs stands for records.
    let mut quiet = problem.clone();
    for (event, motion) in quiet.events.iter_mut().zip(replay.replay(&[])?) {
        let place = || format!("event `{}`", event.name);
        event.outputs =
            motion.map_err(|reason| Error::new("the column did not finish").cause(reason).of_model().at(place()))?;
    }
    let forward = Forward::new(&quiet, replay, settings)?;
    forward.anchor(&[])?;
    let declared = Declared::new(&quiet)?;
    let prediction = Arc::new(forward.predict(&[])?);
    let fitter = Fitter::new(&forward, Expected::of(&forward, prediction));
    let model = Model { declared: &declared, effects: Vec::new() };
    let x = vec![0.0; model.len()];
    let base = fitter.fit(Start::at(model, x), Stop::WHERE_IT_IS)?;
    let instances = acting(&quiet.array);
    let ln_prior = ln_prior(&forward, instances.iter());
    let marks = marks(&fitter, &base, &instances, |instance| ln_prior.get(instance.kind).copied());
    let mut marks = marks.ok_or_else(|| Error::new("the declared values have no posterior"))?;
    marks.sort_by(|a, b| b.0.expected_score.total_cmp(&a.0.expected_score));
    let confusions = confusions(&marks);
    let classes = classes(&confusions);
    Ok(Power { effects: marks.into_iter().map(|(s, _)| s).collect(), confusions, classes })
}

/// What could be seen of each of `instances` beside `base`, whose prior is e to the power of `ln_prior`; none where the coordinates of
/// `base` have no posterior.
fn marks<'a>(
    fitter: &Fitter<'a>,
    base: &Fit<'a>,
    instances: &[Instance],
    ln_prior: impl Fn(&Instance) -> Option<f64> + Sync,
) -> Option<Vec<(Sensitivity, Mark)>> {
    let seen = Seen { fitter, base, covariance: base.covariance()? };
    let of = |i: usize| seen.sensitivity(&instances[i], (1.0 / NOTHING - 1.0).ln() - ln_prior(&instances[i])?);
    Some(on_threads(instances.len(), of).into_iter().flatten().collect())
}

/// Of each kind among `instances` that has a strength the place where it would be seen least beside `base`, the best hidden first.
pub(super) fn hidden<'a>(
    fitter: &Fitter<'a>,
    base: &Fit<'a>,
    instances: &[Instance],
    ln_prior: impl Fn(&Instance) -> Option<f64> + Sync,
) -> Vec<Hidden> {
    let visible = |s: &Sensitivity| s.expected_score / s.needed_score;
    let mut all: Vec<Sensitivity> =
        marks(fitter, base, instances, ln_prior).unwrap_or_default().into_iter().map(|(seen, _)| seen).collect();
    all.retain(|seen| !seen.parameter.is_empty());
    all.sort_by(|a, b| visible(a).total_cmp(&visible(b)));
    let mut kinds = BTreeSet::new();
    all.retain(|seen| kinds.insert(seen.kind.clone()));
    let of = |Sensitivity { kind, target, parameter, unit, detectable, .. }| Hidden {
        kind,
        target,
        parameter,
        unit,
        least: detectable,
    };
    all.into_iter().map(of).collect()
}

/// What an effect changes of the residuals, and how the declared values follow it.
struct Mark {
    change: Rows,
    /// Jᵀ m, and A⁻¹ Jᵀ m with the information A of records and prior.
    by_declared: Vec<f64>,
    follows: Vec<f64>,
}

impl Mark {
    /// (1) between two marks.
    fn product(&self, other: &Self) -> f64 {
        let followed: f64 = self.by_declared.iter().zip(&other.follows).map(|(a, b)| a * b).sum();
        dot(&self.change, &other.change) - followed
    }

    fn score(&self) -> f64 {
        self.product(self).max(0.0)
    }
}

/// Where sensitivities are taken.
struct Seen<'s, 'a> {
    fitter: &'s Fitter<'a>,
    base: &'s Fit<'a>,
    /// Of the declared values.
    covariance: Mat<f64>,
}

impl Seen<'_, '_> {
    fn mark(&self, instance: &Instance, at: &[f64]) -> Option<Mark> {
        let change = self.fitter.change_with(self.base, instance, at).ok()?;
        let by_declared: Vec<f64> = self.base.slopes.iter().map(|slope| dot(&slope.rows, &change)).collect();
        let n = by_declared.len();
        let follows = (0..n).map(|i| (0..n).map(|j| self.covariance[(i, j)] * by_declared[j]).sum()).collect();
        square(&change).is_finite().then_some(Mark { change, by_declared, follows })
    }

    /// What could be seen of `instance` where ln of the odds must grow by `charge` before its strength is known.
    fn sensitivity(&self, instance: &Instance, charge: f64) -> Option<(Sensitivity, Mark)> {
        let mut sensitivity = Sensitivity {
            kind: instance.kind.to_string(),
            target: instance.place(),
            parameter: String::new(),
            unit: String::new(),
            typical: None,
            expected_score: 0.0,
            needed_score: needed(charge),
            detectable: None,
            is_visible: false,
        };
        let (Some(free), Some(zero)) = (instance.free.first(), instance.zero()) else {
            let mark = self.mark(instance, &instance.start())?;
            sensitivity.expected_score = mark.score();
            sensitivity.is_visible = sensitivity.expected_score > sensitivity.needed_score;
            return Some((sensitivity, mark));
        };
        let p = free.parameter;
        let typical = 0.5 * (p.coordinate(p.draw[0]) + p.coordinate(p.draw[1]));
        let at = |share: f64| {
            let mut x = instance.start();
            x[0] = (zero[0] + share * (typical - zero[0])).clamp(p.bounds()[0], p.bounds()[1]);
            x
        };
        let mark = self.mark(instance, &at(1.0))?;
        let score = mark.score();
        let width = prior_of(free)[1] / (typical - zero[0]).abs();
        sensitivity.needed_score = needed(charge + 0.5 * (score * width * width).ln_1p());
        sensitivity.parameter = p.name.to_string();
        sensitivity.unit = p.unit.to_string();
        sensitivity.typical = Some(p.value(typical));
        sensitivity.expected_score = score;
        sensitivity.is_visible = score > sensitivity.needed_score;
        // √λ grows about linearly with the strength: once more from where that leads.
        let share = |at: f64, score: f64| at * (sensitivity.needed_score / score.max(f64::MIN_POSITIVE)).sqrt();
        let first = share(1.0, score).min(LARGEST);
        let found = self.mark(instance, &at(first)).map_or(f64::INFINITY, |mark| share(first, mark.score()));
        sensitivity.detectable = (found <= LARGEST).then(|| p.value(at(found)[0]));
        Some((sensitivity, mark))
    }
}

/// The least λ of (2) for a right-hand side of 2 `charge`.
fn needed(charge: f64) -> f64 {
    let root = POWER_QUANTILE + (POWER_QUANTILE * POWER_QUANTILE + 2.0 * charge.max(0.0)).sqrt();
    root * root
}

/// Pairs of kinds, the best place of one and the closest of the other.
fn confusions(marks: &[(Sensitivity, Mark)]) -> Vec<Confusion> {
    let mut best: Vec<&(Sensitivity, Mark)> = Vec::new();
    for mark in marks.iter().filter(|m| m.0.expected_score > 0.0) {
        if !best.iter().any(|b| b.0.kind == mark.0.kind) {
            best.push(mark);
        }
    }
    let mut found = Vec::new();
    for (i, a) in best.iter().enumerate() {
        for b in &best[i + 1..] {
            let own = marks.iter().filter(|m| m.0.kind == b.0.kind && m.0.expected_score > 0.0);
            let cosine =
                |m: &(Sensitivity, Mark)| a.1.product(&m.1).abs() / (a.0.expected_score * m.0.expected_score).sqrt();
            let closest = own.map(cosine).fold(0.0, f64::max);
            if closest > SIMILAR {
                let (one, other) = (a.0.kind.clone(), b.0.kind.clone());
                found.push(Confusion { one, other, collinearity: closest.min(1.0) });
            }
        }
    }
    found.sort_by(|a, b| b.collinearity.total_cmp(&a.collinearity));
    found
}

/// Kinds joined by collinearities above the limit.
fn classes(confusions: &[Confusion]) -> Vec<Vec<String>> {
    let mut classes: Vec<Vec<String>> = Vec::new();
    for c in confusions.iter().filter(|c| c.collinearity > ALIKE) {
        let mut joined = vec![c.one.clone(), c.other.clone()];
        classes.retain(|class| {
            let is_apart = !class.contains(&c.one) && !class.contains(&c.other);
            if !is_apart {
                joined.extend(class.iter().cloned());
            }
            is_apart
        });
        joined.sort();
        joined.dedup();
        classes.push(joined);
    }
    classes
}
