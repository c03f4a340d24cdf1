//! Of the models that leave no more than noise, the one closest to what is declared.

use super::anchor::Anchor;
use super::places::is_plainer;
use super::problem::Replay;
use super::responses::Scene;
use super::round::parameters;
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use super::settling::MAX_ANCHORS;
use crate::effects::{self, Instance};
use crate::error::Result;
use crate::progress::Progress;

/// Weight of the priors on the way back to what is declared. Noise leaves open what costs a few units; replays of two places that
/// are as good differ by ten.
pub(super) const STIFFNESS: f64 = 10.0;
/// The same of a tolerance that is held at what is declared.
const HELD: f64 = 1e6;
/// Prior standard deviations beyond which that is tried.
const FAR: f64 = 2.0;
/// The same where it makes a model that is an alternative.
const UNLIKELY: f64 = 1.0;
/// Steps of the fit there.
const STEPS: usize = 12;
/// What an effect is put back by that leaves more than noise.
const LEFT: f64 = 50.0;

impl Scene<'_> {
    /// Whether effects are looked for that tolerances have made up for.
    pub(super) fn is_stiff(&self) -> bool {
        self.stiffness > 1.0
    }

    /// The `model` with its tolerances as close to what is declared as noise lets its effects make up for them:
    ///
    /// ```text
    /// min |ρ|² + w |n|²,   |ρ|² no more than noise,   w = 10
    /// ```
    ///
    /// and before that the same with each tolerance that is confused with an effect of the model held at what is declared: on the way
    /// there, derivatives are not good enough to stay in so narrow a valley. Costs of replays differ by more than what a tolerance at
    /// its end costs, so that fits with w = 1 leave it there. Stays as it is where more than noise is left, or where tolerances are no
    /// farther than chance puts them. The scene looks around there.
    ///
    /// Source: Morozov (1966): the discrepancy principle.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn relaxed(
        &mut self,
        here: (Model, Anchor),
        replay: &dyn Replay,
        settings: &DiagnoseSettings,
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let shared = Search::new(self, settings, Some(replay))?.shared_with(&here.0.effects, &here.0, FAR);
        let held = shared.into_iter().map(|i| vec![i]).chain([Vec::new()]).collect();
        self.relaxed_holding(held, here, (replay, settings), progress)
    }

    /// The same, each of these lists of tolerances being `held` in turn.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn relaxed_holding(
        &mut self,
        held: Vec<Vec<usize>>,
        (mut model, mut anchor): (Model, Anchor),
        (replay, settings): (&dyn Replay, &DiagnoseSettings),
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        if !model.is_clean() || model.strain() <= 0.0 {
            return Ok((model, anchor));
        }
        for held in held {
            let mut there = self.clone();
            let search = Search::new(&there, settings, Some(replay))?;
            let mut found = search.released(&model.effects, model.x(), (&anchor, &held), progress)?;
            if !held.is_empty() {
                let (effects, x) = (&found.0.effects, found.0.x());
                let around = there.look_around(replay, settings, (effects, x), progress)?;
                let search = Search::new(&there, settings, Some(replay))?;
                found = search.released(effects, x, (&around, &held), progress)?;
            }
            let search = Search::new(&there, settings, Some(replay))?;
            let what = held.first().map_or("all".into(), |i| search.nuisances[*i].what());
            let (before, now) = (model.prior(), found.0.prior());
            progress.note(&format!("relaxed ({what}): tolerances {before:.0} before, {now:.0} now"));
            if is_plainer(&found.0, &model) {
                ((model, anchor), *self) = (found, there);
            }
        }
        Ok((model, anchor))
    }

    /// Estimates of models that leave no more than noise either, each with another parameter of an effect of the `model` in place of
    /// the tolerances that are confused with it: too weak to be named, it may be there. Each unknown with its standard deviation,
    /// those of the `model` first.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn alternatives(
        &self,
        (model, anchor): (&Model, &Anchor),
        replay: &dyn Replay,
        settings: &DiagnoseSettings,
        progress: &dyn Progress,
    ) -> Result<Vec<Vec<[f64; 2]>>> {
        let search = Search::new(self, settings, Some(replay))?;
        let mut found = Vec::new();
        if !model.is_clean() {
            return Ok(found);
        }
        let is_more = |i: &Instance| model.effects.iter().any(|e| e.kind == i.kind && e.target == i.target);
        for more in search.open(&model.effects).into_iter().filter(is_more) {
            let held = search.shared_with(std::slice::from_ref(&more), model, UNLIKELY);
            let Some(zero) = more.zero().filter(|_| !held.is_empty()) else { continue };
            let along = self.along_all(replay, std::slice::from_ref(&more))?;
            let search = Search::new(&along, settings, Some(replay))?;
            let (effects, x) = ([&model.effects[..], &[more]].concat(), [model.x(), &zero].concat());
            let (other, there) = search.released(&effects, &x, (anchor, &held), progress)?;
            if !other.is_clean() {
                continue;
            }
            let unknowns = search.unknowns(&effects);
            let deviations = search.fitter(&there).deviations(&unknowns, &other.train, other.level());
            found.push(other.x().iter().zip(deviations).map(|(x, d)| [*x, d]).collect());
        }
        Ok(found)
    }
}

impl Search<'_> {
    /// Settles the `effects` from `x` and `anchor` with stiff priors, those of the nuisances that are `held` being as declared.
    fn released(
        &self,
        effects: &[Instance],
        x: &[f64],
        (anchor, held): (&Anchor, &[usize]),
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let mut stiffness = vec![STIFFNESS; self.nuisances.len()];
        let mut x = x.to_vec();
        for held in held {
            stiffness[*held] = HELD;
            x[*held] = 0.0;
        }
        let stiff = Search { stiffness, ..Search::new(self.scene, self.settings, self.replay)? };
        let start = stiff.settle(effects, &x, anchor, None, STEPS)?;
        let from = (None, anchor);
        let (found, there) = stiff.replayed_until_settled(start, from, (MAX_ANCHORS, f64::INFINITY), progress)?;
        Ok((self.settle(effects, found.x(), &there, Some(&found), 0)?, there))
    }

    /// Tolerances more than so many prior standard deviations from what is declared whose kinds are confused with that of one
    /// of the `effects`.
    fn shared_with(&self, effects: &[Instance], model: &Model, deviations: f64) -> Vec<usize> {
        let confused: Vec<&str> = effects
            .iter()
            .filter_map(|e| effects::find(e.kind).ok())
            .flat_map(|e| e.catalogue.confused_with.iter().copied())
            .collect();
        let is_far =
            |i: &usize| model.x()[*i].abs() > deviations && confused.contains(&self.nuisances[*i].instance.kind);
        (0..self.nuisances.len()).filter(is_far).collect()
    }

    /// By how much tolerances cost less in the model `with` an effect than in `base`, less the charge; below nothing where it leaves
    /// more than noise.
    pub(super) fn plainer(&self, base: &Model, with: &Model, effect: &Instance) -> f64 {
        let gain = base.prior() - with.prior() - self.charge() * parameters(effect);
        if with.is_clean() { gain } else { gain.min(0.0) - LEFT }
    }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{DT_S, Uniform, judged};
    use super::super::problem::NoiseSpectrum;
    use super::*;
    use crate::manifest::Tolerances;
    use crate::progress::Quiet;

    #[test]
    fn a_tolerance_at_its_end_gives_way_to_the_effect_it_is_confused_with() {
        let mut problem = judged("");
        // Twice the noise that is there: nothing but noise is to be left wherever replays lead.
        problem.events.iter_mut().for_each(|e| e.noise = vec![NoiseSpectrum::white(0.02, DT_S); 3]);
        problem.tolerances = Tolerances { vs_ln: 0.2, damping_ln: 0.1, ..problem.tolerances };
        let (settings, replay) = (DiagnoseSettings::default(), Uniform(&problem));
        let mut scene = Scene::new(&problem, &settings).unwrap();
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        let nuisance = |kind: &str| search.nuisances.iter().position(|n| n.instance.kind == kind).unwrap();
        let [velocity, damping] = ["layer_velocity", "small_strain_damping"].map(nuisance);
        let mut x = vec![0.0; search.nuisances.len()];
        // The truth has 150 m/s and a damping ratio of 0.03.
        x[velocity] = 0.75f64.ln() / 0.2;
        x[damping] = 1.4f64.ln() / 0.1;
        x.push(0.00002);
        let is_beta = |i: &&Instance| i.kind == "frequency_dependent_damping" && i.free[0].parameter.name == "beta_s";
        let effects = vec![search.instances.iter().find(is_beta).unwrap().clone()];
        let anchor = scene.look_around(&replay, &settings, (&effects, &x), &Quiet).unwrap();
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        let model = search.settle(&effects, &x, &anchor, None, 0).unwrap();
        assert!(model.is_clean() && model.strain() > 0.0, "{:?} {}", model.surprise(), model.strain());
        let others = scene.alternatives((&model, &anchor), &replay, &settings, &Quiet).unwrap();
        let [other] = &others[..] else { panic!("{} alternatives", others.len()) };
        assert!(other.len() == x.len() + 1 && other[damping][0].abs() < 0.01);
        let [[beta_s, deviation], [alpha_1_s, _]] = other[x.len() - 1..] else { unreachable!() };
        assert!((100.0 * beta_s + 0.02 * alpha_1_s - 0.01).abs() < 0.0005, "{beta_s} {alpha_1_s}");
        let unknowns = search.unknowns(&effects);
        let alone = search.fitter(&anchor).deviations(&unknowns, &model.train, model.level())[x.len() - 1];
        assert!(alone < deviation && deviation.is_finite(), "{alone} {deviation}");
        let (found, _) = scene.relaxed((model, anchor), &replay, &settings, &Quiet).unwrap();
        let [multiplier, beta_s] = [x[damping], found.x()[x.len() - 1]];
        assert!(found.is_clean() && found.x()[damping].abs() < 0.1 * multiplier, "{}", found.x()[damping]);
        assert!((beta_s - 0.0001).abs() < 0.00001, "{beta_s}");
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        let gain =
            search.plainer(&search.settle(&effects, &x, &Anchor::fast(&scene), None, 0).unwrap(), &found, &effects[0]);
        assert!((gain - (multiplier.powi(2) - search.charge())).abs() < 2.0, "{gain}");
    }
}
