//! What a prediction is compared by: residuals in units of what is expected of them.

use super::coherence::{coherent, interpolated};
use super::covariance::Covariance;
use super::density::{Residual, shared_error};
use super::forward::{At, Forward, Predicted, Prediction};
use super::spread::{AN_OCTAVE, Places, Spread, band_hz, bands, gains, model_error, noise, powers, seen};
use crate::diagnosis::spectra;
use crate::metrics::median;
use crate::numerics::smooth::{octave_mean, running_mean};
use rayon::prelude::*;
use realfft::num_complex::Complex;
use std::f64::consts::{LN_2, SQRT_2};
use std::ops::Range;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Octaves over which what the column has wrong is one complex number. That neighbouring frequencies err alike is known of all models of
/// Fourier amplitudes (Bayless and Abrahamson, 2019, doi 10.1785/0120180238); the width is a choice that lets nothing be named in records
/// that another program made of the same column.
const ALIKE_OCTAVES: f64 = 0.5;
/// Places between which a line is compared with what is around it.
const LINE_NEIGHBOURS: [usize; 2] = [3, 12];
/// Lines that are looked at.
const LINES: usize = 3;

/// What is expected of records that sensors are taken to have made on the same channels, beside the prediction it was read off.
#[derive(Clone)]
pub struct Expected {
    /// What is expected of residuals.
    pub spread: Spread,
    /// The prediction.
    pub reference: Arc<Prediction>,
}

impl Expected {
    /// What the residuals of `reference` show.
    pub fn of(forward: &Forward<'_>, reference: Arc<Prediction>) -> Self {
        Self { spread: Spread::estimated(forward, &reference), reference }
    }

    /// Weights of the records.
    pub fn weights(&self, forward: &Forward<'_>) -> Weights {
        Weights::new(forward, &self.spread, &self.reference)
    }
}

/// Residuals of all records in units of what is expected of them, record by record.
pub type Rows = Vec<Vec<f64>>;

/// One band of one sensor of one record.
struct Band {
    bins: Range<usize>,
    /// One over the deviation expected of its ln amplitude, times the share of its power that strays.
    weight: f64,
    /// Power of noise in it.
    noise: f64,
    /// Power of what would stray in it, were all of that of another origin.
    added: f64,
}

/// Weights of one record.
struct Record {
    sigma: Vec<Covariance>,
    /// Coherence, `[sensor][bin]`.
    coherence: Vec<Vec<f64>>,
    bands: Vec<Vec<Band>>,
    /// Variance of noise and of what strays, `[sensor][bin]`.
    variance: Vec<Vec<f64>>,
    /// −ln of the density of the base.
    base: f64,
}

/// Residuals in units of what is expected of them.
///
/// ```text
/// Y | U ~ CN( C Ŷ/√(1 − b(1 − C²)), Σ ),   Σ = A Γ A + S_out + H S_in Hᴴ + E + D,   A² = (I − C²) P,   D = (σ m)² N P'   (1)
/// ln A | U ~ N( ½ ln(Â² + b(1 − C²) ⟨|Y|²⟩ₒ), 1/4n + (σ m)² R ),   weighted by the share of A² in Σ without D  (2)
/// ```
///
/// Ŷ is the prediction, U the base, C the coherence of each sensor with its prediction, the same in all events. E is what elements and
/// steps leave wrong of the motion: the power of the difference of a fine replay and a rough one. m is the declared error of the column, a
/// share of what it adds to its base, and σ its estimated level ([`Spread`]). That error is alike in all bins of [`ALIKE_OCTAVES`] and in
/// all records; N is the number of these, so that (1), which takes bins for independent, knows no more of anything smooth than a likelihood
/// with that correlation would. Where the field strays from its base only amplitudes tell of the column: (2), A being the RMS amplitude of a
/// band of n bins and R the number of records times that of the bands that share the error.
///
/// A field that strays by scattering keeps its power at every frequency: of what was recorded, C² follows the base and 1 − C² does not.
/// Motion of another origin, such as traffic or a second source, comes on top of that, with a spectrum of which is known only that it is
/// smooth: ⟨ ⟩ₒ is a mean over an octave. b, from 0 to 1, is the share of what strays that is such motion, the same at all sensors and
/// frequencies; it is estimated with the rest of a model, for a column that is to explain the whole recorded power takes up what another
/// origin added as a gain or a lack of damping. What strays at one output sensor strays at others as well: Γ has ones and beside its
/// diagonal the correlation of [`Spread`]. Amplitudes in (2) are taken to be independent from sensor to sensor.
///
/// What strays lasts as long as the motion, a share s of the record: neighbouring bins are alike, and of n of them n s are independent. So
/// residuals are divided by Σ with 1/s of what strays, and n in (2) is n s.
///
/// P is the expected power of a record, and P' of what it has beside the base: that of a reference prediction, times what the other events
/// have over theirs at the same frequency. The power of the record itself would count residuals least where what strays adds to the
/// prediction, and lead to too little motion. Σ does not change with the prediction, P and H being those of the reference. So a
/// prediction gains nothing by shrinking, and models that are compared are compared by one Σ; those that take other channels for the same
/// sensors have one of their own, for what strays beside wrong labels says nothing of the right ones. Models that are weighed by different
/// Σ are compared by a density: at the prediction that Σ was read off, (1) and (2) are −ln of that of records whose column errs by one
/// number at each frequency ([`shared_error`]); the error that counts N times is none, and favours large errors.
///
/// Source: Pintelon and Schoukens (2012), System Identification, for H S_in Hᴴ; Kennedy and O'Hagan (2001),
/// doi 10.1111/1467-9868.00294, for the error of the column.
/// Check:  `residuals_of_a_partly_coherent_field_tell_no_more_than_they_know`, `damping_of_a_partly_coherent_field_is_found`,
///         `motion_of_another_origin_is_no_lack_of_damping`,
///         `levels_and_coherence_are_read_off_records`, `what_strays_at_one_sensor_strays_at_others`.
pub struct Weights {
    records: Vec<Record>,
    /// What half the squares of residuals lack of −ln of the density of the records: the same for all models that take the same channels
    /// for the same sensors.
    pub constant: f64,
    /// −ln of the density of the records beside the prediction that these were read off.
    pub beside: f64,
}

/// `rows` with nothing above `high_hz`.
pub fn below(forward: &Forward<'_>, rows: &Rows, high_hz: f64) -> Rows {
    let n_sensor = forward.problem.array.outputs.len();
    let of = |(at, rows): (&At, &Vec<f64>)| {
        let f = forward.frequencies_hz(*at);
        let n_bin = f.partition_point(|f| *f <= high_hz);
        let bins = f.iter().flat_map(|f| std::iter::repeat_n(*f <= high_hz, 2 * n_sensor));
        let bands: Vec<bool> = bands(f).into_iter().map(|b| b.end <= n_bin).collect();
        let counts = bins.chain(bands.iter().copied().cycle().take(n_sensor * bands.len()));
        rows.iter().zip(counts).map(|(row, counts)| if counts { *row } else { 0.0 }).collect()
    };
    forward.records.iter().zip(rows).map(of).collect()
}

/// The frequencies from `low_hz` to `high_hz` where the power of `rows` is most above that around, which is what a line there would explain,
/// and how far apart records tell frequencies, all Hz.
pub fn lines_hz(forward: &Forward<'_>, rows: &Rows, [low_hz, high_hz]: [f64; 2]) -> (Vec<f64>, f64) {
    let n_sensor = forward.problem.array.outputs.len();
    let places = Places::of(forward);
    let mut power = vec![0.0; places.count];
    for (at, rows) in forward.records.iter().zip(rows) {
        for (f, bin) in forward.frequencies_hz(*at).iter().zip(rows.chunks(2 * n_sensor)) {
            power[places.at(*f)] += bin.iter().map(|r| r * r).sum::<f64>();
        }
    }
    let above = |k: usize| {
        let ends = k.saturating_sub(LINE_NEIGHBOURS[1])..(k + LINE_NEIGHBOURS[1] + 1).min(places.count);
        let others: Vec<f64> = ends.filter(|j| j.abs_diff(k) >= LINE_NEIGHBOURS[0]).map(|j| power[j]).collect();
        if others.is_empty() { 0.0 } else { power[k] - median(&others) }
    };
    let is_within = |k: &usize| (low_hz..=high_hz).contains(&places.middle_hz(*k));
    let mut all: Vec<(usize, f64)> = (0..places.count).filter(is_within).map(|k| (k, above(k))).collect();
    all.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut lines: Vec<usize> = Vec::new();
    for (k, _) in all {
        if lines.len() < LINES && lines.iter().all(|line| line.abs_diff(k) >= LINE_NEIGHBOURS[0]) {
            lines.push(k);
        }
    }
    (lines.into_iter().map(|k| places.middle_hz(k)).collect(), places.step_hz)
}

impl Weights {
    /// Weights of the records by `spread`, the transfer functions those of `prediction`.
    fn new(forward: &Forward<'_>, spread: &Spread, prediction: &Prediction) -> Self {
        let indices: Vec<usize> = (0..forward.records.len()).collect();
        let records = indices.par_iter().map(|i| Record::of(forward, spread, *i, &prediction[*i])).collect();
        let mut weights = Self { records, constant: 0.0, beside: 0.0 };
        let squares: f64 = weights.rows(prediction).iter().flatten().map(|r| r * r).sum();
        let error = (spread.level * model_error(forward)).powi(2);
        weights.beside = weights.density(forward, prediction, error);
        weights.constant = weights.beside - 0.5 * squares;
        weights
    }

    /// −ln of the density of the records beside the prediction that these weights were read off, the column's `error` one number at each
    /// frequency and sensor.
    fn density(&self, forward: &Forward<'_>, prediction: &Prediction, error: f64) -> f64 {
        let places = Places::of(forward);
        let of_sensor = |s: usize| -> f64 {
            let mut by_place: Vec<Vec<Residual>> = (0..places.count).map(|_| Vec::new()).collect();
            for (i, (at, p)) in forward.records.iter().zip(prediction).enumerate() {
                let Record { coherence, variance, .. } = &self.records[i];
                let count = seen(forward, *at).lasting[p.labels[s + 1].channel];
                for (k, f) in forward.frequencies_hz(*at).iter().enumerate() {
                    let (added, left) = (p.outputs[s][k] - p.base[k], p.residual(s, k, coherence[s][k]));
                    by_place[places.at(*f)].push(Residual { count, added, left, variance: variance[s][k] });
                }
            }
            by_place.iter().map(|residuals| shared_error(residuals, error)).sum()
        };
        let n_sensor = forward.problem.array.outputs.len();
        (0..n_sensor).map(of_sensor).sum::<f64>() + self.records.iter().map(|record| record.base).sum::<f64>()
    }

    /// Residuals of a prediction in units of what is expected of them: half their squares are −ln of (1) and (2), constants apart.
    pub fn rows(&self, prediction: &Prediction) -> Rows {
        self.records.par_iter().zip(prediction).map(|(record, p)| record.rows(p)).collect()
    }

    /// Residuals in these units of what changes outputs alone, of which `slopes` are those in units of `other`, at `prediction`: the same
    /// change of the outputs. `None` where that is not told: what `other` did not count.
    pub fn converted(&self, slopes: &Rows, other: &Self, prediction: &Prediction) -> Option<Rows> {
        let records = self.records.par_iter().zip(&other.records);
        records.zip(slopes).zip(prediction).map(|(((own, other), slopes), p)| own.converted(slopes, other, p)).collect()
    }
}

impl Band {
    /// Power that is expected of the recorded motion where that of the output is `predicted`.
    fn expected(&self, predicted: f64, added_share: f64) -> f64 {
        (predicted + self.noise + added_share * self.added).max(f64::MIN_POSITIVE)
    }
}

impl Record {
    /// Weights of record `index` by `spread`, the transfer functions those of `predicted`.
    fn of(forward: &Forward<'_>, spread: &Spread, index: usize, predicted: &Predicted) -> Self {
        let at = forward.records[index];
        let f = forward.frequencies_hz(at);
        let (half, ends) = (spectra::smoothing_bins(f), band_hz(forward));
        let (n_sensor, n_record) = (predicted.outputs.len(), forward.records.len() as f64);
        let level = spread.level * model_error(forward);
        let gain = gains(predicted, half);
        let noise: Vec<Vec<f64>> = predicted.labels.iter().map(|l| noise(forward, at, l.channel)).collect();
        let channels = &seen(forward, at).channels;
        let input = running_mean(&powers(&channels[predicted.labels[0].channel]), half);
        let [recorded, beside] = spread.expected.each_ref().map(|powers| &powers[index]);
        let wide: Vec<Vec<f64>> = predicted.measured.iter().map(|y| octave_mean(&powers(y), f)).collect();
        let at_bins = |knots: &Vec<f64>| f.iter().map(|f| interpolated(knots, *f, ends)).collect();
        let coherence: Vec<Vec<f64>> = spread.coherence.iter().map(at_bins).collect();
        let straying: Vec<Vec<f64>> = spread.straying.iter().map(at_bins).collect();
        // What strays, were all of it of another origin.
        let added = |s: usize, k: usize| straying[s][k] * wide[s][k];
        let strays = |s: usize, k: usize| {
            let scattered = (1.0 - coherence[s][k].powi(2)).max(0.0) * recorded[s][k];
            (1.0 - spread.added_share) * scattered + spread.added_share * added(s, k)
        };
        let step_hz = f[1] - f[0];
        // Values of the column's error that are one.
        let alike = |k: usize| (f[k] * ((LN_2 * ALIKE_OCTAVES).exp() - 1.0) / step_hz).max(1.0) * n_record;
        let own = |s: usize, k: usize| level * level * alike(k) * beside[s][k];
        let numerical = &spread.numerical[index];
        // What strays lasts as long as the motion, for this share of the record.
        let lasting = |s: usize| seen(forward, at).lasting[predicted.labels[s + 1].channel];
        let quiet = |s: usize, k: usize| (noise[s + 1][k] + numerical[s][k]).max(f64::MIN_POSITIVE);
        // Of what is independent from sensor to sensor, of what strays, and of the noise of the base.
        let sigma = |k: usize| {
            let common = interpolated(&spread.correlation, f[k], ends);
            let strays = |s: usize| strays(s, k) / lasting(s);
            Covariance::new(n_sensor, |i, j| {
                let own = if i == j { quiet(i, k) + own(i, k) } else { 0.0 };
                let of_base = gain[i][k] * gain[j][k].conj() * noise[0][k];
                let astray = if i == j { strays(i) } else { common * (strays(i) * strays(j)).sqrt() };
                of_base + astray + own
            })
        };
        let variance = |s: usize, k: usize| quiet(s, k) + strays(s, k) + gain[s][k].norm_sqr() * noise[0][k];
        let band = |s: usize, bins: Range<usize>| {
            let n = bins.len() as f64;
            let sum = |of: &dyn Fn(usize) -> f64| bins.clone().map(of).sum::<f64>();
            let noisy = sum(&|k| noise[s + 1][k] + gain[s][k].norm_sqr() * noise[0][k] + numerical[s][k]);
            let stray = sum(&|k| strays(s, k));
            let share = stray / (stray + noisy).max(f64::MIN_POSITIVE);
            let alike = n_record * ALIKE_OCTAVES * AN_OCTAVE;
            let weight = share / (0.25 / (n * lasting(s)) + level * level * alike).sqrt();
            Band { weight, noise: sum(&|k| noise[s + 1][k]), added: sum(&|k| added(s, k)), bins }
        };
        let sigma: Vec<Covariance> = (0..f.len()).map(sigma).collect();
        let variance = (0..n_sensor).map(|s| (0..f.len()).map(|k| variance(s, k)).collect()).collect();
        let of_base: f64 = input.iter().map(|p| p.max(f64::MIN_POSITIVE).ln()).sum();
        let base = seen(forward, at).lasting[predicted.labels[0].channel] * of_base;
        let bands = (0..n_sensor).map(|s| bands(f).into_iter().map(|b| band(s, b)).collect()).collect();
        Self { sigma, coherence, bands, variance, base }
    }

    /// See [`Weights::converted`].
    fn converted(&self, slopes: &[f64], other: &Self, p: &Predicted) -> Option<Vec<f64>> {
        let n = p.outputs.len();
        let (of_bins, of_bands) = slopes.split_at_checked(2 * n * self.sigma.len())?;
        let mut rows = Vec::with_capacity(slopes.len());
        let mut change = vec![C64::default(); n];
        for (k, bin) in of_bins.chunks_exact(2 * n).enumerate() {
            change.iter_mut().zip(bin.chunks_exact(2)).for_each(|(c, pair)| *c = C64::new(pair[0], pair[1]));
            other.sigma[k].colour(&mut change);
            for (s, change) in change.iter_mut().enumerate() {
                *change *=
                    coherent(self.coherence[s][k], p.added_share) / coherent(other.coherence[s][k], p.added_share);
            }
            self.sigma[k].whiten(&mut change);
            rows.extend(change.iter().flat_map(|c| [c.re, c.im]));
        }
        let pairs = self.bands.iter().zip(&other.bands).enumerate();
        let bands = pairs.flat_map(|(s, (own, other))| own.iter().zip(other).map(move |(own, other)| (s, own, other)));
        for ((s, own, other), slope) in bands.zip(of_bands) {
            let predicted = p.outputs[s][own.bins.clone()].iter().map(C64::norm_sqr).sum();
            let [here, there] = [own, other].map(|band| band.weight / band.expected(predicted, p.added_share));
            if there == 0.0 && here > 0.0 {
                return None;
            }
            rows.push(if here == 0.0 { 0.0 } else { slope * here / there });
        }
        Some(rows)
    }

    fn rows(&self, p: &Predicted) -> Vec<f64> {
        let n = p.outputs.len();
        let mut rows = Vec::with_capacity(2 * n * self.sigma.len() + self.bands.iter().map(Vec::len).sum::<usize>());
        let mut residual = vec![C64::default(); n];
        for (k, sigma) in self.sigma.iter().enumerate() {
            for (s, r) in residual.iter_mut().enumerate() {
                *r = p.residual(s, k, self.coherence[s][k]);
            }
            sigma.whiten(&mut residual);
            rows.extend(residual.iter().flat_map(|r| [SQRT_2 * r.re, SQRT_2 * r.im]));
        }
        for (s, bands) in self.bands.iter().enumerate() {
            for band in bands {
                let power = |x: &[C64]| x[band.bins.clone()].iter().map(C64::norm_sqr).sum::<f64>();
                let expected = band.expected(power(&p.outputs[s]), p.added_share);
                let ln = 0.5 * (power(&p.measured[s]).max(f64::MIN_POSITIVE) / expected).ln();
                rows.push(band.weight * ln);
            }
        }
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Truth, Uniform, problem};
    use super::*;
    use crate::diagnosis::DiagnoseSettings;

    #[test]
    fn a_line_is_where_a_hum_is() {
        let table = "kind = 'machine_hum'\nsensor = 'top'\namplitude_m_s2 = 0.1\nfrequency_hz = 6.35";
        let problem = problem(&Truth { table, ..Truth::default() });
        let replay = Uniform(&problem);
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        let prediction = forward.predict(&[]).unwrap();
        let weights = Expected::of(&forward, Arc::new(prediction.clone())).weights(&forward);
        let (found_hz, width_hz) = lines_hz(&forward, &weights.rows(&prediction), [0.5, 20.0]);
        assert!((found_hz[0] - 6.35).abs() < width_hz, "{found_hz:?} Hz, {width_hz} Hz wide");
    }

    #[test]
    fn slopes_in_other_units_are_those_of_the_same_change() {
        let straying = |f: f64| 0.95 - 0.04 * f;
        let problem = problem(&Truth { coherence: straying, ..Truth::default() });
        let replay = Uniform(&problem);
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        let table = |ln: f64| toml::from_str(&format!("kind = 'layer_velocity'\nln_factor = {ln}"));
        let at = |ln: f64| -> Prediction {
            let mut prediction = forward.predict(&[table(ln).unwrap()]).unwrap();
            prediction.iter_mut().for_each(|p| p.added_share = 0.3);
            prediction
        };
        let [from, here, there] = [0.05, 0.0, 1e-4].map(at);
        let other = Expected::of(&forward, Arc::new(from)).weights(&forward);
        let own = Expected::of(&forward, Arc::new(here.clone()));
        let scale = |c: &Vec<f64>| c.iter().map(|c| 0.9 * c).collect();
        let spread = Spread { coherence: own.spread.coherence.iter().map(scale).collect(), level: 2.0, ..own.spread };
        let own = Weights::new(&forward, &spread, &own.reference);
        let change = |weights: &Weights| -> Rows {
            let pairs = weights.rows(&there).into_iter().zip(weights.rows(&here));
            pairs.map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b) / 1e-4).collect()).collect()
        };
        let wanted = change(&own);
        let found = own.converted(&change(&other), &other, &here).unwrap();
        let size = |rows: &Rows| rows.iter().flatten().map(|r| r * r).sum::<f64>().sqrt();
        let missed = found.iter().zip(&wanted).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect()).collect();
        assert!(size(&missed) < 1e-3 * size(&wanted), "{} {}", size(&missed), size(&wanted));
        assert!(size(&wanted) > 1.0);
    }

    #[test]
    fn residuals_are_of_the_size_that_weights_expect() {
        let problem = problem(&Truth::default());
        let replay = Uniform(&problem);
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        let right = forward.predict(&[]).unwrap();
        // Without an error of the column and with a field that does not stray only noise is left, and rows are standard normal numbers.
        let found = Spread::estimated(&forward, &right);
        let coherence = found.coherence.iter().map(|c| vec![1.0; c.len()]).collect();
        let spread = Spread { level: 1e-6, coherence, ..found };
        let weights = Weights::new(&forward, &spread, &right);
        let rows: Vec<f64> = weights.rows(&right).into_iter().flatten().filter(|r| *r != 0.0).collect();
        let level = rows.iter().map(|r| r * r).sum::<f64>() / rows.len() as f64;
        assert!((level - 1.0).abs() < 0.25, "{level}");
    }
}
