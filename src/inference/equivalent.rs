//! Motions of the equivalent-linear column: what a change of the column makes of them, for a small part of what a replay costs.

use super::forward::{Bins, Forward, built, lock};
use super::spread::band_hz;
use crate::column::Profile;
use crate::effects::{self, Effect};
use crate::equivalent_linear::{Base, Compatible, Curves, EquivalentColumn, Tuning, element_count};
use crate::error::Result;
use rayon::prelude::*;
use realfft::num_complex::Complex;
use std::sync::{Arc, Mutex};
use toml::Table;

type C64 = Complex<f64>;

/// The equivalent-linear column of every record, its strains compatible with its moduli.
pub struct Columns {
    columns: Vec<Compatible>,
    tuning: Vec<Tuning>,
    bases: Bins,
    depths_m: Vec<f64>,
}

impl Columns {
    /// That of `forward` under `tables` on top of what is declared, tuned to `motions`, `[record][sensor][bin]`.
    ///
    /// # Errors
    /// When the column cannot be built.
    pub fn tuned(forward: &Forward<'_>, tables: &[Table], motions: &[Bins]) -> Result<Self> {
        let found = Self::new(forward, tables, &Curves::default(), None)?;
        Ok(found.tuned_to(forward, motions))
    }

    /// Its strains sought from those `near` it and tuned alike.
    fn new(forward: &Forward<'_>, tables: &[Table], curves: &Curves, near: Option<&Self>) -> Result<Self> {
        let effects = built(forward.problem, tables)?;
        let (bases, depths_m) = (forward.bases(&effects), depths_m(forward, &effects));
        let high_hz = band_hz(forward)[1].max(1.0);
        let elements = element_count(&forward.problem.array.profile, high_hz);
        let mut known: Vec<(Profile, EquivalentColumn)> = Vec::new();
        let mut plain = Vec::with_capacity(forward.records.len());
        for i in 0..bases.len() {
            let profile = profile(forward, &effects, i);
            let column = match known.iter().find(|(p, _)| *p == profile) {
                Some((_, column)) => column.clone(),
                None => {
                    let column = EquivalentColumn::new(&profile, elements, curves)?;
                    known.push((profile, column.clone()));
                    column
                }
            };
            plain.push(column);
        }
        let compatible = |(i, column): (usize, EquivalentColumn)| {
            Compatible::near(column, &forward.shaking(i, &bases[i]), near.map(|near| &near.columns[i]))
        };
        let columns: Vec<Compatible> = plain.into_iter().enumerate().map(compatible).collect();
        let tuning = near.map_or_else(|| vec![Tuning::default(); columns.len()], |near| near.tuning.clone());
        Ok(Self { columns, tuning, bases, depths_m })
    }

    fn tuned_to(self, forward: &Forward<'_>, motions: &[Bins]) -> Self {
        let of = |i: usize| self.columns[i].tuned(&forward.shaking(i, &self.bases[i]), &self.depths_m, &motions[i]);
        let tuning = (0..self.columns.len()).into_par_iter().map(of).collect();
        Self { tuning, ..self }
    }

    /// The same with moduli that do not grow with frequency.
    #[must_use]
    pub fn without_dispersion(self) -> Self {
        let columns = self.columns.into_iter().map(Compatible::without_dispersion).collect();
        Self { columns, ..self }
    }

    /// Motions at the output sensors, `[record][sensor][bin]`.
    pub fn motions(&self, forward: &Forward<'_>) -> Vec<Bins> {
        let of = |(i, column): (usize, &Compatible)| {
            column.motions(&forward.shaking(i, &self.bases[i]), &self.depths_m, &self.tuning[i])
        };
        self.columns.iter().enumerate().map(of).collect()
    }
}

/// The equivalent-linear column in place of replays, tuned to one of these.
#[derive(Default)]
pub struct Equivalent {
    curves: Curves,
    tuned: Mutex<Option<Arc<Columns>>>,
}

impl Equivalent {
    /// Tunes it to `motions` that were replayed of `forward` under `tables`; what it has there, `[record][sensor][bin]`.
    ///
    /// # Errors
    /// When the column cannot be built.
    pub fn tune(&self, forward: &Forward<'_>, tables: &[Table], motions: &[Bins]) -> Result<Vec<Bins>> {
        let near = lock(&self.tuned).clone();
        let columns = Columns::new(forward, tables, &self.curves, near.as_deref())?.tuned_to(forward, motions);
        let own = columns.motions(forward);
        *lock(&self.tuned) = Some(Arc::new(columns));
        Ok(own)
    }

    /// Motions at the output sensors of `forward` under `tables`, `[record][sensor][bin]`.
    ///
    /// # Errors
    /// When the column cannot be built.
    pub fn motions(&self, forward: &Forward<'_>, tables: &[Table]) -> Result<Vec<Bins>> {
        let near = lock(&self.tuned).clone();
        Ok(Columns::new(forward, tables, &self.curves, near.as_deref())?.motions(forward))
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

#[cfg(test)]
mod tests {
    use super::super::made_up::{Nonlinear, Truth, problem};
    use super::*;
    use crate::diagnosis::{DiagnoseSettings, Problem};

    /// How much of the change that an effect makes of replays from `anchor` on the equivalent-linear column misses.
    fn missed(problem: &Problem, anchor: &[Table], effect: &str) -> f64 {
        let replay = Nonlinear(problem);
        let forward = Forward::new(problem, &replay, &DiagnoseSettings::default()).unwrap();
        forward.anchor(&[]).unwrap();
        let surrogate = forward.equivalent_linear();
        surrogate.follow(&forward, anchor).unwrap();
        let with: Vec<Table> = anchor.iter().cloned().chain([effect.parse().unwrap()]).collect();
        let [at, own_at] = [&forward, &surrogate].map(|f| f.corrected(anchor).unwrap());
        let [to, own_to] = [&forward, &surrogate].map(|f| f.corrected(&with).unwrap());
        let norm = |one: &[Bins], other: &[Bins]| -> f64 {
            let pairs = one.iter().flatten().flatten().zip(other.iter().flatten().flatten());
            pairs.map(|(a, b)| (a - b).norm_sqr()).sum::<f64>().sqrt()
        };
        assert!(norm(&at, &own_at) < 1e-9 * norm(&at, &to), "it is the replay where it is tuned");
        norm(&to, &own_to) / norm(&to, &at)
    }

    #[test]
    fn it_leads_on_from_a_replay() {
        let seam = "kind = 'thin_seam'\ndepth_m = 14.0\nthickness_m = 2.0\nln_factor = -0.3";
        let softer: Table = "kind = 'layer_velocity'\nln_factor = -0.1".parse().unwrap();
        // Steps in time shorten periods a little, and what resonates tells.
        let share = missed(&problem(&Truth { events: 1, ..Truth::default() }), &[softer], seam);
        assert!(share < 0.15, "{share}");
    }
}
