//! Steps of a fit that stay within bounds.

use super::fit::solved;
use faer::Mat;

/// `normal` with its diagonal (1 + λ) as large.
pub(super) fn damped(normal: &Mat<f64>, lambda: f64) -> Mat<f64> {
    let mut damped = normal.clone();
    for i in 0..damped.nrows() {
        damped[(i, i)] *= 1.0 + lambda;
    }
    damped
}

/// The step d from `x` with A d = b, which stays within the `bounds`: what would leave them first stops there, the others do what
/// is best with it there, and so on.
pub(super) fn bounded_step(a: Mat<f64>, b: &[f64], x: &[f64], bounds: &[[f64; 2]]) -> Option<Vec<f64>> {
    let mut stopped: Vec<Option<f64>> = vec![None; x.len()];
    loop {
        let free: Vec<usize> = (0..x.len()).filter(|i| stopped[*i].is_none()).collect();
        let push = |i: &usize| {
            let others = stopped.iter().enumerate().filter_map(|(j, d)| Some(a[(*i, j)] * (*d)?));
            b[*i] - others.sum::<f64>()
        };
        let push: Vec<f64> = free.iter().map(push).collect();
        let own = if free.is_empty() {
            Vec::new()
        } else {
            solved(&Mat::from_fn(free.len(), free.len(), |i, j| a[(free[i], free[j])]), &push)?
        };
        let leaves = |(&i, d): (&usize, &f64)| {
            let [low, high] = bounds[i];
            let end = (x[i] + d).clamp(low, high) - x[i];
            (!(low..=high).contains(&(x[i] + d))).then(|| (end / d, i, end))
        };
        match free.iter().zip(&own).filter_map(leaves).min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((_, first, end)) => stopped[first] = Some(end),
            None => {
                free.iter().zip(own).for_each(|(&i, d)| stopped[i] = Some(d));
                return stopped.into_iter().collect();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stops_at_its_bound_leaves_the_others_where_they_cost_least() {
        let a = Mat::from_fn(3, 3, |i, j| [[4.0, 3.0, 0.5], [3.0, 4.0, -0.2], [0.5, -0.2, 1.0]][i][j]);
        let (b, x) = ([5.0, -3.0, 0.3], [0.2, 0.0, -1.0]);
        let cost = |d: &[f64]| -> f64 {
            let quadratic: f64 =
                (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).map(|(i, j)| d[i] * a[(i, j)] * d[j]).sum();
            0.5 * quadratic - d.iter().zip(b).map(|(d, b)| d * b).sum::<f64>()
        };
        let free = bounded_step(a.clone(), &b, &x, &[[-9.0, 9.0]; 3]).unwrap();
        assert!((0..3).all(|i| ((0..3).map(|j| a[(i, j)] * free[j]).sum::<f64>() - b[i]).abs() < 1e-12));
        let bounds = [[-1.0, 1.0], [-3.5, 3.5], [-3.5, 3.5]];
        let found = bounded_step(a.clone(), &b, &x, &bounds).unwrap();
        assert_eq!(found[0], 0.8);
        let clipped: Vec<f64> = (0..3).map(|i| (x[i] + free[i]).clamp(bounds[i][0], bounds[i][1]) - x[i]).collect();
        assert!(cost(&found) < cost(&clipped));
        let nearby = [[0.01, 0.0], [-0.01, 0.0], [0.0, 0.01], [0.0, -0.01]];
        assert!(nearby.iter().all(|[p, q]| cost(&found) < cost(&[found[0], found[1] + p, found[2] + q])));
        assert_eq!(bounded_step(a, &b, &x, &x.map(|x| [x, x])).unwrap(), [0.0; 3]);
    }

    #[test]
    fn damping_enlarges_the_diagonal_alone() {
        let damped = damped(&Mat::from_fn(2, 2, |i, j| (1 + i + j) as f64), 0.5);
        assert_eq!([damped[(0, 0)], damped[(0, 1)], damped[(1, 1)]], [1.5, 2.0, 4.5]);
    }
}
