//! One time increment: HHT-α, a linear predictor from the last tangent, then Newton's iteration.

use super::oscillator::Oscillator;
use super::run::Frames;
use super::{Analysis, Column};
use crate::numerics::block_tridiagonal::BlockTridiagonal;
use crate::soil::{Increment, Refusal, Response};
use std::array::from_fn;

/// Everything the stepper remembers; allocated once a run. Nodes have D degrees of freedom: the horizontal one, and the vertical one where
/// they move that way.
pub(super) struct Stepper<'a, const D: usize> {
    column: &'a Column,
    /// Displacement is not needed: strains accumulate in the laws. Velocity and acceleration relative to the base.
    velocity: Vec<[f64; D]>,
    acceleration: Vec<[f64; D]>,
    trial_velocity: Vec<[f64; D]>,
    trial_acceleration: Vec<[f64; D]>,
    delta: Vec<[f64; D]>,
    correction: Vec<[f64; D]>,
    /// Internal plus damping forces at the last accepted time.
    force: Vec<[f64; D]>,
    trial_force: Vec<[f64; D]>,
    state: Vec<Vec<f64>>,
    trial_state: Vec<Vec<f64>>,
    increments: Vec<Increment>,
    responses: Vec<Response>,
    trial_responses: Vec<Response>,
    /// Vertical strain since the geostatic state.
    eps_yy: Vec<f64>,
    /// Shear strain since the geostatic state.
    gamma: Vec<f64>,
    matrix: BlockTridiagonal<D>,
    structure: Option<Oscillator>,
    /// Largest dynamic stress so far: the scale of the residual.
    scale_pa: f64,
    /// Largest absolute acceleration so far: the scale of the jumps.
    scale_m_s2: f64,
}

/// Shortest increment, over the largest, that an acceleration front is worth.
const FRONT_SHARE: f64 = 0.126;

/// Why an increment must be halved.
pub(super) enum Cut {
    Law {
        element: usize,
        refusal: Refusal,
    },
    Unbalanced {
        node: usize,
        share: f64,
    },
    Singular,
    /// An acceleration jumps: the increment is balanced, but too coarse for what passes.
    Front,
}

impl<'a, const D: usize> Stepper<'a, D> {
    pub fn new(column: &'a Column, base_m_s2: f64) -> Self {
        let mesh = &column.mesh;
        let (n, n_node) = (mesh.elements.len(), mesh.mass.len());
        let zero = vec![[0.0; D]; n_node];
        let state: Vec<Vec<f64>> = mesh.stretches.iter().map(|s| s.start.clone()).collect();
        let responses = mesh.responses();
        Self {
            column,
            velocity: zero.clone(),
            acceleration: vec![from_fn(|k| if k == 0 { -base_m_s2 } else { 0.0 }); n_node],
            trial_velocity: zero.clone(),
            trial_acceleration: zero.clone(),
            delta: zero.clone(),
            correction: zero.clone(),
            force: zero.clone(),
            trial_force: zero,
            trial_state: state.clone(),
            state,
            increments: vec![Increment::default(); n],
            trial_responses: responses.clone(),
            responses,
            eps_yy: vec![0.0; n],
            gamma: vec![0.0; n],
            matrix: BlockTridiagonal::new(n_node),
            structure: Oscillator::new(&mesh.structure, base_m_s2),
            scale_m_s2: base_m_s2.abs(),
            scale_pa: mesh.least_scale_pa(),
        }
    }

    /// Tries one increment of `dt` s ending at the base acceleration `base`; Ok(law evaluations) has been accepted, Err has
    /// changed nothing that lasts.
    pub fn advance(&mut self, dt: f64, base: f64) -> Result<u32, Cut> {
        let analysis = &self.column.analysis;
        self.delta.fill([0.0; D]);
        self.trial_responses.copy_from_slice(&self.responses);
        for (stretch, state) in self.column.mesh.stretches.iter().zip(&self.state) {
            stretch.law.relax_all(dt, state, &mut self.trial_responses[stretch.elements.clone()]);
        }
        self.increments.fill(Increment { dt_s: dt, ..Increment::default() });
        if let Some(structure) = &mut self.structure {
            structure.begin();
        }
        // Predictor: the step solved with the tangent and stress of the last accepted state, relaxed.
        self.assemble(dt);
        self.residual(dt, base);
        self.correct()?;
        for iteration in 1..=analysis.max_iterations {
            self.evaluate()?;
            let (node, size) = self.residual(dt, base);
            let share = size / self.scale_pa;
            if share <= analysis.tolerance {
                if is_front(analysis, dt, self.scale_m_s2, || self.jump()) {
                    return Err(Cut::Front);
                }
                self.accept(base);
                return Ok(iteration);
            }
            if !share.is_finite() || iteration == analysis.max_iterations {
                return Err(Cut::Unbalanced { node, share });
            }
            self.assemble(dt);
            self.correct()?;
        }
        Err(Cut::Unbalanced { node: 0, share: f64::INFINITY })
    }

    /// The effective tangent of the step.
    fn assemble(&mut self, dt: f64) {
        let mesh = &self.column.mesh;
        let hht = 1.0 + self.column.analysis.hht_alpha;
        let (beta, gamma) = newmark(self.column.analysis.hht_alpha);
        let c_mass = 1.0 / (beta * dt * dt);
        let c_rate = gamma / (beta * dt);
        let m = &mut self.matrix;
        for ((d, mass), damping) in m.diagonal.iter_mut().zip(&mesh.mass).zip(&mesh.dashpot) {
            *d = [[0.0; D]; D];
            (0..D).for_each(|k| d[k][k] = mass[k] * c_mass + hht * c_rate * damping[k]);
        }
        let n = mesh.mass.len();
        for (i, (element, response)) in mesh.elements.iter().zip(&self.trial_responses).enumerate() {
            let t = response.tangent_pa;
            let viscous = c_rate * element.beta_s;
            let f = hht / element.height_m;
            // Beside the law: a container in shear, pore water vertically, Rayleigh damping in both.
            let beside = [element.container_pa, element.pore_pa];
            let entry = |r: usize, c: usize| {
                let own = t[2 * r + c];
                if r == c {
                    f * (own + beside[r] + viscous * element.elastic_pa[3 * r]) - c_mass * element.coupling_kg_m2[r]
                } else {
                    f * own
                }
            };
            let k: [[f64; D]; D] = from_fn(|r| from_fn(|c| entry(r, c)));
            let add = |d: &mut [[f64; D]; D]| {
                d.iter_mut().flatten().zip(k.iter().flatten()).for_each(|(d, k)| *d += k);
            };
            add(&mut m.diagonal[i]);
            if i + 1 < n {
                add(&mut m.diagonal[i + 1]);
                m.upper[i] = k.map(|row| row.map(|k| -k));
                m.lower[i + 1] = m.upper[i];
            }
        }
        if let Some(structure) = &mut self.structure {
            m.diagonal[0][0][0] += structure.condensed(c_mass, hht, c_rate);
        }
        if D == 2 && mesh.is_compliant {
            // The base stays where it is vertically.
            let base = n - 1;
            m.upper[n - 2].iter_mut().for_each(|row| row[D - 1] = 0.0);
            m.lower[base][D - 1] = [0.0; D];
            m.diagonal[base][0][D - 1] = 0.0;
            m.diagonal[base][D - 1] = from_fn(|c| f64::from(u8::from(c == D - 1)));
        }
    }

    /// Solves for a correction of the displacement increment and derives the strain increments.
    fn correct(&mut self) -> Result<(), Cut> {
        if let Some(structure) = &self.structure {
            self.correction[0][0] += structure.condensed_residual();
        }
        if !self.matrix.solve(&mut self.correction) {
            return Err(Cut::Singular);
        }
        if let Some(structure) = &mut self.structure {
            structure.correct(self.correction[0][0]);
        }
        for (d, c) in self.delta.iter_mut().zip(&self.correction) {
            (0..D).for_each(|k| d[k] -= c[k]);
        }
        let n = self.delta.len();
        for (i, (element, increment)) in self.column.mesh.elements.iter().zip(&mut self.increments).enumerate() {
            let below = if i + 1 < n { self.delta[i + 1] } else { [0.0; D] };
            increment.gamma = (below[0] - self.delta[i][0]) / element.height_m;
            if D == 2 {
                increment.eps_yy = (below[D - 1] - self.delta[i][D - 1]) / element.height_m;
            }
        }
        Ok(())
    }

    /// Calls the laws with the present strain increments.
    fn evaluate(&mut self) -> Result<(), Cut> {
        for ((stretch, old), new) in self.column.mesh.stretches.iter().zip(&self.state).zip(&mut self.trial_state) {
            let range = stretch.elements.clone();
            stretch
                .law
                .update_all(&self.increments[range.clone()], old, new, &mut self.trial_responses[range.clone()])
                .map_err(|(i, refusal)| Cut::Law { element: range.start + i, refusal })?;
        }
        Ok(())
    }

    /// Writes the unbalanced tractions to `correction`; (node, size) of the largest.
    fn residual(&mut self, dt: f64, base: f64) -> (usize, f64) {
        let mesh = &self.column.mesh;
        let alpha = self.column.analysis.hht_alpha;
        let (beta, gamma) = newmark(alpha);
        let n = self.delta.len();
        let motion = self.delta.iter().zip(&self.velocity).zip(&self.acceleration);
        for (((d, v), a), (new_v, new_a)) in
            motion.zip(self.trial_velocity.iter_mut().zip(&mut self.trial_acceleration))
        {
            for k in 0..D {
                new_a[k] = (d[k] / dt - v[k]) / (beta * dt) - (0.5 / beta - 1.0) * a[k];
                new_v[k] = v[k] + dt * ((1.0 - gamma) * a[k] + gamma * new_a[k]);
            }
        }
        for ((f, v), damping) in self.trial_force.iter_mut().zip(&self.trial_velocity).zip(&mesh.dashpot) {
            *f = from_fn(|k| damping[k] * v[k]);
        }
        let mut dynamic_pa: f64 = 0.0;
        for (i, (element, response)) in mesh.elements.iter().zip(&self.trial_responses).enumerate() {
            let below = if i + 1 < n { self.trial_velocity[i + 1] } else { [0.0; D] };
            let above = self.trial_velocity[i];
            let viscous = element.beta_s / element.height_m;
            let gamma = self.gamma[i] + self.increments[i].gamma;
            let tau = (response.tau_pa + element.container_pa * gamma)
                + viscous * element.elastic_pa[0] * (below[0] - above[0]);
            let mut traction = [tau; D];
            if D == 2 {
                let eps = self.eps_yy[i] + self.increments[i].eps_yy;
                traction[D - 1] = (response.sigma_yy_pa + element.vertical_pa)
                    + element.pore_pa * eps
                    + viscous * element.elastic_pa[3] * (below[D - 1] - above[D - 1]);
            }
            (0..D).for_each(|k| self.trial_force[i][k] -= traction[k]);
            if i + 1 < n {
                (0..D).for_each(|k| self.trial_force[i + 1][k] += traction[k]);
            }
            dynamic_pa = dynamic_pa.max(tau.abs());
        }
        if dynamic_pa.is_finite() {
            self.scale_pa = self.scale_pa.max(dynamic_pa);
        }
        let (mut node, mut size) = (0, 0.0);
        if let Some(structure) = &mut self.structure {
            let surface = [self.delta[0][0], self.trial_velocity[0][0]];
            let (traction, unbalanced) = structure.residual(dt, base, alpha, surface);
            self.trial_force[0][0] -= traction;
            size = unbalanced.abs();
        }
        let acceleration = |node: usize| self.trial_acceleration.get(node).copied().unwrap_or([0.0; D]);
        let mut pull_above = [0.0; D];
        for (i, r) in self.correction.iter_mut().enumerate() {
            let (f, old, a, below) = (self.trial_force[i], self.force[i], acceleration(i), acceleration(i + 1));
            let coupling = mesh.elements.get(i).map_or([0.0; 2], |e| e.coupling_kg_m2);
            let pull: [f64; D] = from_fn(|k| coupling[k] * (below[k] - a[k]));
            let beside: [f64; D] = from_fn(|k| pull[k] - pull_above[k]);
            pull_above = pull;
            r[0] = (mesh.mass[i][0] * (a[0] + base) + beside[0]) + (1.0 + alpha) * f[0] - alpha * old[0];
            let mut worst = r[0].abs();
            if D == 2 {
                let is_held = mesh.is_compliant && i + 1 == n;
                let inertia = mesh.mass[i][1] * a[D - 1] + beside[D - 1];
                let vertical = inertia + (1.0 + alpha) * f[D - 1] - alpha * old[D - 1];
                r[D - 1] = if is_held { 0.0 } else { vertical };
                worst = worst.max(r[D - 1].abs());
            }
            if worst > size || worst.is_nan() {
                (node, size) = (i, worst);
            }
        }
        (node, size)
    }

    /// Largest change of a horizontal acceleration within the increment.
    fn jump(&self) -> f64 {
        let changes = self.acceleration.iter().zip(&self.trial_acceleration).map(|(a, b)| (b[0] - a[0]).abs());
        changes.fold(0.0, f64::max)
    }

    /// Writes what there is to see to `frames`.
    pub fn show(&self, frames: &mut Frames) {
        for (i, (element, response)) in self.column.mesh.elements.iter().zip(&self.responses).enumerate() {
            frames.gamma[i] = self.gamma[i];
            frames.tau_pa[i] = response.tau_pa;
            frames.vertical_pa[i] = -response.sigma_yy_pa;
            frames.pore_pa[i] = -element.pore_pa * self.eps_yy[i];
        }
        let accelerations = self.acceleration.iter().map(|a| a[0]).chain([0.0]);
        frames.nodes_m_s2.iter_mut().zip(accelerations).for_each(|(node, a)| *node = a);
    }

    fn accept(&mut self, base: f64) {
        let largest = self.trial_acceleration.iter().fold(base.abs(), |m, a| m.max((a[0] + base).abs()));
        self.scale_m_s2 = self.scale_m_s2.max(largest);
        if let Some(structure) = &mut self.structure {
            structure.accept(self.delta[0][0]);
        }
        std::mem::swap(&mut self.velocity, &mut self.trial_velocity);
        std::mem::swap(&mut self.acceleration, &mut self.trial_acceleration);
        std::mem::swap(&mut self.force, &mut self.trial_force);
        std::mem::swap(&mut self.state, &mut self.trial_state);
        std::mem::swap(&mut self.responses, &mut self.trial_responses);
        for ((eps, gamma), increment) in self.eps_yy.iter_mut().zip(&mut self.gamma).zip(&self.increments) {
            *eps += increment.eps_yy;
            *gamma += increment.gamma;
        }
    }
}

/// Whether a largest `jump` of the accelerations within an increment of `dt_s` is worth a shorter one where the largest acceleration so far
/// is `scale_m_s2`.
pub(super) fn is_front(analysis: &Analysis, dt_s: f64, scale_m_s2: f64, jump: impl FnOnce() -> f64) -> bool {
    let shortest_s = (FRONT_SHARE * analysis.max_step_s).max(2.0 * analysis.min_step_s);
    dt_s > shortest_s && analysis.max_jump.is_finite() && jump() > analysis.max_jump * scale_m_s2
}

/// Newmark's (β, γ) of the HHT method.
pub(super) fn newmark(alpha: f64) -> (f64, f64) {
    ((1.0 - alpha) * (1.0 - alpha) / 4.0, 0.5 - alpha)
}
