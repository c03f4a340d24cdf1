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

/// gᵀ d − ½ dᵀ A d within bounds of d.
pub struct Quadratic {
    /// A, symmetric positive definite.
    pub a: Mat<f64>,
    /// g.
    pub gradient: Vec<f64>,
    /// Smallest and largest value of each unknown.
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
    fn the_highest_place_is_that_of_a_fine_grid_within_bounds() {
        let a = Mat::from_fn(2, 2, |i, j| [[2.0, 0.9], [0.9, 1.0]][i][j]);
        let quadratic =
            Quadratic { a, gradient: vec![1.0, 1.5], bounds: vec![[-1.0, 1.0], [-0.5, 0.8]], size: vec![1.0, 1.0] };
        let (d, value) = quadratic.highest(f64::INFINITY).unwrap();
        let at = |x: f64, y: f64| x + 1.5 * y - 0.5 * (2.0 * x * x + 1.8 * x * y + y * y);
        let on = |k: i32, [low, high]: [f64; 2]| low + (high - low) * f64::from(k) / 400.0;
        let places = (0..=400).flat_map(|i| (0..=400).map(move |j| (i, j)));
        let highest = places.map(|(i, j)| at(on(i, quadratic.bounds[0]), on(j, quadratic.bounds[1])));
        assert!((value - highest.fold(f64::NEG_INFINITY, f64::max)).abs() < 1e-4);
        assert!((at(d[0], d[1]) - value).abs() < 1e-12 && d[1] == 0.8, "{d:?}");
    }

    #[test]
    fn solutions_inverses_and_determinants_agree() {
        let z = Mat::from_fn(9, 4, |i, j| ((3 * i + 5 * j * j + i * j) as f64).sin());
        let g = z.transpose() * &z;
        let mut whole = g.clone();
        whole[(1, 1)] += 2.0;
        whole[(2, 2)] += 0.5;
        let all = inverse(&whole).unwrap();
        // What unknowns know beside others that give way is the inverse of their block of the inverse.
        let kept = Mat::from_fn(2, 2, |i, j| all[([0, 3][i], [0, 3][j])]);
        let gone = Mat::from_fn(2, 2, |i, j| whole[(i + 1, j + 1)]);
        let beside = ln_determinant(&whole).unwrap() - ln_determinant(&gone).unwrap();
        assert!((ln_determinant(&inverse(&kept).unwrap()).unwrap() - beside).abs() < 1e-9);
        assert!((inverse(&g).unwrap() * &g - Mat::<f64>::identity(4, 4)).norm_max() < 1e-9);
        let x = solved(&whole, &[1.0, 2.0, 3.0, 4.0]).unwrap();
        assert!((0..4).all(|i| ((0..4).map(|j| whole[(i, j)] * x[j]).sum::<f64>() - (i + 1) as f64).abs() < 1e-9));
    }
}
