//! What other programs make of the same declared column: what these change is no property of a site.

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
/// frequency-domain programs have it, instead of the causal one. Taken from the linear-equivalent column; empty where it changes nothing.
///
/// # Errors
/// When the column cannot be built.
pub fn conventions(forward: &Forward<'_>, tables: &[Table]) -> Result<Vec<Slope>> {
    let linear = forward.linear();
    let ours = linear.motions(tables)?;
    let theirs = linear.without_dispersion()?.motions(tables)?;
    let mut power = [0.0, 0.0];
    let change =
        |ours: &Vec<C64>, theirs: &Vec<C64>| -> Vec<C64> { ours.iter().zip(theirs).map(|(a, b)| b - a).collect() };
    let by_sensor = |(ours, theirs): (&Bins, &Bins)| -> Bins {
        let added: Bins = ours.iter().zip(theirs).map(|(a, b)| change(a, b)).collect();
        power[0] += ours.iter().flatten().map(C64::norm_sqr).sum::<f64>();
        power[1] += added.iter().flatten().map(C64::norm_sqr).sum::<f64>();
        added
    };
    let added: Vec<Bins> = ours.iter().zip(theirs.iter()).map(by_sensor).collect();
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
