//! Softening by excess pore pressure that a law does not compute by itself.

use super::{Increment, Point, Scaling};

/// Shear softened by a pore pressure ratio that grows with cyclic shear stress.
///
/// ```text
/// stress path   E = ∫ |τ| |dτ| / σ'_v0²          (2 per cycle of τ = ±σ'_v0)              (1)
/// pore ratio    r_u = min(0.9, a (E/E_ref)^(n/2)),   E_ref = 0.2                          (2)
/// modulus       G → G (1 − r_u)^½: a factor on the shear stress of the law               (3)
/// ```
///
/// E_ref is ten cycles of a tenth of the vertical effective stress: motions of 0.1 g at the base of the Lotung column give
/// 0.07…1 by motion, depth and law; since E grows with the square of the motion, r_u grows with its n-th power.
///
/// | symbol | field             | unit | range |
/// |--------|-------------------|------|-------|
/// | a      | `ru_at_reference` | –    | 0…3   |
/// | n      | `exponent`        | –    | 0.5…4 |
/// | state  | E, τ, σ'_v0     | –, Pa| `[3]` |
///
/// A law with pore pressure of its own (`sanisand`, `cam_clay` and `mohr_coulomb` below the water table) keeps it: this
/// comes on top, as what that law still misses, and does not enter its effective stress.
///
/// Limits: strength falls by (3) too, not by 1 − r_u; no drainage, so no recovery within a motion; a shear stress that is
/// there before shaking does not count.
/// Check: `tests/verification/around_a_law.rs`: r_u of uniform cycles in closed form.
/// Source: Seed, Martin & Lysmer (1976) for growth with the number of cycles; Hardin & Drnevich (1972) for G ~ p'^½.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Softening {
    /// Pore pressure ratio a after the reference stress path.
    pub ru_at_reference: f64,
    /// Exponent n of the growth with the motion.
    pub exponent: f64,
}

const E: usize = 0;
const TAU: usize = 1;
const VERTICAL: usize = 2;
const E_REF: f64 = 0.2;
const RU_MAX: f64 = 0.9;
/// Vertical effective stress below which (1) is taken with this one, Pa.
const VERTICAL_MIN_PA: f64 = 1e3;

impl Softening {
    /// r_u of (2) at E.
    pub fn pore_ratio(&self, e: f64) -> f64 {
        (self.ru_at_reference * (e / E_REF).powf(0.5 * self.exponent)).min(RU_MAX)
    }
}

impl Scaling for Softening {
    fn n_state(&self) -> usize {
        3
    }

    fn start(&self, point: &Point, state: &mut [f64]) {
        state.copy_from_slice(&[0.0, 0.0, point.vertical_pa.max(VERTICAL_MIN_PA)]);
    }

    fn factors(&self, committed: &[f64]) -> (f64, f64) {
        (1.0, (1.0 - self.pore_ratio(committed[E])).sqrt()) // (3)
    }

    fn follow(&self, _: &Increment, tau_pa: f64, committed: &[f64], trial: &mut [f64]) {
        let (a, b) = (committed[TAU] / committed[VERTICAL], tau_pa / committed[VERTICAL]);
        let path = if a * b >= 0.0 { (b * b - a * a).abs() } else { a * a + b * b };
        trial.copy_from_slice(&[committed[E] + 0.5 * path, tau_pa, committed[VERTICAL]]); // (1)
    }
}
