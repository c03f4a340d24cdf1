//! The base below a column whose down-going wave has lost its coherence on the way: what a sensor there records is then not what shakes
//! the column.

use super::mesh::{Element, Mesh};
use crate::numerics::grid::Grid;
use crate::numerics::spectrum;
use crate::soil::bodies;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;

type C64 = Complex<f64>;

/// Frequencies to the fundamental one, and the highest, Hz, at which waves at the base are computed; cubic between, constant above.
const A_MODE: f64 = 8.0;
const HIGHEST_HZ: f64 = 50.0;

/// The motion of the base over what is recorded there.
///
/// ```text
/// U   = √( (1 + C)/2 |u|² + (1 − C)/2 |w|² ) e^{iφ},    φ = arg( (1 + C)/2 u + (1 − C)/2 w )            (1)
/// w   = τ / (i ω √(ρ G)),     u = u↑ + u↓,   w = u↑ − u↓,   C = 1 / (1 + (f/f_c)²)                       (2)
/// ```
///
/// u and τ are displacement and shear stress at the base of the linear column under a motion of one at its surface, U what the sensor
/// records, in power the sum of two waves with the coherence C, in phase its coherent part. With C = 1, U = u.
///
/// Limits: the column at small strains, where motions are strong too; mass-proportional damping, a structure and a compliant base are
/// not in it. u/U is not causal: a record that begins with its event lacks what is before.
/// Check:  `a_sensor_below_sees_what_two_waves_of_less_coherence_leave`, `tests/verification/boundaries.rs`.
/// Source: Steidl, Tumarkin and Archuleta (1996), What is a reference site?, BSSA 86, 1733–1748, for interference and coherence at depth;
/// Tao and Rathje (2019) for columns that interfere more than the records of vertical arrays do.
#[derive(Debug, Clone, PartialEq)]
pub struct Downgoing {
    corner_hz: f64,
    grid: Grid,
    /// u and w on the grid: smooth functions of frequency, for resonances appear in (1) only.
    waves: [Vec<C64>; 2],
}

impl Downgoing {
    /// That of a mesh for the coherence with the corner `corner_hz`.
    pub(super) fn new(mesh: &Mesh, corner_hz: f64) -> Self {
        let grid = Grid::around(0.0, HIGHEST_HZ, mesh.frequency_hz / A_MODE);
        let slabs = slabs(mesh);
        let waves: (Vec<C64>, Vec<C64>) = (0..grid.count).map(|k| waves(&slabs, grid.frequency(k))).unzip();
        Self { corner_hz, grid, waves: waves.into() }
    }

    /// u/U of (1) at `frequency_hz`.
    pub fn at(&self, frequency_hz: f64) -> C64 {
        let frequency_hz = frequency_hz.min(HIGHEST_HZ);
        let at = self.grid.cubic(frequency_hz);
        let [u, w] = [0, 1].map(|i| at.of(&self.waves[i]));
        let coherence = 1.0 / (1.0 + (frequency_hz / self.corner_hz).powi(2));
        let [alike, apart] = [0.5 * (1.0 + coherence), 0.5 * (1.0 - coherence)];
        let power = alike * u.norm_sqr() + apart * w.norm_sqr();
        let coherent = u * alike + w * apart;
        u * coherent.conj() / (power * coherent.norm_sqr()).sqrt()
    }

    /// The acceleration of the base, in the unit of that which was `recorded` there every `dt_s`.
    pub(super) fn base(&self, recorded: &[f64], dt_s: f64) -> Vec<f64> {
        let [base] = spectrum::respond([recorded], dt_s, |f, [x]| [x * self.at(f)]);
        base
    }
}

/// Elements on top of each other that are alike.
struct Slab<'m> {
    element: &'m Element,
    /// That which moves horizontally, lumped by halves at the nodes, kg/m³.
    density_kg_m3: f64,
    count: usize,
}

/// Share of a value within which elements are alike: how far sums of lumped masses are rounded.
const ALIKE: f64 = 1e-9;

/// The elements of `mesh`, surface down.
fn slabs(mesh: &Mesh) -> Vec<Slab<'_>> {
    let is_near = |a: f64, b: f64| (a - b).abs() <= ALIKE * b.abs();
    let mut slabs: Vec<Slab<'_>> = Vec::new();
    let mut half = 0.0;
    for (element, mass) in mesh.elements.iter().zip(&mesh.mass) {
        half = mass[0] - half;
        let density_kg_m3 = 2.0 * half / element.height_m;
        let is_alike = |s: &&mut Slab<'_>| {
            let own = [density_kg_m3, element.height_m, element.elastic_pa[0], element.container_pa, element.beta_s];
            let (e, d) = (s.element, s.density_kg_m3);
            let all = [d, e.height_m, e.elastic_pa[0], e.container_pa, e.beta_s];
            e.relaxation == element.relaxation && own.into_iter().zip(all).all(|(a, b)| is_near(a, b))
        };
        match slabs.last_mut().filter(is_alike) {
            Some(slab) => slab.count += 1,
            None => slabs.push(Slab { element, density_kg_m3, count: 1 }),
        }
    }
    slabs
}

/// u and w of (1) at one frequency.
fn waves(slabs: &[Slab<'_>], frequency_hz: f64) -> (C64, C64) {
    let one = C64::new(1.0, 0.0);
    let omega = TAU * frequency_hz;
    let springs = bodies(frequency_hz);
    // Displacement, and stress over ω: both real where nothing is lost.
    let (mut u, mut tau, mut impedance) = (one, C64::new(0.0, 0.0), one);
    for Slab { element, density_kg_m3, count } in slabs {
        let [re, im] = element.relaxation.map_or([1.0, 0.0], |r| r.modulus_by(&springs));
        let soil_pa = C64::new(re, im + omega * element.beta_s) * element.elastic_pa[0];
        let modulus_pa = soil_pa + element.container_pa;
        impedance = (modulus_pa * *density_kg_m3).sqrt();
        let phase = modulus_pa.inv() * impedance * (omega * element.height_m * *count as f64);
        let up = (phase * C64::i()).exp();
        let down = up.inv();
        let (sin, cos) = ((up - down) * C64::new(0.0, -0.5), (up + down) * 0.5);
        // τ = G ∂u/∂z, z down.
        (u, tau) = (u * cos + tau * sin / impedance, tau * cos - u * sin * impedance);
    }
    (u, tau / (impedance * C64::i()))
}
