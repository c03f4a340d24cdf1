//! The search for the most probable coordinates: Gauss–Newton steps within a trust region, by slopes that are carried along, learn from
//! every step, and are taken anew where they lead no further.

use super::slopes::Axes;
use super::{Fit, Fitter, Point, Start, occam, step};
use crate::error::Result;
use crate::inference::parameters::Model;
use crate::inference::weights::Rows;
use std::sync::Arc;

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

/// When a fit ends.
#[derive(Debug, Clone, Copy)]
pub struct Stop {
    /// Most steps.
    pub steps: usize,
    /// Expected gain below which it has converged, in ln of the posterior density.
    pub gain: f64,
    /// Whether slopes are taken where it ends, until what they say of the evidence stands still.
    pub settles: bool,
}

impl Stop {
    /// At the most probable coordinates.
    pub const EXACT: Self = Self { steps: STEPS, gain: CONVERGED, settles: true };
    /// As close to these as models have to be compared by on the way.
    pub const CLOSE: Self = Self { steps: STEPS, gain: NEAR, settles: true };
    /// Good enough to go on from.
    pub const ON_THE_WAY: Self = Self { steps: STEPS / 3, gain: NEAR, settles: false };
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
    slopes: Vec<Arc<Rows>>,
    /// Whether slopes are from another place and what steps from there did.
    is_carried: bool,
    /// Axes along which slopes were taken where it is.
    axes: Option<Axes>,
    /// Whether slopes were taken where it is, and what they say of the evidence stood still.
    is_fresh: bool,
    /// Times that slopes were taken anew where it is.
    renewals: usize,
    /// Steps in a row that did something else than foretold.
    doubts: usize,
    radius: f64,
}

impl<'a> Fitter<'a> {
    /// Fits from `start`: Gauss–Newton steps within a trust region. Slopes are carried along and learn from every step; where they lead
    /// no further they are taken anew, until what they say of the evidence stands still.
    ///
    /// # Errors
    /// When the column cannot be replayed at the start.
    pub fn fit(&self, start: Start<'a>, stop: Stop) -> Result<Fit<'a>> {
        let was_settled = stop.steps == 0 && start.is_settled;
        let mut search = self.begun(start)?;
        let has_ended = (0..stop.steps).any(|_| self.has_ended(&mut search, stop)) || stop.steps == STEPS;
        let is_settled = was_settled || (has_ended && stop.settles);
        let g = self.normal(&search.slopes, &search.at.rows);
        let cost = self.cost(&search.model, &search.at);
        let Search { model, at, slopes, axes, is_fresh, .. } = search;
        let Point { x, prediction, rows, .. } = at;
        let axes = axes.filter(|_| is_fresh);
        Ok(Fit { model, x, prediction, rows, cost, slopes, g, axes, is_settled })
    }

    fn begun(&self, start: Start<'a>) -> Result<Search<'a>> {
        let Start { model, x, slopes: known, axes, .. } = start;
        let at = self.point(&model, x)?;
        let own = axes.as_ref().filter(|_| known.is_empty());
        let taken = own.and_then(|axes| self.slopes_along(&model, &at, axes, None));
        let is_carried = !known.is_empty();
        let slopes = taken.unwrap_or_else(|| self.slopes(&model, &at, &known));
        let is_fresh = axes.is_some();
        let (renewals, doubts, radius) = (0, 0, RADIUS[0]);
        Ok(Search { model, at, slopes, is_carried, axes, is_fresh, renewals, doubts, radius })
    }

    /// Whether there is nothing more to be gained; otherwise goes a step or takes slopes anew.
    fn has_ended(&self, search: &mut Search<'a>, stop: Stop) -> bool {
        let g = self.normal(&search.slopes, &search.at.rows);
        let cost = self.cost(&search.model, &search.at);
        let (to, expected) = step(&search.model, &search.at.x, &g, search.radius);
        // What is left to gain is not what a short step gains.
        let (_, whole) = step(&search.model, &search.at.x, &g, f64::INFINITY);
        if whole < stop.gain || expected <= 0.0 || search.radius < RADIUS[2] {
            if search.is_fresh || !stop.settles {
                return true;
            }
            search.doubts = 0;
            search.radius = search.radius.max(JITTER);
            self.renew(search);
            return false;
        }
        let found = self.point(&search.model, to).ok();
        let gained = found.as_ref().map_or(f64::NEG_INFINITY, |found| cost - self.cost(&search.model, found));
        let ratio = gained / expected;
        let is_expected = is_borne_out(gained, expected) || (gained - expected).abs() < stop.gain;
        search.doubts = if search.is_carried && !is_expected { search.doubts + 1 } else { 0 };
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
            _ => stop.settles && !search.is_fresh,
        };
        if is_at_fault || is_stuck {
            self.renew(search);
        }
        false
    }

    /// Takes a search and its slopes to where a step ended.
    fn carry(&self, search: &mut Search<'a>, to: &Point) {
        search.at = to.clone();
        let known: Vec<Option<Arc<Rows>>> = search.slopes.drain(..).map(Some).collect();
        search.slopes = self.slopes(&search.model, &search.at, &known);
        (search.is_carried, search.axes, search.is_fresh, search.renewals) = (true, None, false, 0);
    }

    /// Takes the slopes of a search anew where it is.
    fn renew(&self, search: &mut Search<'a>) {
        let Search { model, at, slopes, .. } = &*search;
        let axes = self.principal(model, at, slopes);
        let taken = axes.as_ref().and_then(|axes| self.slopes_along(model, at, axes, Some(slopes)));
        let taken = taken.unwrap_or_else(|| self.slopes(model, at, &[]));
        let evidence = |slopes: &[Arc<Rows>]| occam(model, &at.x, &self.normal(slopes, &at.rows));
        let moved = (evidence(&taken) - evidence(slopes)).abs();
        search.renewals += 1;
        search.is_fresh = moved < STILL || search.renewals == RENEWALS;
        (search.slopes, search.is_carried, search.axes) = (taken, false, axes);
    }
}
