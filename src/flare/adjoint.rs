//! Reverse pass of the rollout: gradients with respect to the initial state and the coefficients.
//!
//! With λ the cotangent of `z_{t+1}` and `J_s` the Jacobian of f at stage s,
//!
//! ```text
//! g_4 = λ/6,  g_3 = λ/3 + J_4ᵀ g_4,  g_2 = λ/3 + J_3ᵀ g_3 / 2,  g_1 = λ/6 + J_2ᵀ g_2 / 2        (1)
//! λ_t = ∂L/∂z_t + λ + Σ_s J_sᵀ g_s,   ∂L/∂Ξ += Σ_s θ_s g_sᵀ                                    (2)
//! ```
//!
//! This is the exact derivative of the discrete rollout, not a discretised continuous adjoint.

use super::integrator::{Forcing, Trajectory};
use super::kernels::{Kernel, LANES, Lanes, dispatch};
use super::library::{Library, accumulate_outer, transpose};

struct Reverse<'a> {
    library: Library,
    xi_t: &'a [f32],
    forcing: &'a Forcing,
    trajectory: &'a Trajectory,
    dz: &'a mut [Lanes],
    dxi: &'a mut [Lanes],
}

/// Runs back through `trajectory`: `dz[n_step · r]` holds ∂L/∂z_t on entry and ∂L/∂z_0, all paths counted, in its first
/// `r` entries on return; ∂L/∂Ξ is added to `dxi[n_term · r]`, still one value per lane.
///
/// Entries of `dz` past the valid part of a lane are ignored.
pub fn reverse(
    library: Library,
    xi: &[f32],
    forcing: &Forcing,
    trajectory: &Trajectory,
    dz: &mut [Lanes],
    dxi: &mut [Lanes],
) {
    dispatch(Reverse { library, xi_t: &transpose(xi, library.latent), forcing, trajectory, dz, dxi });
}

impl Kernel for Reverse<'_> {
    type Out = ();
    #[inline(always)]
    fn run<const FMA: bool>(self) {
        let (r, m) = (self.library.latent, self.library.n_term());
        let n_step = self.forcing.n_step();
        let mut theta = vec![Lanes::ZERO; 4 * m];
        let mut g = vec![Lanes::ZERO; 4 * r];
        let mut work = vec![Lanes::ZERO; m];
        let mut pulled = vec![Lanes::ZERO; r];
        let mut lambda = vec![Lanes::ZERO; r];
        for t in (1..n_step).rev() {
            lambda.iter_mut().zip(&self.dz[t * r..]).for_each(|(l, d)| l.add::<FMA>(d));
            for lane in 0..LANES {
                if t >= self.trajectory.valid[lane] {
                    lambda.iter_mut().for_each(|l| l.0[lane] = 0.0);
                }
            }
            self.trajectory.limits.pull_back(&self.trajectory.z[t * r..(t + 1) * r], &mut lambda);
            let stages = &self.trajectory.stages[(t - 1) * 4 * r..t * 4 * r];
            pulled.fill(Lanes::ZERO);
            let mut total = lambda.clone();
            for (s, (own, from_next)) in
                [(1.0 / 6.0, 0.5), (1.0 / 3.0, 0.5), (1.0 / 3.0, 1.0), (1.0 / 6.0, 0.0)].into_iter().enumerate().rev()
            {
                let z = &stages[s * r..(s + 1) * r];
                let g = &mut g[s * r..(s + 1) * r];
                for k in 0..r {
                    g[k] = Lanes::ZERO;
                    g[k].add_scaled::<FMA>(&lambda[k], own);
                    g[k].add_scaled::<FMA>(&pulled[k], from_next); // (1)
                }
                let drive = self.forcing.stage(t, s);
                self.library.terms(z, drive, &mut theta[s * m..(s + 1) * m]);
                pulled.fill(Lanes::ZERO);
                self.library.pull_back::<FMA>(z, drive, self.xi_t, g, &mut work, &mut pulled);
                if s > 0 {
                    self.trajectory.limits.pull_back(z, &mut pulled);
                }
                for k in 0..r {
                    total[k].add::<FMA>(&pulled[k]);
                }
            }
            let theta_of = |s: usize| &theta[s * m..(s + 1) * m];
            let g_of = |s: usize| &g[s * r..(s + 1) * r];
            accumulate_outer::<FMA, 4>([0, 1, 2, 3].map(theta_of), [0, 1, 2, 3].map(g_of), r, self.dxi); // (2)
            std::mem::swap(&mut lambda, &mut total);
        }
        self.dz.iter_mut().zip(&lambda).for_each(|(d, l)| d.add::<FMA>(l));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flare::integrator::rollout;
    use crate::flare::memory::Drive;
    use crate::numerics::random::stream;
    use rand::RngExt;

    /// Plain f64 rollout of one lane; returns Σ_t w_t · z_t.
    /// `u` and `u_half` hold base acceleration and one memory a sample.
    fn value(r: usize, xi: &[f64], z0: &[f64], u: &[f64], u_half: &[f64], weight: &[f64]) -> f64 {
        let f = |z: &[f64], u: &[f64]| -> Vec<f64> {
            let mut theta = vec![1.0];
            theta.extend(z);
            (0..r).for_each(|i| (i..r).for_each(|j| theta.push(z[i] * z[j])));
            theta.push(u[0]);
            theta.extend(z.iter().chain([&u[0]]).map(|x| u[1] * x));
            (0..r).map(|k| theta.iter().enumerate().map(|(p, t)| t * xi[p * r + k]).sum()).collect()
        };
        let ahead = |z: &[f64], k: &[f64], h: f64| -> Vec<f64> { z.iter().zip(k).map(|(z, k)| z + h * k).collect() };
        let mut z = z0.to_vec();
        let mut sum = 0.0;
        let n_step = u.len() / 2;
        let (u, u_half) = (|t: usize| &u[2 * t..2 * t + 2], |t: usize| &u_half[2 * t..2 * t + 2]);
        for t in 0..n_step {
            sum += (0..r).map(|k| weight[t * r + k] * z[k]).sum::<f64>();
            if t + 1 < n_step {
                let k1 = f(&z, u(t));
                let k2 = f(&ahead(&z, &k1, 0.5), u_half(t));
                let k3 = f(&ahead(&z, &k2, 0.5), u_half(t));
                let k4 = f(&ahead(&z, &k3, 1.0), u(t + 1));
                for k in 0..r {
                    z[k] += (k1[k] + 2.0 * k2[k] + 2.0 * k3[k] + k4[k]) / 6.0;
                }
            }
        }
        sum
    }

    #[test]
    fn gradients_of_the_rollout_match_finite_differences_in_double_precision() {
        let (r, n_step, lane) = (3, 12, 7);
        let library = Library { latent: r, memories: 1, energies: 0 };
        let mut random = stream(3, "adjoint test");
        let mut draw = |n: usize, scale: f64| -> Vec<f64> {
            (0..n).map(|_| f64::from(((random.random::<f64>() - 0.5) * 2.0 * scale) as f32)).collect()
        };
        let xi = draw(library.n_coefficient(), 0.05);
        let (z0, u, u_half, weight) =
            (draw(r, 1.0), draw(2 * n_step, 1.0), draw(2 * n_step - 2, 1.0), draw(n_step * r, 1.0));

        let single = |x: &[f64]| x.iter().map(|v| *v as f32).collect::<Vec<f32>>();
        let in_lane = |x: &[f64]| -> Vec<Lanes> {
            x.iter()
                .map(|v| {
                    let mut l = Lanes::ZERO;
                    l.0[lane] = *v as f32;
                    l
                })
                .collect()
        };
        let mut forcing = Forcing::default();
        forcing.reset(n_step, 2);
        forcing.set(lane, &Drive { width: 2, at: single(&u).into(), half: single(&u_half).into() }, 0..n_step, 1.0);
        let mut trajectory = Trajectory::default();
        rollout(library, &single(&xi), &in_lane(&z0), &forcing, 1e3, &mut trajectory);
        let mut dz = in_lane(&weight);
        let mut dxi = vec![Lanes::ZERO; xi.len()];
        reverse(library, &single(&xi), &forcing, &trajectory, &mut dz, &mut dxi);

        let slope = |x: &[f64], i: usize, f: &dyn Fn(&[f64]) -> f64| {
            let (mut up, mut down) = (x.to_vec(), x.to_vec());
            up[i] += 1e-6;
            down[i] -= 1e-6;
            (f(&up) - f(&down)) / 2e-6
        };
        for (i, d) in dxi.iter().enumerate() {
            let exact = slope(&xi, i, &|xi| value(r, xi, &z0, &u, &u_half, &weight));
            assert!(
                (f64::from(d.sum()) - exact).abs() < 2e-5 * (1.0 + exact.abs()),
                "coefficient {i}: {} {exact}",
                d.sum()
            );
        }
        for (i, d) in dz[..r].iter().enumerate() {
            let exact = slope(&z0, i, &|z0| value(r, &xi, z0, &u, &u_half, &weight));
            assert!((f64::from(d.0[lane]) - exact).abs() < 2e-5 * (1.0 + exact.abs()), "initial state {i}");
        }
    }
}
