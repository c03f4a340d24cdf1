//! Peak ground acceleration and velocity.

use crate::numerics::{filter, integrate};

/// Corner below which a velocity holds drift rather than motion, Hz.
const DRIFT_HZ: f64 = 0.1;

/// Largest absolute value; zero for an empty series, NaN where a value is.
pub fn peak(x: &[f64]) -> f64 {
    x.iter().fold(0.0, |m: f64, v| if v.is_nan() || m.is_nan() { f64::NAN } else { m.max(v.abs()) })
}

/// Peak velocity of an acceleration history, m/s.
///
/// ```text
/// PGV = max |∫ h ∗ a dt|,   h without phase, |h(f)| = (f/f_d)⁸ / (1 + (f/f_d)⁸),  f_d = 0.1 Hz    (1)
/// ```
///
/// | symbol | argument | shape      | unit |
/// |--------|----------|------------|------|
/// | a      | x        | `[n_step]` | m/s² |
///
/// Limits: what moves more slowly than 10 s is taken for drift.
/// Check:  `the_velocity_of_a_wave_packet_is_that_of_its_integral`.
/// Source: Boore and Bommer (2005), Processing of strong-motion accelerograms, SDEE 25, 93–115, for the corner against drift.
pub fn peak_velocity_m_s(x: &[f64], dt_s: f64) -> f64 {
    let steady = filter::zero_phase(x, dt_s, |f| {
        let ratio = (f / DRIFT_HZ).powi(8);
        if ratio.is_finite() { ratio / (1.0 + ratio) } else { 1.0 }
    });
    peak(&integrate::cumulative(&steady, dt_s)) // (1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::made_up::{DT_S, observed};

    /// `python tests/metrics/vectors.py`: scipy 1.17.1, `cumulative_trapezoid`.
    #[test]
    fn the_velocity_of_a_wave_packet_is_that_of_its_integral() {
        assert!((peak_velocity_m_s(&observed(), DT_S) / 0.12426315123351209 - 1.0).abs() < 0.01);
        assert!((peak(&observed()) / 1.2270821139585568 - 1.0).abs() < 1e-9);
    }

    #[test]
    fn an_offset_is_no_velocity() {
        let shifted: Vec<f64> = observed().iter().map(|v| v + 0.05).collect();
        assert!((peak_velocity_m_s(&shifted, DT_S) / peak_velocity_m_s(&observed(), DT_S) - 1.0).abs() < 0.02);
        assert_eq!(peak(&[]), 0.0);
        assert!(peak(&[1.0, f64::NAN, 0.5]).is_nan());
    }
}
