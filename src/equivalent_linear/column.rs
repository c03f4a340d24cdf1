//! The column in the frequency domain, at moduli and damping compatible with its strains.

use super::curves::{Curve, Curves};
use super::surroundings::Surroundings;
use super::tuning::Tuning;
use crate::column::{Analysis, Column, Downgoing, Features, Profile, Slice, Structure};
use crate::error::Result;
use crate::numerics::grid::{Cubic, Grid};
use crate::numerics::lanes::{Lane, WIDEST, Width, on_lanes};
use crate::soil::{N_BODY, Point, Rate, Relaxation, Softening, bodies};
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::sync::Arc;

type C64 = Complex<f64>;

/// Elements in the wave length of the highest frequency.
const PER_WAVE: f64 = 18.0;
/// Most elements.
const MAX_ELEMENTS: usize = 120;
/// Places of a layer at which its curve is measured, at most.
const PLACES: usize = 3;

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

/// Lumped masses and equivalent-linear elements.
///
/// With total displacement U and base motion u_g, from the free surface down over nodes i and elements i,
///
/// ```text
/// τ_i = τ_{i−1} − (ω² m_i − iω c_i) U_i − iω c_i u_g                      (1)
/// γ_i = τ_i / (G_i (1 + 2i D_i) K_i + iω β_i G₀_i),   U_{i+1} = U_i + h_i γ_i   (2)
/// U = a U_h + u_g U_p,   a = u_g (1 − U_p(H)) / U_h(H),   or −u_g τ_p/τ_h below a compliant base's node   (3)
/// ```
///
/// with K_i of [`Relaxation`], 1 for laws that have their small-strain damping in β and c alone, and
/// where U_h starts with (1, 0) and no source and U_p with (0, 0) and the source of (1). Everything marched is a smooth
/// function of frequency, resonances appear in (3) only; so the march needs a coarse grid.
///
/// Limits: one modulus and damping per element and motion, the effective strain's; no permanent strain.
/// Check:  the tests below against the exact layered column and against the nonlinear column in weak motion.
/// Source: Idriss and Sun (1992), SHAKE91; Hughes (2000), The Finite Element Method, for lumped masses.
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

    /// Marches the column on `grid` with effective strains `gamma`, one an element, its soil tuned.
    pub fn march(&self, grid: Grid, gamma: &[f64], wanted: Wanted<'_>, tuning: &Tuning) -> March {
        marched(Width::widest(), self, grid, gamma, wanted, tuning)
    }

    #[inline(always)]
    fn marched(&self, grid: Grid, gamma: &[f64], wanted: Wanted<'_>, tuning: &Tuning) -> March {
        let n = grid.count;
        let (depths_m, has_strains) = match wanted {
            Wanted::Motions { depths_m } => (depths_m, false),
            Wanted::Strains => (&[][..], true),
        };
        let omega: Vec<f64> = (0..n).map(|k| TAU * grid.frequency(k)).collect();
        let is_compliant = self.mass.len() > self.elements.len();
        let is_damped = is_compliant || self.damping.iter().any(|c| *c > 0.0);
        let rows = self.rows(depths_m);
        let springs = Springs::new(grid);
        let mut stiffness = Stiffness { re: vec![0.0; n], im: vec![0.0; n] };
        let mut homogeneous = Wave::new(n, [1.0, 0.0]);
        let mut particular = Wave::new(n, [0.0, 0.0]);
        homogeneous.load(&self.structure, &omega);
        let mut march = March {
            grid,
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
            match &element.relaxation {
                Some(relaxation) => stiffness.relax(relaxation, &springs, self.is_dispersive),
                None => stiffness.start(1.0),
            }
            stiffness.scale(modulus, 2.0 * damping * modulus);
            stiffness.add(element.container_pa, element.beta_s * element.shear_modulus_pa, &omega);
            let node = [self.mass[i], self.damping[i]];
            homogeneous.step(&omega, node, 0.0, &stiffness, element.height_m);
            if is_damped {
                particular.step(&omega, node, 1.0, &stiffness, element.height_m);
            }
            if has_strains {
                march.add_strains([&homogeneous, &particular]);
            }
        }
        if let (true, Some(mass), Some(damping)) = (is_compliant, self.mass.last(), self.damping.last()) {
            homogeneous.pass_node(&omega, [*mass, *damping], 0.0);
            particular.pass_node(&omega, [*mass, *damping], 1.0);
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

    /// Frequency step that resolves what is marched, Hz.
    pub fn grid_step_hz(&self) -> f64 {
        (0.03 / self.travel_s).min(0.125)
    }
}

fn marched(
    width: Width,
    column: &EquivalentColumn,
    grid: Grid,
    gamma: &[f64],
    wanted: Wanted<'_>,
    tuning: &Tuning,
) -> March {
    on_lanes!(width, march(column: &EquivalentColumn, grid: Grid, gamma: &[f64], wanted: Wanted<'_>, tuning: &Tuning) -> March)
}

/// As wide as the compiler makes it: the same operations on every width.
#[inline(always)]
#[expect(clippy::extra_unused_type_parameters, reason = "it tells the registers that this is compiled for")]
fn march<L: Lane>(column: &EquivalentColumn, grid: Grid, gamma: &[f64], wanted: Wanted<'_>, tuning: &Tuning) -> March {
    column.marched(grid, gamma, wanted, tuning)
}

/// Root of Σ x w, at least nothing.
fn weighted(width: Width, x: &[f64], weights: &[f64]) -> f64 {
    on_lanes!(width, root_of_sum(x: &[f64], weights: &[f64]) -> f64)
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

/// The springs of every relaxation on a grid: real and imaginary parts, spring after spring.
struct Springs([[Vec<f64>; 2]; N_BODY]);

impl Springs {
    fn new(grid: Grid) -> Self {
        let at: Vec<_> = (0..grid.count).map(|k| bodies(grid.frequency(k))).collect();
        Self(std::array::from_fn(|j| [0, 1].map(|part| at.iter().map(|springs| springs[j][part]).collect())))
    }
}

/// Complex stiffness of an element on a grid, Pa, real and imaginary parts apart.
struct Stiffness {
    re: Vec<f64>,
    im: Vec<f64>,
}

impl Stiffness {
    /// A real constant.
    #[inline(always)]
    fn start(&mut self, value: f64) {
        self.re.fill(value);
        self.im.fill(0.0);
    }

    /// K of a relaxation; without dispersion over its real part.
    #[inline(always)]
    fn relax(&mut self, relaxation: &Relaxation, springs: &Springs, is_dispersive: bool) {
        self.start(relaxation.rest);
        for (weight, [spring_re, spring_im]) in relaxation.weights.iter().zip(&springs.0) {
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

    /// Times a complex constant.
    #[inline(always)]
    fn scale(&mut self, factor_re: f64, factor_im: f64) {
        for (re, im) in self.re.iter_mut().zip(&mut self.im) {
            (*re, *im) = (factor_re * *re - factor_im * *im, factor_re * *im + factor_im * *re);
        }
    }

    /// A spring and a dashpot in parallel.
    #[inline(always)]
    fn add(&mut self, spring_pa: f64, dashpot_pa_s: f64, omega: &[f64]) {
        for ((re, im), w) in self.re.iter_mut().zip(&mut self.im).zip(omega) {
            *re += spring_pa;
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
        self.strain.chunks_exact(products * n).map(|strain| weighted(Width::widest(), strain, &weights)).collect()
    }
}
