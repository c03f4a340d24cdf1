//! The most probable coordinates of a model, their uncertainty, and the evidence for the model.

mod search;
mod slopes;

use super::algebra::{Quadratic, inverse, ln_determinant, solved};
use super::convention;
use super::forward::{Forward, Label, Prediction, labels, lock};
use super::parameters::Model;
use super::spread::{Spread, band_hz};
use super::weights::{self, Expected, Rows, Weights};
use crate::effects::Instance;
use crate::error::Result;
use crate::metrics::{normal_probability, scaled_tail};
use faer::Mat;
use rayon::prelude::*;
pub use search::{Stop, Taken};
pub use slopes::{Slope, foretold, rows_of};
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// Highest frequency of the first of a series of fits, in fundamental frequencies of the column.
const FIRST_MODES: f64 = 1.5;

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
    pub slopes: Vec<Slope>,
    /// Normal equations: information on the coordinates, and in the last row and column the right-hand side.
    pub g: Mat<f64>,
    /// Where its slopes are from.
    pub taken: Taken,
    /// Whether its search came to its end; otherwise there may be more to gain than models can be compared by.
    pub is_settled: bool,
}

/// What fits models.
pub struct Fitter<'a> {
    /// The column and the sensors.
    pub forward: &'a Forward<'a>,
    /// What is expected of records, and weights, by the labels of the sensors.
    expected: HashMap<Vec<Label>, Expected>,
    weights: Mutex<HashMap<Vec<Label>, Arc<Weights>>>,
    /// The highest frequency that counts, Hz.
    high_hz: f64,
    /// Whether the equivalent-linear column tells how replays change.
    pub is_led: bool,
}

/// Where a fit starts.
#[derive(Clone)]
pub struct Start<'a> {
    /// The model.
    pub model: Model<'a>,
    /// Its coordinates.
    pub x: Vec<f64>,
    /// Slopes that are known already, by coordinate.
    pub slopes: Vec<Option<Slope>>,
    /// Where these are from.
    pub taken: Taken,
    /// Whether that is where a search came to its end.
    pub is_settled: bool,
}

impl<'a> Start<'a> {
    /// From `x`.
    pub fn at(model: Model<'a>, x: Vec<f64>) -> Self {
        Self { model, x, slopes: Vec::new(), taken: Taken::Elsewhere, is_settled: false }
    }

    /// The same with `slopes` from elsewhere.
    pub fn carrying(self, slopes: impl IntoIterator<Item = Option<Slope>>) -> Self {
        Self { slopes: slopes.into_iter().collect(), ..self }
    }

    /// The same with an effect besides, whose coordinates are `at` and whose slopes are not known.
    #[must_use]
    pub fn and(mut self, effect: &Instance, at: &[f64]) -> Self {
        self.model.effects.push(effect.clone());
        self.x.extend(at);
        self.slopes.resize(self.x.len(), None);
        Self { taken: Taken::Elsewhere, is_settled: false, ..self }
    }

    /// From where a fit of another model or by another column ended, its slopes such as lead on from there.
    pub fn led_by(found: Fit<'a>) -> Self {
        Self { taken: Taken::Elsewhere, is_settled: false, ..Self::from(found) }
    }

    /// From the fit `found`, with its slopes.
    pub fn from(found: Fit<'a>) -> Self {
        let Fit { model, x, slopes, taken, is_settled, .. } = found;
        Self { model, x, slopes: slopes.into_iter().map(Some).collect(), taken, is_settled }
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

impl<'a> Fitter<'a> {
    /// One that weighs residuals as `expected` says.
    pub fn new(forward: &'a Forward<'a>, expected: Expected) -> Self {
        let expected = HashMap::from([(labels(&expected.reference).to_vec(), expected)]);
        Self { forward, expected, weights: Mutex::default(), high_hz: f64::INFINITY, is_led: true }
    }

    /// The same with this for the labels of its reference.
    #[must_use]
    pub fn expecting(&self, expected: Expected) -> Self {
        let mut all = self.expected.clone();
        all.insert(labels(&expected.reference).to_vec(), expected);
        Self { expected: all, weights: Mutex::default(), ..*self }
    }

    /// The same with the column as `forward` has it.
    pub fn through<'f>(&self, forward: &'f Forward<'f>) -> Fitter<'f> {
        let weights = Mutex::new(lock(&self.weights).clone());
        Fitter { forward, expected: self.expected.clone(), weights, ..*self }
    }

    /// What is expected of the residuals of models with the labels of `prediction`.
    pub fn spread(&self, prediction: &Prediction) -> Option<&Spread> {
        self.expected.get(labels(prediction)).map(|expected| &expected.spread)
    }

    /// From the fit `found` that `other` weighed: with the same slopes, in units of its own; anew where these are not told. Slopes of what
    /// is not replayed are taken anew wherever a fit begins, so that all that count here change outputs alone.
    pub fn weighed_anew(&self, found: Fit<'a>, other: &Self) -> Start<'a> {
        let [own, other] = [self, other].map(|by| by.weights(&found.prediction));
        let converted = |slope: &Slope| slope.converted(|rows| own.converted(rows, &other, &found.prediction));
        match found.slopes.iter().map(converted).collect::<Option<Vec<_>>>() {
            Some(slopes) => Start { is_settled: false, ..Start::from(Fit { slopes, ..found }) },
            None => Start::at(found.model, found.x),
        }
    }

    /// What a model predicts.
    ///
    /// # Errors
    /// When the column cannot be replayed.
    pub fn predict(&self, model: &Model<'_>, x: &[f64]) -> Result<Arc<Prediction>> {
        let mut prediction = self.forward.predict(&model.tables(x))?;
        convention::add(&mut prediction, &model.declared.conventions, model.declared.convention_strengths(x));
        prediction.iter_mut().for_each(|p| p.added_share = x[model.declared.added()]);
        Ok(Arc::new(prediction))
    }

    /// What the model of `base` predicts with an effect besides, whose coordinates are `at`.
    ///
    /// # Errors
    /// When the column cannot be replayed.
    pub fn predict_with(&self, base: &Fit<'a>, effect: &Instance, at: &[f64]) -> Result<Arc<Prediction>> {
        let mut model = base.model.clone();
        model.effects.push(effect.clone());
        self.predict(&model, &[&base.x[..], at].concat())
    }

    /// How that changes the residuals of `base`.
    ///
    /// # Errors
    /// When the column cannot be replayed.
    pub fn change_with(&self, base: &Fit<'a>, effect: &Instance, at: &[f64]) -> Result<Rows> {
        Ok(combined(&self.rows(&*self.predict_with(base, effect, at)?).0, &base.rows, 1.0, -1.0))
    }

    fn point(&self, model: &Model<'_>, x: Vec<f64>) -> Result<Point> {
        let prediction = self.predict(model, &x)?;
        let (rows, constant) = self.rows(&prediction);
        Ok(Point { x, prediction, rows, constant })
    }

    fn weights(&self, prediction: &Prediction) -> Arc<Weights> {
        let taken = labels(prediction);
        let mut known = lock(&self.weights);
        // What strays and what the column has wrong beside other records is to be read off those.
        let own = || Expected::of(self.forward, Arc::new(prediction.clone()));
        let made = || Arc::new(self.expected.get(taken).cloned().unwrap_or_else(own).weights(self.forward));
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
        let mut below = self.below(FIRST_MODES * self.forward.problem.array.profile.fundamental_hz());
        while below.high_hz < high_hz {
            start = Start::from(below.fit(start, Stop::ON_THE_WAY)?);
            below = below.below(2.0 * below.high_hz);
        }
        self.fit(start, stop)
    }

    fn below(&self, high_hz: f64) -> Self {
        Self { high_hz, ..self.through(self.forward) }
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
}

impl Fit<'_> {
    /// The labels of its sensors.
    pub fn labels(&self) -> &[Label] {
        labels(&self.prediction)
    }

    /// Whether declared values are as far off as their tolerances allow: they stand in for an effect.
    pub fn is_strained(&self) -> bool {
        (0..self.x.len()).any(|i| self.model.is_strained(&self.x, i))
    }

    /// Posterior covariance of the coordinates by the curvature of the cost.
    pub fn covariance(&self) -> Option<Mat<f64>> {
        inverse(&information(&self.model, &self.g))
    }

    /// What one step is expected to gain in ln of the posterior density, nothing where the search came to its end.
    pub fn expected_gain(&self) -> f64 {
        if self.is_settled { 0.0 } else { step(&self.model, &self.x, &self.g, f64::INFINITY).1.max(0.0) }
    }

    /// ln of the evidence.
    pub fn log_evidence(&self) -> f64 {
        occam(&self.model, &self.x, &self.g) - self.cost
    }

    /// The most probable coordinates were every prior `ratio` times as wide, by one step from here.
    pub fn with_priors(&self, ratio: f64) -> Vec<f64> {
        let mut density = around(&self.model, &self.x, &self.g);
        for (i, [mean, sd]) in self.model.prior().into_iter().enumerate() {
            let more = (ratio.powi(-2) - 1.0) / (sd * sd);
            density.a[(i, i)] += more;
            density.gradient[i] -= more * (self.x[i] - mean);
        }
        let moved = density.highest(f64::INFINITY);
        moved.map_or(self.x.clone(), |(dx, _)| self.x.iter().zip(dx).map(|(x, d)| x + d).collect())
    }

    /// The most probable coordinates were there no ends to their ranges, by one step from here.
    pub fn beyond_bounds(&self) -> Vec<f64> {
        let step = solved(&information(&self.model, &self.g), &gradient(&self.model, &self.x, &self.g));
        step.map_or(self.x.clone(), |dx| self.x.iter().zip(dx).map(|(x, d)| x + d).collect())
    }

    /// Coordinates when each event in turn is left out, by one step from here; `groups` are the events of the records.
    pub fn without_each_event(&self, groups: &[usize]) -> Vec<Vec<f64>> {
        let of = |event: usize| {
            let kept = |rows: &Rows| -> Rows {
                rows.iter().zip(groups).filter(|(_, g)| **g != event).map(|(r, _)| r.clone()).collect()
            };
            let slopes: Vec<Arc<Rows>> = self.slopes.iter().map(|s| Arc::new(kept(&s.rows))).collect();
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

/// ln of the posterior density around `x`.
fn around(model: &Model<'_>, x: &[f64], g: &Mat<f64>) -> Quadratic {
    Quadratic {
        a: information(model, g),
        gradient: gradient(model, x, g),
        bounds: model.room(x),
        size: model.prior().iter().map(|[_, sd]| *sd).collect(),
    }
}

/// The step from `x` within `radius` prior standard deviations and the bounds, and what it is expected to gain.
fn step(model: &Model<'_>, x: &[f64], g: &Mat<f64>, radius: f64) -> (Vec<f64>, f64) {
    let Some((dx, gain)) = around(model, x, g).highest(radius) else { return (x.to_vec(), 0.0) };
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
mod tests;
