//! What other programs make of the same declared column: what these change is no property of a site.

use super::forward::{Bins, Forward, Prediction, built};
use crate::diagnosis::DiagnoseSettings;
use crate::diagnosis::responses::Scene;
use crate::effects::Effect;
use crate::error::Result;
use realfft::num_complex::Complex;
use std::sync::Arc;
use toml::Table;

type C64 = Complex<f64>;

/// Share of the motion below which a convention changes nothing.
const NOTHING: f64 = 1e-6;

/// What is added to the outputs, by record.
pub type Slope = Arc<Vec<Bins>>;

/// What each convention adds to the outputs under `tables` on top of what is declared: a complex modulus without dispersion, as
/// frequency-domain programs have it, instead of the causal one. Taken from the linear-equivalent column, tuned to the replay there, for
/// no replay in the time domain can have it; one that changes nothing is left out.
///
/// # Errors
/// When the column cannot be built or replayed.
pub fn conventions(forward: &Forward<'_>, settings: &DiagnoseSettings, tables: &[Table]) -> Result<Vec<Slope>> {
    let effects = built(forward.problem, tables)?;
    let mut scene = Scene::new(forward.problem, settings)?;
    scene.tune(&effects, &forward.fine(tables)?)?;
    let ours = motions(&scene, &effects)?;
    let theirs = motions(&scene.without_dispersion(), &effects)?;
    Ok(change(&ours, &theirs).into_iter().collect())
}

/// Motions at the outputs of a linear-equivalent column, by record.
fn motions(scene: &Scene<'_>, effects: &[Box<dyn Effect>]) -> Result<Vec<Bins>> {
    let groups: Vec<usize> = (0..scene.groups.len()).collect();
    let n = scene.problem.array.outputs.len().max(1);
    let by_sensor =
        |motion: &[C64]| -> Bins { (0..n).map(|s| motion.iter().skip(s).step_by(n).copied().collect()).collect() };
    let found = scene.responses(effects, &groups, None)?;
    Ok(found.records.iter().flatten().map(|r| by_sensor(&r.motion)).collect())
}

/// What `theirs` have more than `ours`, if anything.
fn change(ours: &[Bins], theirs: &[Bins]) -> Option<Slope> {
    let mut power = [0.0, 0.0];
    let by_sensor =
        |(ours, theirs): (&Vec<C64>, &Vec<C64>)| -> Vec<C64> { ours.iter().zip(theirs).map(|(a, b)| b - a).collect() };
    let by_record = |(ours, theirs): (&Bins, &Bins)| -> Bins {
        let added: Bins = ours.iter().zip(theirs).map(by_sensor).collect();
        power[0] += ours.iter().flatten().map(C64::norm_sqr).sum::<f64>();
        power[1] += added.iter().flatten().map(C64::norm_sqr).sum::<f64>();
        added
    };
    let added: Vec<Bins> = ours.iter().zip(theirs).map(by_record).collect();
    (power[1] > NOTHING * NOTHING * power[0]).then(|| Arc::new(added))
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
