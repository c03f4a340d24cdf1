//! A column marched from its surface down over a grid of frequencies, equations (1) to (3) of [`EquivalentColumn`].

use super::super::tuning::Tuning;
use super::EquivalentColumn;
use crate::column::{Downgoing, Structure};
use crate::numerics::grid::{Cubic, Grid};
use crate::numerics::lanes::{Lane, WIDEST, Width, on_lanes};
use crate::soil::{N_BODY, Relaxation, bodies};
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Products of the strains of U_h and U_p that make up the strain of their sum.
const PRODUCTS: usize = 4;

/// What a march is for.
#[derive(Debug, Clone, Copy)]
pub enum Wanted<'d> {
    /// Motions.
    Motions {
        /// At these depths, m.
        depths_m: &'d [f64],
    },
    /// Strains of the elements.
    Strains,
}

impl EquivalentColumn {
    /// Marches the column at the nodes `at` with effective strains `gamma`, one an element, its soil tuned.
    pub fn march(&self, at: &Nodes, gamma: &[f64], wanted: Wanted<'_>, tuning: &Tuning) -> March {
        let column = self;
        on_lanes!(Width::widest(), march(column: &EquivalentColumn, at: &Nodes, gamma: &[f64], wanted: Wanted<'_>, tuning: &Tuning) -> March)
    }

    #[inline(always)]
    fn marched(&self, at: &Nodes, gamma: &[f64], wanted: Wanted<'_>, tuning: &Tuning) -> March {
        let Nodes { grid, omega, springs } = at;
        let n = grid.count;
        let (depths_m, has_strains) = match wanted {
            Wanted::Motions { depths_m } => (depths_m, false),
            Wanted::Strains => (&[][..], true),
        };
        let is_compliant = self.mass.len() > self.elements.len();
        let is_damped = is_compliant || self.damping.iter().any(|c| *c > 0.0);
        let rows = self.rows(depths_m);
        let [mut relaxed, mut stiffness] = [0; 2].map(|_| Stiffness { re: vec![1.0; n], im: vec![0.0; n] });
        let mut latest = None;
        let mut homogeneous = Wave::new(n, [1.0, 0.0]);
        let mut particular = Wave::new(n, [0.0, 0.0]);
        homogeneous.load(&self.structure, omega);
        let mut march = March {
            grid: *grid,
            is_damped,
            is_compliant,
            downgoing: self.downgoing.clone(),
            base: [Vec::new(), Vec::new()],
            sensors: vec![[vec![C64::default(); n], vec![C64::default(); n]]; depths_m.len()],
            strain: Vec::new(),
        };
        if has_strains {
            march.strain.reserve(self.elements.len() * n * if is_damped { PRODUCTS } else { 1 });
        }
        for i in 0..=self.elements.len() {
            for (sensor, (node, share)) in march.sensors.iter_mut().zip(&rows) {
                let weight = if *node == i {
                    1.0 - share
                } else if node + 1 == i {
                    *share
                } else {
                    continue;
                };
                homogeneous.add_to(&mut sensor[0], weight);
                if is_damped {
                    particular.add_to(&mut sensor[1], weight);
                }
            }
            let (Some(element), Some(gamma)) = (self.elements.get(i), gamma.get(i)) else { break };
            let (ratio, damping) = element.curve.at(*gamma);
            let (factor, added) = tuning.at(element.depth_m / self.depth_m);
            let (modulus, damping) = (element.shear_modulus_pa * ratio * factor, (damping + added).max(0.0));
            // Elements of a layer share theirs.
            if latest != Some(&element.relaxation) {
                relaxed.relax(element.relaxation.as_ref(), springs, self.is_dispersive);
                latest = Some(&element.relaxation);
            }
            stiffness.scaled(&relaxed, [modulus, 2.0 * damping * modulus]);
            let dashpot_pa_s = element.beta_s * element.shear_modulus_pa;
            stiffness.add(element.container_pa, dashpot_pa_s, element.inertia_kg_m, omega);
            let node = [self.mass[i], self.damping[i]];
            homogeneous.step(omega, node, 0.0, &stiffness, element.height_m);
            if is_damped {
                particular.step(omega, node, 1.0, &stiffness, element.height_m);
            }
            if has_strains {
                march.add_strains([&homogeneous, &particular]);
            }
        }
        if let (true, Some(mass), Some(damping)) = (is_compliant, self.mass.last(), self.damping.last()) {
            homogeneous.pass_node(omega, [*mass, *damping], 0.0);
            particular.pass_node(omega, [*mass, *damping], 1.0);
            march.base = [homogeneous.traction(), particular.traction()];
            return march;
        }
        march.base = [homogeneous.displacement(), if is_damped { particular.displacement() } else { Vec::new() }];
        march
    }

    /// (node above, share of the node below) of each sensor.
    fn rows(&self, depths_m: &[f64]) -> Vec<(usize, f64)> {
        let row = |depth_m: &f64| {
            let mut top_m = 0.0;
            for (i, element) in self.elements.iter().enumerate() {
                if *depth_m < top_m + element.height_m {
                    return (i, ((depth_m - top_m) / element.height_m).max(0.0));
                }
                top_m += element.height_m;
            }
            (self.elements.len(), 0.0)
        };
        depths_m.iter().map(row).collect()
    }
}

/// As wide as the compiler makes it: the same operations on every width.
#[inline(always)]
#[expect(clippy::extra_unused_type_parameters, reason = "it tells the registers that this is compiled for")]
fn march<L: Lane>(column: &EquivalentColumn, at: &Nodes, gamma: &[f64], wanted: Wanted<'_>, tuning: &Tuning) -> March {
    column.marched(at, gamma, wanted, tuning)
}

/// Root of Σ x w, at least nothing.
fn weighted(x: &[f64], weights: &[f64]) -> f64 {
    on_lanes!(Width::widest(), root_of_sum(x: &[f64], weights: &[f64]) -> f64)
}

/// The sum is taken in as many parts as the widest registers have, on every width.
#[inline(always)]
#[expect(clippy::extra_unused_type_parameters, reason = "it tells the registers that this is compiled for")]
fn root_of_sum<L: Lane>(x: &[f64], weights: &[f64]) -> f64 {
    let (x, x_rest) = x.as_chunks::<WIDEST>();
    let (weights, weights_rest) = weights.as_chunks::<WIDEST>();
    let mut sums = [0.0; WIDEST];
    for (x, w) in x.iter().zip(weights) {
        for lane in 0..WIDEST {
            sums[lane] += x[lane] * w[lane];
        }
    }
    let rest = x_rest.iter().zip(weights_rest).map(|(x, w)| x * w).sum::<f64>();
    (sums.iter().sum::<f64>() + rest).max(0.0).sqrt()
}

/// Frequencies at which columns are marched, and what all columns have in common there.
#[derive(Debug, Clone)]
pub struct Nodes {
    /// The frequencies.
    pub grid: Grid,
    omega: Vec<f64>,
    /// The springs of every relaxation: real and imaginary parts, spring after spring.
    springs: [[Vec<f64>; 2]; N_BODY],
}

impl Nodes {
    /// At the nodes of `grid`.
    pub fn new(grid: Grid) -> Self {
        let at: Vec<_> = (0..grid.count).map(|k| bodies(grid.frequency(k))).collect();
        let springs = std::array::from_fn(|j| [0, 1].map(|part| at.iter().map(|springs| springs[j][part]).collect()));
        Self { grid, omega: (0..grid.count).map(|k| TAU * grid.frequency(k)).collect(), springs }
    }
}

/// Complex stiffness of an element on a grid, Pa, real and imaginary parts apart.
struct Stiffness {
    re: Vec<f64>,
    im: Vec<f64>,
}

impl Stiffness {
    /// K of a relaxation, 1 without; without dispersion over its real part.
    #[inline(always)]
    fn relax(&mut self, relaxation: Option<&Relaxation>, springs: &[[Vec<f64>; 2]; N_BODY], is_dispersive: bool) {
        self.re.fill(relaxation.map_or(1.0, |r| r.rest));
        self.im.fill(0.0);
        let Some(relaxation) = relaxation else { return };
        for (weight, [spring_re, spring_im]) in relaxation.weights.iter().zip(springs) {
            let parts = self.re.iter_mut().zip(&mut self.im).zip(spring_re.iter().zip(spring_im));
            for ((re, im), (x, y)) in parts {
                *re += weight * x;
                *im += weight * y;
            }
        }
        if !is_dispersive {
            for (re, im) in self.re.iter_mut().zip(&mut self.im) {
                (*re, *im) = (1.0, *im / *re);
            }
        }
    }

    /// `other` times a complex constant.
    #[inline(always)]
    fn scaled(&mut self, other: &Self, [factor_re, factor_im]: [f64; 2]) {
        let parts = self.re.iter_mut().zip(&mut self.im).zip(other.re.iter().zip(&other.im));
        for ((re, im), (x, y)) in parts {
            (*re, *im) = (factor_re * x - factor_im * y, factor_re * y + factor_im * x);
        }
    }

    /// A spring, a dashpot and the consistent mass of (2) in parallel.
    #[inline(always)]
    fn add(&mut self, spring_pa: f64, dashpot_pa_s: f64, inertia_kg_m: f64, omega: &[f64]) {
        for ((re, im), w) in self.re.iter_mut().zip(&mut self.im).zip(omega) {
            *re = *re + spring_pa + inertia_kg_m * w * w;
            *im += dashpot_pa_s * w;
        }
    }
}

/// A solution being marched, real and imaginary parts apart.
struct Wave {
    u: [Vec<f64>; 2],
    tau: [Vec<f64>; 2],
    /// Of the element last passed.
    gamma: [Vec<f64>; 2],
}

impl Wave {
    fn new(n: usize, start: [f64; 2]) -> Self {
        let zero = || [vec![0.0; n], vec![0.0; n]];
        Self { u: [vec![start[0]; n], vec![start[1]; n]], tau: zero(), gamma: zero() }
    }

    /// The inertia of a structure on the surface: τ = −m_s ω² T U, T its transmissibility.
    fn load(&mut self, structure: &Structure, omega: &[f64]) {
        if structure.mass_kg_m2 <= 0.0 {
            return;
        }
        let own = TAU * structure.frequency_hz;
        for (k, w) in omega.iter().enumerate() {
            let spring = C64::new(own * own, 2.0 * structure.damping_ratio * own * w);
            let traction = -structure.mass_kg_m2 * w * w * spring / (spring - w * w);
            self.tau[0][k] += traction.re * self.u[0][k] - traction.im * self.u[1][k];
            self.tau[1][k] += traction.re * self.u[1][k] + traction.im * self.u[0][k];
        }
    }

    /// (1) alone.
    fn pass_node(&mut self, omega: &[f64], [mass, damping]: [f64; 2], source: f64) {
        for (k, w) in omega.iter().enumerate() {
            let (m, c) = (w * w * mass, w * damping);
            self.tau[0][k] -= m * self.u[0][k] + c * self.u[1][k];
            self.tau[1][k] += c * (self.u[0][k] - source) - m * self.u[1][k];
        }
    }

    fn traction(&self) -> Vec<C64> {
        self.tau[0].iter().zip(&self.tau[1]).map(|(re, im)| C64::new(*re, *im)).collect()
    }

    fn displacement(&self) -> Vec<C64> {
        self.u[0].iter().zip(&self.u[1]).map(|(re, im)| C64::new(*re, *im)).collect()
    }

    #[inline(always)]
    fn add_to(&self, sum: &mut [C64], weight: f64) {
        for ((sum, re), im) in sum.iter_mut().zip(&self.u[0]).zip(&self.u[1]) {
            *sum += C64::new(weight * re, weight * im);
        }
    }

    /// One node and the element below it: (1) and (2).
    #[inline(always)]
    fn step(&mut self, omega: &[f64], [mass, damping]: [f64; 2], source: f64, stiffness: &Stiffness, height_m: f64) {
        let n = omega.len();
        let [ur, ui] = self.u.each_mut().map(|x| &mut x[..n]);
        let [tr, ti] = self.tau.each_mut().map(|x| &mut x[..n]);
        let [gr, gi] = self.gamma.each_mut().map(|x| &mut x[..n]);
        let (re, im) = (&stiffness.re[..n], &stiffness.im[..n]);
        for k in 0..n {
            let w = omega[k];
            let (m, c) = (w * w * mass, w * damping);
            tr[k] -= m * ur[k] + c * ui[k];
            ti[k] += c * (ur[k] - source) - m * ui[k];
            let scale = 1.0 / (re[k] * re[k] + im[k] * im[k]);
            gr[k] = (tr[k] * re[k] + ti[k] * im[k]) * scale;
            gi[k] = (ti[k] * re[k] - tr[k] * im[k]) * scale;
            ur[k] += height_m * gr[k];
            ui[k] += height_m * gi[k];
        }
    }
}

/// A marched column: what (3) needs, on the coarse grid.
#[derive(Debug, Clone)]
pub struct March {
    grid: Grid,
    is_damped: bool,
    is_compliant: bool,
    downgoing: Option<Arc<Downgoing>>,
    /// U_h and U_p at the base; their tractions below the base node where it is compliant.
    base: [Vec<C64>; 2],
    /// U_h and U_p at each sensor.
    sensors: Vec<[Vec<C64>; 2]>,
    /// |γ_h|² of every frequency, element after element, each followed by Re and Im of γ_h γ_p* and by |γ_p|² where there is a U_p.
    strain: Vec<f64>,
}

impl March {
    /// a/u_g of (3) at a frequency.
    fn amplitude(&self, at: &Cubic) -> C64 {
        let particular = if self.is_damped { at.of(&self.base[1]) } else { C64::default() };
        let wanted = if self.is_compliant { C64::default() } else { C64::new(1.0, 0.0) };
        (wanted - particular) / at.of(&self.base[0])
    }

    /// Motion of the base over that which is recorded there.
    fn base(&self, frequency_hz: f64) -> C64 {
        self.downgoing.as_ref().map_or(C64::new(1.0, 0.0), |d| d.at(frequency_hz))
    }

    /// Total motion of every sensor over the recorded base motion at `frequency_hz`, written to `out`.
    pub fn response(&self, frequency_hz: f64, out: &mut [C64]) {
        let at = self.grid.cubic(frequency_hz);
        let (a, base) = (self.amplitude(&at), self.base(frequency_hz));
        for (out, [h, p]) in out.iter_mut().zip(&self.sensors) {
            *out = a * at.of(h);
            if self.is_damped {
                *out += at.of(p);
            }
            *out *= base;
        }
    }

    /// Products of the strains of an element.
    #[inline(always)]
    fn add_strains(&mut self, [homogeneous, particular]: [&Wave; 2]) {
        let n = self.grid.count;
        let [hr, hi] = homogeneous.gamma.each_ref().map(|x| &x[..n]);
        self.strain.extend((0..n).map(|k| hr[k] * hr[k] + hi[k] * hi[k]));
        if self.is_damped {
            let [pr, pi] = particular.gamma.each_ref().map(|x| &x[..n]);
            self.strain.extend((0..n).map(|k| hr[k] * pr[k] + hi[k] * pi[k]));
            self.strain.extend((0..n).map(|k| hi[k] * pr[k] - hr[k] * pi[k]));
            self.strain.extend((0..n).map(|k| pr[k] * pr[k] + pi[k] * pi[k]));
        }
    }

    /// Root of the sum of |γ|² over the bins, element by element, for base displacements `u` at `frequencies_hz`; of a march for strains.
    pub fn strain_norm(&self, frequencies_hz: &[f64], u: &[C64]) -> Vec<f64> {
        let n = self.grid.count;
        let products = if self.is_damped { PRODUCTS } else { 1 };
        let mut weights = vec![0.0; products * n];
        for (f, u) in frequencies_hz.iter().zip(u) {
            let a = self.amplitude(&self.grid.cubic(*f));
            let power = (u * self.base(*f)).norm_sqr();
            let x = ((f - self.grid.first_hz) / self.grid.step_hz).clamp(0.0, n as f64 - 1.001);
            let (i, share) = (x.floor() as usize, x - x.floor());
            for (node, share) in [(i, 1.0 - share), (i + 1, share)] {
                // |a γ_h + γ_p|² by the products of strains.
                let terms = [a.norm_sqr(), 2.0 * a.re, -2.0 * a.im, 1.0];
                for (product, term) in terms.into_iter().enumerate().take(products) {
                    weights[product * n + node] += share * power * term;
                }
            }
        }
        self.strain.chunks_exact(products * n).map(|strain| weighted(strain, &weights)).collect()
    }
}
