//! Residuals of predictions as one vector, whose square is the power that is left over that of the records.

use crate::inference::forward::Prediction;
use realfft::num_complex::Complex;

/// Residuals of every record, sensor and bin, each sensor's over the power of its record, mean over all: their squares add up to the
/// share of the power that is left.
pub(super) struct Residuals(Vec<Complex<f64>>);

impl Residuals {
    /// Of a prediction.
    pub fn of(prediction: &Prediction) -> Self {
        let n: usize = prediction.iter().map(|p| p.measured.len()).sum();
        let sensors = prediction.iter().flat_map(|p| p.outputs.iter().zip(&p.measured));
        let of = |(y, m): (&Vec<Complex<f64>>, &Vec<Complex<f64>>)| {
            let power: f64 = m.iter().map(|m| m.norm_sqr()).sum();
            let scale = (n as f64 * power).max(f64::MIN_POSITIVE).sqrt().recip();
            m.iter().zip(y).map(|(m, y)| (m - y) * scale).collect::<Vec<_>>()
        };
        Self(sensors.flat_map(of).collect())
    }

    /// The share of the power that is left.
    pub fn share(&self) -> f64 {
        self.0.iter().map(Complex::norm_sqr).sum()
    }

    /// The mean of `all` by their weights, which add up to 1.
    fn mean(all: impl Iterator<Item = (Self, f64)>) -> Self {
        let add = |mut sum: Vec<Complex<f64>>, (one, weight): (Self, f64)| {
            sum.resize(one.0.len(), Complex::ZERO);
            sum.iter_mut().zip(one.0).for_each(|(sum, r)| *sum += r * weight);
            sum
        };
        Self(all.fold(Vec::new(), add))
    }

    fn square_distance(&self, other: &Self) -> f64 {
        self.0.iter().zip(&other.0).map(|(a, b)| (a - b).norm_sqr()).sum()
    }
}

/// Index of the one of `candidates` that is closest to the mean of `all` by their weights, which add up to 1: the one of the least
/// expected square error where each of `all` holds with the probability that is its weight.
pub(super) fn closest_to_mean(candidates: &[Residuals], all: impl Iterator<Item = (Residuals, f64)>) -> Option<usize> {
    let mean = Residuals::mean(all);
    let losses = candidates.iter().map(|own| own.square_distance(&mean)).enumerate();
    losses.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_that_do_alike_one_is_closest_to_the_mean_though_none_is_probable() {
        let of = |values: [f64; 2]| Residuals(values.map(Complex::from).to_vec());
        let without = [1.0, 0.0];
        let (one, other) = ([0.1, 0.2], [0.1, -0.1]);
        let closest = |weights: [f64; 3]| {
            let models = [without, one, other];
            closest_to_mean(&models.map(of), models.map(of).into_iter().zip(weights))
        };
        assert_eq!(closest([0.1, 0.5, 0.4]), Some(1));
        assert_eq!(closest([0.1, 0.3, 0.6]), Some(2));
        assert_eq!(closest([0.6, 0.2, 0.2]), Some(0));
        assert_eq!(closest_to_mean(&[], [without].map(of).into_iter().zip([1.0])), None);
    }
}
