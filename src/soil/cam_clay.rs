//! Modified Cam-Clay: logarithmic porous elasticity, exponential hardening, implicit return.

use super::{Damping, Increment, Law, Point, Ranges, Refusal, Response};
use crate::error::{Error, Result};
use crate::registry::{Entry, params};
use crate::units::{GPA, KPA};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Least and largest slope M of the critical state.
pub const CAM_CLAY_M: [f64; 2] = [0.3, 2.5];

pub(super) const ENTRY: Entry<dyn Law> = Entry {
    name: "cam_clay",
    about: "Modified Cam-Clay, logarithmic elasticity, exponential hardening, G = ρVs²",
    build: |table| {
        let law: CamClay = params(table)?;
        Ranges::new()
            .check("lambda", law.lambda, 1e-3, 2.0)
            .check("kappa", law.kappa, 1e-4, 0.99 * law.lambda)
            .check("m", law.m, CAM_CLAY_M[0], CAM_CLAY_M[1])
            .check("e0", law.e0, 0.1, 10.0)
            .check("ocr", law.ocr, 1.0, 50.0)
            .check("p_c0_kpa", law.p_c0_kpa.unwrap_or(1.0), 1e-3, 1e5)
            .check("damping_ratio", law.damping_ratio, 0.0, 0.5)
            .check("k_w_gpa", law.k_w_gpa, 0.0, 10.0)
            .done()?;
        Ok(Box::new(law))
    },
    schema: || schemars::schema_for!(CamClay),
};

/// Modified Cam-Clay.
///
/// Compression positive, effective; q = √(3/2) ‖s‖:
///
/// ```text
/// yield       f = q² + M² p'(p' − p'_c) = 0, associated                                (1)
/// elasticity  dp'/p' = (1+e₀)/κ dε_v^e,   ds = 2G de^e,   G = ρVs² of the initial state   (2)
/// hardening   dp'_c/p'_c = (1+e₀)/(λ−κ) dε_v^p                                         (3)
/// return      p' = p'_tr e^{−(1+e₀)/κ x},  p'_c = p'_c,n e^{(1+e₀)/(λ−κ) x},  s = s_tr/(1+6Gφ),
///             x = φ M²(2p' − p'_c),  f = 0   for  x = Δε_v^p  and φ                      (4)
/// ```
///
/// | symbol | field             | unit | range |
/// |--------|-------------------|------|-------|
/// | λ, κ   | `lambda`, `kappa` | –    | 0.001…2, < λ (e–ln p') |
/// | M      | `m`               | –    | 0.3…2.5 |
/// | e₀     | `e0`              | –    | 0.1…10 |
/// | OCR    | `ocr`             | –    | 1…50 |
/// | p'_c0  | `p_c0_kpa` (else OCR (p'₀ + q₀²/(M²p'₀))) | kPa | > 0 |
/// | ξ      | `damping_ratio`   | –    | 0…0.5 |
/// | K_w    | `k_w_gpa`         | GPa  | 0…10  |
/// | state  | xx, yy, zz, xy, p'_c, G | `[6]` | Pa |
///
/// Effective stresses: with `vertical = "restrained"` or pore water the volume is (nearly) constant and (4) gives the
/// undrained strength by itself, so no separate total-stress strength is declared. A geostatic stress beyond p'_c0
/// moves p'_c0 to it (normally consolidated).
///
/// Limits: no plasticity inside (1), so cyclic damping of overconsolidated clay is too small; a constant G with a
/// pressure-dependent K is not exactly conservative.
/// Check: `tests/verification/strength.rs`: undrained path to the exact s_u = ½ M p'_f √(4/3), tangent.
/// Source: Roscoe & Burland (1968); Borja & Lee (1990), doi 10.1016/0045-7825(90)90152-C, for (4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct CamClay {
    /// Slope λ of normal compression in e–ln p'.
    lambda: f64,
    /// Slope κ of swelling in e–ln p'.
    kappa: f64,
    /// Critical stress ratio M.
    m: f64,
    /// Initial void ratio e₀.
    e0: f64,
    /// Overconsolidation ratio; counts where `p_c0_kpa` is absent.
    ocr: f64,
    /// Initial preconsolidation pressure p'_c0, kPa.
    p_c0_kpa: Option<f64>,
    /// Small-strain damping ratio ξ.
    damping_ratio: f64,
    /// Bulk modulus of water, GPa (0: drained).
    k_w_gpa: f64,
}

impl Default for CamClay {
    fn default() -> Self {
        Self {
            lambda: 0.18675,
            kappa: 0.01737,
            m: 1.2,
            e0: 1.6,
            ocr: 1.0,
            p_c0_kpa: None,
            damping_ratio: 0.0,
            k_w_gpa: 2.2,
        }
    }
}

const PC: usize = 4;
const G: usize = 5;

/// The plastic solution of (4) and what its derivative needs.
struct Return {
    p: f64,
    pc: f64,
    /// 1/(1 + 6Gφ).
    shrink: f64,
    /// ∂(x, φ)/∂(p_tr, q_tr), row by row.
    sensitivity: [f64; 4],
}

impl CamClay {
    fn elastic_rate(&self) -> f64 {
        (1.0 + self.e0) / self.kappa
    }

    /// Newton's iteration on (4).
    fn returned(&self, g: f64, p_tr: f64, q_tr: f64, pc_n: f64) -> Result<Return, Refusal> {
        let theta = self.elastic_rate();
        let hard = (1.0 + self.e0) / (self.lambda - self.kappa);
        let m2 = self.m * self.m;
        let (mut x, mut phi) = (0.0_f64, 0.0_f64);
        let scale = 1.0 / (m2 * pc_n * pc_n);
        for _ in 0..60 {
            let p = p_tr * (-theta * x).exp();
            let pc = pc_n * (hard * x).exp();
            let shrink = 1.0 / (1.0 + 6.0 * g * phi);
            let q = q_tr * shrink;
            let r1 = x - phi * m2 * (2.0 * p - pc);
            let r2 = (q * q + m2 * p * (p - pc)) * scale;
            let j11 = 1.0 + phi * m2 * (2.0 * theta * p + hard * pc);
            let j12 = -m2 * (2.0 * p - pc);
            let j21 = m2 * scale * (-theta * p * (2.0 * p - pc) - p * hard * pc);
            let j22 = -12.0 * g * q * q * shrink * scale;
            let det = j11 * j22 - j12 * j21;
            if !det.is_finite() || det == 0.0 {
                break;
            }
            if r2.abs() < 1e-12 && r1.abs() < 1e-14 {
                // r1 depends on p_tr through p; r2 on p_tr through p and on q_tr through q.
                let (a1, a2) = (-phi * m2 * 2.0 * p / p_tr, m2 * scale * (2.0 * p - pc) * p / p_tr);
                let b2 = 2.0 * q * shrink * scale;
                let sensitivity =
                    [-(j22 * a1 - j12 * a2) / det, j12 * b2 / det, -(j11 * a2 - j21 * a1) / det, -j11 * b2 / det];
                return Ok(Return { p, pc, shrink, sensitivity });
            }
            let limit = 0.2 / (theta + hard);
            x += ((j12 * r2 - j22 * r1) / det).clamp(-limit, limit);
            phi = (phi + (j21 * r1 - j11 * r2) / det).max(0.0);
        }
        Err(Refusal::Return)
    }
}

impl Law for CamClay {
    fn n_state(&self) -> usize {
        6
    }

    fn start(&self, point: &Point, state: &mut [f64]) -> Result<[f64; 4]> {
        let p = point.mean_pa();
        if p <= 0.0 {
            return Err(Error::new(format!(
                "`cam_clay` needs a mean effective stress above 0 kPa, got {:.3} kPa",
                p / KPA
            ))
            .hint("clay without confinement has no stiffness: cover it or lower the water table"));
        }
        let q = (point.vertical_pa - point.horizontal_pa).abs();
        let on_yield = p + q * q / (self.m * self.m * p);
        let pc = self.p_c0_kpa.map_or(self.ocr * on_yield, |pc| (pc * KPA).max(on_yield));
        let g = point.shear_modulus_pa();
        state.copy_from_slice(&[point.horizontal_pa, point.vertical_pa, point.horizontal_pa, 0.0, pc, g]);
        Ok([g, 0.0, 0.0, self.elastic_rate() * p + 4.0 / 3.0 * g])
    }

    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal> {
        let g = committed[G];
        let dv = -increment.eps_yy;
        let third = dv / 3.0;
        let p_n = (committed[0] + committed[1] + committed[2]) / 3.0;
        let exponent = self.elastic_rate() * dv;
        if !(exponent.abs() < 5.0 && increment.gamma.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        let p_tr = p_n * exponent.exp();
        let s_tr = [
            committed[0] - p_n - 2.0 * g * third,
            committed[1] - p_n + 4.0 * g * third,
            committed[2] - p_n - 2.0 * g * third,
            committed[3] + g * increment.gamma,
        ];
        let norm2 = s_tr[0] * s_tr[0] + s_tr[1] * s_tr[1] + s_tr[2] * s_tr[2] + 2.0 * s_tr[3] * s_tr[3];
        let q_tr = (1.5 * norm2).sqrt();
        let pc_n = committed[PC];
        // Derivatives of the trial values by γ and ε_yy (tension positive).
        let dp_tr = [0.0, -self.elastic_rate() * p_tr];
        let dq_tr = if q_tr > 0.0 { [3.0 * s_tr[3] * g / q_tr, -3.0 * s_tr[1] * g / q_tr] } else { [0.0; 2] };
        let ds_yy = [0.0, -4.0 / 3.0 * g];
        let ds_xy = [g, 0.0];
        let f = q_tr * q_tr + self.m * self.m * p_tr * (p_tr - pc_n);
        let (p, pc, shrink, dp, dshrink) = if f <= 1e-12 * (self.m * pc_n).powi(2) {
            (p_tr, pc_n, 1.0, dp_tr, [0.0; 2])
        } else {
            let r = self.returned(g, p_tr, q_tr, pc_n)?;
            let d = |k: usize| {
                let dx = r.sensitivity[0] * dp_tr[k] + r.sensitivity[1] * dq_tr[k];
                let dphi = r.sensitivity[2] * dp_tr[k] + r.sensitivity[3] * dq_tr[k];
                (r.p / p_tr * dp_tr[k] - self.elastic_rate() * r.p * dx, -6.0 * g * r.shrink * r.shrink * dphi)
            };
            let (a, b) = (d(0), d(1));
            (r.p, r.pc, r.shrink, [a.0, b.0], [a.1, b.1])
        };
        let s = s_tr.map(|x| x * shrink);
        trial.copy_from_slice(&[s[0] + p, s[1] + p, s[2] + p, s[3], pc, g]);
        let tau = |k: usize| shrink * ds_xy[k] + dshrink[k] * s_tr[3];
        let yy = |k: usize| dp[k] + shrink * ds_yy[k] + dshrink[k] * s_tr[1];
        Ok(Response { tau_pa: s[3], sigma_yy_pa: -(s[1] + p), tangent_pa: [tau(0), tau(1), -yy(0), -yy(1)] })
    }

    fn pore_stiffness_pa(&self) -> f64 {
        self.k_w_gpa * GPA * (1.0 + self.e0) / self.e0
    }

    fn damping(&self, _: &Point) -> Damping {
        Damping::Rayleigh { ratio: self.damping_ratio }
    }
}
