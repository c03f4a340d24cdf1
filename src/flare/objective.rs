//! The stage-1 loss of a batch of segments and its gradient.
//!
//! ```text
//! L = λ_rec MSE(D(z), a) + λ_roll MSE(D(ẑ), a) + λ_lat MSE(ẑ, sg z) + λ_eq MSE(ż, Θ(z,u) Ξ) + λ_1 mean|Ξ|       (1)
//! ```
//!
//! `z` are encoded windows, `ẑ` the rollout from the first of them, `sg` holds `z` fixed, `ż` is the central difference.
//! A batch is cut into chunks of at most [`LANES`] segments whatever the number of threads, and gradients are summed in chunk
//! order, so the bytes do not depend on the threads. Limits: samples past a divergence count as a response predicted zero.

use super::adjoint::reverse;
use super::case::Case;
use super::integrator::{Forcing, Trajectory, rollout};
use super::kernels::{LANES, Lanes, SquareError, dispatch};
use super::memory::Drive;
use super::mlp::Tape;
use super::model::Shape;
use super::residuals::{EquationResidual, latent_residual};
use super::settings::LossWeights;
use rayon::prelude::*;

/// A stretch of a case: first sample (window complete there) and sign.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Index of the case.
    pub case: usize,
    /// First sample, at least L − 1.
    pub start: usize,
    /// 1, or −1 for the mirror image.
    pub sign: f32,
}

/// The parts of the loss before weighting: reconstruction, rollout, latent, equation, sparsity.
pub type Terms = [f64; 5];

/// What a batch is judged by.
pub struct Objective<'a> {
    /// Sizes of the model.
    pub shape: &'a Shape,
    /// All training cases.
    pub cases: &'a [Case],
    /// What drives them, see [`Shape::drive`].
    pub drives: &'a [Drive],
    /// Weight of each case, mean 1.
    pub case_weight: &'a [f32],
    /// Weights of the terms.
    pub weights: LossWeights,
    /// Latent states beyond this end a rollout.
    pub bound: f32,
}

/// Working memory of one chunk, kept between batches.
#[derive(Default)]
pub struct Scratch {
    windows: Vec<f32>,
    target: Vec<f32>,
    encoded: Vec<f32>,
    states: Vec<f32>, // encoded states, then rolled-out states
    decoded: Vec<f32>,
    d_states: Vec<f32>,
    encoder: Tape,
    decoder: Tape,
    forcing: Forcing,
    trajectory: Trajectory,
    z: Vec<Lanes>,
    dz: Vec<Lanes>,
    dz_roll: Vec<Lanes>,
    dxi: Vec<Lanes>,
    gradient: Vec<f32>,
    terms: Terms,
}

impl Objective<'_> {
    /// Loss parts of `batch` (all segments `n_step` long) and the gradient of the weighted sum, overwritten.
    pub fn evaluate(
        &self,
        parameters: &[f32],
        batch: &[Segment],
        n_step: usize,
        scratch: &mut Vec<Scratch>,
        gradient: &mut [f32],
    ) -> Terms {
        // chunks alike in size, and small enough to give several threads work, whatever their number
        let per_chunk = batch.len().div_ceil(batch.len().div_ceil(LANES).max(2));
        let n_chunk = batch.len().div_ceil(per_chunk);
        scratch.resize_with(n_chunk.max(scratch.len()), Scratch::default);
        scratch[..n_chunk]
            .par_iter_mut()
            .zip(batch.par_chunks(per_chunk))
            .for_each(|(s, chunk)| self.chunk(parameters, chunk, n_step, batch.len(), s));
        gradient.fill(0.0);
        let mut terms = [0.0; 5];
        for s in &scratch[..n_chunk] {
            gradient.iter_mut().zip(&s.gradient).for_each(|(a, b)| *a += b);
            terms.iter_mut().zip(&s.terms).for_each(|(a, b)| *a += b);
        }
        let xi = &parameters[self.shape.coefficient_range()];
        let scale = (self.weights.sparsity / xi.len() as f64) as f32;
        for (g, c) in gradient.iter_mut().zip(xi) {
            terms[4] += f64::from(c.abs()) / xi.len() as f64;
            *g += if *c == 0.0 { 0.0 } else { scale * c.signum() };
        }
        terms
    }

    /// The weighted sum of the parts.
    pub fn total(&self, terms: &Terms) -> f64 {
        let w = &self.weights;
        [w.reconstruction, w.rollout, w.latent, w.equation, w.sparsity].iter().zip(terms).map(|(w, t)| w * t).sum()
    }

    fn chunk(&self, parameters: &[f32], chunk: &[Segment], n_step: usize, n_batch: usize, s: &mut Scratch) {
        let (r, library) = (self.shape.latent, self.shape.library());
        let width = library.latent;
        let (encoder, decoder) = (self.shape.encoder(), self.shape.decoder());
        let xi = &parameters[self.shape.coefficient_range()];
        let n = chunk.len() * n_step;
        s.gradient.clear();
        s.gradient.resize(parameters.len(), 0.0);
        self.gather(chunk, n_step, s);

        encoder.forward(&parameters[self.shape.encoder_range()], &s.windows, &mut s.encoder, &mut s.encoded);
        to_lanes(&s.encoded, (r, width), n_step, chunk.len(), &mut s.z);
        rollout(library, xi, &s.z[..width], &s.forcing, self.bound, &mut s.trajectory);
        for (z, rolled) in s.z.chunks_exact_mut(width).zip(s.trajectory.z.chunks_exact(width)) {
            z[r..].copy_from_slice(&rolled[r..]); // hidden states are known from the rollout alone, and held fixed
        }
        s.states.resize(2 * n * r, 0.0);
        s.states[..n * r].copy_from_slice(&s.encoded);
        from_lanes(&s.trajectory.z, (r, width), n_step, &mut s.states[n * r..]);
        decoder.forward(&parameters[self.shape.decoder_range()], &s.states, &mut s.decoder, &mut s.decoded);

        self.response_residuals(chunk, n_step, n_batch, s);
        s.d_states.resize(2 * n * r, 0.0);
        let (to_dynamics, to_networks) = s.gradient.split_at_mut(self.shape.coefficient_range().end);
        let (to_encoder, to_decoder) = to_networks.split_at_mut(encoder.n_parameter());
        let decoder_parameters = &parameters[self.shape.decoder_range()];
        decoder.backward(
            decoder_parameters,
            &s.states,
            &mut s.decoder,
            &s.decoded,
            Some(to_decoder),
            Some(&mut s.d_states),
        );

        to_lanes(&s.d_states[..n * r], (r, width), n_step, chunk.len(), &mut s.dz);
        to_lanes(&s.d_states[n * r..], (r, width), n_step, chunk.len(), &mut s.dz_roll);
        let mut weight = Lanes::ZERO;
        chunk.iter().enumerate().for_each(|(lane, segment)| weight.0[lane] = self.case_weight[segment.case]);
        s.dxi.clear();
        s.dxi.resize(library.n_coefficient(), Lanes::ZERO);
        s.terms[2] = latent_residual(
            width,
            &s.z,
            &s.trajectory,
            &weight,
            self.weights.latent,
            n_batch * n_step * r,
            &mut s.dz_roll,
        );
        let count = (n_batch * n_step.saturating_sub(2) * width).max(1);
        s.terms[3] = dispatch(EquationResidual {
            library,
            xi,
            forcing: &s.forcing,
            z: &s.z,
            weight: &weight,
            inverse_count: 1.0 / count as f32,
            factor: self.weights.equation as f32,
            dz: &mut s.dz,
            dxi: &mut s.dxi,
        });
        reverse(library, xi, &s.forcing, &s.trajectory, &mut s.dz_roll, &mut s.dxi);
        for k in 0..r {
            s.dz[k].0.iter_mut().zip(&s.dz_roll[k].0).for_each(|(a, b)| *a += b);
        }
        to_dynamics.iter_mut().zip(&s.dxi).for_each(|(g, d)| *g = d.sum());
        from_lanes(&s.dz, (r, width), n_step, &mut s.d_states[..n * r]);
        let encoder_parameters = &parameters[self.shape.encoder_range()];
        encoder.backward(encoder_parameters, &s.windows, &mut s.encoder, &s.d_states[..n * r], Some(to_encoder), None);
    }

    /// Windows, targets and forcing of the chunk, mirrored where asked for.
    fn gather(&self, chunk: &[Segment], n_step: usize, s: &mut Scratch) {
        let (length, channels) = (self.shape.window, self.shape.channels);
        s.windows.clear();
        s.target.clear();
        s.forcing.reset(n_step, 1 + self.shape.memories.count());
        for (lane, segment) in chunk.iter().enumerate() {
            let case = &self.cases[segment.case];
            let end = segment.start + n_step;
            for t in segment.start..end {
                let window = &case.dense[(t + 1 - length) * channels..(t + 1) * channels];
                append(&mut s.windows, window, segment.sign);
            }
            let target = &case.dense[segment.start * channels..end * channels];
            append(&mut s.target, target, segment.sign);
            s.forcing.set(lane, &self.drives[segment.case], segment.start..end, segment.sign);
        }
    }

    /// Reconstruction and rollout errors; `decoded` becomes their weighted cotangent.
    fn response_residuals(&self, chunk: &[Segment], n_step: usize, n_batch: usize, s: &mut Scratch) {
        let channels = self.shape.channels;
        let n = chunk.len() * n_step;
        let count = (n_batch * n_step * channels) as f64;
        s.terms = [0.0; 5];
        for (half, factor) in [self.weights.reconstruction, self.weights.rollout].into_iter().enumerate() {
            let rows = s.decoded[half * n * channels..(half + 1) * n * channels].chunks_exact_mut(channels);
            for (row, (decoded, target)) in rows.zip(s.target.chunks_exact(channels)).enumerate() {
                let (lane, t) = (row / n_step, row % n_step);
                let weight = self.case_weight[chunk[lane].case];
                let is_valid = half == 0 || t < s.trajectory.valid[lane];
                let mut scale = (2.0 * factor * f64::from(weight) / count) as f32;
                if !is_valid {
                    scale = 0.0;
                    decoded.fill(0.0); // counts as a response of zero, which no parameter moves
                }
                s.terms[half] += f64::from(weight) * dispatch(SquareError { decoded, target, scale }) / count;
            }
        }
    }
}

/// Appends `values`, mirrored for the sign −1.
fn append(to: &mut Vec<f32>, values: &[f32], sign: f32) {
    if sign > 0.0 {
        to.extend_from_slice(values);
    } else {
        to.extend(values.iter().map(|v| -v));
    }
}

/// Rows `[lane][t][r]` to the first r of lanes `[t][width]`; the rest and unused lanes are zero.
pub fn to_lanes(rows: &[f32], (r, width): (usize, usize), n_step: usize, n_lane: usize, lanes: &mut Vec<Lanes>) {
    lanes.clear();
    lanes.resize(n_step * width, Lanes::ZERO);
    for lane in 0..n_lane {
        let series = &rows[lane * n_step * r..(lane + 1) * n_step * r];
        for (to, from) in lanes.chunks_exact_mut(width).zip(series.chunks_exact(r)) {
            to.iter_mut().zip(from).for_each(|(to, from)| to.0[lane] = *from);
        }
    }
}

/// The first r of lanes `[t][width]` to rows `[lane][t][r]`, as many lanes as `rows` has room for.
pub fn from_lanes(lanes: &[Lanes], (r, width): (usize, usize), n_step: usize, rows: &mut [f32]) {
    for (lane, series) in rows.chunks_exact_mut(n_step * r).enumerate() {
        for (to, from) in series.chunks_exact_mut(r).zip(lanes.chunks_exact(width)) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to = from.0[lane]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flare::PretrainSettings;
    use crate::numerics::random::stream;
    use rand::RngExt;

    fn case(n_step: usize, channels: usize, seed: u64) -> Case {
        let mut random = stream(seed, "objective case");
        let mut draw = |n: usize| (0..n).map(|_| 2.0 * random.random::<f32>() - 1.0).collect::<Vec<f32>>();
        Case {
            id: "a".into(),
            u: draw(n_step).into(),
            u_half: draw(n_step - 1).into(),
            dense: draw(n_step * channels).into(),
            sparse: vec![].into(),
        }
    }

    fn drives(shape: &Shape, cases: &[Case]) -> Vec<Drive> {
        cases.iter().map(|c| shape.drive(&c.u, &c.u_half, 1.0)).collect()
    }

    /// A small model with every part alive, ten segments in two chunks.
    fn problem(is_skipped: bool, hidden: usize) -> (Shape, Vec<f32>, Vec<Case>, Vec<Segment>) {
        let settings = PretrainSettings {
            window: 2,
            latent: 3,
            channels: 5,
            encoder_hidden: vec![7, 6],
            decoder_hidden: vec![6],
            linear_start: is_skipped,
            hidden,
            ..Default::default()
        };
        let shape = Shape::new(&settings);
        let mut random = stream(8, "objective parameters");
        let n_coefficient = shape.library().n_coefficient(); // mild, so that the rollout does not magnify rounding
        let size = |i: usize| if i < n_coefficient { 0.05 } else { 0.5 };
        let parameters = (0..shape.decoder_range().end).map(|i| size(i) * (random.random::<f32>() - 0.5)).collect();
        let cases = vec![case(40, 5, 1), case(50, 5, 2)];
        let segments = (0..10)
            .map(|i| Segment { case: i % 2, start: 1 + 2 * i, sign: if i % 3 == 0 { -1.0 } else { 1.0 } })
            .collect();
        (shape, parameters, cases, segments)
    }

    const PURE: [(&str, LossWeights); 6] = [
        (
            "reconstruction",
            LossWeights { reconstruction: 1.0, rollout: 0.0, latent: 0.0, equation: 0.0, sparsity: 0.0 },
        ),
        ("rollout", LossWeights { reconstruction: 0.0, rollout: 1.0, latent: 0.0, equation: 0.0, sparsity: 0.0 }),
        ("latent", LossWeights { reconstruction: 0.0, rollout: 0.0, latent: 1.0, equation: 0.0, sparsity: 0.0 }),
        ("equation", LossWeights { reconstruction: 0.0, rollout: 0.0, latent: 0.0, equation: 1.0, sparsity: 0.0 }),
        ("sparsity", LossWeights { reconstruction: 0.0, rollout: 0.0, latent: 0.0, equation: 0.0, sparsity: 1.0 }),
        ("all", LossWeights { reconstruction: 0.5, rollout: 1.0, latent: 0.0, equation: 0.3, sparsity: 0.1 }),
    ];

    #[test]
    fn the_gradient_of_every_term_matches_finite_differences_in_every_tensor() {
        for (is_skipped, hidden) in [(false, 0), (true, 0), (true, 2)] {
            let (shape, parameters, cases, segments) = problem(is_skipped, hidden);
            // the equation term holds hidden states fixed: not the derivative of its value
            let exact = PURE.into_iter().filter(|(name, _)| hidden == 0 || !["equation", "all"].contains(name));
            for (name, weights) in exact {
                let objective = Objective {
                    shape: &shape,
                    cases: &cases,
                    drives: &drives(&shape, &cases),
                    case_weight: &[0.7, 1.3],
                    weights,
                    bound: 1e3,
                };
                let mut gradient = vec![0.0; parameters.len()];
                let mut scratch = Vec::new();
                objective.evaluate(&parameters, &segments, 12, &mut scratch, &mut gradient);
                let dynamics = shape.coefficient_range();
                for range in [dynamics.clone(), shape.encoder_range(), shape.decoder_range()] {
                    if name == "latent" && range != dynamics {
                        continue; // the encoder is held fixed as target: not the derivative of the value, tested below
                    }
                    let norm = gradient[range.clone()].iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
                    if norm == 0.0 {
                        continue;
                    }
                    let moved = |h: f64| {
                        let mut p = parameters.clone();
                        p[range.clone()]
                            .iter_mut()
                            .zip(&gradient[range.clone()])
                            .for_each(|(p, g)| *p += (h * f64::from(*g) / norm) as f32);
                        let mut unused = vec![0.0; p.len()];
                        objective.total(&objective.evaluate(&p, &segments, 12, &mut Vec::new(), &mut unused))
                    };
                    // a coefficient must not cross zero, where its absolute value has a kink
                    let h = if name == "sparsity" { 1e-4 } else { 3e-3 };
                    let slope = (moved(h) - moved(-h)) / (2.0 * h);
                    assert!((slope - norm).abs() < 2e-3 * norm, "{name}, {range:?}: {norm} against {slope}");
                }
            }
        }
    }

    #[test]
    fn the_latent_term_moves_the_encoder_through_the_initial_state_only() {
        let (shape, parameters, cases, _) = problem(true, 0);
        let latent = LossWeights { reconstruction: 0.0, rollout: 0.0, latent: 1.0, equation: 0.0, sparsity: 0.0 };
        let objective = Objective {
            shape: &shape,
            cases: &cases,
            drives: &drives(&shape, &cases),
            case_weight: &[1.0, 1.0],
            weights: latent,
            bound: 1e3,
        };
        // z' = 0: the rollout stays at the initial state, so L = mean |z_0 − sg z_t|²
        let mut still = parameters.clone();
        still[shape.coefficient_range()].fill(0.0);
        let segment = [Segment { case: 0, start: 3, sign: 1.0 }];
        let mut gradient = vec![0.0; still.len()];
        objective.evaluate(&still, &segment, 6, &mut Vec::new(), &mut gradient);
        let encode = |p: &[f32]| {
            let windows: Vec<f32> = (3..9).flat_map(|t| &cases[0].dense[(t - 1) * 5..(t + 1) * 5]).copied().collect();
            let mut z = Vec::new();
            shape.encoder().forward(&p[shape.encoder_range()], &windows, &mut Tape::default(), &mut z);
            z
        };
        let held = encode(&still);
        let value = |p: &[f32]| -> f64 {
            let z = encode(p);
            held.iter().enumerate().map(|(i, t)| f64::from(z[i % 3] - t).powi(2)).sum::<f64>() / 18.0
        };
        for i in shape.encoder_range() {
            let (mut up, mut down) = (still.clone(), still.clone());
            up[i] += 1e-2;
            down[i] -= 1e-2;
            let slope = (value(&up) - value(&down)) / f64::from(up[i] - down[i]);
            assert!(
                (f64::from(gradient[i]) - slope).abs() < 2e-4 * (1.0 + slope.abs()),
                "{i}: {} {slope}",
                gradient[i]
            );
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_byte() {
        let (shape, parameters, cases, segments) = problem(true, 0);
        let objective = Objective {
            shape: &shape,
            cases: &cases,
            drives: &drives(&shape, &cases),
            case_weight: &[1.0, 1.0],
            weights: LossWeights::default(),
            bound: 1e3,
        };
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            let mut gradient = vec![0.0; parameters.len()];
            let terms = pool.install(|| objective.evaluate(&parameters, &segments, 12, &mut Vec::new(), &mut gradient));
            (terms, gradient)
        };
        assert!(run(1) == run(3));
    }

    #[test]
    fn a_diverging_batch_still_has_a_finite_gradient() {
        let (shape, mut parameters, cases, segments) = problem(true, 0);
        parameters[shape.coefficient_range()].iter_mut().for_each(|c| *c *= 40.0);
        let objective = Objective {
            shape: &shape,
            cases: &cases,
            drives: &drives(&shape, &cases),
            case_weight: &[1.0, 1.0],
            weights: LossWeights::default(),
            bound: 50.0,
        };
        let mut gradient = vec![0.0; parameters.len()];
        let terms = objective.evaluate(&parameters, &segments, 12, &mut Vec::new(), &mut gradient);
        assert!(terms.iter().all(|t| t.is_finite()) && gradient.iter().all(|g| g.is_finite()));
    }
}
