//! Modulus and damping of a soil point as functions of strain, whatever its law: the law itself is driven through cycles.

use super::surroundings::Surroundings;
use crate::column::{Layer, Vertical};
use crate::registry;
use crate::soil::{Increment, LAWS, Law, Point, Refusal};
use std::collections::HashMap;
use std::f64::consts::TAU;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex, OnceLock};

/// Shear-strain amplitudes at which a curve is measured.
const AMPLITUDES: [f64; 10] = [1e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2];
/// Cycles driven at each amplitude; the last one is measured.
pub(super) const CYCLES: usize = 3;
/// Increments of a cycle.
pub(super) const STEPS: usize = 32;
/// Time of an increment, s: cycles of about 2 Hz.
pub(super) const STEP_S: f64 = 0.5 / STEPS as f64;
/// Axes between whose nodes curves are interpolated: shear-wave velocity, vertical stress, strength and contraction.
const N_AXIS: usize = 4;
/// Distances of the measured nodes in ln.
const GRID_LN: [f64; N_AXIS] = [0.2, 0.4, 0.4, 0.4];
/// Distance of the measured densities in ln; the nearest one is taken.
const DENSITY_LN: f64 = 0.05;
/// Parameters that no cycle feels: the column makes damping beside the law of them.
const VISCOUS: [&str; 4] = ["damping_ratio", "damping_multiplier", "damping_exponent", "viscosity_s"];
/// Largest damping ratio.
pub(super) const MAX_DAMPING: f64 = 0.6;

/// A parameter of a law that is moved in small steps, and the axis it has.
struct Moved {
    law_kind: &'static str,
    key: &'static str,
    default: f64,
    axis: usize,
}

/// What takes the factor of a reference strain, and that of contraction.
const MOVED: [Moved; 4] = [
    Moved { law_kind: "hyperbolic", key: "gamma_ref_multiplier", default: 1.0, axis: 2 },
    Moved { law_kind: "sanisand", key: "h_0", default: 6.0, axis: 2 },
    Moved { law_kind: "cam_clay", key: "m", default: 1.2, axis: 2 },
    Moved { law_kind: "sanisand", key: "contraction_multiplier", default: 1.0, axis: 3 },
];

fn moved(law_kind: &str) -> impl Iterator<Item = &'static Moved> {
    MOVED.iter().filter(move |m| m.law_kind == law_kind)
}

/// Secant modulus over the small-strain one and hysteretic damping ratio, by strain amplitude.
///
/// ```text
/// γ(t) = γ_a sin φ,  G* = Σ τ e^{−iφ} / Σ γ e^{−iφ},  G/G₀ = Re G*/G₀,  D = Im G* / (2 Re G*)      (1)
/// ```
///
/// The vertical total stress stays constant as in a column that is free to settle (drained, or undrained with the pore
/// water's stiffness), or the vertical strain is zero where the column is restrained.
///
/// Limits: the third cycle stands for all; beyond an amplitude that the law refuses, the last value holds.
/// Check:  the tests below, against the hyperbola and Masing's damping in closed form.
/// Source: Idriss and Sun (1992) for equivalent-linear site response.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// Weights of measured curves; none is a material that stays linear.
    parts: Vec<(f64, Arc<Measured>)>,
    surroundings: Option<Surroundings>,
}

impl Curve {
    /// A material that stays linear.
    pub const LINEAR: Self = Self { parts: Vec::new(), surroundings: None };

    /// The curve of one law at one point.
    pub fn of(law: Box<dyn Law>, point: &Point, pore_pa: f64, vertical: Vertical) -> Self {
        Self { parts: vec![(1.0, Arc::new(Measured::new(law, point, pore_pa, vertical)))], surroundings: None }
    }

    /// The same law with something around it.
    #[must_use]
    pub fn surrounded(self, by: Option<Surroundings>) -> Self {
        Self { surroundings: by, ..self }
    }

    /// (G/G₀, D) at strain amplitude `gamma`, linear in ln γ.
    pub fn at(&self, gamma: f64) -> (f64, f64) {
        match &self.surroundings {
            None => self.plain(gamma),
            Some(around) => around.at(gamma, |gamma| self.plain(gamma)),
        }
    }

    fn plain(&self, gamma: f64) -> (f64, f64) {
        if self.parts.is_empty() {
            return (1.0, 0.0);
        }
        let last = AMPLITUDES.len() - 1;
        let Some(i) = AMPLITUDES.iter().rposition(|a| gamma >= *a) else { return self.measured(0) };
        if i == last {
            return self.measured(last);
        }
        let share = (gamma / AMPLITUDES[i]).ln() / (AMPLITUDES[i + 1] / AMPLITUDES[i]).ln();
        let ((a, c), (b, d)) = (self.measured(i), self.measured(i + 1));
        (a + share * (b - a), c + share * (d - c))
    }

    fn measured(&self, amplitude: usize) -> (f64, f64) {
        self.parts.iter().fold((0.0, 0.0), |(modulus, damping), (weight, part)| {
            let (m, d) = part.at(amplitude);
            (modulus + weight * m, damping + weight * d)
        })
    }
}

/// A law at one point, driven to an amplitude when that is first asked for: strong cycles are the costly ones, and few
/// motions reach them.
struct Measured {
    law: Box<dyn Law>,
    point: Point,
    pore_pa: f64,
    vertical: Vertical,
    known: [OnceLock<(f64, f64)>; AMPLITUDES.len()],
}

impl Measured {
    fn new(law: Box<dyn Law>, point: &Point, pore_pa: f64, vertical: Vertical) -> Self {
        Self { law, point: *point, pore_pa, vertical, known: Default::default() }
    }

    /// (G/G₀, D) at an amplitude of the list.
    fn at(&self, amplitude: usize) -> (f64, f64) {
        *self.known[amplitude].get_or_init(|| match self.driven(AMPLITUDES[amplitude]) {
            Some(found) => found,
            None if amplitude > 0 => self.at(amplitude - 1),
            None => (1.0, 0.0),
        })
    }

    fn driven(&self, amplitude: f64) -> Option<(f64, f64)> {
        let law = self.law.as_ref();
        let mut state = vec![0.0; law.n_state()];
        let elastic_pa = law.start(&self.point, &mut state).ok()?;
        let (pore_pa, vertical, trial) = (self.pore_pa, self.vertical, state.clone());
        let mut specimen = Specimen { law, pore_pa, vertical, state, trial, eps_yy: 0.0 };
        let [re, im] = specimen.cycles(amplitude, self.point.vertical_pa, elastic_pa[3]).ok()?;
        (re > 1e-4 * elastic_pa[0]).then(|| (re / elastic_pa[0], (0.5 * im / re).clamp(0.0, MAX_DAMPING)))
    }
}

impl std::fmt::Debug for Measured {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Measured").field("point", &self.point).field("known", &self.known).finish_non_exhaustive()
    }
}

impl PartialEq for Measured {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self, other)
    }
}

/// A soil point under strain control.
struct Specimen<'a> {
    law: &'a dyn Law,
    pore_pa: f64,
    vertical: Vertical,
    state: Vec<f64>,
    trial: Vec<f64>,
    eps_yy: f64,
}

impl Specimen<'_> {
    /// Complex modulus of the last cycle, Pa, equation (1).
    fn cycles(&mut self, amplitude: f64, vertical_pa: f64, constrained_pa: f64) -> Result<[f64; 2], Refusal> {
        let mut sums = [0.0; 4];
        let mut gamma = 0.0;
        for k in 1..=CYCLES * STEPS {
            let (sin, cos) = (TAU * k as f64 / STEPS as f64).sin_cos();
            let next = amplitude * sin;
            let tau = self.advance(next - gamma, vertical_pa, constrained_pa, 4)?;
            gamma = next;
            if k > (CYCLES - 1) * STEPS {
                for (sum, term) in sums.iter_mut().zip([tau * sin, tau * cos, gamma * sin, gamma * cos]) {
                    *sum += term;
                }
            }
        }
        let [ts, tc, gs, gc] = sums;
        let size = gs * gs + gc * gc;
        Ok([(ts * gs + tc * gc) / size, (tc * gs - ts * gc) / size])
    }

    /// Shear stress after a strain increment at the vertical condition of the column.
    fn advance(&mut self, gamma: f64, vertical_pa: f64, constrained_pa: f64, halvings: u32) -> Result<f64, Refusal> {
        let mut eps = 0.0;
        let mut outcome = Err(Refusal::Return);
        for _ in 0..8 {
            outcome =
                self.law.update(Increment { dt_s: STEP_S, ..Increment::new(gamma, eps) }, &self.state, &mut self.trial);
            let Ok(response) = &outcome else { break };
            if self.vertical == Vertical::Restrained {
                break;
            }
            let unbalanced = response.sigma_yy_pa + vertical_pa + self.pore_pa * (self.eps_yy + eps);
            if unbalanced.abs() < 1e-6 * vertical_pa.max(1e3) {
                break;
            }
            eps -= unbalanced / (response.tangent_pa[3].max(0.02 * constrained_pa) + self.pore_pa);
        }
        match outcome {
            Ok(response) => {
                self.state.copy_from_slice(&self.trial);
                self.eps_yy += eps;
                Ok(response.tau_pa)
            }
            Err(_) if halvings > 0 => {
                self.advance(0.5 * gamma, vertical_pa, constrained_pa, halvings - 1)?;
                self.advance(0.5 * gamma, vertical_pa, constrained_pa, halvings - 1)
            }
            Err(refusal) => Err(refusal),
        }
    }
}

/// Laws at the nodes asked for so far; the same question has the same answer whoever asked first.
#[derive(Default)]
pub struct Curves {
    known: Mutex<HashMap<u64, Arc<Measured>>>,
}

impl Curves {
    /// The curve of the law of `layer` at `point`, interpolated between laws driven at nodes of shear-wave velocity, vertical
    /// stress and strength: columns of one site ask for many neighbouring values of these.
    pub fn of(&self, layer: &Layer, point: &Point, pore_pa: f64, vertical: Vertical) -> Curve {
        if layer.law_kind == "elastic" {
            return Curve::LINEAR;
        }
        let mut places = [Some(point.vs_m_s), Some(point.vertical_pa), None, None];
        for Moved { key, default, axis, .. } in moved(&layer.law_kind) {
            places[*axis] = Some(layer.law.get(*key).and_then(toml::Value::as_float).unwrap_or(*default));
        }
        let mut nodes = vec![(1.0, [None; N_AXIS])];
        for (axis, place) in places.into_iter().enumerate() {
            let Some(x) = place.map(|p| p.max(1e-9).ln() / GRID_LN[axis]) else { continue };
            let share = x - x.floor();
            let beside = |(weight, node): &(f64, [Option<i64>; N_AXIS])| {
                [(1.0 - share, x.floor()), (share, x.floor() + 1.0)].map(|(w, at)| {
                    let mut node = *node;
                    node[axis] = Some(at as i64);
                    (weight * w, node)
                })
            };
            nodes = nodes.iter().flat_map(beside).filter(|(weight, _)| *weight > 0.0).collect();
        }
        let part = |(weight, node)| Some((weight, self.at(layer, point, (pore_pa, vertical), node)?));
        let parts = nodes.into_iter().filter_map(part);
        Curve { parts: parts.collect(), surroundings: None }
    }

    /// The law at a node; `None` where it cannot be built.
    fn at(
        &self,
        layer: &Layer,
        point: &Point,
        (pore_pa, vertical): (f64, Vertical),
        node: [Option<i64>; N_AXIS],
    ) -> Option<Arc<Measured>> {
        let value = |axis: usize| node[axis].map(|n| (n as f64 * GRID_LN[axis]).exp());
        let density = (point.density_kg_m3.ln() / DENSITY_LN).round();
        let k0 = 1e-3 * (1e3 * point.horizontal_pa / point.vertical_pa).round();
        let mut hasher = DefaultHasher::new();
        layer.law_kind.hash(&mut hasher);
        let counts = |key: &str| moved(&layer.law_kind).all(|m| m.key != key) && !VISCOUS.contains(&key);
        hash_table(&layer.law, &counts, &mut hasher);
        [density, k0, pore_pa].map(f64::to_bits).hash(&mut hasher);
        node.hash(&mut hasher);
        (vertical == Vertical::Restrained).hash(&mut hasher);
        let key = hasher.finish();
        if let Some(known) = self.known.lock().ok().and_then(|known| known.get(&key).cloned()) {
            return Some(known);
        }
        let mut parameters = layer.law.as_ref().clone();
        VISCOUS.iter().for_each(|key| drop(parameters.remove(*key)));
        for Moved { key, axis, .. } in moved(&layer.law_kind) {
            if let Some(value) = value(*axis) {
                parameters.insert(key.to_string(), value.into());
            }
        }
        let law = (registry::find("soil law", LAWS, &layer.law_kind).ok()?.build)(parameters).ok()?;
        let vertical_pa = value(1)?;
        let point = Point {
            vs_m_s: value(0)?,
            vertical_pa,
            horizontal_pa: k0 * vertical_pa,
            density_kg_m3: (density * DENSITY_LN).exp(),
            ..*point
        };
        let measured = Arc::new(Measured::new(law, &point, pore_pa, vertical));
        Some(self.known.lock().ok()?.entry(key).or_insert(measured).clone())
    }
}

/// What of `table` counts.
fn hash_table(table: &toml::Table, counts: &dyn Fn(&str) -> bool, hasher: &mut DefaultHasher) {
    for (key, value) in table.iter().filter(|(key, _)| counts(key)) {
        key.hash(hasher);
        match value {
            toml::Value::Float(x) => x.to_bits().hash(hasher),
            toml::Value::Integer(x) => x.hash(hasher),
            toml::Value::Boolean(x) => x.hash(hasher),
            toml::Value::Table(inner) => hash_table(inner, &|_| true, hasher),
            other => other.to_string().hash(hasher),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::soil::Softening;

    fn law(kind: &str, table: &str) -> Box<dyn Law> {
        (registry::find("soil law", LAWS, kind).unwrap().build)(table.parse().unwrap()).unwrap()
    }

    const POINT: Point =
        Point { depth_m: 5.0, density_kg_m3: 1900.0, vs_m_s: 150.0, vertical_pa: 5e4, horizontal_pa: 2.5e4 };

    #[test]
    fn a_hyperbola_gives_its_secant_modulus_and_masing_damping() {
        let law = law("hyperbolic", "gamma_ref = 1e-3\ncurvature = 1.0\nreduce_damping = false");
        let curve = Curve::of(law, &POINT, 0.0, Vertical::Free);
        for gamma in [1e-4, 3e-4, 1e-3, 3e-3] {
            let (modulus, damping) = curve.at(gamma);
            let x: f64 = gamma / 1e-3;
            // Masing's loop area of the hyperbola over that of the secant; the first harmonic holds slightly more stiffness.
            let masing =
                4.0 / std::f64::consts::PI * (1.0 + 1.0 / x) * (1.0 - (1.0 + x).ln() / x) - 2.0 / std::f64::consts::PI;
            assert!((modulus * (1.0 + x) - 1.0).abs() < 0.12, "modulus at {gamma}: {modulus}");
            assert!((damping / masing - 1.0).abs() < 0.15 + 0.02 / masing, "damping at {gamma}: {damping} {masing}");
        }
        let (modulus, damping) = curve.at(1e-7);
        assert!(modulus > 0.99 && damping < 0.01);
    }

    #[test]
    fn undrained_sand_softens_and_velocities_are_interpolated() {
        let table = std::fs::read_to_string("configs/lotung.toml").unwrap().parse::<toml::Table>().unwrap();
        let mut parameters = table["law"]["silty_sand"].as_table().unwrap().clone();
        parameters.remove("kind");
        let layer = Layer {
            thickness_m: 1.0,
            density_kg_m3: 1900.0,
            vs_m_s: 150.0,
            k0: 0.5,
            fineness: 1.0,
            law_kind: "sanisand".into(),
            law: parameters.clone().into(),
        };
        let law = (registry::find("soil law", LAWS, "sanisand").unwrap().build)(parameters).unwrap();
        let curves = Curves::default();
        let at = |vs_m_s: f64| {
            let point = Point { vs_m_s, ..POINT };
            curves.of(&layer, &point, law.pore_stiffness_pa(), Vertical::Free).at(5e-4)
        };
        let (slow, fast) = (at(140.0), at(160.0));
        assert!(slow.0 < 0.95 && slow.1 > 0.005, "{slow:?}");
        assert!(fast.0 < slow.0, "a stiffer sand of the same strength yields at smaller strain: {fast:?} {slow:?}");
        let between = at(150.0);
        assert!(between.0 < slow.0 && between.0 > fast.0);
        assert_eq!(at(150.0), between);
    }

    #[test]
    fn what_surrounds_a_law_changes_its_curve_as_driving_it_does() {
        let plain = || law("hyperbolic", "gamma_ref = 1e-3\ncurvature = 1.0");
        let around = |softenings: Vec<Softening>, tau_max_pa| {
            let shear_modulus_pa = POINT.density_kg_m3 * POINT.vs_m_s * POINT.vs_m_s;
            let (vertical_pa, rates) = (POINT.vertical_pa, Vec::new());
            Some(Surroundings { softenings, rates, tau_max_pa, vertical_pa, shear_modulus_pa })
        };
        let soft = Softening { ru_at_reference: 0.5, exponent: 1.5 };
        let scaled = crate::soil::Scaled::new(plain(), vec![Box::new(soft)]);
        let slider = crate::soil::Slider::new(plain(), 6e3);
        let dressed: [(Box<dyn Law>, _); 2] =
            [(Box::new(scaled), around(vec![soft], None)), (Box::new(slider), around(Vec::new(), Some(6e3)))];
        for (driven, surroundings) in dressed {
            let driven = Curve::of(driven, &POINT, 0.0, Vertical::Free);
            let quick = Curve::of(plain(), &POINT, 0.0, Vertical::Free).surrounded(surroundings);
            for gamma in [1e-4, 3e-4, 1e-3] {
                let ((a, c), (b, d)) = (driven.at(gamma), quick.at(gamma));
                assert!((a / b - 1.0).abs() < 0.2, "modulus at {gamma}: {a} driven, {b}");
                assert!((c - d).abs() < 0.06 + 0.2 * c, "damping at {gamma}: {c} driven, {d}");
            }
        }
    }
}
