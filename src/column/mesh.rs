//! Elements, nodal masses, the geostatic state, and the laws started from it.

use super::features::Around;
use super::{Analysis, Profile, Rayleigh, Structure, Vertical};
use crate::error::{Error, Result};
use crate::registry;
use crate::soil::{Damping, LAWS, Law, Point, Relaxation, Response, relaxations};
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
    /// Shear stiffness of a container in parallel.
    pub container_pa: f64,
    /// What the consistent share of its mass has beside its diagonal, horizontal and vertical, kg/m²: it takes up a difference of the
    /// accelerations of its two nodes.
    pub coupling_kg_m2: [f64; 2],
    /// Stiffness-proportional damping, s.
    pub beta_s: f64,
    /// Small-strain damping by memory of the stress; the law of the element has it built in.
    pub relaxation: Option<Relaxation>,
}

/// Neighbouring elements of one law, with their geostatic memory as the law laid it out.
pub(super) struct Stretch {
    pub elements: Range<usize>,
    pub law: Box<dyn Law>,
    pub start: Vec<f64>,
}

/// The discretised column. Nodes are numbered from the surface; the base is one of them only where it is compliant.
pub(super) struct Mesh {
    pub elements: Vec<Element>,
    pub stretches: Vec<Stretch>,
    /// Lumped mass per area of the nodes, horizontal and vertical, kg/m².
    pub mass: Vec<[f64; 2]>,
    /// Dashpots between the nodes and the input motion: mass-proportional damping, a compliant base; kg/(m² s).
    pub dashpot: Vec<[f64; 2]>,
    pub structure: Structure,
    /// Whether nodes move vertically: they may, and a law makes them.
    pub moves_vertically: bool,
    pub is_compliant: bool,
    pub frequency_hz: f64,
}

impl Mesh {
    /// Stresses and tangents at the geostatic state.
    pub fn responses(&self) -> Vec<Response> {
        let at_rest = |e: &Element| Response { tau_pa: 0.0, sigma_yy_pa: -e.vertical_pa, tangent_pa: e.elastic_pa };
        self.elements.iter().map(at_rest).collect()
    }

    /// Scale of unbalanced tractions before anything has moved, Pa.
    pub fn least_scale_pa(&self) -> f64 {
        1e-7 * self.elements.last().map_or(1.0, |e| e.vertical_pa.abs()).max(1.0)
    }

    pub fn new(profile: &Profile, analysis: &Analysis) -> Result<Self> {
        let cuts = cuts(profile);
        let stretches = stretches(profile, &cuts)?;
        let frequency_hz = profile.fundamental_hz();
        let is_compliant = profile.features.base_impedance_ratio > 0.0;
        let n_node = cuts.len() + usize::from(is_compliant);
        let mut mesh = Self {
            elements: Vec::with_capacity(cuts.len()),
            stretches: Vec::with_capacity(stretches.len()),
            mass: vec![[0.0; 2]; n_node],
            dashpot: vec![[0.0; 2]; n_node],
            structure: profile.features.structure,
            moves_vertically: false,
            is_compliant,
            frequency_hz,
        };
        for dressed in stretches {
            mesh.push(profile, analysis, &cuts[dressed.elements.clone()], dressed)?;
        }
        if let (true, Some(base), Some(layer)) = (is_compliant, mesh.dashpot.last_mut(), profile.layers.last()) {
            base[0] += layer.density_kg_m3 * layer.vs_m_s / profile.features.base_impedance_ratio;
        }
        Ok(mesh)
    }

    /// Adds the elements of one law, with their masses and dampers.
    fn push(&mut self, profile: &Profile, analysis: &Analysis, cuts: &[Cut], dressed: Dressed) -> Result<()> {
        let Dressed { law, around, .. } = dressed;
        let points: Vec<Point> = cuts.iter().map(|cut| cut.point).collect();
        let damping: Vec<Damping> = points.iter().map(|point| law.damping(point)).collect();
        let relaxations = relaxations(&damping);
        let law = around.dress(law, relaxations.iter().any(Option::is_some));
        self.moves_vertically |= profile.vertical == Vertical::Free && law.couples();
        let mut start = vec![0.0; law.n_state() * points.len()];
        let mut elastic_pa = vec![[0.0; 4]; points.len()];
        law.start_all(&points, &mut start, &mut elastic_pa).map_err(|(i, error)| (*error).at(place(cuts[i].layer)))?;
        let first = self.elements.len();
        let container = profile.features.container;
        let declared_s = profile.rayleigh.beta_s + law.viscosity_s();
        // Rayleigh damping that gives the law's ratio at f and 5 f of the column.
        let modes_rad_s = [TAU * self.frequency_hz, 5.0 * TAU * self.frequency_hz];
        for (i, (cut, elastic_pa)) in (first..).zip(cuts.iter().zip(elastic_pa)) {
            let Cut { point, height_m, .. } = cut;
            let ratio = match damping[i - first] {
                Damping::Rayleigh { ratio } => ratio,
                Damping::Memory { .. } => 0.0,
            };
            let asked = Rayleigh::of_ratio(ratio, modes_rad_s);
            let alpha_1_s = profile.rayleigh.alpha_1_s + asked.alpha_1_s;
            let soil = 0.5 * point.density_kg_m3 * height_m;
            let half = [soil + 0.5 * container.mass_kg_m2 * height_m / profile.depth_m(), soil];
            let crossing_s = height_m * (point.density_kg_m3 / elastic_pa[0]).sqrt();
            let share = analysis.mass.consistent_share(crossing_s, analysis);
            for node in i..(i + 2).min(self.mass.len()) {
                for (k, half) in half.into_iter().enumerate() {
                    self.mass[node][k] += half;
                    self.dashpot[node][k] += half * alpha_1_s;
                }
            }
            self.elements.push(Element {
                depth_m: point.depth_m,
                height_m: *height_m,
                vertical_pa: point.vertical_pa,
                elastic_pa,
                pore_pa: if point.depth_m > profile.water_table_m { law.pore_stiffness_pa() } else { 0.0 },
                container_pa: container.stiffness_pa,
                coupling_kg_m2: half.map(|half| half * share / 3.0),
                beta_s: if around.slips() { 0.0 } else { declared_s + asked.beta_s },
                relaxation: relaxations[i - first],
            });
        }
        self.stretches.push(Stretch { elements: first..self.elements.len(), law, start });
        Ok(())
    }
}

/// An element before it has a law.
struct Cut {
    layer: usize,
    height_m: f64,
    point: Point,
}

/// Neighbouring elements of one law, and what is around it.
struct Dressed {
    elements: Range<usize>,
    law: Box<dyn Law>,
    around: Around,
}

/// The layers cut into elements under their own weight, the structure's, and buoyancy.
fn cuts(profile: &Profile) -> Vec<Cut> {
    let mut cuts = Vec::with_capacity(profile.elements);
    let mut top_m = 0.0;
    let mut total_pa = profile.features.structure.mass_kg_m2 * G_M_S2; // total vertical stress at the element's top
    for (i, (layer, count)) in profile.layers.iter().zip(profile.elements_per_layer()).enumerate() {
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
            cuts.push(Cut { layer: i, height_m, point });
            total_pa += mass * G_M_S2;
            top_m += height_m;
        }
    }
    cuts
}

/// Runs of neighbouring elements with the same law and the same things around it.
fn stretches(profile: &Profile, cuts: &[Cut]) -> Result<Vec<Dressed>> {
    let around_of = |cut: &Cut| {
        let half_m = 0.5 * cut.height_m;
        let kind = &profile.layers[cut.layer].law_kind;
        profile.features.around(kind, cut.point.depth_m - half_m, cut.point.depth_m + half_m)
    };
    let mut found: Vec<Dressed> = Vec::new();
    for (i, cut) in cuts.iter().enumerate() {
        let (layer, around) = (&profile.layers[cut.layer], around_of(cut));
        if let (Some(last), Some(before)) = (found.last_mut(), i.checked_sub(1)) {
            let above = &profile.layers[cuts[before].layer];
            if above.law_kind == layer.law_kind && above.law == layer.law && last.around == around {
                last.elements.end = i + 1;
                continue;
            }
        }
        let law = registry::find("soil law", LAWS, &layer.law_kind)
            .and_then(|entry| (entry.build)(layer.law.as_ref().clone()))
            .map_err(|error: Error| error.at(place(cut.layer)))?;
        found.push(Dressed { elements: i..i + 1, law, around });
    }
    Ok(found)
}

fn place(layer: usize) -> String {
    format!("layer {} from the surface", layer + 1)
}

impl Profile {
    /// Elements by thickness times fineness, at least one a layer, largest remainders first; the sum is `elements`.
    pub fn elements_per_layer(&self) -> Vec<usize> {
        let spare = (self.elements - self.layers.len()) as f64;
        let wanted: Vec<f64> = self.shares().iter().map(|s| (s * self.elements as f64 - 1.0).max(0.0)).collect();
        let scale = spare / wanted.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let exact: Vec<f64> = wanted.iter().map(|w| w * scale).collect();
        let mut counts: Vec<usize> = exact.iter().map(|x| 1 + (x + 1e-9).floor() as usize).collect();
        let mut order: Vec<usize> = (0..counts.len()).collect();
        order.sort_by(|a, b| {
            let rest = |i: &usize| (exact[*i] + 1e-9).fract();
            rest(b).total_cmp(&rest(a)).then(a.cmp(b))
        });
        let missing = self.elements.saturating_sub(counts.iter().sum());
        for i in order.iter().cycle().take(missing) {
            counts[*i] += 1;
        }
        counts
    }
}

#[cfg(test)]
mod tests {
    use super::super::Layer;
    use super::*;

    #[test]
    fn a_cut_layer_leaves_the_elements_of_the_others() {
        let layer = |thickness_m: f64, count: usize| Layer {
            fineness: count as f64 / thickness_m,
            ..Layer::plain("elastic", thickness_m, 1900.0, 200.0)
        };
        let profile = |layers| Profile { elements: 52, ..Profile::plain(layers) };
        let whole = vec![layer(1.0, 2), layer(33.0, 26), layer(22.0, 4), layer(59.0, 20)];
        assert_eq!(profile(whole.clone()).elements_per_layer(), [2, 26, 4, 20]);
        let mut cut = whole;
        cut[1].thickness_m = 12.3;
        cut.insert(1, Layer { thickness_m: 20.7, ..cut[1].clone() });
        assert_eq!(profile(cut).elements_per_layer(), [2, 16, 10, 4, 20]);
    }
}
