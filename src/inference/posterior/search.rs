//! The search for the most probable coordinates: Gauss–Newton steps within a trust region, by slopes that are carried along, learn from
//! every step, and are taken anew where they lead no further.

use super::slopes::Axes;
use super::{Fit, Fitter, Point, Start, occam, square, step};
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

/// Where a fit replays slopes instead of taking those of the equivalent-linear column: as many replays as the model has coordinates, each
/// time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Replays {
    /// Nowhere.
    Nowhere,
    /// Where steps did something else than those foretold, and a shorter one as well.
    WhereDoubted,
    /// Wherever steps did something else, and where the fit ends.
    AtTheEnd,
}

/// When a fit ends.
#[derive(Debug, Clone, Copy)]
pub struct Stop {
    /// Most steps.
    pub steps: usize,
    /// Expected gain below which it has converged, in ln of the posterior density.
    pub gain: f64,
    /// By which slopes.
    pub replays: Replays,
}

impl Stop {
    /// At the most probable coordinates.
    pub const EXACT: Self = Self { steps: STEPS, gain: CONVERGED, replays: Replays::AtTheEnd };
    /// As close to these as models have to be compared by on the way.
    pub const CLOSE: Self = Self { steps: STEPS, gain: NEAR, replays: Replays::WhereDoubted };
    /// Good enough to go on from.
    pub const ON_THE_WAY: Self = Self { steps: 10, gain: NEAR, replays: Replays::Nowhere };
    /// At once: what is known of the model where it is.
    pub const WHERE_IT_IS: Self = Self { steps: 0, ..Self::CLOSE };
}

/// Where the slopes of a fit are from, the best last.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
enum Origin {
    /// From another place, and what steps from there did.
    Carried,
    /// From the equivalent-linear column there.
    Equivalent,
    /// From replays there.
    Replayed,
}

/// Whether what was `gained` bears out what slopes `foretold`.
pub fn is_borne_out(gained: f64, foretold: f64) -> bool {
    (TRUSTED[0]..TRUSTED[1]).contains(&(gained / foretold))
}

/// A search on its way.
struct Search<'a> {
    model: Model<'a>,
    at: Point,
    slopes: Vec<Arc<Rows>>,
    origin: Origin,
    /// Axes along which slopes were replayed where it is.
    axes: Option<Axes>,
    /// Whether slopes were taken where it is, and what they say of the evidence stood still.
    is_fresh: bool,
    /// Whether slopes were replayed, here or where they were carried from.
    was_replayed: bool,
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
        let is_settled = was_settled || (has_ended && stop.replays != Replays::Nowhere);
        let g = self.normal(&search.slopes, &search.at.rows);
        let cost = self.cost(&search.model, &search.at);
        let Search { model, at, slopes, axes, is_fresh, was_replayed, .. } = search;
        let Point { x, prediction, rows, .. } = at;
        let axes = axes.filter(|_| is_fresh);
        Ok(Fit { model, x, prediction, rows, cost, slopes, g, axes, was_replayed, is_settled })
    }

    fn begun(&self, start: Start<'a>) -> Result<Search<'a>> {
        let Start { model, x, slopes: known, axes, was_replayed, .. } = start;
        let at = self.point(&model, x)?;
        let own = axes.as_ref().filter(|_| known.is_empty());
        let taken = own.and_then(|axes| self.slopes_along(&model, &at, axes, None));
        let origin = match (&taken, known.is_empty()) {
            (Some(_), _) => Origin::Replayed,
            (None, true) => Origin::Equivalent,
            (None, false) => Origin::Carried,
        };
        let slopes = taken.unwrap_or_else(|| self.slopes_near(&model, &at, &known));
        let is_fresh = axes.is_some();
        let was_replayed = was_replayed || origin == Origin::Replayed;
        let (renewals, doubts, radius) = (0, 0, RADIUS[0]);
        Ok(Search { model, at, slopes, origin, axes, is_fresh, was_replayed, renewals, doubts, radius })
    }

    /// Whether there is nothing more to be gained; otherwise goes a step or takes slopes anew.
    fn has_ended(&self, search: &mut Search<'a>, stop: Stop) -> bool {
        let g = self.normal(&search.slopes, &search.at.rows);
        let cost = self.cost(&search.model, &search.at);
        let (to, expected) = step(&search.model, &search.at.x, &g, search.radius);
        // What is left to gain is not what a short step gains.
        let (_, whole) = step(&search.model, &search.at.x, &g, f64::INFINITY);
        let is_exact = stop.replays == Replays::AtTheEnd;
        if whole < stop.gain || expected <= 0.0 || search.radius < RADIUS[2] {
            // Replayed slopes that were carried here have learnt from every step since.
            if search.is_fresh || self.surrogate.is_some() || (search.was_replayed && !is_exact) {
                return true;
            }
            search.doubts = 0;
            search.radius = search.radius.max(JITTER);
            self.renew(search, is_exact);
            return false;
        }
        let found = self.point(&search.model, to).ok();
        let gained = found.as_ref().map_or(f64::NEG_INFINITY, |found| cost - self.cost(&search.model, found));
        let ratio = gained / expected;
        let is_expected = is_borne_out(gained, expected) || (gained - expected).abs() < stop.gain;
        let best = if stop.replays == Replays::Nowhere { Origin::Equivalent } else { Origin::Replayed };
        let is_doubtful = search.origin < best && !is_expected;
        search.doubts = if is_doubtful { search.doubts + 1 } else { 0 };
        // Slopes are blamed, and not the length of the step, if better ones can be had.
        let is_at_fault = search.doubts > usize::from(!is_exact);
        let kept = search.radius.max(JITTER);
        search.radius = match ratio {
            _ if is_at_fault => kept,
            r if r > 0.75 => (2.0 * search.radius).min(RADIUS[1]),
            r if r < TRUSTED[0] => SHORTER * search.radius,
            _ => search.radius,
        };
        let mut is_due = is_at_fault && stop.replays != Replays::Nowhere;
        let (from, before) = (search.at.clone(), search.origin);
        let missed = found.as_ref().map(|found| Self::missed(&search.slopes, [&from, found]));
        if let (Some(found), Some(missed)) = (&found, &missed) {
            Self::learn(&search.model, &mut search.slopes, [&from, found], missed);
        }
        match &found {
            Some(found) if ratio > TAKEN => self.carry(search, found),
            _ => is_due |= is_exact && !search.is_fresh,
        }
        if let (Some(found), Some(missed), true) = (&found, &missed, is_doubtful && before == Origin::Carried) {
            let near = self.slopes_near(&search.model, &search.at, &[]);
            if square(&Self::missed(&near, [&from, found])) < square(missed) {
                (search.slopes, search.origin, search.radius) = (near, Origin::Equivalent, kept);
                search.was_replayed = false;
                return false;
            }
        }
        if is_due {
            self.renew(search, true);
        }
        false
    }

    /// Takes a search and its slopes to where a step ended.
    fn carry(&self, search: &mut Search<'a>, to: &Point) {
        search.at = to.clone();
        let known: Vec<Option<Arc<Rows>>> = search.slopes.drain(..).map(Some).collect();
        search.slopes = self.slopes(&search.model, &search.at, &known);
        (search.origin, search.axes, search.is_fresh, search.renewals) = (Origin::Carried, None, false, 0);
    }

    /// Takes the slopes of a search anew where it is: by replays, or by the equivalent-linear column.
    fn renew(&self, search: &mut Search<'a>, is_replayed: bool) {
        let Search { model, at, slopes, .. } = &*search;
        let (taken, axes) = if is_replayed {
            let axes = self.principal(model, at, slopes);
            let taken = axes.as_ref().and_then(|axes| self.slopes_along(model, at, axes, Some(slopes)));
            (taken.unwrap_or_else(|| self.slopes(model, at, &[])), axes)
        } else {
            (self.slopes_near(model, at, &[]), None)
        };
        let evidence = |slopes: &[Arc<Rows>]| occam(model, &at.x, &self.normal(slopes, &at.rows));
        let moved = (evidence(&taken) - evidence(slopes)).abs();
        search.renewals += 1;
        search.is_fresh = moved < STILL || search.renewals == RENEWALS;
        search.was_replayed = is_replayed;
        search.origin = if is_replayed { Origin::Replayed } else { Origin::Equivalent };
        (search.slopes, search.axes) = (taken, axes);
    }
}
