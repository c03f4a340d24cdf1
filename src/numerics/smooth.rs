//! Means over neighbouring values.

use std::f64::consts::SQRT_2;

/// Mean of each value and up to `half` values to either side; at the ends, of those there are.
///
/// Every mean is summed afresh: differences of running sums would lose what is small beside what came before.
///
/// Check: `a_mean_takes_its_neighbours_and_only_those_there_are`.
pub fn running_mean(x: &[f64], half: usize) -> Vec<f64> {
    (0..x.len())
        .map(|k| {
            let near = &x[k.saturating_sub(half)..(k + half + 1).min(x.len())];
            near.iter().sum::<f64>() / near.len() as f64
        })
        .collect()
}

/// Mean of the values at frequencies within half an octave of each, f/√2 to f √2; frequencies ascend.
///
/// Check: `a_mean_takes_its_neighbours_and_only_those_there_are`.
pub fn octave_mean(x: &[f64], frequencies_hz: &[f64]) -> Vec<f64> {
    let of = |f: &f64| {
        let first = frequencies_hz.partition_point(|other| *other < f / SQRT_2);
        let near = &x[first..frequencies_hz.partition_point(|other| *other <= f * SQRT_2)];
        near.iter().sum::<f64>() / near.len() as f64
    };
    frequencies_hz.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_takes_its_neighbours_and_only_those_there_are() {
        assert_eq!(running_mean(&[1.0, 2.0, 6.0, 4.0, 8.0], 1), [1.5, 3.0, 4.0, 6.0, 6.0]);
        assert_eq!(running_mean(&[1e20, 1.0, 1.0, 1.0], 1)[3], 1.0);
        assert!(running_mean(&[], 3).is_empty());
        assert_eq!(octave_mean(&[1.0, 2.0, 6.0, 4.0], &[1.0, 2.0, 2.5, 5.0]), [1.0, 4.0, 4.0, 4.0]);
    }
}
