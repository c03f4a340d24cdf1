//! A few events that stand for all: enough to tell which candidates are worth a fit to all of them.

use super::forward::Forward;
use super::parameters::{Declared, Model};
use super::posterior::{Fit, Fitter, Start, Stop};
use super::weights::Rows;
use crate::error::Result;
use std::sync::Arc;

/// Events that stand for all: two components of each are what is replayed side by side.
const EVENTS: usize = 4;

/// The column and the sensors in a few events, the strongest among them.
pub struct Few<'a> {
    /// Replays of these events.
    pub forward: &'a Forward<'a>,
    /// What may be off, conventions in these events.
    pub declared: &'a Declared,
}

/// The strongest event.
pub(super) fn strongest(forward: &Forward<'_>) -> usize {
    let strength = |g: &usize| -> f64 {
        let of = |event: usize| forward.problem.events[event].input.iter().fold(0.0, |m: f64, a| m.max(a.abs()));
        forward.groups[*g].records.iter().map(|r| of(r.event)).fold(0.0, f64::max)
    };
    (0..forward.groups.len()).max_by(|a, b| strength(a).total_cmp(&strength(b))).unwrap_or(0)
}

/// The strongest event, and others from the first to the last: what depends on strain or on the past differs most between these.
pub fn groups(forward: &Forward<'_>) -> Vec<usize> {
    let strongest = strongest(forward);
    let others: Vec<usize> = (0..forward.groups.len()).filter(|g| *g != strongest).collect();
    let count = others.len().min(EVENTS - 1);
    let evenly = |i: usize| others[i * (others.len() - 1) / (count - 1).max(1)];
    let mut chosen: Vec<usize> = (0..count).map(evenly).chain([strongest]).collect();
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
        by.fit(Start::at(model, fit.x.clone()).carrying(slopes), Stop::WHERE_IT_IS)
    }
}

impl<'a> Forward<'a> {
    /// Its `groups` alone: the strongest, which is always among them, stands for itself, and the others for all others.
    ///
    /// Source: Horvitz and Thompson (1952), doi 10.1080/01621459.1952.10483446: what is drawn with certainty counts once.
    pub fn in_groups(&self, groups: &[usize]) -> Self {
        let mut few = self.without_replays(groups.iter().map(|g| self.groups[*g].clone()).collect());
        few.kept = (0..self.records.len()).filter(|i| groups.contains(&self.records[*i].group)).collect();
        let strongest = strongest(self);
        let is_other = |i: &usize| self.records[*i].group != strongest;
        let others =
            [(0..self.records.len()).filter(is_other).count(), few.kept.iter().filter(|i| is_other(i)).count()];
        let each = others[0] as f64 / others[1].max(1) as f64;
        few.stands_for = few.kept.iter().map(|i| if is_other(i) { each } else { 1.0 }).collect();
        few
    }

    /// Those of a list with one value for each record of all events that are of its own.
    pub fn kept<T: Clone>(&self, of_all: &[T]) -> Vec<T> {
        self.kept.iter().map(|i| of_all[*i].clone()).collect()
    }

    /// Residuals of its own records among those of all, each counting for as many records as it stands for.
    fn rows_of(&self, of_all: &Rows) -> Rows {
        let scaled = |(i, n): (&usize, &f64)| of_all[*i].iter().map(|r| r * n.sqrt()).collect();
        self.kept.iter().zip(&self.stands_for).map(scaled).collect()
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
    use crate::diagnosis::{DiagnoseSettings, Motions, Replay};

    /// Smaller elements make the motion of the upper sensor a twentieth larger in the strongest event, and a tenth in the others.
    struct InHalves<'a>(Uniform<'a>);

    impl Replay for InHalves<'_> {
        fn replay(&self, effects: &[toml::Table]) -> Result<Motions> {
            self.0.replay(effects)
        }

        fn replay_in_halves(&self, effects: &[toml::Table], is_wanted: &[bool]) -> Result<Option<[Motions; 2]>> {
            let whole = self.replay(effects)?;
            let mut halved = whole.clone();
            for (motion, is_wanted) in halved.iter_mut().zip(is_wanted) {
                let factor = if *is_wanted { 1.05 } else { 1.1 };
                motion.as_mut().unwrap().last_mut().unwrap().iter_mut().for_each(|v| *v *= factor);
            }
            Ok(Some([whole, halved]))
        }
    }

    #[test]
    fn what_is_not_converged_is_told_of_the_strongest_event_and_the_worst_sensor() {
        let problem = problem(&Truth::default());
        let replay = InHalves(Uniform(&problem));
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        let share = forward.discretisation_share(&[]).unwrap();
        assert!((share - 0.05 / 1.05).abs() < 1e-9, "{share}");
        let silent = Uniform(&problem);
        let forward = Forward::new(&problem, &silent, &DiagnoseSettings::default()).unwrap();
        assert_eq!(forward.discretisation_share(&[]), None);
    }

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
        // The strongest is the last of the eight, the others the first, the last beside it and the one between.
        assert_eq!(chosen, [0, 3, 6, 7]);
        let few = whole.in_groups(&chosen);
        // Two components of each.
        assert_eq!(few.stands_for, [[7.0 / 3.0; 6].as_slice(), &[1.0; 2]].concat());
        let own = declared.in_events(&few);
        let few = Few { forward: &few, declared: &own };
        let by = few.fitter(&fitter);
        let part = few.of(&by, &fit).unwrap();
        let expected = few.forward.rows_of(&fit.rows);
        let pairs = part.rows.iter().flatten().zip(expected.iter().flatten());
        assert!(pairs.clone().count() > 1000);
        pairs.for_each(|(a, b)| assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} {b}"));
        // Seven like three of these and the strongest are known as well as all eight.
        let ratio = part.covariance().unwrap()[(0, 0)] / fit.covariance().unwrap()[(0, 0)];
        assert!((0.5..2.0).contains(&ratio), "{ratio}");
    }
}
