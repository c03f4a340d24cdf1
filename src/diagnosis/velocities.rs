//! Shear-wave velocities of a profile, at a depth and as the mean of a range.

use crate::column::Profile;

/// Velocity of the layer at `depth_m`, m/s.
pub fn velocity(profile: &Profile, depth_m: f64) -> f64 {
    let mut bottom_m = 0.0;
    let layer = profile.layers.iter().find(|layer| {
        bottom_m += layer.thickness_m;
        depth_m < bottom_m
    });
    layer.or(profile.layers.last()).map_or(f64::NAN, |l| l.vs_m_s)
}

/// ln of the velocity that has the mean of 1/v² over a range.
pub fn ln_velocity(profile: &Profile, [top_m, bottom_m]: [f64; 2]) -> f64 {
    let mut at_m = 0.0;
    let mut sum = 0.0;
    for layer in &profile.layers {
        let inside = (bottom_m.min(at_m + layer.thickness_m) - top_m.max(at_m)).max(0.0);
        sum += inside / (layer.vs_m_s * layer.vs_m_s);
        at_m += layer.thickness_m;
    }
    -0.5 * (sum / (bottom_m - top_m)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::Layer;

    #[test]
    fn a_seam_counts_by_its_compliance() {
        let layer = |thickness_m: f64, vs_m_s: f64| Layer::plain("elastic", thickness_m, 2000.0, vs_m_s);
        let layers = vec![layer(0.75, 100.0), layer(0.25, 50.0), layer(2.0, 300.0)];
        let profile = Profile::plain(layers);
        let slow = 0.75 / 100.0f64.powi(2) + 0.25 / 50.0f64.powi(2);
        assert!((ln_velocity(&profile, [0.0, 1.0]) - (1.0 / slow.sqrt()).ln()).abs() < 1e-12);
        assert_eq!((velocity(&profile, 0.9), velocity(&profile, 9.0)), (50.0, 300.0));
    }
}
