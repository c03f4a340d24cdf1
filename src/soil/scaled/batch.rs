//! The scaling under several motions at once; shear alone.

use super::Scaled;
use crate::numerics::lanes::Width;
use crate::soil::{Batch, Increment, Refusal, Shear, Steps};
use std::ops::Range;

/// Points under several motions, around those of a law. Factors follow from committed memory alone, so they are taken once an accepted
/// increment.
pub(super) struct Points<'l> {
    scaled: &'l Scaled,
    law: Box<dyn Batch + 'l>,
    width: Width,
    start: &'l [f64],
    /// Memory, `[lane][point][number]`.
    own: Vec<f64>,
    /// Memory of one point after an increment.
    next: Vec<f64>,
    /// Factors on strain and on stress, `[point][lane]`.
    strain: Vec<f64>,
    stress: Vec<f64>,
    /// The last increments, the same as the law sees them, and the stress after them, `[point][lane]`.
    increments: Vec<f64>,
    scaled_increments: Vec<f64>,
    tau_pa: Vec<f64>,
    dt_s: Vec<f64>,
}

impl<'l> Points<'l> {
    /// Points of which the law has a batch already, and the scalings start with this memory.
    pub fn new(scaled: &'l Scaled, law: Box<dyn Batch + 'l>, start: &'l [f64], width: Width) -> Self {
        let lanes = width.lanes();
        let all = vec![1.0; start.len() / scaled.n_own * lanes];
        Self {
            scaled,
            law,
            width,
            start,
            own: start.repeat(lanes),
            next: vec![0.0; scaled.n_own],
            strain: all.clone(),
            stress: all.clone(),
            increments: all.clone(),
            scaled_increments: all.clone(),
            tau_pa: all,
            dt_s: vec![1.0; lanes],
        }
    }

    /// Where the memory of a lane is.
    fn memory(&self, lane: usize) -> Range<usize> {
        let n = self.start.len();
        lane * n..(lane + 1) * n
    }

    /// Takes the factors of a lane from its memory.
    fn renew(&mut self, lane: usize) {
        let (lanes, n) = (self.width.lanes(), self.scaled.n_own);
        for (point, own) in self.own[self.memory(lane)].chunks_exact(n).enumerate() {
            let at = point * lanes + lane;
            (self.strain[at], self.stress[at]) = self.scaled.factors(own);
        }
    }
}

impl Batch for Points<'_> {
    fn restart(&mut self, lane: usize) {
        self.law.restart(lane);
        let memory = self.memory(lane);
        self.own[memory].copy_from_slice(self.start);
        self.renew(lane);
    }

    fn relax(&mut self, _: &Steps, _: &mut Shear) {}

    fn update(
        &mut self,
        steps: &Steps,
        increments: &[f64],
        shear: &mut Shear,
        refused: &mut [Option<(usize, Refusal)>],
    ) {
        self.increments.copy_from_slice(increments);
        self.dt_s.copy_from_slice(steps.dt_s);
        for ((scaled, gamma), b) in self.scaled_increments.iter_mut().zip(increments).zip(&self.strain) {
            *scaled = b * gamma;
        }
        self.law.update(steps, &self.scaled_increments, shear, refused);
        let shear = shear.tau_pa.iter_mut().zip(shear.tangent_pa.iter_mut());
        let factors = self.strain.iter().zip(&self.stress);
        for (((tau, tangent), (b, a)), kept) in shear.zip(factors).zip(&mut self.tau_pa) {
            *tau *= a; // (1)
            *tangent *= a * b; // (2)
            *kept = *tau;
        }
    }

    fn accept(&mut self, lanes: &[bool]) {
        self.law.accept(lanes);
        let (width, n) = (self.width.lanes(), self.scaled.n_own);
        for lane in (0..width).filter(|lane| lanes[*lane]) {
            let memory = self.memory(lane);
            for (point, own) in self.own[memory].chunks_exact_mut(n).enumerate() {
                let at = point * width + lane;
                let increment = Increment { gamma: self.increments[at], eps_yy: 0.0, dt_s: self.dt_s[lane] };
                self.scaled.follow(&increment, self.tau_pa[at], own, &mut self.next);
                own.copy_from_slice(&self.next);
            }
            self.renew(lane);
        }
    }

    fn vertical_pa(&self, lane: usize, sigma_yy_pa: &mut [f64]) {
        self.law.vertical_pa(lane, sigma_yy_pa);
    }
}
