//! Constitutive laws: one law a file, registered in [`LAWS`].
//!
//! A law is an immutable value; the memory of every soil point is a slice that the column owns. Laws see plane-strain
//! shear-column kinematics only: shear strain γ and vertical strain ε_yy, tension positive, ε_xx = ε_zz = 0. Stresses
//! handed back are **effective**; the column adds the pore water.
//!
//! [`Scaled`] and [`Slider`] are laws around a law: they add softening, rate dependence or an interface that slips to
//! any of the registered ones. [`Viscoelastic`] gives a law damping at small strains.

mod batch;
mod cam_clay;
mod elastic;
mod hyperbolic;
mod mohr_coulomb;
mod principal;
mod rate;
mod relaxation;
mod sanisand;
mod scaled;
mod slider;
mod softening;
mod viscoelastic;

pub use batch::{Batch, Shear, Steps};
pub use cam_clay::CAM_CLAY_M;
pub use rate::Rate;
pub use relaxation::{Damping, N_BODY, REFERENCE_HZ, Relaxation, bodies, relaxations};
pub use scaled::{Scaled, Scaling};
pub use slider::Slider;
pub use softening::Softening;
pub use viscoelastic::Viscoelastic;

use crate::error::{Error, Result};
use crate::numerics::lanes::Width;
use crate::registry::Entry;
use batch::LaneByLane;
use std::fmt;

/// Every law a manifest can name: a file, its `mod` line and a line here.
pub const LAWS: &[Entry<dyn Law>] =
    &[elastic::ENTRY, hyperbolic::ENTRY, mohr_coulomb::ENTRY, cam_clay::ENTRY, sanisand::ENTRY];

/// Where a soil point is and what it carries before shaking; compression positive, effective.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Depth below the surface, m.
    pub depth_m: f64,
    /// Mass density of the wet soil, kg/m³.
    pub density_kg_m3: f64,
    /// Shear-wave velocity at the geostatic state, m/s.
    pub vs_m_s: f64,
    /// Vertical effective stress, Pa.
    pub vertical_pa: f64,
    /// Horizontal effective stress, Pa.
    pub horizontal_pa: f64,
}

impl Point {
    /// Mean effective stress, Pa.
    pub fn mean_pa(&self) -> f64 {
        (self.vertical_pa + 2.0 * self.horizontal_pa) / 3.0
    }

    /// Small-strain shear modulus ρ·Vs², Pa.
    pub fn shear_modulus_pa(&self) -> f64 {
        self.density_kg_m3 * self.vs_m_s * self.vs_m_s
    }
}

/// Strain increment of one step, tension positive.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Increment {
    /// Δγ = Δ(∂u/∂z).
    pub gamma: f64,
    /// Δε_yy, vertical.
    pub eps_yy: f64,
    /// Time it takes, s; only laws that depend on the rate look at it.
    pub dt_s: f64,
}

impl Increment {
    /// An increment at no particular rate.
    pub fn new(gamma: f64, eps_yy: f64) -> Self {
        Self { gamma, eps_yy, dt_s: 0.0 }
    }
}

/// Stress at the end of the increment and its derivative, tension positive, effective.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Response {
    /// Shear stress τ, Pa.
    pub tau_pa: f64,
    /// Vertical effective stress σ'_yy, Pa.
    pub sigma_yy_pa: f64,
    /// [∂τ/∂γ, ∂τ/∂ε_yy, ∂σ/∂γ, ∂σ/∂ε_yy], Pa.
    pub tangent_pa: [f64; 4],
}

/// Why a law could not follow an increment; the column answers by a shorter step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The integration would need more substeps than allowed.
    Substeps,
    /// The return to the yield surface did not converge.
    Return,
    /// Stress or strain is not a finite number.
    NotFinite,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Substeps => "the stress integration needs more substeps than allowed",
            Self::Return => "the return to the yield surface does not converge",
            Self::NotFinite => "stress or strain is not finite",
        })
    }
}

/// A constitutive law.
pub trait Law: Send + Sync {
    /// Numbers of memory per point.
    fn n_state(&self) -> usize;

    /// Writes the geostatic memory of a point and returns the elastic tangent there.
    ///
    /// # Errors
    /// When the law cannot exist at this stress (outside its strength, for example).
    fn start(&self, point: &Point, state: &mut [f64]) -> Result<[f64; 4]>;

    /// [`Law::start`] of many points: elastic tangents to `elastic_pa`; the error names the first point refused.
    ///
    /// # Errors
    /// When the law cannot exist at the stress of a point.
    fn start_all(
        &self,
        points: &[Point],
        state: &mut [f64],
        elastic_pa: &mut [[f64; 4]],
    ) -> Result<(), (usize, Box<Error>)> {
        let memory = state.chunks_exact_mut(self.n_state());
        for (i, ((point, elastic), state)) in points.iter().zip(elastic_pa).zip(memory).enumerate() {
            *elastic = self.start(point, state).map_err(|error| (i, Box::new(error)))?;
        }
        Ok(())
    }

    /// Response after `increment`, from `committed` memory to `trial` memory.
    ///
    /// # Errors
    /// When the increment is too large to follow.
    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal>;

    /// [`Law::update`] of many points, memory as [`Law::start_all`] laid it out (point after point, unless a law
    /// overrides both); the error names the first point refused.
    ///
    /// # Errors
    /// When the increment of a point is too large to follow.
    fn update_all(
        &self,
        increments: &[Increment],
        committed: &[f64],
        trial: &mut [f64],
        responses: &mut [Response],
    ) -> Result<(), (usize, Refusal)> {
        let n = self.n_state();
        let memory = committed.chunks_exact(n).zip(trial.chunks_exact_mut(n));
        for (i, ((increment, response), (old, new))) in increments.iter().zip(responses).zip(memory).enumerate() {
            *response = self.update(*increment, old, new).map_err(|refusal| (i, refusal))?;
        }
        Ok(())
    }

    /// Bulk stiffness of the pore water, K_w / porosity (Pa), where the point lies below the water table.
    fn pore_stiffness_pa(&self) -> f64;

    /// Small-strain damping that the law asks for beside its hysteresis.
    fn damping(&self, point: &Point) -> Damping;

    /// Turns the last accepted responses into those after `dt_s` without strain, for a law that relaxes: what the predictor
    /// of a step starts from.
    fn relax_all(&self, _dt_s: f64, _committed: &[f64], _responses: &mut [Response]) {}

    /// Points that start with the memory `start` and these responses, under as many motions at once as `width` has lanes; `None` where
    /// the law is followed lane by lane. See [`batch()`].
    fn batch<'l>(&'l self, _start: &'l [f64], _responses: &[Response], _width: Width) -> Option<Box<dyn Batch + 'l>> {
        None
    }

    /// Whether shear strain changes vertical stress or vertical strain shear stress. Where neither does, a column shaken sideways does not
    /// move vertically, and is solved without.
    fn couples(&self) -> bool {
        true
    }

    /// Viscosity over elastic stiffness, s: stiffness-proportional damping without which the law is not well posed.
    fn viscosity_s(&self) -> f64 {
        0.0
    }
}

/// Points of `law` that start with the memory `start` and these responses, under as many motions at once as `width` has lanes.
pub fn batch<'l>(law: &'l dyn Law, start: &'l [f64], responses: &[Response], width: Width) -> Box<dyn Batch + 'l> {
    let lane_by_lane =
        || Box::new(LaneByLane::new(law, start, responses.to_vec(), width.lanes())) as Box<dyn Batch + 'l>;
    law.batch(start, responses, width).unwrap_or_else(lane_by_lane)
}

/// The same of a law around `law` whose memory in `start` comes after that of `law`: the batch of `law`, and that memory.
fn batch_around<'l>(
    law: &'l dyn Law,
    start: &'l [f64],
    responses: &[Response],
    width: Width,
) -> (Box<dyn Batch + 'l>, &'l [f64]) {
    let (inner, own) = start.split_at(responses.len() * law.n_state());
    (batch(law, inner, responses, width), own)
}

/// [`Law::update`] of a law that is written for many points: the increment of one of them.
fn update_alone(
    law: &impl Law,
    increment: Increment,
    committed: &[f64],
    trial: &mut [f64],
) -> Result<Response, Refusal> {
    let mut response = [Response::default()];
    law.update_all(&[increment], committed, trial, &mut response).map_err(|(_, refusal)| refusal)?;
    Ok(response[0])
}

/// Collects range problems as (key, sentence).
struct Ranges(Vec<String>);

impl Ranges {
    fn new() -> Self {
        Self(Vec::new())
    }

    fn check(mut self, key: &str, value: f64, low: f64, high: f64) -> Self {
        if !(value >= low && value <= high) {
            self.0.push(format!("`{key}` must be in {low}…{high}, got {value}"));
        }
        self
    }

    fn done(self) -> Result<()> {
        if self.0.is_empty() { Ok(()) } else { Err(Error::new(self.0.join("; ")).usage()) }
    }
}
