//! Arias intensity, its build-up, and durations read off it.

use crate::numerics::integrate::cumulative;
use crate::units::G_M_S2;
use std::f64::consts::PI;

/// Build-up of the Arias intensity, m/s.
///
/// ```text
/// I_A(t) = π/(2 g) ∫₀ᵗ a² dt                                     (1)
/// ```
///
/// | symbol | argument | shape      | unit |
/// |--------|----------|------------|------|
/// | a      | x        | `[n_step]` | m/s² |
/// | I_A    | returned | `[n_step]` | m/s  |
///
/// Limits: the trapezoidal rule; a step above a tenth of the shortest period loses accuracy.
/// Check:  `intensity_and_durations_are_those_of_an_independent_implementation`.
/// Source: Arias (1970), A measure of earthquake intensity, in Seismic Design for Nuclear Power Plants, MIT Press, 438–483.
pub fn arias_build_up_m_s(x: &[f64], dt_s: f64) -> Vec<f64> {
    let squared: Vec<f64> = x.iter().map(|a| a * a).collect();
    cumulative(&squared, dt_s).into_iter().map(|v| PI / (2.0 * G_M_S2) * v).collect() // (1)
}

/// Time in which `build_up` rises from one share of its end value to another, s; NaN where it does not rise.
///
/// ```text
/// D_{p–q} = t(q I) − t(p I),   I = I(t_end),  linear between samples      (2)
/// ```
///
/// | symbol | argument | unit | range |
/// |--------|----------|------|-------|
/// | I(t)   | build_up | any  | rises |
/// | p, q   | shares   | –    | 0 … 1 |
///
/// Limits: noise after the strong motion lengthens it.
/// Check:  `intensity_and_durations_are_those_of_an_independent_implementation`.
/// Source: Trifunac and Brady (1975), A study on the duration of strong earthquake ground motion, BSSA 65, 581–626.
pub fn significant_duration_s(build_up: &[f64], dt_s: f64, shares: [f64; 2]) -> f64 {
    let end = build_up.last().copied().unwrap_or(0.0);
    if end.is_nan() || end <= 0.0 {
        return f64::NAN;
    }
    let [first, last] = shares.map(|share| {
        let level = share * end;
        let i = build_up.partition_point(|v| *v < level);
        if i == 0 {
            return 0.0;
        }
        let [below, above] = [build_up[i - 1], build_up[i]];
        (i - 1) as f64 + (level - below) / (above - below)
    });
    (last - first) * dt_s // (2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::made_up::{DT_S, observed};

    /// `python tests/metrics/vectors.py` with eqsig 1.2.17: `calc_arias_intensity` and `calc_sig_dur_vals`, whose durations are
    /// whole steps.
    #[test]
    fn intensity_and_durations_are_those_of_an_independent_implementation() {
        let build_up = arias_build_up_m_s(&observed(), DT_S);
        let end = build_up[build_up.len() - 1];
        assert!((end / 0.33865272295932564 - 1.0).abs() < 1e-3, "{end}");
        for (shares, expected_s) in [([0.05, 0.95], 5.08), ([0.05, 0.75], 3.68)] {
            let got_s = significant_duration_s(&build_up, DT_S, shares);
            assert!((got_s - expected_s).abs() <= 1.01 * DT_S, "{got_s} {expected_s}");
        }
    }

    #[test]
    fn a_constant_acceleration_builds_up_evenly() {
        let build_up = arias_build_up_m_s(&[2.0; 101], 0.1);
        assert!((build_up[100] / (PI / (2.0 * G_M_S2) * 40.0) - 1.0).abs() < 1e-12);
        assert!((significant_duration_s(&build_up, 0.1, [0.05, 0.95]) - 9.0).abs() < 1e-9);
        assert!(significant_duration_s(&[0.0; 5], 0.1, [0.05, 0.95]).is_nan());
        assert!(significant_duration_s(&[], 0.1, [0.05, 0.95]).is_nan());
    }
}
