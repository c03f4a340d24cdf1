//! Fits from elsewhere: from where other models ended, and, where what is declared may be so far off that waves arrive by a part of their
//! period earlier or later, from draws of the prior: the posterior then has several modes, and the fit that a start leads to is one of many.

use super::{Competition, FAR, coordinates, has_set, is_same_set};
use crate::error::Result;
use crate::inference::forward::Label;
use crate::inference::posterior::{Fit, Start, Stop};
use crate::inference::spread::band_hz;
use crate::numerics::random;
use crate::progress::Progress;
use rand_distr::{Distribution, StandardNormal};

/// Deviation of the time that waves take through the declared column, in periods of the highest frequency, below which a posterior has
/// one mode: as far as a fit finds the right cycle.
///
/// Source: Bunks et al. (1995), doi 10.1190/1.1443880: half a period, here for the farthest that is to be expected, two deviations.
const ONE_MODE: f64 = 0.25;
/// Draws from the prior of velocities from which fits start, and how many of these are fitted to all events.
const DRAWS: usize = 16;
const FITTED: usize = 2;
/// Prior standard deviations of a declared value within which two fits are at the same mode.
const NEAR: f64 = 1.0;

impl<'a> Competition<'a> {
    /// Whether fits from different declared values may end at different modes.
    pub(super) fn has_modes(&self) -> bool {
        let problem = self.fitter.forward.problem;
        let deviation_s = problem.tolerances.vs_ln * problem.array.profile.travel_time_s();
        deviation_s * band_hz(self.fitter.forward)[1] > ONE_MODE
    }

    /// Fits the most probable model under `labels` from draws of velocities, by the surrogate column and, what ended elsewhere, by replays, and keeps where
    /// these ended. Whether one does better than where it was.
    pub(super) fn explore(&mut self, labels: &[Label], progress: &dyn Progress) -> Result<bool> {
        let leading = self.leading(labels).clone();
        if !self.has_modes() || has_set(&self.explored, &leading.model.effects) {
            return Ok(false);
        }
        self.explored.push(leading.model.effects.clone());
        self.modes.clear();
        let (by, own) = self.around(&leading)?;
        let mut found = self.first_fits(&by, &draws(&own));
        self.most_promising_first(&mut found);
        let least = self.log_posterior(&own) - FAR;
        found.retain(|fit| self.promise(fit) > least && !is_near(&own, fit));
        let mut modes = vec![leading.clone()];
        for fit in found.into_iter().take(FITTED) {
            modes.extend(self.finish(Start::led_by(fit), progress));
        }
        let best = self.known(&leading.model.effects).map_or(&leading, |i| &self.fits[i]);
        modes.retain(|mode| !is_near(best, mode));
        let is_better = self.log_posterior(best) > self.log_posterior(&leading);
        self.modes = modes;
        Ok(is_better)
    }

    /// Goes on with whatever does better where another close model has what is declared: what ended at another mode is no match for it.
    pub(super) fn exchange_modes(&mut self, labels: &[Label], progress: &dyn Progress) -> Result<()> {
        if !self.has_modes() {
            return Ok(());
        }
        let leading = self.leading(labels).clone();
        let least = self.log_posterior(&leading) - FAR;
        let is_close = |fit: &&Fit<'a>| fit.labels() == labels && self.log_posterior(fit) > least;
        let close: Vec<Fit<'a>> = self.fits.iter().filter(is_close).cloned().collect();
        for fit in close.iter().filter(|fit| !is_same_set(&fit.model.effects, &leading.model.effects)) {
            for [to, from] in [[fit, &leading], [&leading, fit]] {
                let x = coordinates(from, &to.model.effects, |i| to.x[to.model.coordinates_of(i)].to_vec());
                self.start_where_better(Start::at(to.model.clone(), x))?;
            }
        }
        self.settle_close(labels, progress)
    }

    /// Takes the searches of parts of the best model under `labels` to their ends, from where it is if they do better there: what ended on
    /// the way there is no match for it.
    pub(super) fn renew_parts(&mut self, labels: &[Label]) -> Result<()> {
        loop {
            let best = self.leading(labels).model.effects.clone();
            for part in (0..best.len()).map(|i| [&best[..i], &best[i + 1..]].concat()) {
                if self.known(&part).is_some() {
                    self.start_where_better(self.part(&part))?;
                    self.settled(&part)?;
                }
            }
            if is_same_set(&best, &self.leading(labels).model.effects) {
                return Ok(());
            }
        }
    }

    /// Has the search of a known model go on from `start` if it does better there than where it is.
    fn start_where_better(&mut self, start: Start<'a>) -> Result<()> {
        let Some(index) = self.known(&start.model.effects) else { return Ok(()) };
        if self.fitter.cost_at(&start.model, start.x.clone()).is_ok_and(|cost| cost < self.fits[index].cost) {
            self.fits[index] = self.fitter.fit(start, Stop::WHERE_IT_IS)?;
        }
        Ok(())
    }
}

/// Where `own` is, with velocities drawn from their prior; slopes of these are to be taken there.
fn draws<'a>(own: &Fit<'a>) -> Vec<Start<'a>> {
    let (prior, bounds, n) = (own.model.prior(), own.model.bounds(), own.model.declared.n_mode());
    let of = |draw: usize| {
        let mut start = Start::led_by(own.clone());
        let normal = StandardNormal.sample_iter(random::stream(draw as u64, "modes of a posterior"));
        for (i, z) in (0..n).zip(normal) {
            let ([mean, sd], [low, high], z): (_, _, f64) = (prior[i], bounds[i], z);
            start.x[i] = (mean + sd * z).clamp(low, high);
            start.slopes[i] = None;
        }
        start
    };
    (0..DRAWS).map(of).collect()
}

/// Whether the declared values of two fits are at the same mode.
fn is_near(one: &Fit<'_>, other: &Fit<'_>) -> bool {
    let declared = one.model.declared.len();
    one.x.iter().zip(&other.x).take(declared).all(|(a, b)| (a - b).abs() < NEAR)
}

#[cfg(test)]
mod tests {
    use super::super::super::made_up::{Truth, Uniform, beginning_at, in_competition, problem};
    use super::*;
    use crate::inference::parameters::Model;
    use crate::progress::Quiet;

    #[test]
    fn a_fit_that_ended_at_another_cycle_is_found_out() {
        let mut problem = problem(&Truth { soil: [270.0, 0.02], events: 3, ..Truth::default() });
        problem.tolerances.vs_ln = 0.3;
        let velocity = |fit: &Fit<'_>| -> f64 {
            let tables = fit.model.tables(&fit.x);
            200.0 * tables.iter().filter_map(|t| t.get("ln_factor")?.as_float()).sum::<f64>().exp()
        };
        let check = |mut competition: Competition<'_>| {
            let stuck = velocity(&competition.fits[0]);
            assert!(stuck < 200.0, "{stuck}");
            let labels = competition.fits[0].labels().to_vec();
            assert!(competition.explore(&labels, &Quiet).unwrap());
            let found = velocity(&competition.fits[0]);
            assert!((found / 270.0 - 1.0).abs() < 0.02, "{found}");
            // Where it was is another mode of the same model; there it is not looked for again.
            assert!(competition.modes.iter().any(|mode| velocity(mode) < 200.0));
            assert!(!competition.explore(&labels, &Quiet).unwrap());
        };
        let replay = Uniform(&problem);
        in_competition(
            &problem,
            &replay,
            |forward, declared| {
                let model = Model { declared, effects: Vec::new() };
                let mut x = vec![0.0; model.len()];
                x[0] = -2.0;
                beginning_at(forward, model, x, Stop::CLOSE)
            },
            check,
        );
    }
}
