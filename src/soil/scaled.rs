//! A law whose shear is scaled by a slowly changing memory: what softening and rate dependence have in common.

mod batch;

use super::{Batch, Damping, Increment, Law, Point, Refusal, Response, batch_around, update_alone};
use crate::error::{Error, Result};
use crate::numerics::lanes::Width;

/// Two factors on the shear of a law, and the memory they follow from.
pub trait Scaling: Send + Sync {
    /// Numbers of memory per point.
    fn n_state(&self) -> usize;

    /// Memory of a point before shaking.
    fn start(&self, point: &Point, state: &mut [f64]);

    /// Factors on (shear strain going in, shear stress coming out), from committed memory.
    fn factors(&self, committed: &[f64]) -> (f64, f64);

    /// Memory after `increment` has led to the (scaled) shear stress `tau_pa`.
    fn follow(&self, increment: &Increment, tau_pa: f64, committed: &[f64], trial: &mut [f64]);
}

/// A law with scaled shear.
///
/// ```text
/// τ(γ) = a τ_law(∫ b dγ),   σ'_yy unscaled                                   (1)
/// ∂τ/∂γ = a b ∂τ_law/∂γ,  ∂τ/∂ε = a ∂τ_law/∂ε,  ∂σ/∂γ = b ∂σ_law/∂γ          (2)
/// ```
///
/// with a, b the products of all scalings' factors at the *committed* memory, so (2) is exact and the factors lag by one
/// increment.
///
/// | symbol | what             | shape                                   |
/// |--------|------------------|-----------------------------------------|
/// | state  | the law's memory of all points, then the scalings' | `[n · n_law][n · n_own]` |
///
/// Limits: factors must change slowly against the increment; they lag by one increment, which is first order in time.
/// Check: `tests/verification/around_a_law.rs`.
/// Source: (1) is the degradation index of Idriss, Dobry & Singh (1978) for b = 1.
pub struct Scaled {
    law: Box<dyn Law>,
    scalings: Vec<Box<dyn Scaling>>,
    n_own: usize,
}

/// Points scaled at a time, so that nothing is allocated.
const BUNDLE: usize = 32;

impl Scaled {
    /// `law`, of those registered, under these scalings.
    pub fn new(law: Box<dyn Law>, scalings: Vec<Box<dyn Scaling>>) -> Self {
        let n_own = scalings.iter().map(|s| s.n_state()).sum();
        Self { law, scalings, n_own }
    }

    fn start_own(&self, point: &Point, mut own: &mut [f64]) {
        for scaling in &self.scalings {
            let (head, tail) = own.split_at_mut(scaling.n_state());
            scaling.start(point, head);
            own = tail;
        }
    }

    fn factors(&self, mut own: &[f64]) -> (f64, f64) {
        let (mut strain, mut stress) = (1.0, 1.0);
        for scaling in &self.scalings {
            let (head, tail) = own.split_at(scaling.n_state());
            let (b, a) = scaling.factors(head);
            (strain, stress) = (strain * b, stress * a);
            own = tail;
        }
        (strain, stress)
    }

    fn follow(&self, increment: &Increment, tau_pa: f64, mut committed: &[f64], mut trial: &mut [f64]) {
        for scaling in &self.scalings {
            let n = scaling.n_state();
            let ((old, rest), (new, tail)) = (committed.split_at(n), trial.split_at_mut(n));
            scaling.follow(increment, tau_pa, old, new);
            (committed, trial) = (rest, tail);
        }
    }
}

impl Law for Scaled {
    fn n_state(&self) -> usize {
        self.law.n_state() + self.n_own
    }

    fn start(&self, point: &Point, state: &mut [f64]) -> Result<[f64; 4]> {
        let (inner, own) = state.split_at_mut(self.law.n_state());
        self.start_own(point, own);
        self.law.start(point, inner)
    }

    fn start_all(
        &self,
        points: &[Point],
        state: &mut [f64],
        elastic_pa: &mut [[f64; 4]],
    ) -> Result<(), (usize, Box<Error>)> {
        let (inner, own) = state.split_at_mut(points.len() * self.law.n_state());
        for (point, own) in points.iter().zip(own.chunks_exact_mut(self.n_own)) {
            self.start_own(point, own);
        }
        self.law.start_all(points, inner, elastic_pa)
    }

    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal> {
        update_alone(self, increment, committed, trial)
    }

    fn update_all(
        &self,
        increments: &[Increment],
        committed: &[f64],
        trial: &mut [f64],
        responses: &mut [Response],
    ) -> Result<(), (usize, Refusal)> {
        let n = self.law.n_state();
        let (old, old_own) = committed.split_at(increments.len() * n);
        let (new, new_own) = trial.split_at_mut(increments.len() * n);
        let own = |memory: &'_ [f64], i: usize| -> std::ops::Range<usize> {
            debug_assert!(memory.len() >= (i + 1) * self.n_own);
            i * self.n_own..(i + 1) * self.n_own
        };
        let mut scaled = [Increment::default(); BUNDLE];
        let mut factors = [(1.0, 1.0); BUNDLE];
        for first in (0..increments.len()).step_by(BUNDLE) {
            let range = first..increments.len().min(first + BUNDLE);
            for (k, i) in range.clone().enumerate() {
                factors[k] = self.factors(&old_own[own(old_own, i)]);
                scaled[k] = Increment { gamma: factors[k].0 * increments[i].gamma, ..increments[i] };
            }
            let memory = range.start * n..range.end * n;
            self.law
                .update_all(
                    &scaled[..range.len()],
                    &old[memory.clone()],
                    &mut new[memory],
                    &mut responses[range.clone()],
                )
                .map_err(|(i, refusal)| (first + i, refusal))?;
            for (k, i) in range.enumerate() {
                let (b, a) = factors[k];
                let r = &mut responses[i];
                r.tau_pa *= a; // (1)
                let t = r.tangent_pa;
                r.tangent_pa = [a * b * t[0], a * t[1], b * t[2], t[3]]; // (2)
                let at = own(old_own, i);
                self.follow(&increments[i], r.tau_pa, &old_own[at.clone()], &mut new_own[at]);
            }
        }
        Ok(())
    }

    fn batch<'l>(&'l self, start: &'l [f64], responses: &[Response], width: Width) -> Option<Box<dyn Batch + 'l>> {
        let (law, own) = batch_around(self.law.as_ref(), start, responses, width);
        Some(Box::new(batch::Points::new(self, law, own, width)))
    }

    fn couples(&self) -> bool {
        self.law.couples()
    }

    fn pore_stiffness_pa(&self) -> f64 {
        self.law.pore_stiffness_pa()
    }

    fn damping(&self, point: &Point) -> Damping {
        self.law.damping(point)
    }

    fn viscosity_s(&self) -> f64 {
        self.law.viscosity_s()
    }
}
