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

    /// Σ⁻¹ x.
    pub fn solve(&self, x: &[C64]) -> Vec<C64> {
        let scaled: Vec<C64> = x.iter().zip(&self.d).map(|(x, d)| x / d.sqrt()).collect();
        let dot: C64 = self.b.iter().zip(&scaled).map(|(b, x)| b.conj() * x).sum();
        let w = dot / (1.0 + self.g);
        scaled.iter().zip(&self.b).zip(&self.d).map(|((x, b), d)| (x - b * w) / d.sqrt()).collect()
    }

    /// An element of Σ⁻¹.
    pub fn inverse(&self, row: usize, column: usize) -> C64 {
        let own = if row == column { 1.0 / self.d[row] } else { 0.0 };
        own - self.b[row] * self.b[column].conj() / ((1.0 + self.g) * (self.d[row] * self.d[column]).sqrt())
    }

    /// h of (1).
    pub fn base(&self) -> Vec<C64> {
        self.b.iter().zip(&self.d).map(|(b, d)| b * d.sqrt()).collect()
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
        let solved = sigma.solve(&x);
        let quadratic: C64 = x.iter().zip(&solved).map(|(x, w)| x.conj() * w).sum();
        assert!((norm - quadratic.re).abs() < 1e-12);
        // Σ Σ⁻¹ x = x.
        for (i, gain_i) in gain.iter().enumerate() {
            let row: C64 = (0..3).map(|j| gain_i * gain[j].conj() * 0.7 * solved[j]).sum();
            assert!((row + sigma.d[i] * solved[i] - x[i]).norm() < 1e-12);
            let inverse: C64 = (0..3).map(|j| sigma.inverse(i, j) * x[j]).sum();
            assert!((inverse - solved[i]).norm() < 1e-12);
        }
    }
}
