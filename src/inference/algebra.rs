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

/// gᵀ d − ½ dᵀ A d within bounds of d.
pub struct Quadratic {
    /// A, symmetric positive definite.
    pub a: Mat<f64>,
    /// g.
    pub gradient: Vec<f64>,
    /// Smallest and largest value of each unknown, nothing between them.
    pub bounds: Vec<[f64; 2]>,
    /// A size of each unknown.
    pub size: Vec<f64>,
}

impl Quadratic {
    /// That of some of its unknowns where the others are nothing.
    pub fn of(&self, unknowns: &[usize]) -> Self {
        Self {
            a: Mat::from_fn(unknowns.len(), unknowns.len(), |i, j| self.a[(unknowns[i], unknowns[j])]),
            gradient: unknowns.iter().map(|i| self.gradient[*i]).collect(),
            bounds: unknowns.iter().map(|i| self.bounds[*i]).collect(),
            size: unknowns.iter().map(|i| self.size[*i]).collect(),
        }
    }

    /// Where it is highest with no unknown farther than `radius` of its sizes, and its value there; an unknown that would pass its bound
    /// stands there, and the others give way to that. `None` where A is not positive definite.
    pub fn highest(&self, radius: f64) -> Option<(Vec<f64>, f64)> {
        let n = self.gradient.len();
        let mut d = vec![0.0; n];
        let mut free: Vec<usize> = (0..n).collect();
        while !free.is_empty() {
            let m = free.len();
            let held = |i: &usize| (0..n).filter(|j| !free.contains(j)).map(|j| self.a[(*i, j)] * d[j]).sum::<f64>();
            let side: Vec<f64> = free.iter().map(|i| self.gradient[*i] - held(i)).collect();
            let damped = |lambda: f64| {
                let more = |i: usize| lambda / self.size[free[i]].powi(2);
                let own = |i, j| self.a[(free[i], free[j])] + if i == j { more(i) } else { 0.0 };
                solved(&Mat::from_fn(m, m, own), &side)
            };
            let length = |s: &[f64]| s.iter().zip(&free).map(|(s, i)| (s / self.size[*i]).abs()).fold(0.0, f64::max);
            let mut lambda = 0.0;
            let mut found = damped(lambda);
            for _ in 0..40 {
                if found.as_ref().is_some_and(|s| length(s) <= radius) {
                    break;
                }
                lambda = if lambda == 0.0 { 1.0 } else { 2.0 * lambda };
                found = damped(lambda);
            }
            free.iter().zip(found?).for_each(|(i, s)| d[*i] = s);
            // The one that passes its bound by most is held there.
            let within = |i: usize| d[i].clamp(self.bounds[i][0], self.bounds[i][1]);
            let beyond = |i: &usize| (d[*i] - within(*i)).abs() / self.size[*i];
            let Some(farthest) = free.iter().copied().max_by(|a, b| beyond(a).total_cmp(&beyond(b))) else { break };
            if beyond(&farthest) == 0.0 {
                break;
            }
            d[farthest] = within(farthest);
            free.retain(|i| *i != farthest);
        }
        let linear: f64 = d.iter().zip(&self.gradient).map(|(d, g)| d * g).sum();
        let square: f64 = (0..n).map(|i| d[i] * (0..n).map(|j| self.a[(i, j)] * d[j]).sum::<f64>()).sum();
        Some((d, linear - 0.5 * square))
    }
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
