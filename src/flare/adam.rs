//! Adam with a learning rate per group of parameters, and the schedule of the rate over the epochs.

use super::kernels::{Kernel, dispatch};
use std::ops::Range;

/// First and second moments of the gradient, and how many steps were taken since the last restart.
#[derive(Debug, Clone, PartialEq)]
pub struct Adam {
    /// First moments.
    pub first: Vec<f32>,
    /// Second moments.
    pub second: Vec<f32>,
    /// Steps since the last restart.
    pub step: u32,
}

const BETA_1: f32 = 0.9;
const BETA_2: f32 = 0.999;
const EPSILON: f32 = 1e-8;

impl Adam {
    /// An optimiser that has taken no step.
    pub fn new(n: usize) -> Self {
        Self { first: vec![0.0; n], second: vec![0.0; n], step: 0 }
    }

    /// Forgets all moments, as after a change of the sparsity mask.
    pub fn restart(&mut self) {
        *self = Self::new(self.first.len());
    }

    /// One step down `gradient`; each group has its own rate. A gradient longer than `clip` is shortened to it first.
    pub fn update(&mut self, parameters: &mut [f32], gradient: &[f32], groups: &[(Range<usize>, f64)], clip: f64) {
        let norm = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        if !norm.is_finite() {
            return; // a step along no number would destroy the model; the next batch has another gradient
        }
        let scale = if norm > clip { (clip / norm) as f32 } else { 1.0 };
        self.step += 1;
        let correction_1 = 1.0 - f64::from(BETA_1).powi(self.step as i32);
        let correction_2 = (1.0 - f64::from(BETA_2).powi(self.step as i32)).sqrt() as f32;
        for (range, rate) in groups {
            dispatch(Step {
                first: &mut self.first[range.clone()],
                second: &mut self.second[range.clone()],
                parameters: &mut parameters[range.clone()],
                gradient: &gradient[range.clone()],
                scale,
                rate: (rate / correction_1) as f32,
                correction_2,
            });
        }
    }
}

/// One step of a group of parameters.
struct Step<'a> {
    first: &'a mut [f32],
    second: &'a mut [f32],
    parameters: &'a mut [f32],
    gradient: &'a [f32],
    scale: f32,
    rate: f32,
    correction_2: f32,
}

impl Kernel for Step<'_> {
    type Out = ();
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let state = self.first.iter_mut().zip(self.second);
        for ((p, g), (m, v)) in self.parameters.iter_mut().zip(self.gradient).zip(state) {
            let g = g * self.scale;
            *m = BETA_1 * *m + (1.0 - BETA_1) * g;
            *v = BETA_2 * *v + (1.0 - BETA_2) * g * g;
            *p -= self.rate * *m / (v.sqrt() / self.correction_2 + EPSILON);
        }
    }
}

/// Factor on the learning rate at `progress` in 0…1: half a cosine from 1 down to `last`.
pub fn cosine(progress: f64, last: f64) -> f64 {
    last + (1.0 - last) * 0.5 * (1.0 + (std::f64::consts::PI * progress.clamp(0.0, 1.0)).cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adam_finds_the_minimum_of_a_badly_scaled_bowl() {
        let scales = [1.0, 100.0, 0.01];
        let mut p = vec![1.0_f32, -1.0, 2.0];
        let mut adam = Adam::new(3);
        for i in 0..4000 {
            let gradient: Vec<f32> = p.iter().zip(&scales).map(|(p, s)| p * s).collect();
            adam.update(&mut p, &gradient, &[(0..3, 0.01 * cosine(f64::from(i) / 4000.0, 0.01))], 1e9);
        }
        assert!(p.iter().all(|p| p.abs() < 1e-3), "{p:?}");
    }

    #[test]
    fn a_gradient_that_is_no_number_leaves_the_parameters_alone() {
        let mut p = vec![1.0_f32];
        Adam::new(1).update(&mut p, &[f32::NAN], &[(0..1, 0.1)], 1.0);
        assert_eq!(p, [1.0]);
    }

    #[test]
    fn the_schedule_falls_from_one_to_its_last_value() {
        assert_eq!(cosine(0.0, 0.05), 1.0);
        assert!((cosine(1.0, 0.05) - 0.05).abs() < 1e-12);
    }
}
