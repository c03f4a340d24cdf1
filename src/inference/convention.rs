//! What other programs make of the same declared column: what these change is no property of a site.

use super::equivalent::Columns;
use super::forward::{Bins, Forward, Prediction};
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
/// frequency-domain programs have it, instead of the causal one. Taken from the equivalent-linear column, tuned to the replay there, for
/// no replay in the time domain can have it; one that changes nothing is left out.
///
/// # Errors
/// When the column cannot be built or replayed.
pub fn conventions(forward: &Forward<'_>, tables: &[Table]) -> Result<Vec<Slope>> {
    let columns = Columns::tuned(forward, tables, &forward.corrected(tables)?)?;
    let ours = columns.motions(forward);
    let theirs = columns.without_dispersion().motions(forward);
    Ok(change(&ours, &theirs).into_iter().collect())
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
