//! Direct solution of block-tridiagonal systems with 2×2 blocks (block Thomas, no pivoting between blocks).

/// A 2×2 block, row by row.
pub type Block = [[f64; 2]; 2];
/// A 2-vector.
pub type Pair = [f64; 2];

/// Workspace of a block-tridiagonal system with `n` block rows.
///
///     L_i x_{i−1} + D_i x_i + U_i x_{i+1} = b_i                              (1)
///
/// Suited to matrices that are symmetric positive definite or block-diagonally dominant, as those of a column in implicit
/// dynamics are. Solving costs O(n) and allocates nothing.
#[derive(Debug, Clone)]
pub struct BlockTridiagonal {
    /// L_i, the blocks left of the diagonal; the first is not read.
    pub lower: Vec<Block>,
    /// D_i, the diagonal blocks.
    pub diagonal: Vec<Block>,
    /// U_i, the blocks right of the diagonal; the last is not read.
    pub upper: Vec<Block>,
}

impl BlockTridiagonal {
    /// A system of zeros with `n` block rows.
    pub fn new(n: usize) -> Self {
        Self { lower: vec![[[0.0; 2]; 2]; n], diagonal: vec![[[0.0; 2]; 2]; n], upper: vec![[[0.0; 2]; 2]; n] }
    }

    /// Solves (1) in place: `b` becomes `x`. The blocks are overwritten.
    ///
    /// Returns whether every pivot block was regular; `b` is not meaningful otherwise.
    pub fn solve(&mut self, b: &mut [Pair]) -> bool {
        let n = self.diagonal.len();
        debug_assert_eq!(b.len(), n);
        let mut regular = true;
        for i in 0..n {
            if i > 0 {
                let l = self.lower[i];
                self.diagonal[i] = subtract(self.diagonal[i], product(l, self.upper[i - 1]));
                let shift = apply(l, b[i - 1]);
                b[i] = [b[i][0] - shift[0], b[i][1] - shift[1]];
            }
            let Some(inverse) = inverse(self.diagonal[i]) else {
                regular = false;
                break;
            };
            self.upper[i] = product(inverse, self.upper[i]);
            b[i] = apply(inverse, b[i]);
        }
        for i in (0..n.saturating_sub(1)).rev() {
            let shift = apply(self.upper[i], b[i + 1]);
            b[i] = [b[i][0] - shift[0], b[i][1] - shift[1]];
        }
        regular
    }
}

#[inline]
fn product(a: Block, b: Block) -> Block {
    [
        [a[0][0] * b[0][0] + a[0][1] * b[1][0], a[0][0] * b[0][1] + a[0][1] * b[1][1]],
        [a[1][0] * b[0][0] + a[1][1] * b[1][0], a[1][0] * b[0][1] + a[1][1] * b[1][1]],
    ]
}

#[inline]
fn subtract(a: Block, b: Block) -> Block {
    [[a[0][0] - b[0][0], a[0][1] - b[0][1]], [a[1][0] - b[1][0], a[1][1] - b[1][1]]]
}

#[inline]
fn apply(a: Block, x: Pair) -> Pair {
    [a[0][0] * x[0] + a[0][1] * x[1], a[1][0] * x[0] + a[1][1] * x[1]]
}

#[inline]
fn inverse(a: Block) -> Option<Block> {
    let determinant = a[0][0] * a[1][1] - a[0][1] * a[1][0];
    if !(determinant.is_finite() && determinant != 0.0) {
        return None;
    }
    let d = 1.0 / determinant;
    Some([[a[1][1] * d, -a[0][1] * d], [-a[1][0] * d, a[0][0] * d]])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_solution_satisfies_the_system() {
        let n = 17;
        let mut system = BlockTridiagonal::new(n);
        let wave = |i: usize, k: f64| (k * (i as f64 + 1.0)).sin();
        for i in 0..n {
            system.lower[i] = [[wave(i, 1.1), wave(i, 2.3)], [wave(i, 0.7), wave(i, 3.1)]];
            system.upper[i] = [[wave(i, 1.7), wave(i, 2.9)], [wave(i, 0.3), wave(i, 1.3)]];
            system.diagonal[i] = [[6.0 + wave(i, 0.9), wave(i, 4.1)], [wave(i, 5.3), 7.0]];
        }
        let b: Vec<Pair> = (0..n).map(|i| [wave(i, 6.1), wave(i, 7.7)]).collect();
        let original = system.clone();
        let mut x = b.clone();
        assert!(system.solve(&mut x));
        for i in 0..n {
            let mut row = apply(original.diagonal[i], x[i]);
            if i > 0 {
                let left = apply(original.lower[i], x[i - 1]);
                row = [row[0] + left[0], row[1] + left[1]];
            }
            if i + 1 < n {
                let right = apply(original.upper[i], x[i + 1]);
                row = [row[0] + right[0], row[1] + right[1]];
            }
            assert!((row[0] - b[i][0]).abs() < 1e-13 && (row[1] - b[i][1]).abs() < 1e-13);
        }
    }

    #[test]
    fn a_singular_pivot_is_reported() {
        let mut system = BlockTridiagonal::new(3);
        assert!(!system.solve(&mut [[1.0, 1.0]; 3]));
    }
}
