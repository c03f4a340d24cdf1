//! Which part of a model neighbours follow, and which the fast column.

use super::neighbours::Neighbours;
use super::responses::Scene;
use super::search::Search;
use super::unknowns::{Placed, Unknowns};
use crate::column::Profile;
use crate::effects::{self, Effect, Instance, Situation};
use crate::error::Result;
use toml::Value;

impl Scene<'_> {
    /// The same with the fast column alone to follow nuisances and velocities.
    pub(super) fn alone(&self) -> Self {
        let mut alone = self.clone();
        alone.neighbours = None;
        alone
    }

    /// What `effects` do to the velocities that neighbours follow, in the first event; empty where they follow none.
    pub(super) fn velocity_shift(&self, effects: &[Box<dyn Effect>]) -> Vec<f64> {
        self.problem.events.first().map_or(Vec::new(), |event| self.edited(effects, &event.situation).1)
    }

    /// The same of the declared effects and the one of `table`.
    ///
    /// # Errors
    /// When an effect cannot be built.
    pub(super) fn velocity_shift_with(&self, table: &toml::Table) -> Result<Vec<f64>> {
        let mut all = effects::build_all(&self.problem.declared)?;
        all.push(effects::build(table)?);
        Ok(self.velocity_shift(&all))
    }

    /// The fast column's profile, and what `effects` do to velocities where neighbours follow these.
    pub(super) fn edited(&self, effects: &[Box<dyn Effect>], situation: &Situation) -> (Profile, Vec<f64>) {
        self.edited_beside(self.neighbours.as_deref(), effects, situation)
    }

    /// The same beside `neighbours` that are not the scene's yet.
    pub(super) fn edited_beside(
        &self,
        neighbours: Option<&Neighbours>,
        effects: &[Box<dyn Effect>],
        situation: &Situation,
    ) -> (Profile, Vec<f64>) {
        let declared = &self.problem.array.profile;
        let mut profile = declared.clone();
        for effect in effects {
            effect.edit(&mut profile, situation);
        }
        let taken = neighbours.map(|n| n.take_velocities(declared, &mut profile, situation));
        (profile, taken.unwrap_or_default())
    }
}

impl Search<'_> {
    /// `effects` and unknowns `x` without the effect at `index`, the tolerances of velocities having taken over what it did to these.
    ///
    /// # Errors
    /// When the effect cannot be built.
    pub(super) fn without(&self, effects: &[Instance], x: &[f64], index: usize) -> Result<(Vec<Instance>, Vec<f64>)> {
        let at = self.unknowns(effects).start(index);
        let mut effects = effects.to_vec();
        let taken_out = effects.remove(index);
        let mut x = x.to_vec();
        let own: Vec<f64> = x.drain(at..at + taken_out.free.len()).collect();
        let taken = self.scene.velocity_shift_with(&taken_out.at(&own))?;
        x.iter_mut().zip(taken).for_each(|(x, taken)| *x += taken);
        Ok((effects, x))
    }
}

/// `x` as anchors know it: effects in their typical sizes; those that neighbours follow count as nuisances, and as nothing by
/// themselves. What does not change the motion of the ground counts as nothing: no replay has anything to tell of it.
///
/// # Errors
/// When an effect cannot be built.
pub(super) fn scaled(scene: &Scene<'_>, unknowns: &Unknowns<'_>, x: &[f64]) -> Result<Placed> {
    let mut scaled = unknowns.placed(x);
    for (x, _) in scaled.x.iter_mut().zip(unknowns.nuisances).filter(|(_, n)| !n.is_shaken) {
        *x = 0.0;
    }
    let array = &scene.problem.array;
    let is_output =
        |e: &Instance| array.outputs.iter().any(|s| e.target.get("sensor").and_then(Value::as_str) == Some(s));
    for (index, instance) in unknowns.effects.iter().enumerate() {
        let start = unknowns.start(index);
        let own = start..start + instance.free.len();
        if is_output(instance) {
            scaled.x[own].fill(0.0);
        } else if unknowns.followed_as(instance).is_none() {
            let shift = scene.velocity_shift_with(&instance.at(&x[own.clone()]))?;
            let is_followed = unknowns.axis(instance).is_none() && shift.iter().any(|s| *s != 0.0);
            for (x, free) in scaled.x[own].iter_mut().zip(&instance.free) {
                *x = if is_followed { 0.0 } else { *x / free.size };
            }
        }
    }
    Ok(scaled)
}

/// The unknowns, what effects do to velocities being added to the nuisances of these.
pub(super) fn place(scene: &Scene<'_>, effects: &[Box<dyn Effect>], x: &[f64]) -> Vec<f64> {
    let mut place = x.to_vec();
    place.iter_mut().zip(scene.velocity_shift(effects)).for_each(|(x, shift)| *x += shift);
    place
}

#[cfg(test)]
mod tests {
    use super::super::made_up::judged;
    use super::super::settings::DiagnoseSettings;
    use super::*;

    #[test]
    fn no_replay_tells_of_what_leaves_the_ground_as_it_is() {
        let (problem, settings) = (judged(""), DiagnoseSettings::default());
        let scene = Scene::new(&problem, &settings).unwrap();
        let search = Search::new(&scene, &settings, None).unwrap();
        let gains: Vec<Instance> = search.instances.iter().filter(|i| i.kind == "sensor_gain").cloned().collect();
        let unknowns = search.unknowns(&gains);
        let counts = |i: usize| {
            let mut x = vec![0.0; unknowns.len()];
            x[i] = 0.1;
            scaled(&scene, &unknowns, &x).unwrap().x[i] != 0.0
        };
        for (i, nuisance) in search.nuisances.iter().enumerate() {
            assert_eq!(counts(i), nuisance.is_shaken, "{}", nuisance.what());
        }
        for (i, gain) in gains.iter().enumerate() {
            assert_eq!(counts(search.nuisances.len() + i), gain.place() == problem.array.input, "{}", gain.place());
        }
    }
}
