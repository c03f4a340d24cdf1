//! The ground the forward search stands on: models settled on training events and judged on validation events.

use super::anchor::Anchor;
use super::fit::{Fitter, Point};
use super::followed::scaled;
use super::problem::{Motions, Problem, Replay};
use super::responses::{Responses, Scene};
use super::settings::DiagnoseSettings;
use super::unknowns::{Nuisance, Unknowns, nuisances};
use crate::effects::{self, Instance};
use crate::error::{Error, Result};
use crate::records::Split;

/// Standard deviations beyond noise at which a model is no place to see an effect of the soil from.
const FAR: f64 = 30.0;

/// Standard deviations by which nuisances are farther from what is declared than chance puts them where they stand for something else.
const STRAINED: f64 = 3.0;

/// Standard deviations beyond noise up to which nothing is left.
pub(super) const CLEAN: f64 = 3.0;

/// Everything that stays the same during a diagnosis.
pub struct Search<'a> {
    /// The problem in the frequency domain.
    pub scene: &'a Scene<'a>,
    /// How to search.
    pub settings: &'a DiagnoseSettings,
    /// The nonlinear column; `None` lets the fast one stand alone.
    pub replay: Option<&'a dyn Replay>,
    /// What each effect could be here.
    pub instances: Vec<Instance>,
    /// Nuisances of every model.
    pub nuisances: Vec<Nuisance>,
    /// Groups to fit.
    pub train: Vec<usize>,
    /// Groups to judge by.
    pub validation: Vec<usize>,
    /// Weight of the prior of each nuisance; one but where a model is to be as close to what is declared as noise allows.
    pub stiffness: Vec<f64>,
}

/// A model: effects, and their and the nuisances' estimates.
#[derive(Clone)]
pub struct Model {
    /// Effects beyond the declared ones.
    pub effects: Vec<Instance>,
    /// At the estimate, training events.
    pub train: Point,
    /// At the same unknowns, validation events.
    pub validation: Point,
    /// What these cost beyond what the training events have left open.
    unforeseen: f64,
    /// Costs of training and validation events if only noise were left.
    pub expected: [f64; 2],
}

impl Model {
    /// The estimate.
    pub fn x(&self) -> &[f64] {
        &self.train.x
    }

    /// Σ|ρ|² of the validation events beyond what the training events have left open: [`Fitter::predictive`].
    pub fn validation_cost(&self) -> f64 {
        self.unforeseen
    }

    /// Cost with priors on training events, and that of the validation events.
    pub fn costs(&self) -> [f64; 2] {
        [self.train.cost, self.validation_cost()]
    }

    /// Cost with priors on training events plus that of the validation events.
    pub fn cost(&self) -> f64 {
        self.train.cost + self.validation_cost()
    }

    /// Σn² of the nuisances: how far they are from what is declared.
    pub fn prior(&self) -> f64 {
        square(&self.x()[..self.n_nuisance()])
    }

    /// Standard deviations by which the nuisances are farther from what is declared than chance puts them.
    pub fn strain(&self) -> f64 {
        let n = self.n_nuisance() as f64;
        (self.prior() - n) / (2.0 * n).sqrt()
    }

    /// Whether nothing but noise is left because nuisances went farther than chance lets them.
    pub fn is_strained(&self) -> bool {
        self.is_clean() && self.strain() > STRAINED
    }

    /// Number of nuisances.
    pub fn n_nuisance(&self) -> usize {
        self.x().len() - self.effects.iter().map(|e| e.free.len()).sum::<usize>()
    }

    /// Cost over the cost of noise alone.
    pub fn level(&self) -> f64 {
        (square(&self.train.residual) + self.validation_cost()) / (self.expected[0] + self.expected[1])
    }

    /// Standard deviations by which the residuals of training and validation events exceed those of noise alone.
    pub fn surprise(&self) -> [f64; 2] {
        let of = |square: f64, n: f64| (square - n) / (2.0 * n).sqrt();
        [of(square(&self.train.residual), self.expected[0]), of(self.validation_cost(), self.expected[1])]
    }

    /// Whether so much is left that this is no place to see an effect of the soil from.
    pub fn is_far(&self) -> bool {
        self.surprise().into_iter().any(|s| s > FAR)
    }

    /// Whether no more than noise is left.
    pub fn is_clean(&self) -> bool {
        self.surprise().into_iter().all(|s| s < CLEAN)
    }

    /// Cost beyond that of noise alone.
    pub fn excess(&self) -> f64 {
        self.cost() - self.expected[0] - self.expected[1]
    }
}

/// Σ r².
pub fn square(residual: &[f64]) -> f64 {
    residual.iter().map(|r| r * r).sum()
}

impl<'a> Search<'a> {
    /// Prepares the search on `scene`.
    ///
    /// # Errors
    /// When there are no training or no validation events.
    pub fn new(scene: &'a Scene<'a>, settings: &'a DiagnoseSettings, replay: Option<&'a dyn Replay>) -> Result<Self> {
        let problem: &Problem = scene.problem;
        let (train, validation) = (scene.of(Split::Train), scene.of(Split::Validation));
        if train.is_empty() || validation.is_empty() {
            let what = format!(
                "a diagnosis needs training and validation events, got {} and {}",
                train.len(),
                validation.len()
            );
            return Err(Error::new(what).hint("name events in `records.train` and `records.validation`").usage());
        }
        let nuisances = nuisances(problem)?;
        Ok(Self {
            scene,
            settings,
            replay,
            instances: effects::instances(&problem.array),
            stiffness: vec![scene.stiffness; nuisances.len()],
            nuisances,
            train,
            validation,
        })
    }

    /// ln of the number of residuals: the charge per parameter.
    pub fn charge(&self) -> f64 {
        ((self.scene.n_residual(&self.train) + self.scene.n_residual(&self.validation)) as f64).ln()
    }

    /// Unknowns with these effects.
    pub fn unknowns(&self, effects: &[Instance]) -> Unknowns<'_> {
        let axes = self.scene.neighbours.as_ref().map(|n| &n.axes[..]);
        Unknowns { nuisances: &self.nuisances, effects: effects.to_vec(), axes }
    }

    /// A fitter on the training events.
    pub fn fitter<'b>(&'b self, anchor: &'b Anchor) -> Fitter<'b> {
        Fitter { scene: self.scene, anchor, groups: &self.train, stiffness: &self.stiffness }
    }

    /// Fits `effects` from `x` with at most `steps` steps (0: just looks) and judges the result.
    ///
    /// # Errors
    /// When `x` cannot be evaluated.
    pub fn settle(
        &self,
        effects: &[Instance],
        x: &[f64],
        anchor: &Anchor,
        near: Option<&Model>,
        steps: usize,
    ) -> Result<Model> {
        let unknowns = self.unknowns(effects);
        let fitter = self.fitter(anchor);
        let train = self.fitted(effects, x, (anchor, near), (steps, 0.0))?;
        let judge = Fitter { groups: &self.validation, ..fitter };
        let validation = judge.at(&unknowns, &train.x, near.map(|m| &m.validation.responses))?;
        let expected = [&train, &validation].map(|p| p.residual.len() as f64);
        let unforeseen = fitter.predictive(&unknowns, &train, (&judge, &validation));
        Ok(Model { effects: effects.to_vec(), train, validation, unforeseen, expected })
    }

    /// The same on training events, not judged, with a `hold` on the way from `x`: [`Fitter::fit`].
    ///
    /// # Errors
    /// When `x` cannot be evaluated.
    pub(super) fn fitted(
        &self,
        effects: &[Instance],
        x: &[f64],
        (anchor, near): (&Anchor, Option<&Model>),
        (steps, hold): (usize, f64),
    ) -> Result<Point> {
        let (unknowns, fitter) = (self.unknowns(effects), self.fitter(anchor));
        let start = fitter.at(&unknowns, x, near.map(|m| &m.train.responses))?;
        fitter.fit(&unknowns, start, steps, hold)
    }

    /// Replays the events at `x`, `before` being the anchor from which it was reached; without a replay, the fast column is its own anchor.
    ///
    /// # Errors
    /// When the replay is impossible.
    pub fn anchored(&self, effects: &[Instance], x: &[f64], before: Option<&Anchor>) -> Result<Anchor> {
        if self.replay.is_none() {
            return Ok(Anchor::fast(self.scene));
        }
        Ok(self.anchored_with_responses(effects, x, before)?.0)
    }

    /// The same with the fast column's responses there.
    ///
    /// # Errors
    /// When the replay is impossible.
    pub(super) fn anchored_with_responses(
        &self,
        effects: &[Instance],
        x: &[f64],
        before: Option<&Anchor>,
    ) -> Result<(Anchor, Responses)> {
        let replays = self.replay.map_or(Ok(Vec::new()), |r| r.replay(&self.unknowns(effects).tables(x)))?;
        self.anchor((effects, x), &replays, before)
    }

    /// The same where the `replays` at `x` are there already.
    ///
    /// # Errors
    /// When an effect cannot be built.
    pub(super) fn anchor(
        &self,
        (effects, x): (&[Instance], &[f64]),
        replays: &Motions,
        before: Option<&Anchor>,
    ) -> Result<(Anchor, Responses)> {
        let unknowns = self.unknowns(effects);
        let built = unknowns.build(&self.scene.problem.declared, x)?;
        let all: Vec<usize> = (0..self.scene.groups.len()).collect();
        let responses = self.scene.responses(&built, &all, None)?;
        let placed = scaled(self.scene, &unknowns, x)?;
        Ok((Anchor::of(self.scene, replays, (&built, &placed), &responses, before), responses))
    }
}
