//! Candidates that may be strong: each over all its strengths, from what is declared, by the surrogate column. Where tolerances or other effects
//! stand in for something strong, what is linear beside them says little of it.

use super::proposals::{SHORTLIST, away, is_among_best, is_linear};
use super::{Competition, HEATS};
use crate::effects::Instance;
use crate::inference::posterior::{Fit, Fitter, Start, Stop};
use crate::numerics::threads::on_threads;
use std::collections::BTreeMap;

/// Strengths at which candidates are tried to either side of nothing, in typical sizes; where the last is the best, twice that and so on.
const LADDER: [f64; 4] = [0.4, 0.9, 1.5, 2.2];

/// Steps of a fit between two halvings.
const SHORT: Stop = Stop { steps: 4, ..Stop::ON_THE_WAY };

/// What candidates are added to: a model somewhere, with its slopes there.
pub(super) struct Ground<'a, 'f> {
    by: &'f Fitter<'a>,
    at: Start<'a>,
}

impl<'a> Competition<'a> {
    /// First fits of the most promising candidates beside the effects of `base`.
    pub(super) fn strong(&self, by: &Fitter<'a>, base: &Fit<'a>) -> Vec<Fit<'a>> {
        let Some(ground) = Ground::declared(by, Start::from(base.clone())) else { return Vec::new() };
        let open = self.instances.iter().filter(|i| base.model.index_of(i).is_none());
        self.first_fits(by, &ground.starts(open))
    }

    /// First fits from `starts`: all of them a few steps, and the better half of those as many again, until no more go on than are fitted
    /// farther anyway.
    ///
    /// Source: Jamieson and Talwalkar (2016), Non-stochastic best arm identification: successive halving.
    pub(super) fn first_fits(&self, by: &Fitter<'a>, starts: &[Start<'a>]) -> Vec<Fit<'a>> {
        let first = |i: usize| by.fit(starts[i].clone(), SHORT).ok();
        let mut fits: Vec<Fit<'a>> = on_threads(starts.len(), first).into_iter().flatten().collect();
        let mut going = fits.len();
        loop {
            self.most_promising_first(&mut fits);
            going = (going / 2).max(HEATS.min(fits.len()));
            let stop = if going > HEATS { SHORT } else { Stop::ON_THE_WAY };
            let farther = |i: usize| {
                let is_open = fits[i].expected_gain() > stop.gain;
                is_open.then(|| by.fit(Start::from(fits[i].clone()), stop).ok()).flatten()
            };
            let found: Vec<Option<Fit<'a>>> = on_threads(going, farther);
            let is_over = going <= HEATS || found.iter().all(Option::is_none);
            for (fit, found) in fits.iter_mut().zip(found) {
                if let Some(found) = found {
                    *fit = found;
                }
            }
            if is_over {
                return fits;
            }
        }
    }
}

impl<'a, 'f> Ground<'a, 'f> {
    /// Where a fit might start.
    pub(super) fn new(by: &'f Fitter<'a>, at: Start<'a>) -> Self {
        Self { by, at }
    }

    /// A model at its declared values, its effects as in `at`; none where the column cannot be replayed there.
    pub(super) fn declared(by: &'f Fitter<'a>, at: Start<'a>) -> Option<Self> {
        let Start { model, mut x, .. } = at;
        x[..model.declared.len()].fill(0.0);
        Some(Self::new(by, Start::from(by.fit(Start::at(model, x), Stop::WHERE_IT_IS).ok()?)))
    }

    /// The most promising `candidates`, each at its most probable strength.
    pub(super) fn starts<'i>(&self, candidates: impl Iterator<Item = &'i Instance>) -> Vec<Start<'a>> {
        let smooth: Vec<&Instance> = candidates.filter(|i| is_linear(i)).collect();
        let tried = |i: usize| self.ladder(smooth[i]).map(|(at, cost)| (smooth[i], at, cost));
        let mut all: Vec<(&Instance, Vec<f64>, f64)> = on_threads(smooth.len(), tried).into_iter().flatten().collect();
        all.sort_by(|a, b| a.2.total_cmp(&b.2));
        let mut places: BTreeMap<String, usize> = BTreeMap::new();
        all.retain(|(instance, ..)| is_among_best(&mut places, instance));
        all.truncate(SHORTLIST);
        all.into_iter().map(|(instance, at, _)| self.at.clone().and(instance, &at)).collect()
    }

    /// The most probable strength of `instance`, and −ln of its posterior density.
    fn ladder(&self, instance: &Instance) -> Option<(Vec<f64>, f64)> {
        let zero = instance.zero()?;
        let there = |size: f64, side: f64| {
            let at = away(instance, &zero, size, side)?;
            let Start { model, x, .. } = self.at.clone().and(instance, &at);
            Some((at, self.by.cost_at(&model, x).ok()?))
        };
        let steps = || LADDER.iter().flat_map(|size| [1.0, -1.0].map(|side| (*size, side)));
        let all = steps().filter_map(|(size, side)| Some((size, side, there(size, side)?)));
        let (mut size, side, mut best) = all.min_by(|a, b| a.2.1.total_cmp(&b.2.1))?;
        while size >= LADDER[LADDER.len() - 1] {
            size *= 2.0;
            match there(size, side) {
                Some(farther) if farther.1 < best.1 => best = farther,
                _ => break,
            }
        }
        Some(best)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::made_up::{Nonlinear, Truth, in_competition, problem, sample};
    use super::super::super::recalibration::recalibrated;
    use super::*;
    use crate::diagnosis::Replay;
    use crate::numerics::random;

    #[test]
    fn a_strong_seam_is_found_where_it_is() {
        let mut problem = problem(&Truth { events: 3, ..Truth::default() });
        let seam = "kind = 'thin_seam'\ndepth_m = 14.117647\nthickness_m = 2.352941\nln_factor = -0.8";
        let motions = Nonlinear(&problem).replay(&[toml::from_str(seam).unwrap()]).unwrap();
        let mut stream = random::stream(3, "noise");
        for (event, motion) in problem.events.iter_mut().zip(motions) {
            event.outputs = motion.unwrap();
            event.outputs.iter_mut().flatten().for_each(|v| *v += 0.01 * sample(&mut stream));
        }
        let check = |competition: Competition<'_>| {
            assert!(competition.fits[0].is_strained());
            let (by, base) = competition.around(&competition.fits[0]).unwrap();
            let found = competition.strong(&by, &base);
            let best =
                found.iter().max_by(|a, b| competition.log_posterior(a).total_cmp(&competition.log_posterior(b)));
            let table = best.unwrap().model.effect_table(&best.unwrap().x, 0);
            assert_eq!(table["kind"].as_str(), Some("thin_seam"), "{table}");
            assert!((table["depth_m"].as_float().unwrap() - 14.117647).abs() < 1e-3, "{table}");
            assert!((table["ln_factor"].as_float().unwrap() + 0.8).abs() < 0.1, "{table}");
        };
        in_competition(
            &problem,
            &Nonlinear(&problem),
            |forward, declared| {
                let (expected, (model, x)) = recalibrated(forward, declared, Vec::new()).unwrap();
                let fitter = Fitter::new(forward, expected);
                let fit = fitter.fit(Start::at(model, x), Stop::CLOSE).unwrap();
                (fitter, fit)
            },
            check,
        );
    }
}
