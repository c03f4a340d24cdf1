//! What models are compared by: what few elements leave wrong, taken out beside the best, and what is expected of residuals, read off
//! beside the model that leaves least.

use super::agenda::best_of_each_number;
use super::{Competition, FAR, TOLD, is_same_set};
use crate::effects::Instance;
use crate::error::Result;
use crate::inference::forward::{Forward, Label};
use crate::inference::posterior::{Fit, Fitter, Start, Stop, combined, square};
use crate::inference::weights::Expected;
use crate::numerics::threads::on_threads;
use crate::progress::Progress;

/// Most times that what few elements leave wrong is taken out anew.
const ANCHORS: usize = 6;
/// Change of the column's level (ln) and of a coherence from which models are compared anew.
const CHANGED: [f64; 2] = [0.05, 0.02];
/// The same from which candidates are looked for anew.
const OTHER: [f64; 2] = [0.7, 0.2];

impl<'a> Competition<'a> {
    /// Takes out what few elements leave wrong beside the best model under `labels` and fits that anew, until the records cannot tell what
    /// is left of it.
    pub(super) fn renew_anchor(&mut self, labels: &[Label], stop: Stop) -> Result<()> {
        for _ in 0..ANCHORS {
            let best = self.best_of(|fit| fit.labels() == labels).unwrap_or(&self.fits[0]).clone();
            self.fitter.forward.anchor(&best.model.tables(&best.x))?;
            let old = std::mem::take(&mut self.fits);
            let evaluated = |i: usize| self.fitter.fit(Start::from(old[i].clone()), Stop::WHERE_IT_IS);
            self.fits = on_threads(old.len(), evaluated).into_iter().collect::<Result<_>>()?;
            let Some(index) = self.known(&best.model.effects) else { break };
            let there = self.fits[index].clone();
            let moved = combined(&there.rows, &best.rows, 1.0, -1.0);
            if 0.5 * square(&moved) < TOLD && there.taken >= stop.slopes {
                break;
            }
            self.fits[index] = self.fitter.fit(Start::from(there), stop)?;
        }
        Ok(())
    }

    /// What is expected of the residuals of `forward` beside a fitted model, and −ln of the density of the records by that.
    pub(super) fn supported(forward: &Forward<'_>, fit: &Fit<'_>) -> (Expected, f64) {
        let expected = Expected::of(forward, fit.prediction.clone());
        let density = expected.weights(forward).beside;
        (expected, density)
    }

    /// Whether something is lacking in all models so far: the column is left with more error than is declared, or a response without a name
    /// does better than all named effects. It may then be found beside any of the best of no more effects than those that lead: what leads
    /// may be what stands in for it.
    pub(super) fn is_lacking(&self, labels: &[Label]) -> bool {
        let best = self.best_of(|fit| fit.labels() == labels);
        let level = best.and_then(|best| self.fitter.spread(&best.prediction)).map_or(1.0, |spread| spread.level);
        is_beyond_declared(level) || self.is_outdone(labels)
    }

    /// Whether a response without a name does better than all named effects under `labels`.
    pub(super) fn is_outdone(&self, labels: &[Label]) -> bool {
        self.best_of(|fit| fit.labels() == labels).is_some_and(|best| !best.model.is_named())
    }

    /// Reads off what is expected of residuals under `labels`, and weighs anew whatever is close, if that has changed: searches go on where
    /// they promise to count. What the column has wrong and what strays is what no model explains: the model beside which least of it is
    /// left tells how much it is, for all of them.
    pub(super) fn renew_spread(&mut self, labels: &[Label], progress: &dyn Progress) -> Result<()> {
        let own = self.fits.iter().filter(|f| f.labels() == labels && f.is_settled);
        let supported = own.map(|f| (f, Self::supported(self.fitter.forward, f)));
        let least = supported.min_by(|a, b| a.1.1.total_cmp(&b.1.1));
        let Some((best, (Expected { spread: found, .. }, _))) = least.map(|(f, s)| (f.clone(), s)) else {
            return Ok(());
        };
        let moved = self.fitter.spread(&best.prediction).map_or([f64::INFINITY; 2], |now| found.distance(now));
        let is_beyond = |limits: [f64; 2]| moved.iter().zip(limits).any(|(moved, limit)| *moved > limit);
        if !is_beyond(CHANGED) {
            return Ok(());
        }
        let is_other = is_beyond(OTHER);
        let beside = best.model.effects.iter().map(|e| e.kind).collect::<Vec<_>>().join(" + ");
        progress.note(&format!("level {:.2}, coherence {:.2?} beside {beside}", found.level, found.coherence));
        // What few elements leave wrong is taken out where it matters now.
        self.fitter.forward.anchor(&best.model.tables(&best.x))?;
        let reference = self.fitter.predict(&best.model, &best.x)?;
        let level = found.level;
        let fitter = self.fitter.expecting(Expected { spread: found, reference });
        let before = std::mem::replace(&mut self.fitter, fitter);
        let own = best.model.effects;
        let is_own = |fit: &Fit<'a>| fit.labels() == labels;
        let old = std::mem::take(&mut self.fits);
        let cost = |fit: &Fit<'a>| self.fitter.nll(&fit.prediction) + Fitter::prior(&fit.model, &fit.x);
        let costs: Vec<f64> = old.iter().map(cost).collect();
        // What has a name is kept by what else has one: a response without takes up all of that at once.
        let lowest = |is_named: bool| {
            let alike = old.iter().zip(&costs).filter(|(fit, _)| is_own(fit) && fit.model.is_named() == is_named);
            alike.map(|(_, cost)| *cost).fold(f64::INFINITY, f64::min)
        };
        let lowest = [lowest(false), lowest(true)];
        // Where something is lacking, what is far behind may yet lead to it.
        let mut best: Vec<usize> = Vec::new();
        if is_beyond_declared(level) {
            let mut order: Vec<usize> =
                (0..old.len()).filter(|i| is_own(&old[*i]) && old[*i].model.is_named()).collect();
            order.sort_by(|a, b| costs[*a].total_cmp(&costs[*b]));
            best.extend(best_of_each_number(order, |i| old[*i].model.effects.clone()));
        }
        for (i, (fit, cost)) in old.into_iter().zip(costs).enumerate() {
            if !is_own(&fit) {
                self.fits.push(fit);
                continue;
            }
            let is_close = cost < lowest[usize::from(fit.model.is_named())] + FAR;
            // What the records are read beside next is as far on as what they were read beside now.
            let is_read = is_same_set(&fit.model.effects, &own);
            if i == 0 || is_close || best.contains(&i) || is_read {
                let stop = if is_read { Stop::CLOSE } else { Stop::WHERE_IT_IS };
                self.fits.push(self.fitter.fit(self.fitter.weighed_anew(fit, &before), stop)?);
            }
        }
        // What was found beside other models may be found anew; what leads away from it does so by any weights.
        if is_other {
            let fits = &self.fits;
            let is_strained =
                |set: &Vec<Instance>| fits.iter().any(|f| is_same_set(&f.model.effects, set) && f.is_strained());
            self.expanded.retain(is_strained);
            self.challenged.clear();
            self.explored.clear();
        }
        self.settle_close(labels, progress)
    }
}

/// Whether the column is left with more error than is declared of it; `level` is the ratio of the two.
fn is_beyond_declared(level: f64) -> bool {
    level.ln() > CHANGED[0]
}
