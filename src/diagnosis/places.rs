//! Where else an effect could sit: the place that was found first may only be next to the right one.

use super::anchor::Anchor;
use super::problem::{Replay, Roughly};
use super::responses::Scene;
use super::search::{Model, Search};
use super::settings::DiagnoseSettings;
use super::settling::MAX_ANCHORS;
use crate::effects::Instance;
use crate::error::Result;
use crate::progress::{Progress, Quiet};

/// Most times an effect is moved to a place next to its own.
const MAX_MOVES: usize = 3;
/// Places tried on either side.
const REACH: usize = 2;
/// Strengths tried there, as shares of the strength found here in typical sizes; tolerances of velocities make up for the difference.
const STRENGTHS: [f64; 3] = [0.75, 1.0, 1.33];
/// Steps of a fit there.
const STEPS: usize = 4;
/// Most replays there.
const REPLAYS: usize = 6;
/// Prior cost of nuisances by which a model is plainer than another.
const PLAINER: f64 = 5.0;
/// Share of the excess over noise that another model must take away.
const WORTHWHILE: f64 = 0.1;

impl Scene<'_> {
    /// The model with its last effect moved to a better place: that of a `rival`, if there is one; then those next to its own, as
    /// long as more than noise is left and that helps. The scene looks around there.
    ///
    /// # Errors
    /// When a replay is impossible.
    pub(super) fn moved(
        &mut self,
        ((mut model, mut anchor), mut rival): ((Model, Anchor), Option<Model>),
        replay: &dyn Replay,
        settings: &DiagnoseSettings,
        progress: &dyn Progress,
    ) -> Result<(Model, Anchor)> {
        for _ in 0..MAX_MOVES {
            let is_rival = rival.is_some();
            let elsewhere = match rival.take() {
                Some(rival) => Some((rival.effects.clone(), rival.x().to_vec())),
                None if model.is_clean() => None,
                None => self.elsewhere(&model, replay, settings)?,
            };
            let Some((effects, x)) = elsewhere else { break };
            let mut there = self.clone();
            let found = there.settled_around((&effects, &x), (replay, MAX_ANCHORS), settings, progress)?;
            if is_preferred(&found.0, &model, settings) {
                ((model, anchor), *self) = (found, there);
            } else if !is_rival {
                break;
            }
        }
        Ok((model, anchor))
    }

    /// The effects and unknowns of `model` with its last effect at another place nearby, at which rough replays around that leave clearly
    /// less; `None` where there is none.
    ///
    /// # Errors
    /// When a replay is impossible.
    fn elsewhere(
        &self,
        model: &Model,
        replay: &dyn Replay,
        settings: &DiagnoseSettings,
    ) -> Result<Option<(Vec<Instance>, Vec<f64>)>> {
        let roughly = Roughly(replay);
        let search = Search::new(self, settings, Some(&roughly))?;
        let at = |effects: &[Instance], x: &[f64]| -> Result<Model> {
            search.settle(effects, x, &search.anchored(effects, x, None)?, None, STEPS)
        };
        let places = search.places(model)?;
        if places.is_empty() {
            return Ok(None);
        }
        let here = at(&model.effects, model.x())?;
        let mut best = (here.cost() - worthwhile(&here, settings), None);
        for Place { effects, starts } in places {
            let tried = starts.iter().filter_map(|x| at(&effects, x).ok());
            let Some(start) = tried.min_by(|a, b| a.cost().total_cmp(&b.cost())) else { continue };
            let place = (&effects[..], start.x());
            if let Ok((found, _)) = self.clone().settled_around(place, (&roughly, REPLAYS), settings, &Quiet)
                && found.cost() < best.0
            {
                best = (found.cost(), Some((effects, found.x().to_vec())));
            }
        }
        Ok(best.1)
    }
}

/// What another must cost less than the `model` to be worth going there.
pub(super) fn worthwhile(model: &Model, settings: &DiagnoseSettings) -> f64 {
    settings.ambiguity.max(WORTHWHILE * model.excess())
}

/// Whether `one` leaves clearly less than `other`, or is plainer.
pub(super) fn is_preferred(one: &Model, other: &Model, settings: &DiagnoseSettings) -> bool {
    is_plainer(one, other) || (!is_bought(one, other) && one.cost() < other.cost() - worthwhile(other, settings))
}

/// Whether `one` leaves no more than noise only because declared values went farther off than chance puts them, where `other` leaves no
/// more either: it has found another name for what is wrong, not a better one.
pub(super) fn is_bought(one: &Model, other: &Model) -> bool {
    one.is_strained() && other.is_clean() && !is_plainer(one, other)
}

/// Whether neither leaves more than noise, and the nuisances of `one` are clearly closer to what is declared. Costs of such models
/// differ by what replays are worth.
pub(super) fn is_plainer(one: &Model, other: &Model) -> bool {
    one.is_clean() && other.is_clean() && one.prior() < other.prior() - PLAINER
}

/// The last effect of a model at another place, and where fits there start.
struct Place {
    effects: Vec<Instance>,
    starts: Vec<Vec<f64>>,
}

impl Search<'_> {
    /// The places next to that of the last effect of `model`.
    fn places(&self, model: &Model) -> Result<Vec<Place>> {
        let Some((last, others)) = model.effects.split_last() else { return Ok(Vec::new()) };
        let alike: Vec<&Instance> = self.instances.iter().filter(|i| i.is_alike(last)).collect();
        let (Some(here), Some(zero)) = (alike.iter().position(|i| *i == last), last.zero()) else {
            return Ok(Vec::new());
        };
        let (_, released) = self.without(&model.effects, model.x(), others.len())?;
        let strength = model.x().len() - last.free.len();
        let size = |i: &Instance| i.free.first().map_or(1.0, |f| f.size);
        let mut places = Vec::new();
        for place in &alike[here.saturating_sub(REACH)..(here + REACH + 1).min(alike.len())] {
            if model.effects.contains(place) {
                continue;
            }
            let scaled = STRENGTHS.iter().map(|share| -> Result<Vec<f64>> {
                let mut own = model.x()[strength..].to_vec();
                own[0] = zero[0] + share * (own[0] - zero[0]) * size(place) / size(last);
                own.iter_mut().zip(place.bounds()).for_each(|(x, [low, high])| *x = x.clamp(low, high));
                let shift = self.scene.velocity_shift_with(&place.at(&own))?;
                let mut x = released.clone();
                x.iter_mut().zip(shift).for_each(|(x, shift)| *x -= shift);
                x.extend(own);
                Ok(x)
            });
            let effects = [others, &[(*place).clone()]].concat();
            let unknowns = self.unknowns(&effects);
            let mut starts: Vec<Vec<f64>> = scaled.collect::<Result<_>>()?;
            starts.extend(self.instead(others, &released, place)?);
            starts.iter_mut().for_each(|x| unknowns.clip(x));
            places.push(Place { effects, starts });
        }
        Ok(places)
    }
}
