//! Before any data: which effects this array, its events and its noise could reveal, and which look alike in it.

use super::anchor::Anchor;
use super::fit::{Fitter, Point};
use super::outcome::Thresholds;
use super::problem::Problem;
use super::responses::Scene;
use super::screen::{Marginal, with_effect};
use super::search::{Search, square};
use super::settings::DiagnoseSettings;
use super::simulated::Disturbance;
use super::unknowns::Unknowns;
use crate::effects::Instance;
use crate::error::Result;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Normal quantile of a power of 80 %.
const POWER_QUANTILE: f64 = 0.842;
/// Sizes tried, as shares of the typical one.
const SIZES: [f64; 6] = [0.0625, 0.125, 0.25, 0.5, 1.0, 2.0];
/// Collinearity above which two effects cannot be told apart.
const ALIKE: f64 = 0.9;

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
    /// Expected fall of the cost at the typical strength, nuisances free to follow.
    pub expected_score: f64,
    /// The score that is needed for an alarm in 80 % of cases.
    pub needed_score: f64,
    /// The smallest strength that would be seen in 80 % of cases.
    pub detectable: Option<f64>,
    /// Whether the typical strength would be seen.
    pub is_visible: bool,
}

/// Two effects that look alike.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Confusion {
    /// One effect.
    pub one: String,
    /// The other.
    pub other: String,
    /// Cosine of the angle between their marks on the records, nuisances free to follow.
    pub collinearity: f64,
}

/// What an array could reveal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Power {
    /// Best place of each effect first.
    pub effects: Vec<Sensitivity>,
    /// Pairs of kinds above a collinearity of 0.5, most alike first.
    pub confusions: Vec<Confusion>,
    /// Kinds that this array cannot tell apart.
    pub classes: Vec<Vec<String>>,
}

/// What `problem` could reveal; of its records only the input motions count. The calibration events alone are used, since an
/// effect must pay there first.
///
/// # Errors
/// When the declared column cannot be built or an event is unusable.
pub fn power(problem: &Problem, settings: &DiagnoseSettings, thresholds: Option<&Thresholds>) -> Result<Power> {
    let recorded = Scene::new(problem, settings)?;
    let quiet = recorded.simulated(&[], Disturbance { seed: None, model_error: 0.0, deviations: None })?;
    let scene = recorded.sharing(&quiet, settings)?;
    let search = Search::new(&scene, settings, None)?;
    let anchor = Anchor::fast(&scene);
    let fitter = search.fitter(&anchor);
    let unknowns = search.unknowns(&[]);
    let zero = vec![0.0; search.nuisances.len()];
    let point = fitter.at(&unknowns, &zero, None)?;
    let marginal = Marginal::new(&fitter, &unknowns, &point);
    let seen = Seen { fitter: &fitter, unknowns: &unknowns, point: &point, marginal: &marginal };
    let alarm = search.charge() + thresholds.map_or(0.0, |t| t.gain);
    let mut marks: Vec<(Sensitivity, Vec<f64>)> =
        search.instances.par_iter().filter_map(|instance| seen.sensitivity(instance, alarm)).collect();
    marks.sort_by(|a, b| b.0.expected_score.total_cmp(&a.0.expected_score));
    let mut best: Vec<&(Sensitivity, Vec<f64>)> = Vec::new();
    for mark in &marks {
        if !best.iter().any(|b| b.0.kind == mark.0.kind) && mark.0.expected_score > 0.0 {
            best.push(mark);
        }
    }
    let mut confusions = Vec::new();
    for (i, a) in best.iter().enumerate() {
        for b in &best[i + 1..] {
            let closest = marks
                .iter()
                .filter(|m| m.0.kind == b.0.kind && m.0.expected_score > 0.0)
                .map(|m| marginal.product(&a.1, &m.1).abs() / (a.0.expected_score * m.0.expected_score).sqrt())
                .fold(0.0, f64::max);
            if closest > 0.5 {
                let (one, other) = (a.0.kind.clone(), b.0.kind.clone());
                confusions.push(Confusion { one, other, collinearity: closest.min(1.0) });
            }
        }
    }
    confusions.sort_by(|a, b| b.collinearity.total_cmp(&a.collinearity));
    let classes = classes(&confusions);
    Ok(Power { effects: marks.into_iter().map(|(s, _)| s).collect(), confusions, classes })
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

/// Where sensitivities are taken.
struct Seen<'a> {
    fitter: &'a Fitter<'a>,
    unknowns: &'a Unknowns<'a>,
    point: &'a Point,
    marginal: &'a Marginal,
}

impl Seen<'_> {
    /// The change of the whitened residuals that `instance` makes at `coordinates`.
    fn mark(&self, instance: &Instance, coordinates: &[f64]) -> Option<Vec<f64>> {
        let residual = with_effect(self.fitter, self.unknowns, self.point, instance, coordinates)?.residual;
        let mark: Vec<f64> = residual.iter().zip(&self.point.residual).map(|(a, b)| a - b).collect();
        square(&mark).is_finite().then_some(mark)
    }

    fn sensitivity(&self, instance: &Instance, alarm: f64) -> Option<(Sensitivity, Vec<f64>)> {
        // Gain λ + 2√λ·N(0, 1) must pass the alarm in 80 % of cases.
        let root = POWER_QUANTILE + (POWER_QUANTILE * POWER_QUANTILE + alarm).sqrt();
        let needed = root * root;
        let mut sensitivity = Sensitivity {
            kind: instance.kind.to_string(),
            target: instance.place(),
            parameter: String::new(),
            unit: String::new(),
            typical: None,
            expected_score: 0.0,
            needed_score: needed,
            detectable: None,
            is_visible: false,
        };
        let score = |mark: &[f64]| self.marginal.product(mark, mark).max(0.0);
        let (Some(free), Some(zero)) = (instance.free.first(), instance.zero()) else {
            let mark = self.mark(instance, &[])?;
            sensitivity.expected_score = score(&mark);
            sensitivity.is_visible = sensitivity.expected_score > needed;
            return Some((sensitivity, mark));
        };
        let p = free.parameter;
        let typical = 0.5 * (p.coordinate(p.draw[0]) + p.coordinate(p.draw[1]));
        let start = instance.start();
        let at = |share: f64| {
            let mut x = start.clone();
            x[0] = (zero[0] + share * (typical - zero[0])).clamp(p.bounds()[0], p.bounds()[1]);
            x
        };
        let mark = self.mark(instance, &at(1.0))?;
        sensitivity.parameter = p.name.to_string();
        sensitivity.unit = p.unit.to_string();
        sensitivity.typical = Some(p.value(typical));
        sensitivity.expected_score = score(&mark);
        sensitivity.is_visible = sensitivity.expected_score > needed;
        let mut before = (0.0, 0.0);
        for share in SIZES {
            let Some(mark) = self.mark(instance, &at(share)) else { continue };
            let root = score(&mark).sqrt();
            if root >= needed.sqrt() {
                // √score grows about linearly with the strength.
                let between = (needed.sqrt() - before.1) / (root - before.1).max(f64::MIN_POSITIVE);
                let share = before.0 + between.clamp(0.0, 1.0) * (share - before.0);
                sensitivity.detectable = Some(p.value(at(share)[0]));
                break;
            }
            before = (share, root);
        }
        Some((sensitivity, mark))
    }
}
