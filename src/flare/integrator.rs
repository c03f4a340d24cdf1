//! Runge–Kutta rollout of the latent equations for a group of sequences side by side, bounded.
//!
//! ```text
//! z_{t+1} = z_t + (k_1 + 2 k_2 + 2 k_3 + k_4)/6                            (1)
//! k_1 = f(z_t, u_t),  k_2 = f(z_t + k_1/2, u_{t+½}),  k_3 = f(z_t + k_2/2, u_{t+½}),  k_4 = f(z_t + k_3, u_{t+1})
//! ```
//!
//! Time is counted in samples, so the step is 1 and coefficients are of order one; the model turns them into 1/s. A state
//! beyond the bound, or no number at all, ends its lane there: what follows is held at zero and counts as not predicted. Soft
//! limits ([`super::limits`]) act on the state of every stage and on the new state.

use super::kernels::{Kernel, LANES, Lanes, dispatch};
use super::library::Library;
use super::limits::Limits;
use super::memory::Drive;
use std::ops::Range;

/// What drives a group: base acceleration and memories at the samples and half-way between, and how long each lane lasts.
#[derive(Debug, Clone, Default)]
pub struct Forcing {
    /// Values a sample.
    pub width: usize,
    /// `[n_step · width]`.
    pub at: Vec<Lanes>,
    /// `[(n_step − 1) · width]`.
    pub half: Vec<Lanes>,
    /// Samples of each lane, at most `n_step`; 0 for an unused lane.
    pub length: [usize; LANES],
}

impl Forcing {
    /// Zeroes everything for `n_step` samples and no lane in use.
    pub fn reset(&mut self, n_step: usize, width: usize) {
        self.width = width;
        self.at.clear();
        self.at.resize(n_step * width, Lanes::ZERO);
        self.half.clear();
        self.half.resize(n_step.saturating_sub(1) * width, Lanes::ZERO);
        self.length = [0; LANES];
    }

    /// Samples of the longest lane.
    pub fn n_step(&self) -> usize {
        self.at.len() / self.width.max(1)
    }

    /// Puts samples `range` of a drive into `lane`, the base acceleration multiplied by `sign`.
    pub fn set(&mut self, lane: usize, drive: &Drive, range: Range<usize>, sign: f32) {
        self.length[lane] = range.len();
        let w = self.width;
        let halves = range.start * w..range.end.saturating_sub(1).max(range.start) * w;
        for (to, from) in
            [(&mut self.at, &drive.at[range.start * w..range.end * w]), (&mut self.half, &drive.half[halves])]
        {
            for (i, (to, from)) in to.iter_mut().zip(from).enumerate() {
                to.0[lane] = if i % w == 0 { from * sign } else { *from };
            }
        }
    }

    /// The drive of Runge–Kutta stage `s` of the step that ends at sample `t`.
    #[inline(always)]
    pub fn stage(&self, t: usize, s: usize) -> &[Lanes] {
        let w = self.width;
        match s {
            0 => &self.at[(t - 1) * w..t * w],
            1 | 2 => &self.half[(t - 1) * w..t * w],
            _ => &self.at[t * w..(t + 1) * w],
        }
    }
}

/// A rolled-out group with what the reverse pass needs.
#[derive(Debug, Clone, Default)]
pub struct Trajectory {
    /// States `[n_step · r]`.
    pub z: Vec<Lanes>,
    /// The four stage states of each step, `[(n_step − 1) · 4 · r]`.
    pub stages: Vec<Lanes>,
    /// Samples of each lane that are valid: its length, or fewer where it left the bound.
    pub valid: [usize; LANES],
    /// The limits it was rolled out with.
    pub limits: Limits,
}

struct Rollout<'a> {
    library: Library,
    xi: &'a [f32],
    forcing: &'a Forcing,
    to: &'a mut Trajectory,
}

/// Rolls the group out from `z0[r]` through `forcing`, in place in `to`, until a state leaves `bound`.
pub fn rollout(library: Library, xi: &[f32], z0: &[Lanes], forcing: &Forcing, bound: f32, to: &mut Trajectory) {
    rollout_limited(library, xi, z0, forcing, &Limits::hard(bound), to);
}

/// As [`rollout`], with soft limits on the states.
pub fn rollout_limited(
    library: Library,
    xi: &[f32],
    z0: &[Lanes],
    forcing: &Forcing,
    limits: &Limits,
    to: &mut Trajectory,
) {
    to.limits.clone_from(limits);
    let r = library.latent;
    let n_step = forcing.n_step();
    to.z.clear();
    to.z.resize(n_step * r, Lanes::ZERO);
    to.stages.clear();
    to.stages.resize(n_step.saturating_sub(1) * 4 * r, Lanes::ZERO);
    to.valid = forcing.length;
    if n_step > 0 {
        to.z[..r].copy_from_slice(z0);
        limits.apply(&mut to.z[..r]);
        end_lanes(&mut to.z[..r], &mut [], 0, limits.bound, &mut to.valid);
    }
    dispatch(Rollout { library, xi, forcing, to });
}

impl Kernel for Rollout<'_> {
    type Out = ();
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let r = self.library.latent;
        let n_step = self.forcing.n_step();
        let mut theta = vec![Lanes::ZERO; self.library.n_term()];
        let mut slope = vec![Lanes::ZERO; r];
        let mut sum = vec![Lanes::ZERO; r];
        for t in 1..n_step {
            let (past, next) = self.to.z.split_at_mut(t * r);
            let (z, next) = (&past[(t - 1) * r..], &mut next[..r]);
            let stages = &mut self.to.stages[(t - 1) * 4 * r..t * 4 * r];
            sum.fill(Lanes::ZERO);
            stages[..r].copy_from_slice(z);
            for (s, (ahead, weight)) in [(0.5, 1.0), (0.5, 2.0), (1.0, 2.0), (0.0, 1.0)].into_iter().enumerate() {
                self.library.terms(&stages[s * r..(s + 1) * r], self.forcing.stage(t, s), &mut theta);
                self.library.combine::<FMA>(&theta, self.xi, &mut slope);
                for k in 0..r {
                    sum[k].add_scaled::<FMA>(&slope[k], weight);
                    if s < 3 {
                        let mut ahead_state = z[k];
                        ahead_state.add_scaled::<FMA>(&slope[k], ahead);
                        stages[(s + 1) * r + k] = ahead_state;
                    }
                }
                if s < 3 {
                    self.to.limits.apply(&mut stages[(s + 1) * r..(s + 2) * r]);
                }
            }
            for k in 0..r {
                next[k] = z[k];
                next[k].add_scaled::<FMA>(&sum[k], 1.0 / 6.0); // (1)
            }
            self.to.limits.apply(next);
            end_lanes(next, stages, t, self.to.limits.bound, &mut self.to.valid);
        }
    }
}

/// Ends lanes that left the bound at sample `t` and zeroes whatever lies past the end of a lane.
#[inline(always)]
fn end_lanes(state: &mut [Lanes], stages: &mut [Lanes], t: usize, bound: f32, valid: &mut [usize; LANES]) {
    let mut inside = [true; LANES];
    for z in state.iter() {
        for (inside, z) in inside.iter_mut().zip(&z.0) {
            *inside &= z.abs() <= bound;
        }
    }
    for lane in 0..LANES {
        if !inside[lane] {
            valid[lane] = valid[lane].min(t);
        }
        if t >= valid[lane] {
            state.iter_mut().chain(stages.iter_mut()).for_each(|z| z.0[lane] = 0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A damped oscillator `z1' = z2, z2' = −ω² z1 − 2ζω z2 + u` in units of `step`.
    fn oscillator(step: f64) -> Vec<f32> {
        let library = Library { latent: 2, memories: 0, energies: 0 };
        let mut xi = vec![0.0; library.n_coefficient()];
        let (omega, zeta) = (3.0, 0.05);
        xi[2 * 2] = step as f32;
        xi[2 + 1] = (-omega * omega * step) as f32;
        xi[2 * 2 + 1] = (-2.0 * zeta * omega * step) as f32;
        xi[library.input_row() * 2 + 1] = step as f32;
        xi
    }

    fn roll(step: f64, n_step: usize) -> f64 {
        let u = |t: f64| (2.0 * t).sin() as f32;
        let series: Vec<f32> = (0..n_step).map(|i| u(i as f64 * step)).collect();
        let half: Vec<f32> = (0..n_step - 1).map(|i| u((i as f64 + 0.5) * step)).collect();
        let mut forcing = Forcing::default();
        forcing.reset(n_step, 1);
        forcing.set(5, &Drive { width: 1, at: series.into(), half: half.into() }, 0..n_step, 1.0);
        let mut to = Trajectory::default();
        rollout(
            Library { latent: 2, memories: 0, energies: 0 },
            &oscillator(step),
            &[Lanes::ZERO; 2],
            &forcing,
            1e3,
            &mut to,
        );
        assert_eq!(to.valid[5], n_step);
        f64::from(to.z[(n_step - 1) * 2].0[5])
    }

    #[test]
    fn rollout_is_fourth_order_in_the_step() {
        let exact = roll(0.005, 801);
        let coarse = (roll(0.2, 21) - exact).abs();
        let fine = (roll(0.1, 41) - exact).abs();
        let slope = (coarse / fine).log2();
        assert!(slope > 3.6 && slope < 4.6, "order {slope}, errors {coarse:e} and {fine:e}");
    }

    #[test]
    fn a_diverging_lane_ends_and_leaves_its_neighbours_alone() {
        let library = Library { latent: 1, memories: 0, energies: 0 };
        let xi = [0.0, 0.0, 1.0, 0.0]; // z' = z², finite-time blow-up from a positive start
        let mut forcing = Forcing::default();
        forcing.reset(50, 1);
        let still = Drive { width: 1, at: vec![0.0; 50].into(), half: vec![0.0; 49].into() };
        forcing.set(0, &still, 0..50, 1.0);
        forcing.set(1, &still, 0..50, 1.0);
        let mut z0 = [Lanes::ZERO];
        z0[0].0[0] = 0.5;
        z0[0].0[1] = -0.5;
        let mut to = Trajectory::default();
        rollout(library, &xi, &z0, &forcing, 100.0, &mut to);
        assert!(to.valid[0] < 10, "ended at {}", to.valid[0]);
        assert_eq!(to.valid[1], 50);
        assert_eq!(to.valid[2], 0);
        assert!(to.z.iter().chain(&to.stages).all(|z| z.0.iter().all(|v| v.is_finite())));
        assert!((f64::from(to.z[49].0[1]) + 1.0 / (2.0 + 49.0)).abs() < 1e-3);
    }
}
