//! A multilayer perceptron with ELU hidden layers, an optional straight linear path, and its reverse pass.
//!
//! ```text
//! y = W_n h_{n−1} + b_n (+ W_s x),   h_i = elu(W_i h_{i−1} + b_i),   h_0 = x
//! ```
//!
//! Parameters live in one flat slice (`W_1, b_1, …, W_n, b_n, W_s`; `W` row-major `[output · input]`), which is what the
//! optimiser, the checkpoint and the finite-difference tests want. Products run on faer, one thread each.

use super::kernels::{BiasElu, ColumnSum, EluSlope, dispatch};
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use rand::{Rng, RngExt};
use std::ops::Range;

/// Sizes of a perceptron.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mlp {
    /// Width of the input, of each hidden layer, of the output.
    pub widths: Vec<usize>,
    /// Whether a linear map of the input is added to the output.
    pub is_skipped: bool,
}

/// Activations of a forward pass, kept for the reverse pass.
#[derive(Debug, Clone, Default)]
pub struct Tape {
    hidden: Vec<Vec<f32>>,
    cotangent: [Vec<f32>; 2],
}

impl Mlp {
    /// A perceptron `input → hidden… → output`.
    pub fn new(input: usize, hidden: &[usize], output: usize, is_skipped: bool) -> Self {
        let mut widths = vec![input];
        widths.extend_from_slice(hidden);
        widths.push(output);
        Self { widths, is_skipped }
    }

    /// Width of the input.
    pub fn n_input(&self) -> usize {
        self.widths[0]
    }

    /// Width of the output.
    pub fn n_output(&self) -> usize {
        self.widths[self.widths.len() - 1]
    }

    /// Number of parameters.
    pub fn n_parameter(&self) -> usize {
        self.tensors().last().map_or(0, |t| t.range.end)
    }

    /// The named pieces of the flat parameter slice, in order.
    pub fn tensors(&self) -> Vec<Tensor> {
        let mut tensors = Vec::new();
        let mut at = 0;
        let mut piece = |name: String, shape: Vec<usize>| {
            let n: usize = shape.iter().product();
            tensors.push(Tensor { name, shape, range: at..at + n });
            at += n;
        };
        for (i, w) in self.widths.windows(2).enumerate() {
            piece(format!("{i}.weight"), vec![w[1], w[0]]);
            piece(format!("{i}.bias"), vec![w[1]]);
        }
        if self.is_skipped {
            piece("linear.weight".to_string(), vec![self.n_output(), self.n_input()]);
        }
        tensors
    }

    /// Where the straight path's matrix `[output · input]` lies.
    pub fn skip_range(&self) -> Option<Range<usize>> {
        self.is_skipped.then(|| self.tensors().last().map(|t| t.range.clone())).flatten()
    }

    /// Uniform Glorot weights and zero biases; with a straight path the last layer starts at a tenth of that.
    pub fn initial(&self, random: &mut impl Rng) -> Vec<f32> {
        let mut parameters = vec![0.0; self.n_parameter()];
        let n_layer = self.widths.len() - 1;
        for (i, tensor) in self.tensors().into_iter().enumerate().filter(|(_, t)| t.shape.len() == 2) {
            let bound = (6.0 / (tensor.shape[0] + tensor.shape[1]) as f32).sqrt();
            let is_last = self.is_skipped && i == 2 * (n_layer - 1);
            let scale = if is_last { 0.1 } else { 1.0 };
            parameters[tensor.range].iter_mut().for_each(|p| *p = scale * bound * (2.0 * random.random::<f32>() - 1.0));
        }
        parameters
    }

    /// `y[n · output]` from `x[n · input]`.
    pub fn forward(&self, parameters: &[f32], x: &[f32], tape: &mut Tape, y: &mut Vec<f32>) {
        let n = x.len() / self.n_input();
        let tensors = self.tensors();
        let n_layer = self.widths.len() - 1;
        tape.hidden.resize(n_layer - 1, Vec::new());
        for i in 0..n_layer - 1 {
            let (before, after) = tape.hidden.split_at_mut(i);
            let input = before.last().map_or(x, |h| h.as_slice());
            let output = &mut after[0];
            output.resize(n * self.widths[i + 1], 0.0);
            layer(output, input, &parameters[tensors[2 * i].range.clone()], n, self.widths[i], self.widths[i + 1]);
            dispatch(BiasElu { rows: output, bias: &parameters[tensors[2 * i + 1].range.clone()] });
        }
        let last = n_layer - 1;
        let (width, n_output) = (self.widths[last], self.n_output());
        y.resize(n * n_output, 0.0);
        layer(
            y,
            tape.hidden.last().map_or(x, |h| h.as_slice()),
            &parameters[tensors[2 * last].range.clone()],
            n,
            width,
            n_output,
        );
        let bias = &parameters[tensors[2 * last + 1].range.clone()];
        y.chunks_exact_mut(n_output).for_each(|row| row.iter_mut().zip(bias).for_each(|(y, b)| *y += b));
        if let Some(range) = self.skip_range() {
            let weight = view(&parameters[range], n_output, self.n_input());
            product(view_mut(y, n, n_output), Accum::Add, view(x, n, self.n_input()), weight.transpose());
        }
    }

    /// For the cotangent `dy[n · output]` of the forward pass of `x[n · input]` recorded in `tape`: adds the derivative by
    /// the parameters to `gradient` and writes the cotangent of the input to `dx`, where they are wanted.
    pub fn backward(
        &self,
        parameters: &[f32],
        x: &[f32],
        tape: &mut Tape,
        dy: &[f32],
        mut gradient: Option<&mut [f32]>,
        dx: Option<&mut [f32]>,
    ) {
        let n = x.len() / self.n_input();
        let tensors = self.tensors();
        let (n_input, n_output) = (self.n_input(), self.n_output());
        let [mut outer, mut inner] = std::mem::take(&mut tape.cotangent);
        for i in (0..self.widths.len() - 1).rev() {
            let (from, to) = (self.widths[i], self.widths[i + 1]);
            let is_top = i + 2 == self.widths.len();
            let cotangent: &[f32] = if is_top { &dy[..n * to] } else { &outer[..n * to] };
            let input = if i == 0 { x } else { &tape.hidden[i - 1] };
            if let Some(gradient) = gradient.as_deref_mut() {
                let weight_gradient = view_mut(&mut gradient[tensors[2 * i].range.clone()], to, from);
                product(weight_gradient, Accum::Add, view(cotangent, n, to).transpose(), view(input, n, from));
                dispatch(ColumnSum { rows: cotangent, sum: &mut gradient[tensors[2 * i + 1].range.clone()] });
            }
            if i > 0 {
                inner.resize(inner.len().max(n * from), 0.0);
                let weight = view(&parameters[tensors[2 * i].range.clone()], to, from);
                product(view_mut(&mut inner[..n * from], n, from), Accum::Replace, view(cotangent, n, to), weight);
                dispatch(EluSlope { cotangent: &mut inner[..n * from], output: input });
                std::mem::swap(&mut outer, &mut inner);
            }
        }
        let bottom: &[f32] = if self.widths.len() == 2 { dy } else { &outer };
        if let (Some(range), Some(gradient)) = (self.skip_range(), gradient) {
            let weight_gradient = view_mut(&mut gradient[range], n_output, n_input);
            product(weight_gradient, Accum::Add, view(dy, n, n_output).transpose(), view(x, n, n_input));
        }
        if let Some(dx) = dx {
            let weight = view(&parameters[tensors[0].range.clone()], self.widths[1], n_input);
            product(view_mut(dx, n, n_input), Accum::Replace, view(bottom, n, self.widths[1]), weight);
            if let Some(range) = self.skip_range() {
                product(
                    view_mut(dx, n, n_input),
                    Accum::Add,
                    view(dy, n, n_output),
                    view(&parameters[range], n_output, n_input),
                );
            }
        }
        tape.cotangent = [outer, inner];
    }
}

/// A named piece of a flat parameter slice.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tensor {
    /// Name inside its network: `0.weight`, `0.bias`, …, `linear.weight`.
    pub name: String,
    /// `[output, input]` or `[output]`.
    pub shape: Vec<usize>,
    /// Where it lies.
    pub range: Range<usize>,
}

fn layer(y: &mut [f32], x: &[f32], weight: &[f32], n: usize, from: usize, to: usize) {
    product(view_mut(y, n, to), Accum::Replace, view(x, n, from), view(weight, to, from).transpose());
}

pub(super) fn view(slice: &[f32], rows: usize, columns: usize) -> MatRef<'_, f32> {
    MatRef::from_row_major_slice(&slice[..rows * columns], rows, columns)
}

pub(super) fn view_mut(slice: &mut [f32], rows: usize, columns: usize) -> MatMut<'_, f32> {
    MatMut::from_row_major_slice_mut(&mut slice[..rows * columns], rows, columns)
}

pub(super) fn product(to: MatMut<'_, f32>, accum: Accum, a: MatRef<'_, f32>, b: MatRef<'_, f32>) {
    matmul(to, accum, a, b, 1.0, Par::Seq);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random::stream;

    #[test]
    fn gradients_match_finite_differences() {
        for (hidden, is_skipped) in [(vec![], false), (vec![6], true), (vec![7, 5], false), (vec![7, 5], true)] {
            let net = Mlp::new(4, &hidden, 3, is_skipped);
            let mut random = stream(1, "mlp test");
            let parameters: Vec<f32> = (0..net.n_parameter()).map(|_| random.random::<f32>() - 0.5).collect();
            let n = 9;
            let x: Vec<f32> = (0..n * 4).map(|_| 2.0 * random.random::<f32>() - 1.0).collect();
            let dy: Vec<f32> = (0..n * 3).map(|_| random.random::<f32>() - 0.5).collect();
            let value = |parameters: &[f32], x: &[f32]| -> f64 {
                let mut y = Vec::new();
                net.forward(parameters, x, &mut Tape::default(), &mut y);
                y.iter().zip(&dy).map(|(y, d)| f64::from(*y) * f64::from(*d)).sum()
            };
            let (mut tape, mut y) = (Tape::default(), Vec::new());
            net.forward(&parameters, &x, &mut tape, &mut y);
            let mut gradient = vec![0.0; parameters.len()];
            let mut dx = vec![0.0; x.len()];
            net.backward(&parameters, &x, &mut tape, &dy, Some(&mut gradient), Some(&mut dx));
            let check = |at: &[f32], i: usize, found: f32, f: &dyn Fn(&[f32]) -> f64| {
                let (mut up, mut down) = (at.to_vec(), at.to_vec());
                up[i] += 5e-3;
                down[i] -= 5e-3;
                let slope = (f(&up) - f(&down)) / f64::from(up[i] - down[i]);
                assert!((f64::from(found) - slope).abs() < 2e-3 * (1.0 + slope.abs()), "{found} {slope}");
            };
            for (i, g) in gradient.iter().enumerate() {
                check(&parameters, i, *g, &|p| value(p, &x));
            }
            for (i, d) in dx.iter().enumerate() {
                check(&x, i, *d, &|x| value(&parameters, x));
            }
        }
    }
}
