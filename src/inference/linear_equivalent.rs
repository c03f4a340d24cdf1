//! What a change of the soil does to motions, by the linear-equivalent column: a surrogate for the difference of two replays.

use super::forward::{Bins, built, key, lock};
use crate::diagnosis::responses::{Responses, Scene};
use crate::diagnosis::{DiagnoseSettings, Motions, Problem};
use crate::error::Result;
use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use toml::Table;

/// States of the column that are remembered.
const REMEMBERED: usize = 64;

/// The column of a problem in the frequency domain, at moduli and damping compatible with its strains in each record.
///
/// ```text
/// y(b) ≈ y(a) + L(b) − L(a)                                              (1)
/// ```
///
/// y is a replay and L this column, tuned to a replay nearby. What it has wrong of one state it has wrong of its neighbours, so that
/// differences are good where values are not.
///
/// Limits: those of [`crate::diagnosis::responses`]: effective strains, no permanent ones.
/// Check:  `surrogate_slopes_are_those_of_replays`.
/// Source: (1) Alexandrov et al. (2001), doi 10.2514/2.2877, additive correction.
pub struct LinearEquivalent<'a> {
    scene: Scene<'a>,
    /// As declared: what is the same in other states is taken from here.
    declared: Responses,
    known: Mutex<HashMap<String, Arc<Vec<Bins>>>>,
}

impl<'a> LinearEquivalent<'a> {
    /// Prepares `problem`.
    ///
    /// # Errors
    /// When an event is unusable or the column cannot be built.
    pub fn new(problem: &'a Problem, settings: &DiagnoseSettings) -> Result<Self> {
        Self::of(Scene::new(problem, settings)?)
    }

    /// The same column with damping that has no dispersion, as frequency-domain programs have it.
    ///
    /// # Errors
    /// When the column cannot be built.
    pub fn without_dispersion(&self) -> Result<Self> {
        Self::of(self.scene.without_dispersion())
    }

    /// The same column, its modulus and damping tuned in each record to `replays` under `tables`.
    ///
    /// # Errors
    /// When the column cannot be built.
    pub fn tuned(&self, tables: &[Table], replays: &Motions) -> Result<Self> {
        let mut scene = self.scene.clone();
        scene.tune(&built(scene.problem, tables)?, replays)?;
        Self::of(scene)
    }

    fn of(scene: Scene<'a>) -> Result<Self> {
        let declared = scene.responses(&built(scene.problem, &[])?, &all_groups(&scene), None)?;
        Ok(Self { scene, declared, known: Mutex::default() })
    }

    /// Motions at the output sensors under `tables` on top of what is declared, record after record, `[sensor][bin]`.
    ///
    /// # Errors
    /// When the column cannot be built.
    pub fn motions(&self, tables: &[Table]) -> Result<Arc<Vec<Bins>>> {
        let key = key(tables);
        if let Some(known) = lock(&self.known).get(&key) {
            return Ok(known.clone());
        }
        let effects = built(self.scene.problem, tables)?;
        let found = self.scene.responses(&effects, &all_groups(&self.scene), Some(&self.declared))?;
        let n = self.scene.problem.array.outputs.len().max(1);
        let by_sensor = |motion: &[_]| (0..n).map(|s| motion.iter().skip(s).step_by(n).copied().collect()).collect();
        let motions: Vec<Bins> = found.records.iter().flatten().map(|r| by_sensor(&r.motion)).collect();
        let motions = Arc::new(motions);
        let mut known = lock(&self.known);
        if known.len() >= REMEMBERED {
            known.clear();
        }
        known.insert(key, motions.clone());
        Ok(motions)
    }
}

fn all_groups(scene: &Scene<'_>) -> Vec<usize> {
    (0..scene.groups.len()).collect()
}
