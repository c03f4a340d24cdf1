//! The likelihood of records given a prediction: a field that is partly coherent, noisy sensors, and a column that is never exact.

use super::algebra::eliminated;
use super::forward::{At, Bins, Forward, Predicted, Prediction};
use crate::numerics::smooth::running_mean;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use rayon::prelude::*;
use realfft::num_complex::Complex;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Half width over which spectra are smoothed, Hz.
const SMOOTH_HZ: f64 = 0.15;
/// Knots of the incoherent share, between the ends of the band at equal ratios.
const SHARE_KNOTS: usize = 7;
/// Knots of the discrepancy to an octave.
const KNOTS_AN_OCTAVE: f64 = 2.5;
/// Prior of the incoherent share 1 − c²: median, and standard deviation of its ln.
const SHARE: [f64; 2] = [1e-3, 2.0];
/// Largest incoherent share: something follows the column.
const LARGEST_SHARE: f64 = 0.995;
/// Prior of the discrepancy, relative to what the column adds to its base: median, and standard deviation of its ln.
const DISCREPANCY: [f64; 2] = [0.02, 0.7];
/// Least level of the discrepancy: mesh, time step and law leave no column better than that.
const LEAST_DISCREPANCY: f64 = 0.01;
/// Standard deviation of the ln of a noise level that records told before their event, and of one that is only bounded.
const NOISE_LN: [f64; 2] = [0.15, 1.0];
/// Noise of a sensor where nothing tells it, as a share of the RMS of its record within the band.
const USUAL_NOISE: f64 = 0.01;
/// Smallest power of noise, as a share of the largest of a record.
const FLOOR: f64 = 1e-12;
/// Largest excess of one bin's power over what is expected that counts in slopes of the variance: one in 400 bins has more.
const OUTLYING: f64 = 5.0;
/// Most values of one coordinate when levels of the discrepancy are searched, and the largest step in ln.
const LEVEL_STEPS: [f64; 4] = [0.9, 0.4, 0.2, 0.1];

/// What the likelihood knows beside the prediction.
#[derive(Debug, Clone)]
pub struct Hyper {
    /// ln(1 − c²) of each output sensor at the knots.
    pub ln_share: Vec<Vec<f64>>,
    /// ln of the factor on the noise of each sensor, the input sensor first.
    pub ln_noise: Vec<f64>,
    /// ln of the level of the discrepancy that is the same in all events, and of that which is not.
    pub ln_discrepancy: [f64; 2],
}

/// How a prediction changes with one coordinate, by record.
pub type Slope = Arc<Vec<Bins>>;

/// Normal equations of one record: coordinates, then the discrepancy (real and imaginary parts, sensor by sensor, knot by knot), then
/// the residual.
struct Normal {
    g: Mat<f64>,
    /// −ln of the likelihood where nothing is moved.
    nll: f64,
}

/// Normal equations of all records, the discrepancy marginalised.
pub struct Reduced {
    /// Information on the coordinates, and in its last row and column the right-hand side.
    pub g: Mat<f64>,
    /// −ln of the marginal likelihood where nothing is moved, priors of hyperparameters included.
    pub nll: f64,
    /// The same for each event without the part that events share; for leaving one out.
    pub events: Vec<Mat<f64>>,
}

/// Records of a problem with what their likelihood needs.
///
/// ```text
/// Y | U ~ CN( C (Ŷ + Φ (a + b_e)),  Σ ),   Σ = (I − C²) ⟨|Ŷ|²⟩ + S_out + H S_in Hᴴ                  (1)
/// −ln L = Σ_bins rᴴ Σ⁻¹ r + ln det Σ                                                              (2)
/// Φ_sk = φ_k(f) (Ŷ_s − U),   a ~ N(0, σ_a²),   b_e ~ N(0, σ_b²)                                    (3)
/// ```
///
/// Ŷ is the prediction, C the coherence of each sensor by a few knots over ln f, the same in all events. Φ(a + b) is what the column
/// itself has wrong: a smooth complex share of what it **adds to its base motion**, so that it vanishes below the first resonance, where
/// every column passes the motion as it is; a is the same in all events, b_e belongs to one. Both are marginalised, their levels
/// estimated. The incoherent part goes with the power that is predicted, so a prediction cannot gain by shrinking. H is the ratio of
/// predicted spectra to the base's, smoothed.
///
/// Limits: what is incoherent is independent between sensors and bins; components share nothing but the coordinates; in derivatives
/// H stands still.
/// Check:  `slopes_are_those_of_the_likelihood`, `damping_of_a_partly_coherent_field_is_found`.
/// Source: Pintelon and Schoukens (2012), System Identification, for H S_in Hᴴ; Kennedy and O'Hagan (2001), doi
/// 10.1111/1467-9868.00294, for the discrepancy.
pub struct Likelihood<'a> {
    forward: &'a Forward<'a>,
    band_hz: [f64; 2],
    n_knot: usize,
    /// Expected |noise|² of each bin before its factor, `[record][sensor][bin]`, the input sensor first.
    noise: Vec<Vec<Vec<f64>>>,
    /// Prior deviation of the ln of each sensor's factor on it.
    noise_ln: f64,
}

/// One record prepared at a prediction.
struct Prepared {
    /// ⟨|Ŷ|²⟩, `[sensor][bin]`.
    power: Vec<Vec<f64>>,
    /// H, `[sensor][bin]`.
    gain: Bins,
    half: usize,
}

/// Σ of one bin: diagonal plus one rank.
struct Covariance {
    /// Diagonal.
    d: Vec<f64>,
    /// H √S_in / √d.
    b: Vec<C64>,
    /// |b|².
    g: f64,
}

impl Covariance {
    /// Σ^{−1/2} x in place.
    fn whiten(&self, x: &mut [C64]) {
        x.iter_mut().zip(&self.d).for_each(|(x, d)| *x /= d.sqrt());
        let dot: C64 = self.b.iter().zip(&*x).map(|(b, x)| b.conj() * x).sum();
        let root = (1.0 + self.g).sqrt();
        let w = dot / (root * (1.0 + root));
        x.iter_mut().zip(&self.b).for_each(|(x, b)| *x -= b * w);
    }

    /// Σ⁻¹ x.
    fn solve(&self, x: &[C64]) -> Vec<C64> {
        let scaled: Vec<C64> = x.iter().zip(&self.d).map(|(x, d)| x / d.sqrt()).collect();
        let dot: C64 = self.b.iter().zip(&scaled).map(|(b, x)| b.conj() * x).sum();
        let w = dot / (1.0 + self.g);
        scaled.iter().zip(&self.b).zip(&self.d).map(|((x, b), d)| (x - b * w) / d.sqrt()).collect()
    }

    /// Diagonal of Σ⁻¹.
    fn inverse_diagonal(&self, s: usize) -> f64 {
        (1.0 - self.b[s].norm_sqr() / (1.0 + self.g)) / self.d[s]
    }

    fn ln_determinant(&self) -> f64 {
        self.d.iter().map(|d| d.ln()).sum::<f64>() + (1.0 + self.g).ln()
    }
}

/// Noise of a channel that no stretch of its record shows: white, a share of the RMS within the band, and no more than the least that
/// the band itself holds; never read off a band that processing may have emptied.
fn guessed(bins: &[C64]) -> Vec<f64> {
    let power: Vec<f64> = bins.iter().map(C64::norm_sqr).collect();
    let mean = power.iter().sum::<f64>() / power.len().max(1) as f64;
    let least = running_mean(&power, 3).into_iter().fold(f64::INFINITY, f64::min);
    vec![(USUAL_NOISE * USUAL_NOISE * mean).min(least).max(f64::MIN_POSITIVE); bins.len()]
}

/// Hat functions over ln f with `n` knots: the knot below and the share of the one above.
fn hat(frequency_hz: f64, [low, high]: [f64; 2], n: usize) -> (usize, f64) {
    if n < 2 {
        return (0, 0.0);
    }
    let x = (frequency_hz / low).ln() / (high / low).ln() * (n - 1) as f64;
    let x = x.clamp(0.0, (n - 1) as f64);
    let i = (x.floor() as usize).min(n - 2);
    (i, x - i as f64)
}

fn at_knots(values: &[f64], (i, w): (usize, f64)) -> f64 {
    values[i] * (1.0 - w) + values.get(i + 1).copied().unwrap_or_default() * w
}

impl<'a> Likelihood<'a> {
    /// Prepares the records of `forward`.
    pub fn new(forward: &'a Forward<'a>) -> Self {
        let is_noise_known = forward.problem.events.iter().all(|e| e.noise.iter().all(|n| n.is_measured));
        let ends =
            |g: &crate::diagnosis::spectra::Group| [g.frequencies_hz[0], *g.frequencies_hz.last().unwrap_or(&1.0)];
        let band_hz = forward
            .groups
            .iter()
            .map(ends)
            .fold([f64::INFINITY, 0.0f64], |[a, b], [low, high]| [a.min(low), b.max(high)]);
        let octaves = (band_hz[1] / band_hz[0]).log2();
        let noise = |at: &At| {
            let record = &forward.groups[at.group].records[at.record];
            let known = forward.problem.events[record.event].noise.iter();
            let pairs = known.zip(&record.noise).zip(&record.channels);
            pairs.map(|((n, own), bins)| if n.is_measured { own.clone() } else { guessed(bins) }).collect()
        };
        Self {
            n_knot: (KNOTS_AN_OCTAVE * octaves).ceil() as usize + 1,
            noise: forward.records.iter().map(noise).collect(),
            noise_ln: NOISE_LN[usize::from(!is_noise_known)],
            forward,
            band_hz,
        }
    }

    fn n_sensor(&self) -> usize {
        self.forward.problem.array.outputs.len()
    }

    fn n_discrepancy(&self) -> usize {
        2 * self.n_sensor() * self.n_knot
    }

    /// Hyperparameters at the medians of their priors.
    pub fn start(&self) -> Hyper {
        Hyper {
            ln_share: vec![vec![SHARE[0].ln(); SHARE_KNOTS]; self.n_sensor()],
            ln_noise: vec![0.0; self.n_sensor() + 1],
            ln_discrepancy: [DISCREPANCY[0].ln(); 2],
        }
    }

    /// Coherence c of output sensor `s` at its knots, with their frequencies, Hz.
    pub fn coherence(&self, hyper: &Hyper, s: usize) -> Vec<[f64; 2]> {
        let [low, high] = self.band_hz;
        let at = |k: usize| low * (high / low).powf(k as f64 / (SHARE_KNOTS - 1) as f64);
        hyper.ln_share[s].iter().enumerate().map(|(k, v)| [at(k), (1.0 - v.exp()).max(0.0).sqrt()]).collect()
    }

    fn prior(&self, hyper: &Hyper) -> f64 {
        let square = |x: f64, median: f64, sd: f64| 0.5 * ((x - median) / sd).powi(2);
        let shares = hyper.ln_share.iter().flatten().map(|x| square(*x, SHARE[0].ln(), SHARE[1])).sum::<f64>();
        let noise = hyper.ln_noise.iter().map(|x| square(*x, 0.0, self.noise_ln)).sum::<f64>();
        let levels = hyper.ln_discrepancy.iter().map(|x| square(*x, DISCREPANCY[0].ln(), DISCREPANCY[1])).sum::<f64>();
        shares + noise + levels
    }

    fn half(&self, at: At) -> usize {
        let f = self.forward.frequencies_hz(at);
        ((SMOOTH_HZ / (f[1] - f[0])).round() as usize).max(1)
    }

    fn prepared(&self, at: At, predicted: &Predicted) -> Prepared {
        let half = self.half(at);
        let smooth = |x: Vec<f64>| running_mean(&x, half);
        let norm = |x: &[C64]| smooth(x.iter().map(C64::norm_sqr).collect());
        let base = norm(&predicted.base);
        let most = base.iter().copied().fold(0.0, f64::max);
        let gain = |y: &Vec<C64>| -> Vec<C64> {
            let cross: Vec<C64> = y.iter().zip(&predicted.base).map(|(y, u)| y * u.conj()).collect();
            let re = smooth(cross.iter().map(|c| c.re).collect());
            let im = smooth(cross.iter().map(|c| c.im).collect());
            re.iter().zip(&im).zip(&base).map(|((re, im), p)| C64::new(*re, *im) / (p + FLOOR * most)).collect()
        };
        Prepared {
            power: predicted.outputs.iter().map(|y| norm(y)).collect(),
            gain: predicted.outputs.iter().map(gain).collect(),
            half,
        }
    }

    fn covariance(&self, index: usize, record: &Prepared, hyper: &Hyper, k: usize, share: &[f64]) -> Covariance {
        let noise = &self.noise[index];
        let s_in = noise[0][k] * hyper.ln_noise[0].exp();
        let n = self.n_sensor();
        let of = |s: usize| share[s] * record.power[s][k] + noise[s + 1][k] * hyper.ln_noise[s + 1].exp();
        let d: Vec<f64> = (0..n).map(|s| of(s).max(f64::MIN_POSITIVE)).collect();
        let b: Vec<C64> = (0..n).map(|s| record.gain[s][k] * (s_in / d[s]).sqrt()).collect();
        let g = b.iter().map(C64::norm_sqr).sum();
        Covariance { d, b, g }
    }

    fn shares(&self, hyper: &Hyper, frequency_hz: f64) -> Vec<f64> {
        let at = hat(frequency_hz, self.band_hz, SHARE_KNOTS);
        hyper.ln_share.iter().map(|v| at_knots(v, at).exp().min(LARGEST_SHARE)).collect()
    }

    /// Normal equations of record `index`; `measured` in place of what belongs to the prediction.
    ///
    /// Rows are Σ^{−1/2} of what moves the mean, real and imaginary parts, and one more for what moves the variance of each bin.
    fn normal(
        &self,
        index: usize,
        (predicted, beside): (&Predicted, &Predicted),
        slopes: &[Slope],
        hyper: &Hyper,
    ) -> Normal {
        let at = self.forward.records[index];
        let mut record = self.prepared(at, predicted);
        if !std::ptr::eq(predicted, beside) {
            record.gain = self.prepared(at, beside).gain;
        }
        let f = self.forward.frequencies_hz(at);
        let (n, n_x, n_knot) = (self.n_sensor(), slopes.len(), self.n_knot);
        let n_column = n_x + self.n_discrepancy() + 1;
        let mut rows = Mat::<f64>::zeros(3 * n * f.len(), n_column);
        // Slopes of the smoothed power, by coordinate.
        let powers: Vec<Vec<Vec<f64>>> = slopes
            .iter()
            .map(|slope| {
                let of = |(y, d): (&Vec<C64>, &Vec<C64>)| {
                    let product: Vec<f64> = y.iter().zip(d).map(|(y, d)| 2.0 * (y.conj() * d).re).collect();
                    running_mean(&product, record.half)
                };
                predicted.outputs.iter().zip(&slope[index]).map(of).collect()
            })
            .collect();
        let mut nll = 0.0;
        let mut moved = vec![C64::default(); n];
        for (k, f) in f.iter().enumerate() {
            let share = self.shares(hyper, *f);
            let c: Vec<f64> = share.iter().map(|v| (1.0 - v).sqrt()).collect();
            let sigma = self.covariance(index, &record, hyper, k, &share);
            let residual: Vec<C64> =
                (0..n).map(|s| predicted.measured[s][k] - c[s] * predicted.outputs[s][k]).collect();
            let solved = sigma.solve(&residual);
            nll += residual.iter().zip(&solved).map(|(r, w)| (r.conj() * w).re).sum::<f64>() + sigma.ln_determinant();
            let at = 3 * n * k;
            let mut put = |column: usize, values: &mut [C64]| {
                sigma.whiten(values);
                for (s, v) in values.iter().enumerate() {
                    rows[(at + 2 * s, column)] = v.re * std::f64::consts::SQRT_2;
                    rows[(at + 2 * s + 1, column)] = v.im * std::f64::consts::SQRT_2;
                }
            };
            for (i, slope) in slopes.iter().enumerate() {
                (0..n).for_each(|s| moved[s] = slope[index][s][k] * c[s]);
                put(i, &mut moved);
            }
            let (knot, weight) = hat(*f, self.band_hz, n_knot);
            for s in 0..n {
                let own = c[s] * (predicted.outputs[s][k] - predicted.base[k]);
                for (j, w) in [(knot, 1.0 - weight), (knot + 1, weight)] {
                    if w == 0.0 || j >= n_knot {
                        continue;
                    }
                    for (part, unit) in [C64::new(1.0, 0.0), C64::new(0.0, 1.0)].into_iter().enumerate() {
                        moved.fill(C64::default());
                        moved[s] = own * w * unit;
                        put(n_x + 2 * (s * n_knot + j) + part, &mut moved);
                    }
                }
            }
            moved.copy_from_slice(&residual);
            put(n_column - 1, &mut moved);
            for s in 0..n {
                let (row, inverse) = (at + 2 * n + s, sigma.inverse_diagonal(s));
                rows[(row, n_column - 1)] = (solved[s].norm_sqr() / inverse - 1.0).min(OUTLYING);
                for (i, power) in powers.iter().enumerate() {
                    rows[(row, i)] = share[s] * power[s][k] * inverse;
                }
                let own = predicted.outputs[s][k].conj() * (predicted.outputs[s][k] - predicted.base[k]);
                for (j, w) in [(knot, 1.0 - weight), (knot + 1, weight)] {
                    if w == 0.0 || j >= n_knot {
                        continue;
                    }
                    let column = n_x + 2 * (s * n_knot + j);
                    rows[(row, column)] = share[s] * inverse * 2.0 * w * own.re;
                    rows[(row, column + 1)] = -share[s] * inverse * 2.0 * w * own.im;
                }
            }
        }
        Normal { g: rows.transpose() * &rows, nll }
    }

    fn normals(&self, prediction: &Prediction, slopes: &[Slope], hyper: &Hyper) -> Vec<Normal> {
        let indices: Vec<usize> = (0..self.forward.records.len()).collect();
        indices.par_iter().map(|i| self.normal(*i, (&prediction[*i], &prediction[*i]), slopes, hyper)).collect()
    }

    /// Marginalises the discrepancy with the levels of `hyper`.
    fn reduced(&self, normals: &[Normal], hyper: &Hyper, n_x: usize) -> Option<Reduced> {
        let gone: Vec<usize> = (n_x..n_x + self.n_discrepancy()).collect();
        let precision = |level: usize| vec![(-2.0 * hyper.ln_discrepancy[level]).exp(); gone.len()];
        let [shared, own] = [0, 1].map(precision);
        let mut nll = self.prior(hyper);
        let n_component = self.forward.problem.array.components.len().max(1);
        let size = n_x + gone.len() + 1;
        let mut sums = vec![Mat::<f64>::zeros(size, size); n_component];
        let mut events = vec![Mat::<f64>::zeros(n_x + 1, n_x + 1); self.forward.groups.len()];
        let parts: Vec<_> =
            normals.par_iter().map(|normal| self.without_own(normal, &gone, &own)).collect::<Option<_>>()?;
        for ((normal, at), (left, ln, gain)) in normals.iter().zip(&self.forward.records).zip(parts) {
            let event = &self.forward.problem.events[self.forward.groups[at.group].records[at.record].event];
            nll += normal.nll + 0.5 * ln - 0.5 * gain;
            if n_x > 0 {
                events[at.group] += eliminated(&left, &gone, &shared)?.0;
            }
            sums[event.component().min(n_component - 1)] += left;
        }
        let mut g = Mat::<f64>::zeros(n_x + 1, n_x + 1);
        for sum in &sums {
            let (left, ln) = eliminated(sum, &gone, &shared)?;
            nll += 0.5 * ln - 0.5 * (sum[(size - 1, size - 1)] - left[(n_x, n_x)]);
            g += left;
        }
        Some(Reduced { g, nll, events })
    }

    /// Normal equations of a record with the discrepancy of its own event marginalised beside the one that events share, the ln of the
    /// determinant, and what that gains.
    fn without_own(&self, normal: &Normal, gone: &[usize], precision: &[f64]) -> Option<(Mat<f64>, f64, f64)> {
        let g = &normal.g;
        let (m, n) = (gone.len(), g.nrows());
        let level = 1.0 / precision.first().copied().unwrap_or(1.0).sqrt();
        let first = gone.first().copied().unwrap_or(0);
        let phi = g.subcols(first, m).to_owned();
        let inner = Mat::from_fn(m, m, |i, j| phi[(first + i, j)] * level * level + f64::from(u8::from(i == j)));
        let factor = inner.llt(Side::Lower).ok()?;
        let l = factor.L();
        let ln = (0..m).map(|i| 2.0 * l[(i, i)].ln()).sum();
        let scaled = Mat::from_fn(m, n, |i, j| phi[(j, i)] * level);
        let solved = factor.solve(&scaled);
        let left = g - scaled.transpose() * solved;
        let gain = g[(n - 1, n - 1)] - left[(n - 1, n - 1)];
        Some((left, ln, gain))
    }

    /// Normal equations at `prediction`, the discrepancy marginalised; `None` where numbers are out of range.
    pub fn at(&self, prediction: &Prediction, slopes: &[Slope], hyper: &Hyper) -> Option<Reduced> {
        let found = self.reduced(&self.normals(prediction, slopes, hyper), hyper, slopes.len())?;
        found.nll.is_finite().then_some(found)
    }

    /// −ln of the marginal likelihood and of the priors of hyperparameters; infinite where numbers are out of range.
    pub fn nll(&self, prediction: &Prediction, hyper: &Hyper) -> f64 {
        self.at(prediction, &[], hyper).map_or(f64::INFINITY, |r| r.nll)
    }

    /// The same with H of (1) as it is at another prediction, `beside`: what slopes there expect of a step.
    pub fn nll_beside(&self, prediction: &Prediction, beside: &Prediction, hyper: &Hyper) -> f64 {
        let indices: Vec<usize> = (0..self.forward.records.len()).collect();
        let one = |i: &usize| self.normal(*i, (&prediction[*i], &beside[*i]), &[], hyper);
        let normals: Vec<Normal> = indices.par_iter().map(one).collect();
        let found = self.reduced(&normals, hyper, 0).map_or(f64::INFINITY, |r| r.nll);
        if found.is_finite() { found } else { f64::INFINITY }
    }

    /// Moves `hyper` towards its best values at `prediction`: levels of the discrepancy, then shares and noise given its mean.
    pub fn tuned(&self, prediction: &Prediction, hyper: &Hyper, rounds: usize) -> Hyper {
        let mut hyper = hyper.clone();
        for _ in 0..rounds {
            // What strays from bin to bin first: a smooth discrepancy must not stand in for it.
            let normals = self.normals(prediction, &[], &hyper);
            let discrepancy = self.mean_discrepancy(&normals, &hyper);
            self.tune_covariance(prediction, &discrepancy, &mut hyper);
        }
        let normals = self.normals(prediction, &[], &hyper);
        self.tune_levels(&normals, &mut hyper);
        hyper
    }

    fn tune_levels(&self, normals: &[Normal], hyper: &mut Hyper) {
        let value = |hyper: &Hyper| self.reduced(normals, hyper, 0).map_or(f64::INFINITY, |r| r.nll);
        let mut best = value(hyper);
        for step in LEVEL_STEPS {
            for level in [0, 1] {
                for sign in [1.0, -1.0] {
                    let mut is_moved = false;
                    loop {
                        let mut other = hyper.clone();
                        other.ln_discrepancy[level] += sign * step;
                        if other.ln_discrepancy[level] < LEAST_DISCREPANCY.ln() {
                            break;
                        }
                        let found = value(&other);
                        if found >= best - 1e-3 {
                            break;
                        }
                        (best, is_moved) = (found, true);
                        *hyper = other;
                    }
                    if is_moved {
                        break;
                    }
                }
            }
        }
    }

    /// Posterior mean of a + b_e by record, as coefficients.
    fn mean_discrepancy(&self, normals: &[Normal], hyper: &Hyper) -> Vec<Vec<f64>> {
        let m = self.n_discrepancy();
        let [shared, own] = hyper.ln_discrepancy.map(|l| (-2.0 * l).exp());
        let gone: Vec<usize> = (0..m).collect();
        let n_component = self.forward.problem.array.components.len().max(1);
        let component = |at: &At| {
            let event = &self.forward.problem.events[self.forward.groups[at.group].records[at.record].event];
            event.component().min(n_component - 1)
        };
        let mut sums = vec![Mat::<f64>::zeros(m + 1, m + 1); n_component];
        for (normal, at) in normals.iter().zip(&self.forward.records) {
            if let Some((left, ..)) = self.without_own(normal, &gone, &vec![own; m]) {
                sums[component(at)] += left;
            }
        }
        let solved = |g: &Mat<f64>, precision: f64, right: &dyn Fn(usize) -> f64| -> Vec<f64> {
            let a = Mat::from_fn(m, m, |i, j| g[(i, j)] + if i == j { precision } else { 0.0 });
            let side = Mat::from_fn(m, 1, |i, _| right(i));
            a.llt(Side::Lower).map_or(vec![0.0; m], |f| {
                let x = f.solve(&side);
                (0..m).map(|i| x[(i, 0)]).collect()
            })
        };
        let a: Vec<Vec<f64>> = sums.iter().map(|g| solved(g, shared, &|i| g[(i, m)])).collect();
        let of = |(normal, at): (&Normal, &At)| {
            let a = &a[component(at)];
            let g = &normal.g;
            let rest = |i: usize| g[(i, m)] - (0..m).map(|j| g[(i, j)] * a[j]).sum::<f64>();
            let b = solved(g, own, &rest);
            a.iter().zip(&b).map(|(a, b)| a + b).collect()
        };
        normals.iter().zip(&self.forward.records).map(of).collect()
    }

    /// What the discrepancy with these coefficients adds to the outputs of a record.
    fn added(&self, index: usize, predicted: &Predicted, coefficients: &[f64]) -> Bins {
        let f = self.forward.frequencies_hz(self.forward.records[index]);
        let of = |s: usize| {
            let at = |(k, f): (usize, &f64)| {
                let (knot, w) = hat(*f, self.band_hz, self.n_knot);
                let own = |j: usize| {
                    let i = 2 * (s * self.n_knot + j.min(self.n_knot - 1));
                    C64::new(coefficients[i], coefficients[i + 1])
                };
                (own(knot) * (1.0 - w) + own(knot + 1) * w) * (predicted.outputs[s][k] - predicted.base[k])
            };
            f.iter().enumerate().map(at).collect()
        };
        (0..self.n_sensor()).map(of).collect()
    }

    /// One step of Fisher scoring of shares and noise levels, the discrepancy at its mean.
    fn tune_covariance(&self, prediction: &Prediction, discrepancy: &[Vec<f64>], hyper: &mut Hyper) {
        let n = self.n_sensor();
        let n_share = n * SHARE_KNOTS;
        let size = n_share + n + 1;
        let indices: Vec<usize> = (0..self.forward.records.len()).collect();
        let one = |i: &usize| self.score(*i, &prediction[*i], &discrepancy[*i], hyper, size);
        let parts: Vec<(Vec<f64>, Mat<f64>)> = indices.par_iter().map(one).collect();
        let (mut score, mut information) = (vec![0.0; size], Mat::<f64>::zeros(size, size));
        for (own, more) in parts {
            score.iter_mut().zip(own).for_each(|(a, b)| *a += b);
            information += more;
        }
        let mut x: Vec<f64> = hyper.ln_share.concat();
        x.extend(&hyper.ln_noise);
        for (i, x) in x.iter().enumerate() {
            let [mean, sd] = if i < n_share { [SHARE[0].ln(), SHARE[1]] } else { [0.0, self.noise_ln] };
            score[i] -= (x - mean) / (sd * sd);
            information[(i, i)] += 1.0 / (sd * sd);
        }
        let side = Mat::from_fn(size, 1, |i, _| score[i]);
        let Ok(factor) = information.llt(Side::Lower) else { return };
        let step = factor.solve(&side);
        let largest = (0..size).map(|i| step[(i, 0)].abs()).fold(1.5, f64::max);
        let held = 1.5 / largest;
        for (i, x) in x.iter_mut().enumerate() {
            *x += held * step[(i, 0)];
            if i < n_share {
                *x = x.clamp(-25.0, LARGEST_SHARE.ln());
            }
        }
        for s in 0..n {
            hyper.ln_share[s].copy_from_slice(&x[s * SHARE_KNOTS..(s + 1) * SHARE_KNOTS]);
        }
        hyper.ln_noise.copy_from_slice(&x[n_share..]);
    }

    fn score(
        &self,
        index: usize,
        predicted: &Predicted,
        coefficients: &[f64],
        hyper: &Hyper,
        size: usize,
    ) -> (Vec<f64>, Mat<f64>) {
        let at = self.forward.records[index];
        let added = self.added(index, predicted, coefficients);
        let record = self.prepared(at, predicted);
        let n = self.n_sensor();
        let n_share = n * SHARE_KNOTS;
        let mut score = vec![0.0; size];
        let mut information = Mat::<f64>::zeros(size, size);
        for (k, f) in self.forward.frequencies_hz(at).iter().enumerate() {
            let share = self.shares(hyper, *f);
            let sigma = self.covariance(index, &record, hyper, k, &share);
            let mean: Vec<C64> = (0..n).map(|s| predicted.outputs[s][k] + added[s][k]).collect();
            let c: Vec<f64> = share.iter().map(|v| (1.0 - v).sqrt()).collect();
            let residual: Vec<C64> = (0..n).map(|s| predicted.measured[s][k] - c[s] * mean[s]).collect();
            let w = sigma.solve(&residual);
            // Σ⁻¹ h, h = H √S_in: the one derivative of Σ that is not diagonal is h hᴴ.
            let h: Vec<C64> = (0..n).map(|s| sigma.b[s] * sigma.d[s].sqrt()).collect();
            let solved_h = sigma.solve(&h);
            let quadratic: f64 = h.iter().zip(&solved_h).map(|(h, x)| (h.conj() * x).re).sum();
            let inverse = |r: usize, c: usize| -> C64 {
                let own = if r == c { 1.0 / sigma.d[r] } else { 0.0 };
                own - sigma.b[r] * sigma.b[c].conj() / ((1.0 + sigma.g) * (sigma.d[r] * sigma.d[c]).sqrt())
            };
            // (index, sensor, dΣ_ss, dmean)
            let (knot, weight) = hat(*f, self.band_hz, SHARE_KNOTS);
            let mut diagonal: Vec<(usize, usize, f64, C64)> = Vec::with_capacity(3 * n);
            for s in 0..n {
                for (j, hat) in [(knot, 1.0 - weight), (knot + 1, weight)] {
                    if hat > 0.0 {
                        let mean = mean[s] * (-0.5 * share[s] / c[s] * hat);
                        diagonal.push((s * SHARE_KNOTS + j, s, hat * share[s] * record.power[s][k], mean));
                    }
                }
                let noise = self.noise[index][s + 1][k] * hyper.ln_noise[s + 1].exp();
                diagonal.push((n_share + 1 + s, s, noise, C64::default()));
            }
            for (a, (i, s, d, mean)) in diagonal.iter().enumerate() {
                score[*i] += d * (w[*s].norm_sqr() - inverse(*s, *s).re) + 2.0 * (mean.conj() * w[*s]).re;
                for (j, t, e, other) in &diagonal[..=a] {
                    let x = inverse(*s, *t);
                    let value = d * e * x.norm_sqr() + 2.0 * (mean.conj() * x * other).re;
                    information[(*i, *j)] += value;
                    if i != j {
                        information[(*j, *i)] += value;
                    }
                }
                let cross = d * solved_h[*s].norm_sqr();
                information[(*i, n_share)] += cross;
                information[(n_share, *i)] += cross;
            }
            let along: C64 = h.iter().zip(&w).map(|(h, w)| h.conj() * w).sum();
            score[n_share] += along.norm_sqr() - quadratic;
            information[(n_share, n_share)] += quadratic * quadratic;
        }
        (score, information)
    }

    /// Residuals beside the model in four parts of power, by record and sensor: recorded, repeatable discrepancy, that of the event
    /// alone, and all that is left.
    pub fn shares_of_power(&self, prediction: &Prediction, hyper: &Hyper) -> Vec<Vec<[f64; 4]>> {
        let normals = self.normals(prediction, &[], hyper);
        let whole = self.mean_discrepancy(&normals, hyper);
        let mut silent = hyper.clone();
        silent.ln_discrepancy[1] = -20.0;
        let shared = self.mean_discrepancy(&normals, &Hyper { ..silent });
        let power = |x: &[C64]| x.iter().map(C64::norm_sqr).sum::<f64>();
        let of = |i: usize| -> Vec<[f64; 4]> {
            let [both, shared] = [&whole, &shared].map(|c| self.added(i, &prediction[i], &c[i]));
            let one = |s: usize| {
                let own: Vec<C64> = both[s].iter().zip(&shared[s]).map(|(a, b)| a - b).collect();
                let p = &prediction[i];
                let rest = p.measured[s].iter().zip(&p.outputs[s]).zip(&both[s]).map(|((m, y), d)| m - y - d);
                [power(&p.measured[s]), power(&shared[s]), power(&own), power(&rest.collect::<Vec<_>>())]
            };
            (0..self.n_sensor()).map(one).collect()
        };
        (0..self.forward.records.len()).map(of).collect()
    }

    /// `hyper` as beside a model that lacks nothing: no more than the medians of their priors. What a candidate would explain must not
    /// be taken for discrepancy when candidates are compared.
    pub fn sharpened(hyper: &Hyper) -> Hyper {
        let least = |x: &f64, median: f64| x.min(median.ln());
        Hyper {
            ln_share: hyper.ln_share.iter().map(|s| s.iter().map(|x| least(x, SHARE[0])).collect()).collect(),
            ln_noise: hyper.ln_noise.clone(),
            ln_discrepancy: hyper.ln_discrepancy.map(|x| least(&x, DISCREPANCY[0])),
        }
    }

    /// Power of sensor noise over that of the records, mean over records and sensors.
    pub fn noise_share(&self, prediction: &Prediction, hyper: &Hyper) -> f64 {
        let mut sum = [0.0, 0.0];
        for (i, predicted) in prediction.iter().enumerate() {
            let record = self.prepared(self.forward.records[i], predicted);
            for s in 0..self.n_sensor() {
                let [own, base] = [hyper.ln_noise[s + 1].exp(), hyper.ln_noise[0].exp()];
                let bins = 0..predicted.base.len();
                let of = |k: usize| {
                    own * self.noise[i][s + 1][k] + base * self.noise[i][0][k] * record.gain[s][k].norm_sqr()
                };
                let recorded: f64 = predicted.measured[s].iter().map(C64::norm_sqr).sum();
                sum[0] += bins.map(of).sum::<f64>() / recorded.max(f64::MIN_POSITIVE);
                sum[1] += 1.0;
            }
        }
        sum[0] / f64::max(sum[1], 1.0)
    }
}
