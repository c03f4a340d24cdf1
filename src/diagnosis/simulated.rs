//! Twins of an array on the fast column: the same events, split and noise, and a truth of one's own.

use super::noise::{drawn, normal};
use super::problem::{Event, Problem};
use super::responses::Scene;
use super::spectra::{self, smoothed};
use super::unknowns::Placed;
use crate::effects::{self, Direction, Effect, Recording};
use crate::error::Result;
use crate::numerics::random;
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// What a twin's records carry beside the motion.
#[derive(Clone, Copy)]
pub struct Disturbance<'b> {
    /// Seed of the noise; `None` records without noise.
    pub seed: Option<u64>,
    /// Random error of the motions of the output sensors, as a share of their smoothed spectra; what the column makes of noise
    /// in its input comes on top.
    pub model_error: f64,
    /// Nuisances of the truth, prior standard deviations: where the nonlinear column has been replayed around the declared
    /// soil, these replays make the motions.
    pub deviations: Option<&'b [f64]>,
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
                motions[0].push(event.input[record.window.clone()].to_vec());
                let soil = disturbance.deviations.map(Placed::plain);
                let replayed = soil.and_then(|n| self.neighbours.as_ref()?.motions([g, r], &n));
                let computed = replayed.unwrap_or_else(|| self.motions(truth, [g, r], &responses));
                let count = array.outputs.len();
                let propagated = self.propagated.get(g).map_or(&[][..], |g| &g[r]);
                for (s, (motion, mut history)) in motions[1..].iter_mut().zip(computed).enumerate() {
                    if let Some(random) = &mut random {
                        let bins = self.windowed(g, &history);
                        let share = disturbance.model_error * disturbance.model_error;
                        let power = smoothed(&bins, half).into_iter().enumerate();
                        let power =
                            power.map(|(k, p)| share * p + propagated.get(k * count + s).copied().unwrap_or_default());
                        let error: Vec<C64> = power.map(|p| normal(random) * p.sqrt()).collect();
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
            let noise = drawn(&event.noise[s], history.len(), event.dt_s, &mut random);
            history.iter_mut().zip(noise).for_each(|(x, n)| *x += n);
        }
        history
    });
    let mut noisy: Vec<Vec<f64>> = noisy.collect();
    event.input = noisy.remove(0);
    event.outputs = noisy;
}
