//! The search for the most probable coordinates: Gauss–Newton steps within a trust region, by slopes that are carried along, learn from
//! every step, and are taken anew where they lead no further: by the equivalent-linear column and what that lacked where replays told, and by
//! replays where that is not enough and where a search ends for good.

use super::slopes::{Slope, rows_of};
use super::{Fit, Fitter, Point, Start, information, occam, step};
use crate::error::Result;
use crate::inference::algebra::solved;
use crate::inference::parameters::Model;
use faer::Mat;

/// Most steps of a fit.
const STEPS: usize = 30;
/// Expected gain below which a fit has converged, nats.
const CONVERGED: f64 = 0.2;
/// The same on the way.
const NEAR: f64 = 1.0;
/// Change of ln of the evidence by slopes taken anew below which they are right.
const STILL: f64 = 0.5;
/// Steps in a row that carried slopes may foretell wrongly: the first may have been too long.
const DOUBTS: usize = 1;
/// Most times that slopes are taken anew at one place.
const RENEWALS: usize = 4;
/// Share of the expected gain that a step must bring to be taken.
const TAKEN: f64 = 0.02;
/// Shares of the expected gain between which a step bears out the slopes that foretold it.
const TRUSTED: [f64; 2] = [0.3, 2.0];
/// Prior standard deviations by which any coordinate moves at most in the first step, in any, and below which a fit ends.
const RADIUS: [f64; 3] = [1.0, 4.0, 0.002];
/// Radius after a step that did something else than foretold, over that before.
const SHORTER: f64 = 0.35;
/// Length of a step, prior standard deviations, below which what a replay does is as much the chance of its time steps as the step's.
pub(super) const JITTER: f64 = 0.005;

/// Where the slopes of a search are from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Taken {
    /// Another place, and what steps from there did.
    Elsewhere,
    /// Where it is, by the equivalent-linear column and what that lacked where replays told.
    Led,
    /// Where it is, by replays.
    Replayed,
}

/// When a fit ends.
#[derive(Debug, Clone, Copy)]
pub struct Stop {
    /// Most steps.
    pub steps: usize,
    /// Expected gain below which it has converged, in ln of the posterior density.
    pub gain: f64,
    /// How slopes are taken where it ends, until what they say of the evidence stands still.
    pub slopes: Taken,
}

impl Stop {
    /// At the most probable coordinates.
    pub const EXACT: Self = Self { steps: STEPS, gain: CONVERGED, slopes: Taken::Replayed };
    /// As close to these as models have to be compared by on the way.
    pub const CLOSE: Self = Self { steps: STEPS, gain: NEAR, slopes: Taken::Led };
    /// Good enough to go on from.
    pub const ON_THE_WAY: Self = Self { steps: STEPS / 3, gain: NEAR, slopes: Taken::Elsewhere };
    /// At once: what is known of the model where it is.
    pub const WHERE_IT_IS: Self = Self { steps: 0, ..Self::CLOSE };
}

/// Whether what was `gained` bears out what slopes `foretold`.
fn is_borne_out(gained: f64, foretold: f64) -> bool {
    (TRUSTED[0]..TRUSTED[1]).contains(&(gained / foretold))
}

/// A search on its way.
struct Search<'a> {
    model: Model<'a>,
    at: Point,
    slopes: Vec<Slope>,
    taken: Taken,
    /// Whether what slopes taken where it is say of the evidence stood still.
    is_still: bool,
    /// Times that slopes were taken anew where it is, and in the same way.
    renewals: usize,
    /// Steps in a row that did something else than foretold.
    doubts: usize,
    radius: f64,
}

impl Search<'_> {
    /// Whether its slopes are as right as those that are `taken` so.
    fn is_known(&self, taken: Taken) -> bool {
        taken == Taken::Elsewhere || (self.is_still && self.taken >= taken)
    }
}

impl<'a> Fitter<'a> {
    /// Fits from `start`: Gauss–Newton steps within a trust region. Slopes are carried along and learn from every step; where they lead
    /// no further they are taken anew, until what they say of the evidence stands still. An error of slopes changes where a fit ends by its
    /// share of the posterior deviation where residuals are what is expected of them; where they are more than that, slopes in doubt are
    /// replayed.
    ///
    /// # Errors
    /// When the column cannot be replayed at the start.
    pub fn fit(&self, start: Start<'a>, stop: Stop) -> Result<Fit<'a>> {
        let was_settled = stop.steps == 0 && start.is_settled;
        let mut search = self.begun(start)?;
        let has_ended = (0..stop.steps).any(|_| self.has_ended(&mut search, stop)) || stop.steps == STEPS;
        let is_settled = was_settled || (has_ended && stop.slopes > Taken::Elsewhere);
        let g = self.normal(&rows_of(&search.slopes), &search.at.rows);
        let cost = self.cost(&search.model, &search.at);
        let taken = if search.is_still { search.taken } else { Taken::Elsewhere };
        let Search { model, at, slopes, .. } = search;
        let Point { x, prediction, rows, .. } = at;
        Ok(Fit { model, x, prediction, rows, cost, slopes, g, taken, is_settled })
    }

    fn begun(&self, start: Start<'a>) -> Result<Search<'a>> {
        let Start { model, x, slopes: known, taken, .. } = start;
        let at = self.point(&model, x)?;
        let slopes = self.first_slopes(&model, &at, known);
        let (is_still, renewals, doubts, radius) = (taken > Taken::Elsewhere, 0, 0, RADIUS[0]);
        Ok(Search { model, at, slopes, taken, is_still, renewals, doubts, radius })
    }

    /// Whether there is nothing more to be gained; otherwise goes a step or takes slopes anew.
    fn has_ended(&self, search: &mut Search<'a>, stop: Stop) -> bool {
        let g = self.normal(&rows_of(&search.slopes), &search.at.rows);
        let cost = self.cost(&search.model, &search.at);
        let (to, expected) = step(&search.model, &search.at.x, &g, search.radius);
        // What is left to gain is not what a short step gains.
        let (_, whole) = step(&search.model, &search.at.x, &g, f64::INFINITY);
        if whole < stop.gain || expected <= 0.0 || search.radius < RADIUS[2] {
            let is_known = search.is_known(stop.slopes);
            if is_known && (stop.slopes == Taken::Elsewhere || self.is_told(search, &g, stop.gain)) {
                return true;
            }
            search.doubts = 0;
            search.radius = search.radius.max(JITTER);
            self.renew(search, if is_known { Taken::Replayed } else { stop.slopes });
            return false;
        }
        let found = self.point(&search.model, to).ok();
        let gained = found.as_ref().map_or(f64::NEG_INFINITY, |found| cost - self.cost(&search.model, found));
        let ratio = gained / expected;
        let is_expected = is_borne_out(gained, expected) || (gained - expected).abs() < stop.gain;
        let is_carried = search.taken == Taken::Elsewhere;
        search.doubts = if is_carried && !is_expected { search.doubts + 1 } else { 0 };
        // Slopes are blamed, and not the length of the step, if better ones can be had.
        let is_at_fault = search.doubts > DOUBTS;
        search.radius = match ratio {
            _ if is_at_fault => search.radius.max(JITTER),
            r if r > 0.75 => (2.0 * search.radius).min(RADIUS[1]),
            r if r < TRUSTED[0] => SHORTER * search.radius,
            _ => search.radius,
        };
        if let Some(found) = &found {
            Self::learn(&search.model, &mut search.slopes, [&search.at, found]);
        }
        let is_stuck = match &found {
            Some(found) if ratio > TAKEN => {
                self.carry(search, found);
                false
            }
            _ => stop.slopes > Taken::Elsewhere && !search.is_known(Taken::Replayed),
        };
        if is_at_fault || is_stuck {
            self.renew(search, if search.is_known(Taken::Led) { Taken::Replayed } else { Taken::Led });
        }
        false
    }

    /// Whether slopes are by replays, or what may be wrong with them counts for less than `gain` here: where residuals are large, so is
    /// what wrong slopes make of them.
    fn is_told(&self, search: &Search<'a>, g: &Mat<f64>, gain: f64) -> bool {
        let Search { model, at, slopes, taken, .. } = search;
        if *taken == Taken::Replayed {
            return true;
        }
        let rows = self.counted(&at.rows);
        let doubt = |(i, slope): (usize, &Slope)| if model.is_at_end(&at.x, i) { 0.0 } else { slope.doubt(&rows) };
        let doubts: Vec<f64> = slopes.iter().enumerate().map(doubt).collect();
        let moved = solved(&information(model, g), &doubts);
        let counts = |moved: Vec<f64>| 0.5 * moved.iter().zip(&doubts).map(|(a, b)| a * b).sum::<f64>();
        moved.is_some_and(|moved| counts(moved) < gain)
    }

    /// Takes a search and its slopes to where a step ended.
    fn carry(&self, search: &mut Search<'a>, to: &Point) {
        search.at = to.clone();
        let known: Vec<Option<Slope>> = search.slopes.drain(..).map(Some).collect();
        search.slopes = self.slopes(&search.model, &search.at, &known);
        (search.taken, search.is_still, search.renewals) = (Taken::Elsewhere, false, 0);
    }

    /// Takes the slopes of a search anew where it is.
    fn renew(&self, search: &mut Search<'a>, taken: Taken) {
        let Search { model, at, slopes, .. } = &*search;
        let led = if taken == Taken::Led { self.led(model, at, slopes) } else { None };
        let taken = if led.is_some() { Taken::Led } else { Taken::Replayed };
        let (found, is_open) = led.unwrap_or_else(|| (self.replayed(model, at, slopes), true));
        let evidence = |slopes: &[Slope]| occam(model, &at.x, &self.normal(&rows_of(slopes), &at.rows));
        let moved = (evidence(&found) - evidence(slopes)).abs();
        search.renewals = if search.taken == taken { search.renewals + 1 } else { 1 };
        search.is_still = !is_open || moved < STILL || search.renewals == RENEWALS;
        (search.slopes, search.taken) = (found, taken);
    }
}
