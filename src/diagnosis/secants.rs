//! What replays so far have told of the errors of a model between them.

use super::fit::solved;
use faer::Mat;
use realfft::num_complex::Complex;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Share of a step's own square that keeps nearly parallel steps apart.
const RIDGE: f64 = 1e-3;

/// Steps between replays, and by how much the model was wrong over each.
///
/// ```text
/// V(θ) += Σ_j w_j D_j,   w = argmin |θ − a − Σ_j w_j Δ_j|² + ε Σ_j w_j² |Δ_j|²,   |w_j| ≤ 1
/// ```
///
/// D_j is the nonlinear column's change over the step Δ_j less the model's. What no step has gone along stays as it is.
///
/// Source: Fang and Saad (2009), doi 10.1002/nla.617: multisecant Broyden update of a first estimate of the derivatives.
#[derive(Clone, Default)]
pub(super) struct Secants(Vec<Secant>);

/// One step.
#[derive(Clone)]
struct Secant {
    /// Δ; unknowns beyond its end did not change.
    step: Vec<f64>,
    /// D, `[group][record][bin and sensor]`; empty where a replay did not finish.
    error: Arc<Vec<Vec<Vec<C64>>>>,
}

impl Secants {
    /// Remembers a step.
    pub fn push(&mut self, step: Vec<f64>, error: Vec<Vec<Vec<C64>>>) {
        if step.iter().any(|d| d.abs() > 1e-6) {
            self.0.push(Secant { step, error: Arc::new(error) });
        }
    }

    /// Also what the last step of `other` has told.
    pub fn learn(&mut self, other: &Self) {
        self.0.extend(other.0.last().cloned());
    }

    /// w for the way `from` one place `to` another; empty where there is none.
    pub fn weights(&self, from: &[f64], to: &[f64]) -> Vec<f64> {
        if self.0.is_empty() || from.len() > to.len() || from == &to[..from.len()] {
            return Vec::new();
        }
        let way: Vec<f64> = from.iter().zip(to).map(|(from, to)| to - from).collect();
        let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let n = self.0.len();
        let step = |j: usize| &self.0[j].step;
        let normal = Mat::from_fn(n, n, |i, j| dot(step(i), step(j)) * if i == j { 1.0 + RIDGE } else { 1.0 });
        let right: Vec<f64> = (0..n).map(|j| dot(step(j), &way)).collect();
        let weights = solved(&normal, &right).unwrap_or_else(|| vec![0.0; n]);
        weights.into_iter().map(|w| w.clamp(-1.0, 1.0)).collect()
    }

    /// Σ w_j D_j at an index of record `r` of group `g`.
    pub fn error(&self, weights: &[f64], [g, r]: [usize; 2], index: usize) -> C64 {
        let of = |(secant, w): (&Secant, &f64)| secant.error[g][r].get(index).map_or(C64::default(), |d| d * w);
        self.0.iter().zip(weights).map(of).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_a_linear_model_are_known_wherever_steps_have_gone() {
        let wrong = |x: &[f64]| C64::new(2.0 * x[0] - x[1], 0.5 * x[2]);
        let mut secants = Secants::default();
        for step in [vec![1.0, 2.0, 0.0], vec![0.5, -1.0, 0.0]] {
            let error = wrong(&step);
            secants.push(step, vec![vec![vec![error]]]);
        }
        let at = |to: &[f64]| {
            let weights = secants.weights(&[0.1, 0.2, 0.3], to);
            secants.error(&weights, [0, 0], 0)
        };
        assert!((at(&[0.4, 0.1, 0.3]) - wrong(&[0.3, -0.1, 0.0])).norm() < 2e-3);
        assert!(at(&[0.1, 0.2, 2.0]).norm() < 1e-12, "no step has gone there");
        assert!((at(&[0.4, 0.1, 0.3, 7.0]) - wrong(&[0.3, -0.1, 0.0])).norm() < 2e-3, "an effect is added");
        assert_eq!(at(&[0.1, 0.2]), C64::default(), "of another model");
        assert!(at(&[90.0, 0.2, 0.3]).norm() < 6.0, "no farther than the steps");
    }
}
