//! Events as spectra: windows, tapers, bins of the common band, and what noise does to each bin.

use super::problem::{Event, Problem};
use super::settings::DiagnoseSettings;
use crate::error::{Error, Result};
use crate::numerics::smooth::running_mean;
use crate::records::Split;
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::f64::consts::{PI, TAU};
use std::ops::Range;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Longest stretch of a record that is compared, s; longer records keep the stretch of most input energy.
const MAX_DURATION_S: f64 = 41.0;
/// Share of the stretch that is tapered at each end.
const TAPER_SHARE: f64 = 0.04;
/// Time that a motion is given to die away before it would wrap around, s.
const SILENCE_S: f64 = 12.0;
/// Samples in the period of the highest frequency of a fast column's motion.
const PER_PERIOD: f64 = 2.4;
/// Half width over which spectra are smoothed, Hz.
pub(super) const SMOOTH_HZ: f64 = 0.15;

/// Bins to either side of a smoothed one.
pub fn smoothing_bins(frequencies_hz: &[f64]) -> usize {
    (SMOOTH_HZ / (frequencies_hz[1] - frequencies_hz[0])).round().max(1.0) as usize
}

/// Components of one event on common bins.
#[derive(Debug, Clone)]
pub struct Group {
    /// What the event may be used for.
    pub split: Split,
    /// Frequencies of the bins, Hz.
    pub frequencies_hz: Vec<f64>,
    /// Its records, by component.
    pub records: Vec<RecordSpectra>,
    /// Convolution without wrapping around.
    pub convolver: Convolver,
}

impl Group {
    /// Of the whitened `residual` of this group, `[bin][record][sensor]` in pairs of numbers, the bins of a record and a sensor.
    pub(super) fn residual_bins(&self, residual: &[f64], n_sensor: usize, [r, s]: [usize; 2]) -> Vec<C64> {
        let pairs = residual.chunks_exact(2).skip(r * n_sensor + s).step_by(self.records.len() * n_sensor);
        pairs.take(self.frequencies_hz.len()).map(|p| C64::new(p[0], p[1])).collect()
    }
}

/// One component of one event as spectra.
#[derive(Debug, Clone)]
pub struct RecordSpectra {
    /// Index in the problem's events.
    pub event: usize,
    /// The samples compared.
    pub window: Range<usize>,
    /// Channels, the input sensor first: `[sensor][bin]`.
    pub channels: Vec<Vec<C64>>,
    /// Expected |noise|² of each bin, `[sensor][bin]`.
    pub noise: Vec<Vec<f64>>,
    /// Peak over root-mean-square base velocity.
    pub peak_factor: f64,
    /// Spectra of the channels, not tapered and followed by silence, at the convolver's frequencies: `[sensor][bin]`.
    pub padded: Vec<Vec<C64>>,
}

/// Transforms of one event's length, planned once: a causal response is convolved with a history followed by silence and cut
/// to the samples compared, so that nothing wraps around.
#[derive(Clone)]
pub struct Convolver {
    /// Its frequencies, Hz.
    pub frequencies_hz: Vec<f64>,
    first: usize,
    n: usize,
    /// Samples to a coarse one, which still resolves the band.
    coarse: usize,
    padded: [Arc<dyn RealToComplex<f64>>; 2],
    inverse: Arc<dyn ComplexToReal<f64>>,
    coarsely: (Arc<dyn RealToComplex<f64>>, Arc<dyn ComplexToReal<f64>>),
}

impl std::fmt::Debug for Convolver {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Convolver").field("n", &self.n).field("first", &self.first).finish_non_exhaustive()
    }
}

impl Convolver {
    fn new(n: usize, dt_s: f64, coarse: usize, [low_hz, high_hz]: [f64; 2]) -> Self {
        let mut size = n + (SILENCE_S / dt_s) as usize;
        while !is_smooth(size) || !size.is_multiple_of(2 * coarse) {
            size += 1;
        }
        let step_hz = 1.0 / (size as f64 * dt_s);
        let first = (0.5 * low_hz / step_hz).ceil().max(1.0) as usize;
        let last = ((high_hz / step_hz).ceil() as usize + 1).min(size / 2 - 1);
        let mut planner = RealFftPlanner::<f64>::new();
        Self {
            frequencies_hz: (first..=last).map(|k| k as f64 * step_hz).collect(),
            first,
            n,
            coarse,
            padded: [planner.plan_fft_forward(size), planner.plan_fft_forward(n)],
            inverse: planner.plan_fft_inverse(size),
            coarsely: (planner.plan_fft_forward(n / coarse), planner.plan_fft_inverse(size / coarse)),
        }
    }

    /// Spectrum of a history of `n` samples followed by silence.
    pub fn forward(&self, x: &[f64]) -> Vec<C64> {
        let plan = &self.padded[0];
        let (mut buffer, mut out) = (plan.make_input_vec(), plan.make_output_vec());
        let count = self.n.min(x.len());
        buffer[..count].copy_from_slice(&x[..count]);
        if plan.process(&mut buffer, &mut out).is_err() {
            out.fill(C64::default());
        }
        out[self.first..self.first + self.frequencies_hz.len()].to_vec()
    }

    /// The first `n` samples of the history with these values at the convolver's frequencies.
    pub fn history(&self, bins: impl Iterator<Item = C64>) -> Vec<f64> {
        let (mut input, mut out) = (self.inverse.make_input_vec(), self.inverse.make_output_vec());
        input[self.first..].iter_mut().zip(bins).for_each(|(x, bin)| *x = bin);
        if self.inverse.process(&mut input, &mut out).is_err() {
            out.fill(0.0);
        }
        let scale = 1.0 / out.len() as f64;
        out[..self.n].iter().map(|x| x * scale).collect()
    }

    /// Tapered spectrum, at `count` bins from `first` on, of the history with these values at the convolver's frequencies: that
    /// of [`Self::history`] by way of no more samples than the band needs.
    pub fn cut(&self, bins: impl Iterator<Item = C64>, first: usize, count: usize) -> Vec<C64> {
        let (forward, inverse) = &self.coarsely;
        let (mut input, mut history) = (inverse.make_input_vec(), inverse.make_output_vec());
        input[self.first..].iter_mut().zip(bins).for_each(|(x, bin)| *x = bin);
        let (mut buffer, mut out) = (forward.make_input_vec(), forward.make_output_vec());
        if inverse.process(&mut input, &mut history).is_err() {
            return vec![C64::default(); count];
        }
        let scale = 1.0 / history.len() as f64;
        for (i, (value, x)) in buffer.iter_mut().zip(&history).enumerate() {
            *value = scale * x * taper(i * self.coarse, self.n);
        }
        if forward.process(&mut buffer, &mut out).is_err() {
            out.fill(C64::default());
        }
        out[first..first + count].to_vec()
    }

    /// Tapered spectrum of `n` samples at `count` bins from `first` on.
    pub fn tapered(&self, history: &[f64], first: usize, count: usize) -> Vec<C64> {
        let plan = &self.padded[1];
        let (mut buffer, mut out) = (plan.make_input_vec(), plan.make_output_vec());
        for (i, (value, x)) in buffer.iter_mut().zip(history).enumerate() {
            *value = x * taper(i, self.n);
        }
        if plan.process(&mut buffer, &mut out).is_err() {
            out.fill(C64::default());
        }
        out[first..first + count].to_vec()
    }
}

/// Samples to one that still resolves `high_hz`.
fn coarse(dt_s: f64, high_hz: f64) -> usize {
    ((1.0 / (PER_PERIOD * high_hz * dt_s)) as usize).max(1)
}

/// Whether a transform of this size is fast.
fn is_smooth(mut n: usize) -> bool {
    for p in [2, 3, 5] {
        while n.is_multiple_of(p) {
            n /= p;
        }
    }
    n == 1
}

impl Group {
    /// Number of whitened residuals.
    pub fn n_residual(&self) -> usize {
        self.records.iter().map(|r| 2 * (r.channels.len() - 1) * self.frequencies_hz.len()).sum()
    }
}

/// The history whose bins from `first` on are `bins`, zero elsewhere.
pub fn history(bins: &[C64], first: usize, n: usize) -> Vec<f64> {
    let plan = RealFftPlanner::<f64>::new().plan_fft_inverse(n);
    let mut input = plan.make_input_vec();
    input[first..first + bins.len()].copy_from_slice(bins);
    let mut out = vec![0.0; n];
    if plan.process(&mut input, &mut out).is_err() {
        return out;
    }
    out.iter().map(|x| x / n as f64).collect()
}

/// Factor on sample `i` of `n` before the transform.
pub(super) fn taper(i: usize, n: usize) -> f64 {
    let edge = (TAPER_SHARE * n as f64).max(1.0);
    let distance = (i.min(n - 1 - i) as f64 + 0.5) / edge;
    if distance >= 1.0 { 1.0 } else { 0.5 - 0.5 * (PI * distance).cos() }
}

/// Index of the first bin of the band and their number for `n` samples of `dt_s`.
pub fn bins(n: usize, dt_s: f64, band_hz: [f64; 2]) -> (usize, usize) {
    let step_hz = 1.0 / (n as f64 * dt_s);
    let high_hz = band_hz[1].min(0.45 / dt_s);
    let first = (band_hz[0] / step_hz).ceil().max(1.0) as usize;
    let last = (high_hz / step_hz).floor() as usize;
    (first, (last + 1).saturating_sub(first))
}

/// The events of `problem`, components of an event together.
///
/// # Errors
/// When an event is too short for the band or its components differ in step or length.
pub fn groups(problem: &Problem, settings: &DiagnoseSettings) -> Result<Vec<Group>> {
    let mut names: Vec<&str> = Vec::new();
    for event in &problem.events {
        if !names.contains(&event.name.as_str()) {
            names.push(&event.name);
        }
    }
    names.iter().map(|name| group(problem, settings, name)).collect()
}

fn group(problem: &Problem, settings: &DiagnoseSettings, name: &str) -> Result<Group> {
    let mut members: Vec<(usize, &Event)> = problem.events.iter().enumerate().filter(|(_, e)| e.name == name).collect();
    members.sort_by_key(|(_, e)| e.component());
    let dt_s = members[0].1.dt_s;
    let place = || format!("event `{name}`");
    if members.iter().any(|(_, e)| e.dt_s != dt_s) {
        return Err(Error::new("the components of an event must have the same time step").at(place()));
    }
    let n = members.iter().map(|(_, e)| e.input.len()).min().unwrap_or(0);
    let mut window = strongest(&members, n, (MAX_DURATION_S / dt_s) as usize);
    let coarse = coarse(dt_s, settings.band_hz[1] + 0.5);
    window.end -= window.len() % coarse;
    let (first, count) = bins(window.len(), dt_s, settings.band_hz);
    if count < 8 {
        let what = format!("{:.1} s are too short for a band of {:?} Hz", n as f64 * dt_s, settings.band_hz);
        return Err(Error::new(what).at(place()));
    }
    let step_hz = 1.0 / (window.len() as f64 * dt_s);
    let band_hz = [settings.band_hz[0], (first + count) as f64 * step_hz];
    let convolver = Convolver::new(window.len(), dt_s, coarse, band_hz);
    let frequencies_hz: Vec<f64> = (0..count).map(|k| (first + k) as f64 * step_hz).collect();
    let tapered: f64 = (0..window.len()).map(|i| taper(i, window.len()).powi(2)).sum();
    let records = members
        .iter()
        .map(|(index, event)| {
            let histories = std::iter::once(&event.input).chain(&event.outputs);
            let channels: Vec<Vec<C64>> =
                histories.map(|x| convolver.tapered(&x[window.clone()], first, count)).collect();
            let smooth = (SMOOTH_HZ / step_hz).round() as usize;
            let noise = channels
                .iter()
                .zip(&event.noise)
                .enumerate()
                .map(|(sensor, (channel, noise))| {
                    let power = smoothed(channel, smooth);
                    let error = if sensor == 0 { 0.0 } else { settings.model_error.powi(2) };
                    let sensor_noise = |f: &f64| tapered * noise.at(*f) / (2.0 * dt_s);
                    let floor = 1e-12 * power.iter().copied().fold(0.0, f64::max) + f64::MIN_POSITIVE;
                    frequencies_hz.iter().zip(&power).map(|(f, p)| sensor_noise(f) + error * p + floor).collect()
                })
                .collect();
            let velocity: Vec<C64> =
                channels[0].iter().zip(&frequencies_hz).map(|(a, f)| a / C64::new(0.0, TAU * f)).collect();
            let velocity = history(&velocity, first, window.len());
            let peak = velocity.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let rms = (velocity.iter().map(|v| v * v).sum::<f64>() / velocity.len() as f64).sqrt();
            let peak_factor = if rms > 0.0 { peak / rms } else { 3.0 };
            let histories = std::iter::once(&event.input).chain(&event.outputs);
            let padded = histories.map(|x| convolver.forward(&x[window.clone()])).collect();
            RecordSpectra { event: *index, window: window.clone(), channels, noise, peak_factor, padded }
        })
        .collect();
    Ok(Group { split: members[0].1.split, frequencies_hz, records, convolver })
}

/// The stretch of `longest` samples with most input energy.
fn strongest(members: &[(usize, &Event)], n: usize, longest: usize) -> Range<usize> {
    if n <= longest {
        return 0..n;
    }
    let power = |i: usize| members.iter().map(|(_, e)| e.input[i] * e.input[i]).sum::<f64>();
    let mut sum: f64 = (0..longest).map(power).sum();
    let (mut best, mut start) = (sum, 0);
    for i in longest..n {
        sum += power(i) - power(i - longest);
        // A little more energy is not worth losing the onset.
        if sum > 1.001 * best {
            (best, start) = (sum, i + 1 - longest);
        }
    }
    start..start + longest
}

/// Mean |x|² over 2·`half` + 1 bins.
pub fn smoothed(x: &[C64], half: usize) -> Vec<f64> {
    running_mean(&x.iter().map(C64::norm_sqr).collect::<Vec<_>>(), half)
}
