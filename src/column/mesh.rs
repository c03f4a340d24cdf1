//! Elements, nodal masses, the geostatic state, and the laws started from it.

use super::{Profile, Vertical};
use crate::error::Result;
use crate::registry;
use crate::soil::{LAWS, Law, Point};
use crate::units::G_M_S2;
use std::f64::consts::TAU;
use std::ops::Range;

const WATER_KG_M3: f64 = 1000.0;

/// One element and its integration point.
pub(super) struct Element {
    pub depth_m: f64,
    pub height_m: f64,
    /// Vertical effective stress before shaking, compression positive.
    pub vertical_pa: f64,
    /// Elastic tangent at the geostatic state.
    pub elastic_pa: [f64; 4],
    /// Bulk stiffness of the pore water; 0 above the water table.
    pub pore_pa: f64,
    /// Stiffness-proportional damping, s.
    pub beta_s: f64,
}

/// Neighbouring elements of one law, with their geostatic memory point after point.
pub(super) struct Stretch {
    pub elements: Range<usize>,
    pub law: Box<dyn Law>,
    pub start: Vec<f64>,
}

/// The discretised column.
pub(super) struct Mesh {
    pub elements: Vec<Element>,
    pub stretches: Vec<Stretch>,
    /// Lumped mass per area of the nodes above the base, kg/m².
    pub mass: Vec<f64>,
    /// Mass-proportional damping of the same nodes, kg/(m² s).
    pub mass_damping: Vec<f64>,
    pub is_restrained: bool,
    pub frequency_hz: f64,
}

impl Mesh {
    pub fn new(profile: &Profile) -> Result<Self> {
        let counts = elements_per_layer(profile);
        let travel_s: f64 = profile.layers.iter().map(|l| l.thickness_m / l.vs_m_s).sum();
        let frequency_hz = 1.0 / (4.0 * travel_s);
        let mut mesh = Self {
            elements: Vec::with_capacity(profile.elements),
            stretches: Vec::new(),
            mass: vec![0.0; profile.elements],
            mass_damping: vec![0.0; profile.elements],
            is_restrained: profile.vertical == Vertical::Restrained,
            frequency_hz,
        };
        let mut top_m = 0.0;
        let mut total_pa = 0.0; // total vertical stress at the element's top
        for (i, (layer, count)) in profile.layers.iter().zip(counts).enumerate() {
            let is_new =
                i == 0 || profile.layers[i - 1].law_kind != layer.law_kind || profile.layers[i - 1].law != layer.law;
            if is_new {
                let place = || format!("layer {} from the surface", i + 1);
                let law = registry::find("soil law", LAWS, &layer.law_kind)
                    .and_then(|entry| (entry.build)(layer.law.clone()))
                    .map_err(|e| e.at(place()))?;
                let n = mesh.elements.len();
                mesh.stretches.push(Stretch { elements: n..n, law, start: Vec::new() });
            }
            let height_m = layer.thickness_m / count as f64;
            let mass = layer.density_kg_m3 * height_m;
            for _ in 0..count {
                let depth_m = top_m + 0.5 * height_m;
                let hydrostatic = WATER_KG_M3 * G_M_S2 * (depth_m - profile.water_table_m).max(0.0);
                let vertical_pa = total_pa + 0.5 * mass * G_M_S2 - hydrostatic;
                let point = Point {
                    depth_m,
                    density_kg_m3: layer.density_kg_m3,
                    vs_m_s: layer.vs_m_s,
                    vertical_pa,
                    horizontal_pa: layer.k0 * vertical_pa,
                };
                mesh.push(profile, &point, height_m).map_err(|e| e.at(format!("layer {} from the surface", i + 1)))?;
                total_pa += mass * G_M_S2;
                top_m += height_m;
            }
        }
        Ok(mesh)
    }

    fn push(&mut self, profile: &Profile, point: &Point, height_m: f64) -> Result<()> {
        let i = self.elements.len();
        let stretch = self.stretches.last_mut().expect("a stretch begins before its elements");
        stretch.elements.end = i + 1;
        let n_state = stretch.law.n_state();
        let at = stretch.start.len();
        stretch.start.resize(at + n_state, 0.0);
        let elastic_pa = stretch.law.start(point, &mut stretch.start[at..])?;
        // Rayleigh damping that gives the law's ratio at f and 5 f of the column.
        let (w1, w2) = (TAU * self.frequency_hz, 5.0 * TAU * self.frequency_hz);
        let ratio = stretch.law.damping_ratio(point);
        let alpha_1_s = profile.rayleigh.alpha_1_s + 2.0 * ratio * w1 * w2 / (w1 + w2);
        let half = 0.5 * point.density_kg_m3 * height_m;
        for node in i..(i + 2).min(self.mass.len()) {
            self.mass[node] += half;
            self.mass_damping[node] += half * alpha_1_s;
        }
        self.elements.push(Element {
            depth_m: point.depth_m,
            height_m,
            vertical_pa: point.vertical_pa,
            elastic_pa,
            pore_pa: if point.depth_m > profile.water_table_m { stretch.law.pore_stiffness_pa() } else { 0.0 },
            beta_s: profile.rayleigh.beta_s + 2.0 * ratio / (w1 + w2),
        });
        Ok(())
    }
}

/// Elements by thickness, at least one a layer, largest remainders first; the sum is `profile.elements`.
fn elements_per_layer(profile: &Profile) -> Vec<usize> {
    let spare = (profile.elements - profile.layers.len()) as f64;
    let share: Vec<f64> = profile.layers.iter().map(|l| l.thickness_m / profile.depth_m()).collect();
    let wanted: Vec<f64> = share.iter().map(|s| (s * profile.elements as f64 - 1.0).max(0.0)).collect();
    let scale = spare / wanted.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let exact: Vec<f64> = wanted.iter().map(|w| w * scale).collect();
    let mut counts: Vec<usize> = exact.iter().map(|x| 1 + (x + 1e-9).floor() as usize).collect();
    let mut order: Vec<usize> = (0..counts.len()).collect();
    order.sort_by(|a, b| {
        let rest = |i: &usize| (exact[*i] + 1e-9).fract();
        rest(b).total_cmp(&rest(a)).then(a.cmp(b))
    });
    let missing = profile.elements.saturating_sub(counts.iter().sum());
    for i in order.iter().cycle().take(missing) {
        counts[*i] += 1;
    }
    counts
}
