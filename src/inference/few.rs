//! A few events that stand for all: enough to tell which candidates are worth a fit to all of them.

use super::forward::Forward;
use super::parameters::{Declared, Model};
use super::posterior::{Fit, Fitter, Start, Stop};
use super::weights::Rows;
use crate::error::Result;
use std::sync::Arc;

/// Events that stand for all.
const EVENTS: usize = 3;

/// The column and the sensors in a few events, the strongest among them.
pub struct Few<'a> {
    /// Replays of these events.
    pub forward: &'a Forward<'a>,
    /// What may be off, conventions in these events.
    pub declared: &'a Declared,
}

/// The strongest event, and the first and the last of the others: what depends on strain or on the past differs most between these.
pub fn groups(forward: &Forward<'_>) -> Vec<usize> {
    let strength = |g: &usize| -> f64 {
        let of = |event: usize| forward.problem.events[event].input.iter().fold(0.0, |m: f64, a| m.max(a.abs()));
        forward.groups[*g].records.iter().map(|r| of(r.event)).fold(0.0, f64::max)
    };
    let all: Vec<usize> = (0..forward.groups.len()).collect();
    let strongest = all.iter().copied().max_by(|a, b| strength(a).total_cmp(&strength(b))).unwrap_or(0);
    let others: Vec<usize> = all.into_iter().filter(|g| *g != strongest).collect();
    let ends = others.len().saturating_sub(EVENTS - 2);
    let mut chosen: Vec<usize> = others.iter().take(1).chain(others.iter().skip(ends.max(1))).copied().collect();
    chosen.push(strongest);
    chosen.sort_unstable();
    chosen
}

impl<'a> Few<'a> {
    /// `fitter` in these events.
    pub fn fitter(&self, fitter: &Fitter<'a>) -> Fitter<'a> {
        self.forward.follow(fitter.forward);
        fitter.in_events(self.forward)
    }

    /// `fit`, to all events, in these: where it is, with its slopes.
    ///
    /// # Errors
    /// When the column cannot be replayed.
    pub fn of(&self, by: &Fitter<'a>, fit: &Fit<'a>) -> Result<Fit<'a>> {
        let model = Model { declared: self.declared, effects: fit.model.effects.clone() };
        let slopes = fit.slopes.iter().map(|s| Some(Arc::new(self.forward.rows_of(s))));
        by.fit(Start::at(model, fit.x.clone()).carrying(slopes, fit), Stop::WHERE_IT_IS)
    }
}

impl<'a> Forward<'a> {
    /// Its `groups` alone, each standing for as many as there are of all to one of them.
    pub fn in_groups(&self, groups: &[usize]) -> Self {
        let mut few = self.without_replays(groups.iter().map(|g| self.groups[*g].clone()).collect());
        let is_kept = |i: &usize| groups.contains(&self.records[*i].group);
        few.kept = (0..self.records.len()).filter(is_kept).collect();
        few.share = few.records.len() as f64 / self.records.len() as f64;
        few
    }

    /// Those of a list with one value for each record of all events that are of its own.
    pub fn kept<T: Clone>(&self, of_all: &[T]) -> Vec<T> {
        self.kept.iter().map(|i| of_all[*i].clone()).collect()
    }

    /// Residuals of its own records among those of all, each counting for as many records as it stands for.
    fn rows_of(&self, of_all: &Rows) -> Rows {
        let factor = 1.0 / self.share.sqrt();
        let scaled = |i: &usize| of_all[*i].iter().map(|r| r * factor).collect();
        self.kept.iter().map(scaled).collect()
    }
}

impl Declared {
    /// The same, conventions in the records of `few` alone.
    pub fn in_events(&self, few: &Forward<'_>) -> Self {
        let conventions = self.conventions.iter().map(|c| Arc::new(few.kept(c))).collect();
        self.clone().with_conventions(conventions)
    }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Truth, Uniform, problem};
    use super::super::weights::Expected;
    use super::*;
    use crate::diagnosis::DiagnoseSettings;

    #[test]
    fn a_fit_in_few_events_is_that_part_of_the_fit_to_all() {
        let problem = problem(&Truth { soil: [204.0, 0.022], ..Truth::default() });
        let replay = Uniform(&problem);
        let whole = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        whole.anchor(&[]).unwrap();
        let declared = Declared::new(&problem).unwrap();
        let prediction = Arc::new(whole.predict(&[]).unwrap());
        let fitter = Fitter::new(&whole, Expected::of(&whole, prediction));
        let model = Model { declared: &declared, effects: Vec::new() };
        let fit = fitter.fit(Start::at(model, vec![0.0; declared.len()]), Stop::CLOSE).unwrap();
        let chosen = groups(&whole);
        // The strongest is the last of the eight, the others the first and the last beside it.
        assert_eq!(chosen, [0, 6, 7]);
        let few = whole.in_groups(&chosen);
        let own = declared.in_events(&few);
        let few = Few { forward: &few, declared: &own };
        let by = few.fitter(&fitter);
        let part = few.of(&by, &fit).unwrap();
        let expected = few.forward.rows_of(&fit.rows);
        let pairs = part.rows.iter().flatten().zip(expected.iter().flatten());
        assert!(pairs.clone().count() > 1000);
        pairs.for_each(|(a, b)| assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} {b}"));
        // Eight like these three are known as well as all eight.
        let ratio = part.covariance().unwrap()[(0, 0)] / fit.covariance().unwrap()[(0, 0)];
        assert!((0.5..2.0).contains(&ratio), "{ratio}");
    }
}
