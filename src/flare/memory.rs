//! What the latent equations know of the shaking so far: slow measures of the base acceleration, beside its value.
//!
//! A soil that has been shaken is softer and damps more than one that has not, and a window of accelerations does not show
//! it. Each memory is a running root mean square of the normalised base acceleration, brought into 0…1:
//!
//! ```text
//! τ dE/dt = u² − E  (fading)    or    τ dE/dt = u²  (lasting),    E(0) = 0                                   (1)
//! m = √E / (1 + √E)                                                                                          (2)
//! ```
//!
//! It is known for any motion before anything is predicted, the same for simulations and events. The library offers its
//! products with the states and with `u`. Limits: one measure for the whole column; bounded, so that a motion beyond the
//! trained range changes the coefficients by no more than a factor.

use crate::error::Result;
use crate::numerics::spill::{Spill, Values};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Time constants of the memories.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Memories {
    /// Time constants τ of memories that fade (s).
    pub fading_s: Vec<f64>,
    /// Time constants τ of memories that last (s).
    pub lasting_s: Vec<f64>,
}

impl Memories {
    /// How many there are.
    pub fn count(&self) -> usize {
        self.fading_s.len() + self.lasting_s.len()
    }
}

/// What drives the latent equations: `u` and the memories, at the samples and half-way between.
#[derive(Debug, Clone, PartialEq)]
pub struct Drive {
    /// Values a sample: 1 and the number of memories.
    pub width: usize,
    /// `[n_step · width]`.
    pub at: Values<f32>,
    /// `[(n_step − 1) · width]`.
    pub half: Values<f32>,
}

impl Drive {
    /// The drive of a motion from its first sample, all of it multiplied by `factor`.
    pub fn new(memories: &Memories, step_s: f64, u: &[f32], u_half: &[f32], factor: f32) -> Self {
        let width = 1 + memories.count();
        let (mut at, mut half) = (vec![0.0; u.len() * width], vec![0.0; u_half.len() * width]);
        at.chunks_exact_mut(width).zip(u).for_each(|(row, u)| row[0] = u * factor);
        half.chunks_exact_mut(width).zip(u_half).for_each(|(row, u)| row[0] = u * factor);
        let kinds = memories.fading_s.iter().map(|t| (*t, true)).chain(memories.lasting_s.iter().map(|t| (*t, false)));
        for (m, (time_s, fades)) in kinds.enumerate() {
            let share = 0.5 * step_s / time_s;
            let keep = if fades { (-share).exp() } else { 1.0 };
            let gain = if fades { 1.0 - keep } else { share };
            let mut energy = 0.0_f64;
            let mut last = f64::from(at[0]);
            let mut advance = |next: f32| {
                let next = f64::from(next);
                energy = keep * energy + gain * 0.5 * (last * last + next * next); // (1)
                last = next;
                let size = energy.sqrt();
                (size / (1.0 + size)) as f32 // (2)
            };
            for t in 1..u.len() {
                half[(t - 1) * width + 1 + m] = advance(half[(t - 1) * width]);
                at[t * width + 1 + m] = advance(at[t * width]);
            }
        }
        Self { width, at: at.into(), half: half.into() }
    }

    /// The same, kept by `spill`.
    ///
    /// # Errors
    /// When it cannot be kept.
    pub fn kept(self, spill: &Spill) -> Result<Self> {
        Ok(Self { at: spill.keep(self.at.to_vec())?, half: spill.keep(self.half.to_vec())?, ..self })
    }

    /// Samples.
    pub fn n_step(&self) -> usize {
        self.at.len() / self.width.max(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steady(memories: &Memories, n: usize) -> Drive {
        Drive::new(memories, 0.05, &vec![2.0; n], &vec![2.0; n - 1], 1.0)
    }

    #[test]
    fn a_fading_memory_tends_to_the_mean_square_and_a_lasting_one_grows_with_the_energy() {
        let memories = Memories { fading_s: vec![0.5], lasting_s: vec![4.0] };
        let drive = steady(&memories, 201);
        let last = &drive.at[200 * 3..];
        assert_eq!(last[0], 2.0);
        assert!((f64::from(last[1]) - 2.0 / 3.0).abs() < 1e-6, "{}", last[1]);
        let energy = 4.0_f64 * 10.0 / 4.0;
        assert!((f64::from(last[2]) - energy.sqrt() / (1.0 + energy.sqrt())).abs() < 1e-6, "{}", last[2]);
        // after one time constant, 1 − 1/e of the mean square
        let size = (4.0 * (1.0 - (-1.0_f64).exp())).sqrt();
        assert!((f64::from(drive.at[10 * 3 + 1]) - size / (1.0 + size)).abs() < 1e-6);
    }

    #[test]
    fn the_sign_of_a_motion_does_not_change_its_memories() {
        let memories = Memories { fading_s: vec![1.0], lasting_s: vec![] };
        let u: Vec<f32> = (0..50).map(|i| (i as f32 * 0.7).sin()).collect();
        let turn = |sign: f32| Drive::new(&memories, 0.05, &u, &u[..49], sign);
        let (a, b) = (turn(1.0), turn(-1.0));
        for t in 0..50 {
            assert_eq!(a.at[2 * t], -b.at[2 * t]);
            assert_eq!(a.at[2 * t + 1], b.at[2 * t + 1]);
        }
    }
}
