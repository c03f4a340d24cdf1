//! Which model is looked around next.

use super::proposals::distinct;
use super::{Competition, WINDOW, has_set};
use crate::effects::Instance;
use crate::error::Result;
use crate::inference::forward::Label;
use crate::inference::posterior::{Fit, Stop};
use crate::progress::Progress;

impl<'a> Competition<'a> {
    /// Reads off what is expected beside the best model under `labels`, and goes on with all under them by that.
    pub(super) fn renew(&mut self, labels: &[Label], progress: &dyn Progress) -> Result<()> {
        self.renew_anchor(labels, Stop::CLOSE)?;
        self.renew_spread(labels, progress)?;
        self.renew_parts(labels)?;
        self.exchange_modes(labels, progress)
    }

    /// Looks for candidates around the most probable model under `labels`; whether there was where to look.
    pub(super) fn round(&mut self, labels: &[Label], progress: &dyn Progress) -> Result<bool> {
        self.renew(labels, progress)?;
        if self.expanded.is_empty() && self.explore(labels, progress)? {
            return Ok(true);
        }
        // Where nothing is lacking the answer may be there already under other names; where something is, none of them has it all.
        let is_lacking = self.is_lacking(labels);
        if !is_lacking && self.challenge(labels, progress)? {
            return Ok(true);
        }
        match self.agenda(labels, is_lacking).into_iter().find(|set| !has_set(&self.expanded, set)) {
            Some(next) => self.expand(next, progress).map(|()| true),
            None => Ok((is_lacking && self.challenge(labels, progress)?) || self.explore(labels, progress)?),
        }
    }

    /// The models to be looked around under `labels`: the leading one less each of its effects, and what is nearly as probable, or, where
    /// something is lacking, the best of each number of effects: of one more than the leading model has where a response without a name does
    /// better than all that has one, for effects that explain together what none of them explains alone gain nothing one by one.
    fn agenda(&self, labels: &[Label], is_lacking: bool) -> Vec<Vec<Instance>> {
        let leading = self.leading(labels);
        let effects = &leading.model.effects;
        let without = |i: usize| [&effects[..i], &effects[i + 1..]].concat();
        let keeps_labels = |i: &usize| !effects[*i].exchanges_labels();
        // A response without a name is what named effects are compared with, and nothing to look further from: it takes up what they
        // would explain.
        let is_own = |fit: &&Fit<'a>| fit.model.is_named() && fit.labels() == labels && !self.is_idle(fit);
        let mut own: Vec<&Fit<'a>> = self.fits.iter().filter(is_own).collect();
        self.best_first(&mut own);
        let close = if is_lacking {
            own.retain(|fit| fit.model.effects.len() <= effects.len() + usize::from(self.is_outdone(labels)));
            best_of_each_number(own, |fit| fit.model.effects.clone())
        } else {
            let least = self.log_posterior(leading) - WINDOW;
            own.into_iter().filter(|fit| self.log_posterior(fit) > least).collect()
        };
        let parts = (0..effects.len()).filter(keeps_labels).map(without);
        let mut agenda: Vec<_> = parts.chain(close.into_iter().map(|fit| fit.model.effects.clone())).collect();
        // What is simpler first: it may do as well, and it leads to more. Then the best, and what is less probable.
        agenda.sort_by_key(Vec::len);
        agenda
    }

    /// Whether a model is no more probable than one of fewer of its effects: what else is in it leads nowhere.
    ///
    /// Source: Madigan and Raftery (1994), the second principle of Occam's window.
    fn is_idle(&self, fit: &Fit<'a>) -> bool {
        let has = |other: &Fit<'a>| other.model.effects.iter().all(|e| fit.model.index_of(e).is_some());
        let is_simpler = |other: &&Fit<'a>| other.model.effects.len() < fit.model.effects.len() && has(other);
        self.fits.iter().filter(is_simpler).any(|other| self.log_posterior(other) >= self.log_posterior(fit))
    }
}

/// The best of `all`, best first, whose effects are those that `of` says: of each number of effects those of distinct forms, the fewest
/// first.
pub(super) fn best_of_each_number<T>(all: Vec<T>, of: impl Fn(&T) -> Vec<Instance>) -> Vec<T> {
    let mut by_number: Vec<Vec<T>> = Vec::new();
    for one in all {
        let number = of(&one).len();
        if by_number.len() <= number {
            by_number.resize_with(number + 1, Vec::new);
        }
        by_number[number].push(one);
    }
    by_number.into_iter().flat_map(|alike| distinct(alike, &of)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::super::made_up::{Truth, Uniform, as_declared, in_competition, problem};
    use super::super::{Start, effects, is_same_set};
    use super::*;
    use crate::inference::parameters::Model;

    #[test]
    fn pairs_behind_a_single_effect_are_looked_around_where_what_has_no_name_is_ahead() {
        let problem = problem(&Truth { events: 2, ..Truth::default() });
        in_competition(&problem, &Uniform(&problem), as_declared, |mut competition| {
            let labels = competition.fits[0].labels().to_vec();
            let declared = competition.fits[0].model.declared;
            let of = |kind: &str| competition.instances.iter().find(|i| i.kind == kind).cloned().expect("a candidate");
            let [ahead, one, other] = ["sensor_gain", "clock_offset", "sensor_orientation"].map(of);
            let unnamed = effects::unnamed(&problem.array).swap_remove(0);
            let pair = vec![one.clone(), other.clone()];
            let sets = [vec![ahead], vec![one], vec![other], pair.clone(), vec![unnamed]];
            let mut has_pair = |reached: [f64; 5]| {
                competition.fits.truncate(1);
                for (effects, ln_odds) in sets.iter().zip(reached) {
                    let starts = effects.iter().flat_map(Instance::start);
                    let x = vec![0.0; declared.len()].into_iter().chain(starts).collect();
                    let model = Model { declared, effects: effects.clone() };
                    let mut fit = competition.fitter.fit(Start::at(model, x), Stop::WHERE_IT_IS).expect("a fit");
                    fit.cost += competition.log_posterior(&fit) - competition.log_posterior(&competition.fits[0]);
                    fit.cost -= ln_odds;
                    competition.fits.push(fit);
                }
                competition.agenda(&labels, true).iter().any(|set| is_same_set(set, &pair))
            };
            assert!(has_pair([10.0, -5.0, -6.0, 4.0, 12.0]));
            assert!(!has_pair([10.0, -5.0, -6.0, 4.0, 8.0]), "what has a name does as well");
            assert!(!has_pair([10.0, -5.0, -6.0, -7.0, 12.0]), "one of the two does as well");
        });
    }
}
