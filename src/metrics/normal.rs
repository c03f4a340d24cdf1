//! The normal distribution.

/// exp(k²/2) Φ(−k) for k ≥ 0.
///
/// Source: Abramowitz and Stegun (1964), 26.2.14, for large k.
pub fn scaled_tail(k: f64) -> f64 {
    if k < 3.0 {
        return (0.5 * k * k).exp() * normal_probability(-k);
    }
    let fraction = (1..=20).rev().fold(k, |below, m| k + f64::from(m) / below);
    1.0 / (fraction * (2.0 * std::f64::consts::PI).sqrt())
}

/// Probability that a standard normal number is below `z`.
///
/// Source: Abramowitz and Stegun (1964), 26.2.17; error below 7.5e-8.
pub fn normal_probability(z: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.231_641_9 * z.abs());
    let series =
        t * (0.319_381_530 + t * (-0.356_563_782 + t * (1.781_477_937 + t * (-1.821_255_978 + t * 1.330_274_429))));
    let tail = (-0.5 * z * z).exp() / (2.0 * std::f64::consts::PI).sqrt() * series;
    if z >= 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_probabilities_are_those_of_tables() {
        for (z, p) in [(0.0, 0.5), (1.0, 0.841_344_7), (-1.959_964, 0.025), (3.0, 0.998_650_1)] {
            assert!((normal_probability(z) - p).abs() < 1e-6, "{z}");
        }
    }
}
