//! The column in the frequency domain, at moduli and damping compatible with its strains.

mod march;

use super::curves::{Curve, Curves};
use super::surroundings::Surroundings;
use crate::column::{Analysis, Column, Downgoing, Features, Profile, Slice, Structure};
use crate::error::Result;
use crate::soil::{Point, Rate, Relaxation, Softening};
pub use march::{March, Nodes, Wanted};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Elements in the wave length of the highest frequency.
const PER_WAVE: f64 = 18.0;
/// Most elements.
const MAX_ELEMENTS: usize = 120;
/// Places of a layer at which its curve is measured, at most.
const PLACES: usize = 3;

/// Equivalent-linear elements with the mean of lumped and consistent mass, of which waves are as fast as in the soil but for
/// (kh)⁴/480.
///
/// With total displacement U and base motion u_g, from the free surface down over nodes i and elements i,
///
/// ```text
/// τ_i = τ_{i−1} − (ω² m_i − iω c_i) U_i − iω c_i u_g                      (1)
/// γ_i = τ_i / (G_i (1 + 2i D_i) K_i + iω β_i G₀_i + ω² ρ_i h_i²/12),   U_{i+1} = U_i + h_i γ_i   (2)
/// U = a U_h + u_g U_p,   a = u_g (1 − U_p(H)) / U_h(H),   or −u_g τ_p/τ_h below a compliant base's node   (3)
/// ```
///
/// m_i lumped, what is consistent in the mass being the last term of (2), K_i of [`Relaxation`], 1 for laws that have their
/// small-strain damping in β and c alone, and where U_h starts with (1, 0) and no source and U_p with (0, 0) and the source of
/// (1). Everything marched is a smooth function of frequency, resonances appear in (3) only; so the march needs a coarse grid.
///
/// Limits: one modulus and damping per element and motion, the effective strain's; no permanent strain.
/// Check:  the tests below against the exact layered column and against the nonlinear column in weak motion.
/// Source: Idriss and Sun (1992), SHAKE91; Hughes (2000), The Finite Element Method, section 7.3.2, for the mass.
#[derive(Debug, Clone, PartialEq)]
pub struct EquivalentColumn {
    elements: Vec<Element>,
    mass: Vec<f64>,
    damping: Vec<f64>,
    structure: Structure,
    downgoing: Option<Arc<Downgoing>>,
    depth_m: f64,
    travel_s: f64,
    is_dispersive: bool,
}

#[derive(Debug, Clone, PartialEq)]
struct Element {
    height_m: f64,
    depth_m: f64,
    shear_modulus_pa: f64,
    container_pa: f64,
    beta_s: f64,
    /// ρ h²/12 of (2), kg/m.
    inertia_kg_m: f64,
    relaxation: Option<Relaxation>,
    curve: Curve,
}

/// Elements that the declared `profile` needs up to `high_hz`.
pub fn element_count(profile: &Profile, high_hz: f64) -> usize {
    let needed = profile.layers.iter().zip(profile.shares()).map(|(l, share)| {
        let height_m = l.vs_m_s / (PER_WAVE * high_hz);
        if l.thickness_m <= 1.5 * height_m { 1.0 } else { (l.thickness_m / (height_m * share) - 1e-9).ceil() }
    });
    (needed.fold(1.0, f64::max) as usize).clamp(profile.layers.len(), MAX_ELEMENTS.max(profile.layers.len()))
}

/// What of `features` surrounds the law of `slice`, of kind `law_kind`.
fn surroundings(features: &Features, law_kind: &str, slice: &Slice<'_>) -> Option<Surroundings> {
    let (softenings, rates) = (&features.softenings, &features.rates);
    let inside = |top: f64, bottom: f64| (top..bottom).contains(&slice.depth_m);
    let range = slice.depth_m - 0.5 * slice.height_m..slice.depth_m + 0.5 * slice.height_m;
    let softenings = softenings.iter().filter(|z| z.ru_at_reference > 0.0 && inside(z.top_m, z.bottom_m));
    let rates = rates.iter().filter(|z| {
        z.per_log_cycle > 0.0 && inside(z.top_m, z.bottom_m) && z.law_kind.as_deref().is_none_or(|k| k == law_kind)
    });
    let slips = features.slips.iter().filter(|s| range.contains(&s.depth_m));
    let found = Surroundings {
        softenings: softenings
            .map(|z| Softening { ru_at_reference: z.ru_at_reference, exponent: z.exponent })
            .collect(),
        rates: rates.map(|z| Rate { per_log_cycle: z.per_log_cycle }).collect(),
        tau_max_pa: slips.map(|s| s.tau_max_pa).reduce(f64::min),
        vertical_pa: slice.vertical_pa,
        shear_modulus_pa: slice.shear_modulus_pa,
    };
    let is_plain = found.softenings.is_empty() && found.rates.is_empty() && found.tau_max_pa.is_none();
    (!is_plain).then_some(found)
}

impl EquivalentColumn {
    /// Sets up `profile` with about `elements` elements.
    ///
    /// # Errors
    /// When the profile or a law is out of range.
    pub fn new(profile: &Profile, elements: usize, curves: &Curves) -> Result<Self> {
        let coarse = Profile { elements: elements.max(profile.layers.len()), ..profile.clone() };
        let column = Column::new(&coarse, &Analysis::default())?;
        let mut out = Vec::with_capacity(coarse.elements);
        let (mut layer, mut top_m) = (0, 0.0);
        let mut latest: Option<(usize, usize, Curve)> = None;
        for slice in column.slices() {
            while layer + 1 < coarse.layers.len() && slice.depth_m > top_m + coarse.layers[layer].thickness_m {
                top_m += coarse.layers[layer].thickness_m;
                layer += 1;
            }
            let declared = &coarse.layers[layer];
            let places = ((declared.thickness_m / (0.04 * coarse.depth_m())) as usize).clamp(1, PLACES);
            let place = ((slice.depth_m - top_m) / declared.thickness_m * places as f64) as usize;
            let curve = match &latest {
                Some((l, p, curve)) if (*l, *p) == (layer, place) => curve.clone(),
                _ => {
                    let point = Point {
                        depth_m: slice.depth_m,
                        density_kg_m3: declared.density_kg_m3,
                        vs_m_s: declared.vs_m_s,
                        vertical_pa: slice.vertical_pa,
                        horizontal_pa: declared.k0 * slice.vertical_pa,
                    };
                    curves.of(declared, &point, slice.pore_pa, coarse.vertical)
                }
            };
            latest = Some((layer, place, curve.clone()));
            let curve = curve.surrounded(surroundings(&coarse.features, &declared.law_kind, &slice));
            out.push(Element {
                height_m: slice.height_m,
                depth_m: slice.depth_m,
                shear_modulus_pa: slice.shear_modulus_pa,
                container_pa: slice.container_pa,
                beta_s: slice.beta_s,
                inertia_kg_m: declared.density_kg_m3 * slice.height_m * slice.height_m / 12.0,
                relaxation: slice.relaxation,
                curve,
            });
        }
        Ok(Self {
            elements: out,
            mass: column.node_mass_kg_m2(),
            damping: column.node_damping_kg_m2_s(),
            structure: column.structure(),
            downgoing: column.downgoing(),
            depth_m: coarse.depth_m(),
            travel_s: coarse.travel_time_s(),
            is_dispersive: true,
        })
    }

    /// The same column with moduli G (1 + i Im K/Re K) that do not grow with frequency, as frequency-domain programs have
    /// them: what differs between both is a convention of how damping is idealised and no property of a site.
    #[must_use]
    pub fn without_dispersion(self) -> Self {
        Self { is_dispersive: false, ..self }
    }

    /// Number of elements.
    pub fn n_element(&self) -> usize {
        self.elements.len()
    }

    /// Secant shear modulus over the small-strain one and damping ratio, small-strain damping included, of the element around `depth_m` at
    /// the strain amplitude `gamma` and `frequency_hz`.
    pub fn modulus_and_damping(&self, depth_m: f64, gamma: f64, frequency_hz: f64) -> (f64, f64) {
        let nearest = |e: &&Element| (e.depth_m - depth_m).abs();
        let Some(element) = self.elements.iter().min_by(|a, b| nearest(a).total_cmp(&nearest(b))) else {
            return (1.0, 0.0);
        };
        let (modulus, hysteretic) = element.curve.at(gamma);
        let [re, im] = element.relaxation.map_or([1.0, 0.0], |relaxation| relaxation.modulus(frequency_hz));
        // A dashpot keeps its strength while the secant modulus falls.
        let viscous = 0.5 * element.beta_s * TAU * frequency_hz / (modulus * re).max(f64::MIN_POSITIVE);
        (modulus, hysteretic + 0.5 * im / re + viscous)
    }

    /// Frequency step that resolves what is marched, Hz.
    pub fn grid_step_hz(&self) -> f64 {
        (0.03 / self.travel_s).min(0.125)
    }
}
