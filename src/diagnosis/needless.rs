//! Replays around a model with its effects, and whether it needs them all.

use super::anchor::Anchor;
use super::diagnose::STEPS;
use super::outcome::Thresholds;
use super::path::Path;
use super::places::worthwhile;
use super::problem::Replay;
use super::responses::Scene;
use super::round::parameters;
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use super::settling::MAX_ANCHORS;
use super::verdict::reach;
use crate::effects::Class;
use crate::error::Result;
use crate::progress::Progress;

/// Share of the gain of an effect below which nothing else is an effect of its own: described to a tenth of what it does to the
/// motions, an effect leaves a hundredth of what it gained.
const DETAIL: f64 = 0.01;
/// The same for an effect in doubt: no column does to motions what an effect does to better than a hundredth.
const EXACTNESS: f64 = 1e-4;
/// Share of the typical size of an effect below which it is in doubt.
const SMALL: f64 = 0.1;
/// Most replays of a model without one of its effects.
const REPLAYS: usize = 6;
/// Most looks around a model with its effects: the replays around a place say less of the next, and a valley is walked in steps.
const POLISHES: usize = 3;

impl Scene<'_> {
    /// `model` settled with replays around it, and around where that leads, as long as it pays. These are followed from then on.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn polished(
        &mut self,
        mut model: Model,
        replay: &dyn Replay,
        settings: &DiagnoseSettings,
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let mut looks = 0;
        loop {
            let before = model;
            let place = (&before.effects[..], before.x());
            let (now, anchor) = self.settled_around(place, (replay, MAX_ANCHORS), settings, progress)?;
            progress.note(&format!("polished: {:.0} before, {:.0} now", before.cost(), now.cost()));
            looks += 1;
            if now.is_clean() {
                return Ok((now, anchor));
            }
            // From far off, what comes next leads farther than this valley.
            if !now.is_far() {
                return self.walked((now, anchor), replay, settings, progress);
            }
            if looks == POLISHES || now.cost() > before.cost() - worthwhile(&before, settings) {
                return Ok((now, anchor));
            }
            model = now;
        }
    }

    /// The `model` walked on along the valley in which it is, with replays nearer than tolerances; then it is looked at as before.
    fn walked(
        &mut self,
        (model, anchor): (Model, Anchor),
        replay: &dyn Replay,
        settings: &DiagnoseSettings,
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let here = (model.clone(), anchor.clone());
        let found = self.clone().settled_closely(here, replay, settings, progress)?.0;
        if found.cost() > model.cost() - worthwhile(&model, settings) {
            return Ok((model, anchor));
        }
        self.settled_around((&found.effects, found.x()), (replay, MAX_ANCHORS), settings, progress)
    }
}

impl Search<'_> {
    /// Takes out effects that would raise no alarm any more: later ones, or the replays around them, have made them needless.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn drop_needless(
        &self,
        path: &mut Path,
        thresholds: &Thresholds,
        progress: &dyn Progress,
    ) -> Result<()> {
        self.drop(path, |_, _| true, thresholds, progress)
    }

    /// The same of effects alone that are in doubt.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn drop_doubtful(
        &self,
        path: &mut Path,
        thresholds: &Thresholds,
        progress: &dyn Progress,
    ) -> Result<()> {
        self.drop(path, |path, index| self.is_doubtful(path, index), thresholds, progress)
    }

    /// The same of those that `is_asked` about.
    fn drop(
        &self,
        path: &mut Path,
        is_asked: impl Fn(&Path, usize) -> bool,
        thresholds: &Thresholds,
        progress: &dyn Progress,
    ) -> Result<()> {
        let mut index = 0;
        while index < path.accepted.len() {
            let is_dropped = is_asked(path, index) && self.dropped(path, index, thresholds, progress)?;
            index += usize::from(!is_dropped);
        }
        Ok(())
    }

    /// Whether the effect of `path` at `index` is not told from nothing, or far smaller than such effects are.
    fn is_doubtful(&self, path: &Path, index: usize) -> bool {
        let model = &path.corrected;
        let unknowns = self.unknowns(&model.effects);
        let own = unknowns.start(index);
        let instance = &model.effects[index];
        let Some((zero, free)) = instance.zero().and_then(|z| z.first().copied()).zip(instance.free.first()) else {
            return false;
        };
        let deviation = self.fitter(&path.anchor).deviations(&unknowns, &model.train, model.level())[own];
        (model.x()[own] - zero).abs() < (reach(self) * deviation).max(SMALL * free.size)
    }

    /// Takes the effect of `path` at `index` out if it is needless, and says whether it was.
    fn dropped(&self, path: &mut Path, index: usize, thresholds: &Thresholds, progress: &dyn Progress) -> Result<bool> {
        let fitted = self.fitted_without(path, index)?;
        let at_stake = path.corrected.cost();
        let without = self.replayed_until_settled(fitted, (None, &path.anchor), (REPLAYS, at_stake), progress)?;
        let is_needless = self.is_needless(path, index, &without.0, thresholds);
        if is_needless {
            path.take_out(index, without, progress);
        }
        Ok(is_needless)
    }

    /// The model without one of its effects, whose velocities may have been the tolerances' all along.
    fn fitted_without(&self, path: &Path, index: usize) -> Result<Model> {
        let (effects, mut x) = self.without(&path.corrected.effects, path.corrected.x(), index)?;
        self.unknowns(&effects).clip(&mut x);
        self.settle(&effects, &x, &path.anchor, None, STEPS)
    }

    /// Whether the effect of `path` at `index` would raise no alarm beside `without`.
    fn is_needless(&self, path: &Path, index: usize, without: &Model, thresholds: &Thresholds) -> bool {
        let own = &path.corrected.effects[index];
        if self.scene.is_stiff() && without.is_clean() && path.corrected.is_clean() {
            return self.plainer(without, &path.corrected, own) < thresholds.gain;
        }
        // Where nothing is left that asks for an effect, a small one has taken the place of tolerances.
        let is_doubtful = self.is_doubtful(path, index);
        if without.excess() <= 0.0 && !without.is_strained() && is_doubtful {
            return true;
        }
        let others = path.accepted.iter().enumerate().filter(|(i, _)| *i != index);
        let least = least_gain(others.map(|(_, f)| f.gain), (&path.corrected, is_doubtful), thresholds);
        path.fall(without) - self.charge() * parameters(own) < least
    }
}

/// Least gain of an effect beside others with these `gains`, where the model `with` all of them is this: more than a detail of any of
/// them could. Where nothing but noise is left, of which no detail is a part, only what is in doubt can be one.
pub(super) fn least_gain(
    gains: impl Iterator<Item = f64>,
    (with, is_doubtful): (&Model, bool),
    thresholds: &Thresholds,
) -> f64 {
    let detail = match (with.is_clean(), is_doubtful) {
        (false, _) => DETAIL,
        (true, true) => EXACTNESS,
        (true, false) => 0.0,
    };
    thresholds.gain.max(detail * gains.fold(0.0, f64::max))
}

impl Path {
    fn take_out(&mut self, index: usize, without: (Model, Anchor), progress: &dyn Progress) {
        let own = &self.corrected.effects[index];
        progress.note(&format!("{} {} gains {:.0} no more", own.kind, own.place(), self.fall(&without.0)));
        (self.corrected, self.anchor) = without;
        self.accepted.remove(index);
    }

    /// By how much `other` costs more than the corrected model, in units of the level of what is left.
    fn fall(&self, other: &Model) -> f64 {
        (other.cost() - self.corrected.cost()) / self.corrected.level().max(1.0)
    }

    /// Where an effect of the soil is there twice, takes out one that the other can stand for once it is seen from replays around itself:
    /// what lies between two places was found at neither. The second of a kind is a detail of the first where it does a hundredth
    /// of what both do.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn say_once(
        &mut self,
        scene: &mut Scene<'_>,
        settings: &DiagnoseSettings,
        replay: &dyn Replay,
        progress: &dyn Progress,
    ) -> Result<()> {
        let mut index = 0;
        while index < self.accepted.len() {
            let own = &self.corrected.effects[index];
            let is_twice = self.corrected.effects.iter().filter(|e| e.is_alike(own)).count() > 1;
            if is_twice && own.class() == Class::Soil {
                let around_both = scene.clone();
                let alone = Search::new(scene, settings, Some(replay))?.fitted_without(self, index)?;
                let mut alone = scene.polished(alone, replay, settings, progress)?;
                if alone.0.is_far() {
                    alone = scene.walked(alone, replay, settings, progress)?;
                }
                let without = scene.moved((alone, None), replay, settings, progress)?;
                if self.fall(&without.0) < DETAIL * self.fall(&self.recalibrated) {
                    self.take_out(index, without, progress);
                    continue;
                }
                *scene = around_both;
            }
            index += 1;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{DT_S, judged};
    use super::super::problem::NoiseSpectrum;
    use super::*;
    use crate::diagnosis::DiagnoseSettings;

    #[test]
    fn beside_a_large_effect_a_small_one_is_a_detail() {
        let (validation_gain, excess, deviations) = (0.0, 3.0, 3.0);
        let thresholds =
            Thresholds { gain: 20.0, validation_gain, excess, deviations, twins: 20, null_gains: Vec::new() };
        // Noise as it is, of which far more is left, and so much that nothing else is.
        for (noise, doubtful, certain) in [(0.01, 1e4, 1e4), (100.0, 100.0, 20.0)] {
            let mut problem = judged("");
            problem.events.iter_mut().for_each(|e| e.noise = vec![NoiseSpectrum::white(noise, DT_S); 3]);
            let settings = DiagnoseSettings::default();
            let scene = Scene::new(&problem, &settings).unwrap();
            let search = Search::new(&scene, &settings, None).unwrap();
            let x = vec![0.0; search.nuisances.len()];
            let model = search.settle(&[], &x, &Anchor::fast(&scene), None, 0).unwrap();
            assert_eq!(model.is_clean(), noise > 1.0, "{:?}", model.surprise());
            let least = |is_doubtful| least_gain([3.0, 1e6].into_iter(), (&model, is_doubtful), &thresholds);
            assert_eq!([least(true), least(false)], [doubtful, certain]);
        }
    }
}
