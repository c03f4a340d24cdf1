//! From a profile to elements in geostatic equilibrium.

use super::{Analysis, Profile, Vertical};
use crate::error::{Error, Result};
use crate::soil::{self, Material, Point};
use crate::units::G_M_S2;

/// Density of water, kg/m³.
const WATER_KG_M3: f64 = 1000.0;

/// Effective stress never starts below that of this much soil, m: a law needs some confinement.
const MIN_COVER_M: f64 = 0.02;

/// A soil column, ready to run motions. One value serves all threads.
pub struct Column {
    pub(super) analysis: Analysis,
    pub(super) vertical: Vertical,
    /// Elements from the surface down.
    pub(super) elements: Vec<Element>,
    /// Lumped mass of each node per unit area, kg/m².
    pub(super) mass_kg_m2: Vec<f64>,
    /// Mass-proportional damping of each node, kg/(m² s).
    pub(super) mass_damping: Vec<f64>,
    remarks: Vec<LayerRemark>,
}

/// What a law says of one layer.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerRemark {
    /// Depth of the element in the middle of the layer, m.
    pub depth_m: f64,
    /// The law's remark there.
    pub remark: String,
}

/// One element.
pub(super) struct Element {
    pub height_m: f64,
    pub centre_m: f64,
    pub material: Box<dyn Material>,
    /// Stiffness of the pore water against volume change, Pa; zero above the water table.
    pub water_pa: f64,
    /// Stiffness-proportional damping, s.
    pub beta_s: f64,
    /// Tangent at the geostatic state, pore water included, Pa.
    pub initial_pa: [[f64; 2]; 2],
    /// Where its state starts in the column's state vector, and how long it is.
    pub state: std::ops::Range<usize>,
}

impl Column {
    /// Meshes `profile` and puts it into geostatic equilibrium.
    ///
    /// Element boundaries lie on layer boundaries; each layer gets elements in proportion to its thickness, at least one.
    ///
    /// # Errors
    /// When a law is unknown, a parameter is out of range, or there are fewer elements than layers.
    pub fn new(profile: &Profile, analysis: &Analysis) -> Result<Self> {
        let counts = elements_per_layer(profile)?;
        let mut elements = Vec::with_capacity(profile.elements);
        let mut damping_ratio = Vec::with_capacity(profile.elements);
        let mut remarks = Vec::new();
        let mut top_m = 0.0;
        let mut overburden_pa = 0.0;
        let mut n_state = 0;
        for (number, (layer, count)) in profile.layers.iter().zip(counts).enumerate() {
            let place = |e: Error| e.at(format!("layer {} of the profile", number + 1));
            let law = soil::build(&layer.law_kind, &layer.law).map_err(place)?;
            let height_m = layer.thickness_m / count as f64;
            for i in 0..count {
                let centre_m = top_m + (i as f64 + 0.5) * height_m;
                let weight_pa = layer.density_kg_m3 * G_M_S2 * height_m;
                let submerged_m = profile.water_table_m.map_or(0.0, |w| (centre_m - w).max(0.0));
                let effective = overburden_pa + 0.5 * weight_pa - WATER_KG_M3 * G_M_S2 * submerged_m;
                let point = Point {
                    depth_m: centre_m,
                    density_kg_m3: layer.density_kg_m3,
                    vs_m_s: layer.vs_m_s,
                    vertical_effective_stress_pa: effective.max(layer.density_kg_m3 * G_M_S2 * MIN_COVER_M),
                    k0: layer.k0,
                };
                let material = law.at(&point).map_err(place)?;
                if i == count / 2
                    && let Some(remark) = material.remark()
                {
                    remarks.push(LayerRemark { depth_m: centre_m, remark });
                }
                let is_saturated = profile.water_table_m.is_some_and(|w| centre_m > w);
                let porosity = material.void_ratio() / (1.0 + material.void_ratio());
                let water_pa = if is_saturated { material.water_bulk_modulus_pa() / porosity } else { 0.0 };
                let mut initial_pa = material.initial_tangent_pa();
                initial_pa[1][1] += water_pa;
                damping_ratio.push(material.small_strain_damping());
                let state = n_state..n_state + material.n_state();
                n_state = state.end;
                elements.push(Element { height_m, centre_m, material, water_pa, beta_s: profile.rayleigh.beta_s, initial_pa, state });
                overburden_pa += weight_pa;
            }
            top_m += layer.thickness_m;
        }
        let densities = profile.layers.iter().zip(elements_per_layer(profile)?);
        let densities: Vec<f64> = densities.flat_map(|(l, count)| std::iter::repeat_n(l.density_kg_m3, count)).collect();
        let mut mass_kg_m2 = vec![0.0; elements.len() + 1];
        let mut mass_damping = vec![0.0; elements.len() + 1];
        let (alpha_1_s, beta_s) = unit_damping(&elements, &densities);
        for (i, element) in elements.iter_mut().enumerate() {
            let half = 0.5 * densities[i] * element.height_m;
            let alpha = profile.rayleigh.alpha_1_s + damping_ratio[i] * alpha_1_s;
            element.beta_s += damping_ratio[i] * beta_s;
            for node in [i, i + 1] {
                mass_kg_m2[node] += half;
                mass_damping[node] += alpha * half;
            }
        }
        Ok(Self { analysis: analysis.clone(), vertical: profile.vertical, elements, mass_kg_m2, mass_damping, remarks })
    }

    /// Depths of the element centres, surface down, m: where the response is given.
    pub fn channel_depths_m(&self) -> Vec<f64> {
        self.elements.iter().map(|e| e.centre_m).collect()
    }

    /// Depth of the base, m.
    pub fn depth_m(&self) -> f64 {
        self.elements.iter().map(|e| e.height_m).sum()
    }

    /// What the laws remark of their layers, surface down.
    pub fn remarks(&self) -> &[LayerRemark] {
        &self.remarks
    }

    /// Fundamental shear frequency at small strain on a rigid base, Hz.
    pub fn fundamental_frequency_hz(&self) -> f64 {
        fundamental_rad_s(&self.elements, &self.mass_kg_m2) / std::f64::consts::TAU
    }
}

fn elements_per_layer(profile: &Profile) -> Result<Vec<usize>> {
    let n_layer = profile.layers.len();
    if n_layer == 0 || profile.elements < n_layer {
        let what = format!("a profile of {n_layer} layers needs at least as many elements, got {}", profile.elements);
        return Err(Error::new(what).hint("raise `site.elements`").usage());
    }
    let depth_m = profile.depth_m();
    let mut counts = vec![1usize; n_layer];
    // One at a time to the layer with the thickest elements: boundaries stay on layers and heights as even as can be.
    for _ in n_layer..profile.elements {
        let height = |i: usize| profile.layers[i].thickness_m / counts[i] as f64;
        let thickest = (0..n_layer).max_by(|a, b| height(*a).total_cmp(&height(*b)).then(b.cmp(a)));
        if let Some(i) = thickest {
            counts[i] += 1;
        }
    }
    debug_assert!(depth_m > 0.0);
    Ok(counts)
}

/// Rayleigh coefficients that give a damping of one at the first and about one up to five times the first frequency.
fn unit_damping(elements: &[Element], densities: &[f64]) -> (f64, f64) {
    let mut mass = vec![0.0; elements.len() + 1];
    for (i, element) in elements.iter().enumerate() {
        mass[i] += 0.5 * densities[i] * element.height_m;
        mass[i + 1] += 0.5 * densities[i] * element.height_m;
    }
    let first = fundamental_rad_s(elements, &mass);
    let second = 5.0 * first;
    (2.0 * first * second / (first + second), 2.0 / (first + second))
}

/// First eigenfrequency in shear by inverse iteration.
fn fundamental_rad_s(elements: &[Element], mass: &[f64]) -> f64 {
    let n = elements.len();
    let mut shape: Vec<f64> = (0..n).map(|i| 1.0 - i as f64 / n as f64).collect();
    let mut omega_squared = 0.0;
    for _ in 0..60 {
        // With forces m φ the shear force below node i is their running sum, and displacements add up from the base.
        let mut shear = 0.0;
        let forces: Vec<f64> = shape.iter().zip(mass).map(|(s, m)| s * m).collect();
        let slopes: Vec<f64> = elements
            .iter()
            .zip(&forces)
            .map(|(e, f)| {
                shear += f;
                shear * e.height_m / e.initial_pa[0][0]
            })
            .collect();
        let mut displacement = 0.0;
        let mut next = vec![0.0; n];
        for i in (0..n).rev() {
            displacement += slopes[i];
            next[i] = displacement;
        }
        let numerator: f64 = next.iter().zip(&forces).map(|(x, f)| x * f).sum();
        let denominator: f64 = next.iter().zip(mass).map(|(x, m)| x * x * m).sum();
        omega_squared = numerator / denominator;
        let norm = next[0];
        shape = next.into_iter().map(|x| x / norm).collect();
    }
    omega_squared.sqrt()
}
