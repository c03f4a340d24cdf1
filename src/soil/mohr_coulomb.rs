//! Mohr–Coulomb plasticity with linear elasticity and non-associated flow.

use super::principal::Principal;
use super::{Damping, Increment, Law, Point, Ranges, Refusal, Response};
use crate::error::Result;
use crate::registry::{Entry, params};
use crate::units::{GPA, KPA};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry<dyn Law> = Entry {
    name: "mohr_coulomb",
    about: "linear elasticity, Mohr-Coulomb strength, non-associated dilation",
    build: |table| {
        let law: MohrCoulomb = params(table)?;
        Ranges::new()
            .check("poisson_ratio", law.poisson_ratio, 0.0, 0.495)
            .check("cohesion_kpa", law.cohesion_kpa, 0.0, 1e4)
            .check("friction_angle_deg", law.friction_angle_deg, 1.0, 60.0)
            .check("dilation_angle_deg", law.dilation_angle_deg, 0.0, law.friction_angle_deg)
            .check("damping_ratio", law.damping_ratio, 0.0, 0.5)
            .check("porosity", law.porosity, 0.01, 0.99)
            .check("k_w_gpa", law.k_w_gpa, 0.0, 10.0)
            .done()?;
        Ok(Box::new(law))
    },
    schema: || schemars::schema_for!(MohrCoulomb),
};

/// Isotropic elasticity inside the Mohr–Coulomb pyramid, returned in principal stresses.
///
/// Compression positive, effective, σ₁ ≥ σ₂ ≥ σ₃:
///
/// ```text
/// yield   f_ij = (σ_i − σ_j) − (σ_i + σ_j) sin φ' − 2c' cos φ',   f₁₃ = 0                  (1)
/// flow    the gradient of (1) with ψ for φ'                                               (2)
/// return  σ = σ_tr − D Bᵀ (A D Bᵀ)⁻¹ (A σ_tr − 2c' cos φ')                                 (3)
/// ```
///
/// with A, B the gradients of yield and flow on the active planes: one on a face, two on an edge; on the apex
/// σ = −c' cot φ'. The tangent is the derivative of (3), its directions turning with the trial stress.
///
/// | symbol | field                | unit | range     |
/// |--------|----------------------|------|-----------|
/// | ν      | `poisson_ratio`      | –    | 0…0.495   |
/// | c'     | `cohesion_kpa`       | kPa  | 0…1e4     |
/// | φ'     | `friction_angle_deg` | °    | 1…60      |
/// | ψ      | `dilation_angle_deg` | °    | 0…φ'      |
/// | ξ      | `damping_ratio`      | –    | 0…0.5     |
/// | n, K_w | `porosity`, `k_w_gpa`| –, GPa |         |
/// | state  | xx, yy, zz, xy, G    | `[5]` | Pa        |
///
/// Limits: no hysteresis below yield, constant dilation without end. An initial stress outside (1) is refused.
/// Check: `tests/verification/strength.rs`: limit load, faces and edges, tangent.
/// Source: de Souza Neto, Perić & Owen (2008), Computational Methods for Plasticity, section 8.2.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct MohrCoulomb {
    /// Poisson's ratio ν.
    poisson_ratio: f64,
    /// Effective cohesion c', kPa.
    cohesion_kpa: f64,
    /// Effective friction angle φ', degrees.
    friction_angle_deg: f64,
    /// Dilation angle ψ, degrees.
    dilation_angle_deg: f64,
    /// Small-strain damping ratio ξ.
    damping_ratio: f64,
    /// Porosity n (pore water below the water table).
    porosity: f64,
    /// Bulk modulus of water, GPa (0: drained).
    k_w_gpa: f64,
}

impl Default for MohrCoulomb {
    fn default() -> Self {
        Self {
            poisson_ratio: 0.3,
            cohesion_kpa: 1.0,
            friction_angle_deg: 35.0,
            dilation_angle_deg: 5.0,
            damping_ratio: 0.0,
            porosity: 0.4,
            k_w_gpa: 2.2,
        }
    }
}

type Matrix3 = [[f64; 3]; 3];

/// Gradient of (1) or (2) for the pair (i, j).
fn gradient(i: usize, j: usize, sine: f64) -> [f64; 3] {
    let mut a = [0.0; 3];
    a[i] = 1.0 - sine;
    a[j] = -1.0 - sine;
    a
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl MohrCoulomb {
    fn lame(&self, g: f64) -> f64 {
        2.0 * g * self.poisson_ratio / (1.0 - 2.0 * self.poisson_ratio)
    }

    /// Returned principal values and their derivative by the trial values, for any order of `trial`.
    fn returned(&self, g: f64, trial: [f64; 3]) -> ([f64; 3], Matrix3) {
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let mut order = [0, 1, 2];
        order.sort_by(|i, j| trial[*j].total_cmp(&trial[*i]));
        let [one, two, three] = order;
        let (phi, psi) = (self.friction_angle_deg.to_radians(), self.dilation_angle_deg.to_radians());
        let strength = 2.0 * self.cohesion_kpa * KPA * phi.cos();
        let face = (gradient(one, three, phi.sin()), gradient(one, three, psi.sin()));
        if dot(face.0, trial) <= strength {
            return (trial, identity);
        }
        let lame = self.lame(g);
        let stiff = |b: [f64; 3]| {
            let trace = lame * (b[0] + b[1] + b[2]);
            b.map(|x| trace + 2.0 * g * x)
        };
        let apex = -self.cohesion_kpa * KPA / phi.tan();
        let solve = |planes: &[([f64; 3], [f64; 3])]| -> Option<([f64; 3], Matrix3)> {
            // W = (A D Bᵀ)⁻¹ A, one row a plane.
            let weights: Vec<[f64; 3]> = match planes {
                [(a, b)] => vec![a.map(|x| x / dot(*a, stiff(*b)))],
                [(a, b), (c, d)] => {
                    let m = [dot(*a, stiff(*b)), dot(*a, stiff(*d)), dot(*c, stiff(*b)), dot(*c, stiff(*d))];
                    let det = m[0] * m[3] - m[1] * m[2];
                    let row = |p: f64, q: f64| [0, 1, 2].map(|k| (p * a[k] + q * c[k]) / det);
                    vec![row(m[3], -m[1]), row(-m[2], m[0])]
                }
                _ => return None,
            };
            let mut values = trial;
            let mut matrix = identity;
            for ((_, b), w) in planes.iter().zip(&weights) {
                // A σ_apex = 2c' cos φ', so the apex is the origin of (3).
                let amount = dot(*w, trial.map(|x| x - apex));
                let push = stiff(*b);
                for i in 0..3 {
                    values[i] -= push[i] * amount; // (3)
                    for j in 0..3 {
                        matrix[i][j] -= push[i] * w[j];
                    }
                }
            }
            let slack = 1e-9 * (values[one].abs() + values[three].abs() + 1.0);
            let is_ordered = values[one] >= values[two] - slack && values[two] >= values[three] - slack;
            let is_below_apex = (values[0] + values[1] + values[2]) / 3.0 < apex - slack;
            (is_ordered && !is_below_apex).then_some((values, matrix))
        };
        let plane = |i, j| (gradient(i, j, phi.sin()), gradient(i, j, psi.sin()));
        // The face first; then the edge on the side where the middle value left the order.
        let upper = [face, plane(two, three)];
        let lower = [face, plane(one, two)];
        let edges = if trial[two] - trial[three] > trial[one] - trial[two] { [upper, lower] } else { [lower, upper] };
        solve(&[face]).or_else(|| solve(&edges[0])).or_else(|| solve(&edges[1])).unwrap_or_else(|| {
            // The apex; a trace of stiffness keeps the column's matrix regular.
            ([apex; 3], identity.map(|row| row.map(|x| 1e-4 * x)))
        })
    }
}

impl Law for MohrCoulomb {
    fn n_state(&self) -> usize {
        5
    }

    fn start(&self, point: &Point, state: &mut [f64]) -> Result<[f64; 4]> {
        let g = point.shear_modulus_pa();
        let stress = [point.horizontal_pa, point.vertical_pa, point.horizontal_pa];
        let (returned, _) = self.returned(g, stress);
        if stress.iter().zip(returned).any(|(a, b)| (a - b).abs() > 1e-6 * a.abs() + 1e-3) {
            let [h, v] = [point.horizontal_pa / KPA, point.vertical_pa / KPA];
            return Err(crate::error::Error::new(format!(
                "the geostatic stress ({v:.2} kPa vertical, {h:.2} kPa horizontal) exceeds the Mohr-Coulomb strength"
            ))
            .hint("K0 nearer to 1, or a larger friction angle"));
        }
        state.copy_from_slice(&[stress[0], stress[1], stress[2], 0.0, g]);
        Ok([g, 0.0, 0.0, self.lame(g) + 2.0 * g])
    }

    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal> {
        let g = committed[4];
        let lame = self.lame(g);
        let dv = -increment.eps_yy;
        let stress = [
            committed[0] + lame * dv,
            committed[1] + (lame + 2.0 * g) * dv,
            committed[2] + lame * dv,
            committed[3] + g * increment.gamma,
        ];
        if !stress.iter().all(|x| x.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        let principal = Principal::new(stress);
        let (values, matrix) = self.returned(g, principal.values);
        let new = principal.with_values(values);
        trial.copy_from_slice(&[new[0], new[1], new[2], new[3], g]);
        let by_gamma = principal.derivative(values, &matrix, [0.0, 0.0, 0.0, g]);
        let by_eps = principal.derivative(values, &matrix, [-lame, -lame - 2.0 * g, -lame, 0.0]);
        Ok(Response {
            tau_pa: new[3],
            sigma_yy_pa: -new[1],
            tangent_pa: [by_gamma[3], by_eps[3], -by_gamma[1], -by_eps[1]],
        })
    }

    fn pore_stiffness_pa(&self) -> f64 {
        self.k_w_gpa * GPA / self.porosity
    }

    fn damping(&self, _: &Point) -> Damping {
        Damping::Rayleigh { ratio: self.damping_ratio }
    }
}
