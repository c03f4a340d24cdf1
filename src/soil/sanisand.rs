//! SANISAND: the bounding-surface sand of Dafalias and Manzari (2004) with fabric.

mod integrate;
mod rates;
mod tensor;

use super::elastic::check;
use super::{Increment, Law, Material, Point, Refusal, Response};
use crate::error::Result;
use crate::registry::{self, Entry};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use tensor::Tensor;

pub(super) const ENTRY: Entry<dyn Law> = Entry {
    name: "sanisand",
    about: "Dafalias–Manzari 2004 sand with fabric; G0 from density and shear-wave velocity",
    build: |table| Ok(Box::new(registry::params::<Sanisand>(table)?.checked()?)),
    schema: || schemars::schema_for!(Sanisand),
};

/// SANISAND with fabric (Dafalias and Manzari 2004); compression positive in this block, p̄ = p + p_t throughout.
///
///     G = G0 p_a (2.97 − e)²/(1 + e) (p̄/p_a)^½,  K = 2(1 + ν)/(3(1 − 2ν)) G                       (1)
///     ψ = e − e_c,  e_c = e_0 − λ_c (p̄/p_a)^ξ                                                     (2)
///     f = ‖s − p̄ α‖ − √⅔ m p̄                                                                      (3)
///     n = (r − α)/‖r − α‖,  r = s/p̄;  g = 2c/((1 + c) − (1 − c) cos 3θ),  c = M_e/M_c             (4)
///     α_b = √⅔ (g M_c e^(−n_b ψ) − m) n,  α_d = √⅔ (g M_c e^(n_d ψ) − m) n                        (5)
///     h = G0 h_0 (1 − c_h e)(p̄/p_a)^−½ / ((α − α_in):n),  K_p = ⅔ p̄ h (α_b − α):n                 (6)
///     D = A_0 (1 + ⟨z:n⟩)(α_d − α):n                                                              (7)
///     R' = B n − C (n² − ⅓ I),  B = 1 + 1.5 (1 − c)/c g cos 3θ,  C = 3 √1.5 (1 − c)/c g           (8)
///     L = (2G n:de − n:r K dε_v)/(K_p + 2G (B − C tr n³) − K D n:r)                               (9)
///     dσ = 2G de + K dε_v I − ⟨L⟩(2G R' + K D I)                                                 (10)
///     dα = ⟨L⟩ ⅔ h (α_b − α),  dz = −c_z ⟨−⟨L⟩ D⟩(z_max n + z)                                   (11)
///
/// G0 is chosen so that (1) gives ρ Vs² at the geostatic state. α starts at the geostatic stress ratio and so does α_in,
/// which jumps to α whenever (α − α_in):n turns negative. Where p̄ < p_t (tension carried by the residual pressure
/// alone), contraction is scaled by p̄/p_t, so that p̄ cannot vanish.
///
/// | symbol | field       | unit | range      |
/// |--------|-------------|------|------------|
/// | p_a    | `p_a_kpa`   | kPa  | 50…200     |
/// | e_0    | `e_0`       | –    | 0.3…2      |
/// | λ_c    | `lambda_c`  | –    | 0…0.5      |
/// | ξ      | `xi`        | –    | 0.1…2      |
/// | M_c    | `m_c`       | –    | 0.5…2      |
/// | M_e    | `m_e`       | –    | 0.3…2      |
/// | m      | `m`         | –    | 0.001…0.2  |
/// | ν      | `nu`        | –    | 0…0.45     |
/// | e_ini  | `e_ini`     | –    | 0.3…2      |
/// | h_0    | `h_0`       | –    | 0.1…100    |
/// | c_h    | `c_h`       | –    | 0…1.5      |
/// | n_b    | `n_b`       | –    | 0…10       |
/// | A_0    | `a_0`       | –    | 0…5        |
/// | n_d    | `n_d`       | –    | 0…10       |
/// | z_max  | `z_max`     | –    | 0…50       |
/// | c_z    | `c_z`       | –    | 0…5000     |
/// | p_t/p_a| `p_t_ratio` | –    | 0.001…0.2  |
/// | K_w    | `k_w_gpa`   | GPa  | 0.01…5     |
///
/// Limits: no plasticity at constant stress ratio; no cementation; (7) is scaled at p̄ < p_t.
/// Check:  the tests of this folder (independent reference paths, step-size objectivity, tangent).
/// Source: Dafalias and Manzari (2004), Simple plasticity sand model accounting for fabric change effects, J. Eng.
///         Mech. 130(6), eqs. 1–26, doi 10.1061/(ASCE)0733-9399(2004)130:6(622).
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Sanisand {
    p_a_kpa: f64,
    e_0: f64,
    lambda_c: f64,
    xi: f64,
    m_c: f64,
    m_e: f64,
    m: f64,
    nu: f64,
    e_ini: f64,
    h_0: f64,
    c_h: f64,
    n_b: f64,
    a_0: f64,
    n_d: f64,
    z_max: f64,
    c_z: f64,
    p_t_ratio: f64,
    #[serde(default = "default_water")]
    k_w_gpa: f64,
}

fn default_water() -> f64 {
    2.2
}

impl Sanisand {
    fn checked(self) -> Result<Self> {
        let ranges = [
            ("p_a_kpa", self.p_a_kpa, 50.0, 200.0),
            ("e_0", self.e_0, 0.3, 2.0),
            ("lambda_c", self.lambda_c, 0.0, 0.5),
            ("xi", self.xi, 0.1, 2.0),
            ("m_c", self.m_c, 0.5, 2.0),
            ("m_e", self.m_e, 0.3, 2.0),
            ("m", self.m, 0.001, 0.2),
            ("nu", self.nu, 0.0, 0.45),
            ("e_ini", self.e_ini, 0.3, 2.0),
            ("h_0", self.h_0, 0.1, 100.0),
            ("c_h", self.c_h, 0.0, 1.5),
            ("n_b", self.n_b, 0.0, 10.0),
            ("a_0", self.a_0, 0.0, 5.0),
            ("n_d", self.n_d, 0.0, 10.0),
            ("z_max", self.z_max, 0.0, 50.0),
            ("c_z", self.c_z, 0.0, 5000.0),
            ("p_t_ratio", self.p_t_ratio, 0.001, 0.2),
            ("k_w_gpa", self.k_w_gpa, 0.01, 5.0),
        ];
        for (name, value, lowest, highest) in ranges {
            check(name, value, lowest, highest)?;
        }
        Ok(self)
    }
}

impl Law for Sanisand {
    fn at(&self, point: &Point) -> Result<Box<dyn Material>> {
        let p_a = self.p_a_kpa * 1e3;
        let p_t = self.p_t_ratio * p_a;
        let p_bar = point.mean_effective_stress_pa() + p_t;
        let unit = p_a * (2.97 - self.e_ini).powi(2) / (1.0 + self.e_ini) * (p_bar / p_a).sqrt();
        let horizontal = point.k0 * point.vertical_effective_stress_pa;
        let stress = Tensor([horizontal, point.vertical_effective_stress_pa, horizontal, 0.0]);
        Ok(Box::new(Placed { law: self.clone(), p_a, p_t, g_0: point.shear_modulus_pa() / unit, stress })) // (1)
    }
}

/// The law at one point; all in Pa.
#[derive(Clone)]
struct Placed {
    law: Sanisand,
    p_a: f64,
    p_t: f64,
    g_0: f64,
    /// Geostatic effective stress, compression positive.
    stress: Tensor,
}

/// State of a point, compression positive.
#[derive(Debug, Clone, Copy, PartialEq)]
struct State {
    stress: Tensor,
    alpha: Tensor,
    fabric: Tensor,
    alpha_in: Tensor,
    void_ratio: f64,
}

const N_STATE: usize = 17;

impl State {
    fn read(slice: &[f64]) -> Self {
        let tensor = |i: usize| Tensor([slice[i], slice[i + 1], slice[i + 2], slice[i + 3]]);
        Self { stress: tensor(0), alpha: tensor(4), fabric: tensor(8), alpha_in: tensor(12), void_ratio: slice[16] }
    }

    fn write(&self, slice: &mut [f64]) {
        for (i, tensor) in [self.stress, self.alpha, self.fabric, self.alpha_in].iter().enumerate() {
            slice[4 * i..4 * i + 4].copy_from_slice(&tensor.0);
        }
        slice[16] = self.void_ratio;
    }
}

impl Placed {
    fn initial_state(&self) -> State {
        let p_bar = self.stress.trace() / 3.0 + self.p_t;
        let alpha = self.stress.deviator() * (1.0 / p_bar);
        State { stress: self.stress, alpha, fabric: Tensor::ZERO, alpha_in: alpha, void_ratio: self.law.e_ini }
    }
}

impl Material for Placed {
    fn n_state(&self) -> usize {
        N_STATE
    }

    fn initial(&self, state: &mut [f64]) {
        self.initial_state().write(state);
    }

    fn update(&self, increment: Increment, committed: &[f64], trial: &mut [f64]) -> Result<Response, Refusal> {
        let start = State::read(committed);
        // Tension-positive column strains become compression-positive tensor strains.
        let strain = Tensor([0.0, -increment.epsilon_yy, 0.0, -0.5 * increment.gamma]);
        let (end, stiffness) = self.integrate(&start, strain)?;
        end.write(trial);
        Ok(Response {
            tau_pa: -end.stress.0[3],
            sigma_yy_pa: self.stress.0[1] - end.stress.0[1],
            tangent_pa: stiffness.plane(),
        })
    }

    fn initial_tangent_pa(&self) -> [[f64; 2]; 2] {
        let state = self.initial_state();
        let (shear, bulk) = self.moduli(state.stress.trace() / 3.0 + self.p_t, state.void_ratio);
        [[shear, 0.0], [0.0, bulk + 4.0 / 3.0 * shear]]
    }

    fn void_ratio(&self) -> f64 {
        self.law.e_ini
    }

    fn water_bulk_modulus_pa(&self) -> f64 {
        self.law.k_w_gpa * 1e9
    }

    fn remark(&self) -> Option<String> {
        Some(format!("G0 = {:.2}", self.g_0))
    }
}
