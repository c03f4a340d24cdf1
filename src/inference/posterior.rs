//! The most probable coordinates of a model, their uncertainty, and the evidence for the model.

mod slopes;

use super::algebra::{Quadratic, inverse, ln_determinant, solved};
use super::convention;
use super::forward::{Forward, Prediction, channels, lock};
use super::parameters::Model;
use super::weights::{self, Rows, Spread, Weights, band_hz};
use crate::effects::Instance;
use crate::error::Result;
use crate::metrics::{normal_probability, scaled_tail};
use faer::Mat;
use rayon::prelude::*;
use slopes::Axes;
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// Most steps of a fit.
const STEPS: usize = 30;
/// Expected gain below which a fit has converged, nats.
const CONVERGED: f64 = 0.2;
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
/// Highest frequency of the first of a series of fits, in fundamental frequencies of the column.
const FIRST_MODES: f64 = 1.5;
/// Length of a step, prior standard deviations, below which what a replay does is as much the chance of its time steps as the step's.
const JITTER: f64 = 0.005;

/// A model at its most probable coordinates.
#[derive(Clone)]
pub struct Fit<'a> {
    /// The model.
    pub model: Model<'a>,
    /// Its coordinates.
    pub x: Vec<f64>,
    /// What it predicts.
    pub prediction: Arc<Prediction>,
    /// Residuals in units of what is expected of them.
    pub rows: Arc<Rows>,
    /// −ln of the posterior density, constants apart.
    pub cost: f64,
    /// How residuals change with each coordinate.
    pub slopes: Vec<Arc<Rows>>,
    /// Normal equations: information on the coordinates, and in the last row and column the right-hand side.
    pub g: Mat<f64>,
    /// Along which axes the slopes were taken here; none where they were carried here.
    pub axes: Option<Axes>,
}

/// When a fit ends.
#[derive(Debug, Clone, Copy)]
pub struct Stop {
    /// Most steps.
    pub steps: usize,
    /// Expected gain below which it has converged, in ln of the posterior density.
    pub gain: f64,
    /// Whether it has to have converged by slopes replayed where it ends; otherwise those carried there will do.
    pub is_exact: bool,
    /// Whether slopes may be replayed at all: as many replays as the model has coordinates, each time.
    pub may_replay: bool,
}

impl Stop {
    /// At the most probable coordinates.
    pub const EXACT: Self = Self { steps: STEPS, gain: CONVERGED, is_exact: true, may_replay: true };
    /// Good enough to go on from.
    const ON_THE_WAY: Self = Self { steps: 10, gain: 0.5, is_exact: false, may_replay: false };
    /// Where carried slopes see nothing to be gained any more.
    pub const CLOSE: Self = Self { is_exact: false, ..Self::EXACT };
    /// At once: what is known of the model where it is.
    pub const WHERE_IT_IS: Self = Self { steps: 0, ..Self::CLOSE };
}

/// What fits models.
pub struct Fitter<'a> {
    /// The column and the sensors.
    pub forward: &'a Forward<'a>,
    spread: Spread,
    reference: Arc<Prediction>,
    /// Weights by the channels that the sensors are taken to be recorded on.
    weights: Mutex<HashMap<Vec<usize>, Arc<Weights>>>,
    /// The highest frequency that counts, Hz.
    high_hz: f64,
}

/// Where a fit starts.
pub struct Start<'a> {
    /// The model.
    pub model: Model<'a>,
    /// Its coordinates.
    pub x: Vec<f64>,
    /// Slopes that are known already, by coordinate.
    pub slopes: Vec<Option<Arc<Rows>>>,
    /// Axes along which slopes at `x` are to be taken.
    pub axes: Option<Axes>,
}

impl<'a> Start<'a> {
    /// From `x`.
    pub fn at(model: Model<'a>, x: Vec<f64>) -> Self {
        Self { model, x, slopes: Vec::new(), axes: None }
    }

    /// From the fit `found`, with its slopes.
    pub fn from(found: Fit<'a>) -> Self {
        let Fit { model, x, slopes, axes, .. } = found;
        Self { model, x, slopes: slopes.into_iter().map(Some).collect(), axes }
    }

    /// From the fit `found`, its slopes taken anew by other weights.
    pub fn weighed_anew(found: Fit<'a>) -> Self {
        Self { slopes: Vec::new(), ..Self::from(found) }
    }
}

/// A point of a fit.
#[derive(Clone)]
struct Point {
    x: Vec<f64>,
    prediction: Arc<Prediction>,
    rows: Arc<Rows>,
    constant: f64,
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

impl<'a> Fitter<'a> {
    /// One that weighs residuals as `spread` says, transfer functions those of `reference`.
    pub fn new(forward: &'a Forward<'a>, spread: Spread, reference: Arc<Prediction>) -> Self {
        Self { forward, spread, reference, weights: Mutex::default(), high_hz: f64::INFINITY }
    }

    /// The same in the events of `few` alone.
    pub fn in_events(&self, few: &'a Forward<'a>) -> Self {
        Self::new(few, self.spread.in_events(few), Arc::new(few.kept(&self.reference)))
    }

    /// What is expected of residuals.
    pub fn spread(&self) -> &Spread {
        &self.spread
    }

    /// What a model predicts.
    ///
    /// # Errors
    /// When the column cannot be replayed.
    pub fn predict(&self, model: &Model<'a>, x: &[f64]) -> Result<Arc<Prediction>> {
        Ok(Arc::new(Self::with_conventions(self.forward.predict(&model.tables(x))?, model, x)))
    }

    /// A prediction of the column alone with what the conventions of `model` at `x` add to it.
    fn with_conventions(mut prediction: Prediction, model: &Model<'_>, x: &[f64]) -> Prediction {
        convention::add(&mut prediction, &model.declared.conventions, model.declared.convention_strengths(x));
        prediction
    }

    /// The model of `base` with an effect besides, whose coordinates are `at`, and all its coordinates.
    fn model_with(base: &Fit<'a>, effect: &Instance, at: &[f64]) -> (Model<'a>, Vec<f64>) {
        let mut model = base.model.clone();
        model.effects.push(effect.clone());
        (model, base.x.iter().chain(at).copied().collect())
    }

    /// What the model of `base` predicts with an effect besides, whose coordinates are `at`.
    ///
    /// # Errors
    /// When the column cannot be replayed.
    pub fn predict_with(&self, base: &Fit<'a>, effect: &Instance, at: &[f64]) -> Result<Arc<Prediction>> {
        let (model, x) = Self::model_with(base, effect, at);
        self.predict(&model, &x)
    }

    /// How that changes the residuals of `base`.
    ///
    /// # Errors
    /// When the column cannot be replayed.
    pub fn change_with(&self, base: &Fit<'a>, effect: &Instance, at: &[f64]) -> Result<Rows> {
        Ok(combined(&self.rows(&*self.predict_with(base, effect, at)?).0, &base.rows, 1.0, -1.0))
    }

    fn point(&self, model: &Model<'a>, x: Vec<f64>) -> Result<Point> {
        let prediction = self.predict(model, &x)?;
        let (rows, constant) = self.rows(&prediction);
        Ok(Point { x, prediction, rows, constant })
    }

    fn weights(&self, prediction: &Prediction) -> Arc<Weights> {
        let taken = channels(prediction);
        let mut known = lock(&self.weights);
        let of = if channels(&self.reference) == taken { &self.reference } else { prediction };
        let made = || Arc::new(Weights::new(self.forward, &self.spread, of));
        known.entry(taken.to_vec()).or_insert_with(made).clone()
    }

    /// Residuals of a prediction, and −ln of the density where they are nothing.
    pub fn rows(&self, prediction: &Prediction) -> (Arc<Rows>, f64) {
        let weights = self.weights(prediction);
        (Arc::new(weights.rows(prediction)), weights.constant)
    }

    /// −ln of the density of the records given a prediction.
    pub fn nll(&self, prediction: &Prediction) -> f64 {
        let (rows, constant) = self.rows(prediction);
        0.5 * square(&self.counted(&rows)) + constant
    }

    /// ½ of the squared distance from the means of the prior.
    pub fn prior(model: &Model<'_>, x: &[f64]) -> f64 {
        model.prior().iter().zip(x).map(|([mean, sd], x)| 0.5 * ((x - mean) / sd).powi(2)).sum()
    }

    /// Fits from `start`, first to the lowest mode of the column, then to one octave more at a time: where a model is far off, residuals
    /// at high frequencies lead to the next cycle and not to the right one.
    ///
    /// Source: Bunks et al. (1995), doi 10.1190/1.1443880.
    ///
    /// # Errors
    /// As [`Fitter::fit`].
    pub fn fit_from_afar(&self, mut start: Start<'a>, stop: Stop) -> Result<Fit<'a>> {
        let [_, high_hz] = band_hz(self.forward);
        let mut below = self.of_lowest_modes();
        while below.high_hz < high_hz {
            start = Start::from(below.fit(start, Stop::ON_THE_WAY)?);
            below = below.below(2.0 * below.high_hz);
        }
        self.fit(start, stop)
    }

    /// One for which residuals up to the lowest mode of the column count alone.
    pub fn of_lowest_modes(&self) -> Self {
        self.below(FIRST_MODES * 0.25 / self.forward.problem.array.profile.travel_time_s())
    }

    fn below(&self, high_hz: f64) -> Self {
        Self { high_hz, ..Self::new(self.forward, self.spread.clone(), self.reference.clone()) }
    }

    /// Those of `rows` that count.
    fn counted(&self, rows: &Arc<Rows>) -> Arc<Rows> {
        if self.high_hz.is_infinite() {
            rows.clone()
        } else {
            Arc::new(weights::below(self.forward, rows, self.high_hz))
        }
    }

    /// Normal equations; see [`Fit::g`].
    pub fn normal(&self, slopes: &[Arc<Rows>], rows: &Arc<Rows>) -> Mat<f64> {
        let slopes: Vec<Arc<Rows>> = slopes.iter().map(|s| self.counted(s)).collect();
        normal(&slopes, &self.counted(rows))
    }

    /// −ln of the posterior density of `model` at `x`, constants apart.
    ///
    /// # Errors
    /// When the column cannot be replayed.
    pub fn cost_at(&self, model: &Model<'a>, x: Vec<f64>) -> Result<f64> {
        Ok(self.cost(model, &self.point(model, x)?))
    }

    /// −ln of the posterior density at `at`, constants apart.
    fn cost(&self, model: &Model<'_>, at: &Point) -> f64 {
        0.5 * square(&self.counted(&at.rows)) + at.constant + Self::prior(model, &at.x)
    }

    /// Fits from `start`: Gauss–Newton steps within a trust region. Slopes are carried along and learn from every step; where they lead
    /// no further they are taken anew, until what they say of the evidence stands still.
    ///
    /// # Errors
    /// When the column cannot be replayed at the start.
    pub fn fit(&self, start: Start<'a>, stop: Stop) -> Result<Fit<'a>> {
        let Start { model, x, slopes: known, mut axes } = start;
        let mut at = self.point(&model, x)?;
        let taken =
            axes.as_ref().filter(|_| known.is_empty()).and_then(|axes| self.slopes_along(&model, &at, axes, None));
        let mut origin = match (&taken, known.is_empty()) {
            (Some(_), _) => Origin::Replayed,
            (None, true) => Origin::Equivalent,
            (None, false) => Origin::Carried,
        };
        let mut slopes = taken.unwrap_or_else(|| self.slopes_near(&model, &at, &known));
        let mut is_fresh = axes.is_some();
        let mut renewals = 0;
        let mut radius = RADIUS[0];
        for _ in 0..stop.steps {
            let g = self.normal(&slopes, &at.rows);
            let cost = self.cost(&model, &at);
            let (to, expected) = step(&model, &at.x, &g, radius);
            // What is left to gain is not what a short step gains.
            let (_, whole) = step(&model, &at.x, &g, f64::INFINITY);
            let has_converged = whole < stop.gain || expected <= 0.0 || radius < RADIUS[2];
            if has_converged && (is_fresh || !stop.is_exact) {
                break;
            }
            let found = if has_converged { None } else { self.point(&model, to).ok() };
            let ratio = found.as_ref().map_or(f64::NEG_INFINITY, |found| (cost - self.cost(&model, found)) / expected);
            // Slopes that are not from replays and foretold something else are blamed before the length of the step is, if better ones
            // can be had.
            let best = if stop.may_replay { Origin::Replayed } else { Origin::Equivalent };
            let is_doubtful = origin < best && !(TRUSTED[0]..TRUSTED[1]).contains(&ratio);
            radius = match ratio {
                _ if has_converged || is_doubtful => radius.max(JITTER),
                r if r > 0.75 => (2.0 * radius).min(RADIUS[1]),
                r if r < TRUSTED[0] => SHORTER * radius,
                _ => radius,
            };
            let mut is_due = is_doubtful || has_converged;
            let (from, before) = (at.clone(), origin);
            let missed = found.as_ref().map(|found| Self::missed(&slopes, [&from, found]));
            if let (Some(found), Some(missed)) = (&found, &missed) {
                Self::learn(&model, &mut slopes, [&from, found], missed);
            }
            match &found {
                Some(found) if ratio > TAKEN => {
                    at = found.clone();
                    let known: Vec<Option<Arc<Rows>>> = slopes.into_iter().map(Some).collect();
                    slopes = self.slopes(&model, &at, &known);
                    (is_fresh, origin, axes, renewals) = (false, Origin::Carried, None, 0);
                }
                _ => is_due |= !is_fresh,
            }
            if is_doubtful && before == Origin::Carried {
                let near = missed.is_some().then(|| self.slopes_near(&model, &at, &[]));
                let is_better = |near: &Vec<Arc<Rows>>, found: &Point, missed: &Rows| {
                    square(&Self::missed(near, [&from, found])) < square(missed)
                };
                match (near, &found, &missed) {
                    (Some(near), Some(found), Some(missed)) if is_better(&near, found, missed) => {
                        (slopes, origin, is_due) = (near, Origin::Equivalent, false);
                    }
                    _ if !stop.may_replay => radius *= SHORTER,
                    _ => {}
                }
            }
            if is_due && stop.may_replay {
                axes = self.principal(&model, &at, &slopes);
                let taken = axes.as_ref().and_then(|axes| self.slopes_along(&model, &at, axes, Some(&slopes)));
                let taken = taken.unwrap_or_else(|| self.slopes(&model, &at, &[]));
                let evidence = |slopes: &[Arc<Rows>]| occam(&model, &at.x, &self.normal(slopes, &at.rows));
                renewals += 1;
                is_fresh = (evidence(&taken) - evidence(&slopes)).abs() < STILL || renewals == RENEWALS;
                slopes = taken;
                origin = Origin::Replayed;
            }
        }
        let g = self.normal(&slopes, &at.rows);
        let cost = self.cost(&model, &at);
        let Point { x, prediction, rows, .. } = at;
        let axes = axes.filter(|_| is_fresh);
        Ok(Fit { model, x, prediction, rows, cost, slopes, g, axes })
    }
}

impl Fit<'_> {
    /// Whether declared values are as far off as their tolerances allow: they stand in for an effect.
    pub fn is_strained(&self) -> bool {
        (0..self.x.len()).any(|i| self.model.is_strained(&self.x, i))
    }

    /// Posterior covariance of the coordinates by the curvature of the cost.
    pub fn covariance(&self) -> Option<Mat<f64>> {
        inverse(&information(&self.model, &self.g))
    }

    /// ln of the evidence.
    pub fn log_evidence(&self) -> f64 {
        occam(&self.model, &self.x, &self.g) - self.cost
    }

    /// Coordinates when each event in turn is left out, by one step from here; `groups` are the events of the records.
    pub fn without_each_event(&self, groups: &[usize]) -> Vec<Vec<f64>> {
        let of = |event: usize| {
            let kept = |rows: &Rows| -> Rows {
                rows.iter().zip(groups).filter(|(_, g)| **g != event).map(|(r, _)| r.clone()).collect()
            };
            let slopes: Vec<Arc<Rows>> = self.slopes.iter().map(|s| Arc::new(kept(s))).collect();
            let g = normal(&slopes, &kept(&self.rows));
            let step = solved(&information(&self.model, &g), &gradient(&self.model, &self.x, &g))?;
            Some(self.x.iter().zip(step).map(|(x, d)| x + d).collect())
        };
        let count = groups.iter().max().map_or(0, |g| g + 1);
        (0..count).into_par_iter().filter_map(of).collect()
    }
}

/// a · `one` + b · `other`.
pub fn combined(one: &Rows, other: &Rows, a: f64, b: f64) -> Rows {
    let of = |(x, y): (&Vec<f64>, &Vec<f64>)| x.iter().zip(y).map(|(x, y)| a * x + b * y).collect();
    one.iter().zip(other).map(of).collect()
}

/// Σ r s over all residuals.
pub fn dot(one: &Rows, other: &Rows) -> f64 {
    one.iter().flatten().zip(other.iter().flatten()).map(|(r, s)| r * s).sum()
}

/// Σ r² over all residuals.
pub fn square(rows: &Rows) -> f64 {
    dot(rows, rows)
}

/// Normal equations of residuals `rows` with these `slopes`: Jᵀ J, and −Jᵀ r in the last row and column.
fn normal(slopes: &[Arc<Rows>], rows: &Rows) -> Mat<f64> {
    let n = slopes.len();
    let one = |record: usize| {
        let columns: Vec<&[f64]> =
            slopes.iter().map(|s| s[record].as_slice()).chain([rows[record].as_slice()]).collect();
        let m = columns[n].len();
        let j = Mat::from_fn(m, n + 1, |i, c| if c == n { -columns[c][i] } else { columns[c][i] });
        j.transpose() * &j
    };
    let all: Vec<Mat<f64>> = (0..rows.len()).into_par_iter().map(one).collect();
    all.iter().fold(Mat::zeros(n + 1, n + 1), |sum, g| sum + g)
}

/// Information of the records and the prior.
fn information(model: &Model<'_>, g: &Mat<f64>) -> Mat<f64> {
    let prior = model.prior();
    let n = prior.len();
    Mat::from_fn(n, n, |i, j| g[(i, j)] + if i == j { 1.0 / prior[i][1].powi(2) } else { 0.0 })
}

/// How ln of the posterior density changes at `x` with each coordinate: right-hand side of `g` and pull of the prior.
pub fn gradient(model: &Model<'_>, x: &[f64], g: &Mat<f64>) -> Vec<f64> {
    let side = g.nrows() - 1;
    model.prior().iter().zip(x).enumerate().map(|(i, ([mean, sd], x))| g[(i, side)] - (x - mean) / sd.powi(2)).collect()
}

/// The step from `x` within `radius` prior standard deviations and the bounds, and what it is expected to gain.
fn step(model: &Model<'_>, x: &[f64], g: &Mat<f64>, radius: f64) -> (Vec<f64>, f64) {
    let quadratic = Quadratic {
        a: information(model, g),
        gradient: gradient(model, x, g),
        bounds: model.room(x),
        size: model.prior().iter().map(|[_, sd]| *sd).collect(),
    };
    let Some((dx, gain)) = quadratic.highest(radius) else { return (x.to_vec(), 0.0) };
    (x.iter().zip(dx).map(|(x, d)| x + d).collect(), gain)
}

/// ln of the share of the prior that the posterior leaves:
///
/// ```text
/// −½ ln det(I + Λ^{−1/2} A Λ^{−1/2}) + Σ ln(share of the posterior within its range / that of the prior)       (1)
/// ```
///
/// What the records push against an end of its range is not at the top of its posterior: with the slope p of the ln of the density there
/// and the variance c of the coordinate, that top is k = p √c deviations outside, and the share is exp(k²/2) Φ(−k), the density at the end
/// being that of the fit.
///
/// Check: `evidence_at_an_end_of_a_range_is_that_of_quadrature`.
fn occam(model: &Model<'_>, x: &[f64], g: &Mat<f64>) -> f64 {
    let prior = model.prior();
    let n = prior.len();
    let scaled = Mat::from_fn(n, n, |i, j| g[(i, j)] * prior[i][1] * prior[j][1] + f64::from(u8::from(i == j)));
    let Some(ln) = ln_determinant(&scaled) else { return f64::NEG_INFINITY };
    let covariance = inverse(&scaled);
    let (bounds, slopes) = (model.bounds(), gradient(model, x, g));
    let within = |i: usize| {
        let ([mean, sd], ends) = (prior[i], bounds[i]);
        let deviation = covariance.as_ref().map_or(1.0, |c| c[(i, i)].sqrt()) * sd;
        let share = |of: f64, deviation: f64| {
            let [low, high] = ends.map(|end| normal_probability((end - of) / deviation));
            high - low
        };
        let slope = slopes[i];
        // The far end is this many deviations away.
        let (k, width) = (slope.abs() * deviation, (ends[1] - ends[0]) / deviation);
        let posterior = if is_pushed(model, x, i, slope) {
            scaled_tail(k) - (-width * (k + 0.5 * width)).exp() * scaled_tail(k + width)
        } else {
            share(x[i], deviation)
        };
        (posterior / share(mean, sd)).max(f64::MIN_POSITIVE).ln()
    };
    -0.5 * ln + (0..n).map(within).sum::<f64>()
}

/// Whether a `slope` of the ln of the posterior density at `x` pushes coordinate `i` against an end of its range.
fn is_pushed(model: &Model<'_>, x: &[f64], i: usize, slope: f64) -> bool {
    let [low, high] = model.bounds()[i];
    model.is_at_end(x, i) && (slope > 0.0) == (high - x[i] < x[i] - low)
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{DAMPING, Nonlinear, Truth, Uniform, problem};
    use super::super::parameters::Declared;
    use super::*;
    use crate::diagnosis::{DiagnoseSettings, Problem};
    use crate::effects;
    use crate::numerics::random;
    use rand::RngExt;

    /// Fits the model with effects of `kinds` to `problem`, what is expected of residuals read off in turn.
    fn fitted<T>(problem: &Problem, kinds: &[&str], use_of: impl for<'x> FnOnce(&Fit<'x>, &Fitter<'x>) -> T) -> T {
        let replay = Uniform(problem);
        let forward = Forward::new(problem, &replay, &DiagnoseSettings::default()).unwrap();
        let declared = Declared::new(problem).unwrap();
        let all = effects::instances(&problem.array);
        let of = |kind: &&str| all.iter().find(|i| i.kind == *kind).unwrap().clone();
        let model = Model { declared: &declared, effects: kinds.iter().map(of).collect() };
        let mut x: Vec<f64> = model.prior().iter().map(|[mean, _]| *mean).collect();
        let mut prediction = Arc::new(forward.predict(&model.tables(&x)).unwrap());
        for _ in 0..3 {
            let fitter = Fitter::new(&forward, Spread::estimated(&forward, &prediction), prediction);
            let fit = fitter.fit(Start::at(model.clone(), x), Stop::EXACT).unwrap();
            (x, prediction) = (fit.x, fit.prediction);
        }
        let fitter = Fitter::new(&forward, Spread::estimated(&forward, &prediction), prediction);
        let fit = fitter.fit(Start::at(model, x), Stop::EXACT).unwrap();
        use_of(&fit, &fitter)
    }

    /// Damping ratio of a fit with `small_strain_damping` as its only effect.
    fn damping_ratio(fit: &Fit<'_>) -> f64 {
        let declared = fit.model.declared;
        let tolerance = declared.others.iter().position(|o| o.instance.kind == "small_strain_damping").unwrap();
        let tolerated = declared.others[tolerance].coordinate(fit.x[declared.n_mode() + tolerance]);
        DAMPING * (fit.x[fit.model.start(0)] + tolerated).exp()
    }

    fn straying(f: f64) -> f64 {
        if f < 0.7 { 0.97 } else { (0.97 - 0.55 * (f / 0.7).ln() / (8.0f64 / 0.7).ln()).max(0.4) }
    }

    #[test]
    fn normal_equations_are_slopes_of_the_cost() {
        let problem = problem(&Truth { soil: [197.0, 0.03], coherence: straying, ..Truth::default() });
        fitted(&problem, &["small_strain_damping"], |fit, fitter| {
            let model = fit.model.clone();
            let n = model.len();
            let x: Vec<f64> = fit.x.iter().zip(model.prior()).map(|(x, [_, sd])| x + 0.1 * sd).collect();
            let at = fitter.point(&model, x).unwrap();
            let g = normal(&fitter.slopes(&model, &at, &[]), &at.rows);
            let mut stream = random::stream(3, "directions");
            for _ in 0..5 {
                let direction: Vec<f64> = (0..n).map(|_| stream.random::<f64>() - 0.5).collect();
                let expected: f64 = -(0..n).map(|i| direction[i] * g[(i, n)]).sum::<f64>();
                let size = (0..n).map(|i| (direction[i] * g[(i, n)]).powi(2)).sum::<f64>().sqrt();
                let beside = |h: f64| {
                    let beside: Vec<f64> = at.x.iter().zip(&direction).map(|(x, d)| x + h * d).collect();
                    fitter.nll(&fitter.predict(&model, &beside).unwrap())
                };
                let found = (beside(1e-4) - beside(-1e-4)) / 2e-4;
                assert!((found - expected).abs() < 0.1 * size, "{found} {expected} {size}");
            }
        });
    }

    #[test]
    fn slopes_of_the_equivalent_linear_column_are_those_of_replays() {
        let problem = problem(&Truth { events: 2, ..Truth::default() });
        let replay = Nonlinear(&problem);
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        let declared = Declared::new(&problem).unwrap();
        let prediction = Arc::new(forward.predict(&[]).unwrap());
        let fitter = Fitter::new(&forward, Spread::estimated(&forward, &prediction), prediction);
        let all = effects::instances(&problem.array);
        let kinds = ["small_strain_damping", "frequency_dependent_damping", "layer_velocity", "thin_seam"];
        let of = |kind: &&str| all.iter().find(|i| i.kind == *kind).unwrap().clone();
        let model = Model { declared: &declared, effects: kinds.iter().map(of).collect() };
        // Beside nothing, where every one of them has a slope of its own.
        let x = model.prior().iter().map(|[mean, sd]| mean + 0.1 * sd).collect();
        let at = fitter.point(&model, x).unwrap();
        let (near, replayed) = (fitter.slopes_near(&model, &at, &[]), fitter.slopes(&model, &at, &[]));
        let mut told = 0;
        for i in (0..model.len()).filter(|i| model.is_replayed(*i) && square(&replayed[*i]) > 1.0) {
            let missed = (square(&combined(&near[i], &replayed[i], 1.0, -1.0)) / square(&replayed[i])).sqrt();
            println!("{i}: {missed:.3} of {:.1}", square(&replayed[i]).sqrt());
            assert!(missed < 0.1, "{i}: {missed}");
            told += 1;
        }
        assert!(told > 5, "{told}");
    }

    #[test]
    fn slopes_along_principal_axes_are_those_of_coordinates() {
        let problem = problem(&Truth { soil: [204.0, 0.022], ..Truth::default() });
        fitted(&problem, &["small_strain_damping"], |fit, fitter| {
            let model = &fit.model;
            let at = fitter.point(model, fit.x.clone()).unwrap();
            let by_coordinate = fitter.slopes(model, &at, &[]);
            let axes = fitter.principal(model, &at, &by_coordinate).unwrap();
            let slopes = fitter.slopes_along(model, &at, &axes, None).unwrap();
            let along = &axes.along;
            let size = |i: usize| square(&by_coordinate[i]).sqrt() * model.prior()[i][1];
            let largest = (0..model.len()).map(size).fold(0.0, f64::max);
            for (i, (a, b)) in slopes.iter().zip(&by_coordinate).enumerate() {
                let missed = square(&combined(a, b, 1.0, -1.0)).sqrt() * model.prior()[i][1];
                assert!(missed < 0.02 * largest + 0.1 * size(i), "{i}: {missed} of {} and {largest}", size(i));
            }
            // What a displacement does is what the slopes say of it, however little that is.
            for k in 0..along.ncols() {
                let beside = (0..model.len()).map(|i| at.x[i] + along[(i, k)]).collect();
                let found = combined(&fitter.point(model, beside).unwrap().rows, &at.rows, 1.0, -1.0);
                let nothing = combined(&found, &found, 0.0, 0.0);
                let said = (0..model.len()).fold(nothing, |sum, i| combined(&sum, &slopes[i], 1.0, along[(i, k)]));
                let missed = square(&combined(&found, &said, 1.0, -1.0)).sqrt();
                assert!(missed < 1e-6 * square(&found).sqrt() + 1e-9, "{k}: {missed}");
            }
        });
    }

    #[test]
    fn steps_end_at_bounds_where_the_others_give_way() {
        let problem = problem(&Truth::default());
        let declared = Declared::new(&problem).unwrap();
        let model = Model { declared: &declared, effects: Vec::new() };
        let n = model.len();
        let bounds = model.bounds();
        let mut stream = random::stream(7, "directions");
        let mut at_bounds = 0;
        for _ in 0..20 {
            let slopes = Mat::from_fn(2 * n, n + 1, |_, _| 4.0 * (stream.random::<f64>() - 0.5));
            let g = slopes.transpose() * &slopes * 10.0;
            let x: Vec<f64> = bounds.iter().map(|[low, high]| low + (high - low) * stream.random::<f64>()).collect();
            let (to, gain) = step(&model, &x, &g, f64::INFINITY);
            assert!(gain >= 0.0);
            let a = information(&model, &g);
            for (i, [low, high]) in bounds.iter().copied().enumerate() {
                assert!((low..=high).contains(&to[i]));
                // Slope of the cost there: nothing inside, and downhill beyond a bound.
                let slope = (0..n).map(|j| a[(i, j)] * (to[j] - x[j])).sum::<f64>() - (g[(i, n)] - x[i]);
                if to[i] == low || to[i] == high {
                    at_bounds += 1;
                } else {
                    assert!(slope.abs() < 1e-6 * a[(i, i)], "{i}: {slope}");
                }
            }
        }
        assert!(at_bounds > 5, "{at_bounds}");
    }

    #[test]
    fn data_do_not_tell_an_effect_from_a_tolerance_that_does_the_same() {
        let problem = problem(&Truth { soil: [200.0, 1.5 * DAMPING], ..Truth::default() });
        fitted(&problem, &["small_strain_damping"], |fit, fitter| {
            let start = fit.model.start(0);
            assert_eq!(fit.model.same(&fit.x).len(), 1);
            let at = fitter.point(&fit.model, fit.x.clone()).unwrap();
            let own = fitter.slope(&fit.model, &at, start).unwrap();
            let missed = square(&combined(&own, &fit.slopes[start], 1.0, -1.0)).sqrt() / square(&own).sqrt();
            assert!(missed < 0.05, "{missed}");
            // What is known of the two is known of their product alone: the interval is that of the tolerance.
            let deviation = fit.covariance().unwrap()[(start, start)].sqrt();
            assert!(deviation > 0.8 * problem.tolerances.damping_ln, "{deviation}");
        });
    }

    #[test]
    fn damping_of_a_partly_coherent_field_is_found() {
        // Least squares that take the field for coherent would find three times the damping of what does not follow the base.
        for seed in [5, 6, 7, 8] {
            let problem = problem(&Truth { soil: [200.0, 0.05], coherence: straying, seed, ..Truth::default() });
            fitted(&problem, &["small_strain_damping"], |fit, fitter| {
                let found = damping_ratio(fit);
                println!("seed {seed}: damping ratio {found:.4}, 0.0500 holds");
                assert!((found / 0.05 - 1.0).abs() < 0.1, "seed {seed}: {found}");
                for [f, c] in fitter.spread().at_knots(1, band_hz(fitter.forward)) {
                    println!("  {f:.2} Hz: {c:.3} {:.3}", straying(f));
                    assert!((c - straying(f)).abs() < 0.1, "seed {seed}, {f} Hz: {c} {}", straying(f));
                }
            });
        }
    }

    #[test]
    fn a_coherent_field_is_found_coherent_and_leaving_events_out_moves_little() {
        let problem = problem(&Truth { soil: [204.0, 0.025], ..Truth::default() });
        fitted(&problem, &[], |fit, fitter| {
            let spread = fitter.spread();
            assert!(spread.coherence.iter().flatten().all(|c| *c > 0.99), "{:?}", spread.coherence);
            assert!(spread.level < 1.2, "{}", spread.level);
            let covariance = fit.covariance().unwrap();
            let groups: Vec<usize> = fitter.forward.records.iter().map(|at| at.group).collect();
            for x in fit.without_each_event(&groups) {
                for (i, (a, b)) in x.iter().zip(&fit.x).enumerate() {
                    assert!((a - b).abs() < 4.0 * covariance[(i, i)].sqrt() + 0.05, "{i}: {a} {b}");
                }
            }
        });
    }

    #[test]
    fn evidence_at_an_end_of_a_range_is_that_of_quadrature() {
        let problem =
            problem(&Truth { table: "kind = 'frequency_dependent_damping'\nbeta_s = 0.0", ..Truth::default() });
        let declared = Declared::new(&problem).unwrap();
        let all = effects::instances(&problem.array);
        let effect = all.iter().find(|i| i.free.len() == 1 && i.free[0].parameter.name == "beta_s").unwrap().clone();
        let model = Model { declared: &declared, effects: vec![effect] };
        let (n, at) = (model.len(), model.start(0));
        let (prior, [low, high]) = (model.prior()[at], model.bounds()[at]);
        // One strength alone is told of: the density is exp(−½ a (x − u)²), its top below, at and above what is allowed.
        let precision = 9.0 / prior[1].powi(2);
        for top in [-4.0, -1.5, -0.3, 0.0, 0.7, 2.0].map(|d| low + d * prior[1]) {
            let mut x: Vec<f64> = model.prior().iter().map(|[mean, _]| *mean).collect();
            let unbounded = precision * top / (precision + prior[1].powi(-2));
            x[at] = unbounded.clamp(low, high);
            let mut g = Mat::zeros(n + 1, n + 1);
            g[(at, at)] = precision;
            g[(at, n)] = -precision * (x[at] - top);
            let cost = 0.5 * precision * (x[at] - top).powi(2) + Fitter::prior(&model, &x);
            let found = occam(&model, &x, &g) - cost;
            let count = 200_000;
            let step = (high - low).min(12.0 * prior[1]) / f64::from(count);
            let (mut of_prior, mut of_posterior) = (0.0, 0.0);
            for x in (0..count).map(|k| low + (f64::from(k) + 0.5) * step) {
                let density = (-0.5 * ((x - prior[0]) / prior[1]).powi(2)).exp();
                of_prior += density;
                of_posterior += density * (-0.5 * precision * (x - top).powi(2)).exp();
            }
            let expected = (of_posterior / of_prior).ln();
            assert!((found - expected).abs() < 0.02, "{top}: {found} {expected}");
        }
    }
}
