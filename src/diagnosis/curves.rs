//! Modulus and damping of a soil point as functions of strain, whatever its law: the law itself is driven through cycles.

use crate::column::{Layer, Vertical};
use crate::soil::{Increment, Law, Point, Refusal};
use std::collections::HashMap;
use std::f64::consts::TAU;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex};

/// Shear-strain amplitudes at which a curve is measured.
const AMPLITUDES: [f64; 10] = [1e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2];
/// Cycles driven at each amplitude; the last one is measured.
const CYCLES: usize = 3;
/// Increments of a cycle.
const STEPS: usize = 32;
/// Time of an increment, s: cycles of about 2 Hz.
const STEP_S: f64 = 0.5 / STEPS as f64;
/// Distance of the measured shear-wave velocities in ln; between them curves are interpolated.
const GRID_LN: f64 = 0.15;

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
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Curve {
    modulus: [f64; AMPLITUDES.len()],
    damping: [f64; AMPLITUDES.len()],
}

impl Curve {
    /// A material that stays linear.
    pub const LINEAR: Self = Self { modulus: [1.0; AMPLITUDES.len()], damping: [0.0; AMPLITUDES.len()] };

    /// (G/G₀, D) at strain amplitude `gamma`, linear in ln γ.
    pub fn at(&self, gamma: f64) -> (f64, f64) {
        let x = (gamma.max(1e-12) / AMPLITUDES[0]).ln();
        let last = AMPLITUDES.len() - 1;
        if x <= 0.0 {
            return (self.modulus[0], self.damping[0]);
        }
        let i = AMPLITUDES.iter().rposition(|a| gamma >= *a).unwrap_or(0);
        if i == last {
            return (self.modulus[last], self.damping[last]);
        }
        let share = (gamma / AMPLITUDES[i]).ln() / (AMPLITUDES[i + 1] / AMPLITUDES[i]).ln();
        let mix = |v: &[f64]| v[i] + share * (v[i + 1] - v[i]);
        (mix(&self.modulus), mix(&self.damping))
    }

    fn mixed(&self, other: &Self, share: f64) -> Self {
        let mix = |a: [f64; AMPLITUDES.len()], b: [f64; AMPLITUDES.len()]| {
            std::array::from_fn(|i| a[i] + share * (b[i] - a[i]))
        };
        Self { modulus: mix(self.modulus, other.modulus), damping: mix(self.damping, other.damping) }
    }

    /// Drives `law` at `point`.
    pub fn measured(law: &dyn Law, point: &Point, pore_pa: f64, vertical: Vertical) -> Self {
        let mut curve = Self::LINEAR;
        let mut start = vec![0.0; law.n_state()];
        let Ok(elastic_pa) = law.start(point, &mut start) else { return curve };
        for (i, amplitude) in AMPLITUDES.iter().enumerate() {
            let mut specimen =
                Specimen { law, pore_pa, vertical, state: start.clone(), trial: start.clone(), eps_yy: 0.0 };
            match specimen.cycles(*amplitude, point.vertical_pa, elastic_pa[3]) {
                Ok([re, im]) if re > 1e-4 * elastic_pa[0] => {
                    curve.modulus[i] = re / elastic_pa[0];
                    curve.damping[i] = (0.5 * im / re).clamp(0.0, 0.6);
                }
                _ if i > 0 => {
                    curve.modulus[i] = curve.modulus[i - 1];
                    curve.damping[i] = curve.damping[i - 1];
                }
                _ => {}
            }
        }
        curve
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

/// Curves measured so far; the same question has the same answer whoever asked first.
#[derive(Default)]
pub struct Curves {
    known: Mutex<HashMap<u64, Arc<Curve>>>,
}

impl Curves {
    /// The curve of `law` of `layer` at `point`, interpolated between a grid of shear-wave velocities.
    ///
    /// `around` names what surrounds the law beside its own parameters.
    pub fn of(
        &self,
        law: &dyn Law,
        (layer, around): (&Layer, &str),
        point: &Point,
        pore_pa: f64,
        vertical: Vertical,
    ) -> Curve {
        if layer.law_kind == "elastic" && around.is_empty() {
            return Curve::LINEAR;
        }
        let x = point.vs_m_s.ln() / GRID_LN;
        let [below, above] =
            [0.0, 1.0].map(|shift| self.on_grid(law, (layer, around), point, (pore_pa, vertical), x.floor() + shift));
        below.mixed(&above, x - x.floor())
    }

    fn on_grid(
        &self,
        law: &dyn Law,
        (layer, around): (&Layer, &str),
        point: &Point,
        (pore_pa, vertical): (f64, Vertical),
        node: f64,
    ) -> Arc<Curve> {
        let mut hasher = DefaultHasher::new();
        layer.law_kind.hash(&mut hasher);
        around.hash(&mut hasher);
        hash_table(&layer.law, &mut hasher);
        let numbers = [point.density_kg_m3, point.vertical_pa, point.horizontal_pa, pore_pa, node];
        numbers.map(f64::to_bits).hash(&mut hasher);
        (vertical == Vertical::Restrained).hash(&mut hasher);
        let key = hasher.finish();
        if let Some(curve) = self.known.lock().ok().and_then(|known| known.get(&key).cloned()) {
            return curve;
        }
        let point = Point { vs_m_s: (node * GRID_LN).exp(), ..*point };
        let curve = Arc::new(Curve::measured(law, &point, pore_pa, vertical));
        if let Ok(mut known) = self.known.lock() {
            known.insert(key, curve.clone());
        }
        curve
    }
}

fn hash_table(table: &toml::Table, hasher: &mut DefaultHasher) {
    for (key, value) in table {
        key.hash(hasher);
        match value {
            toml::Value::Float(x) => x.to_bits().hash(hasher),
            toml::Value::Integer(x) => x.hash(hasher),
            toml::Value::Boolean(x) => x.hash(hasher),
            toml::Value::Table(inner) => hash_table(inner, hasher),
            other => other.to_string().hash(hasher),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registry;
    use crate::soil::LAWS;

    fn law(kind: &str, table: &str) -> Box<dyn Law> {
        (registry::find("soil law", LAWS, kind).unwrap().build)(table.parse().unwrap()).unwrap()
    }

    const POINT: Point =
        Point { depth_m: 5.0, density_kg_m3: 1900.0, vs_m_s: 150.0, vertical_pa: 5e4, horizontal_pa: 2.5e4 };

    #[test]
    fn a_hyperbola_gives_its_secant_modulus_and_masing_damping() {
        let law = law("hyperbolic", "gamma_ref = 1e-3\ncurvature = 1.0\nreduce_damping = false");
        let curve = Curve::measured(law.as_ref(), &POINT, 0.0, Vertical::Free);
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
            law_kind: "sanisand".into(),
            law: parameters.clone(),
        };
        let law = (registry::find("soil law", LAWS, "sanisand").unwrap().build)(parameters).unwrap();
        let curves = Curves::default();
        let at = |vs_m_s: f64| {
            let point = Point { vs_m_s, ..POINT };
            curves.of(law.as_ref(), (&layer, ""), &point, law.pore_stiffness_pa(), Vertical::Free).at(5e-4)
        };
        let (slow, fast) = (at(140.0), at(160.0));
        assert!(slow.0 < 0.95 && slow.1 > 0.005, "{slow:?}");
        assert!(fast.0 < slow.0, "a stiffer sand of the same strength yields at smaller strain: {fast:?} {slow:?}");
        let between = at(150.0);
        assert!(between.0 < slow.0 && between.0 > fast.0);
        assert_eq!(at(150.0), between);
    }
}
