//! Hyperbolic backbone with extended Masing rules and a damping reduction factor.

use super::elastic::{check, constrained_modulus_pa};
use super::{Increment, Law, Material, Point, Refusal, Response};
use crate::error::Result;
use crate::registry::{self, Entry};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry<dyn Law> = Entry {
    name: "hyperbolic",
    about: "MKZ-type backbone, extended Masing unloading with damping reduction, Darendeli curves",
    build: |table| Ok(Box::new(registry::params::<Hyperbolic>(table)?.checked()?)),
    schema: || schemars::schema_for!(Hyperbolic),
};

/// Hyperbolic backbone with extended Masing unloading and a damping reduction factor.
///
///     τ_b(γ) = G γ / (1 + (|γ|/γ_r)^a)                                      (1)
///     γ_r = (0.0352 + 0.0010 PI OCR^0.3246) (σ'0/p_a)^0.3483 %              (2)
///     after a reversal at (γ_r, τ_r), with Δ = γ − γ_r:
///     τ = τ_r + F [2 τ_b(Δ/2) − G_m Δ] + G_m Δ                              (3)
///     F = b (G_m/G)^0.1,   G_m = τ_b(γ_m)/γ_m                               (4)
///     D_min = (0.8005 + 0.0129 PI OCR^−0.1069) (σ'0/p_a)^−0.2889 %          (5)
///
/// γ_m is the largest strain so far. An unloading branch ends where it meets the branch it left (the last two
/// reversals are forgotten) or the backbone.
///
/// | symbol | field               | unit | range      |
/// |--------|---------------------|------|------------|
/// | PI     | `plasticity_index`  | %    | 0…100      |
/// | OCR    | `ocr`               | –    | 1…30       |
/// | a      | `curvature`         | –    | 0.5…1.5    |
/// | b      | `damping_reduction` | –    | 0…1        |
/// | γ_r    | `gamma_ref`         | –    | 1e-5…1e-1, from (2) when absent |
/// | D_min  | `damping`           | –    | 0…0.3, from (5) when absent |
/// | ν      | `poisson_ratio`     | –    | 0…0.49     |
/// | e      | `void_ratio`        | –    | 0.1…5      |
///
/// Limits: total stress in shear, no pore-pressure generation; no strength cap beyond (1); D_min is realised as
/// Rayleigh damping of the element.
/// Check:  loop area against the closed form for a = 1; tangent against finite differences.
/// Source: Darendeli (2001), dissertation, table 8.12; Phillips and Hashash (2009), eq. 7, doi 10.1016/j.soildyn.2009.01.004.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Hyperbolic {
    /// Plasticity index, %.
    plasticity_index: f64,
    /// Overconsolidation ratio.
    ocr: f64,
    /// Exponent of the backbone.
    curvature: f64,
    /// Damping reduction at small strain; 1 is plain Masing.
    damping_reduction: f64,
    /// Reference strain, where G/Gmax = 1/2.
    #[serde(skip_serializing_if = "Option::is_none")]
    gamma_ref: Option<f64>,
    /// Small-strain damping, fraction of critical.
    #[serde(skip_serializing_if = "Option::is_none")]
    damping: Option<f64>,
    /// Drained Poisson's ratio.
    poisson_ratio: f64,
    /// Void ratio, for the pore water below the water table.
    void_ratio: f64,
}

impl Default for Hyperbolic {
    fn default() -> Self {
        Self {
            plasticity_index: 0.0,
            ocr: 1.0,
            curvature: 0.919,
            damping_reduction: 0.6329,
            gamma_ref: None,
            damping: None,
            poisson_ratio: 0.3,
            void_ratio: 0.7,
        }
    }
}

const ATMOSPHERE_PA: f64 = 101_325.0;

impl Hyperbolic {
    fn checked(self) -> Result<Self> {
        check("plasticity_index", self.plasticity_index, 0.0, 100.0)?;
        check("ocr", self.ocr, 1.0, 30.0)?;
        check("curvature", self.curvature, 0.5, 1.5)?;
        check("damping_reduction", self.damping_reduction, 0.0, 1.0)?;
        check("gamma_ref", self.gamma_ref.unwrap_or(1e-3), 1e-5, 1e-1)?;
        check("damping", self.damping.unwrap_or(0.0), 0.0, 0.3)?;
        check("poisson_ratio", self.poisson_ratio, 0.0, 0.49)?;
        check("void_ratio", self.void_ratio, 0.1, 5.0)?;
        Ok(self)
    }
}

impl Law for Hyperbolic {
    fn at(&self, point: &Point) -> Result<Box<dyn Material>> {
        let pressure = (point.mean_effective_stress_pa() / ATMOSPHERE_PA).max(0.01);
        let percent = 0.01;
        let gamma_ref = self.gamma_ref.unwrap_or_else(|| {
            percent * (0.0352 + 0.0010 * self.plasticity_index * self.ocr.powf(0.3246)) * pressure.powf(0.3483) // (2)
        });
        let damping = self.damping.unwrap_or_else(|| {
            percent * (0.8005 + 0.0129 * self.plasticity_index * self.ocr.powf(-0.1069)) * pressure.powf(-0.2889) // (5)
        });
        let shear_pa = point.shear_modulus_pa();
        Ok(Box::new(Placed {
            shear_pa,
            constrained_pa: constrained_modulus_pa(shear_pa, self.poisson_ratio),
            gamma_ref,
            curvature: self.curvature,
            damping_reduction: self.damping_reduction,
            damping,
            void_ratio: self.void_ratio,
        }))
    }
}

struct Placed {
    shear_pa: f64,
    constrained_pa: f64,
    gamma_ref: f64,
    curvature: f64,
    damping_reduction: f64,
    damping: f64,
    void_ratio: f64,
}

// State: γ, ε_yy, γ_m, direction (±1, 0 at first), number of reversals, then (γ_r, τ_r) pairs.
const GAMMA: usize = 0;
const EPSILON: usize = 1;
const GAMMA_MAX: usize = 2;
const DIRECTION: usize = 3;
const COUNT: usize = 4;
const STACK: usize = 5;
const MAX_REVERSALS: usize = 12;

impl Placed {
    /// (1) and its derivative.
    fn backbone(&self, gamma: f64) -> (f64, f64) {
        let ratio = (gamma.abs() / self.gamma_ref).powf(self.curvature);
        let denominator = 1.0 + ratio;
        let tau = self.shear_pa * gamma / denominator;
        let slope = self.shear_pa * (1.0 + (1.0 - self.curvature) * ratio) / (denominator * denominator);
        (tau, slope)
    }

    /// Stress and slope on the branch that started at the last of `state`'s reversals.
    fn branch(&self, gamma: f64, state: &[f64]) -> (f64, f64) {
        let count = state[COUNT] as usize;
        if count == 0 {
            return self.backbone(gamma);
        }
        let (gamma_r, tau_r) = (state[STACK + 2 * count - 2], state[STACK + 2 * count - 1]);
        let gamma_max = state[GAMMA_MAX];
        let delta = gamma - gamma_r;
        let (half_tau, half_slope) = self.backbone(0.5 * delta);
        let secant = if gamma_max > 0.0 { self.backbone(gamma_max).0 / gamma_max } else { self.shear_pa };
        let factor = self.damping_reduction * (secant / self.shear_pa).powf(0.1); // (4)
        let tau = tau_r + factor * (2.0 * half_tau - secant * delta) + secant * delta; // (3)
        (tau, factor * (half_slope - secant) + secant)
    }

    /// Records a reversal at the committed strain when the direction changes.
    fn turn(&self, direction: f64, state: &mut [f64]) {
        if state[DIRECTION] == direction {
            return;
        }
        if state[DIRECTION] != 0.0 {
            let gamma = state[GAMMA];
            let (tau, _) = self.branch(gamma, state);
            let mut count = state[COUNT] as usize;
            if count == MAX_REVERSALS {
                // The innermost loop is forgotten: its stress difference is far below the loops outside.
                count -= 2;
            }
            state[STACK + 2 * count] = gamma;
            state[STACK + 2 * count + 1] = tau;
            state[COUNT] = (count + 1) as f64;
        }
        state[DIRECTION] = direction;
    }

    /// Forgets loops that `gamma` has closed.
    fn close_loops(&self, gamma: f64, state: &mut [f64]) {
        loop {
            let count = state[COUNT] as usize;
            if count == 0 {
                break;
            }
            // The branch from the last reversal ends at the reversal before it, or at the mirrored backbone.
            let (target, forget) = if count >= 2 {
                (state[STACK + 2 * (count - 2)], 2)
            } else {
                (state[DIRECTION] * state[GAMMA_MAX], 1)
            };
            if (gamma - target) * state[DIRECTION] < 0.0 {
                break;
            }
            state[COUNT] = (count - forget) as f64;
        }
    }
}

impl Material for Placed {
    fn n_state(&self) -> usize {
        STACK + 2 * MAX_REVERSALS
    }

    fn initial(&self, state: &mut [f64]) {
        state.fill(0.0);
    }

    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal> {
        trial.copy_from_slice(committed);
        let gamma = committed[GAMMA] + increment.gamma;
        if increment.gamma != 0.0 {
            self.turn(increment.gamma.signum(), trial);
            self.close_loops(gamma, trial);
        }
        let (tau_pa, slope_pa) = self.branch(gamma, trial);
        trial[GAMMA] = gamma;
        trial[EPSILON] = committed[EPSILON] + increment.epsilon_yy;
        if trial[COUNT] == 0.0 {
            trial[GAMMA_MAX] = trial[GAMMA_MAX].max(gamma.abs());
        }
        if !tau_pa.is_finite() {
            return Err(Refusal::NotFinite);
        }
        let tangent_pa = [[slope_pa, 0.0], [0.0, self.constrained_pa]];
        Ok(Response { tau_pa, sigma_yy_pa: self.constrained_pa * trial[EPSILON], tangent_pa })
    }

    fn initial_tangent_pa(&self) -> [[f64; 2]; 2] {
        [[self.shear_pa, 0.0], [0.0, self.constrained_pa]]
    }

    fn small_strain_damping(&self) -> f64 {
        self.damping
    }

    fn void_ratio(&self) -> f64 {
        self.void_ratio
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn placed(curvature: f64, damping_reduction: f64) -> Placed {
        Placed {
            shear_pa: 5e7,
            constrained_pa: 1e8,
            gamma_ref: 1e-3,
            curvature,
            damping_reduction,
            damping: 0.01,
            void_ratio: 0.7,
        }
    }

    /// Follows `path` of strains in steps of `step`, returning (γ, τ).
    fn follow(material: &Placed, path: &[f64], step: f64) -> Vec<(f64, f64)> {
        let mut state = vec![0.0; material.n_state()];
        let mut trial = state.clone();
        let mut out = vec![(0.0, 0.0)];
        let mut gamma = 0.0;
        for target in path {
            let n = ((target - gamma) / step).abs().round().max(1.0) as usize;
            let d = (target - gamma) / n as f64;
            for _ in 0..n {
                let increment = Increment { gamma: d, epsilon_yy: 0.0 };
                let response = material.update(increment, &state, &mut trial).expect("the law follows");
                state.copy_from_slice(&trial);
                gamma = state[GAMMA];
                out.push((gamma, response.tau_pa));
            }
        }
        out
    }

    #[test]
    fn masing_loop_area_matches_the_closed_form() {
        // For a = 1 and F = 1: D = (4/π)(1 + 1/x)(1 − ln(1 + x)/x) − 2/π, x = γ_a/γ_r (Hardin and Drnevich 1972).
        let material = placed(1.0, 1.0);
        for x in [0.1, 1.0, 5.0] {
            let amplitude = x * 1e-3;
            let path = follow(&material, &[amplitude, -amplitude, amplitude], amplitude / 2000.0);
            let cycle = &path[2000..];
            let area: f64 = cycle.windows(2).map(|w| 0.5 * (w[0].1 + w[1].1) * (w[1].0 - w[0].0)).sum();
            let peak = cycle[0].1;
            // G_m = G for F = 1 would need F exactly one: (4) gives F = (G_m/G)^0.1, so compare with that factor.
            let factor = (peak / amplitude / 5e7f64).powf(0.1);
            let damping = area / (2.0 * std::f64::consts::PI * peak * amplitude);
            let masing = 4.0 / std::f64::consts::PI * (1.0 + 1.0 / x) * (1.0 - (1.0 + x).ln() / x) - 2.0 / std::f64::consts::PI;
            assert!((damping - factor * masing).abs() < 1e-5, "x = {x}: {damping} against {}", factor * masing);
        }
    }

    #[test]
    fn a_closed_small_loop_returns_to_the_large_one() {
        let material = placed(0.9, 0.7);
        let large = follow(&material, &[2e-3, -1e-3], 1e-6);
        let interrupted = follow(&material, &[2e-3, 0.0, 5e-4, -1e-3], 1e-6);
        let (a, b) = (large[large.len() - 1], interrupted[interrupted.len() - 1]);
        assert!((a.1 - b.1).abs() < 1e-6 * a.1.abs());
    }

    #[test]
    fn tangent_matches_finite_differences() {
        let material = placed(0.919, 0.6329);
        let mut state = vec![0.0; material.n_state()];
        let mut trial = state.clone();
        for d in [4e-4, -3e-4, -5e-4, 2e-4, 9e-4] {
            let at = |g: f64, trial: &mut Vec<f64>| {
                material.update(Increment { gamma: g, epsilon_yy: 0.0 }, &state, trial).expect("follows")
            };
            let h = 1e-9;
            let difference = (at(d + h, &mut trial).tau_pa - at(d - h, &mut trial).tau_pa) / (2.0 * h);
            let response = at(d, &mut trial);
            assert!((response.tangent_pa[0][0] / difference - 1.0).abs() < 1e-6);
            state.copy_from_slice(&trial);
        }
    }
}
