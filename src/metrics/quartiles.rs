//! Median and quartiles of a sample.

use serde::{Deserialize, Serialize};

/// Median, lower and upper quartile of a sample; all NaN when it is empty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quartiles {
    /// Half the sample lies below.
    pub median: f64,
    /// A quarter of the sample lies below.
    pub q25: f64,
    /// Three quarters of the sample lie below.
    pub q75: f64,
}

impl Quartiles {
    /// Quartiles of `values` by linear interpolation between order statistics.
    pub fn of(values: &[f64]) -> Self {
        Self { median: quantile(values, 0.5), q25: quantile(values, 0.25), q75: quantile(values, 0.75) }
    }
}

/// Median; NaN for an empty sample.
pub fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

/// Quantile at `share` (0…1), linear between the order statistics (`x_{(n−1)p}`); NaN when empty or a value is NaN.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    if values.is_empty() || values.iter().any(|v| v.is_nan()) {
        return f64::NAN;
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let position = share.clamp(0.0, 1.0) * (sorted.len() - 1) as f64;
    let (below, above) = (position.floor() as usize, position.ceil() as usize);
    if below == above {
        return sorted[below];
    }
    sorted[below] + (position - below as f64) * (sorted[above] - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_interpolate_between_order_statistics() {
        let q = Quartiles::of(&[4.0, 1.0, 3.0, 2.0]);
        assert_eq!((q.q25, q.median, q.q75), (1.75, 2.5, 3.25));
        assert_eq!(median(&[7.0]), 7.0);
        assert!(median(&[]).is_nan() && median(&[1.0, f64::NAN]).is_nan());
        assert_eq!(quantile(&[1.0, f64::INFINITY], 0.0), 1.0);
    }
}
