//! The equivalent-linear column beside a replay: how motions change with what changes the column.
//!
//! ```text
//! V(θ + δ) ≈ V(θ) + V(θ) (V_lin(θ + δ) − V_lin(θ)) V_lin(θ)* / (|V_lin(θ)|² + ε)                      (1)
//! ```
//!
//! V is the replay and V_lin the equivalent-linear column tuned to it. (1) takes over how amplitudes and phases change, whatever the
//! two columns differ by at θ, and costs a hundredth of a replay. Where strains are too large for it, steps that were foretold by (1) show
//! that, and slopes are replayed.
//!
//! Check: `slopes_of_the_equivalent_linear_column_are_those_of_replays`.

use super::forward::{Bins, Forward, built};
use crate::column::Profile;
use crate::diagnosis::Problem;
use crate::effects::{self, Effect};
use crate::equivalent_linear::{Base, Compatible, Curves, EquivalentColumn, Tuning, element_count};
use crate::error::Result;
use rayon::prelude::*;
use realfft::num_complex::Complex;
use std::sync::Arc;
use toml::Table;

type C64 = Complex<f64>;

/// ε of (1), a share of the mean power of a motion.
const FLOOR: f64 = 1e-3;

/// Equivalent-linear columns of an array.
pub struct Equivalent {
    curves: Curves,
    elements: usize,
}

impl Equivalent {
    /// For motions up to `high_hz`.
    pub fn new(problem: &Problem, high_hz: f64) -> Self {
        Self { curves: Curves::default(), elements: element_count(&problem.array.profile, high_hz) }
    }
}

/// The column of every record in one state, its strains compatible with its moduli.
pub struct State {
    columns: Vec<Compatible>,
    tuning: Vec<Tuning>,
    bases: Bins,
    depths_m: Vec<f64>,
}

impl State {
    /// The column of `forward` under `tables` on top of what is declared, strains and tuning those of a state `near` by at first.
    ///
    /// # Errors
    /// When an effect or the column cannot be built.
    fn new(forward: &Forward<'_>, tables: &[Table], near: Option<&Self>) -> Result<Self> {
        let effects = built(forward.problem, tables)?;
        let bases = forward.bases(&effects);
        let Equivalent { curves, elements } = &*forward.equivalent;
        let mut known: Vec<(Profile, EquivalentColumn)> = Vec::new();
        let mut columns = Vec::with_capacity(forward.records.len());
        for (i, motion) in bases.iter().enumerate() {
            let profile = profile(forward, &effects, i);
            let column = match known.iter().find(|(p, _)| *p == profile) {
                Some((_, column)) => column.clone(),
                None => {
                    let column = EquivalentColumn::new(&profile, *elements, curves)?;
                    known.push((profile, column.clone()));
                    column
                }
            };
            let base = forward.shaking(i, motion);
            columns.push(match near {
                Some(near) => Compatible::beside(column, &base, &near.columns[i]),
                None => Compatible::new(column, &base),
            });
        }
        let tuning = near.map_or_else(|| vec![Tuning::default(); columns.len()], |near| near.tuning.clone());
        Ok(Self { columns, tuning, bases, depths_m: depths_m(forward, &effects) })
    }

    /// The same tuned to `motions`, `[record][sensor][bin]`.
    ///
    /// # Errors
    /// As [`State::new`].
    pub fn tuned(forward: &Forward<'_>, tables: &[Table], motions: &[Bins]) -> Result<Self> {
        let mut state = Self::new(forward, tables, None)?;
        let of = |i: usize| state.columns[i].tuned(&forward.shaking(i, &state.bases[i]), &state.depths_m, &motions[i]);
        state.tuning = (0..state.columns.len()).into_par_iter().map(of).collect();
        Ok(state)
    }

    /// The same, prepared for many states beside it.
    fn prepared(self, forward: &Forward<'_>) -> Self {
        let bases = self.bases;
        let all = self.columns.into_iter().zip(&bases).enumerate();
        let columns = all.map(|(i, (column, base))| column.prepared(&forward.shaking(i, base))).collect();
        Self { columns, bases, ..self }
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

/// A replay and the equivalent-linear column there.
pub struct Neighbourhood<'f, 'a> {
    forward: &'f Forward<'a>,
    state: State,
    replayed: Arc<Vec<Bins>>,
    motions: Vec<Bins>,
}

impl<'f, 'a> Neighbourhood<'f, 'a> {
    /// Around the column under `tables`.
    ///
    /// # Errors
    /// When an effect or the column cannot be built or replayed.
    pub fn new(forward: &'f Forward<'a>, tables: &[Table]) -> Result<Self> {
        let replayed = forward.corrected(tables)?;
        let state = State::tuned(forward, tables, &replayed)?.prepared(forward);
        let motions = state.motions(forward);
        Ok(Self { forward, state, replayed, motions })
    }

    /// Motions at the output sensors under `tables` near by, equation (1).
    ///
    /// # Errors
    /// When an effect or the column cannot be built.
    pub fn motions(&self, tables: &[Table]) -> Result<Vec<Bins>> {
        let there = State::new(self.forward, tables, Some(&self.state))?.motions(self.forward);
        let changed = |((v, here), there): ((&Vec<C64>, &Vec<C64>), &Vec<C64>)| -> Vec<C64> {
            let floor = FLOOR * here.iter().map(C64::norm_sqr).sum::<f64>() / here.len().max(1) as f64;
            let of = |((v, a), b): ((&C64, &C64), &C64)| {
                v + v * (b - a) * a.conj() / (a.norm_sqr() + floor).max(f64::MIN_POSITIVE)
            };
            v.iter().zip(here).zip(there).map(of).collect()
        };
        let of_record = |((v, here), there): ((&Bins, &Bins), &Bins)| -> Bins {
            v.iter().zip(here).zip(there).map(changed).collect()
        };
        Ok(self.replayed.iter().zip(&self.motions).zip(&there).map(of_record).collect())
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
