//! Equidistant frequencies at which something smooth is known, and what it is between them.

use realfft::num_complex::Complex;

/// Equidistant frequencies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// First frequency, Hz.
    pub first_hz: f64,
    /// Step, Hz.
    pub step_hz: f64,
    /// How many.
    pub count: usize,
}

impl Grid {
    /// A grid that reaches a step and a half beyond `low_hz…high_hz`.
    pub fn around(low_hz: f64, high_hz: f64, step_hz: f64) -> Self {
        let first_hz = (low_hz - 1.5 * step_hz).max(0.02);
        let count = ((high_hz + 1.5 * step_hz - first_hz) / step_hz).ceil() as usize + 2;
        Self { first_hz, step_hz, count: count.max(4) }
    }

    /// Frequency of node `k`, Hz.
    pub fn frequency(&self, k: usize) -> f64 {
        self.first_hz + k as f64 * self.step_hz
    }

    /// The four nodes around `frequency_hz`.
    pub fn cubic(&self, frequency_hz: f64) -> Cubic {
        let x = (frequency_hz - self.first_hz) / self.step_hz;
        let i = (x.floor() as isize - 1).clamp(0, self.count as isize - 4) as usize;
        let t = x - i as f64;
        let [a, b, c, d] = [t, t - 1.0, t - 2.0, t - 3.0];
        let weights = [-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0];
        Cubic { first: i, weights }
    }
}

/// Lagrange's cubic through four nodes of a grid, at one frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cubic {
    first: usize,
    weights: [f64; 4],
}

impl Cubic {
    /// What `values`, one a node of the grid, are there.
    pub fn of(&self, values: &[Complex<f64>]) -> Complex<f64> {
        (0..4).map(|k| values[self.first + k] * self.weights[k]).sum()
    }
}
