//! Twins of an array on the fast column: the same events, split and noise, and a truth of one's own.

use super::anchor::Anchor;
use super::problem::{Event, NoiseSpectrum, Problem};
use super::responses::{DISTRUST, Scene};
use super::spectra::{self, smoothed};
use crate::effects::{self, Direction, Effect, Recording};
use crate::error::Result;
use crate::numerics::random;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use realfft::RealFftPlanner;
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// What a twin's records carry beside the motion.
#[derive(Clone, Copy)]
pub struct Disturbance<'b> {
    /// Seed of the noise; `None` records without noise.
    pub seed: Option<u64>,
    /// Random error of the motions of the output sensors, as a share of their smoothed spectra.
    pub model_error: f64,
    /// What the nonlinear column does beyond the fast one: a random share of it is an error of the motions too, alike at all
    /// sensors of a record, since that is how an extrapolation by the fast column goes wrong.
    pub beyond: Option<&'b Anchor>,
}

impl Scene<'_> {
    /// The problem as it would be if `truth` held: recorded inputs become true base motions, and every sensor records
    /// what the fast column makes of them.
    ///
    /// # Errors
    /// When the column of the truth cannot be built.
    pub fn simulated(&self, truth: &[Box<dyn Effect>], disturbance: Disturbance<'_>) -> Result<Problem> {
        let all: Vec<usize> = (0..self.groups.len()).collect();
        let responses = self.responses(truth, &all, None)?;
        let array = &self.problem.array;
        let mut problem = self.problem.clone();
        let names: Vec<String> = array.sensors().map(String::from).collect();
        let depths_m: Vec<f64> =
            std::iter::once(array.profile.depth_m()).chain(array.depths_m.iter().copied()).collect();
        for (g, group) in self.groups.iter().enumerate() {
            let step_hz = group.frequencies_hz[1] - group.frequencies_hz[0];
            let first = (group.frequencies_hz[0] / step_hz).round() as usize;
            let half = (spectra::SMOOTH_HZ / step_hz).round() as usize;
            let mut motions: Vec<Vec<Vec<f64>>> = vec![Vec::new(); names.len()];
            let mut components = Vec::new();
            for (r, record) in group.records.iter().enumerate() {
                let event = &self.problem.events[record.event];
                components.push(array.components.get(event.component()).cloned().unwrap_or_default());
                let n = record.window.len();
                let mut random = disturbance
                    .seed
                    .map(|seed| random::stream(seed, &format!("model {} {}", event.name, event.component())));
                let beyond = disturbance.beyond.and_then(|a| a.records[g][r].as_ref());
                let share = random.as_mut().map_or(C64::default(), |random| normal(random) * DISTRUST);
                motions[0].push(event.input[record.window.clone()].to_vec());
                let computed = self.motions(truth, [g, r], &responses);
                let count = computed.len();
                for (s, (motion, mut history)) in motions[1..].iter_mut().zip(computed).enumerate() {
                    if let Some(random) = &mut random {
                        let bins = self.windowed(g, &history);
                        let power = smoothed(&bins, half);
                        let rest = |k: usize| beyond.map_or(C64::default(), |a| share * a.rest[k * count + s]);
                        let own = |p: &f64| disturbance.model_error * p.sqrt();
                        let error: Vec<C64> =
                            power.iter().enumerate().map(|(k, p)| normal(random) * own(p) + rest(k)).collect();
                        history.iter_mut().zip(spectra::history(&error, first, n)).for_each(|(x, e)| *x += e);
                    }
                    motion.push(history);
                }
            }
            let event = &self.problem.events[group.records[0].event];
            let recording = Recording {
                event: &event.name,
                dt_s: event.dt_s,
                sensors: &names,
                depths_m: &depths_m,
                components: &components,
            };
            let recorded = effects::observe(&recording, &motions, truth, Direction::Distort);
            for (r, record) in group.records.iter().enumerate() {
                let event = &mut problem.events[record.event];
                let channels: Vec<Vec<f64>> = recorded.iter().map(|sensor| sensor[r].clone()).collect();
                write(event, channels, disturbance.seed);
            }
        }
        Ok(problem)
    }
}

fn write(event: &mut Event, channels: Vec<Vec<f64>>, seed: Option<u64>) {
    let label = format!("noise {} {}", event.name, event.component());
    let noisy = channels.into_iter().enumerate().map(|(s, mut history)| {
        if let Some(seed) = seed {
            let mut random = random::stream(seed, &format!("{label} {s}"));
            let noise = noise(&event.noise[s], history.len(), event.dt_s, &mut random);
            history.iter_mut().zip(noise).for_each(|(x, n)| *x += n);
        }
        history
    });
    let mut noisy: Vec<Vec<f64>> = noisy.collect();
    event.input = noisy.remove(0);
    event.outputs = noisy;
}

/// A Gaussian history of this density.
fn noise(spectrum: &NoiseSpectrum, n: usize, dt_s: f64, random: &mut impl Rng) -> Vec<f64> {
    let plan = RealFftPlanner::<f64>::new().plan_fft_inverse(n);
    let mut bins = plan.make_input_vec();
    let last = bins.len() - 1;
    for (k, bin) in bins.iter_mut().enumerate() {
        let power = spectrum.at(k as f64 / (n as f64 * dt_s)) * n as f64 / (2.0 * dt_s);
        *bin = normal(random) * power.sqrt();
        if k == 0 || (k == last && n.is_multiple_of(2)) {
            *bin = C64::new(bin.re * std::f64::consts::SQRT_2, 0.0);
        }
    }
    let mut out = vec![0.0; n];
    if plan.process(&mut bins, &mut out).is_err() {
        return out;
    }
    out.iter().map(|x| x / n as f64).collect()
}

/// A complex number of unit variance.
fn normal(random: &mut impl Rng) -> C64 {
    let mut draw = || -> f64 { StandardNormal.sample(random) };
    C64::new(draw(), draw()) * std::f64::consts::FRAC_1_SQRT_2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawn_noise_has_its_density() {
        let white = NoiseSpectrum::white(0.02, 0.01);
        let x = noise(&white, 20_000, 0.01, &mut random::stream(3, "test"));
        let rms = (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt();
        assert!((rms / 0.02 - 1.0).abs() < 0.02, "{rms}");
        assert!((white.at(3.3) * 0.5 / 0.01 - 4e-4).abs() < 1e-12);
    }
}
