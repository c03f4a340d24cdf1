//! The covariance of the outputs of one bin.

use faer::{Mat, Side};
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// Σ of one bin by its Cholesky factor.
pub struct Covariance {
    /// Lower triangle of the factor, row by row.
    rows: Vec<C64>,
    n: usize,
}

impl Covariance {
    /// That of `n` sensors with these entries, of which the lower triangle is read; what is not positive definite counts as its diagonal.
    pub fn new(n: usize, entry: impl Fn(usize, usize) -> C64) -> Self {
        let dense = Mat::<C64>::from_fn(n, n, |i, j| if i >= j { entry(i, j) } else { entry(j, i).conj() });
        let factor = dense.llt(Side::Lower);
        let of = |i: usize, j: usize| match &factor {
            Ok(factor) => factor.L()[(i, j)],
            Err(_) if i == j => C64::from(dense[(i, i)].re.max(f64::MIN_POSITIVE).sqrt()),
            Err(_) => C64::default(),
        };
        Self { rows: (0..n).flat_map(|i| (0..=i).map(move |j| (i, j))).map(|(i, j)| of(i, j)).collect(), n }
    }

    /// Row `i` of the factor up to its diagonal.
    fn row(&self, i: usize) -> &[C64] {
        let first = i * (i + 1) / 2;
        &self.rows[first..=first + i]
    }

    /// L⁻¹ x in place.
    pub fn whiten(&self, x: &mut [C64]) {
        for i in 0..self.n {
            let row = self.row(i);
            let known: C64 = row[..i].iter().zip(&*x).map(|(l, x)| l * x).sum();
            x[i] = (x[i] - known) / row[i].re;
        }
    }

    /// L x in place.
    pub fn colour(&self, x: &mut [C64]) {
        for i in (0..self.n).rev() {
            x[i] = self.row(i).iter().zip(&*x).map(|(l, x)| l * x).sum();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_whitened_vector_has_the_norm_that_the_inverse_gives_it() {
        let gain = [C64::new(1.0, 0.5), C64::new(-2.0, 0.3), C64::new(0.0, 1.0)];
        let entry = |i: usize, j: usize| {
            gain[i] * gain[j].conj() * 0.7 + if i == j { C64::from([0.5, 2.0, 1.0][i]) } else { C64::default() }
        };
        let sigma = Covariance::new(3, entry);
        let x = [C64::new(0.3, -1.0), C64::new(2.0, 0.1), C64::new(-0.4, 0.6)];
        let mut white = x.to_vec();
        sigma.whiten(&mut white);
        let mut coloured = white.clone();
        sigma.colour(&mut coloured);
        assert!(coloured.iter().zip(&x).all(|(a, b)| (a - b).norm() < 1e-12));
        let norm: f64 = white.iter().map(C64::norm_sqr).sum();
        // xᴴ Σ⁻¹ x by elimination on the dense matrix.
        let mut rows: Vec<Vec<C64>> = (0..3).map(|i| (0..3).map(|j| entry(i, j)).chain([x[i]]).collect()).collect();
        for i in 0..3 {
            let pivot = rows[i].clone();
            for row in rows.iter_mut().skip(i + 1) {
                let factor = row[i] / pivot[i];
                row.iter_mut().zip(&pivot).for_each(|(r, p)| *r -= factor * p);
            }
        }
        let mut solved = [C64::default(); 3];
        for i in (0..3).rev() {
            let known: C64 = (i + 1..3).map(|j| rows[i][j] * solved[j]).sum();
            solved[i] = (rows[i][3] - known) / rows[i][i];
        }
        let quadratic: C64 = x.iter().zip(&solved).map(|(x, w)| x.conj() * w).sum();
        assert!((norm - quadratic.re).abs() < 1e-12);
    }

    #[test]
    fn what_is_not_positive_definite_counts_as_its_diagonal() {
        let sigma = Covariance::new(2, |i, j| C64::from(if i == j { 4.0 } else { 5.0 }));
        let mut white = [C64::from(2.0), C64::from(6.0)];
        sigma.whiten(&mut white);
        assert_eq!(white, [C64::from(1.0), C64::from(3.0)]);
    }
}
