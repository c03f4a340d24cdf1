//! The answer looked at closely: derivatives from replays so near that nothing between them turns in phase.

use super::anchor::Anchor;
use super::axes::{Axis, Node, has_axis};
use super::neighbours::{Replayed, Soil};
use super::problem::{Motions, Replay};
use super::responses::Scene;
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use super::settling::MAX_ANCHORS;
use super::unknowns::{Nuisance, Unknowns, common_velocity, nuisances};
use crate::effects::Instance;
use crate::error::Result;
use crate::numerics::threads::on_threads;
use crate::progress::Progress;
use std::sync::Arc;

/// What a step may change residuals by, squared, as a share of their number.
const MOVED: f64 = 0.03;
/// Most looks: a curved valley is walked in steps.
const LOOKS: usize = 3;
/// Most steps of a fit.
const STEPS: usize = 12;
/// Share of the cost that a look must take off for another to follow.
const PAYS: f64 = 0.01;

impl Scene<'_> {
    /// The `model` settled with derivatives right where it is, as long as that pays, and as its best replay has it; the scene looks around
    /// there.
    ///
    /// Effects and tolerances that nearly make up for each other leave a valley in which derivatives that are wrong by a tenth show a
    /// slope where there is none: the answer stays where it first came upon the valley, and seems known there.
    ///
    /// Check:  `derivatives_are_those_of_replays`.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn settled_closely(
        &mut self,
        (mut model, mut anchor): (Model, Anchor),
        replay: &dyn Replay,
        settings: &DiagnoseSettings,
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        for _ in 0..LOOKS {
            let steps = Search::new(self, settings, Some(replay))?.steps(&model, &anchor);
            let place = (&model.effects[..], model.x());
            let motions = self.look_closely(replay, (place.0, place.1, &steps), progress)?;
            let around = Search::new(self, settings, Some(replay))?.anchor(place, &motions, None)?.0;
            let search = Search::new(self, settings, Some(replay))?;
            let here = search.settle(&model.effects, model.x(), &around, None, 0)?;
            let wanted = search.settle(&model.effects, model.x(), &around, Some(&here), STEPS)?;
            let best = Some((here, around.clone()));
            let found = search.replayed(wanted, (best, &around), (MAX_ANCHORS, f64::INFINITY), progress)?;
            let (before, now) = (model.cost(), found.0.cost());
            progress.note(&format!("looked at closely: {before:.0} before, {now:.0} now"));
            (model, anchor) = found;
            if now > (1.0 - PAYS) * before {
                break;
            }
        }
        Ok((model, anchor))
    }

    /// Replays around the unknowns `x`, one of [`Replay::replay`] to each unknown that moves the ground, these `steps` away. What the
    /// column makes of noise in its input stays as it was heard. The motions at `x`.
    fn look_closely(
        &mut self,
        replay: &dyn Replay,
        (instances, x, steps): (&[Instance], &[f64], &[f64]),
        progress: &dyn Progress,
    ) -> Result<Motions> {
        let nuisances = &nuisances(self.problem)?;
        let unknowns = Unknowns { nuisances, effects: instances.to_vec(), axes: Some(&[]) };
        let common = common_velocity(nuisances);
        let mut moves: Vec<usize> = Vec::new();
        let soil = |(i, n): (usize, &Nuisance)| {
            let mut own = n.is_shaken.then(|| Soil::of(n))?;
            moves.push(i);
            own.up = Some(moves.len());
            own.step = steps[i];
            // All velocities together are one more way here, not the layers' once more.
            own.range = own.range.filter(|_| Some(i) != common);
            Some(own)
        };
        let soil: Vec<Option<Soil>> = nuisances.iter().enumerate().map(soil).collect();
        let along = || instances.iter().enumerate().filter(|(_, i)| has_axis(i)).map(|(k, i)| (i, unknowns.start(k)));
        let first = moves.len() + 1;
        moves.extend(along().map(|(_, at)| at));
        let bounds = unknowns.bounds();
        // A nuisance at its end may be replayed a step beyond.
        let is_beyond = |i: usize| i >= nuisances.len() && x[i] + steps[i] > bounds[i][1];
        let moved = |i: usize| if is_beyond(i) { x[i] - steps[i] } else { x[i] + steps[i] };
        progress.start("neighbours", moves.len() as u64);
        let run = |k: usize| -> Result<Arc<Replayed>> {
            let mut x = x.to_vec();
            x[moves[k]] = moved(moves[k]);
            let seen = self.seen(&replay.replay(&unknowns.tables(&x))?);
            progress.advance(1);
            Ok(Arc::new(seen))
        };
        let motions = replay.replay(&unknowns.tables(x))?;
        let mut all = self.around(&unknowns, x, soil, self.seen(&motions))?;
        all.replays.extend(on_threads(moves.len(), run).into_iter().collect::<Result<Vec<_>>>()?);
        let axis = |(k, (instance, i)): (usize, (&Instance, usize))| {
            let same = nuisances.iter().position(|n| n.is_same(instance)).map_or(0.0, |n| x[n]);
            let node = |coordinate, replay| Node { coordinate, replay, from: 0 };
            Axis::new(instance, vec![node(x[i], 0), node(moved(i), first + k)], same)
        };
        all.axes = along().enumerate().map(axis).collect();
        all.centre = self.centre(&all, &unknowns, x)?;
        self.neighbours = Some(Arc::new(all));
        Ok(motions)
    }
}

impl Search<'_> {
    /// Steps of the unknowns of `model` that change its residuals by what [`MOVED`] says, prior standard deviations and coordinates;
    /// at most one of [`Unknowns::deviations`].
    fn steps(&self, model: &Model, anchor: &Anchor) -> Vec<f64> {
        let unknowns = self.unknowns(&model.effects);
        let all: Vec<usize> = (0..unknowns.len()).collect();
        let jacobian = self.fitter(anchor).jacobian(&unknowns, &model.train, &all);
        let allowed = MOVED * model.train.residual.len() as f64;
        let step = |(i, largest): (usize, f64)| {
            let square: f64 = jacobian.col(i).iter().map(|d| d * d).sum();
            if square > 0.0 { (allowed / square).sqrt().min(largest) } else { largest }
        };
        unknowns.deviations().into_iter().enumerate().map(step).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Uniform, judged};
    use super::*;
    use crate::effects;
    use crate::manifest::Tolerances;
    use crate::progress::Quiet;

    #[test]
    fn derivatives_are_those_of_replays() {
        let mut problem = judged("");
        problem.tolerances = Tolerances { vs_ln: 0.2, damping_ln: 0.2, ..problem.tolerances };
        let settings = DiagnoseSettings::default();
        let replay = Uniform(&problem);
        let mut scene = Scene::new(&problem, &settings).unwrap();
        let is_alpha = |i: &Instance| i.free.len() == 1 && i.free[0].parameter.name == "alpha_1_s";
        let effects: Vec<Instance> = effects::instances(&problem.array).into_iter().filter(is_alpha).collect();
        let n = nuisances(&problem).unwrap();
        // 150 m/s and a damping ratio of 0.02 · 1.2 + 0.02 · 0.3, as in the records.
        let value = |n: &Nuisance| match n.instance.kind {
            "layer_velocity" if n.deviation == 0.2 => 0.75f64.ln() / 0.2,
            "small_strain_damping" => 1.2f64.ln() / 0.2,
            _ => 0.0,
        };
        let x: Vec<f64> = n.iter().map(value).chain([0.3]).collect();
        // From steps as wide as tolerances, and from such as the residuals allow.
        let anchor = scene.look_around(&replay, &settings, (&effects, &x), &Quiet).unwrap();
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        let model = search.settle(&effects, &x, &anchor, None, 0).unwrap();
        let steps = search.steps(&model, &anchor);
        let mut close = scene.clone();
        close.look_closely(&replay, (&effects, &x, &steps), &Quiet).unwrap();
        let wrong = |scene: &Scene<'_>, i: usize| {
            let search = Search::new(scene, &settings, Some(&replay)).unwrap();
            let anchor = search.anchored(&effects, &x, None).unwrap();
            let at = |x: &[f64], anchor| search.settle(&effects, x, anchor, None, 0).unwrap().train.residual;
            let mut there = x.clone();
            there[i] += 0.5 * steps[i];
            let (here, expected) = (at(&x, &anchor), at(&there, &anchor));
            let found = at(&there, &search.anchored(&effects, &there, None).unwrap());
            let far = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            far(&expected, &found) / far(&found, &here)
        };
        let is_soil = |n: &Nuisance| ["layer_velocity", "small_strain_damping"].contains(&n.instance.kind);
        let shaken = (0..=n.len()).filter(|i| n.get(*i).is_none_or(is_soil));
        let mut worst = [0.0f64; 2];
        for i in shaken {
            let [wide, near] = [wrong(&scene, i), wrong(&close, i)];
            assert!(near < 0.02, "unknown {i}: {near}");
            worst = [worst[0].max(wide), worst[1].max(near)];
        }
        assert!(worst[0] > 3.0 * worst[1], "{worst:?}");
    }
}
