//! The equivalent-linear column tuned, record by record, to what the nonlinear column does at the declared values.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

/// Most steps of a fit.
const STEPS: usize = 10;
/// Steps of finite differences.
const DIFFERENCE: [f64; 3] = [0.01, 0.02, 0.002];
/// Bounds of the values.
const BOUNDS: [[f64; 2]; 3] = [[-1.5, 0.7], [-0.7, 0.7], [-0.1, 0.3]];

/// What one record's nonlinear column has beyond its equivalent-linear one.
///
/// ```text
/// G → G exp(p₀ + p₁ (2 z/H − 1)),   D → D + p₂                              (1)
/// p = argmin Σ |V_FE − V_linear(p)|² / Σ |V_FE|², sum over sensors of sums over bins   (2)
/// ```
///
/// One effective strain cannot stand for a whole motion; (2) puts modulus and damping where the resonances of the motion
/// really are.
///
/// Limits: at the declared values only; three numbers a record.
/// Check:  `tuning_brings_strong_motion_closer`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tuning(pub [f64; 3]);

impl Tuning {
    /// (factor on the modulus, what is added to the damping) at a depth over that of the column.
    pub fn at(&self, relative_depth: f64) -> (f64, f64) {
        let [p0, p1, p2] = self.0;
        ((p0 + p1 * (2.0 * relative_depth - 1.0)).exp(), p2)
    }
}

/// The values of least Σ r², by damped Gauss–Newton steps from zero.
pub(super) fn least(residual: impl Fn([f64; 3]) -> Vec<f64>) -> [f64; 3] {
    let square = |r: &[f64]| r.iter().map(|r| r * r).sum::<f64>();
    let mut p = [0.0; 3];
    let mut r = residual(p);
    let mut lambda = 1e-2;
    for _ in 0..STEPS {
        let mut columns = Vec::new();
        for i in 0..3 {
            let mut moved = p;
            moved[i] += if p[i] + DIFFERENCE[i] > BOUNDS[i][1] { -DIFFERENCE[i] } else { DIFFERENCE[i] };
            let step = moved[i] - p[i];
            columns.push(residual(moved).iter().zip(&r).map(|(a, b)| (a - b) / step).collect::<Vec<f64>>());
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let before = square(&r);
        for _ in 0..5 {
            let normal = Mat::from_fn(3, 3, |i, j| {
                dot(&columns[i], &columns[j]) * if i == j { 1.0 + lambda } else { 1.0 }
                    + if i == j { 1e-9 } else { 0.0 }
            });
            let Ok(factor) = normal.llt(Side::Lower) else { return p };
            let step = factor.solve(Mat::from_fn(3, 1, |i, _| -dot(&columns[i], &r)));
            let next: [f64; 3] = std::array::from_fn(|i| (p[i] + step[(i, 0)]).clamp(BOUNDS[i][0], BOUNDS[i][1]));
            let trial = residual(next);
            if square(&trial) < before {
                (p, r) = (next, trial);
                lambda *= 0.2;
                break;
            }
            lambda = (5.0 * lambda).max(1e-3);
        }
        if square(&r) > (1.0 - 1e-4) * before {
            break;
        }
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_of_a_curved_valley_is_found() {
        let wanted = [-0.4, 0.2, 0.05];
        let residual = |p: [f64; 3]| {
            let d: [f64; 3] = std::array::from_fn(|i| p[i] - wanted[i]);
            vec![d[0] + d[1] * d[1], d[1] - 0.5 * d[0], 3.0 * d[2] + d[0] * d[0]]
        };
        let found = least(residual);
        assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}");
    }
}
