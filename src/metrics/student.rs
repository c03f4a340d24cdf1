//! What a few paired differences allow to say: Student's interval and the exact sign test.

use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Mean of a few differences, one an event, with what may be said of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PairedDifference {
    /// Mean.
    pub mean: f64,
    /// 95 % interval of the mean; `None` for a single difference.
    pub ci95: Option<[f64; 2]>,
    /// Two-sided p of the sign test.
    pub sign_test_p: f64,
    /// Number of differences.
    pub n: usize,
}

impl PairedDifference {
    /// Events from which on something may be claimed: with two the interval is thirteen standard errors wide to either side and rests
    /// on the normal law alone.
    pub const FEWEST: usize = 3;

    /// Of `differences` between two models on the same events, one an event; `None` without any.
    ///
    /// ```text
    /// d̄ ± t₀.₉₇₅(n − 1) s/√n,   s² = Σ (d_i − d̄)²/(n − 1)                        (1)
    /// p = min(1, 2 Σ_{j ≤ k} C(m, j) 2⁻ᵐ),   k the rarer sign of the m that are not 0   (2)
    /// ```
    ///
    /// Limits: (1) is exact for normal differences and wider than need be for heavy tails; skewed ones may be covered less. With n
    /// events the smallest p of (2) is 2^(1−n): it cannot fall below 0.05 before the sixth event.
    /// Check:  `interval_and_sign_test_are_those_of_scipy`, `intervals_of_few_differences_hold`.
    /// Source: Student (1908), The probable error of a mean, Biometrika 6, 1–25; Dixon and Mood (1946), JASA 41, 557–566.
    pub fn of(differences: &[f64]) -> Option<Self> {
        let n = differences.len();
        if n == 0 {
            return None;
        }
        let mean = differences.iter().sum::<f64>() / n as f64;
        let ci95 = (n > 1).then(|| {
            let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1) as f64;
            let half = t_quantile(0.975, n - 1) * (variance / n as f64).sqrt(); // (1)
            [mean - half, mean + half]
        });
        Some(Self { mean, ci95, sign_test_p: sign_test(differences), n })
    }

    /// Whether the interval lies below zero, with three events or more behind it.
    pub fn is_below_zero(&self) -> bool {
        self.n >= Self::FEWEST && self.ci95.is_some_and(|[_, high]| high < 0.0)
    }

    /// Whether the interval `ci95` of `n` differences lies above zero, with three events or more behind it.
    pub fn is_above_zero(ci95: Option<[f64; 2]>, n: usize) -> bool {
        n >= Self::FEWEST && ci95.is_some_and(|[low, _]| low > 0.0)
    }
}

fn sign_test(differences: &[f64]) -> f64 {
    let below = differences.iter().filter(|d| **d < 0.0).count();
    let above = differences.iter().filter(|d| **d > 0.0).count();
    let (n, rarer) = (below + above, below.min(above));
    let mut term = 0.5f64.powi(n as i32);
    let mut sum = term;
    for j in 1..=rarer {
        term *= (n + 1 - j) as f64 / j as f64;
        sum += term;
    }
    (2.0 * sum).min(1.0) // (2)
}

/// Quantile of Student's t at `share` (0.5 … 1), `degrees` of freedom (1 or more).
///
/// Limits: found by halving an interval, to ten digits; `share` below 0.5 is not served.
/// Check:  `interval_and_sign_test_are_those_of_scipy`.
pub fn t_quantile(share: f64, degrees: usize) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    while t_distribution(high, degrees) < share && high < 1e12 {
        high *= 2.0;
    }
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if t_distribution(middle, degrees) < share { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Student's distribution function for whole degrees of freedom, a finite sum.
///
/// Source: Abramowitz and Stegun (1964), Handbook of Mathematical Functions, 26.7.3 and 26.7.4.
fn t_distribution(t: f64, degrees: usize) -> f64 {
    let theta = (t / (degrees as f64).sqrt()).atan();
    let (sin, cos) = theta.sin_cos();
    let is_odd = degrees % 2 == 1;
    // Odd: cos θ (1 + 2/3 cos² + 2·4/(3·5) cos⁴ …); even: 1 + 1/2 cos² + 1·3/(2·4) cos⁴ …
    let (first, steps) = if is_odd { (2, (degrees.max(3) - 3) / 2) } else { (1, (degrees - 2) / 2) };
    let mut term = if is_odd { cos } else { 1.0 };
    let mut sum = if degrees == 1 { 0.0 } else { term };
    for j in 0..steps {
        let above = (first + 2 * j) as f64;
        term *= above / (above + 1.0) * cos * cos;
        sum += term;
    }
    let within = if is_odd { 2.0 / PI * (theta + sin * sum) } else { sin * sum };
    0.5 + 0.5 * within
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand::RngExt;
    use rand_distr::{Distribution, StandardNormal, StudentT};

    /// `python tests/metrics/vectors.py` with scipy 1.17.1: `t.ppf`, `t.interval`, `binomtest`.
    #[test]
    fn interval_and_sign_test_are_those_of_scipy() {
        let expected =
            [(1, 12.706204736174694), (2, 4.302652729749462), (3, 3.1824463052837078), (8, 2.306004135204166)];
        for (degrees, expected) in expected.into_iter().chain([(30, 2.0422724563012378)]) {
            assert!((t_quantile(0.975, degrees) / expected - 1.0).abs() < 1e-9, "{degrees}");
        }
        let found = PairedDifference::of(&[-3.0, -1.0, -4.0, -2.5, 0.5]).unwrap();
        let [low, high] = found.ci95.unwrap();
        assert!((low + 4.1949725827127065).abs() < 1e-9 && (high - 0.1949725827127069).abs() < 1e-9);
        assert!((found.sign_test_p - 0.375).abs() < 1e-12 && found.n == 5 && !found.is_below_zero());
    }

    #[test]
    fn nothing_is_said_of_fewer_than_three() {
        assert_eq!(PairedDifference::of(&[]), None);
        let one = PairedDifference::of(&[-5.0]).unwrap();
        assert!(one.ci95.is_none() && !one.is_below_zero() && one.sign_test_p == 1.0);
        let two = PairedDifference::of(&[-5.0, -5.1]).unwrap();
        assert!(two.ci95.is_some_and(|[_, high]| high < 0.0) && !two.is_below_zero());
        assert!(PairedDifference::of(&[-5.0, -5.1, -4.9]).unwrap().is_below_zero());
        assert_eq!(PairedDifference::of(&[0.0, 0.0]).unwrap().sign_test_p, 1.0);
    }

    #[test]
    fn intervals_of_few_differences_hold() {
        const DRAWS: usize = 20_000;
        let heavy = StudentT::new(3.0).unwrap();
        let mut random = random::stream(1, "coverage of Student's interval");
        for n in 3..=9 {
            let mut normal = || (0..n).map(|_| StandardNormal.sample(&mut random)).collect::<Vec<f64>>();
            let of_normal = covered(DRAWS, &mut normal);
            let mut tails = || (0..n).map(|_| heavy.sample(&mut random)).collect::<Vec<f64>>();
            let of_heavy = covered(DRAWS, &mut tails);
            // Now and then one event ten times as far off as the others.
            let mut spoiled = || {
                let scale =
                    |random: &mut rand_chacha::ChaCha12Rng| if random.random::<f64>() < 0.1 { 10.0 } else { 1.0 };
                (0..n)
                    .map(|_| {
                        scale(&mut random) * <StandardNormal as Distribution<f64>>::sample(&StandardNormal, &mut random)
                    })
                    .collect::<Vec<f64>>()
            };
            let of_spoiled = covered(DRAWS, &mut spoiled);
            println!(
                "{n} events: normal {of_normal:.3}, t of 3 degrees {of_heavy:.3}, one in ten far off {of_spoiled:.3}"
            );
            assert!(of_normal.min(of_heavy).min(of_spoiled) >= 0.93, "{n}: {of_normal} {of_heavy} {of_spoiled}");
        }
    }

    fn covered(draws: usize, draw: &mut dyn FnMut() -> Vec<f64>) -> f64 {
        let hits = (0..draws).filter(|_| {
            let [low, high] = PairedDifference::of(&draw()).unwrap().ci95.unwrap();
            low <= 0.0 && 0.0 <= high
        });
        hits.count() as f64 / draws as f64
    }
}
