//! Strength that grows with the rate of strain, as clay's does.

use super::{Increment, Point, Scaling};

/// Shear strength that grows with the logarithm of the strain rate, at unchanged initial stiffness.
///
/// ```text
/// factor   F = 1 + β log₁₀(1 + γ̇/γ̇₀),   γ̇₀ = 1e-5 1/s                           (1)
/// rate     γ̇ the mean of |dγ/dt| over the last T = 0.5 s, with fading weights      (2)
/// stress   τ = F τ_law(∫ dγ/F): strength and reference strain × F, G as it was    (3)
/// ```
///
/// | symbol | field           | unit | range  |
/// |--------|-----------------|------|--------|
/// | β      | `per_log_cycle` | –    | 0…0.5  |
/// | state  | γ̇               | 1/s  | `[1]`  |
///
/// γ̇₀ is the rate of a monotonic laboratory test (a few percent an hour), to which declared strengths refer.
///
/// Limits: the mean (2) instead of the momentary rate, which would let τ drop at every reversal; pore pressure does not
/// depend on the rate.
/// Check: `tests/verification/around_a_law.rs`: undrained strength at rates a decade apart in closed form.
/// Source: Kulhawy & Mayne (1990), EPRI EL-6800, about 10 % a log cycle; Afacan, Brandenberg & Stewart (2014),
/// doi 10.1061/(ASCE)GT.1943-5606.0001000, for the centrifuge models.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rate {
    /// Gain of strength β per tenfold rate.
    pub per_log_cycle: f64,
}

const REFERENCE_1_S: f64 = 1e-5;
const MEMORY_S: f64 = 0.5;

impl Rate {
    /// F of (1) at a strain rate, 1/s.
    pub fn factor(&self, rate_1_s: f64) -> f64 {
        1.0 + self.per_log_cycle * (rate_1_s / REFERENCE_1_S).ln_1p() / std::f64::consts::LN_10
    }
}

impl Scaling for Rate {
    fn n_state(&self) -> usize {
        1
    }

    fn start(&self, _: &Point, state: &mut [f64]) {
        state[0] = 0.0;
    }

    fn factors(&self, committed: &[f64]) -> (f64, f64) {
        let f = self.factor(committed[0]);
        (1.0 / f, f) // (3)
    }

    fn follow(&self, increment: &Increment, _: f64, committed: &[f64], trial: &mut [f64]) {
        let fade = (-increment.dt_s / MEMORY_S).exp();
        // (1 − fade)/Δt, also where the increment takes no time.
        let weight = if increment.dt_s > 0.0 { (1.0 - fade) / increment.dt_s } else { 0.0 };
        trial[0] = fade * committed[0] + weight * increment.gamma.abs(); // (2)
    }
}
