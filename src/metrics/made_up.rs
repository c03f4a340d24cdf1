//! Two short histories in closed form, for tests of every measure against independent implementations
//! (`tests/metrics/vectors.py` makes the same).

/// Step, s.
pub const DT_S: f64 = 0.01;

fn history(first: f64, second: f64, lag_s: f64) -> Vec<f64> {
    let at = |t: f64| {
        first * (std::f64::consts::TAU * 1.3 * t).sin() * (-((t - 8.0) / 3.0).powi(2)).exp()
            + second * (std::f64::consts::TAU * 4.7 * t + 1.0).sin() * (-((t - 6.0) / 1.5).powi(2)).exp()
    };
    (0..2001).map(|i| at(i as f64 * DT_S - lag_s)).collect()
}

/// What was recorded, m/s².
pub fn observed() -> Vec<f64> {
    history(1.0, 0.5, 0.0)
}

/// What was predicted, m/s².
pub fn predicted() -> Vec<f64> {
    history(1.2, 0.35, 0.03)
}
