//! Events as they are compared below the first resonance.

use super::super::problem::{Event, Motions, Problem};
use super::column::{first_order_s2, travel_s};
use realfft::RealFftPlanner;
use realfft::num_complex::Complex;
use std::f64::consts::PI;

type C64 = Complex<f64>;
/// Both components by bin.
type Bins = Vec<[C64; 2]>;

/// Highest frequency used over the declared first resonance, at most.
const SHARE_OF_RESONANCE: f64 = 0.55;
/// Fewest events that tell anything.
pub const FEWEST: usize = 4;
/// Fewest bins of an event that do.
const BINS: usize = 5;
/// Share of noise in the input's power beyond which an event is left out.
const NOISIEST: f64 = 0.2;
/// Share of each end that is tapered.
const TAPER_SHARE: f64 = 0.04;
/// ξ₀: damping ratio of a column that was not replayed.
const DAMPING: f64 = 0.05;
/// Share of the bins that tell how soft an event has made the column.
const SOFTENED: f64 = 1.0 / 3.0;
/// Travel time to a sensor over that to the base beyond which nothing is compared.
pub const DEEPEST: f64 = 0.95;

/// One event on the bins below the limit.
pub struct Shot {
    pub frequencies_hz: Vec<f64>,
    pub input: Bins,
    pub outputs: Vec<Bins>,
    /// h₀ U of each output sensor.
    pub passed: Vec<Bins>,
    /// a₀ of each output sensor.
    pub a0: Vec<f64>,
    pub components: usize,
}

/// What a declared column does below its resonance.
pub struct Declared<'a> {
    problem: &'a Problem,
    /// Its motions in every event, where it was replayed.
    replays: Option<&'a Motions>,
    /// a₀ and r of each output sensor.
    pub shapes: Vec<[f64; 2]>,
    /// Lowest and highest frequency.
    band_hz: [f64; 2],
}

impl<'a> Declared<'a> {
    /// The column of `problem` from `low_hz` to about half its first resonance.
    pub fn new(problem: &'a Problem, replays: Option<&'a Motions>, low_hz: f64) -> Self {
        let profile = &problem.array.profile;
        let whole_s = travel_s(profile, profile.depth_m());
        let shape = |depth_m: &f64| [first_order_s2(profile, *depth_m), travel_s(profile, *depth_m) / whole_s];
        Self {
            problem,
            replays,
            shapes: problem.array.depths_m.iter().map(shape).collect(),
            band_hz: [low_hz, SHARE_OF_RESONANCE * 0.25 / whole_s],
        }
    }

    /// Events with enough bins and little noise; a component alone stands first.
    pub fn shots(&self) -> Vec<Shot> {
        let mut names: Vec<&str> = Vec::new();
        for event in &self.problem.events {
            if !names.contains(&event.name.as_str()) {
                names.push(&event.name);
            }
        }
        names.iter().filter_map(|name| self.shot(name)).collect()
    }

    fn shot(&self, name: &str) -> Option<Shot> {
        let mut members: Vec<_> = self.problem.events.iter().enumerate().filter(|(_, e)| e.name == name).collect();
        members.sort_by_key(|(_, e)| e.component());
        members.truncate(2);
        // A second component alone cannot be told from the first, so such an event would only confuse signs.
        if members.len() < self.problem.array.components.len().min(2) {
            return None;
        }
        let dt_s = members[0].1.dt_s;
        let n = members.iter().map(|(_, e)| e.input.len()).min()?;
        let step_hz = 1.0 / (n as f64 * dt_s);
        let [low_hz, high_hz] = self.band_hz;
        let first = (low_hz / step_hz).ceil() as usize;
        let last = (high_hz / step_hz).floor() as usize;
        if members.iter().any(|(_, e)| e.dt_s != dt_s) || last + 1 < first + BINS || last > n / 2 {
            return None;
        }
        let plan = RealFftPlanner::<f64>::new().plan_fft_forward(n);
        let spectrum = |x: &Vec<f64>| {
            let x = x.get(..n)?;
            let mean = x.iter().sum::<f64>() / n as f64;
            let mut tapered: Vec<f64> = x.iter().enumerate().map(|(i, v)| (v - mean) * taper(i, n)).collect();
            let mut out = plan.make_output_vec();
            plan.process(&mut tapered, &mut out).ok()?;
            Some(out[first..=last].to_vec())
        };
        let both = |histories: &[Option<&Vec<f64>>]| -> Option<Bins> {
            let one = spectrum((*histories.first()?)?)?;
            let other = match histories.get(1) {
                Some(history) => spectrum((*history)?)?,
                None => vec![C64::default(); one.len()],
            };
            Some(one.into_iter().zip(other).map(|(a, b)| [a, b]).collect())
        };
        let every = |events: &[Option<&Vec<Vec<f64>>>]| -> Option<Vec<Bins>> {
            let of = |s: usize| both(&events.iter().map(|e| e.and_then(|e| e.get(s))).collect::<Vec<_>>());
            (0..self.shapes.len()).map(of).collect()
        };
        let input = both(&members.iter().map(|(_, e)| Some(&e.input)).collect::<Vec<_>>())?;
        let outputs = every(&members.iter().map(|(_, e)| Some(&e.outputs)).collect::<Vec<_>>())?;
        let frequencies_hz: Vec<f64> = (first..=last).map(|k| k as f64 * step_hz).collect();
        let weight: f64 = (0..n).map(|i| taper(i, n).powi(2)).sum();
        let density = |e: &Event| frequencies_hz.iter().map(|f| weight * e.noise[0].at(*f) / (2.0 * dt_s)).sum::<f64>();
        let power: f64 = input.iter().flatten().map(C64::norm_sqr).sum();
        let noise = members.iter().map(|(_, e)| density(e)).sum::<f64>() / power;
        let passed = match self.replays {
            Some(replays) => every(&members.iter().map(|(i, _)| replays.get(*i)?.as_ref()).collect::<Vec<_>>())?,
            None => self.uniform(&input, &frequencies_hz, 1.0 - noise),
        };
        let mut shot = Shot {
            a0: self.shapes.iter().map(|[a0, _]| *a0).collect(),
            frequencies_hz,
            input,
            outputs,
            passed,
            components: members.len(),
        };
        let softer = self.replays.map_or(1.0, |_| self.soften(&mut shot));
        shot.end_at(high_hz / softer.sqrt());
        (noise < NOISIEST && shot.frequencies_hz.len() >= BINS).then_some(shot)
    }

    /// A `share` of (2) of [`super::passed`] under the `input`.
    fn uniform(&self, input: &[[C64; 2]], frequencies_hz: &[f64], share: f64) -> Vec<Bins> {
        let of = |[a0, ratio]: &[f64; 2]| {
            let at = |(u, f): (&[C64; 2], &f64)| u.map(|u| u * (ln_h(a0 * f * f, *ratio, [0.0; 3]).exp() * share));
            input.iter().zip(frequencies_hz).map(at).collect()
        };
        self.shapes.iter().map(of).collect()
    }

    /// Gives `shot` the a₀ of its own motions; by how much these are larger than the declared ones, for most sensors.
    fn soften(&self, shot: &mut Shot) -> f64 {
        let count = ((SOFTENED * shot.frequencies_hz.len() as f64) as usize).max(BINS);
        let mut factors = Vec::new();
        for ((a0, passed), [declared, ratio]) in shot.a0.iter_mut().zip(&shot.passed).zip(&self.shapes) {
            let (mut product, mut square) = (0.0, 0.0);
            for ((f, u), y) in shot.frequencies_hz.iter().zip(&shot.input).zip(passed).take(count) {
                for (u, y) in u.iter().zip(y) {
                    product += f * f * ((y - u) * u.conj()).re;
                    square += f.powi(4) * u.norm_sqr();
                }
            }
            let factor = product / square / declared;
            if *ratio < DEEPEST && factor.is_finite() {
                *a0 = declared * factor.max(1.0);
                factors.push(factor.max(1.0));
            }
        }
        factors.sort_by(f64::total_cmp);
        factors.get(factors.len() / 2).copied().unwrap_or(1.0)
    }
}

impl Shot {
    /// Leaves out what lies beyond a frequency.
    fn end_at(&mut self, high_hz: f64) {
        let count = self.frequencies_hz.iter().filter(|f| **f <= high_hz).count();
        self.frequencies_hz.truncate(count);
        self.input.truncate(count);
        self.outputs.iter_mut().chain(&mut self.passed).for_each(|bins| bins.truncate(count));
    }
}

/// (2) of [`super::passed`] for a₀ f² = `a`, with ln a/a₀, ξ − ξ₀ and κ − 1.
pub fn ln_h(a: f64, ratio: f64, [ln_a, xi, kappa]: [f64; 3]) -> C64 {
    let uniform = (1.0 + ratio * ratio) / (1.0 - ratio * ratio) / 3.0;
    let a = a * ln_a.exp();
    C64::new(a, -2.0 * (DAMPING + xi) * a) + C64::new(1.0, -4.0 * (DAMPING + xi)) * ((1.0 + kappa) * uniform * a * a)
}

fn taper(i: usize, n: usize) -> f64 {
    let x = (i.min(n - 1 - i) as f64 + 0.5) / (TAPER_SHARE * n as f64).max(1.0);
    if x >= 1.0 { 1.0 } else { 0.5 - 0.5 * (PI * x).cos() }
}
