//! Direct solution of block-tridiagonal systems with D×D blocks, D of 1 or 2 (block Thomas), without allocation.

use std::array::from_fn;

/// A D×D block by rows.
pub type Block<const D: usize> = [[f64; D]; D];

/// Matrix `A` of `n` block rows, `A[i,i−1] = lower[i]`, `A[i,i] = diagonal[i]`, `A[i,i+1] = upper[i]`, and its
/// factorisation `A = L·U` without pivoting between blocks.
///
/// Limits: the leading block minors must be regular, which mass and stiffness of a column guarantee away from a
/// limit point; `solve` returns false when a pivot block is singular or not finite.
#[derive(Debug, Clone)]
pub struct BlockTridiagonal<const D: usize> {
    /// Blocks below the diagonal; the first is unused.
    pub lower: Vec<Block<D>>,
    /// Blocks on the diagonal.
    pub diagonal: Vec<Block<D>>,
    /// Blocks above the diagonal; the last is unused.
    pub upper: Vec<Block<D>>,
    factor: Vec<Block<D>>,
}

impl<const D: usize> BlockTridiagonal<D> {
    /// A zero matrix of `n` block rows.
    pub fn new(n: usize) -> Self {
        const { assert!(D == 1 || D == 2, "blocks are inverted in closed form") };
        let zero = vec![[[0.0; D]; D]; n];
        Self { lower: zero.clone(), diagonal: zero.clone(), upper: zero.clone(), factor: zero }
    }

    /// Solves `A x = b` in place (`b` enters, `x` leaves); false when a pivot block is singular.
    #[must_use]
    pub fn solve(&mut self, b: &mut [[f64; D]]) -> bool {
        let n = self.diagonal.len();
        let mut above = [[0.0; D]; D]; // D⁻¹U of the row above
        let mut x = [0.0; D];
        let mut is_regular = true;
        for (i, row) in b.iter_mut().enumerate() {
            let l = self.lower[i];
            let (inverse, one_over_det) = inverted(sub(self.diagonal[i], mul(l, above)));
            is_regular &= one_over_det.is_finite() && one_over_det != 0.0;
            let lx = apply(l, x);
            x = apply(inverse, from_fn(|k| row[k] - lx[k]));
            *row = x;
            above = mul(inverse, self.upper[i]);
            self.factor[i] = above;
        }
        for i in (0..n.saturating_sub(1)).rev() {
            let ux = apply(self.factor[i], x);
            x = from_fn(|k| b[i][k] - ux[k]);
            b[i] = x;
        }
        is_regular
    }
}

/// Inverse of a block and that of its determinant.
#[inline(always)]
fn inverted<const D: usize>(b: Block<D>) -> (Block<D>, f64) {
    let last = D - 1;
    if D == 1 {
        let inv = 1.0 / b[0][0];
        return ([[inv; D]; D], inv);
    }
    let inv = 1.0 / (b[0][0] * b[last][last] - b[0][last] * b[last][0]);
    let entry = |i: usize, j: usize| if i == j { b[last - i][last - i] * inv } else { -b[i][j] * inv };
    (from_fn(|i| from_fn(|j| entry(i, j))), inv)
}

#[inline(always)]
fn mul<const D: usize>(a: Block<D>, b: Block<D>) -> Block<D> {
    from_fn(|i| from_fn(|j| (1..D).fold(a[i][0] * b[0][j], |sum, k| sum + a[i][k] * b[k][j])))
}

#[inline(always)]
fn sub<const D: usize>(a: Block<D>, b: Block<D>) -> Block<D> {
    from_fn(|i| from_fn(|j| a[i][j] - b[i][j]))
}

#[inline(always)]
fn apply<const D: usize>(a: Block<D>, x: [f64; D]) -> [f64; D] {
    from_fn(|i| (1..D).fold(a[i][0] * x[0], |sum, k| sum + a[i][k] * x[k]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    fn random_system<const D: usize>(n: usize) -> (BlockTridiagonal<D>, Vec<[f64; D]>) {
        let mut rng = crate::numerics::random::stream(7, "block");
        let mut block =
            |scale: f64| -> Block<D> { [[0.0; D]; D].map(|r| r.map(|_| scale * rng.random_range(-1.0..1.0))) };
        let mut a = BlockTridiagonal::new(n);
        for i in 0..n {
            a.lower[i] = if i > 0 { block(1.0) } else { [[0.0; D]; D] };
            a.upper[i] = if i + 1 < n { block(1.0) } else { [[0.0; D]; D] };
            a.diagonal[i] = block(1.0);
            (0..D).for_each(|k| a.diagonal[i][k][k] += 5.0);
        }
        let x = (0..n).map(|i| from_fn(|k| if k == 0 { i as f64 - 3.0 } else { 0.5 * i as f64 })).collect();
        (a, x)
    }

    fn reproduces_the_right_hand_side<const D: usize>() {
        let (mut a, x) = random_system::<D>(50);
        let mut b: Vec<[f64; D]> = (0..50)
            .map(|i| {
                let mut row = apply(a.diagonal[i], x[i]);
                let mut add = |t: [f64; D]| row = from_fn(|k| row[k] + t[k]);
                if i > 0 {
                    add(apply(a.lower[i], x[i - 1]));
                }
                if i < 49 {
                    add(apply(a.upper[i], x[i + 1]));
                }
                row
            })
            .collect();
        assert!(a.solve(&mut b));
        for (b, x) in b.iter().flatten().zip(x.iter().flatten()) {
            assert!((b - x).abs() < 1e-12, "{b:?} {x:?}");
        }
    }

    #[test]
    fn solution_reproduces_the_right_hand_side_to_round_off() {
        reproduces_the_right_hand_side::<1>();
        reproduces_the_right_hand_side::<2>();
    }

    #[test]
    fn a_singular_block_is_told() {
        let mut a = BlockTridiagonal::new(2);
        a.diagonal[1] = [[1.0, 0.0], [0.0, 1.0]];
        assert!(!a.solve(&mut [[1.0, 1.0], [1.0, 1.0]]));
        assert!(!BlockTridiagonal::new(2).solve(&mut [[1.0], [1.0]]));
    }
}
