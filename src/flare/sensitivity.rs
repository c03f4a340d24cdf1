//! Forward sensitivities: how every state of a rollout answers to every coefficient.
//!
//! With `J_s` the Jacobian of f and `θ_s` its terms at Runge–Kutta stage s, one step of the rollout has the derivative
//!
//! ```text
//! M_4 = 1/6,  M_3 = 1/3 + M_4 J_4,  M_2 = 1/3 + M_3 J_3 / 2,  M_1 = 1/6 + M_2 J_2 / 2                     (1)
//! S_t = A S_{t−1} + Σ_s θ_sᵀ ⊗ M_s,   A = 1 + Σ_s M_s J_s,   S_t = ∂z_t/∂Ξ                                (2)
//! ```
//!
//! Where a soft limit acts, its slope multiplies what passes through it. This is the exact derivative of the discrete rollout, the same one the reverse pass of [`super::adjoint`] follows
//! backwards. Rows of `S` belong to coefficients in the order of Ξ, columns to states, so that the second part of (2) is
//! one product of narrow matrices.

use super::integrator::{Forcing, Trajectory};
use super::kernels::{Kernel, Lanes, dispatch};
use super::library::{Library, transpose};
use super::mlp::{product, view, view_mut};
use faer::Accum;

/// The derivative of one step of a group, lane by lane.
pub struct StepSlope {
    /// Aᵀ, `[r · r]`.
    a: Vec<Lanes>,
    /// Of each stage M_sᵀ, `[4 · r · r]`.
    m: Vec<Lanes>,
    /// Of each stage θ_s, `[4 · n_term]`.
    theta: Vec<Lanes>,
}

struct Linearise<'a> {
    library: Library,
    xi_t: &'a [f32],
    forcing: &'a Forcing,
    trajectory: &'a Trajectory,
    t: usize,
}

/// The derivative of the step of a rollout that ends at sample `t`, at the coefficients `xi` it was rolled out with.
pub fn linearise(library: Library, xi: &[f32], forcing: &Forcing, trajectory: &Trajectory, t: usize) -> StepSlope {
    dispatch(Linearise { library, xi_t: &transpose(xi, library.latent), forcing, trajectory, t })
}

impl Kernel for Linearise<'_> {
    type Out = StepSlope;
    #[inline(always)]
    fn run<const FMA: bool>(self) -> StepSlope {
        let (r, n_term, t) = (self.library.latent, self.library.n_term(), self.t);
        let stages = &self.trajectory.stages[(t - 1) * 4 * r..t * 4 * r];
        let mut slope =
            StepSlope { a: identity(r, 1.0), m: vec![Lanes::ZERO; 4 * r * r], theta: vec![Lanes::ZERO; 4 * n_term] };
        let limits = &self.trajectory.limits;
        let mut jacobian = vec![Lanes::ZERO; r * r];
        let mut work = vec![Lanes::ZERO; n_term];
        let mut unit = vec![Lanes::ZERO; r];
        let mut pulled = vec![Lanes::ZERO; r * r]; // (M_{s+1} J_{s+1})ᵀ
        for (s, (own, from_next)) in
            [(1.0 / 6.0, 0.5), (1.0 / 3.0, 0.5), (1.0 / 3.0, 1.0), (1.0 / 6.0, 0.0)].into_iter().enumerate().rev()
        {
            let z = &stages[s * r..(s + 1) * r];
            let drive = self.forcing.stage(t, s);
            self.library.terms(z, drive, &mut slope.theta[s * n_term..(s + 1) * n_term]);
            jacobian.fill(Lanes::ZERO);
            for k in 0..r {
                unit[k] = Lanes::splat(1.0);
                let row = &mut jacobian[k * r..(k + 1) * r];
                self.library.pull_back::<FMA>(z, drive, self.xi_t, &unit, &mut work, row);
                unit[k] = Lanes::ZERO;
            }
            let m = &mut slope.m[s * r * r..(s + 1) * r * r];
            m.copy_from_slice(&identity(r, own)); // (1)
            m.iter_mut().zip(&pulled).for_each(|(m, p)| m.add_scaled::<FMA>(p, from_next));
            // (M J)ᵀ = Jᵀ Mᵀ, both kept transposed: entry (i, k) sums J[j][i] Mᵀ[j][k]
            pulled.fill(Lanes::ZERO);
            for j in 0..r {
                for i in 0..r {
                    let slope = jacobian[j * r + i];
                    for k in 0..r {
                        pulled[i * r + k].add_product::<FMA>(&slope, &m[j * r + k]);
                    }
                }
            }
            for i in (0..r).filter(|_| s > 0) {
                if let Some(limit) = limits.slope(z, i) {
                    pulled[i * r..(i + 1) * r].iter_mut().for_each(|p| *p = Lanes::product(p, &limit));
                }
            }
            slope.a.iter_mut().zip(&pulled).for_each(|(a, p)| a.add_scaled::<FMA>(p, 1.0)); // (2)
        }
        for i in 0..r {
            if let Some(limit) = limits.slope(&self.trajectory.z[t * r..(t + 1) * r], i) {
                let of_state = slope.a.iter_mut().chain(&mut slope.m).skip(i).step_by(r);
                of_state.for_each(|x| *x = Lanes::product(x, &limit));
            }
        }
        slope
    }
}

fn identity(r: usize, value: f32) -> Vec<Lanes> {
    (0..r * r).map(|i| if i / r == i % r { Lanes::splat(value) } else { Lanes::ZERO }).collect()
}

/// The sensitivities of one lane, carried from sample to sample.
#[derive(Default)]
pub struct Sensitivity {
    /// Sᵀ, `[n_coefficient · r]`.
    pub state: Vec<f32>,
    next: Vec<f32>,
}

impl Sensitivity {
    /// At the initial state, which no coefficient moves.
    pub fn new(library: Library) -> Self {
        let n = library.n_coefficient() * library.latent;
        Self { state: vec![0.0; n], next: vec![0.0; n] }
    }

    /// Carries them over the step `slope` (2) in `lane`.
    pub fn advance(&mut self, library: Library, slope: &StepSlope, lane: usize) {
        let (r, n_term, n) = (library.latent, library.n_term(), library.n_coefficient());
        let of_lane = |lanes: &[Lanes]| lanes.iter().map(|l| l.0[lane]).collect::<Vec<f32>>();
        let (a, m, theta) = (of_lane(&slope.a), of_lane(&slope.m), of_lane(&slope.theta));
        let next = &mut self.next[..];
        product(view_mut(next, n, r), Accum::Replace, view(&self.state, n, r), view(&a, r, r));
        product(view_mut(next, n_term, r * r), Accum::Add, view(&theta, 4, n_term).transpose(), view(&m, 4, r * r));
        std::mem::swap(&mut self.state, &mut self.next);
    }
}
