//! Weighted linear least squares with a ridge, through the normal equations in double precision.

use crate::error::{Error, Result};
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

/// Sums of a regression of `y[n_y]` on `x[n_x]`, row by row.
pub struct Regression {
    n_x: usize,
    n_y: usize,
    xx: Vec<f64>,
    xy: Vec<f64>,
}

impl Regression {
    /// No rows yet.
    pub fn new(n_x: usize, n_y: usize) -> Self {
        Self { n_x, n_y, xx: vec![0.0; n_x * n_x], xy: vec![0.0; n_x * n_y] }
    }

    /// Adds one row with its weight.
    pub fn add(&mut self, x: &[f64], y: &[f64], weight: f64) {
        for (i, x_i) in x.iter().enumerate() {
            let w = weight * x_i;
            self.xx[i * self.n_x..(i + 1) * self.n_x].iter_mut().zip(x).for_each(|(s, x)| *s += w * x);
            self.xy[i * self.n_y..(i + 1) * self.n_y].iter_mut().zip(y).for_each(|(s, y)| *s += w * y);
        }
    }

    /// `B` in `y = B x`, with `ridge` times the mean diagonal added to the diagonal of `XᵀX`.
    ///
    /// # Errors
    /// When the normal equations are singular all the same.
    pub fn solve(&self, ridge: f64) -> Result<Mat<f64>> {
        let n = self.n_x;
        let mean = (0..n).map(|i| self.xx[i * n + i]).sum::<f64>() / n as f64;
        let lift = ridge * mean.max(f64::MIN_POSITIVE);
        let normal = Mat::from_fn(n, n, |i, j| self.xx[i * n + j] + if i == j { lift } else { 0.0 });
        let right = Mat::from_fn(n, self.n_y, |i, j| self.xy[i * self.n_y + j]);
        let factor = normal
            .llt(Side::Lower)
            .map_err(|_| Error::new("a linear regression is singular").hint("are all responses zero?"))?;
        Ok(factor.solve(&right).transpose().to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_noiseless_linear_map_is_found() {
        let mut regression = Regression::new(2, 2);
        for i in 0..20 {
            let x = [(f64::from(i) * 0.7).sin(), (f64::from(i) * 1.9).cos()];
            regression.add(&x, &[2.0 * x[0] - x[1], 0.5 * x[1]], 1.0 + f64::from(i));
        }
        let map = regression.solve(0.0).expect("regular");
        for (found, exact) in [(map[(0, 0)], 2.0), (map[(0, 1)], -1.0), (map[(1, 0)], 0.0), (map[(1, 1)], 0.5)] {
            assert!((found - exact).abs() < 1e-10);
        }
    }
}
