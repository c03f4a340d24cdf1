//! Linear elasticity with the shear-wave velocity of the layer.

use super::{Damping, Increment, Law, Point, Ranges, Refusal, Response};
use crate::error::Result;
use crate::registry::{Entry, params};
use crate::units::GPA;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry<dyn Law> = Entry {
    name: "elastic",
    about: "linear elasticity, G = ρVs², with a small-strain damping ratio",
    build: |table| {
        let law: Elastic = params(table)?;
        Ranges::new()
            .check("poisson_ratio", law.poisson_ratio, 0.0, 0.495)
            .check("damping_ratio", law.damping_ratio, 0.0, 0.5)
            .check("damping_exponent", law.damping_exponent, -0.6, 0.6)
            .check("porosity", law.porosity, 0.01, 0.99)
            .check("k_w_gpa", law.k_w_gpa, 0.0, 10.0)
            .done()?;
        Ok(Box::new(law))
    },
    schema: || schemars::schema_for!(Elastic),
};

/// Isotropic linear elasticity.
///
/// ```text
/// τ = G γ,   σ'_yy = σ'_yy0 + M ε_yy,   G = ρ Vs²,   M = 2G(1−ν)/(1−2ν)        (1)
/// ```
///
/// | symbol | field           | unit | range     |
/// |--------|-----------------|------|-----------|
/// | ν      | `poisson_ratio` | –    | 0…0.495   |
/// | ξ      | `damping_ratio` | –    | 0…0.5     |
/// | n      | `damping_exponent` | – | −0.6…0.6  |
/// | φ      | `porosity`      | –    | 0.01…0.99 |
/// | K_w    | `k_w_gpa`       | GPa  | 0…10      |
///
/// Damping is [`Viscoelastic`](super::Viscoelastic): ξ(f) = ξ (f/f_r)ⁿ, f_r = 3 Hz, where Vs holds; n = 0 does not depend on
/// frequency. Who wants Rayleigh damping declares ξ = 0 and `[site.rayleigh]`.
///
/// Limits: no hysteresis, no strength.
/// Check: `tests/verification/transfer_function.rs`, `tests/verification/viscoelastic.rs`.
/// Source: any text on elasticity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Elastic {
    /// Poisson's ratio ν of the skeleton.
    poisson_ratio: f64,
    /// Small-strain damping ratio ξ.
    damping_ratio: f64,
    /// Exponent n of its growth with frequency.
    damping_exponent: f64,
    /// Porosity n (pore water below the water table).
    porosity: f64,
    /// Bulk modulus of water, GPa (0: drained).
    k_w_gpa: f64,
}

impl Default for Elastic {
    fn default() -> Self {
        Self { poisson_ratio: 0.3, damping_ratio: 0.0, damping_exponent: 0.0, porosity: 0.4, k_w_gpa: 2.2 }
    }
}

const TAU: usize = 0;
const SIGMA: usize = 1;
const G: usize = 2;
const M: usize = 3;

impl Law for Elastic {
    fn n_state(&self) -> usize {
        4
    }

    fn start(&self, point: &Point, state: &mut [f64]) -> Result<[f64; 4]> {
        let g = point.shear_modulus_pa();
        let nu = self.poisson_ratio;
        let m = 2.0 * g * (1.0 - nu) / (1.0 - 2.0 * nu);
        state.copy_from_slice(&[0.0, -point.vertical_pa, g, m]);
        Ok([g, 0.0, 0.0, m])
    }

    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal> {
        trial.copy_from_slice(committed);
        trial[TAU] += committed[G] * increment.gamma; // (1)
        trial[SIGMA] += committed[M] * increment.eps_yy;
        Ok(Response {
            tau_pa: trial[TAU],
            sigma_yy_pa: trial[SIGMA],
            tangent_pa: [committed[G], 0.0, 0.0, committed[M]],
        })
    }

    fn couples(&self) -> bool {
        false
    }

    fn pore_stiffness_pa(&self) -> f64 {
        self.k_w_gpa * GPA / self.porosity
    }

    fn damping(&self, _: &Point) -> Damping {
        Damping::Memory { ratio: self.damping_ratio, exponent: self.damping_exponent }
    }
}
