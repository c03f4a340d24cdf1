//! What a correction of the latent equations costs before the records have asked for it.
//!
//! ```text
//! R = mean_k  Δξ_kᵀ C Δξ_k / (ξ₀_kᵀ C ξ₀_k),   k: latent equations                                          (1)
//! ```
//!
//! | metric         | C                                   | meaning                                                  |
//! |----------------|-------------------------------------|----------------------------------------------------------|
//! | `coefficients` | 1                                   | relative size of the correction, as published            |
//! | `field`        | mean of θ θᵀ over the simulations   | relative change of dz/dt where the simulations have been |
//!
//! A few weak events say little about the terms that matter in strong shaking. The published penalty leaves those terms as
//! free as any other; `field` asks that the equations of strong simulated motions change only as much as those of weak ones.
//! A hundredth of the published penalty is added to it. Limits: the simulations must reach the amplitudes that are to be predicted.

use super::case::Case;
use super::kernels::{LANES, Lanes};
use super::mlp::{product, view, view_mut};
use super::model::SourceModel;
use super::settings::Metric;
use faer::{Accum, Mat};
use rayon::prelude::*;

/// Share of the published metric in `field`, so that directions no simulation has taken are not free.
const PLAIN_SHARE: f64 = 0.01;
/// Simulations whose moments are in memory together.
const AT_ONCE: usize = 64;

/// The quadratic form (1): one block an equation.
pub struct Penalty {
    origin: Vec<f32>,
    /// `C/(r · ξ₀_kᵀ C ξ₀_k)`, each `[n_term × n_term]`.
    blocks: Vec<Mat<f64>>,
}

impl Penalty {
    /// The penalty of that `metric`; only the field looks at the `simulations`.
    pub fn of(metric: Metric, model: &SourceModel, simulations: &[Case]) -> Self {
        match metric {
            Metric::Coefficients => Self::coefficients(model),
            Metric::Field => Self::field(model, simulations),
        }
    }

    /// The published metric.
    pub fn coefficients(model: &SourceModel) -> Self {
        Self::new(model, None)
    }

    /// The metric of the vector field over `simulations`.
    pub fn field(model: &SourceModel, simulations: &[Case]) -> Self {
        let n = model.shape.library().n_term();
        let count: usize = simulations.iter().map(|case| case.u.len() + 1 - model.shape.window).sum();
        let mut metric = vec![0.0; n * n];
        for some in simulations.chunks(AT_ONCE) {
            let parts: Vec<Vec<f64>> = some.par_iter().map(|case| second_moments(model, case)).collect();
            parts.iter().for_each(|part| metric.iter_mut().zip(part).for_each(|(m, p)| *m += p / count as f64));
        }
        Self::new(model, Some(metric))
    }

    fn new(model: &SourceModel, metric: Option<Vec<f64>>) -> Self {
        let (latent, n) = (model.shape.library().latent, model.shape.library().n_term());
        let origin = model.coefficients().to_vec();
        let share = if metric.is_some() { PLAIN_SHARE } else { 1.0 };
        let blocks = (0..latent).map(|k| {
            let column: Vec<f64> = origin.iter().skip(k).step_by(latent).map(|c| f64::from(*c)).collect();
            let mut block = Mat::<f64>::zeros(n, n);
            if let Some(metric) = &metric {
                let size: f64 = (0..n * n).map(|i| metric[i] * column[i / n] * column[i % n]).sum();
                block += Mat::from_fn(n, n, |i, j| metric[i * n + j] / (latent as f64 * size.max(1e-12)));
            }
            let size: f64 = column.iter().map(|c| c * c).sum();
            (0..n).for_each(|i| block[(i, i)] += share / (latent as f64 * size.max(1e-12)));
            block
        });
        Self { blocks: blocks.collect(), origin }
    }

    /// R of (1).
    pub fn value(&self, xi: &[f32]) -> f64 {
        self.half_gradient(xi).iter().zip(self.change(xi)).map(|(g, c)| g * c).sum()
    }

    /// Half the gradient of R by every coefficient.
    pub fn half_gradient(&self, xi: &[f32]) -> Vec<f64> {
        let (change, r) = (self.change(xi), self.blocks.len());
        let mut gradient = vec![0.0; change.len()];
        for (k, block) in self.blocks.iter().enumerate() {
            let column = Mat::from_fn(block.nrows(), 1, |p, _| change[p * r + k]);
            let product = block * column;
            (0..block.nrows()).for_each(|p| gradient[p * r + k] = product[(p, 0)]);
        }
        gradient
    }

    /// Half the second derivative of R by coefficients `i` and `j`.
    pub fn curvature(&self, i: usize, j: usize) -> f64 {
        let r = self.blocks.len();
        if i % r == j % r { self.blocks[i % r][(i / r, j / r)] } else { 0.0 }
    }

    fn change(&self, xi: &[f32]) -> Vec<f64> {
        xi.iter().zip(&self.origin).map(|(a, b)| f64::from(*a) - f64::from(*b)).collect()
    }
}

/// Sum of θ θᵀ over the samples of a case.
fn second_moments(model: &SourceModel, case: &Case) -> Vec<f64> {
    let library = model.shape.library();
    let (r, n) = (library.latent, library.n_term());
    let z = model.simulated_states(case);
    let drive = model.shape.drive(&case.u, &case.u_half, 1.0);
    let (n_sample, width) = (z.len() / r, drive.width);
    let driving = &drive.at[(model.shape.window - 1) * width..];
    let mut rows = Vec::with_capacity(n_sample * n);
    let mut theta = vec![Lanes::ZERO; n];
    for (z, drive) in z.chunks(LANES * r).zip(driving.chunks(LANES * width)) {
        library.terms(&side_by_side(z, r), &side_by_side(drive, width), &mut theta);
        (0..z.len() / r).for_each(|lane| rows.extend(theta.iter().map(|t| t.0[lane])));
    }
    let mut sum = vec![0.0_f32; n * n];
    let all = view(&rows, n_sample, n);
    product(view_mut(&mut sum, n, n), Accum::Replace, all.transpose(), all);
    sum.into_iter().map(f64::from).collect()
}

/// Rows of `n` values, one a lane.
fn side_by_side(rows: &[f32], n: usize) -> Vec<Lanes> {
    let mut lanes = vec![Lanes::ZERO; n];
    for (lane, row) in rows.chunks_exact(n).enumerate() {
        lanes.iter_mut().zip(row).for_each(|(to, from)| to.0[lane] = *from);
    }
    lanes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flare::PretrainSettings;
    use crate::flare::model::Shape;
    use crate::numerics::random::stream;
    use rand::RngExt;

    fn random(n: usize, scale: f32, label: &str) -> Vec<f32> {
        let mut random = stream(11, label);
        (0..n).map(|_| scale * (2.0 * random.random::<f32>() - 1.0)).collect()
    }

    fn problem() -> (SourceModel, Vec<Case>) {
        let settings = PretrainSettings {
            latent: 3,
            hidden: 0,
            channels: 4,
            encoder_hidden: vec![5],
            memories: Default::default(),
            energy_levels: 0,
            ..Default::default()
        };
        let shape = Shape::new(&settings);
        let parameters = random(shape.decoder_range().end, 0.5, "parameters");
        let mask = vec![true; shape.library().n_coefficient()];
        let case = |i: usize| Case {
            id: i.to_string(),
            u: random(30, 1.0, &format!("u {i}")).into(),
            u_half: random(29, 1.0, &format!("half {i}")).into(),
            dense: random(120, 1.0, &format!("dense {i}")).into(),
            sparse: vec![].into(),
        };
        (SourceModel { shape, parameters, mask }, (0..3).map(case).collect())
    }

    #[test]
    fn gradient_and_curvature_match_finite_differences_in_both_metrics() {
        let (model, cases) = problem();
        for penalty in [Penalty::coefficients(&model), Penalty::field(&model, &cases)] {
            let origin = penalty.origin.clone();
            let xi: Vec<f32> = origin.iter().zip(random(origin.len(), 0.3, "delta")).map(|(a, b)| a + b).collect();
            let gradient = penalty.half_gradient(&xi);
            let moved = |i: usize, h: f32| {
                let mut moved = xi.clone();
                moved[i] += h;
                moved
            };
            for i in 0..xi.len() {
                let (up, down) = (moved(i, 1e-2), moved(i, -1e-2));
                let step = 2.0 * f64::from(up[i] - down[i]);
                let slope = (penalty.value(&up) - penalty.value(&down)) / step;
                assert!((gradient[i] - slope).abs() < 1e-6 * (1.0 + slope.abs()), "{i}: {} {slope}", gradient[i]);
                let (up, down) = (penalty.half_gradient(&up), penalty.half_gradient(&down));
                for j in 0..xi.len() {
                    let bend = 2.0 * (up[j] - down[j]) / step;
                    let found = penalty.curvature(i, j);
                    assert!((found - bend).abs() < 1e-5 * (1.0 + bend.abs()), "({i}, {j}): {found} {bend}");
                }
            }
        }
    }

    #[test]
    fn the_field_metric_is_the_relative_change_of_the_equations_at_the_simulated_states() {
        let (model, cases) = problem();
        let penalty = Penalty::field(&model, &cases);
        let library = model.shape.library();
        let xi: Vec<f32> = penalty.origin.iter().map(|c| 1.1 * c).collect();
        assert!((penalty.value(&xi) - 0.0101).abs() < 1e-6, "every equation is a tenth larger everywhere");
        // a change of one term costs by the power of that term
        let mut xi = penalty.origin.clone();
        xi[library.input_row() * 3 + 1] += 0.5;
        let u: Vec<f64> = cases.iter().flat_map(|c| &c.u[2..]).map(|u| f64::from(*u)).collect();
        let power = u.iter().map(|u| u * u).sum::<f64>() / u.len() as f64;
        let plain = Penalty::coefficients(&model).value(&xi);
        let sized = |f: &dyn Fn(&[f64], f64) -> f64| -> f64 {
            cases
                .iter()
                .map(|c| {
                    model
                        .encode(&c.dense)
                        .chunks(3)
                        .zip(&c.u[2..])
                        .map(|(z, u)| {
                            let z: Vec<f64> = z.iter().map(|v| f64::from(*v)).collect();
                            f(&z, f64::from(*u)).powi(2)
                        })
                        .sum::<f64>()
                })
                .sum::<f64>()
                / u.len() as f64
        };
        let of = |p: usize| f64::from(penalty.origin[p * 3 + 1]);
        let whole = sized(&|z, u| {
            let mut theta = vec![1.0];
            theta.extend(z);
            (0..3).for_each(|i| (i..3).for_each(|j| theta.push(z[i] * z[j])));
            theta.push(u);
            theta.iter().enumerate().map(|(p, t)| t * of(p)).sum()
        });
        let expected = 0.25 * power / (3.0 * whole) + PLAIN_SHARE * plain;
        assert!((penalty.value(&xi) - expected).abs() < 1e-4 * expected, "{} {expected}", penalty.value(&xi));
    }
}
