//! Small dense symmetric systems.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

/// Inverse of a symmetric positive definite matrix; `None` where it is not.
pub fn inverse(a: &Mat<f64>) -> Option<Mat<f64>> {
    let factor = a.llt(Side::Lower).ok()?;
    Some(factor.solve(Mat::<f64>::identity(a.nrows(), a.nrows())))
}

/// Solution of A x = b, A symmetric positive definite; `None` where it is not.
pub fn solved(a: &Mat<f64>, b: &[f64]) -> Option<Vec<f64>> {
    let x = a.llt(Side::Lower).ok()?.solve(Mat::from_fn(b.len(), 1, |i, _| b[i]));
    Some((0..b.len()).map(|i| x[(i, 0)]).collect())
}

/// ln of the determinant of a symmetric positive definite matrix; `None` where it is not.
pub fn ln_determinant(a: &Mat<f64>) -> Option<f64> {
    let factor = a.llt(Side::Lower).ok()?;
    let l = factor.L();
    Some((0..a.nrows()).map(|i| 2.0 * l[(i, i)].ln()).sum())
}

/// What is left of the normal equations `g` beside unknowns with the prior covariance L Lᵀ, of which `cross` = Lᵀ G_gk has the
/// products with what is kept and `inner` = Lᵀ G_gg L those among themselves.
///
/// ```text
/// G' = G_kk − G_kg L (I + Lᵀ G_gg L)⁻¹ Lᵀ G_gk                           (1)
/// ```
///
/// `None` where I + Lᵀ G_gg L is not positive definite.
fn marginal(kept: &Mat<f64>, cross: &Mat<f64>, inner: &Mat<f64>) -> Option<Mat<f64>> {
    let m = inner.nrows();
    let whole = Mat::from_fn(m, m, |i, j| inner[(i, j)] + f64::from(u8::from(i == j)));
    let factor = whole.llt(Side::Lower).ok()?;
    Some(kept - cross.transpose() * factor.solve(cross))
}

/// `g` when its unknowns `gone` are marginalised beside a prior of precision `precision` on each of them; the others keep their order.
pub fn without(g: &Mat<f64>, gone: &[usize], precision: &[f64]) -> Option<Mat<f64>> {
    let kept: Vec<usize> = (0..g.nrows()).filter(|i| !gone.contains(i)).collect();
    let scale: Vec<f64> = precision.iter().map(|p| 1.0 / p.sqrt()).collect();
    let (m, n) = (gone.len(), kept.len());
    let inner = Mat::from_fn(m, m, |i, j| g[(gone[i], gone[j])] * scale[i] * scale[j]);
    let cross = Mat::from_fn(m, n, |i, j| g[(gone[i], kept[j])] * scale[i]);
    marginal(&Mat::from_fn(n, n, |i, j| g[(kept[i], kept[j])]), &cross, &inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elimination_leaves_the_normal_equations_of_what_is_kept() {
        let z = Mat::from_fn(9, 4, |i, j| ((3 * i + 5 * j * j + i * j) as f64).sin());
        let g = z.transpose() * &z;
        let left = without(&g, &[1, 2], &[2.0, 0.5]).unwrap();
        let mut whole = g.clone();
        whole[(1, 1)] += 2.0;
        whole[(2, 2)] += 0.5;
        let all = inverse(&whole).unwrap();
        let own = inverse(&left).unwrap();
        for (i, a) in [0, 3].into_iter().enumerate() {
            for (j, b) in [0, 3].into_iter().enumerate() {
                assert!((own[(i, j)] - all[(a, b)]).abs() < 1e-9);
            }
        }
        assert!((inverse(&g).unwrap() * &g - Mat::<f64>::identity(4, 4)).norm_max() < 1e-9);
        let x = solved(&whole, &[1.0, 2.0, 3.0, 4.0]).unwrap();
        assert!((0..4).all(|i| ((0..4).map(|j| whole[(i, j)] * x[j]).sum::<f64>() - (i + 1) as f64).abs() < 1e-9));
    }
}
