//! The column as a linear analysis sees it: masses, heights, viscous damping, and the law of each element at rest.

use super::{Column, Structure};
use crate::soil::{Law, Relaxation};

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

    /// The structure on the surface.
    pub fn structure(&self) -> Structure {
        self.mesh.structure
    }
}
