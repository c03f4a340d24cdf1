//! What a layered column does to first order in frequency.

use crate::column::{Layer, Profile};
use std::f64::consts::TAU;

/// Time of a shear wave from the surface to `depth_m`, s.
pub fn travel_s(profile: &Profile, depth_m: f64) -> f64 {
    let mut top_m = 0.0;
    let of = |layer: &Layer| {
        let own = (depth_m - top_m).clamp(0.0, layer.thickness_m);
        top_m += layer.thickness_m;
        own / layer.vs_m_s
    };
    profile.layers.iter().map(of).sum()
}

/// ∫_z^H m(z')/G(z') dz' · (2π)² at depth z = `depth_m`, m the mass above z': the first order of the transfer function in f².
pub fn first_order_s2(profile: &Profile, depth_m: f64) -> f64 {
    let (mut top_m, mut mass, mut sum) = (0.0, 0.0, 0.0);
    for layer in &profile.layers {
        let (h, rho) = (layer.thickness_m, layer.density_kg_m3);
        let above = (depth_m - top_m).clamp(0.0, h);
        let from = mass + rho * above;
        sum += 0.5 * (h - above) * (from + mass + rho * h) / (rho * layer.vs_m_s.powi(2));
        mass += rho * h;
        top_m += h;
    }
    TAU * TAU * sum
}
