//! Shear-wave velocities as few modes over depth.

use super::algebra;
use crate::effects::Array;
use faer::{Mat, Side};

/// Prior standard deviation of the ln of all shear-wave velocities together: dispersion of mesh and time step.
pub const COMMON_VELOCITY_LN: f64 = 0.01;
/// Depth modes of ln Vs that are shared by the intervals between sensors, and the least of each.
const MODES: [usize; 2] = [9, 3];
/// Most depth ranges with a velocity of their own.
const MAX_RANGES: usize = 20;

/// Depths between which velocities move together, m: the layers, or ranges of equal travel time where there are too many.
pub fn ranges(array: &Array) -> Vec<f64> {
    let layers = &array.profile.layers;
    let travel_s = array.profile.travel_time_s();
    let (mut depth_m, mut passed_s) = (0.0, 0.0);
    let mut cuts = vec![0.0];
    for (i, layer) in layers.iter().enumerate() {
        depth_m += layer.thickness_m;
        passed_s += layer.thickness_m / layer.vs_m_s;
        let is_due = passed_s >= travel_s * cuts.len() as f64 / MAX_RANGES as f64;
        if layers.len() <= MAX_RANGES || is_due || i + 1 == layers.len() {
            cuts.push(depth_m);
        }
    }
    cuts
}

/// Depth modes of ln Vs: between every two sensors polynomials of the range's place in order, of as low a degree as the array
/// resolves, with the prior of independent layers and a common factor carried over.
///
/// ```text
/// ln f = B a,   K = σ² I + σ_c² 1 1ᵀ,   cov(a) = (Bᵀ K⁻¹ B)⁻¹ = L Lᵀ,   modes = B L                 (1)
/// ```
///
/// Check: `modes_carry_the_prior_of_layers`.
pub fn modes(array: &Array, cuts_m: &[f64], vs_ln: f64) -> Vec<Vec<f64>> {
    let n = cuts_m.len() - 1;
    let middles: Vec<f64> = cuts_m.windows(2).map(|p| 0.5 * (p[0] + p[1])).collect();
    let sensors = array.cuts_m();
    let interval = |z: f64| sensors.windows(2).position(|p| z < p[1]).unwrap_or(sensors.len() - 2);
    let n_interval = sensors.len() - 1;
    let most = (MODES[0] / n_interval.max(1)).max(MODES[1]);
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for k in 0..n_interval {
        let own: Vec<usize> = (0..n).filter(|i| interval(middles[*i]) == k).collect();
        let m = own.len();
        for degree in 0..m.min(most) {
            let mut column = vec![0.0; n];
            // Discrete cosines are orthogonal over the ranges of an interval.
            let at = |j: usize| (std::f64::consts::PI * degree as f64 * (j as f64 + 0.5) / m as f64).cos();
            own.iter().enumerate().for_each(|(j, i)| column[*i] = at(j));
            columns.push(column);
        }
    }
    if columns.is_empty() || vs_ln <= 0.0 {
        return vec![Vec::new(); n];
    }
    let b = Mat::from_fn(n, columns.len(), |i, j| columns[j][i]);
    let k =
        Mat::from_fn(n, n, |i, j| COMMON_VELOCITY_LN * COMMON_VELOCITY_LN + if i == j { vs_ln * vs_ln } else { 0.0 });
    let (Some(inverse), m) = (algebra::inverse(&k), columns.len()) else { return vec![Vec::new(); n] };
    let precision = b.transpose() * &inverse * &b;
    // With precision = C Cᵀ, L = C⁻ᵀ.
    let Ok(factor) = precision.llt(Side::Lower) else { return vec![Vec::new(); n] };
    let c = factor.L().to_owned();
    let mut l = Mat::<f64>::zeros(m, m);
    for column in 0..m {
        // Solves Cᵀ x = e_column from the end.
        for i in (0..m).rev() {
            let rest: f64 = (i + 1..m).map(|j| c[(j, i)] * l[(j, column)]).sum();
            l[(i, column)] = (f64::from(u8::from(i == column)) - rest) / c[(i, i)];
        }
    }
    let scaled = &b * &l;
    (0..n).map(|i| (0..m).map(|j| scaled[(i, j)]).collect()).collect()
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Truth, problem};
    use super::*;
    use crate::column::Layer;

    #[test]
    fn modes_carry_the_prior_of_layers() {
        let mut array = problem(&Truth::default()).array;
        // Two ranges above each sensor and below the last: as many modes as ranges.
        let layers = [6.0, 14.0, 8.0, 12.0].map(|thickness_m| Layer::plain("elastic", thickness_m, 2000.0, 200.0));
        array.profile.layers = layers.into();
        let cuts_m = ranges(&array);
        assert_eq!(cuts_m, [0.0, 6.0, 20.0, 28.0, 40.0]);
        let vs_ln = 0.1;
        let modes = modes(&array, &cuts_m, vs_ln);
        for i in 0..4 {
            for j in 0..4 {
                let found: f64 = modes[i].iter().zip(&modes[j]).map(|(a, b)| a * b).sum();
                let expected = COMMON_VELOCITY_LN.powi(2) + if i == j { vs_ln * vs_ln } else { 0.0 };
                assert!((found - expected).abs() < 1e-9, "{i} {j}: {found} {expected}");
            }
        }
    }
}
