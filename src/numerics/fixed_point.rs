//! Where a map leaves a vector as it is.

use super::threads::on_threads;
use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};

/// Steps that are remembered.
const MEMORY: usize = 4;
/// Largest share of what the map changes that a step takes, without and with a derivative from near by.
const LARGEST: [f64; 2] = [0.5, 1.0];
/// Length of the differences by which a derivative is taken.
const STEP: f64 = 1e-3;
/// Share of the diagonal that keeps the least squares of steps in one direction solvable.
const RIDGE: f64 = 1e-10;

/// (I − ∂map/∂x)⁻¹ somewhere: what turns `map`(x) − x into a step.
#[derive(Debug)]
pub struct Newton(Mat<f64>);

impl Newton {
    /// At `x`, by one call of `map` for each value; `None` where it is singular.
    pub fn at(x: &[f64], map: impl Fn(&[f64]) -> Vec<f64> + Sync) -> Option<Self> {
        let (n, here) = (x.len(), map(x));
        let column = |j: usize| {
            let mut beside = x.to_vec();
            beside[j] += STEP;
            minus(&map(&beside), &here)
        };
        let changes = on_threads(n, column);
        let one_less = Mat::from_fn(n, n, |i, j| f64::from(u8::from(i == j)) - changes[j][i] / STEP);
        let inverse = one_less.partial_piv_lu().inverse();
        let is_finite = (0..n).all(|i| (0..n).all(|j| inverse[(i, j)].is_finite()));
        is_finite.then_some(Self(inverse))
    }

    fn step(&self, f: &[f64]) -> Vec<f64> {
        (0..f.len()).map(|i| (0..f.len()).map(|j| self.0[(i, j)] * f[j]).sum()).collect()
    }
}

/// x of `map`(x) = x from `start`, within `tolerance` of every value, and whether it is: Anderson's mixing, with `newton` from near by
/// where there is one.
///
/// ```text
/// f = map(x) − x,   x ← x + β P f − Σ_j θ_j (Δx_j + β P Δf_j),   θ = argmin |f − Σ_j θ_j Δf_j|²            (1)
/// ```
///
/// P = I and β = ½, or β = 1 with P of `newton`. A step that would make |f| larger is not taken: all before it and `newton` are forgotten
/// and β is halved; each that is taken doubles it again up to ½.
///
/// Check:  `a_map_that_is_nearly_one_ends_in_few_steps`, `a_map_that_turns_back_ends`,
/// `a_map_that_is_nowhere_on_the_way_is_turned_from`, `what_is_known_near_by_saves_steps_and_changes_nothing`.
/// Source: Walker & Ni (2011), doi 10.1137/10078356X.
pub fn fixed_point(
    start: Vec<f64>,
    map: impl Fn(&[f64]) -> Vec<f64>,
    newton: Option<&Newton>,
    most_steps: usize,
    tolerance: f64,
) -> (Vec<f64>, bool) {
    let residual = |x: &[f64]| minus(&map(x), x);
    let is_still = |f: &[f64]| f.iter().all(|f| f.abs() < tolerance);
    let mut f = residual(&start);
    let mut x = start;
    let mut steps: Vec<[Vec<f64>; 2]> = Vec::new();
    let mut newton = newton.filter(|newton| newton.0.nrows() == x.len());
    let largest = |newton: Option<&Newton>| LARGEST[usize::from(newton.is_some())];
    let mut share = largest(newton);
    for _ in 0..most_steps {
        if is_still(&f) {
            break;
        }
        let there = mixed(&x, &f, &steps, newton, share);
        let found = residual(&there);
        if square(&found).total_cmp(&square(&f)).is_gt() && !is_still(&found) {
            steps.clear();
            newton = None;
            share *= 0.5;
            continue;
        }
        share = largest(newton).min(2.0 * share);
        steps.push([minus(&there, &x), minus(&found, &f)]);
        if steps.len() > MEMORY.min(x.len()) {
            steps.remove(0);
        }
        (x, f) = (there, found);
    }
    let is_found = is_still(&f);
    (x, is_found)
}

/// The next x of (1).
fn mixed(x: &[f64], f: &[f64], steps: &[[Vec<f64>; 2]], newton: Option<&Newton>, share: f64) -> Vec<f64> {
    let mut left = f.to_vec();
    let mut next = x.to_vec();
    let m = steps.len();
    let a = Mat::from_fn(m, m, |i, j| dot(&steps[i][1], &steps[j][1]) * if i == j { 1.0 + RIDGE } else { 1.0 });
    if let Ok(factor) = a.llt(Side::Lower) {
        let theta = factor.solve(Mat::from_fn(m, 1, |i, _| dot(&steps[i][1], f)));
        for (j, [dx, df]) in steps.iter().enumerate() {
            next.iter_mut().zip(dx).for_each(|(x, dx)| *x -= theta[(j, 0)] * dx);
            left.iter_mut().zip(df).for_each(|(f, df)| *f -= theta[(j, 0)] * df);
        }
    }
    let pulled = newton.map_or_else(|| left.clone(), |newton| newton.step(&left));
    next.iter_mut().zip(pulled).for_each(|(x, f)| *x += share * f);
    next
}

fn minus(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn square(a: &[f64]) -> f64 {
    dot(a, a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn a_map_that_is_nearly_one_ends_in_few_steps() {
        // Half of the change alone would take 200 steps.
        let count = Cell::new(0);
        let map = |x: &[f64]| {
            count.set(count.get() + 1);
            vec![0.95 * x[0] + 0.1 * x[1] + 0.05, 0.3 * x[1] + 0.1 * x[1].sin() + 0.7]
        };
        let (x, is_found) = fixed_point(vec![5.0, -3.0], map, None, 40, 1e-8);
        let residual = [0.95 * x[0] + 0.1 * x[1] + 0.05 - x[0], 0.3 * x[1] + 0.1 * x[1].sin() + 0.7 - x[1]];
        assert!(is_found && residual.iter().all(|r| r.abs() < 1e-8), "{x:?} {residual:?}");
        assert!(count.get() < 15, "{}", count.get());
    }

    #[test]
    fn a_map_that_turns_back_ends() {
        let (x, is_found) = fixed_point(vec![0.1], |x| vec![3.0 - 2.5 * x[0].tanh()], None, 60, 1e-9);
        assert!(is_found && (3.0 - 2.5 * x[0].tanh() - x[0]).abs() < 1e-9, "{x:?}");
    }

    #[test]
    fn a_map_that_is_nowhere_on_the_way_is_turned_from() {
        let map = |x: &[f64]| vec![if x[0] > 2.0 { f64::NAN } else { 5.0 - 4.0 * x[0] }];
        let (x, is_found) = fixed_point(vec![0.0], map, None, 40, 1e-9);
        assert!(is_found && (x[0] - 1.0).abs() < 1e-9, "{x:?}");
    }

    #[test]
    fn what_is_known_near_by_saves_steps_and_changes_nothing() {
        let n = 12;
        let of = |shift: f64| {
            move |x: &[f64]| -> Vec<f64> {
                let mean = x.iter().sum::<f64>() / n as f64;
                let all = x.iter().enumerate();
                all.map(|(i, x)| 0.6 * (x + shift * i as f64).sin() - 0.8 * mean.tanh() + 0.1 * i as f64).collect()
            }
        };
        let (here, is_found) = fixed_point(vec![0.0; n], of(0.0), None, 60, 1e-10);
        assert!(is_found);
        let newton = Newton::at(&here, of(0.0)).unwrap();
        let counted = |newton: Option<&Newton>| {
            let count = Cell::new(0);
            let map = |x: &[f64]| {
                count.set(count.get() + 1);
                of(0.02)(x)
            };
            let (x, is_found) = fixed_point(here.clone(), map, newton, 60, 1e-6);
            assert!(is_found);
            (x, count.get())
        };
        let ((plain, many), (pulled, few)) = (counted(None), counted(Some(&newton)));
        assert!(2 * few < many, "{few} {many}");
        assert!(plain.iter().zip(&pulled).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn what_has_none_says_so() {
        assert!(!fixed_point(vec![0.0], |x| vec![x[0] + 1.0], None, 20, 1e-6).1);
    }
}
