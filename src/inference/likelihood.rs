//! The likelihood of records given a prediction: a field that is partly coherent, noisy sensors, and a column that is never exact.

use super::covariance::Covariance;
use super::discrepancy::{Discrepancy, Levels, Mean, Normal, Shared, hat, strengths};
use super::forward::{At, Bins, Forward, Predicted, Prediction};
use crate::diagnosis::spectra;
use crate::numerics::smooth::running_mean;
use faer::linalg::solvers::Solve;
use faer::{Mat, MatMut, Side};
use rayon::prelude::*;
use realfft::num_complex::Complex;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Knots of the incoherent share, between the ends of the band at equal ratios.
const SHARE_KNOTS: usize = 7;
/// Prior of the incoherent share 1 − c²: median, and standard deviation of its ln.
const SHARE: [f64; 2] = [1e-3, 2.0];
/// Largest incoherent share: something follows the column.
const LARGEST_SHARE: f64 = 0.995;
/// Standard deviation of the ln of a noise level that records told before their event, and of one that is only bounded.
const NOISE_LN: [f64; 2] = [0.15, 1.0];
/// Noise of a sensor where nothing tells it, as a share of the RMS of its record within the band.
const USUAL_NOISE: f64 = 0.01;
/// Smallest power of noise, as a share of the largest of a record.
const FLOOR: f64 = 1e-12;
/// Largest excess of one bin's power over what is expected that counts in slopes of the variance: one in 400 bins has more.
const OUTLYING: f64 = 5.0;
/// What the likelihood knows beside the prediction.
#[derive(Debug, Clone)]
pub struct Hyper {
    /// ln(1 − c²) of each output sensor at the knots.
    pub ln_share: Vec<Vec<f64>>,
    /// ln of the factor on the noise of each sensor, the input sensor first.
    pub ln_noise: Vec<f64>,
    /// Levels of the discrepancy.
    pub levels: Levels,
}

/// How a prediction changes with one coordinate, by record.
pub type Slope = Arc<Vec<Bins>>;

/// Normal equations of all records, the discrepancy marginalised.
pub struct Reduced {
    /// Information on the coordinates, and in its last row and column the right-hand side.
    pub g: Mat<f64>,
    /// −ln of the marginal likelihood where nothing is moved, priors of hyperparameters included.
    pub nll: f64,
}

impl Reduced {
    /// Those of records that say `design_effect` times less.
    pub fn thinned(&self, design_effect: f64) -> Self {
        Self { g: faer::Scale(1.0 / design_effect) * &self.g, nll: self.nll / design_effect }
    }
}

/// Records of a problem with what their likelihood needs.
///
/// ```text
/// Y | U ~ CN( C (Ŷ + δ (Ŷ − U)),  Σ ),   Σ = (I − C²) ⟨|Ŷ|²⟩ + S_out + H S_in Hᴴ                   (1)
/// −ln L = Σ_bins rᴴ Σ⁻¹ r + ln det Σ                                                              (2)
/// ```
///
/// Ŷ is the prediction, C the coherence of each sensor by a few knots over ln f, the same in all events. δ is what the column itself
/// has wrong ([`Discrepancy`]): a complex share of what it **adds to its base motion**, so that it vanishes below the first resonance,
/// where every column passes the motion as it is. It is marginalised, its levels estimated. The incoherent part goes with the power
/// that is predicted, so a prediction cannot gain by shrinking. H is the ratio of predicted spectra to the base's, smoothed.
///
/// Limits: what is incoherent is independent between sensors and bins; in derivatives H and the information on δ stand still.
/// Check:  `slopes_are_those_of_the_likelihood`, `damping_of_a_partly_coherent_field_is_found`.
/// Source: Pintelon and Schoukens (2012), System Identification, for H S_in Hᴴ.
pub struct Likelihood<'a> {
    forward: &'a Forward<'a>,
    band_hz: [f64; 2],
    discrepancy: Discrepancy,
    /// Strength of the motion of each record, [`strengths`].
    strengths: Vec<f64>,
    /// What other conventions of the column add, see [`Discrepancy`].
    conventions: Vec<Slope>,
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

/// Noise of a channel that no stretch of its record shows: white, a share of the RMS within the band, and no more than the least that
/// the band itself holds; never read off a band that processing may have emptied.
fn guessed(bins: &[C64]) -> Vec<f64> {
    let power: Vec<f64> = bins.iter().map(C64::norm_sqr).collect();
    let mean = power.iter().sum::<f64>() / power.len().max(1) as f64;
    let least = running_mean(&power, 3).into_iter().fold(f64::INFINITY, f64::min);
    vec![(USUAL_NOISE * USUAL_NOISE * mean).min(least).max(f64::MIN_POSITIVE); bins.len()]
}

fn at_knots(values: &[f64], (i, w): (usize, f64)) -> f64 {
    values[i] * (1.0 - w) + values.get(i + 1).copied().unwrap_or_default() * w
}

/// One bin of one record, and what moves it.
struct Bin<'b> {
    predicted: &'b Predicted,
    slopes: &'b [&'b Slope],
    /// Slopes of the smoothed power, `[coordinate][sensor][bin]`.
    powers: &'b [Vec<Vec<f64>>],
    index: usize,
    k: usize,
    /// Incoherent share of each sensor.
    share: &'b [f64],
}

impl Bin<'_> {
    /// Fills the rows of the bin: the two knots around it, `weight` that of the upper one, coordinates, residual. Gives its −ln L.
    fn rows(&self, sigma: &Covariance, weight: f64, mut rows: MatMut<'_, f64>) -> f64 {
        let Self { predicted, k, share, .. } = *self;
        let (n, n_x) = (share.len(), self.slopes.len());
        let (hats, last) = ([1.0 - weight, weight], 4 * n + n_x);
        let c: Vec<f64> = share.iter().map(|v| (1.0 - v).sqrt()).collect();
        let residual: Vec<C64> = (0..n).map(|s| predicted.measured[s][k] - c[s] * predicted.outputs[s][k]).collect();
        let solved = sigma.solve(&residual);
        let mut moved = vec![C64::default(); n];
        let put = |rows: &mut MatMut<'_, f64>, column: usize, values: &mut [C64]| {
            sigma.whiten(values);
            for (s, v) in values.iter().enumerate() {
                rows[(2 * s, column)] = v.re * std::f64::consts::SQRT_2;
                rows[(2 * s + 1, column)] = v.im * std::f64::consts::SQRT_2;
            }
        };
        for (i, slope) in self.slopes.iter().enumerate() {
            (0..n).for_each(|s| moved[s] = slope[self.index][s][k] * c[s]);
            put(&mut rows, 4 * n + i, &mut moved);
        }
        for s in 0..n {
            let added = predicted.outputs[s][k] - predicted.base[k];
            let own = predicted.outputs[s][k].conj() * added;
            let inverse = sigma.inverse(s, s).re;
            for (j, w) in hats.into_iter().enumerate() {
                let column = 4 * s + 2 * j;
                for (part, unit) in [C64::new(1.0, 0.0), C64::new(0.0, 1.0)].into_iter().enumerate() {
                    moved.fill(C64::default());
                    moved[s] = added * (c[s] * w) * unit;
                    put(&mut rows, column + part, &mut moved);
                }
                rows[(2 * n + s, column)] = share[s] * inverse * 2.0 * w * own.re;
                rows[(2 * n + s, column + 1)] = -share[s] * inverse * 2.0 * w * own.im;
            }
            for (i, power) in self.powers.iter().enumerate() {
                rows[(2 * n + s, 4 * n + i)] = share[s] * power[s][k] * inverse;
            }
            rows[(2 * n + s, last)] = (solved[s].norm_sqr() / inverse - 1.0).min(OUTLYING);
        }
        moved.copy_from_slice(&residual);
        put(&mut rows, last, &mut moved);
        residual.iter().zip(&solved).map(|(r, w)| (r.conj() * w).re).sum::<f64>() + sigma.ln_determinant()
    }
}

impl<'a> Likelihood<'a> {
    /// Prepares the records of `forward`.
    pub fn new(forward: &'a Forward<'a>, conventions: Vec<Slope>) -> Self {
        let is_noise_known = forward.problem.events.iter().all(|e| e.noise.iter().all(|n| n.is_measured));
        let ends =
            |g: &crate::diagnosis::spectra::Group| [g.frequencies_hz[0], *g.frequencies_hz.last().unwrap_or(&1.0)];
        let band_hz = forward
            .groups
            .iter()
            .map(ends)
            .fold([f64::INFINITY, 0.0f64], |[a, b], [low, high]| [a.min(low), b.max(high)]);
        let least = Levels::least(forward.problem.tolerances.model);
        let noise = |at: &At| {
            let record = &forward.groups[at.group].records[at.record];
            let known = forward.problem.events[record.event].noise.iter();
            let pairs = known.zip(&record.noise).zip(&record.channels);
            pairs.map(|((n, own), bins)| if n.is_measured { own.clone() } else { guessed(bins) }).collect()
        };
        Self {
            discrepancy: Discrepancy::new(band_hz, forward.problem.array.outputs.len(), conventions.len(), least),
            strengths: strengths(&forward.peaks_m_s2()),
            conventions,
            noise: forward.records.iter().map(noise).collect(),
            noise_ln: NOISE_LN[usize::from(!is_noise_known)],
            forward,
            band_hz,
        }
    }

    fn n_sensor(&self) -> usize {
        self.forward.problem.array.outputs.len()
    }

    /// Hyperparameters at the medians of their priors.
    pub fn start(&self) -> Hyper {
        Hyper {
            ln_share: vec![vec![SHARE[0].ln(); SHARE_KNOTS]; self.n_sensor()],
            ln_noise: vec![0.0; self.n_sensor() + 1],
            levels: self.discrepancy.usual(),
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
        shares + noise + self.discrepancy.cost(hyper.levels)
    }

    fn half(&self, at: At) -> usize {
        spectra::smoothing_bins(self.forward.frequencies_hz(at))
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
        Covariance::new(d, record.gain.iter().map(|h| h[k]), s_in)
    }

    fn shares(&self, hyper: &Hyper, frequency_hz: f64) -> Vec<f64> {
        let at = hat(frequency_hz, self.band_hz, SHARE_KNOTS);
        hyper.ln_share.iter().map(|v| at_knots(v, at).exp().min(LARGEST_SHARE)).collect()
    }

    /// Normal equations of record `index`, H of (1) as it is at the prediction `beside`: the discrepancy, then coordinates.
    ///
    /// Rows are Σ^{−1/2} of what moves the mean, real and imaginary parts, and one more for what moves the variance of each bin. Between
    /// two knots few coefficients of the discrepancy act.
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
        // Slopes of the smoothed power, by coordinate.
        let slopes: Vec<&Slope> = self.conventions.iter().chain(slopes).collect();
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
        let f = self.forward.frequencies_hz(at);
        let n = self.n_sensor();
        // Coefficients of conventions follow those of the hats.
        let (n_x, n_hat) = (slopes.len(), self.discrepancy.len() - self.conventions.len());
        let mut g = Mat::<f64>::zeros(n_hat + n_x + 1, n_hat + n_x + 1);
        let mut nll = 0.0;
        let mut first = 0;
        while first < f.len() {
            let knot = self.discrepancy.knot(f[first]).0;
            let count = f[first..].iter().take_while(|f| self.discrepancy.knot(**f).0 == knot).count();
            let mut rows = Mat::<f64>::zeros(3 * n * count, 4 * n + n_x + 1);
            for (k, f_hz) in f.iter().enumerate().skip(first).take(count) {
                let share = self.shares(hyper, *f_hz);
                let sigma = self.covariance(index, &record, hyper, k, &share);
                let bin = Bin { predicted, slopes: &slopes, powers: &powers, index, k, share: &share };
                let block = rows.subrows_mut(3 * n * (k - first), 3 * n);
                nll += bin.rows(&sigma, self.discrepancy.knot(*f_hz).1, block);
            }
            let local = rows.transpose() * &rows;
            let place = |i: usize| match i.checked_sub(4 * n) {
                Some(beside) => n_hat + beside,
                None => self.discrepancy.index(i / 4, knot + (i / 2) % 2) + i % 2,
            };
            let places: Vec<usize> = (0..local.nrows()).map(place).collect();
            for (j, to) in places.iter().enumerate() {
                for (i, from) in places.iter().enumerate() {
                    g[(*from, *to)] += local[(i, j)];
                }
            }
            first += count;
        }
        self.discrepancy.normal(g, nll, self.strengths[index])
    }

    fn normals(&self, prediction: &Prediction, slopes: &[Slope], hyper: &Hyper) -> Vec<Normal> {
        let indices: Vec<usize> = (0..self.forward.records.len()).collect();
        indices.par_iter().map(|i| self.normal(*i, (&prediction[*i], &prediction[*i]), slopes, hyper)).collect()
    }

    fn reduced(&self, normals: &[Normal], hyper: &Hyper) -> Option<Reduced> {
        let shared = self.discrepancy.summed(normals, hyper.levels)?;
        let Shared { g, nll } = self.discrepancy.without_shared(&shared, hyper.levels)?;
        Some(Reduced { g, nll: nll + self.prior(hyper) }).filter(|r| r.nll.is_finite())
    }

    /// Normal equations at `prediction`, the discrepancy marginalised; `None` where numbers are out of range.
    pub fn at(&self, prediction: &Prediction, slopes: &[Slope], hyper: &Hyper) -> Option<Reduced> {
        self.reduced(&self.normals(prediction, slopes, hyper), hyper)
    }

    /// Score of each event in the coordinates, the discrepancy marginalised.
    pub fn scores(&self, prediction: &Prediction, slopes: &[Slope], hyper: &Hyper) -> Option<Vec<Vec<f64>>> {
        let normals = self.normals(prediction, slopes, hyper);
        let own = |normal: &Normal| self.discrepancy.without_own(normal, hyper.levels);
        let parts: Vec<Shared> = normals.par_iter().map(own).collect::<Option<_>>()?;
        let groups: Vec<usize> = self.forward.records.iter().map(|at| at.group).collect();
        self.discrepancy.scores(&parts, &groups, hyper.levels)
    }

    /// [`Self::at`] without each event in turn, those of which nothing is left out of the band apart.
    pub fn without_each_event(&self, prediction: &Prediction, slopes: &[Slope], hyper: &Hyper) -> Vec<Reduced> {
        let normals = self.normals(prediction, slopes, hyper);
        let own = |normal: &Normal| self.discrepancy.without_own(normal, hyper.levels);
        let Some(parts) = normals.iter().map(own).collect::<Option<Vec<Shared>>>() else { return Vec::new() };
        let of = |event: usize| {
            let kept = parts.iter().zip(&self.forward.records).filter(|(_, at)| at.group != event).map(|(p, _)| p);
            let zero = Shared { g: Mat::zeros(parts[0].g.nrows(), parts[0].g.ncols()), nll: self.prior(hyper) };
            let sum = kept.fold(zero, |sum, p| Shared { g: sum.g + &p.g, nll: sum.nll + p.nll });
            let Shared { g, nll } = self.discrepancy.without_shared(&sum, hyper.levels)?;
            Some(Reduced { g, nll })
        };
        (0..self.forward.groups.len()).filter_map(of).collect()
    }

    /// −ln of the marginal likelihood and of the priors of hyperparameters; infinite where numbers are out of range.
    pub fn nll(&self, prediction: &Prediction, hyper: &Hyper) -> f64 {
        self.nll_beside(prediction, prediction, hyper)
    }

    /// The same with H of (1) as it is at another prediction, `beside`: what slopes there expect of a step.
    pub fn nll_beside(&self, prediction: &Prediction, beside: &Prediction, hyper: &Hyper) -> f64 {
        let indices: Vec<usize> = (0..self.forward.records.len()).collect();
        let one = |i: &usize| self.normal(*i, (&prediction[*i], &beside[*i]), &[], hyper);
        let normals: Vec<Normal> = indices.par_iter().map(one).collect();
        self.reduced(&normals, hyper).map_or(f64::INFINITY, |r| r.nll)
    }

    /// Moves `hyper` towards its best values at `prediction`: levels of the discrepancy, then shares and noise given its mean.
    pub fn tuned(&self, prediction: &Prediction, hyper: &Hyper, rounds: usize) -> Hyper {
        self.moved(prediction, hyper, rounds, false)
    }

    /// The same where `hyper` was best a step of a fit before.
    pub fn followed(&self, prediction: &Prediction, hyper: &Hyper) -> Hyper {
        self.moved(prediction, hyper, 1, true)
    }

    fn moved(&self, prediction: &Prediction, hyper: &Hyper, rounds: usize, is_near: bool) -> Hyper {
        let mut hyper = hyper.clone();
        for _ in 0..rounds {
            // What strays from bin to bin first: a smooth discrepancy must not stand in for it.
            let normals = self.normals(prediction, &[], &hyper);
            let Some(mean) = self.discrepancy.mean(&normals, hyper.levels) else { break };
            self.tune_covariance(prediction, &mean.whole, &mut hyper);
        }
        let normals = self.normals(prediction, &[], &hyper);
        hyper.levels = self.discrepancy.tuned(&normals, hyper.levels, is_near);
        hyper
    }

    /// What the discrepancy with these coefficients adds to the outputs of a record.
    fn added(&self, index: usize, predicted: &Predicted, coefficients: &[f64]) -> Bins {
        let f = self.forward.frequencies_hz(self.forward.records[index]);
        let of = |s: usize| {
            let at = |(k, f): (usize, &f64)| {
                let (knot, w) = self.discrepancy.knot(*f);
                let own = |j: usize| {
                    let i = self.discrepancy.index(s, j);
                    C64::new(coefficients[i], coefficients[i + 1])
                };
                (own(knot) * (1.0 - w) + own(knot + 1) * w) * (predicted.outputs[s][k] - predicted.base[k])
            };
            let mut bins: Vec<C64> = f.iter().enumerate().map(at).collect();
            let first = self.discrepancy.len() - self.conventions.len();
            for (convention, share) in self.conventions.iter().zip(&coefficients[first..]) {
                bins.iter_mut().zip(&convention[index][s]).for_each(|(b, c)| *b += c * *share);
            }
            bins
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
            // The one derivative of Σ that is not diagonal is h hᴴ.
            let h = sigma.base();
            let solved_h = sigma.solve(&h);
            let quadratic: f64 = h.iter().zip(&solved_h).map(|(h, x)| (h.conj() * x).re).sum();
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
                score[*i] += d * (w[*s].norm_sqr() - sigma.inverse(*s, *s).re) + 2.0 * (mean.conj() * w[*s]).re;
                for (j, t, e, other) in &diagonal[..=a] {
                    let x = sigma.inverse(*s, *t);
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
        let n = self.forward.records.len();
        let zero = || vec![0.0; self.discrepancy.len()];
        let nothing = || Mean { shared: zero(), repeatable: vec![zero(); n], whole: vec![zero(); n] };
        let mean = self.discrepancy.mean(&normals, hyper.levels).unwrap_or_else(nothing);
        let power = |x: &[C64]| x.iter().map(C64::norm_sqr).sum::<f64>();
        let of = |i: usize| -> Vec<[f64; 4]> {
            let [both, shared] = [&mean.whole[i], &mean.repeatable[i]].map(|c| self.added(i, &prediction[i], c));
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

    /// What all records share of the discrepancy of sensor `s`: frequency of its knots in Hz, real and imaginary part.
    pub fn shared_discrepancy(&self, prediction: &Prediction, hyper: &Hyper) -> Vec<Vec<[f64; 3]>> {
        let normals = self.normals(prediction, &[], hyper);
        let Some(mean) = self.discrepancy.mean(&normals, hyper.levels) else { return Vec::new() };
        (0..self.n_sensor()).map(|s| self.discrepancy.at_knots(s, &mean.shared)).collect()
    }

    /// `hyper` as beside a model that lacks nothing: no more than the medians of their priors. What a candidate would explain must not
    /// be taken for discrepancy when candidates are compared.
    pub fn sharpened(&self, hyper: &Hyper) -> Hyper {
        let least = |x: &f64, median: f64| x.min(median.ln());
        Hyper {
            ln_share: hyper.ln_share.iter().map(|s| s.iter().map(|x| least(x, SHARE[0])).collect()).collect(),
            ln_noise: hyper.ln_noise.clone(),
            levels: hyper.levels.sharpened(self.discrepancy.usual()),
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
