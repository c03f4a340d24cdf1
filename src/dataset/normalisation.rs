//! Scales of base, dense and sparse channels, from training cases only.

use super::coarse::Coarse;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Standard deviation of each channel over the training cases; a normalised value is the value over it.
///
/// ```text
/// x̃ = x / σ,   σ² = mean over training cases and steps of (x − x̄)²
/// ```
///
/// The mean is not subtracted: an acceleration at rest stays zero.
///
/// Limits: a channel that never moves has no scale and is an error.
/// Check:  `scales_are_the_pooled_standard_deviation_of_the_training_cases`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Normalisation {
    /// Scale of the base acceleration, m/s².
    pub base_m_s2: f64,
    /// Scale of each dense channel, m/s².
    pub dense_m_s2: Vec<f64>,
    /// Scale of each sensor, m/s².
    pub sparse_m_s2: Vec<f64>,
}

impl Normalisation {
    /// Base acceleration in units of its scale (steps or half steps).
    pub fn base(&self, x_m_s2: &[f64]) -> Vec<f32> {
        x_m_s2.iter().map(|v| (v / self.base_m_s2) as f32).collect()
    }

    /// Dense rows in units of their scales.
    pub fn dense(&self, rows_m_s2: &[f64]) -> Vec<f32> {
        scaled(rows_m_s2, &self.dense_m_s2)
    }

    /// Sensor rows in units of their scales.
    pub fn sparse(&self, rows_m_s2: &[f64]) -> Vec<f32> {
        scaled(rows_m_s2, &self.sparse_m_s2)
    }

    /// Dense rows back in m/s².
    pub fn dense_to_m_s2(&self, rows: &[f32]) -> Vec<f64> {
        unscaled(rows, &self.dense_m_s2)
    }

    /// Sensor rows back in m/s².
    pub fn sparse_to_m_s2(&self, rows: &[f32]) -> Vec<f64> {
        unscaled(rows, &self.sparse_m_s2)
    }
}

fn scaled(rows: &[f64], scales: &[f64]) -> Vec<f32> {
    rows.iter().zip(scales.iter().cycle()).map(|(v, s)| (v / s) as f32).collect()
}

fn unscaled(rows: &[f32], scales: &[f64]) -> Vec<f64> {
    rows.iter().zip(scales.iter().cycle()).map(|(v, s)| f64::from(*v) * s).collect()
}

/// Gathers the scales case by case, so that the cases need not be in memory together.
#[derive(Debug, Clone, Default)]
pub struct Accumulator {
    base: Moments,
    dense: Vec<Moments>,
    sparse: Vec<Moments>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    n: f64,
    sum: f64,
    squares: f64,
}

impl Moments {
    fn add(&mut self, x: f64) {
        self.n += 1.0;
        self.sum += x;
        self.squares += x * x;
    }

    fn deviation(&self) -> f64 {
        let mean = self.sum / self.n;
        (self.squares / self.n - mean * mean).max(0.0).sqrt()
    }
}

impl Accumulator {
    /// Adds one training case.
    ///
    /// # Errors
    /// When it has other channels than those before.
    pub fn add(&mut self, case: &Coarse) -> Result<()> {
        if self.base.n == 0.0 {
            self.dense = vec![Moments::default(); case.n_dense];
            self.sparse = vec![Moments::default(); case.n_sparse];
        }
        if (case.n_dense, case.n_sparse) != (self.dense.len(), self.sparse.len()) {
            return Err(Error::new(format!(
                "case `{}` has {} dense and {} sparse channels, those before have {} and {}",
                case.id,
                case.n_dense,
                case.n_sparse,
                self.dense.len(),
                self.sparse.len()
            )));
        }
        case.base_m_s2.iter().for_each(|v| self.base.add(*v));
        for (rows, sums) in [(&case.dense_m_s2, &mut self.dense), (&case.sparse_m_s2, &mut self.sparse)] {
            for row in rows.chunks_exact(sums.len().max(1)) {
                row.iter().zip(sums.iter_mut()).for_each(|(v, m)| m.add(*v));
            }
        }
        Ok(())
    }

    /// The scales of all cases added.
    ///
    /// # Errors
    /// When there was no case, or a channel never moves.
    pub fn finish(self) -> Result<Normalisation> {
        let scale = |what: &str, i: usize, m: &Moments| {
            let deviation = m.deviation();
            let text =
                format!("{what} channel {i} has a standard deviation of {deviation} m/s² over the training cases");
            if deviation > 0.0 && deviation.is_finite() {
                Ok(deviation)
            } else {
                Err(Error::new(text).hint("every channel must move in the training cases; are there any?"))
            }
        };
        let scales = |what: &str, all: &[Moments]| {
            all.iter().enumerate().map(|(i, m)| scale(what, i, m)).collect::<Result<Vec<f64>>>()
        };
        Ok(Normalisation {
            base_m_s2: scale("base", 0, &self.base)?,
            dense_m_s2: scales("dense", &self.dense)?,
            sparse_m_s2: scales("sparse", &self.sparse)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(factor: f64) -> Coarse {
        let wave = |i: usize, k: f64| factor * k * (0.3 * i as f64).sin();
        Coarse {
            id: "001".into(),
            dt_s: 0.05,
            base_m_s2: (0..500).map(|i| wave(i, 1.0)).collect(),
            base_half_m_s2: vec![0.0; 499],
            n_dense: 2,
            dense_m_s2: (0..500).flat_map(|i| [wave(i, 2.0), wave(i, 5.0)]).collect(),
            n_sparse: 1,
            sparse_m_s2: (0..500).map(|i| wave(i, 3.0)).collect(),
        }
    }

    fn scales(training: &[Coarse]) -> Result<Normalisation> {
        let mut sums = Accumulator::default();
        training.iter().try_for_each(|case| sums.add(case))?;
        sums.finish()
    }

    #[test]
    fn scales_are_the_pooled_standard_deviation_of_the_training_cases() {
        let n = scales(&[case(1.0), case(7.0)]).unwrap();
        let expected = (0.5f64 * (1.0 + 49.0) * 0.5).sqrt();
        assert!((n.base_m_s2 / expected - 1.0).abs() < 0.01);
        assert!((n.dense_m_s2[1] / n.dense_m_s2[0] - 2.5).abs() < 1e-12);
        assert!((n.sparse_m_s2[0] / n.base_m_s2 - 3.0).abs() < 1e-12);
    }

    #[test]
    fn values_come_back_in_physical_units() {
        let c = case(1.0);
        let n = scales(&[case(1.0)]).unwrap();
        let back = n.dense_to_m_s2(&n.dense(&c.dense_m_s2));
        assert!(back.iter().zip(&c.dense_m_s2).all(|(a, b)| (a - b).abs() < 1e-6));
        let back = n.sparse_to_m_s2(&n.sparse(&c.sparse_m_s2));
        assert!(back.iter().zip(&c.sparse_m_s2).all(|(a, b)| (a - b).abs() < 1e-6));
        let text = toml::to_string(&n).unwrap();
        assert_eq!(toml::from_str::<Normalisation>(&text).unwrap(), n);
    }

    #[test]
    fn still_channels_and_unlike_cases_are_refused() {
        assert!(scales(&[]).is_err());
        assert!(scales(&[case(0.0)]).unwrap_err().what().contains("base channel 0"));
        let unlike = Coarse { n_sparse: 0, sparse_m_s2: vec![], ..case(1.0) };
        assert!(scales(&[case(1.0), unlike]).is_err());
    }
}
