//! What an effect of the answer is confused with, in its place: it may say the same.

use super::anchor::Anchor;
use super::path::Path;
use super::places::{is_bought, is_preferred};
use super::problem::Replay;
use super::responses::Scene;
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use super::settling::MAX_ANCHORS;
use crate::effects::{self, Class, Instance};
use crate::error::Result;
use crate::progress::Progress;

/// Steps of a fit.
const STEPS: usize = 6;
/// Cost, over that of the answer, up to which another is worth replays: what is far from the answer is not told well from there.
const PROMISING: f64 = 2.0;
/// Cost, over that of the answer, up to which another is looked at closely.
const NEAR: f64 = 1.5;

impl Path {
    /// Tries in place of each effect of the answer what its kind is confused with: another that leaves clearly less, or no more than
    /// noise with tolerances closer to what is declared, takes its place; one that leaves as much makes the answer ambiguous. `scene`
    /// looks around the answer. Whether another has taken a place.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn try_stand_ins(
        &mut self,
        scene: &mut Scene<'_>,
        (replay, settings): (&dyn Replay, &DiagnoseSettings),
        progress: &dyn Progress,
    ) -> Result<bool> {
        let mut is_changed = false;
        for index in 0..self.accepted.len() {
            let own = self.corrected.effects[index].kind;
            for wanted in Search::new(scene, settings, Some(replay))?.promising(self, index)? {
                let kind = wanted.effects[index].kind;
                let mut there = scene.clone();
                let place = (&wanted.effects[..], wanted.x());
                let mut found = there.settled_around(place, (replay, MAX_ANCHORS), settings, progress)?;
                if found.0.cost() < NEAR * self.corrected.cost() {
                    found = there.relaxed_holding(vec![Vec::new()], found, (replay, settings), progress)?;
                    // Where only farther tolerances leave no more than noise, a closer look brings no nearer ones.
                    if !is_bought(&found.0, &self.corrected) {
                        found = there.settled_closely(found, replay, settings, progress)?;
                        found = there.relaxed_holding(vec![Vec::new()], found, (replay, settings), progress)?;
                    }
                }
                let (cost, so_far) = (found.0.cost(), self.corrected.cost());
                progress.note(&format!("{kind} in place of {own}: cost {cost:.0}, {so_far:.0} so far"));
                if is_preferred(&found.0, &self.corrected, settings) {
                    self.accepted[index].instance = found.0.effects[index].clone();
                    ((self.corrected, self.anchor), *scene) = (found, there);
                    is_changed = true;
                    break;
                }
                if !found.0.is_strained() && !is_preferred(&self.corrected, &found.0, settings) {
                    self.stand_ins.push(kind.to_string());
                }
            }
        }
        Ok(is_changed)
    }
}

impl Search<'_> {
    /// What the effect of `path` at `index` is confused with in its place, one model for each kind that is worth replays.
    fn promising(&self, path: &Path, index: usize) -> Result<Vec<Model>> {
        let model = &path.corrected;
        let mut promising = Vec::new();
        for kind in effects::find(model.effects[index].kind)?.catalogue.confused_with {
            promising.extend(self.stand_in((model, index), &[kind], &path.anchor)?);
        }
        promising.retain(|m| m.cost() < PROMISING * model.cost());
        Ok(promising)
    }

    /// `model` with an effect of one of these `kinds` in place of that at `index`, which has taken over what velocities have in common
    /// with it: the one that costs least from the `anchor`.
    ///
    /// # Errors
    /// When an effect cannot be built.
    pub(super) fn stand_in(
        &self,
        (model, index): (&Model, usize),
        kinds: &[&str],
        anchor: &Anchor,
    ) -> Result<Option<Model>> {
        let (others, released) = self.without(&model.effects, model.x(), index)?;
        let at = self.unknowns(&others).start(index);
        let mut best: Option<Model> = None;
        for instance in self.open(&model.effects).into_iter().filter(|i| kinds.contains(&i.kind)) {
            let at_sensor = || self.at_sensor(&released, &instance);
            let Some(mut x) = self.instead(&others, &released, &instance)?.or_else(at_sensor) else { continue };
            let own = x.split_off(released.len());
            x.splice(at..at, own);
            let mut effects = others.clone();
            effects.insert(index, instance);
            self.unknowns(&effects).clip(&mut x);
            let found = self.settle(&effects, &x, anchor, None, STEPS)?;
            if best.as_ref().is_none_or(|b| found.cost() < b.cost()) {
                best = Some(found);
            }
        }
        Ok(best)
    }

    /// Unknowns `from` with an effect of a sensor beside them: what the tolerance that is the same thing had, else nothing yet.
    fn at_sensor(&self, from: &[f64], instance: &Instance) -> Option<Vec<f64>> {
        let zero = instance.zero().filter(|z| instance.class() == Class::Sensor && z.len() == 1)?;
        let mut x = from.to_vec();
        let same = self.nuisances.iter().position(|n| n.instance.is_same(instance));
        let own = same.map_or(0.0, |n| std::mem::take(&mut x[n]) * self.nuisances[n].deviation);
        x.push(zero[0] + own);
        Some(x)
    }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{DT_S, Uniform, judged, path};
    use super::super::problem::NoiseSpectrum;
    use super::*;
    use crate::manifest::Tolerances;
    use crate::progress::Quiet;

    #[test]
    fn a_late_clock_takes_the_place_of_a_low_pass_that_stood_in_for_it() {
        let mut problem = judged("kind = 'clock_offset'\nsensor = 'top'\noffset_s = 0.013");
        problem.tolerances = Tolerances { vs_ln: 0.2, damping_ln: 0.2, ..problem.tolerances };
        let (settings, replay) = (DiagnoseSettings::default(), Uniform(&problem));
        let mut scene = Scene::new(&problem, &settings).unwrap();
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        let nuisance = |kind: &str| search.nuisances.iter().position(|n| n.instance.kind == kind).unwrap();
        let mut x = vec![0.0; search.nuisances.len()];
        x[nuisance("layer_velocity")] = 0.75f64.ln() / search.nuisances[nuisance("layer_velocity")].deviation;
        x[nuisance("small_strain_damping")] =
            1.5f64.ln() / search.nuisances[nuisance("small_strain_damping")].deviation;
        x.push(std::f64::consts::TAU * 0.0065);
        let is_low_pass = |i: &&Instance| i.kind == "instrument_low_pass" && i.place() == "top";
        let effects = [search.instances.iter().find(is_low_pass).unwrap().clone()];
        let anchor = scene.look_around(&replay, &settings, (&effects, &x), &Quiet).unwrap();
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        let corrected = search.settle(&effects, &x, &anchor, None, 6).unwrap();
        let mut path = path(corrected, anchor);
        path.try_stand_ins(&mut scene, (&replay, &settings), &Quiet).unwrap();
        let named = &path.corrected.effects[0];
        assert_eq!((named.kind, named.place().as_str()), ("clock_offset", "top"));
        assert!((path.corrected.x().last().unwrap() - 0.013).abs() < 0.001, "{:?}", path.corrected.x());
    }

    #[test]
    fn what_says_the_same_makes_the_answer_ambiguous_and_what_is_plainer_takes_its_place() {
        let mut problem = judged("");
        // Twice the noise that is there: nothing but noise is to be left wherever replays lead.
        problem.events.iter_mut().for_each(|e| e.noise = vec![NoiseSpectrum::white(0.02, DT_S); 3]);
        problem.tolerances = Tolerances { vs_ln: 0.2, damping_ln: 0.1, ..problem.tolerances };
        let (settings, replay) = (DiagnoseSettings::default(), Uniform(&problem));
        // The truth has 150 m/s and a damping ratio of 0.03 = 0.02 m + 0.02 α, of which the tolerance has some.
        for (deviations, stand_ins, kind) in
            [(1.0f64, &["small_strain_damping"][..], "frequency_dependent_damping"), (3.4, &[], "small_strain_damping")]
        {
            let mut scene = Scene::new(&problem, &settings).unwrap();
            let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
            let nuisance = |kind: &str| search.nuisances.iter().position(|n| n.instance.kind == kind).unwrap();
            let mut x = vec![0.0; search.nuisances.len()];
            x[nuisance("layer_velocity")] = 0.75f64.ln() / 0.2;
            x[nuisance("small_strain_damping")] = deviations;
            x.push(1.5 - (0.1 * deviations).exp());
            let is_alpha = |i: &&Instance| i.free.len() == 1 && i.free[0].parameter.name == "alpha_1_s";
            let alpha = search.instances.iter().find(is_alpha).unwrap().clone();
            let effects = [alpha];
            let anchor = scene.look_around(&replay, &settings, (&effects, &x), &Quiet).unwrap();
            let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
            let corrected = search.settle(&effects, &x, &anchor, None, 0).unwrap();
            let mut path = path(corrected, anchor);
            path.try_stand_ins(&mut scene, (&replay, &settings), &Quiet).unwrap();
            assert_eq!(path.stand_ins, stand_ins, "{deviations}");
            assert_eq!([path.accepted[0].instance.kind, path.corrected.effects[0].kind], [kind; 2], "{deviations}");
        }
    }
}
