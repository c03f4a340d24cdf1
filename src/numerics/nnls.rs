//! Least squares with unknowns that cannot be negative, for a few unknowns.

/// x ≥ 0 with the smallest xᵀNx/2 − rᵀx, N = AᵀA and r = Aᵀb of the least-squares problem.
///
/// `normal` is symmetric and positive definite, `[N, N]`; only its lower half is read. The unconstrained minimum is tried
/// first; where it has negative unknowns, unknowns are freed one by one.
///
/// Source: Lawson & Hanson (1974), Solving Least Squares Problems, chapter 23.
pub fn nonnegative<const N: usize>(normal: &[[f64; N]; N], rhs: &[f64; N]) -> [f64; N] {
    let mut is_free = [true; N];
    let unconstrained = solved(normal, rhs, &is_free);
    if unconstrained.iter().all(|x| *x >= 0.0) {
        return unconstrained;
    }
    is_free = [false; N];
    let mut x = [0.0; N];
    for _ in 0..3 * N {
        let gradient = |i: usize| rhs[i] - (0..N).map(|j| entry(normal, i, j) * x[j]).sum::<f64>();
        let steepest = (0..N).filter(|i| !is_free[*i]).max_by(|a, b| gradient(*a).total_cmp(&gradient(*b)));
        let Some(i) = steepest.filter(|i| gradient(*i) > 1e-12 * rhs[*i].abs()) else { break };
        is_free[i] = true;
        loop {
            let wanted = solved(normal, rhs, &is_free);
            // As far towards what is wanted as nothing becomes negative; what reaches zero is held there.
            let step = |i: usize| x[i] / (x[i] - wanted[i]);
            let blocking =
                (0..N).filter(|i| is_free[*i] && wanted[*i] <= 0.0).min_by(|a, b| step(*a).total_cmp(&step(*b)));
            let Some(blocking) = blocking else {
                x = wanted;
                break;
            };
            let share = step(blocking);
            for i in 0..N {
                x[i] += share * (wanted[i] - x[i]);
            }
            (x[blocking], is_free[blocking]) = (0.0, false);
        }
    }
    x
}

fn entry<const N: usize>(normal: &[[f64; N]; N], i: usize, j: usize) -> f64 {
    normal[i.max(j)][i.min(j)]
}

/// The unconstrained minimum over the free unknowns, by Cholesky's factors; the others are 0.
fn solved<const N: usize>(normal: &[[f64; N]; N], rhs: &[f64; N], is_free: &[bool; N]) -> [f64; N] {
    let mut factor = [[0.0; N]; N];
    let mut x = [0.0; N];
    for i in (0..N).filter(|i| is_free[*i]) {
        for j in (0..=i).filter(|j| is_free[*j]) {
            let rest = normal[i][j] - (0..j).map(|k| factor[i][k] * factor[j][k]).sum::<f64>();
            factor[i][j] = if i == j { rest.max(f64::MIN_POSITIVE).sqrt() } else { rest / factor[j][j] };
        }
        x[i] = (rhs[i] - (0..i).map(|k| factor[i][k] * x[k]).sum::<f64>()) / factor[i][i];
    }
    for i in (0..N).rev().filter(|i| is_free[*i]) {
        x[i] = (x[i] - (i + 1..N).map(|k| factor[k][i] * x[k]).sum::<f64>()) / factor[i][i];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_minimum_satisfies_the_conditions_of_kuhn_and_tucker() {
        // A of 6 × 4, some of whose unconstrained unknowns are negative.
        let a = |i: usize, j: usize| ((1.3 * i as f64 + 0.7) * (j as f64 + 0.4)).sin() + if i == j { 1.0 } else { 0.0 };
        for case in 0..20 {
            let b = |i: usize| ((i + 3 * case) as f64 * 1.1).cos();
            let sum = |f: &dyn Fn(usize) -> f64| (0..6).map(f).sum::<f64>();
            let normal: [[f64; 4]; 4] = std::array::from_fn(|j| std::array::from_fn(|k| sum(&|i| a(i, j) * a(i, k))));
            let rhs: [f64; 4] = std::array::from_fn(|j| sum(&|i| a(i, j) * b(i)));
            let x = nonnegative(&normal, &rhs);
            for i in 0..4 {
                let gradient = rhs[i] - (0..4).map(|j| normal[i][j] * x[j]).sum::<f64>();
                assert!(x[i] >= 0.0, "case {case}: {x:?}");
                assert!(
                    if x[i] > 0.0 { gradient.abs() < 1e-9 } else { gradient < 1e-9 },
                    "case {case}: {x:?} {gradient}"
                );
            }
        }
    }
}
