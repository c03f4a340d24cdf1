//! How sure a median over events is.

use super::{median, quantile};
use crate::numerics::random;
use rand::RngExt;

/// Resamples of the events.
const RESAMPLES: usize = 2000;

/// 95 % interval of the median over all values when whole events are drawn anew, with replacement.
///
/// ```text
/// m* = median of ∪_i V_{e_i},   e_i uniform over the events;   [q_0.025(m*), q_0.975(m*)]
/// ```
///
/// | argument | shape                       | unit |
/// |----------|-----------------------------|------|
/// | events   | one list of values an event | any  |
///
/// The values of one event share its motion, so they are not drawn one by one. For a difference of two models give the
/// differences of pairs: then the interval is that of the paired comparison.
///
/// Limits: with three events the ends are those of the best and the worst event; `None` without a finite value.
/// Check:  `the_interval_covers_the_median_and_narrows_with_more_events`.
/// Source: Efron and Tibshirani (1993), An Introduction to the Bootstrap, ch. 13.
pub fn median_interval(events: &[Vec<f64>], seed: u64) -> Option<[f64; 2]> {
    let events: Vec<Vec<f64>> = events
        .iter()
        .map(|values| values.iter().copied().filter(|v| v.is_finite()).collect::<Vec<_>>())
        .filter(|values: &Vec<f64>| !values.is_empty())
        .collect();
    if events.is_empty() {
        return None;
    }
    let mut random = random::stream(seed, "bootstrap over events");
    let medians: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let drawn = (0..events.len()).map(|_| &events[random.random_range(0..events.len())]);
            median(&drawn.flatten().copied().collect::<Vec<_>>())
        })
        .collect();
    Some([quantile(&medians, 0.025), quantile(&medians, 0.975)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    fn normal(n_event: usize, seed: u64) -> Vec<Vec<f64>> {
        let mut random = random::stream(seed, "test");
        (0..n_event).map(|_| (0..3).map(|_| StandardNormal.sample(&mut random)).collect()).collect()
    }

    #[test]
    fn the_interval_covers_the_median_and_narrows_with_more_events() {
        let covers = |seed| {
            let [low, high] = median_interval(&normal(20, seed), 1).expect("there are values");
            low <= 0.0 && 0.0 <= high
        };
        let covered = (0..100).filter(|seed| covers(*seed)).count();
        assert!((88..=99).contains(&covered), "{covered} of 100 intervals hold the true median");
        let width = |n| median_interval(&normal(n, 7), 1).map(|[low, high]| high - low).expect("there are values");
        assert!(width(200) < 0.5 * width(20));
    }

    #[test]
    fn few_events_and_gaps_are_no_obstacle() {
        assert_eq!(median_interval(&[vec![2.0]], 1), Some([2.0, 2.0]));
        assert_eq!(median_interval(&[vec![f64::NAN], vec![]], 1), None);
        assert_eq!(median_interval(&[vec![1.0], vec![3.0], vec![f64::NAN]], 1), Some([1.0, 3.0]));
    }
}
