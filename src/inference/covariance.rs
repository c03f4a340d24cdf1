//! The covariance of the outputs of one bin.

use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// Σ of one bin: diagonal plus one rank.
///
/// ```text
/// Σ = diag(d) + h hᴴ,   h = H √S_in                                     (1)
/// ```
pub struct Covariance {
    /// Diagonal.
    pub d: Vec<f64>,
    /// h / √d.
    b: Vec<C64>,
    /// |b|².
    g: f64,
}

impl Covariance {
    /// That of the diagonal `d` and the transfer functions `gain` of noise of the base with power `s_in`.
    pub fn new(d: Vec<f64>, gain: impl Iterator<Item = C64>, s_in: f64) -> Self {
        let b: Vec<C64> = gain.zip(&d).map(|(h, d)| h * (s_in / d).sqrt()).collect();
        let g = b.iter().map(C64::norm_sqr).sum();
        Self { d, b, g }
    }

    /// Σ^{−1/2} x in place.
    pub fn whiten(&self, x: &mut [C64]) {
        x.iter_mut().zip(&self.d).for_each(|(x, d)| *x /= d.sqrt());
        let dot: C64 = self.b.iter().zip(&*x).map(|(b, x)| b.conj() * x).sum();
        let root = (1.0 + self.g).sqrt();
        let w = dot / (root * (1.0 + root));
        x.iter_mut().zip(&self.b).for_each(|(x, b)| *x -= b * w);
    }

    /// ln of the determinant.
    pub fn ln_determinant(&self) -> f64 {
        self.d.iter().map(|d| d.ln()).sum::<f64>() + (1.0 + self.g).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_whitened_vector_has_the_norm_that_the_inverse_gives_it() {
        let gain = [C64::new(1.0, 0.5), C64::new(-2.0, 0.3), C64::new(0.0, 1.0)];
        let sigma = Covariance::new(vec![0.5, 2.0, 1.0], gain.into_iter(), 0.7);
        let x = [C64::new(0.3, -1.0), C64::new(2.0, 0.1), C64::new(-0.4, 0.6)];
        let mut white = x.to_vec();
        sigma.whiten(&mut white);
        let norm: f64 = white.iter().map(C64::norm_sqr).sum();
        // xᴴ Σ⁻¹ x and ln det Σ by elimination on the dense matrix.
        let mut rows: Vec<Vec<C64>> = (0..3)
            .map(|i| {
                let of = |j: usize| {
                    gain[i] * gain[j].conj() * 0.7 + if i == j { C64::from(sigma.d[i]) } else { C64::default() }
                };
                (0..3).map(of).chain([x[i]]).collect()
            })
            .collect();
        let mut ln_determinant = 0.0;
        for i in 0..3 {
            ln_determinant += rows[i][i].re.ln();
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
        assert!((sigma.ln_determinant() - ln_determinant).abs() < 1e-12);
    }
}
