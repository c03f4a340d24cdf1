//! Candidates that may be strong: each over all its strengths, from what is declared, by the equivalent-linear column. Where tolerances or
//! other effects stand in for something strong, what is linear beside them says little of it.

use super::proposals::{SHORTLIST, away, distinct, is_among_best, is_linear};
use super::{Competition, FAR_HEAT};
use crate::effects::Instance;
use crate::inference::parameters::Model;
use crate::inference::posterior::{Fit, Fitter, Start, Stop};
use crate::numerics::threads::on_threads;
use std::collections::BTreeMap;

/// Strengths at which candidates are tried to either side of nothing, in typical sizes.
const LADDER: [f64; 4] = [0.4, 0.9, 1.5, 2.2];

/// What candidates are added to: a model somewhere, and the equivalent-linear column there.
pub(super) struct Ground<'a> {
    by: Fitter<'a>,
    model: Model<'a>,
    x: Vec<f64>,
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
        Self::replayed(by, &found.iter().filter(is_alike).map(Start::beside).collect::<Vec<_>>())
    }

    /// Fits of the most promising `candidates` to the equivalent-linear column, best first.
    pub(super) fn scanned<'i>(
        &self,
        ground: &Ground<'a>,
        candidates: impl Iterator<Item = &'i Instance>,
    ) -> Vec<Fit<'a>> {
        let smooth: Vec<&Instance> = candidates.filter(|i| is_linear(i)).collect();
        let tried = |i: usize| Some((smooth[i], ground.best_of_ladder(smooth[i])?));
        let mut all: Vec<_> = on_threads(smooth.len(), tried).into_iter().flatten().collect();
        all.sort_by(|(_, (_, a)), (_, (_, b))| a.total_cmp(b));
        let mut places: BTreeMap<String, usize> = BTreeMap::new();
        all.retain(|(instance, _)| is_among_best(&mut places, instance));
        all.truncate(SHORTLIST);
        let fitted = |i: usize| ground.fitted(all[i].0, all[i].1.0.clone());
        let mut fits: Vec<Fit<'a>> = on_threads(all.len(), fitted).into_iter().flatten().collect();
        self.best_first(&mut fits);
        fits
    }

    /// First fits to the column itself, from where those to the equivalent-linear one ended.
    pub(super) fn replayed(by: &Fitter<'a>, starts: &[Start<'a>]) -> Vec<Fit<'a>> {
        let fitted = |i: usize| by.fit(starts[i].clone(), FAR_HEAT).ok();
        on_threads(starts.len(), fitted).into_iter().flatten().collect()
    }
}

impl<'a> Ground<'a> {
    /// A model at `x`; none where the column cannot be replayed there.
    pub(super) fn new(by: &Fitter<'a>, model: Model<'a>, x: Vec<f64>) -> Option<Self> {
        Some(Self { by: by.by_surrogate(&model, &x)?, model, x })
    }

    /// A model at its declared values, its effects as at `x`.
    pub(super) fn declared(by: &Fitter<'a>, model: Model<'a>, mut x: Vec<f64>) -> Option<Self> {
        x[..model.declared.len()].fill(0.0);
        Self::new(by, model, x)
    }

    fn with(&self, instance: &Instance, at: Vec<f64>) -> (Model<'a>, Vec<f64>) {
        let mut model = self.model.clone();
        model.effects.push(instance.clone());
        (model, self.x.iter().copied().chain(at).collect())
    }

    /// The most probable strength of `instance` among those of the ladder, and −ln of its posterior density.
    pub(super) fn best_of_ladder(&self, instance: &Instance) -> Option<(Vec<f64>, f64)> {
        let zero = instance.zero()?;
        let sides = |size: &f64| [1.0, -1.0].map(|side| away(instance, &zero, *size, side));
        let cost = |at: Vec<f64>| {
            let (model, x) = self.with(instance, at.clone());
            Some((at, self.by.cost_at(&model, x).ok()?))
        };
        let all = LADDER.iter().flat_map(sides).flatten().filter_map(cost);
        all.min_by(|a, b| a.1.total_cmp(&b.1))
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
