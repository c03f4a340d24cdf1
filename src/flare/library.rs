//! The candidate library Θ(z, u) of the latent equations: which terms there are, in which order, under which names.
//!
//! Order: `1`, then `z_i`, then `z_i z_j` for `i ≤ j`, then `u`, then for each memory `m_k` of the shaking `m_k z_i` and
//! `m_k u`, then for each level `l` of energy `e_l z_i`. The arithmetic runs on [`Lanes`]; names serve the printed equations and
//! the checkpoint card.
//!
//! ```text
//! e_l = S / (l + S),   S = Σ z_i²                                                  (1)
//! ```
//!
//! `e_l z_i` is odd in the state, as a column without left and right asks for, and bounded by a linear term.

use super::kernels::Lanes;

/// Constant, linear and quadratic functions of the latent state, the base acceleration, and the products of state and
/// base acceleration with memories of the shaking.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Library {
    /// Latent dimension r.
    pub latent: usize,
    /// Number of memories, 0 as published.
    pub memories: usize,
    /// Number of energy levels, 0 as published.
    pub energies: usize,
}

/// Levels of eq. (1), the first ones used first.
pub const ENERGY: [f32; 3] = [1.0, 30.0, 0.03];

/// Most outputs whose sums are kept in registers at once.
const BLOCK: usize = 7;

/// Most equations whose sums over two terms are kept in registers at once.
const OUTER: usize = 5;

impl Library {
    /// Number of terms, `2 + r + r(r+1)/2`, `r + 1` for each memory and `r` for each energy level.
    pub fn n_term(&self) -> usize {
        self.energy_row(self.energies)
    }

    /// Number of coefficients of the latent equations.
    pub fn n_coefficient(&self) -> usize {
        self.n_term() * self.latent
    }

    /// Names in order: `1`, `z1`, …, `z1^2`, `z1 z2`, …, `u`, `m1 z1`, …, `m1 u`, ….
    pub fn names(&self) -> Vec<String> {
        let r = self.latent;
        let linear = (1..=r).map(|i| format!("z{i}"));
        let quadratic =
            (1..=r).flat_map(|i| (i..=r).map(move |j| if i == j { format!("z{i}^2") } else { format!("z{i} z{j}") }));
        std::iter::once("1".to_string())
            .chain(linear)
            .chain(quadratic)
            .chain(std::iter::once("u".to_string()))
            .chain((1..=self.memories).flat_map(|m| {
                let products = (1..=r).map(move |i| format!("m{m} z{i}"));
                products.chain(std::iter::once(format!("m{m} u")))
            }))
            .chain((1..=self.energies).flat_map(|e| (1..=r).map(move |i| format!("e{e} z{i}"))))
            .collect()
    }

    /// Row of the linear term `z_{i+1}`.
    pub fn linear_row(&self, i: usize) -> usize {
        1 + i
    }

    /// Row of the base acceleration.
    pub fn input_row(&self) -> usize {
        1 + self.latent + self.latent * (self.latent + 1) / 2
    }

    /// First row of the products with memory `m`.
    fn memory_row(&self, m: usize) -> usize {
        self.input_row() + 1 + m * (self.latent + 1)
    }

    /// First row of the products with energy level `e`.
    fn energy_row(&self, e: usize) -> usize {
        self.memory_row(self.memories) + e * self.latent
    }

    /// Θ(z, u): `theta[n_term]` from `z[r]` and `drive[1 + memories]`, `u` first.
    #[inline(always)]
    pub fn terms(&self, z: &[Lanes], drive: &[Lanes], theta: &mut [Lanes]) {
        let r = self.latent;
        theta[0] = Lanes::splat(1.0);
        theta[1..=r].copy_from_slice(&z[..r]);
        let mut p = 1 + r;
        for i in 0..r {
            for j in i..r {
                theta[p] = Lanes::product(&z[i], &z[j]);
                p += 1;
            }
        }
        theta[p] = drive[0];
        for m in &drive[1..=self.memories] {
            for i in 0..r {
                theta[p + 1 + i] = Lanes::product(m, &z[i]);
            }
            theta[p + 1 + r] = Lanes::product(m, &drive[0]);
            p += r + 1;
        }
        if self.energies > 0 {
            let size = energy(&z[..r]);
            for (e, level) in ENERGY[..self.energies].iter().enumerate() {
                let row = self.energy_row(e);
                let share = size.map(|s| s / (level + s)); // (1)
                (0..r).for_each(|i| theta[row + i] = Lanes::product(&share, &z[i]));
            }
        }
    }

    /// Θ Ξ: `out[r] = Ξᵀ θ` with `xi[n_term · r]`.
    #[inline(always)]
    pub fn combine<const FMA: bool>(&self, theta: &[Lanes], xi: &[f32], out: &mut [Lanes]) {
        let r = self.latent;
        let width = even_width(r, BLOCK);
        let mut k = 0;
        while k < r {
            let n = width.min(r - k);
            match n {
                1 => combine_block::<FMA, 1>(theta, xi, r, k, out),
                2 => combine_block::<FMA, 2>(theta, xi, r, k, out),
                3 => combine_block::<FMA, 3>(theta, xi, r, k, out),
                4 => combine_block::<FMA, 4>(theta, xi, r, k, out),
                5 => combine_block::<FMA, 5>(theta, xi, r, k, out),
                6 => combine_block::<FMA, 6>(theta, xi, r, k, out),
                _ => combine_block::<FMA, BLOCK>(theta, xi, r, k, out),
            }
            k += n;
        }
    }

    /// Transposed Jacobian product: adds `(∂(ΘΞ)/∂z)ᵀ g` to `dz[r]`; `xi_t[r · n_term]` is Ξ transposed,
    /// `work[n_term]` is overwritten.
    #[inline(always)]
    pub fn pull_back<const FMA: bool>(
        &self,
        z: &[Lanes],
        drive: &[Lanes],
        xi_t: &[f32],
        g: &[Lanes],
        work: &mut [Lanes],
        dz: &mut [Lanes],
    ) {
        let (r, m) = (self.latent, self.n_term());
        // the row of u has no part in ∂/∂z
        let last = if m == self.input_row() + 1 { m - 1 } else { m };
        let mut p = 1;
        while p + BLOCK <= last {
            combine_block::<FMA, BLOCK>(&g[..r], xi_t, m, p, work);
            p += BLOCK;
        }
        while p < last {
            combine_block::<FMA, 1>(&g[..r], xi_t, m, p, work);
            p += 1;
        }
        for (k, memory) in drive[1..=self.memories].iter().enumerate() {
            let row = self.memory_row(k);
            dz.iter_mut().zip(&work[row..row + r]).for_each(|(d, w)| d.add_product::<FMA>(w, memory));
        }
        if self.energies > 0 {
            let size = energy(&z[..r]);
            for (e, level) in ENERGY[..self.energies].iter().enumerate() {
                let row = self.energy_row(e);
                let share = size.map(|s| s / (level + s));
                // ∂e/∂z_j = 2 l z_j / (l + S)²
                let mut along = Lanes::ZERO;
                work[row..row + r].iter().zip(z).for_each(|(w, z)| along.add_product::<FMA>(w, z));
                let slope = Lanes::product(&along, &size.map(|s| 2.0 * level / ((level + s) * (level + s))));
                for i in 0..r {
                    dz[i].add_product::<FMA>(&work[row + i], &share);
                    dz[i].add_product::<FMA>(&slope, &z[i]);
                }
            }
        }
        for i in 0..r {
            dz[i].add::<FMA>(&work[1 + i]);
        }
        let mut p = 1 + r;
        for i in 0..r {
            for j in i..r {
                let w = work[p];
                dz[i].add_product::<FMA>(&w, &z[j]);
                dz[j].add_product::<FMA>(&w, &z[i]);
                p += 1;
            }
        }
    }
}

/// Width of the fewest blocks of at most `most` that hold `n`, all about as wide.
fn even_width(n: usize, most: usize) -> usize {
    n.div_ceil(n.div_ceil(most))
}

/// `Σ z_i²`, lane by lane.
#[inline(always)]
fn energy(z: &[Lanes]) -> Lanes {
    let mut sum = Lanes::ZERO;
    z.iter().for_each(|z| sum.add_product::<false>(z, z));
    sum
}

/// `out[k..k+B] = Σ_p input[p] · matrix[p][k..k+B]`, sums in registers.
#[inline(always)]
fn combine_block<const FMA: bool, const B: usize>(
    input: &[Lanes],
    matrix: &[f32],
    n: usize,
    k: usize,
    out: &mut [Lanes],
) {
    let mut sums = [Lanes::ZERO; B];
    for (x, row) in input.iter().zip(matrix.chunks_exact(n)) {
        if let Some(row) = row[k..].first_chunk::<B>() {
            for b in 0..B {
                sums[b].add_scaled::<FMA>(x, row[b]);
            }
        }
    }
    out[k..k + B].copy_from_slice(&sums);
}

/// Adds `Σ_s θ_s g_sᵀ` to `dxi[n_term · r]` for `S` evaluations at once (lanes are summed later).
#[inline(always)]
pub fn accumulate_outer<const FMA: bool, const S: usize>(
    theta: [&[Lanes]; S],
    g: [&[Lanes]; S],
    r: usize,
    dxi: &mut [Lanes],
) {
    let width = even_width(r, OUTER);
    for (pair, rows) in dxi.chunks_mut(2 * r).enumerate() {
        let p = 2 * pair;
        let mut k = 0;
        while k < r {
            let n = if rows.len() == 2 * r { width.min(r - k) } else { 1 };
            match (rows.len() == 2 * r, n) {
                (true, 1) => outer_block::<FMA, S, 2, 1>(&theta, &g, p, k, r, rows),
                (true, 2) => outer_block::<FMA, S, 2, 2>(&theta, &g, p, k, r, rows),
                (true, 3) => outer_block::<FMA, S, 2, 3>(&theta, &g, p, k, r, rows),
                (true, 4) => outer_block::<FMA, S, 2, 4>(&theta, &g, p, k, r, rows),
                (true, _) => outer_block::<FMA, S, 2, OUTER>(&theta, &g, p, k, r, rows),
                (false, _) => outer_block::<FMA, S, 1, 1>(&theta, &g, p, k, r, rows),
            }
            k += n;
        }
    }
}

/// `P` terms by `K` equations with the sums in registers.
#[inline(always)]
fn outer_block<const FMA: bool, const S: usize, const P: usize, const K: usize>(
    theta: &[&[Lanes]; S],
    g: &[&[Lanes]; S],
    p: usize,
    k: usize,
    r: usize,
    rows: &mut [Lanes],
) {
    let mut sums = [[Lanes::ZERO; K]; P];
    for s in 0..S {
        if let (Some(theta), Some(g)) = (theta[s][p..].first_chunk::<P>(), g[s][k..].first_chunk::<K>()) {
            for i in 0..P {
                for j in 0..K {
                    sums[i][j].add_product::<FMA>(&theta[i], &g[j]);
                }
            }
        }
    }
    for i in 0..P {
        for j in 0..K {
            rows[i * r + k + j].add::<FMA>(&sums[i][j]);
        }
    }
}

/// Transposes `[rows · columns]`.
pub fn transpose(matrix: &[f32], columns: usize) -> Vec<f32> {
    let rows = matrix.len() / columns;
    (0..matrix.len()).map(|i| matrix[(i % rows) * columns + i / rows]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_are_named_in_the_order_they_are_computed() {
        let library = Library { latent: 2, memories: 1, energies: 1 };
        let names = ["1", "z1", "z2", "z1^2", "z1 z2", "z2^2", "u", "m1 z1", "m1 z2", "m1 u", "e1 z1", "e1 z2"];
        assert_eq!(library.names(), names);
        let mut theta = vec![Lanes::ZERO; library.n_term()];
        library.terms(&[2.0, 3.0].map(Lanes::splat), &[5.0, 0.5].map(Lanes::splat), &mut theta);
        let values: Vec<f32> = theta.iter().map(|t| t.0[0]).collect();
        assert_eq!(
            values,
            [1.0, 2.0, 3.0, 4.0, 6.0, 9.0, 5.0, 1.0, 1.5, 2.5, 2.0 * (13.0 / 14.0), 3.0 * (13.0 / 14.0)]
        );
    }

    #[test]
    fn every_latent_dimension_up_to_32_combines_like_a_plain_sum() {
        for r in 1..=32 {
            let library = Library { latent: r, memories: r % 3, energies: r % 2 };
            let m = library.n_term();
            let xi: Vec<f32> = (0..m * r).map(|i| ((i * 37 % 101) as f32 - 50.0) / 50.0).collect();
            let z: Vec<Lanes> = (0..r).map(|i| Lanes::splat((i as f32 * 0.7).sin())).collect();
            let mut theta = vec![Lanes::ZERO; m];
            library.terms(&z, &[0.3, 0.6, 0.2].map(Lanes::splat), &mut theta);
            let mut out = vec![Lanes::ZERO; r];
            library.combine::<false>(&theta, &xi, &mut out);
            for k in 0..r {
                let plain: f64 = (0..m).map(|p| f64::from(theta[p].0[3]) * f64::from(xi[p * r + k])).sum();
                assert!((f64::from(out[k].0[3]) - plain).abs() < 1e-4, "r = {r}, equation {k}");
            }
        }
    }

    #[test]
    fn pull_back_matches_finite_differences_of_the_right_hand_side() {
        for (r, memories, energies) in [(1, 0, 0), (2, 1, 0), (5, 2, 2), (7, 0, 1), (14, 2, 3)] {
            let library = Library { latent: r, memories, energies };
            let drive = [0.2, 0.7, 0.4];
            let m = library.n_term();
            let xi: Vec<f32> = (0..m * r).map(|i| ((i * 53 % 97) as f32 - 48.0) / 97.0).collect();
            let z: Vec<f64> = (0..r).map(|i| (i as f64 * 1.3).cos()).collect();
            let g: Vec<f64> = (0..r).map(|i| (i as f64 * 0.9 + 0.4).sin()).collect();
            let value = |z: &[f64]| -> f64 {
                let mut theta = vec![1.0];
                theta.extend(z);
                (0..r).for_each(|i| (i..r).for_each(|j| theta.push(z[i] * z[j])));
                theta.push(drive[0]);
                for m in &drive[1..=memories] {
                    theta.extend(z.iter().chain([&drive[0]]).map(|x| m * x));
                }
                let size: f64 = z.iter().map(|z| z * z).sum();
                for level in &ENERGY[..energies] {
                    theta.extend(z.iter().map(|z| z * size / (f64::from(*level) + size)));
                }
                (0..r).map(|k| g[k] * (0..m).map(|p| theta[p] * f64::from(xi[p * r + k])).sum::<f64>()).sum()
            };
            let lanes = |x: &[f64]| x.iter().map(|v| Lanes::splat(*v as f32)).collect::<Vec<_>>();
            let mut dz = vec![Lanes::ZERO; r];
            let mut work = vec![Lanes::ZERO; m];
            library.pull_back::<false>(&lanes(&z), &lanes(&drive), &transpose(&xi, r), &lanes(&g), &mut work, &mut dz);
            for i in 0..r {
                let (mut up, mut down) = (z.clone(), z.clone());
                up[i] += 1e-5;
                down[i] -= 1e-5;
                let slope = (value(&up) - value(&down)) / 2e-5;
                assert!((f64::from(dz[i].0[0]) - slope).abs() < 1e-4 * (1.0 + slope.abs()), "r = {r}, z{}", i + 1);
            }
        }
    }
}
