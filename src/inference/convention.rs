//! What other programs make of the same declared column: what these change is no property of a site.

use super::forward::{Bins, Forward, Predicted, Prediction, built};
use crate::effects;
use crate::equivalent_linear::{Base, Compatible, Curves, EquivalentColumn, element_count};
use crate::error::Result;
use rayon::prelude::*;
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
    let effects = built(forward.problem, tables)?;
    let array = &forward.problem.array;
    let high_hz =
        forward.records.iter().filter_map(|at| forward.frequencies_hz(*at).last()).fold(1.0f64, |m, f| m.max(*f));
    let elements = element_count(&array.profile, high_hz);
    let curves = Curves::default();
    let depths_m: Vec<f64> = array
        .outputs
        .iter()
        .zip(&array.depths_m)
        .map(|(name, depth_m)| effects::depth_m(&effects, name, *depth_m, array.profile.depth_m()))
        .collect();
    let of = |(i, (predicted, replayed)): (usize, (&Predicted, &Bins))| -> Result<[Bins; 2]> {
        let at = forward.records[i];
        let record = &forward.groups[at.group].records[at.record];
        let mut profile = array.profile.clone();
        effects.iter().for_each(|e| e.edit(&mut profile, &forward.problem.events[record.event].situation));
        let base = Base {
            frequencies_hz: forward.frequencies_hz(at),
            acceleration_m_s2: &predicted.base,
            samples: record.window.len(),
            peak_factor: record.peak_factor,
        };
        let column = Compatible::new(EquivalentColumn::new(&profile, elements, &curves)?, &base);
        let tuning = column.tuned(&base, &depths_m, replayed);
        let ours = column.motions(&base, &depths_m, &tuning);
        Ok([ours, column.without_dispersion().motions(&base, &depths_m, &tuning)])
    };
    let (prediction, replayed) = (forward.predict(tables)?, forward.corrected(tables)?);
    let records: Vec<_> = prediction.iter().zip(replayed.iter()).enumerate().collect();
    let both: Vec<[Bins; 2]> = records.into_par_iter().map(of).collect::<Result<_>>()?;
    let (ours, theirs): (Vec<Bins>, Vec<Bins>) = both.into_iter().map(|[ours, theirs]| (ours, theirs)).unzip();
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
