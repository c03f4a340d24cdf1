//! Where a map leaves a vector as it is.

use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

/// Steps that are remembered.
const MEMORY: usize = 4;
/// Largest share of what the map changes that a step takes.
const LARGEST: f64 = 0.5;
/// Share of the diagonal that keeps the least squares of steps in one direction solvable.
const RIDGE: f64 = 1e-10;

/// x of `map`(x) = x from `start`, within `tolerance` of every value, and whether it is: Anderson's mixing.
///
/// ```text
/// f = map(x) − x,   x ← x + β f − Σ_j θ_j (Δx_j + β Δf_j),   θ = argmin |f − Σ_j θ_j Δf_j|²            (1)
/// ```
///
/// β is ½ at first. A step that would make |f| larger is not taken: all before it are forgotten and β is halved; each that is taken doubles
/// it again up to ½.
///
/// Check:  `a_map_that_is_nearly_one_ends_in_few_steps`, `a_map_that_turns_back_ends`,
/// `a_map_that_is_nowhere_on_the_way_is_turned_from`.
/// Source: Walker & Ni (2011), doi 10.1137/10078356X.
pub fn fixed_point(
    start: Vec<f64>,
    map: impl Fn(&[f64]) -> Vec<f64>,
    most_steps: usize,
    tolerance: f64,
) -> (Vec<f64>, bool) {
    let residual = |x: &[f64]| minus(&map(x), x);
    let is_still = |f: &[f64]| f.iter().all(|f| f.abs() < tolerance);
    let mut f = residual(&start);
    let mut x = start;
    let mut steps: Vec<[Vec<f64>; 2]> = Vec::new();
    let mut share = LARGEST;
    for _ in 0..most_steps {
        if is_still(&f) {
            break;
        }
        let there = mixed(&x, &f, &steps, share);
        let found = residual(&there);
        if square(&found).total_cmp(&square(&f)).is_gt() && !is_still(&found) {
            steps.clear();
            share *= 0.5;
            continue;
        }
        share = LARGEST.min(2.0 * share);
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
fn mixed(x: &[f64], f: &[f64], steps: &[[Vec<f64>; 2]], share: f64) -> Vec<f64> {
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
    next.iter_mut().zip(left).for_each(|(x, f)| *x += share * f);
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
        let (x, is_found) = fixed_point(vec![5.0, -3.0], map, 40, 1e-8);
        let residual = [0.95 * x[0] + 0.1 * x[1] + 0.05 - x[0], 0.3 * x[1] + 0.1 * x[1].sin() + 0.7 - x[1]];
        assert!(is_found && residual.iter().all(|r| r.abs() < 1e-8), "{x:?} {residual:?}");
        assert!(count.get() < 15, "{}", count.get());
    }

    #[test]
    fn a_map_that_turns_back_ends() {
        let (x, is_found) = fixed_point(vec![0.1], |x| vec![3.0 - 2.5 * x[0].tanh()], 60, 1e-9);
        assert!(is_found && (3.0 - 2.5 * x[0].tanh() - x[0]).abs() < 1e-9, "{x:?}");
    }

    #[test]
    fn a_map_that_is_nowhere_on_the_way_is_turned_from() {
        let map = |x: &[f64]| vec![if x[0] > 2.0 { f64::NAN } else { 5.0 - 4.0 * x[0] }];
        let (x, is_found) = fixed_point(vec![0.0], map, 40, 1e-9);
        assert!(is_found && (x[0] - 1.0).abs() < 1e-9, "{x:?}");
    }

    #[test]
    fn what_has_none_says_so() {
        assert!(!fixed_point(vec![0.0], |x| vec![x[0] + 1.0], 20, 1e-6).1);
    }
}
