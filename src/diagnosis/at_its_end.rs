//! A tolerance that went as far as it may, beside an effect that makes up for the rest: it may be the effect itself.

use super::anchor::Anchor;
use super::places::is_preferred;
use super::problem::Replay;
use super::responses::Scene;
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use super::settling::MAX_ANCHORS;
use crate::error::Result;
use crate::progress::Progress;

/// Prior standard deviations at which a tolerance is as good as at its end.
const END: f64 = 3.0;

impl Scene<'_> {
    /// The `model`, or where tolerances are at their end, the one in which what these stand for is an effect instead of the last: it
    /// leaves clearly less, or no more than noise with tolerances closer to what is declared. The scene looks around there.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn beyond_tolerance(
        &mut self,
        (model, anchor): (Model, Anchor),
        replay: &dyn Replay,
        settings: &DiagnoseSettings,
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        let Some(wanted) = Search::new(self, settings, Some(replay))?.at_its_end(&model, &anchor)? else {
            return Ok((model, anchor));
        };
        let mut there = self.clone();
        let found = there.settled_around((&wanted.effects, wanted.x()), (replay, MAX_ANCHORS), settings, progress)?;
        let last = wanted.effects.last().map_or("", |e| e.kind);
        progress.note(&format!("{last} beyond its tolerance: cost {:.0}, {:.0} so far", found.0.cost(), model.cost()));
        if is_preferred(&found.0, &model, settings) {
            *self = there;
            return Ok(found);
        }
        Ok((model, anchor))
    }
}

impl Search<'_> {
    /// `model` with its last effect taken out and, as an effect, what a tolerance at its end stands for, where that costs least from the
    /// `anchor`.
    fn at_its_end(&self, model: &Model, anchor: &Anchor) -> Result<Option<Model>> {
        let is_far = |n: usize| model.x()[n].abs() >= END;
        let kinds: Vec<&str> =
            (0..self.nuisances.len()).filter(|n| is_far(*n)).map(|n| self.nuisances[n].instance.kind).collect();
        let Some(last) = model.effects.len().checked_sub(1).filter(|_| !kinds.is_empty()) else { return Ok(None) };
        self.stand_in((model, last), &kinds, anchor)
    }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{DT_S, Uniform, judged};
    use super::super::problem::NoiseSpectrum;
    use super::*;
    use crate::effects::Instance;
    use crate::manifest::Tolerances;
    use crate::progress::Quiet;

    #[test]
    fn a_velocity_at_the_end_of_its_tolerance_is_the_effect() {
        let mut problem = judged("");
        // The truth has 150 m/s instead of 200, as far from what is declared as a tolerance may go.
        problem.tolerances = Tolerances { vs_ln: 0.75f64.ln() / -3.5, damping_ln: 0.3, ..problem.tolerances };
        // With the surface alone, velocities are looked for in the whole column, as the made-up one knows them.
        problem.array.outputs.remove(0);
        problem.array.depths_m.remove(0);
        for event in &mut problem.events {
            event.outputs.remove(0);
            // Twice the noise that is there: nothing but noise is to be left wherever replays lead.
            event.noise = vec![NoiseSpectrum::white(0.02, DT_S); 2];
        }
        let (settings, replay) = (DiagnoseSettings::default(), Uniform(&problem));
        let mut scene = Scene::new(&problem, &settings).unwrap();
        let search = Search::new(&scene, &settings, Some(&replay)).unwrap();
        let velocity = search.nuisances.iter().position(|n| n.instance.kind == "layer_velocity").unwrap();
        let mut x = vec![0.0; search.nuisances.len()];
        x[velocity] = -3.5;
        x.push(0.0001);
        let is_beta = |i: &&Instance| i.kind == "frequency_dependent_damping" && i.free[0].parameter.name == "beta_s";
        let effects = vec![search.instances.iter().find(is_beta).unwrap().clone()];
        let anchor = scene.look_around(&replay, &settings, (&effects, &x), &Quiet).unwrap();
        let model =
            Search::new(&scene, &settings, Some(&replay)).unwrap().settle(&effects, &x, &anchor, None, 0).unwrap();
        let (found, there) =
            scene.beyond_tolerance((model.clone(), anchor.clone()), &replay, &settings, &Quiet).unwrap();
        assert_eq!(found.effects.iter().map(|e| e.kind).collect::<Vec<_>>(), ["layer_velocity"]);
        assert!(found.x()[velocity].abs() < 1.0 && found.cost() < model.cost(), "{:?}", found.x());
        let again = scene.beyond_tolerance((found.clone(), there), &replay, &settings, &Quiet).unwrap().0;
        assert_eq!(again.x(), found.x(), "no tolerance is at its end any more");
    }
}
