//! Direct solution of block-tridiagonal systems with 2×2 blocks (block Thomas), without allocation.

/// A 2×2 block, row by row.
pub type Block = [f64; 4];

/// Matrix `A` of `n` block rows, `A[i,i−1] = lower[i]`, `A[i,i] = diagonal[i]`, `A[i,i+1] = upper[i]`, and its
/// factorisation `A = L·U` without pivoting between blocks.
///
/// Limits: the leading block minors must be regular, which mass and stiffness of a column guarantee away from a
/// limit point; `solve` returns false when a pivot block is singular or not finite.
#[derive(Debug, Clone)]
pub struct BlockTridiagonal {
    /// Blocks below the diagonal; the first is unused.
    pub lower: Vec<Block>,
    /// Blocks on the diagonal.
    pub diagonal: Vec<Block>,
    /// Blocks above the diagonal; the last is unused.
    pub upper: Vec<Block>,
    factor: Vec<Block>,
}

impl BlockTridiagonal {
    /// A zero matrix of `n` block rows.
    pub fn new(n: usize) -> Self {
        let zero = vec![[0.0; 4]; n];
        Self { lower: zero.clone(), diagonal: zero.clone(), upper: zero.clone(), factor: zero }
    }

    /// Solves `A x = b` in place (`b` enters, `x` leaves); false when a pivot block is singular.
    #[must_use]
    pub fn solve(&mut self, b: &mut [[f64; 2]]) -> bool {
        let n = self.diagonal.len();
        let mut above = [0.0; 4]; // D⁻¹U of the row above
        let mut x = [0.0; 2];
        let mut is_regular = true;
        for (i, row) in b.iter_mut().enumerate() {
            let l = self.lower[i];
            let d = sub(self.diagonal[i], mul(l, above));
            let det = d[0] * d[3] - d[1] * d[2];
            let inv = 1.0 / det;
            is_regular &= inv.is_finite() && inv != 0.0;
            let inverse = [d[3] * inv, -d[1] * inv, -d[2] * inv, d[0] * inv];
            let lx = apply(l, x);
            x = apply(inverse, [row[0] - lx[0], row[1] - lx[1]]);
            *row = x;
            above = mul(inverse, self.upper[i]);
            self.factor[i] = above;
        }
        for i in (0..n.saturating_sub(1)).rev() {
            let ux = apply(self.factor[i], x);
            x = [b[i][0] - ux[0], b[i][1] - ux[1]];
            b[i] = x;
        }
        is_regular
    }
}

#[inline(always)]
fn mul(a: Block, b: Block) -> Block {
    [a[0] * b[0] + a[1] * b[2], a[0] * b[1] + a[1] * b[3], a[2] * b[0] + a[3] * b[2], a[2] * b[1] + a[3] * b[3]]
}

#[inline(always)]
fn sub(a: Block, b: Block) -> Block {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]]
}

#[inline(always)]
fn apply(a: Block, x: [f64; 2]) -> [f64; 2] {
    [a[0] * x[0] + a[1] * x[1], a[2] * x[0] + a[3] * x[1]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    fn random_system(n: usize) -> (BlockTridiagonal, Vec<[f64; 2]>) {
        let mut rng = crate::numerics::random::stream(7, "block");
        let mut block = |scale: f64| [0; 4].map(|_| scale * rng.random_range(-1.0..1.0));
        let mut a = BlockTridiagonal::new(n);
        for i in 0..n {
            a.lower[i] = if i > 0 { block(1.0) } else { [0.0; 4] };
            a.upper[i] = if i + 1 < n { block(1.0) } else { [0.0; 4] };
            let d = block(1.0);
            a.diagonal[i] = [d[0] + 5.0, d[1], d[2], d[3] + 5.0];
        }
        let x = (0..n).map(|i| [i as f64 - 3.0, 0.5 * i as f64]).collect();
        (a, x)
    }

    #[test]
    fn solution_reproduces_the_right_hand_side_to_round_off() {
        let (mut a, x) = random_system(50);
        let mut b: Vec<[f64; 2]> = (0..50)
            .map(|i| {
                let mut row = apply(a.diagonal[i], x[i]);
                if i > 0 {
                    let t = apply(a.lower[i], x[i - 1]);
                    row = [row[0] + t[0], row[1] + t[1]];
                }
                if i < 49 {
                    let t = apply(a.upper[i], x[i + 1]);
                    row = [row[0] + t[0], row[1] + t[1]];
                }
                row
            })
            .collect();
        assert!(a.solve(&mut b));
        for (b, x) in b.iter().zip(&x) {
            assert!((b[0] - x[0]).abs() < 1e-12 && (b[1] - x[1]).abs() < 1e-12, "{b:?} {x:?}");
        }
    }

    #[test]
    fn a_singular_block_is_told() {
        let mut a = BlockTridiagonal::new(2);
        a.diagonal[1] = [1.0, 0.0, 0.0, 1.0];
        assert!(!a.solve(&mut [[1.0, 1.0], [1.0, 1.0]]));
    }
}
