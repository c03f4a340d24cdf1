//! A posterior with several modes: where what is declared may be so far off that waves arrive by a part of their period earlier or later,
//! the fit that a start leads to is one of many.

use super::scan::Ground;
use super::{Competition, FAR, has_set};
use crate::effects::Instance;
use crate::error::Result;
use crate::inference::parameters::Model;
use crate::inference::posterior::{Fit, Start, Stop};
use crate::inference::spread::band_hz;
use crate::numerics::random;
use crate::numerics::threads::on_threads;
use crate::progress::Progress;
use rand_distr::{Distribution, StandardNormal};

/// Deviation of the time that waves take through the declared column, in periods of the highest frequency, below which a posterior has
/// one mode: as far as a fit finds the right cycle.
///
/// Source: Bunks et al. (1995), doi 10.1190/1.1443880: half a period, here for the farthest that is to be expected, two deviations.
const ONE_MODE: f64 = 0.25;
/// Draws from the prior of what is declared from which fits to the equivalent-linear column start, how many of these are replayed, and how
/// many of them are fitted to all events.
const DRAWS: usize = 16;
const REPLAYED: usize = 4;
const FITTED: usize = 2;

impl<'a> Competition<'a> {
    /// Whether fits from different declared values may end at different modes.
    pub(super) fn has_modes(&self) -> bool {
        let problem = self.fitter.forward.problem;
        let deviation_s = problem.tolerances.vs_ln * problem.array.profile.travel_time_s();
        deviation_s * band_hz(self.fitter.forward)[1] > ONE_MODE
    }

    /// Fits the most probable model under `labels` from draws of what is declared, by the equivalent-linear column, in few events and in
    /// all, and keeps where these ended. Whether one does better than where it was.
    pub(super) fn explore(&mut self, labels: &[usize], progress: &dyn Progress) -> Result<bool> {
        let leading = self.leading(labels).clone();
        if !self.has_modes() || has_set(&self.explored, &leading.model.effects) {
            return Ok(false);
        }
        self.explored.push(leading.model.effects.clone());
        let by = self.few.fitter(&self.fitter);
        let own = self.few.of(&by, &leading)?;
        let Some(ground) = Ground::declared(&by, own.model.clone(), own.x.clone()) else { return Ok(false) };
        let starts = draws(&own.model, &own.x);
        let fitted = |i: usize| ground.fitted_from(starts[i].clone());
        let mut found: Vec<Fit<'a>> = on_threads(starts.len(), fitted).into_iter().flatten().collect();
        self.best_first(&mut found);
        let mut found = Self::replayed(&by, &found.iter().take(REPLAYED).collect::<Vec<_>>());
        self.best_first(&mut found);
        self.modes = vec![leading.clone()];
        let least = self.log_posterior(&own) - FAR;
        found.retain(|fit| self.log_posterior(fit) > least);
        for fit in found.into_iter().take(FITTED) {
            let model = Model { declared: leading.model.declared, effects: fit.model.effects };
            let Ok(fit) = self.fitter.fit(Start::at(model, fit.x), Stop::CLOSE) else { continue };
            progress.note(&self.described(&fit));
            self.modes.push(fit.clone());
            self.keep(fit);
        }
        let best = self.known(&leading.model.effects).map(|i| self.fits[i].clone());
        let is_better = best.as_ref().is_some_and(|best| self.log_posterior(best) > self.log_posterior(&leading));
        self.modes.retain(|mode| best.as_ref().is_some_and(|best| !Self::is_near(best, mode)));
        Ok(is_better)
    }

    /// Fits anew whatever does better where another close model has what is declared: what ended at another mode is no match for it.
    pub(super) fn exchange_modes(&mut self, labels: &[usize]) -> Result<()> {
        if !self.has_modes() {
            return Ok(());
        }
        let leading = self.leading(labels).clone();
        let least = self.log_posterior(&leading) - FAR;
        let is_close = |fit: &&Fit<'a>| fit.labels() == labels && self.log_posterior(fit) > least;
        let close: Vec<Fit<'a>> = self.fits.iter().filter(is_close).cloned().collect();
        for fit in &close {
            self.follow(fit, &leading)?;
            self.follow(&leading, fit)?;
        }
        Ok(())
    }

    /// Fits the model of `to` anew from the declared values of `from` if it does better there.
    fn follow(&mut self, to: &Fit<'a>, from: &Fit<'a>) -> Result<()> {
        let x = moved(to, from);
        let Some(index) = self.known(&to.model.effects) else { return Ok(()) };
        if self.fitter.cost_at(&to.model, x.clone()).is_ok_and(|cost| cost < self.fits[index].cost) {
            let fit = self.fitter.fit(Start::at(to.model.clone(), x), Stop::CLOSE)?;
            self.keep(fit);
        }
        Ok(())
    }
}

/// Coordinates of `to` with what is declared, and the effects that both have, as in `from`.
fn moved(to: &Fit<'_>, from: &Fit<'_>) -> Vec<f64> {
    let n = to.model.declared.len();
    let of = |(index, effect): (usize, &Instance)| match from.model.index_of(effect) {
        Some(other) => from.x[from.model.coordinates_of(other)].to_vec(),
        None => to.x[to.model.coordinates_of(index)].to_vec(),
    };
    from.x[..n].iter().copied().chain(to.model.effects.iter().enumerate().flat_map(of)).collect()
}

/// Coordinates of `model` with what is declared drawn from its prior, and effects as at `x`.
fn draws(model: &Model<'_>, x: &[f64]) -> Vec<Vec<f64>> {
    let (prior, bounds, n) = (model.prior(), model.bounds(), model.declared.len());
    let of = |draw: usize| {
        let mut normal = StandardNormal.sample_iter(random::stream(draw as u64, "modes of a posterior"));
        let declared = prior[..n].iter().zip(&bounds).map(|([mean, sd], [low, high])| {
            let z: f64 = normal.next().unwrap_or_default();
            (mean + sd * z).clamp(*low, *high)
        });
        declared.collect::<Vec<_>>().into_iter().chain(x[n..].iter().copied()).collect()
    };
    (0..DRAWS).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::super::super::few::{self, Few};
    use super::super::super::forward::Forward;
    use super::super::super::made_up::{Truth, Uniform, problem};
    use super::super::super::parameters::Declared;
    use super::super::super::weights::Expected;
    use super::*;
    use crate::diagnosis::DiagnoseSettings;
    use crate::inference::posterior::Fitter;
    use crate::progress::Quiet;
    use std::sync::Arc;

    #[test]
    fn a_fit_that_ended_at_another_cycle_is_found_out() {
        let mut problem = problem(&Truth { soil: [270.0, 0.02], events: 3, ..Truth::default() });
        problem.tolerances.vs_ln = 0.3;
        let replay = Uniform(&problem);
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        let declared = Declared::new(&problem).unwrap();
        forward.anchor(&[]).unwrap();
        let model = Model { declared: &declared, effects: Vec::new() };
        let mut x = vec![0.0; model.len()];
        x[0] = -2.0;
        let there = Arc::new(forward.predict(&model.tables(&x)).unwrap());
        let fitter = Fitter::new(&forward, Expected::of(&forward, there));
        let stuck = fitter.fit(Start::at(model, x), Stop::CLOSE).unwrap();
        let velocity = |fit: &Fit<'_>| -> f64 {
            let tables = fit.model.tables(&fit.x);
            200.0 * tables.iter().filter_map(|t| t.get("ln_factor")?.as_float()).sum::<f64>().exp()
        };
        assert!(velocity(&stuck) < 200.0, "{}", velocity(&stuck));
        let in_few = forward.in_groups(&few::groups(&forward));
        let few = Few { forward: &in_few, declared: &declared.in_events(&in_few) };
        let mut competition = Competition::new(fitter, stuck, few, 4);
        let labels = competition.fits[0].labels().to_vec();
        assert!(competition.explore(&labels, &Quiet).unwrap());
        let found = velocity(&competition.fits[0]);
        assert!((found / 270.0 - 1.0).abs() < 0.02, "{found}");
        // Where it was is another mode of the same model; there it is not looked for again.
        assert!(competition.modes.iter().any(|mode| velocity(mode) < 200.0));
        assert!(!competition.explore(&labels, &Quiet).unwrap());
    }
}
