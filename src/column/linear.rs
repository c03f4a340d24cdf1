//! The column as a linear analysis sees it: masses, heights, viscous damping, and the law of each element at rest.

use super::{Column, Downgoing, Structure};
use crate::soil::{Law, Relaxation};
use std::f64::consts::TAU;
use std::sync::Arc;

/// One element before shaking.
#[derive(Clone, Copy)]
pub struct Slice<'a> {
    /// Depth of its centre, m.
    pub depth_m: f64,
    /// Height, m.
    pub height_m: f64,
    /// Small-strain shear modulus, Pa.
    pub shear_modulus_pa: f64,
    /// Vertical effective stress, Pa, compression positive.
    pub vertical_pa: f64,
    /// Bulk stiffness of the pore water, Pa; 0 above the water table.
    pub pore_pa: f64,
    /// Shear stiffness of a container in parallel, Pa.
    pub container_pa: f64,
    /// Stiffness-proportional damping, s.
    pub beta_s: f64,
    /// Small-strain damping by memory of the stress.
    pub relaxation: Option<Relaxation>,
    /// Its law.
    pub law: &'a dyn Law,
}

impl Column {
    /// The elements, surface down.
    pub fn slices(&self) -> impl Iterator<Item = Slice<'_>> {
        self.mesh.stretches.iter().flat_map(|stretch| {
            self.mesh.elements[stretch.elements.clone()].iter().map(|e| Slice {
                depth_m: e.depth_m,
                height_m: e.height_m,
                shear_modulus_pa: e.elastic_pa[0],
                vertical_pa: e.vertical_pa,
                pore_pa: e.pore_pa,
                container_pa: e.container_pa,
                beta_s: e.beta_s,
                relaxation: e.relaxation,
                law: stretch.law.as_ref(),
            })
        })
    }

    /// Horizontal mass of the nodes, kg/m², surface down, the base where it is compliant; a container's is in it, a
    /// structure's is not.
    pub fn node_mass_kg_m2(&self) -> Vec<f64> {
        self.mesh.mass.iter().map(|m| m[0]).collect()
    }

    /// Dashpots between the same nodes and the input motion, kg/(m² s).
    pub fn node_damping_kg_m2_s(&self) -> Vec<f64> {
        self.mesh.dashpot.iter().map(|c| c[0]).collect()
    }

    /// Small-strain damping ratio at a frequency, the mean over travel time:
    ///
    /// ```text
    /// ξ = Σ t (ω β + Im K/Re K) / (2 Σ t) + Σ c/(2 ω Σ m),   t = h/√G         (1)
    /// ```
    ///
    /// Limits: hysteresis of laws at small strains is not in it; densities are taken to be alike.
    pub fn small_strain_damping_ratio(&self, frequency_hz: f64) -> f64 {
        let omega = TAU * frequency_hz;
        let (mut lost_s, mut travel_s, mut n) = (0.0, 0.0, 0);
        for slice in self.slices() {
            let time_s = slice.height_m / slice.shear_modulus_pa.sqrt();
            let [re, im] = slice.relaxation.map_or([1.0, 0.0], |r| r.modulus(frequency_hz));
            lost_s += time_s * (omega * slice.beta_s + im / re);
            travel_s += time_s;
            n += 1;
        }
        let sum = |of: &[[f64; 2]]| of.iter().take(n).map(|x| x[0]).sum::<f64>();
        0.5 * (lost_s / travel_s + sum(&self.mesh.dashpot) / (omega * sum(&self.mesh.mass)))
    }

    /// The motion of the base over what is recorded there, where that is another one.
    pub fn downgoing(&self) -> Option<Arc<Downgoing>> {
        self.downgoing.clone()
    }

    /// The structure on the surface.
    pub fn structure(&self) -> Structure {
        self.mesh.structure
    }
}

#[cfg(test)]
mod tests {
    use crate::column::{Analysis, Column, Layer, Profile, Rayleigh};

    #[test]
    fn damping_is_that_of_laws_and_column_together() {
        let law = toml::Table::from_iter([("damping_ratio".to_string(), 0.02.into())]);
        let layer = Layer { law: law.into(), ..Layer::plain("elastic", 20.0, 1900.0, 200.0) };
        let rayleigh = Rayleigh { alpha_1_s: 0.1142, beta_s: 0.000_289_4 };
        let profile = Profile { rayleigh, ..Profile::plain(vec![layer]) };
        let column = Column::new(&profile, &Analysis::default()).unwrap();
        // Rayleigh damping is one per cent at 1 and 10 Hz, and least between.
        for (f, expected) in [(1.0, 0.03), (10.0, 0.03), (3.1623, 0.025_75)] {
            let found = column.small_strain_damping_ratio(f);
            assert!((found / expected - 1.0).abs() < 0.03, "{f} Hz: {found} {expected}");
        }
    }
}
