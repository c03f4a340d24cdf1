//! What a motion does over the depth of a column: largest acceleration, strain, stress and pore pressure, and the loop where strain is largest.

use crate::column::{Column, Frame};
use crate::error::{Error, Result};
use crate::numerics::resample::resample_band_limited;

/// Largest absolute values over a motion, element by element, surface down.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DepthProfile {
    /// Depths of the element centres, m.
    pub depth_m: Vec<f64>,
    /// Acceleration, m/s².
    pub acceleration_m_s2: Vec<f64>,
    /// Shear strain.
    pub gamma: Vec<f64>,
    /// Shear stress, Pa.
    pub tau_pa: Vec<f64>,
    /// Excess pore pressure over the vertical effective stress before the motion.
    pub pore_ratio: Vec<f64>,
    /// Element with the largest strain.
    pub weakest: usize,
    /// Times of the histories, s.
    pub time_s: Vec<f64>,
    /// History of each element.
    pub histories: Vec<ElementHistory>,
}

/// One element over a motion, in single precision: enough to draw, and a long motion of many elements fits into memory.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ElementHistory {
    /// Shear strain.
    pub gamma: Vec<f32>,
    /// Shear stress, Pa.
    pub tau_pa: Vec<f32>,
    /// Excess pore pressure, Pa.
    pub excess_pore_pa: Vec<f32>,
}

impl DepthProfile {
    /// Of `column` under a base motion, m/s² every `dt_s`, at least as fine as `output_step_s`.
    ///
    /// # Errors
    /// When the column cannot finish the motion.
    pub fn of(column: &Column, acceleration_m_s2: &[f64], dt_s: f64, output_step_s: f64) -> Result<Self> {
        let step_s = dt_s.min(output_step_s);
        let base = resample_band_limited(acceleration_m_s2, dt_s, step_s);
        let depth_m = column.channel_depths_m();
        let n = depth_m.len();
        let mut found = Self {
            acceleration_m_s2: vec![0.0; n],
            gamma: vec![0.0; n],
            tau_pa: vec![0.0; n],
            pore_ratio: vec![0.0; n],
            histories: vec![ElementHistory::default(); n],
            depth_m,
            ..Self::default()
        };
        let before_pa = column.vertical_effective_stress_pa();
        let mut read = |frame: &Frame<'_>| {
            let largest = |into: &mut [f64], from: &[f64]| {
                into.iter_mut().zip(from).for_each(|(m, v)| *m = m.max(v.abs()));
            };
            largest(&mut found.acceleration_m_s2, frame.elements_m_s2);
            largest(&mut found.gamma, frame.gamma);
            largest(&mut found.tau_pa, frame.tau_pa);
            found.time_s.push(frame.time_s);
            for (i, history) in found.histories.iter_mut().enumerate() {
                found.pore_ratio[i] = found.pore_ratio[i].max(frame.excess_pore_pa[i] / before_pa[i].max(1.0));
                history.gamma.push(frame.gamma[i] as f32);
                history.tau_pa.push(frame.tau_pa[i] as f32);
                history.excess_pore_pa.push(frame.excess_pore_pa[i] as f32);
            }
            Ok(())
        };
        column.run(step_s, &base, &mut read).map_err(|failure| Error::new(failure.to_string()))?;
        found.weakest = (0..n).max_by(|a, b| found.gamma[*a].total_cmp(&found.gamma[*b])).unwrap_or(0);
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::{Analysis, Layer, Profile};

    /// Slow shaking moves an elastic column as a body: stress is what the mass above needs, strain is stress over modulus.
    #[test]
    fn slow_motion_is_carried_by_the_stress_of_the_mass_above() {
        let layer: Layer = toml::from_str(
            "thickness_m = 20.0\nvs_m_s = 200.0\ndensity_kg_m3 = 2000.0\nk0 = 0.5\nlaw_kind = 'elastic'\n[law]\n",
        )
        .unwrap();
        let profile = Profile {
            layers: vec![layer],
            water_table_m: 20.0,
            vertical: Default::default(),
            rayleigh: Default::default(),
            elements: 20,
            features: Default::default(),
        };
        let analysis = Analysis::default();
        let column = Column::new(&profile, &analysis).unwrap();
        let base: Vec<f64> = (0..4000)
            .map(|i| f64::from(i) * 0.01)
            .map(|t| 0.5 * (0.1 * std::f64::consts::TAU * t).sin() * (t / 10.0).min(1.0))
            .collect();
        let found = DepthProfile::of(&column, &base, 0.01, analysis.output_step_s).unwrap();
        let modulus_pa = 2000.0 * 200.0 * 200.0;
        for (i, depth_m) in found.depth_m.iter().enumerate() {
            let stress_pa = 2000.0 * depth_m * 0.5;
            assert!(
                (found.acceleration_m_s2[i] / 0.5 - 1.0).abs() < 0.02,
                "{depth_m} m: {}",
                found.acceleration_m_s2[i]
            );
            assert!((found.tau_pa[i] / stress_pa - 1.0).abs() < 0.03, "{depth_m} m: {} Pa", found.tau_pa[i]);
            assert!((found.gamma[i] * modulus_pa / stress_pa - 1.0).abs() < 0.04, "{depth_m} m: {}", found.gamma[i]);
        }
        assert_eq!(found.weakest, 19);
        assert!(found.pore_ratio.iter().all(|r| *r == 0.0));
        let weakest = &found.histories[19];
        let peak = weakest.gamma.iter().fold(0.0f64, |m, v| m.max(f64::from(v.abs())));
        assert!((peak / found.gamma[19] - 1.0).abs() < 1e-6);
        assert!(weakest.tau_pa.len() == found.time_s.len() && weakest.gamma.len() == found.time_s.len());
    }
}
