//! The rate equations: plastic flow and hardening at one state.

use super::tensor::Tensor;
use super::{Placed, State};

const SQRT_2_3: f64 = 0.816_496_580_927_726;

/// Everything of (4) to (9) that does not depend on the strain rate.
pub(super) struct Flow {
    pub shear: f64,
    pub bulk: f64,
    /// Loading direction n.
    n: Tensor,
    /// n:r
    n_r: f64,
    /// 2G R' + K D I
    relaxation: Tensor,
    /// Denominator of (9).
    denominator: f64,
    /// ⅔ h (α_b − α)
    back_stress_rate: Tensor,
    /// D
    dilatancy: f64,
}

/// Changes of a state.
#[derive(Clone, Copy)]
pub(super) struct Change {
    pub stress: Tensor,
    pub alpha: Tensor,
    pub fabric: Tensor,
    pub void_ratio: f64,
}

/// Stiffness at a state: elastic moduli and, on the yield surface, what plasticity takes away.
pub(super) struct Stiffness {
    pub shear: f64,
    pub bulk: f64,
    pub flow: Option<Flow>,
}

impl Placed {
    /// (1)
    #[inline(always)]
    pub(super) fn moduli(&self, p_bar: f64, void_ratio: f64) -> (f64, f64) {
        let gap = 2.97 - void_ratio;
        let shear = self.g_0 * gap * gap / (1.0 + void_ratio) * (p_bar * self.p_a).sqrt();
        (shear, 2.0 * (1.0 + self.law.nu) / (3.0 * (1.0 - 2.0 * self.law.nu)) * shear)
    }

    /// Loading direction (4) at `state`.
    #[inline(always)]
    pub(super) fn direction(&self, state: &State) -> Tensor {
        let p_bar = state.stress.trace() / 3.0 + self.p_t;
        let offset = state.stress.deviator() * (1.0 / p_bar) - state.alpha;
        offset * (1.0 / offset.norm().max(1e-14))
    }

    pub(super) fn flow(&self, state: &State) -> Flow {
        let law = &self.law;
        let p_bar = state.stress.trace() / 3.0 + self.p_t;
        let (shear, bulk) = self.moduli(p_bar, state.void_ratio);
        let r = state.stress.deviator() * (1.0 / p_bar);
        let offset = r - state.alpha;
        let n = offset * (1.0 / offset.norm().max(1e-14));
        let n_squared = n.square();
        let tr_n3 = n_squared.dot(n);
        let cos_3theta = (6.0f64.sqrt() * tr_n3).clamp(-1.0, 1.0);
        let c = law.m_e / law.m_c;
        let g = 2.0 * c / ((1.0 + c) - (1.0 - c) * cos_3theta); // (4)
        let ratio = p_bar / self.p_a;
        let psi = state.void_ratio - (law.e_0 - law.lambda_c * ratio.powf(law.xi)); // (2)
        let bound = SQRT_2_3 * (g * law.m_c * (-law.n_b * psi).exp() - law.m); // (5)
        let dilatant = SQRT_2_3 * (g * law.m_c * (law.n_d * psi).exp() - law.m);
        let alpha_n = state.alpha.dot(n);
        let distance_in = (state.alpha - state.alpha_in).dot(n).max(MIN_DISTANCE);
        let h = self.g_0 * law.h_0 * (1.0 - law.c_h * state.void_ratio) / ratio.sqrt() / distance_in; // (6)
        let hardening = 2.0 / 3.0 * p_bar * h * (bound - alpha_n);
        let mut dilatancy = law.a_0 * (1.0 + state.fabric.dot(n).max(0.0)) * (dilatant - alpha_n); // (7)
        if dilatancy > 0.0 {
            dilatancy *= (p_bar / self.p_t).min(1.0);
        }
        let shape = (1.0 - c) / c * g;
        let b = 1.0 + 1.5 * shape * cos_3theta; // (8)
        let c_flow = 3.0 * 1.5f64.sqrt() * shape;
        let deviatoric = n * b - (n_squared - Tensor::UNIT * (1.0 / 3.0)) * c_flow;
        let n_r = n.dot(r);
        Flow {
            shear,
            bulk,
            n,
            n_r,
            relaxation: deviatoric * (2.0 * shear) + Tensor::UNIT * (bulk * dilatancy),
            denominator: hardening + 2.0 * shear * (b - c_flow * tr_n3) - bulk * dilatancy * n_r,
            back_stress_rate: (n * bound - state.alpha) * (2.0 / 3.0 * h),
            dilatancy,
        }
    }

    /// Change of `state` over `strain` with the rates at `state`, (9) to (11).
    pub(super) fn plastic_change(&self, state: &State, flow: &Flow, strain: Tensor) -> Change {
        let volumetric = strain.trace();
        let elastic = strain.deviator() * (2.0 * flow.shear) + Tensor::UNIT * (flow.bulk * volumetric);
        let load = flow.load(strain).max(0.0);
        let plastic_volumetric = load * flow.dilatancy;
        let growth = self.law.c_z * (-plastic_volumetric).max(0.0);
        Change {
            stress: elastic - flow.relaxation * load, // (10)
            alpha: flow.back_stress_rate * load,      // (11)
            fabric: (flow.n * self.law.z_max + state.fabric) * -growth,
            void_ratio: -(1.0 + state.void_ratio) * volumetric,
        }
    }
}

/// Smallest (α − α_in):n, which keeps h of (6) finite at a reversal.
const MIN_DISTANCE: f64 = 1e-7;

impl Flow {
    /// Loading index (9) of a strain increment.
    #[inline(always)]
    pub(super) fn load(&self, strain: Tensor) -> f64 {
        let numerator = 2.0 * self.shear * self.n.dot(strain.deviator()) - self.n_r * self.bulk * strain.trace();
        if self.denominator > 0.0 { numerator / self.denominator } else { 0.0 }
    }
}

impl Stiffness {
    /// ∂(τ, σ_yy)/∂(γ, ε_yy), tension positive as the column wants it.
    pub(super) fn plane(&self) -> [[f64; 2]; 2] {
        let mut tangent = [[self.shear, 0.0], [0.0, self.bulk + 4.0 / 3.0 * self.shear]];
        if let Some(flow) = &self.flow {
            // Unit γ is tensor strain −½ xy, unit ε_yy is −1 yy; stresses change sign back.
            let strains = [Tensor([0.0, 0.0, 0.0, -0.5]), Tensor([0.0, -1.0, 0.0, 0.0])];
            for (column, strain) in strains.into_iter().enumerate() {
                let load = flow.load(strain);
                tangent[0][column] += flow.relaxation.0[3] * load;
                tangent[1][column] += flow.relaxation.0[1] * load;
            }
        }
        tangent
    }
}
