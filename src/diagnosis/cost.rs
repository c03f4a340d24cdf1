//! The errors-in-variables cost: residuals whitened by the noise of outputs and input as the model passes it on.

use super::anchor::Anchor;
use super::generic::Pair;
use super::operators::{Operators, entry};
use super::responses::{Responses, Scene};
use super::spectra::smoothing_bins;
use super::unknowns::Placed;
use crate::effects::Effect;
use rayon::prelude::*;
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// Residuals of whole groups, whitened: independent and of variance 1 where the model and its noise are right.
///
/// With all outputs of one event at one frequency in y and both components of the input in u,
///
/// ```text
/// r = y − ŷ(θ, u_m),   Σ(θ) = S + A S_u Aᴴ,   ρ = √2 Σ^{−1/2} r,   cost = Σ |ρ|²                    (1)
/// Σ^{−1/2} = (I − B̃ W B̃ᴴ) S^{−1/2},   B̃ = S^{−1/2} A S_u^{1/2},   G = B̃ᴴ B̃,   W = G⁻¹(I − (I + G)^{−1/2})   (2)
/// ```
///
/// ŷ is the model's motion, cut as the record is; A = ∂ŷ/∂u_m holds column, anchor and sensors. The true input is an unknown of its own, so there is no determinant of Σ in the cost.
///
/// Limits: noise of different sensors and bins independent; at most two components share the input.
/// Check:  `whitening_is_the_inverse_square_root_of_the_covariance`.
/// Source: Pintelon and Schoukens (2012), System Identification, 2nd ed., chapter 12.
pub fn whitened(
    scene: &Scene<'_>,
    effects: &[Box<dyn Effect>],
    responses: &Responses,
    (anchor, x): (&Anchor, &Placed),
    groups: &[usize],
) -> Vec<f64> {
    all_whitened(scene, effects, responses, (anchor, x), (&[], groups)).concat().concat()
}

/// By how much [`whitened`] changes on each way from `x` to one of `moved`, which differs by what neighbours follow only: motions
/// change, and nothing that whitens.
///
/// Check: `derivatives_of_what_neighbours_follow_are_those_of_residuals`.
pub fn changes(
    scene: &Scene<'_>,
    effects: &[Box<dyn Effect>],
    responses: &Responses,
    (anchor, x): (&Anchor, &Placed),
    (moved, groups): (&[Placed], &[usize]),
) -> Vec<Vec<f64>> {
    let by_group = all_whitened(scene, effects, responses, (anchor, x), (moved, groups));
    let of = |way: usize| by_group.iter().flat_map(move |g| g[1 + way].iter().map(|v| -v)).collect();
    (0..moved.len()).map(of).collect()
}

/// By group, [`whitened`] and then what is predicted more at each of `moved`, whitened too.
fn all_whitened(
    scene: &Scene<'_>,
    effects: &[Box<dyn Effect>],
    responses: &Responses,
    (anchor, x): (&Anchor, &Placed),
    (moved, groups): (&[Placed], &[usize]),
) -> Vec<Vec<Vec<f64>>> {
    let amounts = &anchor.amounts(scene, effects, x);
    let ways: Vec<(&Placed, Vec<f64>)> = moved.iter().map(|m| (m, anchor.amounts(scene, effects, m))).collect();
    let side = SensorSide::new(scene, effects);
    let whiten = |g: &usize| {
        let mut out = vec![Vec::with_capacity(scene.groups[*g].n_residual()); 1 + moved.len()];
        each_bin(scene, &side, responses, (anchor, x, amounts), (*g, &ways), |bin| bin.whiten(&mut out));
        out
    };
    groups.par_iter().map(whiten).collect()
}

/// What is predicted and what was recorded in group `g`, `[record][sensor]`; interference is out of both.
pub fn pairs(
    scene: &Scene<'_>,
    effects: &[Box<dyn Effect>],
    responses: &Responses,
    (anchor, x): (&Anchor, &Placed),
    g: usize,
) -> Vec<Vec<Pair>> {
    let group = &scene.groups[g];
    let n_sensor = scene.problem.array.outputs.len();
    let empty = Pair { frequencies_hz: group.frequencies_hz.clone(), predicted: Vec::new(), measured: Vec::new() };
    let mut rows = vec![empty; group.records.len() * n_sensor];
    let amounts = &anchor.amounts(scene, effects, x);
    each_bin(scene, &SensorSide::new(scene, effects), responses, (anchor, x, amounts), (g, &[]), |bin| {
        for (row, (predicted, measured)) in rows.iter_mut().zip(bin.predicted.iter().zip(&bin.measured)) {
            row.predicted.push(*predicted);
            row.measured.push(*measured);
        }
    });
    rows.chunks_exact(n_sensor.max(1)).map(<[Pair]>::to_vec).collect()
}

/// What sensors make of motions under some effects.
struct SensorSide<'e> {
    effects: &'e [Box<dyn Effect>],
    operators: Operators<'e>,
    /// The channel of each sensor, the input sensor first.
    sources: Vec<usize>,
}

impl<'e> SensorSide<'e> {
    fn new(scene: &'e Scene<'_>, effects: &'e [Box<dyn Effect>]) -> Self {
        let operators = Operators::new(scene, effects);
        let sources = (0..=scene.problem.array.outputs.len()).map(|s| scene.source(effects, s)).collect();
        Self { effects, operators, sources }
    }
}

/// Sets up every frequency of group `g` in turn, with what is predicted more on each of the `ways` to other places of the soil.
fn each_bin(
    scene: &Scene<'_>,
    SensorSide { effects, operators: all, sources }: &SensorSide<'_>,
    responses: &Responses,
    (anchor, x, amounts): (&Anchor, &Placed, &[f64]),
    (g, ways): (usize, &[(&Placed, Vec<f64>)]),
    mut visit: impl FnMut(&mut Bin),
) {
    let group = &scene.groups[g];
    let n_sensor = scene.problem.array.outputs.len();
    let n_record = group.records.len();
    let removed = scene.estimated_interference(effects, g);
    let mut bin = Bin::new(n_record, n_record * n_sensor, ways.len());
    let seen_by = scene.input_sensor(effects, all, g);
    let input = |r: usize| {
        let response = &responses.records[g][r];
        if response.seen_by == seen_by { response.input.clone() } else { scene.true_input(effects, all, g, r) }
    };
    let inputs: Vec<Vec<C64>> = (0..n_record).map(input).collect();
    let arrivals = |r: usize| scene.arrivals((effects, all), [g, r], (&responses.records[g][r], &seen_by));
    let arrivals: Vec<Vec<C64>> = (0..n_record).map(arrivals).collect();
    let half = smoothing_bins(&group.frequencies_hz);
    let turned = |r: usize| anchor.records[g][r].as_ref().map_or(Vec::new(), |a| a.turned(&inputs[r], &seen_by, half));
    let turned: Vec<Vec<C64>> = (0..n_record).map(turned).collect();
    let followed: Vec<Vec<C64>> = (0..n_record).map(|r| anchor.followed(scene, responses, [g, r], x)).collect();
    let on_the_way = |(to, there): &(&Placed, Vec<f64>), r: usize| -> Vec<C64> {
        let mut way = anchor.followed(scene, responses, [g, r], to);
        way.iter_mut().zip(&followed[r]).for_each(|(to, from)| *to -= from);
        let Some(own) = &anchor.records[g][r] else { return way };
        way.resize(own.rest.len(), C64::default());
        let error = |at: usize| anchor.secants.error(there, [g, r], at) - anchor.secants.error(amounts, [g, r], at);
        way.iter_mut().enumerate().for_each(|(at, way)| *way += error(at));
        way
    };
    let ways: Vec<Vec<Vec<C64>>> = ways.iter().map(|way| (0..n_record).map(|r| on_the_way(way, r)).collect()).collect();
    let components: Vec<usize> = group.records.iter().map(|r| scene.problem.events[r.event].component()).collect();
    let (undone, outputs) = (all.input_undone(&group.frequencies_hz), all.outputs(&group.frequencies_hz));
    let bins = group.frequencies_hz.iter().zip(undone.iter().zip(outputs.chunks_exact(n_sensor.max(1))));
    for (k, (f, (undone, outputs))) in bins.enumerate() {
        for (s, operator) in outputs.iter().enumerate() {
            let arrival = all.arrival(scene.problem.array.depths_m[s], *f);
            for r in 0..n_record {
                let row = r * n_sensor + s;
                bin.model[row * n_record..(row + 1) * n_record].fill(C64::default());
                bin.predicted[row] = C64::default();
                bin.ways.iter_mut().for_each(|way| way[row] = C64::default());
                for q in 0..n_record {
                    let weight = entry(operator, components[r], components[q]);
                    if weight == C64::default() {
                        continue;
                    }
                    let response = &responses.records[g][q];
                    let at = k * n_sensor + s;
                    // The true input has moved since the response was computed only where the column did not change.
                    let moved = inputs[q][k] - response.input[k];
                    let mut predicted = response.motion[at] + response.transfer[at] * moved;
                    let mut motion = response.transfer[at];
                    let mut rest = followed[q].get(at).copied().unwrap_or_default();
                    if let Some(own) = &anchor.records[g][q] {
                        motion *= own.factor[at];
                        predicted *= own.factor[at];
                        rest += own.rest[at] + anchor.secants.error(amounts, [g, q], at);
                    }
                    let turned = turned[q].get(k).copied().unwrap_or(C64::new(1.0, 0.0));
                    predicted += turned * rest;
                    for (to, way) in bin.ways.iter_mut().zip(&ways) {
                        to[row] += weight * turned * way[q].get(at).copied().unwrap_or_default();
                    }
                    predicted += arrivals[q].get(at).copied().unwrap_or_default();
                    motion += arrival;
                    bin.predicted[row] += weight * predicted;
                    for p in 0..n_record {
                        bin.model[row * n_record + p] += weight * motion * entry(undone, components[q], components[p]);
                    }
                }
                let record = &group.records[r];
                let source = sources[s + 1];
                bin.measured[row] = record.channels[source][k];
                if let Some(added) = &removed[r][source] {
                    bin.measured[row] -= added[k];
                }
                bin.residual[row] = bin.measured[row] - bin.predicted[row];
                let propagated = scene.propagated.get(g).and_then(|g| g[r].get(k * n_sensor + s));
                bin.noise[row] = record.noise[source][k] + propagated.copied().unwrap_or_default();
            }
        }
        for (p, record) in group.records.iter().enumerate() {
            bin.input_noise[p] = record.noise[sources[0]][k];
        }
        visit(&mut bin);
    }
}

/// One frequency of one event.
struct Bin {
    /// `[row][input]`.
    model: Vec<C64>,
    predicted: Vec<C64>,
    measured: Vec<C64>,
    residual: Vec<C64>,
    /// What is predicted more on each way.
    ways: Vec<Vec<C64>>,
    noise: Vec<f64>,
    input_noise: Vec<f64>,
}

impl Bin {
    fn new(n_input: usize, n_row: usize, n_way: usize) -> Self {
        Self {
            model: vec![C64::default(); n_input * n_row],
            predicted: vec![C64::default(); n_row],
            measured: vec![C64::default(); n_row],
            residual: vec![C64::default(); n_row],
            ways: vec![vec![C64::default(); n_row]; n_way],
            noise: vec![1.0; n_row],
            input_noise: vec![0.0; n_input],
        }
    }

    /// Appends ρ of (1), real and imaginary parts, to the first of `out`, and the same of each way to the others; (2) for the first
    /// two inputs.
    fn whiten(&mut self, out: &mut [Vec<f64>]) {
        let n_input = self.input_noise.len();
        let roots: Vec<f64> = self.input_noise.iter().map(|s| s.sqrt()).collect();
        for (row, (model, noise)) in self.model.chunks_exact_mut(n_input).zip(&self.noise).enumerate() {
            let scale = 1.0 / noise.sqrt();
            self.residual[row] *= scale;
            self.ways.iter_mut().for_each(|way| way[row] *= scale);
            for (a, root) in model.iter_mut().zip(&roots) {
                *a *= scale * root;
            }
        }
        let zero = C64::default();
        let two = n_input > 1;
        let (mut g00, mut g11, mut g01) = (0.0, 0.0, zero);
        for row in self.model.chunks_exact(n_input) {
            g00 += row[0].norm_sqr();
            if two {
                g11 += row[1].norm_sqr();
                g01 += row[0].conj() * row[1];
            }
        }
        // W = f(G) = α I + β G for a Hermitian two-by-two G with eigenvalues g1, g2.
        let half = 0.5 * (g00 + g11);
        let spread = (0.25 * (g00 - g11) * (g00 - g11) + g01.norm_sqr()).sqrt();
        let (g1, g2) = (half + spread, (half - spread).max(0.0));
        let (f1, f2) = (kernel(g1), kernel(g2));
        let beta = if g1 - g2 > 1e-6 * (1.0 + g1) {
            (f1 - f2) / (g1 - g2)
        } else {
            let step = 1e-4 * (1.0 + g1);
            (kernel(g1 + step) - f1) / step
        };
        let alpha = f1 - beta * g1;
        for (values, out) in std::iter::once(&self.residual).chain(&self.ways).zip(out) {
            let mut b = [zero; 2];
            for (row, value) in self.model.chunks_exact(n_input).zip(values) {
                b[0] += row[0].conj() * value;
                if two {
                    b[1] += row[1].conj() * value;
                }
            }
            let w = [
                b[0] * (alpha + beta * g00) + g01 * b[1] * beta,
                b[1] * (alpha + beta * g11) + g01.conj() * b[0] * beta,
            ];
            for (row, r) in self.model.chunks_exact(n_input).zip(values) {
                let mut value = r - row[0] * w[0];
                if two {
                    value -= row[1] * w[1];
                }
                out.push(value.re * std::f64::consts::SQRT_2);
                out.push(value.im * std::f64::consts::SQRT_2);
            }
        }
    }
}

/// (1 − 1/√(1 + g))/g.
fn kernel(g: f64) -> f64 {
    let root = (1.0 + g).sqrt();
    1.0 / (root * (1.0 + root))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whitening_is_the_inverse_square_root_of_the_covariance() {
        let c = C64::new;
        let mut bin = Bin::new(2, 3, 1);
        let model = [[c(2.0, 1.0), c(0.1, -0.3)], [c(-0.5, 0.4), c(1.5, 0.2)], [c(3.0, -2.0), c(0.3, 0.0)]];
        bin.model = model.concat();
        bin.residual = vec![c(0.4, -0.1), c(1.0, 0.7), c(-0.2, 0.5)];
        bin.ways[0] = bin.residual.iter().map(|r| r * 2.0).collect();
        bin.noise = vec![0.5, 1.0, 0.2];
        bin.input_noise = vec![0.3, 0.8];
        let mut sigma = [[c(0.0, 0.0); 3]; 3];
        for (i, row) in sigma.iter_mut().enumerate() {
            for (j, value) in row.iter_mut().enumerate() {
                for ((a, b), noise) in model[i].iter().zip(&model[j]).zip(&bin.input_noise) {
                    *value += a * b.conj() * noise;
                }
                if i == j {
                    *value += bin.noise[i];
                }
            }
        }
        // Σ x = r by elimination.
        let mut x = bin.residual.clone();
        for i in 0..3 {
            for j in i + 1..3 {
                let factor = sigma[j][i] / sigma[i][i];
                let above = sigma[i];
                sigma[j].iter_mut().zip(&above).skip(i).for_each(|(to, from)| *to -= factor * from);
                let term = factor * x[i];
                x[j] -= term;
            }
        }
        for i in (0..3).rev() {
            let known: C64 = (i + 1..3).map(|k| sigma[i][k] * x[k]).sum();
            x[i] = (x[i] - known) / sigma[i][i];
        }
        let expected: f64 = 2.0 * bin.residual.iter().zip(&x).map(|(r, x)| (r.conj() * x).re).sum::<f64>();
        let mut out = [Vec::new(), Vec::new()];
        bin.whiten(&mut out);
        let [rho, way] = out;
        assert!(rho.iter().zip(&way).all(|(r, w)| (2.0 * r - w).abs() < 1e-12));
        let cost: f64 = rho.iter().map(|v| v * v).sum();
        assert!((cost / expected - 1.0).abs() < 1e-12, "{cost} {expected}");
    }

    #[test]
    fn one_component_alone_is_whitened_too() {
        let mut bin = Bin::new(1, 1, 0);
        bin.model[0] = C64::new(3.0, 0.0);
        bin.residual[0] = C64::new(1.0, 1.0);
        bin.noise[0] = 1.0;
        bin.input_noise[0] = 1.0;
        let mut out = [Vec::new()];
        bin.whiten(&mut out);
        let [rho] = out;
        assert!((rho[0] * rho[0] - 2.0 / 10.0).abs() < 1e-12 && rho[0] == rho[1]);
    }
}
