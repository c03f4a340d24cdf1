//! How residuals change with the coordinates of a model: by coordinate, along the principal axes of the posterior, by the equivalent-linear
//! column, and by what steps did.

use super::search::JITTER;
use super::{Fitter, Point, combined, dot, information, square};
use crate::inference::algebra::inverse;
use crate::inference::parameters::Model;
use crate::inference::weights::Rows;
use crate::numerics::threads::on_threads;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use std::sync::Arc;

/// Length of the displacements along which slopes are taken, posterior standard deviations.
const SHARE: f64 = 1.0;
/// Posterior over prior variance along a principal axis above which the records tell so little of it (½ ln of it of the evidence) that no
/// replay of its slope is worth its time.
const UNTOLD: f64 = 0.8;

/// How residuals change with a coordinate.
#[derive(Clone)]
pub struct Slope {
    /// For one unit of it.
    pub rows: Arc<Rows>,
    /// The same where replays told it last; none where they never did.
    told: Option<Told>,
}

/// A slope where replays told it.
#[derive(Clone)]
struct Told {
    replayed: Arc<Rows>,
    /// That of the equivalent-linear column there.
    column: Arc<Rows>,
}

impl Slope {
    /// One that no replay told.
    pub fn new(rows: Rows) -> Self {
        Self { rows: Arc::new(rows), told: None }
    }

    /// Its rows, and those that replays told, as `of` makes them.
    pub fn converted(&self, of: impl Fn(&Rows) -> Option<Rows>) -> Option<Self> {
        let of = |rows: &Rows| of(rows).map(Arc::new);
        let told = self.told.as_ref().and_then(|t| Some(Told { replayed: of(&t.replayed)?, column: of(&t.column)? }));
        Some(Self { rows: of(&self.rows)?, told })
    }

    /// What is right where the column has `own`: what the column lacks of it changes less than it does.
    fn moved(&self, own: &Self) -> Self {
        let Some(told) = &self.told else { return own.clone() };
        let rows = combined(&combined(&own.rows, &told.replayed, 1.0, 1.0), &told.column, 1.0, -1.0);
        Self { rows: Arc::new(rows), told: self.told.clone() }
    }

    /// How wrong it may be in the product with `rows`: what the column lacked of it where replays told it, as far as it has changed since.
    pub fn doubt(&self, rows: &Rows) -> f64 {
        let Some(told) = &self.told else { return 0.0 };
        let changed =
            square(&combined(&self.rows, &told.replayed, 1.0, -1.0)) / square(&self.rows).max(f64::MIN_POSITIVE);
        changed.sqrt().min(1.0) * (dot(&told.replayed, rows) - dot(&told.column, rows))
    }
}

/// Share of the power of what replays told of `slopes` that the equivalent-linear column had of it, each in units of its deviation in
/// `prior`; none where replays told nothing.
pub fn foretold(slopes: &[Slope], prior: &[[f64; 2]]) -> Option<f64> {
    let of = |(slope, [_, sd]): (&Slope, &[f64; 2])| {
        let Told { replayed, column } = slope.told.as_ref()?;
        Some([replayed, &combined(replayed, column, 1.0, -1.0)].map(|rows| sd * sd * square(rows)))
    };
    let sum = |[a, b]: [f64; 2], [c, d]: [f64; 2]| [a + c, b + d];
    let [power, missed] = slopes.iter().zip(prior).filter_map(of).reduce(sum)?;
    (power > 0.0).then(|| 1.0 - missed / power)
}

/// Rows of `slopes`.
pub fn rows_of(slopes: &[Slope]) -> Vec<Arc<Rows>> {
    slopes.iter().map(|slope| slope.rows.clone()).collect()
}

/// Displacements of all coordinates along which slopes are taken, column by column.
pub(super) struct Axes {
    pub(super) along: Mat<f64>,
    /// Coordinates whose slopes these tell.
    of: Vec<usize>,
    /// Whether the records tell something along each.
    is_told: Vec<bool>,
}

/// Coordinates that do what declared values do, each with these and how far they go for one unit of it.
type Same = [(usize, Vec<(usize, f64)>)];

impl<'a> Fitter<'a> {
    /// How residuals change with coordinate `i`; `None` where the column does not finish beside it.
    pub(super) fn slope(&self, model: &Model<'_>, at: &Point, i: usize) -> Option<Slope> {
        let step = model.step(&at.x, i);
        let mut beside = at.x.clone();
        beside[i] += step;
        Some(Slope::new(combined(&self.point(model, beside).ok()?.rows, &at.rows, 1.0 / step, -1.0 / step)))
    }

    /// Slopes by coordinate, those apart that are `known` and would need a replay.
    pub(super) fn slopes(&self, model: &Model<'_>, at: &Point, known: &[Option<Slope>]) -> Vec<Slope> {
        let same = model.same(&at.x);
        let nothing = || Slope::new(combined(&at.rows, &at.rows, 0.0, 0.0));
        let of = |i: usize| {
            if same.iter().any(|(effect, _)| *effect == i) {
                return nothing();
            }
            let own = known.get(i).cloned().flatten().filter(|_| model.is_replayed(i));
            own.or_else(|| self.slope(model, at, i)).unwrap_or_else(nothing)
        };
        let mut slopes = on_threads(model.len(), of);
        Self::join(&same, &mut slopes);
        slopes
    }

    /// Slopes where a search begins: those that are `known`, and of others that would need a replay those of the equivalent-linear column.
    pub(super) fn first_slopes(&self, model: &Model<'_>, at: &Point, mut known: Vec<Option<Slope>>) -> Vec<Slope> {
        known.resize(model.len(), None);
        let mut open = turned(model, &model.same(&at.x), &at.x);
        open.retain(|i| known[*i].is_none());
        let column = if open.is_empty() { None } else { self.by_column(model, at) };
        if let Some(column) = column {
            open.into_iter().for_each(|i| known[i] = Some(column[i].clone()));
        }
        self.slopes(model, at, &known)
    }

    /// Slopes by the equivalent-linear column, tuned to the replay there; none where that is what replays are taken for or tells nothing
    /// of them.
    fn by_column(&self, model: &Model<'_>, at: &Point) -> Option<Vec<Slope>> {
        if !self.is_led || self.forward.is_equivalent_linear() {
            return None;
        }
        let column = self.forward.equivalent_linear();
        column.follow(self.forward, &model.tables(&at.x)).ok()?;
        Some(self.through(&column).slopes(model, at, &[]))
    }

    /// Slopes by the equivalent-linear column and what that lacked where replays told the `known` ones; those that they did not tell yet
    /// are taken by replays along principal axes. Whether there were any of these.
    ///
    /// Source: Echeverría and Hemker (2005), doi 10.2478/cmam-2005-0006, for a cheap model corrected by what it lacked of a dear one.
    /// Check: `slopes_lead_on_from_replays_without_more_of_them`.
    pub(super) fn led(&self, model: &Model<'_>, at: &Point, known: &[Slope]) -> Option<(Vec<Slope>, bool)> {
        let column = self.by_column(model, at)?;
        let moved = |(own, known): (&Slope, &Slope)| Some(known.moved(own));
        let slopes = self.slopes(model, at, &column.iter().zip(known).map(moved).collect::<Vec<_>>());
        let mut open = turned(model, &model.same(&at.x), &at.x);
        open.retain(|i| slopes[*i].told.is_none());
        if open.is_empty() {
            return Some((slopes, false));
        }
        let axes = self.principal(model, at, &slopes, open)?;
        let mut slopes = self.slopes_along(model, at, &axes, slopes)?;
        Self::tell(&mut slopes, &column, &axes.of);
        Some((slopes, true))
    }

    /// Slopes by replays along the principal axes of the posterior.
    pub(super) fn replayed(&self, model: &Model<'_>, at: &Point, known: &[Slope]) -> Vec<Slope> {
        let turned = turned(model, &model.same(&at.x), &at.x);
        let apart: Vec<_> = (0..model.len()).map(|i| turned.contains(&i).then(|| known[i].clone())).collect();
        let slopes = self.slopes(model, at, &apart);
        let axes = self.principal(model, at, &slopes, turned);
        let taken = axes.and_then(|axes| self.slopes_along(model, at, &axes, slopes));
        let mut slopes = taken.unwrap_or_else(|| self.slopes(model, at, &[]));
        if let Some(column) = self.by_column(model, at) {
            let all: Vec<usize> = (0..model.len()).filter(|i| model.is_replayed(*i)).collect();
            Self::tell(&mut slopes, &column, &all);
        }
        slopes
    }

    fn tell(slopes: &mut [Slope], column: &[Slope], of: &[usize]) {
        for i in of {
            slopes[*i].told = Some(Told { replayed: slopes[*i].rows.clone(), column: column[*i].rows.clone() });
        }
    }

    /// Displacements along which slopes `of` some coordinates are taken where `slopes` are known to be about right.
    ///
    /// ```text
    /// A⁻¹ restricted to these = D U Λ Uᵀ D,   δ_k = s √λ_k A⁻¹ [A⁻¹]⁻¹ D u_k                  (1)
    /// ```
    ///
    /// D are the prior standard deviations, s is [`SHARE`], the others go along as the records ask, and what is at an end of its range stays
    /// there. A difference is wrong by a share of its own size. Taken coordinate by coordinate, the difference of two that do nearly the
    /// same is lost in that; taken along the principal axes of the posterior, what changes records little is known as well as what changes
    /// them much.
    pub(super) fn principal(&self, model: &Model<'_>, at: &Point, slopes: &[Slope], of: Vec<usize>) -> Option<Axes> {
        let (prior, bounds, n) = (model.prior(), model.bounds(), model.len());
        let same = model.same(&at.x);
        let a = information(model, &self.normal(&rows_of(slopes), &at.rows));
        let held: Vec<bool> = (0..n).map(|i| is_held(model, &same, &at.x, i)).collect();
        let free = |i: usize, j: usize| if held[i] || held[j] { f64::from(u8::from(i == j)) } else { a[(i, j)] };
        let c = inverse(&Mat::from_fn(n, n, free))?;
        let p = of.len();
        let deviation = |k: usize| prior[of[k]][1];
        let scaled = Mat::from_fn(p, p, |i, j| c[(of[i], of[j])] / (deviation(i) * deviation(j)));
        let axes = scaled.self_adjoint_eigen(Side::Lower).ok()?;
        let mut along = Mat::zeros(n, p);
        let is_told = (0..p).map(|k| axes.S()[k] < UNTOLD).collect();
        for k in 0..p {
            let lambda = axes.S()[k].max(f64::MIN_POSITIVE);
            let pulled: Vec<f64> = (0..p).map(|i| axes.U()[(i, k)] / (deviation(i) * lambda.sqrt())).collect();
            let moved: Vec<f64> =
                (0..n).map(|i| SHARE * (0..p).map(|j| c[(i, of[j])] * pulled[j]).sum::<f64>()).collect();
            // To the side on which bounds leave more room.
            let room = |sign: f64| {
                let of = |(i, d): (usize, &f64)| {
                    let end = if sign * d > 0.0 { bounds[i][1] } else { bounds[i][0] };
                    if *d == 0.0 { 1.0 } else { ((end - at.x[i]) / (sign * d)).max(0.0) }
                };
                moved.iter().enumerate().map(of).fold(1.0, f64::min)
            };
            let [up, down] = [room(1.0), room(-1.0)];
            let share = if up >= down { up } else { -down };
            moved.iter().enumerate().for_each(|(i, d)| along[(i, k)] = share * d);
        }
        Some(Axes { along, of, is_told })
    }

    /// `slopes`, those of the coordinates of `axes` by replays along these. Where the records tell nothing along an axis, what is known of it
    /// will do.
    pub(super) fn slopes_along(
        &self,
        model: &Model<'_>,
        at: &Point,
        Axes { along, of, is_told }: &Axes,
        mut slopes: Vec<Slope>,
    ) -> Option<Vec<Slope>> {
        let p = of.len();
        let moved = Mat::from_fn(p, p, |i, k| along[(of[i], k)]);
        let back = moved.partial_piv_lu().solve(Mat::<f64>::identity(p, p));
        if !(0..p).all(|i| (0..p).all(|j| back[(i, j)].is_finite())) {
            return None;
        }
        let nothing = combined(&at.rows, &at.rows, 0.0, 0.0);
        let change = |k: usize| -> Option<Rows> {
            if !is_told[k] {
                let sum = |sum: Rows, i: &usize| combined(&sum, &slopes[*i].rows, 1.0, along[(*i, k)]);
                return Some(of.iter().fold(nothing.clone(), sum));
            }
            let beside: Vec<f64> = (0..model.len()).map(|i| at.x[i] + along[(i, k)]).collect();
            let mut change = combined(&self.point(model, beside).ok()?.rows, &at.rows, 1.0, -1.0);
            for i in (0..model.len()).filter(|i| !of.contains(i) && along[(*i, k)] != 0.0) {
                change = combined(&change, &slopes[i].rows, 1.0, -along[(i, k)]);
            }
            Some(change)
        };
        let changes: Vec<Rows> = on_threads(p, change).into_iter().collect::<Option<_>>()?;
        for (j, i) in of.iter().enumerate() {
            let sum = |sum: Rows, (k, r): (usize, &Rows)| combined(&sum, r, 1.0, back[(k, j)]);
            slopes[*i].rows = Arc::new(changes.iter().enumerate().fold(nothing.clone(), sum));
        }
        Self::join(&model.same(&at.x), &mut slopes);
        Some(slopes)
    }

    /// Gives effects that do what declared values do the slopes of those: data cannot tell the two, and no error of a finite difference
    /// may.
    fn join(same: &Same, slopes: &mut [Slope]) {
        for (effect, parts) in same {
            let own = &slopes[*effect].rows;
            let nothing = combined(own, own, 0.0, 0.0);
            let sum = parts.iter().fold(nothing, |sum, (i, share)| combined(&sum, &slopes[*i].rows, 1.0, *share));
            slopes[*effect] = Slope::new(sum);
        }
    }

    /// Corrects slopes by what a step did beyond what they said of it, along it alone.
    ///
    /// ```text
    /// J ← J + (Δr − J δ) δᵀ/(δᵀ δ + τ²)                                      (1)
    /// ```
    ///
    /// τ is [`JITTER`], so that what a short step does by chance is not taken for a slope; δ in prior standard deviations, over the
    /// coordinates whose slopes are replays; those of sensors are taken anew.
    ///
    /// Source: (1) Broyden (1965), doi 10.1090/S0025-5718-1965-0198670-6.
    pub(super) fn learn(model: &Model<'_>, slopes: &mut [Slope], [from, to]: [&Point; 2]) {
        let back = from.x.iter().zip(&to.x).map(|(from, to)| from - to);
        let change = combined(&to.rows, &from.rows, 1.0, -1.0);
        let missed =
            slopes.iter().zip(back).fold(change, |missed, (slope, back)| combined(&missed, &slope.rows, 1.0, back));
        let prior = model.prior();
        let same = model.same(&from.x);
        let mut moved: Vec<f64> = to.x.iter().zip(&from.x).map(|(to, from)| to - from).collect();
        for (effect, parts) in &same {
            let own = std::mem::take(&mut moved[*effect]);
            parts.iter().for_each(|(i, share)| moved[*i] += share * own);
        }
        let delta: Vec<f64> = (0..model.len()).map(|i| moved[i] / prior[i][1]).collect();
        let square: f64 = (0..model.len()).filter(|i| model.is_replayed(*i)).map(|i| delta[i] * delta[i]).sum();
        if square < 1e-12 {
            return;
        }
        for (i, slope) in slopes.iter_mut().enumerate() {
            let factor = delta[i] / ((square + JITTER * JITTER) * prior[i][1]);
            if model.is_replayed(i) && factor != 0.0 {
                slope.rows = Arc::new(combined(&slope.rows, &missed, 1.0, factor));
            }
        }
        Self::join(&same, slopes);
    }
}

/// Coordinates whose slopes are taken along displacements of all of them: what is replayed and free to go to either side.
fn turned(model: &Model<'_>, same: &Same, x: &[f64]) -> Vec<usize> {
    (0..model.len()).filter(|i| model.is_replayed(*i) && !is_held(model, same, x, *i)).collect()
}

/// Whether coordinate `i` stays where it is: at an end of its range, or doing what a declared value does.
fn is_held(model: &Model<'_>, same: &Same, x: &[f64], i: usize) -> bool {
    model.is_at_end(x, i) || same.iter().any(|(effect, _)| *effect == i)
}
