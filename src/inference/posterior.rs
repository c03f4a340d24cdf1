//! The most probable coordinates of a model, their uncertainty, and the evidence for the model.

use super::algebra::{inverse, ln_determinant, solved};
use super::convention;
use super::forward::{Forward, Prediction, lock};
use super::parameters::Model;
use super::weights::{Rows, Spread, Weights, band_hz};
use crate::error::Result;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use toml::Table;

/// Most steps of a fit.
const STEPS: usize = 30;
/// Expected gain below which a fit has converged, nats.
const CONVERGED: f64 = 0.1;
/// Share of the expected gain that a step must bring for its slopes to be trusted again, and to be taken at all.
const TRUSTED: [f64; 2] = [0.3, 0.02];
/// Gain of a step over what was expected of it within which its slopes are carried on.
const AGREE: [f64; 2] = [0.5, 1.6];
/// Prior standard deviations by which any coordinate moves at most in the first step, in any, and below which a fit ends.
const RADIUS: [f64; 3] = [1.0, 4.0, 0.02];
/// Highest frequency of the first of a series of fits, in fundamental frequencies of the column.
const FIRST_MODES: f64 = 1.5;
/// Prior standard deviations beyond which a declared value is out of its tolerance.
pub const STRAINED: f64 = 3.0;
/// Prior standard deviations within which what replays add to slopes is carried on.
const NEAR: f64 = 1.0;
/// Length of a step, prior standard deviations, below which what a replay does is as much the chance of its time steps as the step's.
const JITTER: f64 = 0.2;

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
    /// −ln of the density where every residual is nothing.
    pub constant: f64,
    /// How residuals change with each coordinate.
    pub slopes: Vec<Arc<Rows>>,
    /// What replays add to the slopes that the linear-equivalent column has in what is declared, where it was last told.
    pub corrections: Arc<Corrections>,
    /// Normal equations: information on the coordinates, and in the last row and column the right-hand side.
    pub g: Mat<f64>,
}

/// What replays add to the slopes of the linear-equivalent column.
#[derive(Default)]
pub struct Corrections {
    /// The coordinates of what is declared where that was told.
    at: Vec<f64>,
    /// By coordinate.
    slopes: Vec<Rows>,
    /// Their size over that of the slopes.
    share: f64,
}

impl Corrections {
    /// Size of what the linear-equivalent column misses over that of the slopes.
    pub fn missed(&self) -> f64 {
        self.share
    }

    /// The corrections, as far as they hold at `x`.
    fn near(&self, x: &[f64]) -> &[Rows] {
        let is_near = self.at.iter().zip(x).all(|(a, b)| (a - b).abs() < NEAR);
        if is_near { &self.slopes } else { &[] }
    }
}

/// When a fit ends.
#[derive(Debug, Clone, Copy)]
pub struct Stop {
    /// Most steps.
    pub steps: usize,
    /// Expected gain below which it has converged, in ln of the posterior density.
    pub gain: f64,
    /// Whether it has to have converged by slopes that replays tell; otherwise those of the linear-equivalent column will do.
    pub is_exact: bool,
}

impl Stop {
    /// At the most probable coordinates.
    pub const EXACT: Self = Self { steps: STEPS, gain: CONVERGED, is_exact: true };
    /// Good enough to go on from.
    const ON_THE_WAY: Self = Self { steps: 10, gain: 0.5, is_exact: false };
    /// Where the linear-equivalent column sees nothing to be gained any more.
    pub const CLOSE: Self = Self { steps: STEPS, gain: CONVERGED, is_exact: false };
}

/// Where slopes come from, from the quickest to the best.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Source {
    Carried,
    Surrogate,
    Replayed,
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
    /// Effects of the state of the column that is replayed, everything else by the linear-equivalent column from there; without one
    /// every step is replayed.
    pub near: Option<Vec<Table>>,
    /// See [`Fit::corrections`]; empty where they are not known.
    pub corrections: Arc<Corrections>,
}

impl<'a> Start<'a> {
    /// From `x`, with slopes of the linear-equivalent column.
    pub fn at(model: Model<'a>, x: Vec<f64>) -> Self {
        Self { model, x, slopes: Vec::new(), near: None, corrections: Arc::default() }
    }

    /// From `x`, with slopes of the linear-equivalent column and what is known of what replays add to them.
    pub fn corrected(model: Model<'a>, x: Vec<f64>, corrections: &Arc<Corrections>) -> Self {
        Self { corrections: corrections.clone(), ..Self::at(model, x) }
    }

    /// From `x` by what is known beside the fit `base`, to which the model adds effects; everything by the linear-equivalent column from
    /// there.
    pub fn near(base: &Fit<'a>, model: Model<'a>, x: Vec<f64>) -> Self {
        let near = Some(base.model.tables(&base.x));
        let slopes = base.slopes.iter().cloned().map(Some).collect();
        Self { near, slopes, ..Self::corrected(model, x, &base.corrections) }
    }

    /// From the fit `found`, with its slopes.
    pub fn from(found: Fit<'a>) -> Self {
        let Fit { model, x, slopes, corrections, .. } = found;
        Self { slopes: slopes.into_iter().map(Some).collect(), corrections, ..Self::at(model, x) }
    }
}

/// A point of a fit.
struct Point {
    x: Vec<f64>,
    prediction: Arc<Prediction>,
    rows: Arc<Rows>,
    constant: f64,
}

impl<'a> Fitter<'a> {
    /// One that weighs residuals as `spread` says, transfer functions those of `reference`.
    pub fn new(forward: &'a Forward<'a>, spread: Spread, reference: Arc<Prediction>) -> Self {
        Self { forward, spread, reference, weights: Mutex::default(), high_hz: f64::INFINITY }
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
        let prediction = self.forward.predict(&model.tables(x))?;
        Ok(Self::with_conventions(prediction, model, x))
    }

    /// The same by the linear-equivalent column from the replay under `near`.
    ///
    /// # Errors
    /// When a column cannot be built, or not be replayed under `near`.
    pub fn predict_near(&self, model: &Model<'a>, x: &[f64], near: &[Table]) -> Result<Arc<Prediction>> {
        let prediction = self.forward.predict_near(&model.tables(x), near)?;
        Ok(Self::with_conventions(prediction, model, x))
    }

    fn with_conventions(mut prediction: Prediction, model: &Model<'_>, x: &[f64]) -> Arc<Prediction> {
        convention::add(&mut prediction, &model.declared.conventions, model.declared.convention_strengths(x));
        Arc::new(prediction)
    }

    fn point(&self, model: &Model<'a>, x: Vec<f64>, near: Option<&[Table]>) -> Result<Point> {
        let prediction = match near {
            Some(near) => self.predict_near(model, &x, near)?,
            None => self.predict(model, &x)?,
        };
        let (rows, constant) = self.rows(&prediction);
        Ok(Point { x, prediction, rows, constant })
    }

    fn weights(&self, prediction: &Prediction) -> Arc<Weights> {
        let channels = prediction.first().map(|p| p.channels.clone()).unwrap_or_default();
        let mut known = lock(&self.weights);
        let is_reference = self.reference.first().is_some_and(|p| p.channels == channels);
        let of = if is_reference { &self.reference } else { prediction };
        let made = || Arc::new(Weights::new(self.forward, &self.spread, of).below(self.forward, self.high_hz));
        known.entry(channels).or_insert_with(made).clone()
    }

    /// Residuals of a prediction, and −ln of the density where they are nothing.
    pub fn rows(&self, prediction: &Prediction) -> (Arc<Rows>, f64) {
        let weights = self.weights(prediction);
        (Arc::new(weights.rows(prediction)), weights.constant)
    }

    /// −ln of the density of the records given a prediction.
    pub fn nll(&self, prediction: &Prediction) -> f64 {
        let (rows, constant) = self.rows(prediction);
        0.5 * square(&rows) + constant
    }

    /// How residuals change with coordinate `i`, by replays or by the linear-equivalent column from the replay under `near`; `None` where
    /// the column does not finish beside it.
    fn slope(&self, model: &Model<'a>, at: &Point, i: usize, near: Option<&[Table]>) -> Option<Arc<Rows>> {
        let step = model.step(&at.x, i);
        let mut beside = at.x.clone();
        beside[i] += step;
        let there = self.point(model, beside, near).ok()?;
        Some(Arc::new(combined(&there.rows, &at.rows, 1.0 / step, -1.0 / step)))
    }

    fn all_slopes(
        &self,
        model: &Model<'a>,
        at: &Point,
        known: &[Option<Arc<Rows>>],
        near: Option<&[Table]>,
    ) -> Vec<Arc<Rows>> {
        let of = |i: usize| {
            let own = known.get(i).cloned().flatten().filter(|_| model.is_replayed(i));
            own.or_else(|| self.slope(model, at, i, near))
                .unwrap_or_else(|| Arc::new(combined(&at.rows, &at.rows, 0.0, 0.0)))
        };
        (0..model.len()).map(of).collect()
    }

    /// Slopes as far as they are `known`; others by the linear-equivalent column from the replay under `near`, or at `at` itself, and what
    /// replays are known to add to them nearby.
    fn quick_slopes(
        &self,
        model: &Model<'a>,
        at: &Point,
        known: &[Option<Arc<Rows>>],
        near: Option<&[Table]>,
        corrections: &Corrections,
    ) -> Vec<Arc<Rows>> {
        let own = model.tables(&at.x);
        let mut slopes = self.all_slopes(model, at, known, Some(near.unwrap_or(&own)));
        for (i, correction) in corrections.near(&at.x).iter().enumerate().filter(|(i, _)| model.is_replayed(*i)) {
            if known.get(i).is_none_or(Option::is_none) {
                slopes[i] = Arc::new(combined(&slopes[i], correction, 1.0, 1.0));
            }
        }
        slopes
    }

    /// Slopes by replays, and what they add to those of the linear-equivalent column.
    fn replayed_slopes(&self, model: &Model<'a>, at: &Point, near: Option<&[Table]>) -> (Vec<Arc<Rows>>, Corrections) {
        let quick = self.quick_slopes(model, at, &[], near, &Corrections::default());
        let replayed = self.all_slopes(model, at, &[], None);
        let n = model.declared.len();
        let slopes: Vec<Rows> = replayed.iter().zip(&quick).take(n).map(|(a, b)| combined(a, b, 1.0, -1.0)).collect();
        let whole = replayed.iter().take(n).map(|s| square(s)).sum::<f64>().sqrt();
        let share = slopes.iter().map(square).sum::<f64>().sqrt() / whole.max(f64::MIN_POSITIVE);
        (replayed, Corrections { at: at.x[..n].to_vec(), slopes, share })
    }

    /// Corrects slopes by what a step did, along it alone.
    ///
    /// ```text
    /// J ← J + (Δr − J δ) δᵀ/(δᵀ δ + τ²)                                      (1)
    /// ```
    ///
    /// τ is [`JITTER`], so that what a short step does by chance is not taken for a slope; δ in prior standard deviations, over the
    /// coordinates whose slopes are replays; those of sensors are taken anew.
    ///
    /// Source: (1) Broyden (1965), doi 10.1090/S0025-5718-1965-0198670-6.
    fn learn(model: &Model<'a>, slopes: &mut [Arc<Rows>], [from, to]: [&Point; 2]) {
        let prior = model.prior();
        let delta: Vec<f64> = (0..model.len()).map(|i| (to.x[i] - from.x[i]) / prior[i][1]).collect();
        let square: f64 = (0..model.len()).filter(|i| model.is_replayed(*i)).map(|i| delta[i] * delta[i]).sum();
        if square < 1e-12 {
            return;
        }
        let mut missed = combined(&to.rows, &from.rows, 1.0, -1.0);
        for (i, slope) in slopes.iter().enumerate() {
            missed = combined(&missed, slope, 1.0, from.x[i] - to.x[i]);
        }
        for (i, slope) in slopes.iter_mut().enumerate() {
            let factor = delta[i] / ((square + JITTER * JITTER) * prior[i][1]);
            if model.is_replayed(i) && factor != 0.0 {
                *slope = Arc::new(combined(slope, &missed, 1.0, factor));
            }
        }
    }

    /// ½ of the squared distance from the means of the prior.
    pub fn prior(model: &Model<'_>, x: &[f64]) -> f64 {
        model.prior().iter().zip(x).map(|([mean, sd], x)| 0.5 * ((x - mean) / sd).powi(2)).sum()
    }

    /// Fits from `x`, first to the lowest mode of the column, then to one octave more at a time: where a model is far off, residuals
    /// at high frequencies lead to the next cycle and not to the right one.
    ///
    /// Source: Bunks et al. (1995), doi 10.1190/1.1443880.
    ///
    /// # Errors
    /// As [`Fitter::fit`].
    pub fn fit_from_afar(&self, mut model: Model<'a>, mut x: Vec<f64>, stop: Stop) -> Result<Fit<'a>> {
        let [_, high_hz] = band_hz(self.forward);
        let mut below = self.of_lowest_modes();
        while below.high_hz < high_hz {
            let found = below.fit(Start::at(model, x), Stop::ON_THE_WAY)?;
            (model, x) = (found.model, found.x);
            below = below.below(2.0 * below.high_hz);
        }
        self.fit(Start::at(model, x), stop)
    }

    /// One for which residuals up to the lowest mode of the column count alone.
    pub fn of_lowest_modes(&self) -> Self {
        self.below(FIRST_MODES * 0.25 / self.forward.problem.array.profile.travel_time_s())
    }

    fn below(&self, high_hz: f64) -> Self {
        Self { high_hz, ..Self::new(self.forward, self.spread.clone(), self.reference.clone()) }
    }

    /// Fits from `start`: Gauss–Newton steps within a trust region.
    ///
    /// # Errors
    /// When the column cannot be replayed at the start.
    pub fn fit(&self, start: Start<'a>, stop: Stop) -> Result<Fit<'a>> {
        let Start { model, x, slopes: known, near, mut corrections } = start;
        let mut at = self.point(&model, x, near.as_deref())?;
        let is_carried = known.iter().any(Option::is_some);
        let mut source = if is_carried { Source::Carried } else { Source::Surrogate };
        let mut best = Source::Surrogate;
        let mut slopes = self.quick_slopes(&model, &at, &known, near.as_deref(), &corrections);
        let mut radius = RADIUS[0];
        for _ in 0..stop.steps {
            let g = normal(&slopes, &at.rows);
            let cost = at.cost(&model);
            let (to, expected) = step(&model, &at.x, &g, radius);
            // What is left to gain is not what a short step gains.
            let (_, whole) = step(&model, &at.x, &g, f64::INFINITY);
            let is_at_end = whole < stop.gain || expected <= 0.0 || radius < RADIUS[2];
            let found = if is_at_end { None } else { self.point(&model, to.clone(), near.as_deref()).ok() };
            let ratio = found.as_ref().map_or(f64::NEG_INFINITY, |found| (cost - found.cost(&model)) / expected);
            if let Some(found) = &found {
                Self::learn(&model, &mut slopes, [&at, found]);
            }
            radius = match ratio {
                _ if is_at_end => radius.max(JITTER),
                r if r > 0.75 => (2.0 * radius).min(RADIUS[1]),
                r if r < TRUSTED[0] => 0.35 * radius,
                _ => radius,
            };
            let is_taken = found.is_some() && ratio > TRUSTED[1];
            let better = match source {
                Source::Carried => Some(best),
                Source::Surrogate => stop.is_exact.then_some(Source::Replayed),
                Source::Replayed => None,
            };
            if is_taken {
                at = found.unwrap_or(at);
                // Slopes that foresaw something else are those of another place.
                let is_other = !(AGREE[0]..AGREE[1]).contains(&ratio);
                let known: Vec<Option<Arc<Rows>>> = slopes.iter().cloned().map(Some).collect();
                source = if is_other { Source::Surrogate } else { Source::Carried };
                let known: &[_] = if is_other { &[] } else { &known };
                slopes = self.quick_slopes(&model, &at, known, near.as_deref(), &corrections);
            } else if let Some(better) = better {
                (source, best) = (better, better);
                if source == Source::Replayed {
                    let (replayed, told) = self.replayed_slopes(&model, &at, near.as_deref());
                    (slopes, corrections) = (replayed, Arc::new(told));
                } else {
                    slopes = self.quick_slopes(&model, &at, &[], near.as_deref(), &corrections);
                }
            } else if is_at_end {
                break;
            }
        }
        let g = normal(&slopes, &at.rows);
        let Point { x, prediction, rows, constant } = at;
        Ok(Fit { model, x, prediction, rows, constant, slopes, corrections, g })
    }
}

impl Point {
    /// −ln of the posterior density, constants apart.
    fn cost(&self, model: &Model<'_>) -> f64 {
        0.5 * square(&self.rows) + self.constant + Fitter::prior(model, &self.x)
    }
}

impl Fit<'_> {
    /// Whether declared values are farther off than their tolerances allow: they stand in for an effect.
    pub fn is_strained(&self) -> bool {
        self.x[..self.model.declared.len()].iter().any(|z| z.abs() > STRAINED)
    }

    /// Posterior covariance of the coordinates by the curvature of the cost.
    pub fn covariance(&self) -> Option<Mat<f64>> {
        inverse(&information(&self.model, &self.g))
    }

    /// −ln of the posterior density, constants apart.
    pub fn cost(&self) -> f64 {
        0.5 * square(&self.rows) + self.constant + Fitter::prior(&self.model, &self.x)
    }

    /// ln of the evidence.
    pub fn log_evidence(&self) -> f64 {
        occam(&self.model, &self.x, &self.g) - self.cost()
    }

    /// Coordinates when each event in turn is left out, by one step from here; `groups` are the events of the records.
    pub fn without_each_event(&self, groups: &[usize]) -> Vec<Vec<f64>> {
        let (n, prior) = (self.x.len(), self.model.prior());
        let of = |event: usize| {
            let kept = |rows: &Rows| -> Rows {
                rows.iter().zip(groups).filter(|(_, g)| **g != event).map(|(r, _)| r.clone()).collect()
            };
            let slopes: Vec<Arc<Rows>> = self.slopes.iter().map(|s| Arc::new(kept(s))).collect();
            let g = normal(&slopes, &kept(&self.rows));
            let side: Vec<f64> = (0..n).map(|i| g[(i, n)] - (self.x[i] - prior[i][0]) / prior[i][1].powi(2)).collect();
            let step = solved(&information(&self.model, &g), &side)?;
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

fn square(rows: &Rows) -> f64 {
    rows.iter().flatten().map(|r| r * r).sum()
}

/// Normal equations of residuals `rows` with these `slopes`: Jᵀ J, and −Jᵀ r in the last row and column.
pub fn normal(slopes: &[Arc<Rows>], rows: &Rows) -> Mat<f64> {
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

/// The step from `x` within `radius` prior standard deviations and the bounds, and what it is expected to gain.
fn step(model: &Model<'_>, x: &[f64], g: &Mat<f64>, radius: f64) -> (Vec<f64>, f64) {
    let (prior, bounds, n) = (model.prior(), model.bounds(), x.len());
    let a = information(model, g);
    let gradient: Vec<f64> = (0..n).map(|i| g[(i, n)] - (x[i] - prior[i][0]) / prior[i][1].powi(2)).collect();
    let mut held = vec![false; n];
    let mut to = x.to_vec();
    for _ in 0..n {
        let free: Vec<usize> = (0..n).filter(|i| !held[*i]).collect();
        let m = free.len();
        // A trust region in prior standard deviations.
        let damped = |lambda: f64| {
            let own = Mat::from_fn(m, m, |i, j| {
                a[(free[i], free[j])] + if i == j { lambda / prior[free[i]][1].powi(2) } else { 0.0 }
            });
            let side = Mat::from_fn(m, 1, |i, _| gradient[free[i]]);
            own.llt(Side::Lower).ok().map(|f| f.solve(&side))
        };
        let size = |s: &Mat<f64>| (0..m).map(|i| (s[(i, 0)] / prior[free[i]][1]).abs()).fold(0.0, f64::max);
        let mut lambda = 0.0;
        let mut found = damped(lambda);
        for _ in 0..40 {
            match &found {
                Some(s) if size(s) <= radius => break,
                _ => {
                    lambda = if lambda == 0.0 { 1.0 } else { 2.0 * lambda };
                    found = damped(lambda);
                }
            }
        }
        let Some(s) = found else { return (x.to_vec(), 0.0) };
        to.copy_from_slice(x);
        free.iter().enumerate().for_each(|(i, at)| to[*at] += s[(i, 0)]);
        // Only as far as the first bound on the way; a coordinate that stands at its bound stays there.
        let room = |i: &usize| {
            let [low, high] = bounds[*i];
            let moved = to[*i] - x[*i];
            let end = if moved < 0.0 { low } else { high };
            let share = if moved == 0.0 { f64::INFINITY } else { ((end - x[*i]) / moved).max(0.0) };
            (*i, share)
        };
        let nearest = free.iter().map(room).min_by(|a, b| a.1.total_cmp(&b.1));
        match nearest {
            Some((i, share)) if share < 1e-6 => held[i] = true,
            Some((_, share)) => {
                (0..n).for_each(|i| to[i] = x[i] + share.min(1.0) * (to[i] - x[i]));
                break;
            }
            None => break,
        }
    }
    let dx: Vec<f64> = to.iter().zip(x).map(|(a, b)| a - b).collect();
    let linear: f64 = dx.iter().zip(&gradient).map(|(d, g)| d * g).sum();
    let square: f64 = (0..n).map(|i| dx[i] * (0..n).map(|j| a[(i, j)] * dx[j]).sum::<f64>()).sum();
    (to, linear - 0.5 * square)
}

/// ln of the share of the prior that the posterior leaves, half of it where a strength has one sign:
///
/// ```text
/// −½ ln det(I + Λ^{−1/2} A Λ^{−1/2}) + Σ ln 2 Φ(distance of a one-sided strength from zero in deviations)      (1)
/// ```
fn occam(model: &Model<'_>, x: &[f64], g: &Mat<f64>) -> f64 {
    let prior = model.prior();
    let n = prior.len();
    let scaled = Mat::from_fn(n, n, |i, j| g[(i, j)] * prior[i][1] * prior[j][1] + f64::from(u8::from(i == j)));
    let Some(ln) = ln_determinant(&scaled) else { return f64::NEG_INFINITY };
    let covariance = inverse(&scaled);
    let bounds = model.bounds();
    let one_sided = |i: usize| {
        let distance = [bounds[i][0], bounds[i][1]].map(|b| (b - prior[i][0]).abs() < 1e-12);
        let deviation = covariance.as_ref().map_or(1.0, |c| c[(i, i)].sqrt()) * prior[i][1];
        let toward = if distance[0] { 1.0 } else { -1.0 };
        (distance[0] || distance[1]).then(|| (2.0 * normal_probability(toward * (x[i] - prior[i][0]) / deviation)).ln())
    };
    -0.5 * ln + (model.declared.len()..n).filter_map(one_sided).sum::<f64>()
}

/// Probability that a standard normal number is below `z`.
///
/// Source: Abramowitz and Stegun (1964), 26.2.17; error below 7.5e-8.
pub fn normal_probability(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let series =
        t * (0.319_381_530 + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    let tail = (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt() * series;
    if z >= 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{DAMPING, Truth, Uniform, problem};
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
            let at = fitter.point(&model, x, None).unwrap();
            let g = normal(&fitter.all_slopes(&model, &at, &[], None), &at.rows);
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
                // Slopes are differences over a fifth of a prior deviation.
                assert!((found - expected).abs() < 0.1 * size, "{found} {expected} {size}");
            }
        });
    }

    #[test]
    fn surrogate_slopes_are_those_of_replays() {
        let problem = problem(&Truth::default());
        let replay = Uniform(&problem);
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        // The analytic column that stands for replays here has damping without dispersion.
        forward.without_dispersion().unwrap();
        let declared = Declared::new(&problem).unwrap();
        let model = Model { declared: &declared, effects: Vec::new() };
        let prediction = Arc::new(forward.predict(&[]).unwrap());
        let fitter = Fitter::new(&forward, Spread::estimated(&forward, &prediction), prediction);
        for share in [0.0, 0.5] {
            let at = fitter.point(&model, vec![share; model.len()], None).unwrap();
            let replayed = fitter.all_slopes(&model, &at, &[], None);
            let surrogate = fitter.all_slopes(&model, &at, &[], Some(&model.tables(&at.x)));
            for (i, (a, b)) in replayed.iter().zip(&surrogate).enumerate() {
                let [missed, whole] = [square(&combined(a, b, 1.0, -1.0)), square(a)].map(f64::sqrt);
                // Its elements are a few to a wave, so that the peaks of the higher modes are not quite where they are. The analytic column
                // knows of velocity and damping alone.
                assert!(i > 1 || (whole > 1.0 && missed < 0.2 * whole), "coordinate {i}: {missed} of {whole}");
            }
        }
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
    fn normal_probabilities_are_those_of_tables() {
        for (z, p) in [(0.0, 0.5), (1.0, 0.841_344_7), (-1.959_964, 0.025), (3.0, 0.998_650_1)] {
            assert!((normal_probability(z) - p).abs() < 1e-6, "{z}");
        }
    }
}
