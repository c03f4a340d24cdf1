//! What one sensor makes of a motion at one frequency: a two-by-two complex matrix over the first two components.

use realfft::num_complex::Complex;

/// A channel's place: what decides which effects reach it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place<'a> {
    /// Name of the sensor.
    pub sensor: &'a str,
    /// Components of the array, in the manifest's order.
    pub components: &'a [String],
}

/// Recorded spectra of the first two components from the true ones; further components pass unchanged, and a single
/// component sees the first entry alone.
///
/// ```text
/// (Y₁, Y₂)ᵀ = O(f) (X₁, X₂)ᵀ,   X(f) = Σ x(t) exp(−i 2π f t)            (1)
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Operator(pub [[Complex<f64>; 2]; 2]);

const ZERO: Complex<f64> = Complex::new(0.0, 0.0);

impl Operator {
    /// What leaves everything as it is.
    pub const IDENTITY: Self = Self([[Complex::new(1.0, 0.0), ZERO], [ZERO, Complex::new(1.0, 0.0)]]);

    /// The same factor on both components.
    pub fn scalar(factor: Complex<f64>) -> Self {
        Self([[factor, ZERO], [ZERO, factor]])
    }

    /// This operator after `first`.
    #[must_use]
    pub fn after(&self, first: &Self) -> Self {
        let [a, b] = [&self.0, &first.0];
        Self(std::array::from_fn(|i| std::array::from_fn(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j])))
    }

    /// (1) for both components.
    pub fn apply(&self, x: [Complex<f64>; 2]) -> [Complex<f64>; 2] {
        self.0.map(|row| row[0] * x[0] + row[1] * x[1])
    }

    /// The inverse, held back where the sensor passes little:
    ///
    /// ```text
    /// (OᴴO + ε² I)⁻¹ Oᴴ (1 + ε²)                                         (2)
    /// ```
    ///
    /// with ε = 0.03, exact for O = I, 3 % short of the exact inverse where O passes 17 %.
    #[must_use]
    pub fn undone(&self) -> Self {
        if *self == Self::IDENTITY {
            return *self;
        }
        let o = &self.0;
        let adjoint = Self([[o[0][0].conj(), o[1][0].conj()], [o[0][1].conj(), o[1][1].conj()]]);
        let mut normal = adjoint.after(self).0;
        normal[0][0] += HELD_BACK;
        normal[1][1] += HELD_BACK;
        let determinant = normal[0][0] * normal[1][1] - normal[0][1] * normal[1][0];
        let scale = (1.0 + HELD_BACK) / determinant;
        let inverse =
            Self([[normal[1][1] * scale, -normal[0][1] * scale], [-normal[1][0] * scale, normal[0][0] * scale]]);
        inverse.after(&adjoint) // (2)
    }
}

/// ε² of (2).
const HELD_BACK: f64 = 9e-4;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn undoing_a_turn_and_a_gain_gives_the_motion_back() {
        let (sin, cos) = 0.4f64.sin_cos();
        let turn = Operator([[cos.into(), sin.into()], [(-sin).into(), cos.into()]]);
        let both = Operator::scalar(Complex::from_polar(0.8, 0.3)).after(&turn);
        let x = [Complex::new(1.0, 2.0), Complex::new(-0.5, 0.1)];
        let back = both.undone().apply(both.apply(x));
        for (a, b) in back.iter().zip(x) {
            assert!((a - b).norm() < 1e-3 * b.norm(), "{a} {b}");
        }
        assert_eq!(Operator::IDENTITY.undone(), Operator::IDENTITY);
    }

    #[test]
    fn what_a_sensor_hardly_passes_is_not_blown_up() {
        let deaf = Operator::scalar(Complex::new(1e-6, 0.0));
        assert!(deaf.undone().0[0][0].norm() < 2e-3);
        let dull = Operator::scalar(Complex::new(0.17, 0.0));
        assert!((dull.undone().0[0][0].re * 0.17 - 1.0).abs() < 0.035);
    }
}
