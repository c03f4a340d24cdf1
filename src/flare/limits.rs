//! Where latent states may go: a hard bound that ends a rollout, and a soft limit that keeps one from ever reaching it.
//!
//! Quadratic equations can blow up in finite time wherever the simulations have not been. Each state is therefore passed
//! through a smooth limit after every stage of every step,
//!
//! ```text
//! s(x) = x                                for |x| ≤ a
//! s(x) = sgn x · a (1 + t/(1 + t))        for |x| > a,   t = |x|/a − 1                                       (1)
//! s'   = 1/(1 + t)² = (2 − |s|/a)²                                                                          (2)
//! ```
//!
//! so that |s| ≤ 2a whatever happens: no finite input makes a rollout diverge, however strong or long. `a` is a multiple of
//! the range that state had in the training simulations; a rollout that stays below is the same to the last bit. Limits of
//! this: beyond `a` the response is bounded, not right.
//!
//! The twenty validation motions of Lotung, doubled, or ten times in a row (peak against the plain rollout, and last repetition
//! against the first; a first source model with memories and energies):
//!
//! | a over range | doubled: finite | largest | tenfold: finite | largest | median NRMSE, strongest motions |
//! |--------------|-----------------|---------|-----------------|---------|---------------------------------|
//! | none         | 16 of 20        |         | 19 of 20        |         | 48 48 39 44 45 40 %             |
//! | 1.5          | 20              | 13.2    | 20              | 17.0    | 48 48 39 44 45 40 %             |
//! | 1            | 20              | 7.3     | 20              | 10.1    | 48 48 39 44 45 40 %             |
//! | 0.75         | 20              | 2.1     | 20              | 1.2     | 48 48 40 44 45 40 %             |
//! | 0.5          | 20              | 1.9     | 20              | 1.0     | 47 47 44 46 46 40 %             |
//!
//! With room to spare the equations settle on states far outside, bounded but wrong; with 0.75 they come back.

use super::kernels::{LANES, Lanes};

/// A hard bound, and for each state where its soft limit begins (empty for none).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Limits {
    /// States beyond this end their rollout.
    pub bound: f32,
    /// `a` of equation (1), one a state.
    pub soft: Vec<f32>,
}

impl Limits {
    /// The hard bound alone.
    pub fn hard(bound: f32) -> Self {
        Self { bound, soft: Vec::new() }
    }

    /// Limits `state[r]` (1).
    #[inline(always)]
    pub fn apply(&self, state: &mut [Lanes]) {
        for (x, a) in state.iter_mut().zip(&self.soft) {
            if x.0.iter().any(|x| x.abs() > *a) {
                for x in &mut x.0 {
                    let t = (x.abs() / a - 1.0).clamp(0.0, 1e30);
                    let limited = (a + a * (t / (1.0 + t))).copysign(*x);
                    *x = if x.abs() > *a { limited } else { *x };
                }
            }
        }
    }

    /// Multiplies the cotangent of the limited `state` by the slope of the limit (2).
    #[inline(always)]
    pub fn pull_back(&self, state: &[Lanes], cotangent: &mut [Lanes]) {
        for (k, cotangent) in cotangent.iter_mut().enumerate().take(self.soft.len()) {
            if let Some(slope) = self.slope(state, k) {
                *cotangent = Lanes::product(cotangent, &slope);
            }
        }
    }

    /// Slope of the limit of state `k` at the limited `state`, where any lane is beyond.
    #[inline(always)]
    pub fn slope(&self, state: &[Lanes], k: usize) -> Option<Lanes> {
        let a = *self.soft.get(k)?;
        let is_beyond: [bool; LANES] = state[k].0.map(|s| s.abs() > a);
        is_beyond.contains(&true).then(|| {
            let mut slope = Lanes::splat(1.0);
            for (slope, s) in slope.0.iter_mut().zip(&state[k].0) {
                let left = (2.0 - s.abs() / a).clamp(0.0, 1.0);
                *slope = left * left;
            }
            slope
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_limit_is_the_identity_inside_smooth_at_its_beginning_and_bounded_everywhere() {
        let limits = Limits { bound: 1e3, soft: vec![1.5] };
        let limited = |x: f32| {
            let mut state = [Lanes::splat(x)];
            limits.apply(&mut state);
            state[0].0[3]
        };
        for x in [0.0, -1.499, 1.5, 0.3] {
            assert_eq!(limited(x).to_bits(), x.to_bits());
        }
        for x in [1.6, 3.0, -40.0, 1e20, f32::MAX, -f32::MAX, f32::INFINITY] {
            let y = limited(x);
            assert!(y.abs() <= 3.0 && y.signum() == x.signum(), "{x} {y}");
        }
        assert!((limited(1.5001) - 1.5001).abs() < 1e-6);
    }

    #[test]
    fn the_slope_of_the_limit_matches_finite_differences() {
        let limits = Limits { bound: 1e3, soft: vec![0.8] };
        for x in [0.1_f32, 0.79, 0.9, 1.5, -2.4, -7.0] {
            let at = |x: f32| {
                let mut state = [Lanes::splat(x)];
                limits.apply(&mut state);
                state
            };
            let slope = limits.slope(&at(x), 0).map_or(1.0, |s| s.0[0]);
            let step = 2e-3;
            let exact = (at(x + step)[0].0[0] - at(x - step)[0].0[0]) / (2.0 * step);
            assert!((slope - exact).abs() < 1e-3, "{x}: {slope} {exact}");
        }
    }
}
