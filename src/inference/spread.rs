//! What is expected of residuals, read off the records beside one prediction: how far the field follows its base, what strays, and what
//! the column has wrong.

use super::algebra;
use super::forward::{At, Bins, Forward, Predicted, Prediction, channels};
use crate::diagnosis::spectra::{self, RecordSpectra};
use crate::diagnosis::{NoiseSource, USUAL_SHARE};
use crate::numerics::smooth::running_mean;
use faer::Mat;
use rayon::prelude::*;
use realfft::num_complex::Complex;
use std::ops::Range;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Bands to an octave over which moments are taken.
pub(super) const AN_OCTAVE: f64 = 6.0;
/// Least bins of a band.
const LEAST_BINS: usize = 3;
/// Knots of the coherence, between the ends of the frequency band at equal ratios.
const KNOTS: usize = 7;
/// Bins to either side over which the transfer function of the column is taken.
const RESOLUTION: usize = 1;
/// Values of the column's error that the declared one counts for when its level is estimated.
const PRIOR_VALUES: f64 = 10.0;
/// Steps towards the level of that error.
const LEVEL_STEPS: usize = 20;
/// Fewest independent bins of a band that tell of its coherence.
const LEAST_INDEPENDENT: f64 = 2.0;
/// How far below one a squared coherence is expected at most: the deviation of a half-normal prior.
const INCOHERENCE: f64 = 0.5;
/// How far apart the squared coherences of neighbouring knots are expected: the deviation of a normal prior.
const ROUGHNESS: f64 = 0.25;
/// How far a band may be off the line between knots, in squared coherence.
const UNEVEN: f64 = 0.05;
/// Steps towards the coherence.
const COHERENCE_STEPS: usize = 5;
/// Smallest coherence that is still told from none.
const LEAST_COHERENCE: f64 = 0.05;
/// Least error of a column.
const LEAST_ERROR: f64 = 1e-4;
/// Smallest power, as a share of the largest of a record.
const FLOOR: f64 = 1e-12;

/// What the records say of the field and of the column's error, beside one prediction of them.
#[derive(Debug, Clone)]
pub struct Spread {
    /// Error of the column over the declared one, at least 1: what is not the same in all records is not in it.
    pub level: f64,
    /// Coherence of each output sensor with its prediction at the knots.
    pub coherence: Vec<Vec<f64>>,
    /// Share of the power of each output sensor that strays, at the knots.
    pub(super) straying: Vec<Vec<f64>>,
    /// Share of that which is of another origin.
    pub(super) added_share: f64,
    /// What all records share of the residual of each output sensor, by frequency.
    pub repeatable: Vec<Vec<Shared>>,
    /// Power of what elements and steps leave wrong of the motion of each output sensor, `[record][sensor][bin]`.
    pub(super) numerical: Powers,
    /// Expected power of each record, its noise included, and of what it has beside the base, by what the other events make of the
    /// prediction: `[record][sensor][bin]`.
    pub(super) expected: [Powers; 2],
    /// The channels for which that holds.
    pub(super) channels: Vec<usize>,
}

/// What all records share of a residual at one frequency.
#[derive(Debug, Clone, Copy)]
pub struct Shared {
    /// Frequency, Hz.
    f_hz: f64,
    /// As a share of what the column adds.
    delta: C64,
    /// Its expected |δ|² where nothing is shared.
    chance: f64,
}

/// One bin of one sensor of one record, as moments are taken over it.
struct Bin {
    band: usize,
    f_hz: f64,
    /// One over the power of the record.
    weight: f64,
    recorded: C64,
    predicted: C64,
    base: C64,
    /// Power of the sensor's noise, and of that of the input sensor as the column passes it on with what elements and steps leave wrong.
    noise: f64,
    predicted_noise: f64,
    added_share: f64,
    /// Share of the record over which the motion lasts.
    lasting: f64,
}

pub(super) fn powers(x: &[C64]) -> Vec<f64> {
    x.iter().map(C64::norm_sqr).collect()
}

/// Bands of equal ratio, as ranges of bins.
pub(super) fn bands(frequencies_hz: &[f64]) -> Vec<Range<usize>> {
    let mut all = Vec::new();
    let mut first = 0;
    while first < frequencies_hz.len() {
        let end_hz = frequencies_hz[first] * (1.0 / AN_OCTAVE).exp2();
        let end = frequencies_hz.partition_point(|f| *f < end_hz).max(first + LEAST_BINS);
        // What is left is no band of its own.
        let end = if end + LEAST_BINS > frequencies_hz.len() { frequencies_hz.len() } else { end };
        all.push(first..end);
        first = end;
    }
    all
}

/// Sums over the bins of a band in all records, each weighted by the power of its record.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    f_hz: f64,
    /// Σ |Y|² and Σ |Ŷ|², and what noise makes of them.
    recorded: f64,
    predicted: f64,
    noise: [f64; 2],
    /// Σ Y Ŷ*.
    cross: C64,
    /// Number of independent bins.
    n: f64,
}

impl Moments {
    fn add(&mut self, bin: &Bin) {
        self.recorded += bin.weight * bin.recorded.norm_sqr();
        self.predicted += bin.weight * bin.predicted.norm_sqr();
        self.noise[0] += bin.weight * bin.noise;
        self.noise[1] += bin.weight * bin.predicted_noise;
        self.cross += bin.recorded * bin.predicted.conj() * bin.weight;
        self.n += bin.lasting;
    }

    /// Power of noise over that of the motion, recorded and predicted together; none where nothing is left beside noise.
    fn noise_ratio(&self) -> Option<f64> {
        let [recorded, predicted] = [self.recorded - self.noise[0], self.predicted - self.noise[1]];
        let has_motion = recorded > FLOOR && predicted > FLOOR;
        has_motion.then(|| self.recorded * self.predicted / (recorded * predicted) - 1.0)
    }

    /// Squared coherence of the motion; none where too few bins tell. Chance takes it beyond one, too.
    fn squared_coherence(&self) -> Option<f64> {
        let gamma = self.cross.norm_sqr() / (self.recorded * self.predicted).max(FLOOR);
        let less_chance = (gamma - 1.0 / self.n) / (1.0 - 1.0 / self.n);
        (self.n >= LEAST_INDEPENDENT).then_some((1.0 + self.noise_ratio()?) * less_chance)
    }
}

/// Share of the power that strays, at the knots.
fn straying_at_knots(moments: &[Moments], ends_hz: [f64; 2]) -> Vec<f64> {
    let mut shares = [[0.0, f64::MIN_POSITIVE]; KNOTS];
    for m in moments {
        let Some(square) = m.squared_coherence() else { continue };
        let (i, w) = hat(m.f_hz, ends_hz);
        let motion = m.recorded - m.noise[0];
        for (j, w) in [(i, 1.0 - w), (i + 1, w)] {
            shares[j][0] += w * motion * (1.0 - square.clamp(0.0, 1.0));
            shares[j][1] += w * motion;
        }
    }
    shares.iter().map(|[strays, all]| strays / all).collect()
}

/// Coherence at the knots: squared, it is the line through that of the bands that is as smooth as [`ROUGHNESS`] says and no further below
/// one than [`INCOHERENCE`] says, as far as bands tell.
///
/// ```text
/// C²  = (1 + ν) (γ² − 1/n)/(1 − 1/n),   γ² = |Σ Y Ŷ*|² / (Σ |Ŷ|² Σ |Y|²)
/// var = (1 + ν)² (1 − g)² (2 g + 1/n)/n + (C² ν)² + 0.05²,   g = C²/(1 + ν)
/// ```
///
/// Sums are over the bins of a band in all records, each weighted by the power of its record; n of them are independent. ν is the ratio
/// of noise to motion, known no better than to a factor of two: where noise prevails a band tells nothing, and the line goes on as it came.
/// The variance is taken at the line and not at each band, where what chance raised would count for more.
///
/// Source: Bendat and Piersol (2010), Random Data, for the variance of γ².
fn coherence_at_knots(moments: &[Moments], ends_hz: [f64; 2]) -> Vec<f64> {
    let told = |m: &Moments| Some((hat(m.f_hz, ends_hz), m.n, m.noise_ratio()?, m.squared_coherence()?));
    let told: Vec<((usize, f64), f64, f64, f64)> = moments.iter().filter_map(told).collect();
    let mut square = vec![1.0; KNOTS];
    for _ in 0..COHERENCE_STEPS {
        let mut a = Mat::<f64>::from_fn(KNOTS, KNOTS, |i, j| if i == j { INCOHERENCE.powi(-2) } else { 0.0 });
        let mut b = vec![INCOHERENCE.powi(-2); KNOTS];
        for i in 1..KNOTS {
            let stiffness = ROUGHNESS.powi(-2);
            a[(i, i)] += stiffness;
            a[(i - 1, i - 1)] += stiffness;
            a[(i, i - 1)] -= stiffness;
            a[(i - 1, i)] -= stiffness;
        }
        for ((i, w), n, ratio, value) in &told {
            let line = square[*i] * (1.0 - w) + square[i + 1] * w;
            let g = (line / (1.0 + ratio)).min(1.0);
            let of_chance = ((1.0 + ratio) * (1.0 - g)).powi(2) * (2.0 * g + 1.0 / n) / n;
            let weight = 1.0 / (of_chance + (line * ratio).powi(2) + UNEVEN * UNEVEN);
            for (j, u) in [(*i, 1.0 - w), (i + 1, *w)] {
                b[j] += weight * u * value;
                for (k, v) in [(*i, 1.0 - w), (i + 1, *w)] {
                    a[(j, k)] += weight * u * v;
                }
            }
        }
        let Some(solved) = algebra::solved(&a, &b) else { break };
        square = solved.into_iter().map(|q| q.clamp(LEAST_COHERENCE.powi(2), 1.0)).collect();
    }
    square.into_iter().map(f64::sqrt).collect()
}

/// Hat functions over ln f with [`KNOTS`] knots: the knot below and the share of the one above.
fn hat(frequency_hz: f64, [low, high]: [f64; 2]) -> (usize, f64) {
    let x = (frequency_hz / low).ln() / (high / low).ln() * (KNOTS - 1) as f64;
    let x = x.clamp(0.0, (KNOTS - 1) as f64);
    let i = (x.floor() as usize).min(KNOTS - 2);
    (i, x - i as f64)
}

/// Value at a frequency of what is given at the knots, linear over ln f.
pub(super) fn interpolated(knots: &[f64], frequency_hz: f64, ends_hz: [f64; 2]) -> f64 {
    let (i, w) = hat(frequency_hz, ends_hz);
    knots[i] * (1.0 - w) + knots[i + 1] * w
}

/// Share of the prediction that the mean motion is where the coherence is `c` and a share `added` of what strays is of another origin.
pub(super) fn coherent(c: f64, added: f64) -> f64 {
    c / (1.0 - added * (1.0 - c * c)).sqrt()
}

/// Declared error of the column, a share of what it adds to its base.
pub(super) fn model_error(forward: &Forward<'_>) -> f64 {
    forward.problem.tolerances.model.max(LEAST_ERROR)
}

/// The band that all records share, Hz.
pub fn band_hz(forward: &Forward<'_>) -> [f64; 2] {
    forward.groups.iter().fold([f64::INFINITY, 0.0f64], |[low, high], g| {
        [low.min(g.frequencies_hz[0]), high.max(*g.frequencies_hz.last().unwrap_or(&1.0))]
    })
}

/// Frequencies as far apart as the shortest record tells them, over the band that all records share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Places {
    low_hz: f64,
    pub step_hz: f64,
    pub count: usize,
}

impl Places {
    pub fn of(forward: &Forward<'_>) -> Self {
        let [low_hz, high_hz] = band_hz(forward);
        let step_hz = forward.groups.iter().map(|g| g.frequencies_hz[1] - g.frequencies_hz[0]).fold(0.0, f64::max);
        Self { low_hz, step_hz, count: ((high_hz - low_hz) / step_hz) as usize + 1 }
    }

    /// The place of a frequency.
    pub fn at(&self, frequency_hz: f64) -> usize {
        (((frequency_hz - self.low_hz) / self.step_hz) as usize).min(self.count - 1)
    }

    /// Its middle, Hz.
    pub fn middle_hz(&self, place: usize) -> f64 {
        self.low_hz + (place as f64 + 0.5) * self.step_hz
    }
}

/// The spectra of a record.
pub(super) fn seen<'f>(forward: &'f Forward<'_>, at: At) -> &'f RecordSpectra {
    &forward.groups[at.group].records[at.record]
}

/// One value for each bin, `[record][sensor][bin]`.
type Powers = Arc<Vec<Vec<Vec<f64>>>>;

/// Expected |noise|² of each bin of a channel: what the record shows of it before its event; or white, a share of the RMS within the
/// band and nowhere more than what was recorded there, for processing may have emptied part of the band.
pub(super) fn noise(forward: &Forward<'_>, at: At, channel: usize) -> Vec<f64> {
    let record = seen(forward, at);
    if forward.problem.events[record.event].noise[channel].source != NoiseSource::Usual {
        return record.noise[channel].clone();
    }
    let power = powers(&record.channels[channel]);
    let white = USUAL_SHARE * USUAL_SHARE * power.iter().sum::<f64>() / power.len().max(1) as f64;
    let half = spectra::smoothing_bins(forward.frequencies_hz(at));
    running_mean(&power, half).into_iter().map(|recorded| white.min(recorded).max(f64::MIN_POSITIVE)).collect()
}

/// Power of what elements and steps leave wrong, `[record][sensor][bin]`: the difference of the replays at the anchor.
fn numerical_powers(forward: &Forward<'_>) -> Vec<Vec<Vec<f64>>> {
    let error = forward.numerical_error();
    let n_sensor = forward.problem.array.outputs.len();
    let of = |(i, at): (usize, &At)| -> Vec<Vec<f64>> {
        let f = forward.frequencies_hz(*at);
        let half = spectra::smoothing_bins(f);
        let sensor = |s: usize| match &error {
            Some(error) => running_mean(&powers(&error[i][s]), half),
            None => vec![0.0; f.len()],
        };
        (0..n_sensor).map(sensor).collect()
    };
    forward.records.iter().enumerate().map(of).collect()
}

/// Power of `x` less so many times the base, smoothed.
fn beside_base(forward: &Forward<'_>, at: At, x: &[C64], predicted: &Predicted, base: f64) -> Vec<f64> {
    let power: Vec<f64> = x.iter().zip(&predicted.base).map(|(x, u)| (x - base * u).norm_sqr()).collect();
    running_mean(&power, spectra::smoothing_bins(forward.frequencies_hz(at)))
}

/// Expected power of each record less so many times its base: that of its prediction, times what the other events have over theirs at the
/// same frequency. What strays in a record itself must not tell how much counts there, or it would count least where it adds to the
/// prediction.
fn expected_powers(forward: &Forward<'_>, prediction: &Prediction, base: f64) -> Vec<Vec<Vec<f64>>> {
    let places = Places::of(forward);
    let of_sensor = |s: usize| -> Vec<Vec<f64>> {
        let both =
            |(at, p): (&At, &Predicted)| [&p.measured[s], &p.outputs[s]].map(|x| beside_base(forward, *at, x, p, base));
        let both: Vec<[Vec<f64>; 2]> = forward.records.iter().zip(prediction).map(both).collect();
        // Recorded and predicted power by event and place.
        let mut events = vec![vec![[0.0; 2]; places.count]; forward.groups.len()];
        for (at, [recorded, predicted]) in forward.records.iter().zip(&both) {
            let total: f64 = recorded.iter().sum::<f64>().max(f64::MIN_POSITIVE);
            for (k, f) in forward.frequencies_hz(*at).iter().enumerate() {
                let sums = &mut events[at.group][places.at(*f)];
                sums[0] += recorded[k] / total;
                sums[1] += predicted[k] / total;
            }
        }
        let add = |a: [f64; 2], b: [f64; 2]| [a[0] + b[0], a[1] + b[1]];
        let others = |group: usize| -> Vec<[f64; 2]> {
            let others = || events.iter().enumerate().filter(|(g, _)| *g != group);
            (0..places.count).map(|place| others().map(|(_, e)| e[place]).fold([0.0; 2], add)).collect()
        };
        let others: Vec<Vec<[f64; 2]>> = (0..events.len()).map(others).collect();
        let of = |(at, [recorded, predicted]): (&At, &[Vec<f64>; 2])| {
            let value = |(k, f): (usize, &f64)| {
                let [has, foretold] = others[at.group][places.at(*f)];
                if has > 0.0 && foretold > 0.0 { predicted[k] * has / foretold } else { recorded[k] }
            };
            forward.frequencies_hz(*at).iter().enumerate().map(value).collect()
        };
        forward.records.iter().zip(&both).map(of).collect()
    };
    let n_sensor = forward.problem.array.outputs.len();
    let by_sensor: Vec<Vec<Vec<f64>>> = (0..n_sensor).into_par_iter().map(of_sensor).collect();
    (0..prediction.len()).map(|i| by_sensor.iter().map(|s| s[i].clone()).collect()).collect()
}

/// Transfer functions of the outputs over the base.
pub(super) fn gains(predicted: &Predicted, half: usize) -> Bins {
    let narrow = |x: Vec<f64>| running_mean(&x, RESOLUTION.min(half));
    let base = narrow(powers(&predicted.base));
    let floor = FLOOR * base.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    let of = |y: &Vec<C64>| -> Vec<C64> {
        let cross: Vec<C64> = y.iter().zip(&predicted.base).map(|(y, u)| y * u.conj()).collect();
        let re = narrow(cross.iter().map(|c| c.re).collect());
        let im = narrow(cross.iter().map(|c| c.im).collect());
        re.iter().zip(&im).zip(&base).map(|((re, im), p)| C64::new(*re, *im) / (p + floor)).collect()
    };
    predicted.outputs.iter().map(of).collect()
}

impl Spread {
    /// What the residuals of `prediction` show.
    ///
    /// ```text
    /// δ  = Σ (Y − C Ŷ/√(1 − b(1 − C²))) (Ŷ − U)* / Σ |Ŷ − U|²                                    (1)
    /// σ² = (ν + Σ ω (|δ|² − v)/m²) / (ν + Σ ω),   ω = (m²/(m² + v))²                             (2)
    /// ```
    ///
    /// ω counts what is seen at the declared error: what is missing is not to be taken for an error of the column before it has a name.
    /// Sums of (1) are over the bins of the shortest record's resolution in all records, each weighted by its power; v is what noise and
    /// straying make of δ by chance. ν values of δ count for the declared error m.
    pub fn estimated(forward: &Forward<'_>, prediction: &Prediction) -> Self {
        let n_sensor = forward.problem.array.outputs.len();
        let ends = band_hz(forward);
        let model = model_error(forward);
        let n_band = ((ends[1] / ends[0]).log2() * AN_OCTAVE).ceil().max(1.0) as usize;
        let at_hz = |b: usize| ends[0] * (ends[1] / ends[0]).powf((b as f64 + 0.5) / n_band as f64);
        let band_of = |f: f64| (((f / ends[0]).log2() * AN_OCTAVE) as usize).min(n_band - 1);
        let places = Places::of(forward);
        let gain: Vec<Bins> = prediction.iter().map(|p| gains(p, RESOLUTION)).collect();
        let by_sensor = |(at, p): (&At, &Predicted)| p.channels.iter().map(|c| noise(forward, *at, *c)).collect();
        let noises: Vec<Vec<Vec<f64>>> = forward.records.iter().zip(prediction).map(by_sensor).collect();
        let numerical = Arc::new(numerical_powers(forward));
        let (mut coherence, mut straying, mut repeatable) = (Vec::new(), Vec::new(), Vec::new());
        for s in 0..n_sensor {
            let mut moments: Vec<Moments> =
                (0..n_band).map(|b| Moments { f_hz: at_hz(b), ..Moments::default() }).collect();
            let each = |of: &mut dyn FnMut(Bin)| {
                let records = forward.records.iter().zip(prediction).zip(&gain).zip(&noises).zip(&*numerical);
                for ((((at, p), gain), noises), numerical) in records {
                    let total: f64 = powers(&p.measured[s]).iter().sum::<f64>().max(f64::MIN_POSITIVE);
                    for (k, f_hz) in forward.frequencies_hz(*at).iter().enumerate() {
                        of(Bin {
                            band: band_of(*f_hz),
                            f_hz: *f_hz,
                            weight: 1.0 / total,
                            recorded: p.measured[s][k],
                            predicted: p.outputs[s][k],
                            base: p.base[k],
                            noise: noises[s + 1][k],
                            predicted_noise: gain[s][k].norm_sqr() * noises[0][k] + numerical[s][k],
                            added_share: p.added_share,
                            lasting: seen(forward, *at).lasting[p.channels[s + 1]],
                        });
                    }
                }
            };
            each(&mut |bin| moments[bin.band].add(&bin));
            let own = coherence_at_knots(&moments, ends);
            straying.push(straying_at_knots(&moments, ends));
            // Σ r a*, Σ |a|², Σ v |a|², by place: what arrives late turns quickly with frequency.
            let mut shared = vec![(C64::default(), 0.0, 0.0); places.count];
            each(&mut |bin| {
                let (added, c, w) = (bin.predicted - bin.base, interpolated(&own, bin.f_hz, ends), bin.weight);
                let m = &mut shared[places.at(bin.f_hz)];
                m.0 += (bin.recorded - coherent(c, bin.added_share) * bin.predicted) * added.conj() * w;
                m.1 += w * added.norm_sqr();
                let strays = (1.0 - c * c) * bin.recorded.norm_sqr();
                m.2 += w * w * added.norm_sqr() * (bin.noise + bin.predicted_noise + strays);
            });
            let mut own_places = Vec::new();
            for (k, (cross, square, strays)) in shared.into_iter().enumerate().filter(|(_, m)| m.1 > 0.0) {
                let (delta, chance) = (cross / square, strays / (square * square));
                own_places.push(Shared { f_hz: places.middle_hz(k), delta, chance });
            }
            coherence.push(own);
            repeatable.push(own_places);
        }
        let added_share = prediction.first().map_or(0.0, |p| p.added_share);
        let level = Self::level(&repeatable, model, 1.0);
        let expected = [0.0, 1.0].map(|base| Arc::new(expected_powers(forward, prediction, base)));
        let channels = channels(prediction).to_vec();
        Self { level, coherence, straying, added_share, repeatable, numerical, expected, channels }
    }

    /// The same for the records of `few` alone.
    pub fn in_events(&self, few: &Forward<'_>) -> Self {
        let kept = |powers: &Powers| Arc::new(few.kept(powers));
        Self { numerical: kept(&self.numerical), expected: self.expected.each_ref().map(kept), ..self.clone() }
    }

    /// Error of the column over the declared one when all that records share counts, also what is no error of a column: the solution σ
    /// of (2) with ω at σ instead of the declared error.
    pub fn shared_level(&self, forward: &Forward<'_>) -> f64 {
        (0..LEVEL_STEPS).fold(self.level, |level, _| Self::level(&self.repeatable, model_error(forward), level))
    }

    /// (2), ω at `level`.
    fn level(repeatable: &[Vec<Shared>], model: f64, level: f64) -> f64 {
        let declared = model * model;
        let (mut sum, mut weight) = (PRIOR_VALUES, PRIOR_VALUES);
        for place in repeatable.iter().flatten() {
            let own = level * level * declared;
            let omega = (own / (own + place.chance)).powi(2);
            sum += omega * (place.delta.norm_sqr() - place.chance) / declared;
            weight += omega;
        }
        (sum / weight).max(1.0).sqrt()
    }

    /// What all records share of the residual of output sensor `s`, mean over bands: frequency in Hz, real and imaginary part.
    pub fn by_band(&self, s: usize) -> Vec<[f64; 3]> {
        let places = &self.repeatable[s];
        let frequencies_hz: Vec<f64> = places.iter().map(|p| p.f_hz).collect();
        let mean = |band: Range<usize>| {
            let n = band.len() as f64;
            let sum: C64 = places[band.clone()].iter().map(|p| p.delta).sum();
            [frequencies_hz[band].iter().sum::<f64>() / n, sum.re / n, sum.im / n]
        };
        bands(&frequencies_hz).into_iter().map(mean).collect()
    }

    /// Coherence of output sensor `s` at the knots: frequency in Hz, and c.
    pub fn at_knots(&self, s: usize, [low, high]: [f64; 2]) -> Vec<[f64; 2]> {
        let at = |k: usize| low * (high / low).powf(k as f64 / (KNOTS - 1) as f64);
        self.coherence[s].iter().enumerate().map(|(k, c)| [at(k), *c]).collect()
    }
}

/// Power of what remains beside a prediction, over all records, each weighted alike: what is the same in all of them, what is not and
/// is more than noise, and what was recorded.
pub fn residual_powers(forward: &Forward<'_>, prediction: &Prediction, spread: &Spread) -> [f64; 3] {
    let mut sums = [0.0; 3];
    let ends = band_hz(forward);
    let half_hz = 0.5 * Places::of(forward).step_hz;
    for ((at, p), numerical) in forward.records.iter().zip(prediction).zip(&*spread.numerical) {
        let gain = gains(p, RESOLUTION);
        let input = noise(forward, *at, p.channels[0]);
        for (s, y) in p.measured.iter().enumerate() {
            let noise = noise(forward, *at, p.channels[s + 1]);
            let total: f64 = powers(y).iter().sum::<f64>().max(f64::MIN_POSITIVE);
            for (k, f) in forward.frequencies_hz(*at).iter().enumerate() {
                let c = interpolated(&spread.coherence[s], *f, ends);
                let place = spread.repeatable[s].partition_point(|shared| shared.f_hz + half_hz < *f);
                let shared = spread.repeatable[s].get(place).map_or(0.0, |s| s.delta.norm_sqr() - s.chance);
                let same = shared * (p.outputs[s][k] - p.base[k]).norm_sqr();
                let expected = noise[k] + gain[s][k].norm_sqr() * input[k] + numerical[s][k];
                sums[0] += same / total;
                sums[1] += ((y[k] - coherent(c, p.added_share) * p.outputs[s][k]).norm_sqr() - expected - same) / total;
                sums[2] += y[k].norm_sqr() / total;
            }
        }
    }
    sums.map(|s: f64| s.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Truth, Uniform, problem, sample};
    use super::*;
    use crate::diagnosis::DiagnoseSettings;
    use crate::numerics::random;

    #[test]
    fn bands_in_which_noise_prevails_tell_no_coherence() {
        let ends_hz = [0.2, 20.0];
        let square = |f: f64| -> f64 { if f < 1.0 { 1.0 } else { 0.36 } };
        let band = |b: u32| {
            let f_hz = 0.2 * (f64::from(b) / 6.0).exp2();
            // From 8 Hz on there is hardly a prediction, and what is there is noise.
            let predicted = if f_hz < 8.0 { 1.0 } else { 1e-3 };
            let cross = C64::from(if f_hz < 8.0 { square(f_hz).sqrt() } else { 1e-3 });
            Moments { f_hz, recorded: 1.0, predicted, noise: [1e-4, 0.98e-3], cross, n: 50.0 }
        };
        let all: Vec<Moments> = (0..40).map(band).collect();
        let found = coherence_at_knots(&all, ends_hz);
        // Knots are at 0.2, 0.43, 0.93, 2, 4.3, 9.3 and 20 Hz; half the line between the third and the fourth is on the way.
        assert!(found[..2].iter().all(|c| (c - 1.0).abs() < 0.05), "{found:?}");
        assert!((found[4] - 0.6).abs() < 0.05, "{found:?}");
        assert!(found[5..].iter().all(|c| (0.55..0.85).contains(c)), "{found:?}");
    }

    #[test]
    fn chance_is_not_taken_for_a_field_that_strays() {
        // In bands of few bins squared coherence is one on average, and by chance beyond.
        let mut stream = random::stream(3, "coherence");
        let band = |b: u32, stream: &mut _| {
            let one = |_: u32| {
                let predicted = C64::new(sample(stream), sample(stream));
                let noise = C64::new(sample(stream), sample(stream));
                [predicted, predicted + 0.2 * noise]
            };
            let bins: Vec<[C64; 2]> = (0..8).map(one).collect();
            let power = |s: usize| bins.iter().map(|b| b[s].norm_sqr()).sum::<f64>();
            let cross = bins.iter().map(|[p, y]| y * p.conj()).sum();
            let f_hz = 0.2 * (f64::from(b) / 6.0).exp2();
            Moments { f_hz, recorded: power(1), predicted: power(0), noise: [0.64, 0.0], cross, n: 8.0 }
        };
        let all: Vec<Moments> = (0..40).map(|b| band(b, &mut stream)).collect();
        let found = coherence_at_knots(&all, [0.2, 20.0]);
        assert!(found.iter().all(|c| *c > 0.98), "{found:?}");
    }

    #[test]
    fn levels_and_coherence_are_read_off_records() {
        let problem = problem(&Truth::default());
        let replay = Uniform(&problem);
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        let right = forward.predict(&[]).unwrap();
        let of_right = Spread::estimated(&forward, &right);
        assert!(of_right.level < 1.1 && of_right.coherence.iter().flatten().all(|c| *c > 0.99), "{of_right:?}");
        // A column that adds 15 % too much: in its own measure the records lack 0.13 of what it adds.
        let mut wrong = right.clone();
        for p in &mut wrong {
            for (y, u) in p.outputs.iter_mut().flat_map(|y| y.iter_mut().zip(&p.base)) {
                *y += 0.15 * (*y - u);
            }
        }
        let of_wrong = Spread::estimated(&forward, &wrong);
        let expected = 0.15 / 1.15 / problem.tolerances.model;
        assert!((of_wrong.level / expected - 1.0).abs() < 0.3, "{} {expected}", of_wrong.level);
        let [repeatable, strays, recorded] = residual_powers(&forward, &wrong, &of_wrong);
        assert!(repeatable > 3.0 * strays && repeatable < 0.2 * recorded, "{repeatable} {strays} {recorded}");
    }
}
