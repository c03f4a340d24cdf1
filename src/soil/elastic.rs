//! Linear elasticity.

use super::{Increment, Law, Material, Point, Refusal, Response};
use crate::error::{Error, Result};
use crate::registry::{self, Entry};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub(super) const ENTRY: Entry<dyn Law> = Entry {
    name: "elastic",
    about: "linear isotropic elasticity with G = ρ Vs²",
    build: |table| Ok(Box::new(registry::params::<Elastic>(table)?.checked()?)),
    schema: || schemars::schema_for!(Elastic),
};

/// Linear isotropic elasticity in plane strain.
///
///     τ = G γ,   G = ρ Vs²                                                  (1)
///     σ_yy = (λ + 2G) ε_yy,   λ = 2 G ν / (1 − 2ν)                          (2)
///
/// | symbol | field           | unit | range      |
/// |--------|-----------------|------|------------|
/// | ν      | `poisson_ratio` | –    | 0…0.49     |
/// | e      | `void_ratio`    | –    | 0.1…5      |
/// | ξ      | `damping`       | –    | 0…0.3      |
///
/// Limits: no strength, no hysteresis; `damping` is realised as Rayleigh damping of the element.
/// Check:  the rigid-base transfer function against the exact one.
/// Source: any text on elasticity.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
struct Elastic {
    /// Drained Poisson's ratio.
    poisson_ratio: f64,
    /// Void ratio, for the pore water below the water table.
    void_ratio: f64,
    /// Small-strain damping, fraction of critical.
    damping: f64,
}

impl Default for Elastic {
    fn default() -> Self {
        Self { poisson_ratio: 0.3, void_ratio: 0.7, damping: 0.0 }
    }
}

impl Elastic {
    fn checked(self) -> Result<Self> {
        check("poisson_ratio", self.poisson_ratio, 0.0, 0.49)?;
        check("void_ratio", self.void_ratio, 0.1, 5.0)?;
        check("damping", self.damping, 0.0, 0.3)?;
        Ok(self)
    }
}

/// Refuses `value` outside `lowest…highest`.
pub(super) fn check(name: &str, value: f64, lowest: f64, highest: f64) -> Result<()> {
    if (lowest..=highest).contains(&value) {
        return Ok(());
    }
    Err(Error::new(format!("`{name}` must be in {lowest}…{highest}, got {value}")).usage())
}

struct Placed {
    shear_pa: f64,
    constrained_pa: f64,
    void_ratio: f64,
    damping: f64,
}

impl Law for Elastic {
    fn at(&self, point: &Point) -> Result<Box<dyn Material>> {
        let shear_pa = point.shear_modulus_pa(); // (1)
        let constrained_pa = constrained_modulus_pa(shear_pa, self.poisson_ratio); // (2)
        Ok(Box::new(Placed { shear_pa, constrained_pa, void_ratio: self.void_ratio, damping: self.damping }))
    }
}

/// λ + 2G for a shear modulus and Poisson's ratio.
pub(super) fn constrained_modulus_pa(shear_pa: f64, poisson_ratio: f64) -> f64 {
    2.0 * shear_pa * (1.0 - poisson_ratio) / (1.0 - 2.0 * poisson_ratio)
}

impl Material for Placed {
    fn n_state(&self) -> usize {
        2
    }

    fn initial(&self, state: &mut [f64]) {
        state.fill(0.0);
    }

    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal> {
        trial[0] = committed[0] + increment.gamma;
        trial[1] = committed[1] + increment.epsilon_yy;
        let (tau_pa, sigma_yy_pa) = (self.shear_pa * trial[0], self.constrained_pa * trial[1]);
        Ok(Response { tau_pa, sigma_yy_pa, tangent_pa: self.initial_tangent_pa() })
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
