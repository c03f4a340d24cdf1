//! What is fitted around a model: the most promising candidates, first by the surrogate column or, where that tells too little, as far as
//! the linear problem leads, the best of them by replays.

use super::null::Null;
use super::proposals::{Linear, Proposal, distinct};
use super::{Competition, FAR, FINALS, is_same_set};
use crate::effects::{self, Instance};
use crate::error::Result;
use crate::inference::posterior::{Fit, Fitter, Start, Stop};
use crate::numerics::threads::on_threads;
use crate::progress::Progress;

impl<'a> Competition<'a> {
    /// Fits the most promising candidates beside the fitted model with `effects`.
    pub(super) fn expand(&mut self, effects: Vec<Instance>, progress: &dyn Progress) -> Result<()> {
        let base = self.settled(&effects)?;
        let (by, start) = if self.fitter.is_led {
            self.around(&base)?
        } else {
            (self.fitter.through(self.fitter.forward), base.clone())
        };
        let is_open = start.model.effects.len() < self.max_effects;
        let directions = self.directions(&by, &start);
        let linear = Linear::new(&by, &start, &directions).filter(|_| !directions.is_empty());
        if let Some(null) = linear.as_ref().and_then(|linear| Null::of(linear, &self.ln_priors(linear))) {
            self.nulls.retain(|(set, _)| !is_same_set(set, &effects));
            self.nulls.push((effects.clone(), null));
        }
        self.expanded.push(effects);
        let mut heats = self.heats(&by, &start, linear.as_ref());
        heats.extend(self.unnamed(&by, &start));
        if is_open && base.is_strained() {
            heats.extend(self.strong_beside(&base, &by, &start)?);
        }
        self.most_promising_first(&mut heats);
        let mut finals: Vec<Fit<'a>> = Vec::new();
        let is_new = |finals: &[Fit<'a>], heat: &Fit<'a>| {
            !finals.iter().any(|f| is_same_set(&f.model.effects, &heat.model.effects))
        };
        // What is far behind by the surrogate is not worth replays, unless something is lacking, to which it may lead; a response without
        // a name is compared with nothing here.
        let highest = heats.iter().filter(|heat| heat.model.is_named()).map(|heat| self.promise(heat));
        let far = if self.is_lacking(base.labels()) { f64::INFINITY } else { FAR };
        let worth = highest.fold(f64::NEG_INFINITY, f64::max) - far;
        for heat in heats.iter().filter(|heat| self.promise(heat) > worth) {
            if finals.len() < FINALS && is_new(&finals, heat) {
                finals.push(heat.clone());
            }
        }
        // One that leaves little tells most of what to expect, even where what is expected now does not favour it.
        let alike = heats.into_iter().filter(|h| h.labels() == base.labels());
        let least = alike.map(|h| (Self::supported(by.forward, &h).1, h)).min_by(|a, b| a.0.total_cmp(&b.0));
        let telling = least.map(|(_, heat)| heat);
        finals.retain(|heat| telling.as_ref().is_none_or(|t| !is_same_set(&t.model.effects, &heat.model.effects)));
        let of_finals = finals.into_iter().map(|heat| (Start::led_by(heat), Stop::ON_THE_WAY));
        let starts: Vec<_> = of_finals.chain(telling.map(|heat| (Start::led_by(heat), Stop::CLOSE))).collect();
        self.begin(&starts);
        self.settle_close(base.labels(), progress)
    }

    /// First fits of what may be strong, always sought by the surrogate column, as `by` has them.
    fn strong_beside(&self, base: &Fit<'a>, by: &Fitter<'a>, start: &Fit<'a>) -> Result<Vec<Fit<'a>>> {
        if self.fitter.is_led {
            return Ok(self.strong(by, start));
        }
        let (column, start) = self.around(base)?;
        let strong = self.strong(&column, &start);
        let evaluated = |i: usize| by.fit(Start::led_by(strong[i].clone()), Stop::WHERE_IT_IS).ok();
        Ok(on_threads(strong.len(), evaluated).into_iter().flatten().collect())
    }

    /// First fits of the most promising candidates by the linear problem there.
    fn heats(&self, by: &Fitter<'a>, base: &Fit<'a>, linear: Option<&Linear<'_, 'a>>) -> Vec<Fit<'a>> {
        let mut proposals = self.proposals(by, base, linear);
        proposals.sort_by(|a, b| b.log_posterior.total_cmp(&a.log_posterior));
        // A pair that holds what a single one holds is always as good before it is fitted. Where tolerances stand in for something, what
        // comes on top of a pair is sought when one of the two is in the model.
        let (singles, pairs): (Vec<_>, Vec<_>) = proposals.into_iter().partition(|p| p.parts.len() == 1);
        let of = |p: &Proposal| -> Vec<Instance> { p.parts.iter().map(|part| part.instance.clone()).collect() };
        let pairs = if base.is_strained() { Vec::new() } else { distinct(pairs, of) };
        let all: Vec<Proposal> = distinct(singles, of).into_iter().chain(pairs).collect();
        let fitted = |i: usize| by.fit(Self::started(by, base, &all[i]), self.first_stop()).ok();
        on_threads(all.len(), fitted).into_iter().flatten().collect()
    }

    /// The best first fit of what has no name: a response of one sensor, or of each.
    fn unnamed(&self, by: &Fitter<'a>, base: &Fit<'a>) -> Option<Fit<'a>> {
        if !base.model.is_named() {
            return None;
        }
        let all = effects::unnamed(&by.forward.problem.array);
        let alone = all.iter().map(|response| vec![response.clone()]);
        let together = Some(all.clone()).filter(|all| all.len() > 1);
        let all: Vec<Vec<Instance>> = alone.chain(together).collect();
        let fitted = |i: usize| {
            let start = all[i].iter().fold(Start::from(base.clone()), |s, e| s.and(e, &vec![0.0; e.free.len()]));
            by.fit(start, self.first_stop()).ok()
        };
        let fits = on_threads(all.len(), fitted).into_iter().flatten();
        fits.max_by(|a, b| self.promise(a).total_cmp(&self.promise(b)))
    }

    /// How far candidates are fitted before the best of them are fitted by replays: no farther than the linear problem leads where that is
    /// what they are looked at by.
    fn first_stop(&self) -> Stop {
        if self.fitter.is_led { Stop::ON_THE_WAY } else { Stop::WHERE_IT_IS }
    }
}
