//! Events as spectra: windows, tapers, bins of the common band, and what noise does to each bin.

use super::problem::{Event, NoiseSpectrum, Problem};
use super::settings::DiagnoseSettings;
use crate::error::{Error, Result};
use crate::metrics::rms;
use crate::numerics::smooth::running_mean;
use crate::numerics::spectrum::transforms;
use crate::records::Split;
use realfft::RealToComplex;
use realfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};
use std::ops::Range;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Longest stretch of a record that is compared, s; longer records keep the stretch of most input energy.
const MAX_DURATION_S: f64 = 41.0;
/// Share of the stretch that is tapered at each end.
const TAPER_SHARE: f64 = 0.04;
/// Half width over which spectra are smoothed, Hz.
const SMOOTH_HZ: f64 = 0.15;
/// Half of the time over which the power of a motion is smoothed, s.
const SMOOTH_S: f64 = 0.5;
/// Highest frequency that is compared, over that of the samples.
pub const HIGHEST_SHARE: f64 = 0.45;
/// Least power of noise in a bin, over the largest power of a channel.
const LEAST_NOISE: f64 = 1e-12;
/// Peak over RMS velocity of a base that does not move.
const USUAL_PEAK_FACTOR: f64 = 3.0;

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
    transform: Transform,
}

impl Group {
    /// Spectrum of a history of record `record` as that is seen: its window, its taper, its bins.
    pub fn bins(&self, record: usize, history: &[f64]) -> Vec<C64> {
        let seen = history.get(self.records[record].window.clone()).unwrap_or_default();
        self.transform.tapered(seen)
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
    /// Share of the window over which the motion of each channel lasts, by sensor: [`lasting_share`].
    pub lasting: Vec<f64>,
    /// Peak over root-mean-square base velocity.
    pub peak_factor: f64,
}

/// The transform of one event's length, planned once.
#[derive(Clone)]
struct Transform {
    plan: Arc<dyn RealToComplex<f64>>,
    /// Bins that are compared.
    bins: Range<usize>,
}

impl std::fmt::Debug for Transform {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Transform").field("n", &self.plan.len()).field("bins", &self.bins).finish()
    }
}

impl Transform {
    /// Tapered spectrum of a history that has the length of the event.
    fn tapered(&self, history: &[f64]) -> Vec<C64> {
        let (mut buffer, mut out) = (self.plan.make_input_vec(), self.plan.make_output_vec());
        let n = buffer.len();
        for (i, (value, x)) in buffer.iter_mut().zip(history).enumerate() {
            *value = x * taper(i, n);
        }
        // Lengths agree by construction; a failure would leave the spectrum at zero.
        let _ = self.plan.process(&mut buffer, &mut out);
        out[self.bins.clone()].to_vec()
    }
}

/// The history whose bins from `first` on are `bins`, zero elsewhere.
fn history(bins: &[C64], first: usize, n: usize) -> Vec<f64> {
    let (_, plan) = transforms(n);
    let mut input = plan.make_input_vec();
    input[first..first + bins.len()].copy_from_slice(bins);
    let mut out = vec![0.0; n];
    if plan.process(&mut input, &mut out).is_err() {
        return out;
    }
    out.iter().map(|x| x / n as f64).collect()
}

/// Share of a history over which its motion lasts.
///
/// ```text
/// s = (Σ p)² / (n Σ p²),   p the mean of the squared history around a sample          (1)
/// ```
///
/// Of the bins of its spectrum only that share is independent: 1/s neighbours are alike.
///
/// Check:  `a_motion_lasts_as_long_as_its_envelope`.
/// Source: Bendat and Piersol (2010), Random Data, chapter 12, for products of an envelope and stationary noise.
fn lasting_share(history: &[f64], dt_s: f64) -> f64 {
    let squares: Vec<f64> = history.iter().map(|v| v * v).collect();
    let power = running_mean(&squares, (SMOOTH_S / dt_s).round() as usize);
    let sums = power.iter().fold([0.0, 0.0], |[one, two], p| [one + p, two + p * p]);
    if sums[1] > 0.0 { sums[0] * sums[0] / (power.len() as f64 * sums[1]) } else { 1.0 }
}

/// Factor on sample `i` of `n` before the transform.
fn taper(i: usize, n: usize) -> f64 {
    let edge = (TAPER_SHARE * n as f64).max(1.0);
    let distance = (i.min(n - 1 - i) as f64 + 0.5) / edge;
    if distance >= 1.0 { 1.0 } else { 0.5 - 0.5 * (PI * distance).cos() }
}

/// Index of the first bin of the band and their number for `n` samples of `dt_s`.
fn bins(n: usize, dt_s: f64, band_hz: [f64; 2]) -> (usize, usize) {
    let step_hz = 1.0 / (n as f64 * dt_s);
    let high_hz = band_hz[1].min(HIGHEST_SHARE / dt_s);
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
    let window = strongest(&members, n, (MAX_DURATION_S / dt_s) as usize);
    let (first, count) = bins(window.len(), dt_s, settings.band_hz);
    if count < 8 {
        let what = format!("{:.1} s are too short for a band of {:?} Hz", n as f64 * dt_s, settings.band_hz);
        return Err(Error::new(what).at(place()));
    }
    let step_hz = 1.0 / (window.len() as f64 * dt_s);
    let transform = Transform { plan: transforms(window.len()).0, bins: first..first + count };
    let frequencies_hz: Vec<f64> = (0..count).map(|k| (first + k) as f64 * step_hz).collect();
    let tapered: f64 = (0..window.len()).map(|i| taper(i, window.len()).powi(2)).sum();
    let of = |(index, event): &(usize, &Event)| {
        let histories = std::iter::once(&event.input).chain(&event.outputs);
        let channels: Vec<Vec<C64>> = histories.map(|x| transform.tapered(&x[window.clone()])).collect();
        let noise = |(channel, noise): (&Vec<C64>, &NoiseSpectrum)| -> Vec<f64> {
            let largest = channel.iter().map(C64::norm_sqr).fold(0.0, f64::max);
            let floor = LEAST_NOISE * largest + f64::MIN_POSITIVE;
            frequencies_hz.iter().map(|f| tapered * noise.at(*f) / (2.0 * dt_s) + floor).collect()
        };
        let noise = channels.iter().zip(&event.noise).map(noise).collect();
        let lasting = channels.iter().map(|x| lasting_share(&history(x, first, window.len()), dt_s)).collect();
        let velocity: Vec<C64> =
            channels[0].iter().zip(&frequencies_hz).map(|(a, f)| a / C64::new(0.0, TAU * f)).collect();
        let velocity = history(&velocity, first, window.len());
        let peak = velocity.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let rms = rms(&velocity);
        let peak_factor = if rms > 0.0 { peak / rms } else { USUAL_PEAK_FACTOR };
        RecordSpectra { event: *index, window: window.clone(), channels, noise, lasting, peak_factor }
    };
    let records = members.iter().map(of).collect();
    Ok(Group { split: members[0].1.split, frequencies_hz, records, transform })
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn a_motion_lasts_as_long_as_its_envelope() {
        let (n, dt_s) = (4000, 0.01);
        let mut stream = random::stream(4, "envelope");
        let noise: Vec<f64> = (0..n).map(|_| StandardNormal.sample(&mut stream)).collect();
        let of = |envelope: &dyn Fn(f64) -> f64| {
            let motion: Vec<f64> = noise.iter().enumerate().map(|(i, v)| envelope(i as f64 * dt_s) * v).collect();
            lasting_share(&motion, dt_s)
        };
        let lasts_s = |share: f64| share * n as f64 * dt_s;
        // (∫ p)² / ∫ p²: the length of a box, 2√π σ of a normal power, twice the decay time of an exponential one.
        let cases: [(f64, f64); 3] = [
            (of(&|t| if (10.0..18.0).contains(&t) { 1.0 } else { 0.0 }), 8.0),
            (of(&|t| (-0.25 * ((t - 20.0) / 3.0).powi(2)).exp()), 6.0 * PI.sqrt()),
            (of(&|t| (-0.5 * t / 4.0).exp()), 8.0),
        ];
        for (share, expected_s) in cases {
            assert!((lasts_s(share) / expected_s - 1.0).abs() < 0.15, "{} s, {expected_s} s", lasts_s(share));
        }
        assert!(of(&|_| 1.0) > 0.95);
        assert!((lasting_share(&[0.0; 100], dt_s) - 1.0).abs() < 1e-12);
    }
}
