//! What surrounds the law of an element, as a change of its curve of modulus and damping.

use super::curves::{CYCLES, MAX_DAMPING, STEP_S, STEPS};
use crate::soil::{Rate, Softening};

/// What of the column's features surrounds the law of an element: softening by pore pressure, growth of strength with the
/// rate, a cap on the stress.
///
/// ```text
/// rate       F of the mean rate 4 γ f:       G(γ) → G(γ/F)                        (1)
/// softening  dE/dN = 2 (τ/σ'_v)², N = 0…3:    G → G √(1 − r_u(E))                 (2)
/// slip       μ = γ G(γ_y)/τ_max > 1:          G → G (θ − ½ sin 2θ)/π,  cos θ = 1 − 2/μ,
///            D → D + 2 (μ − 1)/(μ² (θ − ½ sin 2θ))                               (3)
/// ```
///
/// Limits: cycles of 2 Hz, three of them, as those that measure the law.
/// Check:  `what_surrounds_a_law_changes_its_curve_as_driving_it_does`.
#[derive(Debug, Clone, PartialEq)]
pub struct Surroundings {
    /// Softenings that reach the element.
    pub softenings: Vec<Softening>,
    /// Growth of strength with the rate.
    pub rates: Vec<Rate>,
    /// Cap on the shear stress, Pa.
    pub tau_max_pa: Option<f64>,
    /// Vertical effective stress, Pa.
    pub vertical_pa: f64,
    /// Small-strain shear modulus, Pa.
    pub shear_modulus_pa: f64,
}

impl Surroundings {
    /// (G/G₀, D) at `gamma` where the law alone has `plain`.
    pub fn at(&self, gamma: f64, plain: impl Fn(f64) -> (f64, f64)) -> (f64, f64) {
        let stuck = self.stuck(gamma, &plain);
        let Some(tau_max_pa) = self.tau_max_pa.filter(|t| stuck.0 * self.shear_modulus_pa * gamma > *t) else {
            return stuck;
        };
        let mut yields = tau_max_pa / self.shear_modulus_pa;
        for _ in 0..8 {
            yields = tau_max_pa / (self.shear_modulus_pa * self.stuck(yields, &plain).0.max(1e-3));
        }
        let inside = self.stuck(yields, &plain);
        let mu = (gamma / yields).max(1.0 + 1e-9);
        let theta = (1.0 - 2.0 / mu).acos();
        let in_phase = (theta - theta.sin() * theta.cos()) / std::f64::consts::PI;
        let lost = 4.0 * (mu - 1.0) / (std::f64::consts::PI * mu * mu);
        (inside.0 * in_phase, (inside.1 + 0.5 * lost / in_phase).min(MAX_DAMPING)) // (3)
    }

    /// Without the slip.
    fn stuck(&self, gamma: f64, plain: impl Fn(f64) -> (f64, f64)) -> (f64, f64) {
        let rate_1_s = 4.0 * gamma / (STEPS as f64 * STEP_S);
        let factor: f64 = self.rates.iter().map(|r| r.factor(rate_1_s)).product();
        let (unsoftened, damping) = plain(gamma / factor); // (1)
        let (mut modulus, mut path, parts) = (unsoftened, 0.0, 8);
        for _ in 0..CYCLES * parts {
            let left: f64 = self.softenings.iter().map(|s| (1.0 - s.pore_ratio(path)).sqrt()).product();
            modulus = unsoftened * left; // (2)
            let ratio = modulus * self.shear_modulus_pa * gamma / self.vertical_pa.max(1e3);
            path += 2.0 / parts as f64 * ratio * ratio;
        }
        (modulus, damping)
    }
}
