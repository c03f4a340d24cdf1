//! The density of records beside the prediction that what is expected of them was read off.

use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// What is left of one bin of one sensor.
pub struct Residual {
    /// Independent values that it stands for.
    pub count: f64,
    /// What the column adds to its base.
    pub added: C64,
    /// What was recorded beside the mean motion.
    pub left: C64,
    /// Variance of noise and of what strays.
    pub variance: f64,
}

/// −ln of the density of `residuals` at one frequency that share an error of what the column adds to its base, with this variance.
///
/// ```text
/// r = δ (Ŷ − U) + ε,   δ ~ CN(0, σ²),   ε ~ CN(0, v)                                                (1)
/// −ln p = Σ s (ln v + |r|²/v) + ln(1 + σ² A) − |B|²/(A + σ⁻²),   A = Σ s |Ŷ − U|²/v,   B = Σ s (Ŷ − U)* r/v      (2)
/// ```
///
/// | symbol | what                               | field    |
/// |--------|------------------------------------|----------|
/// | r      | residual                           | left     |
/// | Ŷ − U  | what the column adds to its base   | added    |
/// | v      | variance of noise and what strays  | variance |
/// | s      | independent values in a bin        | count    |
/// | σ²     | variance of the shared error       | error    |
///
/// Source: (2) is the determinant lemma and the identity of Woodbury (1950) for the covariance of (1).
/// Check:  `records_that_share_an_error_have_the_density_of_their_whole_covariance`.
pub fn shared_error<'a>(residuals: impl IntoIterator<Item = &'a Residual>, error: f64) -> f64 {
    let (mut own, mut a, mut b) = (0.0, 0.0, C64::default());
    for r in residuals {
        let weight = r.count / r.variance;
        own += r.count * r.variance.ln() + weight * r.left.norm_sqr();
        a += weight * r.added.norm_sqr();
        b += r.added.conj() * r.left * weight;
    }
    own + (error * a).ln_1p() - b.norm_sqr() / (a + 1.0 / error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inference::algebra::ln_determinant;
    use crate::numerics::random;
    use faer::linalg::solvers::Solve;
    use faer::{Mat, Side};
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn records_that_share_an_error_have_the_density_of_their_whole_covariance() {
        let mut draws = StandardNormal.sample_iter(random::stream(7, "records that share an error"));
        let mut draw = || -> C64 { C64::new(draws.next().unwrap(), draws.next().unwrap()) };
        let n = 5;
        let error = 0.3;
        let residual =
            |i: usize, [added, left]: [C64; 2]| Residual { count: 1.0, added, left, variance: 0.2 + 0.4 * i as f64 };
        let all: Vec<Residual> = (0..n).map(|i| residual(i, [draw(), draw()])).collect();
        // Real and imaginary parts side by side: half the variance each, and −ln p of CN(0, Σ) is that of these up to constants.
        let entry = |i: usize, j: usize| -> f64 {
            let (p, q) = (i % n, j % n);
            let shared = error * all[p].added * all[q].added.conj();
            let own = if p == q { all[p].variance } else { 0.0 };
            match (i < n, j < n) {
                (true, true) | (false, false) => 0.5 * (shared.re + own),
                (true, false) => -0.5 * shared.im,
                (false, true) => 0.5 * shared.im,
            }
        };
        let sigma = Mat::from_fn(2 * n, 2 * n, entry);
        let r = Mat::from_fn(2 * n, 1, |i, _| if i < n { all[i].left.re } else { all[i - n].left.im });
        let solved = sigma.llt(Side::Lower).unwrap().solve(&r);
        let quadratic: f64 = (0..2 * n).map(|i| r[(i, 0)] * solved[(i, 0)]).sum();
        let whole = 0.5 * (ln_determinant(&sigma).unwrap() + 2.0 * n as f64 * 2.0_f64.ln() + quadratic);
        assert!((shared_error(&all, error) - whole).abs() < 1e-9, "{} {whole}", shared_error(&all, error));
        // Two records that are one count as two.
        let twice: Vec<Residual> = all.iter().map(|r| Residual { count: 2.0, ..*r }).collect();
        let double = shared_error(all.iter().chain(&all), error);
        assert!((shared_error(&twice, error) - double).abs() < 1e-9);
    }
}
