//! What other programs make of the same declared column: what these change is no property of a site.

use super::forward::{Bins, Forward, Prediction};
use crate::diagnosis::DiagnoseSettings;
use crate::diagnosis::responses::Scene;
use crate::effects;
use crate::error::Result;
use std::sync::Arc;
use toml::Table;

/// Share of the motion below which a convention changes nothing.
const NOTHING: f64 = 1e-6;

/// What is added to the outputs, by record.
pub type Slope = Arc<Vec<Bins>>;

/// What each convention adds to the outputs under `tables` on top of what is declared: a complex modulus without dispersion, as
/// frequency-domain programs have it, instead of the causal one. Taken from the linear-equivalent column; empty where it changes nothing.
///
/// # Errors
/// When the column cannot be built.
pub fn conventions(forward: &Forward<'_>, settings: &DiagnoseSettings, tables: &[Table]) -> Result<Vec<Slope>> {
    let ours = Scene::new(forward.problem, settings)?;
    let theirs = ours.without_dispersion();
    let all: Vec<Table> = forward.problem.declared.iter().chain(tables).cloned().collect();
    let built = effects::build_all(&all)?;
    let groups: Vec<usize> = (0..forward.groups.len()).collect();
    let [ours, theirs] = [ours, theirs].map(|scene| scene.responses(&built, &groups, None));
    let (ours, theirs) = (ours?, theirs?);
    let n = forward.problem.array.outputs.len();
    let mut power = [0.0, 0.0];
    let mut added: Vec<Bins> = Vec::with_capacity(forward.records.len());
    for (a, b) in ours.records.iter().flatten().zip(theirs.records.iter().flatten()) {
        let mut bins: Bins = vec![Vec::with_capacity(a.motion.len() / n.max(1)); n];
        for (i, (a, b)) in a.motion.iter().zip(&b.motion).enumerate() {
            power[0] += a.norm_sqr();
            power[1] += (b - a).norm_sqr();
            bins[i % n].push(b - a);
        }
        added.push(bins);
    }
    Ok(if power[1] > NOTHING * NOTHING * power[0] { vec![Arc::new(added)] } else { Vec::new() })
}

/// Adds `strengths` of `conventions` to a prediction.
pub fn add(prediction: &mut Prediction, conventions: &[Slope], strengths: &[f64]) {
    for (convention, strength) in conventions.iter().zip(strengths).filter(|(_, w)| **w != 0.0) {
        for (p, change) in prediction.iter_mut().zip(convention.iter()) {
            for (y, d) in p.outputs.iter_mut().flatten().zip(change.iter().flatten()) {
                *y += d * *strength;
            }
        }
    }
}
