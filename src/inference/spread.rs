//! What is expected of residuals, read off the records beside one prediction: how far the field follows its base, what strays, and what
//! the column has wrong.

use super::coherence::{FLOOR, Moments, coherence_at_knots, coherent, interpolated, knot_hz, straying_at_knots};
use super::correlation::correlation_at_knots;
use super::forward::{At, Bins, Forward, Predicted, Prediction};
use crate::diagnosis::spectra::{self, RecordSpectra};
use crate::diagnosis::{NoiseSource, USUAL_SHARE};
use crate::numerics::smooth::running_mean;
use rayon::prelude::*;
use realfft::num_complex::Complex;
use std::ops::Range;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Bands to an octave over which moments are taken.
pub(super) const AN_OCTAVE: f64 = 6.0;
/// Least bins of a band.
const LEAST_BINS: usize = 3;
/// Bins to either side over which the transfer function of the column is taken.
const RESOLUTION: usize = 1;
/// Values of the column's error that the declared one counts for when its level is estimated.
const PRIOR_VALUES: f64 = 10.0;
/// Steps towards the level of that error.
const LEVEL_STEPS: usize = 20;
/// Least error of a column.
const LEAST_ERROR: f64 = 1e-4;

/// What the records say of the field and of the column's error, beside one prediction of them.
#[derive(Debug, Clone)]
pub struct Spread {
    /// Error of the column over the declared one, at least 1: what is not the same in all records is not in it.
    pub level: f64,
    /// Coherence of each output sensor with its prediction at the knots.
    pub coherence: Vec<Vec<f64>>,
    /// Correlation of what strays from output sensor to output sensor, at the knots.
    pub(super) correlation: Vec<f64>,
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
        let by_sensor = |(at, p): (&At, &Predicted)| p.labels.iter().map(|l| noise(forward, *at, l.channel)).collect();
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
                            lasting: seen(forward, *at).lasting[p.labels[s + 1].channel],
                        });
                    }
                }
            };
            each(&mut |bin| {
                let m = &mut moments[bin.band];
                m.recorded += bin.weight * bin.recorded.norm_sqr();
                m.predicted += bin.weight * bin.predicted.norm_sqr();
                m.noise[0] += bin.weight * bin.noise;
                m.noise[1] += bin.weight * bin.predicted_noise;
                m.cross += bin.recorded * bin.predicted.conj() * bin.weight;
                m.n += bin.lasting;
            });
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
        let correlation = correlation_at_knots(forward, prediction, &coherence);
        Self { level, coherence, correlation, straying, added_share, repeatable, numerical, expected }
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

    /// How far it is from another: change of the level (ln), and the largest of a coherence.
    pub fn distance(&self, other: &Self) -> [f64; 2] {
        let coherences = self.coherence.iter().flatten().zip(other.coherence.iter().flatten());
        let moved = coherences.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        [(self.level / other.level).ln().abs(), moved]
    }

    /// Coherence of output sensor `s` at the knots: frequency in Hz, and c.
    pub fn at_knots(&self, s: usize, ends_hz: [f64; 2]) -> Vec<[f64; 2]> {
        self.coherence[s].iter().enumerate().map(|(k, c)| [knot_hz(k, ends_hz), *c]).collect()
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
        let input = noise(forward, *at, p.labels[0].channel);
        for (s, y) in p.measured.iter().enumerate() {
            let noise = noise(forward, *at, p.labels[s + 1].channel);
            let total: f64 = powers(y).iter().sum::<f64>().max(f64::MIN_POSITIVE);
            for (k, f) in forward.frequencies_hz(*at).iter().enumerate() {
                let c = interpolated(&spread.coherence[s], *f, ends);
                let place = spread.repeatable[s].partition_point(|shared| shared.f_hz + half_hz < *f);
                let shared = spread.repeatable[s].get(place).map_or(0.0, |s| s.delta.norm_sqr() - s.chance);
                let same = shared * (p.outputs[s][k] - p.base[k]).norm_sqr();
                let expected = noise[k] + gain[s][k].norm_sqr() * input[k] + numerical[s][k];
                sums[0] += same / total;
                sums[1] += (p.residual(s, k, c).norm_sqr() - expected - same) / total;
                sums[2] += y[k].norm_sqr() / total;
            }
        }
    }
    sums.map(|s: f64| s.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Truth, Uniform, problem};
    use super::*;
    use crate::diagnosis::DiagnoseSettings;

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
