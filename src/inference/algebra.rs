//! Small dense symmetric systems.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

/// Inverse of a symmetric positive definite matrix; `None` where it is not.
pub fn inverse(a: &Mat<f64>) -> Option<Mat<f64>> {
    let factor = a.llt(Side::Lower).ok()?;
    Some(factor.solve(Mat::<f64>::identity(a.nrows(), a.nrows())))
}

/// ln of the determinant of a symmetric positive definite matrix; `None` where it is not.
pub fn ln_determinant(a: &Mat<f64>) -> Option<f64> {
    let factor = a.llt(Side::Lower).ok()?;
    let l = factor.L();
    Some((0..a.nrows()).map(|i| 2.0 * l[(i, i)].ln()).sum())
}

/// What is left of `g` when its unknowns `gone` are eliminated beside a prior of precision `precision` on each of them, and the ln of
/// the determinant of I + G_gone/precision; the others keep their order.
///
/// ```text
/// G' = G_kk − G_kg (G_gg + Λ)⁻¹ G_gk                                     (1)
/// ```
///
/// `None` where G_gg + Λ is not positive definite.
pub fn eliminated(g: &Mat<f64>, gone: &[usize], precision: &[f64]) -> Option<(Mat<f64>, f64)> {
    let kept: Vec<usize> = (0..g.nrows()).filter(|i| !gone.contains(i)).collect();
    if gone.is_empty() {
        return Some((g.clone(), 0.0));
    }
    let (m, n) = (gone.len(), kept.len());
    // Scaled by the prior, so that the matrix to be factored has ones and more on its diagonal.
    let scale: Vec<f64> = precision.iter().map(|p| 1.0 / p.sqrt()).collect();
    let inner = Mat::from_fn(m, m, |i, j| g[(gone[i], gone[j])] * scale[i] * scale[j] + f64::from(u8::from(i == j)));
    let cross = Mat::from_fn(m, n, |i, j| g[(gone[i], kept[j])] * scale[i]);
    let factor = inner.llt(Side::Lower).ok()?;
    let solved = factor.solve(&cross);
    let own = Mat::from_fn(n, n, |i, j| g[(kept[i], kept[j])]);
    let l = factor.L();
    let ln = (0..m).map(|i| 2.0 * l[(i, i)].ln()).sum();
    Some((own - cross.transpose() * solved, ln))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elimination_leaves_the_normal_equations_of_what_is_kept() {
        let z = Mat::from_fn(9, 4, |i, j| ((3 * i + 5 * j * j + i * j) as f64).sin());
        let g = z.transpose() * &z;
        let (left, ln) = eliminated(&g, &[1, 2], &[2.0, 0.5]).unwrap();
        let mut whole = g.clone();
        whole[(1, 1)] += 2.0;
        whole[(2, 2)] += 0.5;
        let inner = Mat::from_fn(2, 2, |i, j| whole[(i + 1, j + 1)]);
        let expected = ln_determinant(&inner).unwrap() - (2.0f64 * 0.5).ln();
        assert!((ln - expected).abs() < 1e-10);
        let all = inverse(&whole).unwrap();
        let own = inverse(&left).unwrap();
        for (i, a) in [0, 3].into_iter().enumerate() {
            for (j, b) in [0, 3].into_iter().enumerate() {
                assert!((own[(i, j)] - all[(a, b)]).abs() < 1e-9);
            }
        }
        assert!((inverse(&g).unwrap() * &g - Mat::<f64>::identity(4, 4)).norm_max() < 1e-9);
    }
}
