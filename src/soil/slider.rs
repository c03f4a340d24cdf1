//! An interface that slips: a cap on the shear stress of one element.

use super::{Damping, Increment, Law, Point, Refusal, Response};
use crate::error::Result;

/// A law in series with a rigid-plastic slider.
///
/// ```text
/// γ = γ_law + γ_slip,   |τ| ≤ τ_max,   γ_slip moves only where |τ| = τ_max              (1)
/// slipping:   ∂τ = 0,   ∂σ/∂ε = ∂σ_law/∂ε − ∂σ_law/∂γ ∂τ_law/∂ε / (∂τ_law/∂γ)           (2)
/// ```
///
/// | symbol | field        | unit | range  |
/// |--------|--------------|------|--------|
/// | τ_max  | `tau_max_pa` | Pa   | > 0    |
/// | state  | the law's    |      |        |
///
/// Limits: τ_max does not depend on the normal stress; the slip is spread over the element that holds it. A softening
/// law that falls below τ_max by itself does not slip.
/// Check: `tests/verification/boundaries.rs`: sliding block under a rectangular pulse in closed form, plateau of the
/// acceleration above.
/// Source: Newmark (1965), doi 10.1680/geot.1965.15.2.139.
pub struct Slider {
    law: Box<dyn Law>,
    tau_max_pa: f64,
}

impl Slider {
    /// `law` behind a slider.
    pub fn new(law: Box<dyn Law>, tau_max_pa: f64) -> Self {
        Self { law, tau_max_pa }
    }
}

const MAX_ITERATIONS: usize = 50;

impl Law for Slider {
    fn n_state(&self) -> usize {
        self.law.n_state()
    }

    fn start(&self, point: &Point, state: &mut [f64]) -> Result<[f64; 4]> {
        self.law.start(point, state)
    }

    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal> {
        let mut response = self.law.update(increment, committed, trial)?;
        if response.tau_pa.abs() <= self.tau_max_pa {
            return Ok(response);
        }
        // The law's share of the increment, by Newton's iteration between the stuck share and none.
        let limit = self.tau_max_pa.copysign(response.tau_pa);
        let mut inside = increment;
        for _ in 0..MAX_ITERATIONS {
            let miss = response.tau_pa - limit;
            if miss.abs() <= 1e-7 * self.tau_max_pa {
                let t = response.tangent_pa;
                return Ok(Response {
                    tau_pa: limit,
                    sigma_yy_pa: response.sigma_yy_pa,
                    tangent_pa: [0.0, 0.0, 0.0, t[3] - t[2] * t[1] / t[0]], // (2)
                });
            }
            inside.gamma -= miss / response.tangent_pa[0];
            response = self.law.update(inside, committed, trial)?;
        }
        Err(Refusal::Return)
    }

    fn relax_all(&self, dt_s: f64, committed: &[f64], responses: &mut [Response]) {
        self.law.relax_all(dt_s, committed, responses);
        for response in responses {
            response.tau_pa = response.tau_pa.clamp(-self.tau_max_pa, self.tau_max_pa);
        }
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
