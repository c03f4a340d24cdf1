//! The fast column tuned, record by record, to what the nonlinear column does at the declared values.

use super::anchor::Anchor;
use super::problem::Replay;
use super::responses::Scene;
use super::unknowns::Placed;
use crate::effects::{self, Effect};
use crate::error::Result;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use rayon::prelude::*;
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// Most steps of a fit.
const STEPS: usize = 10;
/// Steps of finite differences.
const DIFFERENCE: [f64; 3] = [0.01, 0.02, 0.002];
/// Bounds of the values.
const BOUNDS: [[f64; 2]; 3] = [[-1.5, 0.7], [-0.7, 0.7], [-0.1, 0.3]];

/// What one record's nonlinear column has beyond its linear-equivalent one.
///
/// ```text
/// G → G exp(p₀ + p₁ (2 z/H − 1)),   D → D + p₂                              (1)
/// p = argmin Σ |V_FE − V_fast(p)|² / Σ |V_FE|², sum over sensors of sums over bins   (2)
/// ```
///
/// One effective strain cannot stand for a whole motion; (2) puts modulus and damping where the resonances of the motion
/// really are, so that derivatives of the fast column are taken there.
///
/// Limits: at the declared values only; three numbers a record.
/// Check:  `tests/diagnosis`: twins made by the nonlinear column.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tuning(pub [f64; 3]);

impl Tuning {
    /// (factor on the modulus, what is added to the damping) at a depth over that of the column.
    pub fn at(&self, relative_depth: f64) -> (f64, f64) {
        let [p0, p1, p2] = self.0;
        ((p0 + p1 * (2.0 * relative_depth - 1.0)).exp(), p2)
    }
}

impl Scene<'_> {
    /// Replays the declared values, tunes the fast column there, and gives the anchor. Without a replay the fast column stands alone.
    ///
    /// # Errors
    /// When the replay is impossible.
    pub fn declared(&mut self, replay: Option<&dyn Replay>, n_nuisance: usize) -> Result<Anchor> {
        let Some(replay) = replay else { return Ok(Anchor::fast(self)) };
        let replays = replay.replay(&[])?;
        let built = effects::build_all(&self.problem.declared)?;
        self.tune(&built, &replays)?;
        let all: Vec<usize> = (0..self.groups.len()).collect();
        let responses = self.responses(&built, &all, None)?;
        let anchor = Anchor::of(self, &replays, (&built, &Placed::plain(&vec![0.0; n_nuisance])), &responses, None);
        Ok(anchor)
    }

    /// Tunes the fast column of each record to `replays` under the effects `built`.
    ///
    /// # Errors
    /// When the column cannot be built.
    pub fn tune(&mut self, built: &[Box<dyn Effect>], replays: &[Option<Vec<Vec<f64>>>]) -> Result<()> {
        let records: Vec<[usize; 2]> = self.record_indices().collect();
        let tuned: Vec<Tuning> = records
            .par_iter()
            .map(|&[g, r]| {
                let Some(Some(replayed)) = replays.get(self.groups[g].records[r].event) else {
                    return Ok(Tuning::default());
                };
                let wanted: Vec<Vec<C64>> = replayed.iter().map(|x| self.bins(g, r, x)).collect();
                let scales: Vec<f64> = wanted
                    .iter()
                    .map(|w| 1.0 / w.iter().map(C64::norm_sqr).sum::<f64>().sqrt().max(f64::MIN_POSITIVE))
                    .collect();
                let residual = |p: [f64; 3]| -> Result<Vec<f64>> {
                    let motion = self.motion_with(built, [g, r], Tuning(p))?;
                    let n = wanted.len();
                    let miss = |(i, v): (usize, &C64)| (v - wanted[i % n][i / n]) * scales[i % n];
                    Ok(motion.iter().enumerate().map(miss).flat_map(|c| [c.re, c.im]).collect())
                };
                Ok(Tuning(least(residual)?))
            })
            .collect::<Result<_>>()?;
        let mut all: Vec<Vec<Tuning>> = vec![Vec::new(); self.groups.len()];
        records.iter().zip(tuned).for_each(|([g, _], tuning)| all[*g].push(tuning));
        self.set_tuning(all);
        Ok(())
    }
}

/// The values of least Σ r², by damped Gauss–Newton steps from zero.
fn least(residual: impl Fn([f64; 3]) -> Result<Vec<f64>>) -> Result<[f64; 3]> {
    let square = |r: &[f64]| r.iter().map(|r| r * r).sum::<f64>();
    let mut p = [0.0; 3];
    let mut r = residual(p)?;
    let mut lambda = 1e-2;
    for _ in 0..STEPS {
        let mut columns = Vec::new();
        for i in 0..3 {
            let mut moved = p;
            moved[i] += if p[i] + DIFFERENCE[i] > BOUNDS[i][1] { -DIFFERENCE[i] } else { DIFFERENCE[i] };
            let step = moved[i] - p[i];
            columns.push(residual(moved)?.iter().zip(&r).map(|(a, b)| (a - b) / step).collect::<Vec<f64>>());
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let before = square(&r);
        for _ in 0..5 {
            let normal = Mat::from_fn(3, 3, |i, j| {
                dot(&columns[i], &columns[j]) * if i == j { 1.0 + lambda } else { 1.0 }
                    + if i == j { 1e-9 } else { 0.0 }
            });
            let Ok(factor) = normal.llt(Side::Lower) else { return Ok(p) };
            let step = factor.solve(Mat::from_fn(3, 1, |i, _| -dot(&columns[i], &r)));
            let next: [f64; 3] = std::array::from_fn(|i| (p[i] + step[(i, 0)]).clamp(BOUNDS[i][0], BOUNDS[i][1]));
            let trial = residual(next)?;
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
    Ok(p)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_of_a_curved_valley_is_found() {
        let wanted = [-0.4, 0.2, 0.05];
        let residual = |p: [f64; 3]| {
            let d: [f64; 3] = std::array::from_fn(|i| p[i] - wanted[i]);
            Ok(vec![d[0] + d[1] * d[1], d[1] - 0.5 * d[0], 3.0 * d[2] + d[0] * d[0]])
        };
        let found = least(residual).unwrap();
        assert!(found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?}");
    }
}
