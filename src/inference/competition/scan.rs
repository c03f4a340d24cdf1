//! Candidates that may be strong: each over all its strengths, from what is declared, by the equivalent-linear column, and by the column
//! itself where that does something else. Where tolerances or other effects stand in for something strong, what is linear beside them says
//! little of it.

use super::proposals::{SHORTLIST, away, distinct, is_among_best, is_linear};
use super::{Competition, FAR, FAR_HEATS, HEAT};
use crate::effects::Instance;
use crate::inference::parameters::Model;
use crate::inference::posterior::{Fit, Fitter, Start, Stop, is_borne_out};
use crate::numerics::threads::on_threads;
use std::collections::BTreeMap;

/// Strengths at which candidates are tried to either side of nothing, in typical sizes; where the last is the best, twice that and so on.
const LADDER: [f64; 4] = [0.4, 0.9, 1.5, 2.2];

/// What candidates are added to: a model somewhere, the column, and the equivalent-linear one there.
pub(super) struct Ground<'a, 'f> {
    by: Fitter<'a>,
    column: &'f Fitter<'a>,
    model: Model<'a>,
    x: Vec<f64>,
    /// −ln of its posterior density by the equivalent-linear column, and by the column.
    costs: [f64; 2],
}

/// A candidate at the best of its strengths.
struct Tried<'i> {
    instance: &'i Instance,
    at: Vec<f64>,
    /// How much −ln of the posterior density falls.
    gain: f64,
    /// Whether that is by replays.
    is_replayed: bool,
}

impl<'a> Competition<'a> {
    /// First fits of the most promising candidates beside the effects of `base`.
    pub(super) fn strong(&self, by: &Fitter<'a>, base: &Fit<'a>) -> Vec<Fit<'a>> {
        let Some(ground) = Ground::declared(by, base.model.clone(), base.x.clone()) else { return Vec::new() };
        let open = self.instances.iter().filter(|i| base.model.index_of(i).is_none());
        let found = self.scanned(&ground, open);
        // Which of the places of a form it is that column does not tell well enough.
        let own: Vec<&Instance> = found.iter().filter_map(|fit| fit.model.effects.last()).collect();
        let best = distinct(own, |instance| vec![(*instance).clone()]);
        let is_alike = |fit: &&Fit<'a>| fit.model.effects.last().is_some_and(|e| best.iter().any(|b| b.is_alike(e)));
        self.replayed(by, &found.iter().filter(is_alike).map(Start::beside).collect::<Vec<_>>())
    }

    /// Fits of the most promising `candidates` to the equivalent-linear column, best first.
    pub(super) fn scanned<'i>(
        &self,
        ground: &Ground<'a, '_>,
        candidates: impl Iterator<Item = &'i Instance>,
    ) -> Vec<Fit<'a>> {
        let smooth: Vec<&Instance> = candidates.filter(|i| is_linear(i)).collect();
        let tried = |i: usize| {
            let (at, cost) = ground.best_of_ladder(smooth[i])?;
            Some(Tried { instance: smooth[i], at, gain: ground.costs[0] - cost, is_replayed: false })
        };
        let all: Vec<Tried<'_>> = on_threads(smooth.len(), tried).into_iter().flatten().collect();
        let mut all = ground.borne_out(all);
        all.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        let mut places: BTreeMap<String, usize> = BTreeMap::new();
        all.retain(|tried| is_among_best(&mut places, tried.instance));
        all.truncate(SHORTLIST);
        let fitted = |i: usize| ground.first_fit(&all[i]);
        let mut fits: Vec<Fit<'a>> = on_threads(all.len(), fitted).into_iter().flatten().collect();
        self.best_first(&mut fits);
        fits
    }

    /// First fits to the column itself, from where those to the equivalent-linear one ended: what is far behind by what its search promises
    /// is left behind on the way.
    pub(super) fn replayed(&self, by: &Fitter<'a>, starts: &[Start<'a>]) -> Vec<Fit<'a>> {
        let first = |i: usize| by.fit(starts[i].clone(), HEAT).ok();
        let mut fits: Vec<Fit<'a>> = on_threads(starts.len(), first).into_iter().flatten().collect();
        for _ in 1..FAR_HEATS {
            let highest = fits.iter().map(|fit| self.log_posterior(fit)).fold(f64::NEG_INFINITY, f64::max);
            let farther = |i: usize| {
                let fit = fits[i].clone();
                let goes_on = fit.expected_gain() > HEAT.gain && self.promise(&fit) > highest - FAR;
                if goes_on { by.fit(Start::from(fit), HEAT).ok() } else { Some(fit) }
            };
            fits = on_threads(fits.len(), farther).into_iter().flatten().collect();
        }
        fits
    }
}

impl<'a, 'f> Ground<'a, 'f> {
    /// A model at `x`; none where the column cannot be replayed there.
    pub(super) fn new(column: &'f Fitter<'a>, model: Model<'a>, x: Vec<f64>) -> Option<Self> {
        let by = column.by_surrogate(&model, &x)?;
        let costs = [by.cost_at(&model, x.clone()).ok()?, column.cost_at(&model, x.clone()).ok()?];
        Some(Self { by, column, model, x, costs })
    }

    /// A model at its declared values, its effects as at `x`.
    pub(super) fn declared(column: &'f Fitter<'a>, model: Model<'a>, mut x: Vec<f64>) -> Option<Self> {
        x[..model.declared.len()].fill(0.0);
        Self::new(column, model, x)
    }

    /// The same candidates, those replayed at all strengths of whose form the column, at the best place and strength, does something else
    /// than the equivalent-linear one foretells.
    fn borne_out<'i>(&self, tried: Vec<Tried<'i>>) -> Vec<Tried<'i>> {
        let mut best: Vec<&Tried<'i>> = Vec::new();
        for one in &tried {
            match best.iter_mut().find(|known| known.instance.is_alike(one.instance)) {
                Some(known) if known.gain >= one.gain => {}
                Some(known) => *known = one,
                None => best.push(one),
            }
        }
        let is_poor = |i: usize| {
            let cost = self.cost(self.column, best[i].instance, best[i].at.clone()).unwrap_or(f64::INFINITY);
            is_other(self.costs[1] - cost, best[i].gain)
        };
        let poor: Vec<bool> = on_threads(best.len(), is_poor);
        let poor: Vec<&Instance> = best.iter().zip(poor).filter(|(_, poor)| *poor).map(|(b, _)| b.instance).collect();
        let again = |i: usize| {
            let instance = tried[i].instance;
            if !poor.iter().any(|known| known.is_alike(instance)) {
                return Some(Tried { instance, at: tried[i].at.clone(), ..tried[i] });
            }
            let (at, cost) = self.ladder(self.column, instance)?;
            Some(Tried { instance, at, gain: self.costs[1] - cost, is_replayed: true })
        };
        on_threads(tried.len(), again).into_iter().flatten().collect()
    }

    /// The fit of a candidate to the equivalent-linear column where that is a step ahead for the column too; else where it is, on the same
    /// scale.
    fn first_fit(&self, tried: &Tried<'_>) -> Option<Fit<'a>> {
        let (model, x) = self.with(tried.instance, tried.at.clone());
        let cost = |x: &[f64]| self.column.cost_at(&model, x.to_vec()).unwrap_or(f64::INFINITY);
        let fitted = if tried.is_replayed { None } else { self.fitted(tried.instance, tried.at.clone()) };
        if let Some(fitted) = fitted.filter(|fitted| cost(&fitted.x) < cost(&x)) {
            return Some(fitted);
        }
        let mut fit = self.column.fit(Start::at(model, x), Stop::WHERE_IT_IS).ok()?;
        fit.cost += self.costs[0] - self.costs[1];
        Some(fit)
    }

    /// −ln of the posterior density with `instance` at `at`.
    fn cost(&self, by: &Fitter<'a>, instance: &Instance, at: Vec<f64>) -> Option<f64> {
        let (model, x) = self.with(instance, at);
        by.cost_at(&model, x).ok()
    }

    fn with(&self, instance: &Instance, at: Vec<f64>) -> (Model<'a>, Vec<f64>) {
        let mut model = self.model.clone();
        model.effects.push(instance.clone());
        (model, self.x.iter().copied().chain(at).collect())
    }

    /// The most probable strength of `instance` by the equivalent-linear column, and −ln of its posterior density.
    pub(super) fn best_of_ladder(&self, instance: &Instance) -> Option<(Vec<f64>, f64)> {
        self.ladder(&self.by, instance)
    }

    fn ladder(&self, by: &Fitter<'a>, instance: &Instance) -> Option<(Vec<f64>, f64)> {
        let zero = instance.zero()?;
        let there = |size: f64, side: f64| {
            let at = away(instance, &zero, size, side)?;
            let cost = self.cost(by, instance, at.clone())?;
            Some((at, cost))
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

    /// The fit of `instance` from `at`.
    pub(super) fn fitted(&self, instance: &Instance, at: Vec<f64>) -> Option<Fit<'a>> {
        let (model, x) = self.with(instance, at);
        self.by.fit(Start::at(model, x), Stop::ON_THE_WAY).ok()
    }

    /// The fit of its own model from `x`.
    pub(super) fn fitted_from(&self, x: Vec<f64>) -> Option<Fit<'a>> {
        self.by.fit(Start::at(self.model.clone(), x), Stop::ON_THE_WAY).ok()
    }
}

/// Whether what was `gained` is other than what was `foretold`, so far that it counts.
fn is_other(gained: f64, foretold: f64) -> bool {
    (gained - foretold).abs() > FAR && !is_borne_out(gained, foretold)
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
            let by = competition.few.fitter(&competition.fitter);
            let base = competition.few.of(&by, &competition.fits[0]).unwrap();
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
