//! The single terms of the stage-1 loss with their cotangents: latent state and latent equation.

use super::integrator::{Forcing, Trajectory};
use super::kernels::{Kernel, LANES, Lanes};
use super::library::{Library, accumulate_outer, transpose};

/// Latent error `MSE(ẑ, sg z)` over the valid samples; its cotangent is added to `dz_roll`.
pub fn latent_residual(
    r: usize,
    z: &[Lanes],
    rolled: &Trajectory,
    weight: &Lanes,
    factor: f64,
    count: usize,
    dz_roll: &mut [Lanes],
) -> f64 {
    let scale = (2.0 * factor / count as f64) as f32;
    let mut sum = [0.0_f64; LANES];
    for t in 0..z.len() / r {
        for i in t * r..(t + 1) * r {
            for (lane, sum) in sum.iter_mut().enumerate() {
                if t < rolled.valid[lane] {
                    let error = rolled.z[i].0[lane] - z[i].0[lane];
                    *sum += f64::from(weight.0[lane] * error * error);
                    dz_roll[i].0[lane] += scale * weight.0[lane] * error;
                }
            }
        }
    }
    sum.iter().sum::<f64>() / count as f64
}

/// Equation error of the encoded states against the central difference; adds to `dz` and `dxi`.
pub struct EquationResidual<'a> {
    /// The candidate library.
    pub library: Library,
    /// Ξ per sample, `[n_term · r]`.
    pub xi: &'a [f32],
    /// Base acceleration and memories.
    pub forcing: &'a Forcing,
    /// Encoded states, `[n_step · r]`.
    pub z: &'a [Lanes],
    /// Weight of each lane.
    pub weight: &'a Lanes,
    /// One over the number of errors in the mean.
    pub inverse_count: f32,
    /// λ_eq.
    pub factor: f32,
    /// Cotangent of `z`, added to.
    pub dz: &'a mut [Lanes],
    /// Cotangent of Ξ, still one value per lane, added to.
    pub dxi: &'a mut [Lanes],
}

impl Kernel for EquationResidual<'_> {
    type Out = f64;
    #[inline(always)]
    fn run<const FMA: bool>(self) -> f64 {
        let (r, m) = (self.library.latent, self.library.n_term());
        let xi_t = transpose(self.xi, r);
        let mut theta = vec![Lanes::ZERO; m];
        let mut work = vec![Lanes::ZERO; m];
        let mut g = vec![Lanes::ZERO; r];
        let mut total = 0.0;
        for t in 1..self.forcing.n_step().saturating_sub(1) {
            let drive = self.forcing.stage(t + 1, 0);
            let z = &self.z[t * r..(t + 1) * r];
            self.library.terms(z, drive, &mut theta);
            self.library.combine::<FMA>(&theta, self.xi, &mut g);
            let mut sum = Lanes::ZERO;
            for (k, g) in g.iter_mut().enumerate() {
                g.add_scaled::<FMA>(&self.z[(t + 1) * r + k], -0.5);
                g.add_scaled::<FMA>(&self.z[(t - 1) * r + k], 0.5);
                let weighted = Lanes::product(g, self.weight);
                sum.add_product::<FMA>(g, &weighted);
                *g = Lanes::ZERO;
                g.add_scaled::<FMA>(&weighted, 2.0 * self.factor * self.inverse_count);
                self.dz[(t + 1) * r + k].add_scaled::<FMA>(g, -0.5);
                self.dz[(t - 1) * r + k].add_scaled::<FMA>(g, 0.5);
            }
            self.library.pull_back::<FMA>(z, drive, &xi_t, &g, &mut work, &mut self.dz[t * r..(t + 1) * r]);
            accumulate_outer::<FMA, 1>([&theta], [&g], r, self.dxi);
            total += f64::from(sum.sum());
        }
        total * f64::from(self.inverse_count)
    }
}
