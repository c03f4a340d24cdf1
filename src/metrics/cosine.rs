//! Cosine similarity of two coefficient arrays.

/// Cosine of the angle between two arrays of equal length, 1 for the same direction.
///
/// ```text
/// c = Σ a_i b_i / (‖a‖ ‖b‖)
/// ```
///
/// Limits: blind to a common factor; NaN when an array is empty or all zero, or the lengths differ.
/// Check:  `parallel_is_one_and_orthogonal_is_zero`.
/// Source: definition.
pub fn cosine_similarity(a: &[f64], b: &[f64]) -> f64 {
    if a.len() != b.len() {
        return f64::NAN;
    }
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(p, q)| p * q).sum::<f64>();
    dot(a, b) / (dot(a, a).sqrt() * dot(b, b).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parallel_is_one_and_orthogonal_is_zero() {
        assert!((cosine_similarity(&[1.0, -2.0, 3.0], &[2.0, -4.0, 6.0]) - 1.0).abs() < 1e-15);
        assert_eq!(cosine_similarity(&[1.0, 0.0], &[0.0, 5.0]), 0.0);
        assert!((cosine_similarity(&[1.0, 0.0], &[1.0, 1.0]) - 0.5f64.sqrt()).abs() < 1e-15);
        assert!(cosine_similarity(&[0.0], &[1.0]).is_nan() && cosine_similarity(&[1.0], &[1.0, 2.0]).is_nan());
    }
}
