//! What other programs make of the same declared column: what these change is no property of a site.

use super::forward::{Bins, Forward, Prediction, built};
use super::spread::band_hz;
use crate::column::Profile;
use crate::effects::{self, Effect};
use crate::equivalent_linear::{Base, Compatible, Curves, EquivalentColumn, Tuning, element_count};
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

/// The equivalent-linear column of every record, its strains compatible with its moduli.
struct Columns {
    columns: Vec<Compatible>,
    tuning: Vec<Tuning>,
    bases: Bins,
    depths_m: Vec<f64>,
}

impl Columns {
    /// That of `forward` under `tables` on top of what is declared, tuned to `motions`, `[record][sensor][bin]`.
    fn tuned(forward: &Forward<'_>, tables: &[Table], motions: &[Bins]) -> Result<Self> {
        let effects = built(forward.problem, tables)?;
        let (bases, depths_m) = (forward.bases(&effects), depths_m(forward, &effects));
        let high_hz = band_hz(forward)[1].max(1.0);
        let (curves, elements) = (Curves::default(), element_count(&forward.problem.array.profile, high_hz));
        let mut known: Vec<(Profile, EquivalentColumn)> = Vec::new();
        let mut columns = Vec::with_capacity(forward.records.len());
        for (i, motion) in bases.iter().enumerate() {
            let profile = profile(forward, &effects, i);
            let column = match known.iter().find(|(p, _)| *p == profile) {
                Some((_, column)) => column.clone(),
                None => {
                    let column = EquivalentColumn::new(&profile, elements, &curves)?;
                    known.push((profile, column.clone()));
                    column
                }
            };
            columns.push(Compatible::new(column, &forward.shaking(i, motion)));
        }
        let of = |i: usize| columns[i].tuned(&forward.shaking(i, &bases[i]), &depths_m, &motions[i]);
        let tuning = (0..columns.len()).into_par_iter().map(of).collect();
        Ok(Self { columns, tuning, bases, depths_m })
    }

    /// The same with moduli that do not grow with frequency.
    fn without_dispersion(self) -> Self {
        let columns = self.columns.into_iter().map(Compatible::without_dispersion).collect();
        Self { columns, ..self }
    }

    /// Motions at the output sensors, `[record][sensor][bin]`.
    fn motions(&self, forward: &Forward<'_>) -> Vec<Bins> {
        let of = |(i, column): (usize, &Compatible)| {
            column.motions(&forward.shaking(i, &self.bases[i]), &self.depths_m, &self.tuning[i])
        };
        self.columns.iter().enumerate().map(of).collect()
    }
}

impl Forward<'_> {
    /// What shakes the column in record `i` when the motion of its base is `acceleration_m_s2`.
    fn shaking<'m>(&'m self, i: usize, acceleration_m_s2: &'m [C64]) -> Base<'m> {
        let at = self.records[i];
        let record = &self.groups[at.group].records[at.record];
        Base {
            frequencies_hz: self.frequencies_hz(at),
            acceleration_m_s2,
            samples: record.window.len(),
            peak_factor: record.peak_factor,
        }
    }
}

/// The column of record `i` under `effects`.
fn profile(forward: &Forward<'_>, effects: &[Box<dyn Effect>], i: usize) -> Profile {
    let at = forward.records[i];
    let event = forward.groups[at.group].records[at.record].event;
    let mut profile = forward.problem.array.profile.clone();
    effects.iter().for_each(|e| e.edit(&mut profile, &forward.problem.events[event].situation));
    profile
}

/// Depths of the output sensors under `effects`.
fn depths_m(forward: &Forward<'_>, effects: &[Box<dyn Effect>]) -> Vec<f64> {
    let array = &forward.problem.array;
    let outputs = array.outputs.iter().zip(&array.depths_m);
    outputs.map(|(name, depth_m)| effects::depth_m(effects, name, *depth_m, array.profile.depth_m())).collect()
}
