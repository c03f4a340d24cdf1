//! Implicit dynamics of the column: HHT-α, Newton with the laws' tangents, adaptive steps.

use super::{Cause, Column, Failure, Vertical};
use crate::numerics::block_tridiagonal::{BlockTridiagonal, Pair};
use crate::soil::{Increment, Response};

/// What the column says at one output time.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// Time since the first sample of the base motion, s.
    pub time_s: f64,
    /// Absolute horizontal acceleration of the base, m/s².
    pub base_m_s2: f64,
    /// Absolute horizontal accelerations at the element centres, surface down, m/s².
    pub elements_m_s2: &'a [f64],
    /// Absolute horizontal acceleration of the surface node, m/s².
    pub surface_m_s2: f64,
    /// Shear strains of the elements, surface down.
    pub gamma: &'a [f64],
    /// Shear stresses of the elements, Pa.
    pub tau_pa: &'a [f64],
}

/// What the time stepping did.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RunSummary {
    /// Accepted steps.
    pub steps: u64,
    /// Steps halved because Newton or a law did not converge.
    pub cuts: u64,
    /// Newton iterations of the accepted steps.
    pub iterations: u64,
    /// Work done by the base on the column, J/m².
    pub work_j_m2: f64,
    /// Kinetic energy at the end plus stress work plus damping work, J/m².
    pub stored_and_dissipated_j_m2: f64,
}

/// Displacements, velocities and accelerations of one time, and the forces that went with them.
#[derive(Clone)]
struct Motion {
    velocity: Vec<Pair>,
    acceleration: Vec<Pair>,
    /// Damping plus internal forces.
    force: Vec<Pair>,
    /// Stresses of the elements, damping included, measured from the geostatic state.
    stress: Vec<Pair>,
}

/// Everything one run needs, allocated once.
struct Workspace {
    now: Motion,
    next: Motion,
    /// Displacement since the committed time.
    moved: Vec<Pair>,
    residual: Vec<Pair>,
    system: BlockTridiagonal,
    committed: Vec<f64>,
    trial: Vec<f64>,
    response: Vec<Response>,
    /// Pore-water stress and strains of the committed time.
    strain: Vec<Pair>,
    tau_pa: Vec<f64>,
    tau_next_pa: Vec<f64>,
}

/// How a step ended.
enum Outcome {
    Converged { iterations: u32 },
    Cut { depth_m: Option<f64>, cause: Cause },
}

/// Newmark parameters of one step size.
struct Scheme {
    dt: f64,
    alpha: f64,
    beta: f64,
    gamma: f64,
}

impl Column {
    /// Runs a base motion of samples `base_m_s2` every `base_dt_s` and hands `sink` one frame an output step.
    ///
    /// The response is in total displacement; the column starts at rest. HHT-α:
    ///
    ///     M a₁ + (1 + α)(C v₁ + f₁) − α (C v₀ + f₀) = 0                        (1)
    ///
    /// # Errors
    /// When a step does not converge at the smallest step size, with time, depth and cause; frames up to then were given.
    pub fn run(
        &self,
        base_dt_s: f64,
        base_m_s2: &[f64],
        sink: &mut dyn FnMut(&Frame<'_>) -> crate::Result<()>,
    ) -> Result<RunSummary, Failure> {
        let fail = |time_s, depth_m, cause| Failure { time_s, depth_m, cause };
        if base_m_s2.is_empty() || base_m_s2.iter().any(|a| !a.is_finite()) {
            return Err(fail(0.0, None, Cause::BaseMotion));
        }
        let n = self.elements.len();
        let mut work = self.workspace();
        let mut centres = vec![0.0; n];
        let mut gamma = vec![0.0; n];
        let mut summary = RunSummary::default();
        let base_at = |t: f64| {
            let position = t / base_dt_s;
            let i = (position.floor() as usize).min(base_m_s2.len() - 1);
            let j = (i + 1).min(base_m_s2.len() - 1);
            let weight = (position - i as f64).clamp(0.0, 1.0);
            base_m_s2[i] + weight * (base_m_s2[j] - base_m_s2[i])
        };
        for node in 0..=n {
            work.now.acceleration[node] = [if node == n { base_at(0.0) } else { 0.0 }, 0.0];
        }
        let output = self.analysis.output_step_s;
        let duration = (base_m_s2.len() - 1) as f64 * base_dt_s;
        let n_output = (duration / output + 1e-6).floor() as usize;
        let mut step = self.analysis.initial_step_s;
        let mut force_scale = 0.0f64;
        let mut time = 0.0;
        for k in 0..=n_output {
            let target = k as f64 * output;
            while target - time > 1e-9 * output {
                let remaining = target - time;
                let dt = remaining / (remaining / step - 1e-6).ceil().max(1.0);
                match self.step(&mut work, dt, base_at(time + dt), force_scale) {
                    Outcome::Converged { iterations } => {
                        self.account(&work, dt, &mut summary);
                        self.accept(&mut work);
                        time += dt;
                        summary.steps += 1;
                        summary.iterations += u64::from(iterations);
                        force_scale = force_scale.max(self.inertia(&work));
                        if iterations <= 5 {
                            step = (step * 1.5).min(self.analysis.max_step_s);
                        }
                    }
                    Outcome::Cut { depth_m, cause } => {
                        summary.cuts += 1;
                        step = 0.5 * dt;
                        if step < self.analysis.min_step_s {
                            return Err(fail(time, depth_m, cause));
                        }
                    }
                }
            }
            time = target;
            for (i, centre) in centres.iter_mut().enumerate() {
                *centre = 0.5 * (work.now.acceleration[i][0] + work.now.acceleration[i + 1][0]);
                gamma[i] = work.strain[i][0];
            }
            let frame = Frame {
                time_s: time,
                base_m_s2: work.now.acceleration[n][0],
                elements_m_s2: &centres,
                surface_m_s2: work.now.acceleration[0][0],
                gamma: &gamma,
                tau_pa: &work.tau_pa,
            };
            sink(&frame).map_err(|e| fail(time, None, Cause::Output(e)))?;
        }
        summary.stored_and_dissipated_j_m2 += self.kinetic(&work);
        Ok(summary)
    }

    fn workspace(&self) -> Workspace {
        let n = self.elements.len();
        let still = Motion {
            velocity: vec![[0.0; 2]; n + 1],
            acceleration: vec![[0.0; 2]; n + 1],
            force: vec![[0.0; 2]; n + 1],
            stress: vec![[0.0; 2]; n],
        };
        let n_state = self.elements.last().map_or(0, |e| e.state.end);
        let mut committed = vec![0.0; n_state];
        for element in &self.elements {
            element.material.initial(&mut committed[element.state.clone()]);
        }
        Workspace {
            now: still.clone(),
            next: still,
            moved: vec![[0.0; 2]; n + 1],
            residual: vec![[0.0; 2]; n],
            system: BlockTridiagonal::new(n),
            trial: committed.clone(),
            committed,
            response: vec![Response::default(); n],
            strain: vec![[0.0; 2]; n],
            tau_pa: vec![0.0; n],
            tau_next_pa: vec![0.0; n],
        }
    }

    /// One step of `dt` to base acceleration `base`: Newton on (1) for the displacements since the committed time.
    fn step(&self, work: &mut Workspace, dt: f64, base: f64, force_scale: f64) -> Outcome {
        let n = self.elements.len();
        let alpha = self.analysis.hht_alpha;
        let scheme = Scheme { dt, alpha, beta: 0.25 * (1.0 - alpha) * (1.0 - alpha), gamma: 0.5 - alpha };
        for i in 0..=n {
            let [v, a] = [work.now.velocity[i], work.now.acceleration[i]];
            let end = if i == n { [base, 0.0] } else { a };
            for d in 0..2 {
                work.moved[i][d] =
                    dt * v[d] + dt * dt * ((0.5 - scheme.beta) * a[d] + scheme.beta * end[d]);
            }
        }
        let mut worst = f64::INFINITY;
        for iteration in 1..=self.analysis.max_iterations {
            if let Err((element, refusal)) = self.respond(work) {
                return Outcome::Cut { depth_m: Some(self.elements[element].centre_m), cause: Cause::Law(refusal) };
            }
            self.kinematics(work, &scheme, base);
            self.forces(work, &scheme);
            let inertia = (0..n).map(|i| (self.mass_kg_m2[i] * work.next.acceleration[i][0]).abs()).fold(0.0, f64::max);
            let scale = force_scale.max(inertia).max(1e-12);
            let (place, largest) = self.largest_residual(work);
            worst = largest / scale;
            if !worst.is_finite() {
                break;
            }
            if worst <= self.analysis.force_tolerance {
                return Outcome::Converged { iterations: iteration };
            }
            if iteration == self.analysis.max_iterations {
                let cause = Cause::NoConvergence { step_s: dt, residual: worst };
                return Outcome::Cut { depth_m: Some(self.elements[place].centre_m), cause };
            }
            self.tangent(work, &scheme);
            if !work.system.solve(&mut work.residual) {
                return Outcome::Cut { depth_m: None, cause: Cause::Singular };
            }
            for (moved, correction) in work.moved.iter_mut().zip(&work.residual) {
                moved[0] -= correction[0];
                moved[1] -= correction[1];
            }
        }
        Outcome::Cut { depth_m: None, cause: Cause::NoConvergence { step_s: dt, residual: worst } }
    }

    /// Asks every law for its stresses at the displacements tried.
    fn respond(&self, work: &mut Workspace) -> Result<(), (usize, crate::soil::Refusal)> {
        for (i, element) in self.elements.iter().enumerate() {
            let h = element.height_m;
            let increment = Increment {
                gamma: (work.moved[i + 1][0] - work.moved[i][0]) / h,
                epsilon_yy: (work.moved[i + 1][1] - work.moved[i][1]) / h,
            };
            let range = element.state.clone();
            let response = element.material.update(increment, &work.committed[range.clone()], &mut work.trial[range]);
            let mut response = response.map_err(|refusal| (i, refusal))?;
            response.sigma_yy_pa += element.water_pa * (work.strain[i][1] + increment.epsilon_yy);
            response.tangent_pa[1][1] += element.water_pa;
            work.response[i] = response;
        }
        Ok(())
    }

    /// Velocities and accelerations that belong to the displacements tried (Newmark).
    fn kinematics(&self, work: &mut Workspace, s: &Scheme, base: f64) {
        let n = self.elements.len();
        for i in 0..=n {
            let [v, a] = [work.now.velocity[i], work.now.acceleration[i]];
            for d in 0..2 {
                let end = if i == n {
                    [base, 0.0][d]
                } else {
                    (work.moved[i][d] - s.dt * v[d]) / (s.beta * s.dt * s.dt) - (0.5 - s.beta) / s.beta * a[d]
                };
                work.next.acceleration[i][d] = end;
                work.next.velocity[i][d] = v[d] + s.dt * ((1.0 - s.gamma) * a[d] + s.gamma * end);
            }
        }
    }

    /// Damping and internal forces, and the residual of (1).
    fn forces(&self, work: &mut Workspace, s: &Scheme) {
        let n = self.elements.len();
        let base_velocity = work.next.velocity[n][0];
        for (i, force) in work.next.force.iter_mut().enumerate() {
            let v = work.next.velocity[i];
            *force = [self.mass_damping[i] * (v[0] - base_velocity), self.mass_damping[i] * v[1]];
        }
        for (i, element) in self.elements.iter().enumerate() {
            let rate = |d: usize| (work.next.velocity[i + 1][d] - work.next.velocity[i][d]) / element.height_m;
            let k = &element.initial_pa;
            let viscous = |d: usize| element.beta_s * (k[d][0] * rate(0) + k[d][1] * rate(1));
            let stress = [work.response[i].tau_pa + viscous(0), work.response[i].sigma_yy_pa + viscous(1)];
            work.tau_next_pa[i] = work.response[i].tau_pa;
            work.next.stress[i] = stress;
            for d in 0..2 {
                work.next.force[i][d] -= stress[d];
                work.next.force[i + 1][d] += stress[d];
            }
        }
        for i in 0..n {
            for d in 0..2 {
                work.residual[i][d] = self.mass_kg_m2[i] * work.next.acceleration[i][d]
                    + (1.0 + s.alpha) * work.next.force[i][d]
                    - s.alpha * work.now.force[i][d];
            }
            if self.vertical == Vertical::Restrained {
                work.residual[i][1] = 0.0;
            }
        }
    }

    fn largest_residual(&self, work: &Workspace) -> (usize, f64) {
        let size = |r: &Pair| if r[0].is_nan() || r[1].is_nan() { f64::NAN } else { r[0].abs().max(r[1].abs()) };
        let mut largest = (0, 0.0);
        for (i, r) in work.residual.iter().enumerate() {
            let value = size(r);
            if value.is_nan() {
                return (i, f64::NAN);
            }
            if value > largest.1 {
                largest = (i, value);
            }
        }
        largest
    }

    /// Derivative of (1) with respect to the displacements.
    fn tangent(&self, work: &mut Workspace, s: &Scheme) {
        let n = self.elements.len();
        let by_acceleration = 1.0 / (s.beta * s.dt * s.dt);
        let by_velocity = (1.0 + s.alpha) * s.gamma / (s.beta * s.dt);
        for i in 0..n {
            let diagonal = self.mass_kg_m2[i] * by_acceleration + self.mass_damping[i] * by_velocity;
            work.system.diagonal[i] = [[diagonal, 0.0], [0.0, diagonal]];
        }
        for (i, element) in self.elements.iter().enumerate() {
            let mut k = [[0.0; 2]; 2];
            for (row, values) in k.iter_mut().enumerate() {
                for (column, value) in values.iter_mut().enumerate() {
                    let law = (1.0 + s.alpha) * work.response[i].tangent_pa[row][column];
                    *value = (law + by_velocity * element.beta_s * element.initial_pa[row][column]) / element.height_m;
                }
            }
            if self.vertical == Vertical::Restrained {
                k[0][1] = 0.0;
                k[1] = [0.0, 0.0];
            }
            for row in 0..2 {
                for column in 0..2 {
                    let value = k[row][column];
                    work.system.diagonal[i][row][column] += value;
                    work.system.upper[i][row][column] = -value;
                    if i + 1 < n {
                        work.system.diagonal[i + 1][row][column] += value;
                        work.system.lower[i + 1][row][column] = -value;
                    }
                }
            }
        }
    }

    fn accept(&self, work: &mut Workspace) {
        for (i, element) in self.elements.iter().enumerate() {
            for d in 0..2 {
                work.strain[i][d] += (work.moved[i + 1][d] - work.moved[i][d]) / element.height_m;
            }
        }
        std::mem::swap(&mut work.now, &mut work.next);
        work.committed.copy_from_slice(&work.trial);
        std::mem::swap(&mut work.tau_pa, &mut work.tau_next_pa);
    }

    fn inertia(&self, work: &Workspace) -> f64 {
        let n = self.elements.len();
        (0..n).map(|i| (self.mass_kg_m2[i] * work.now.acceleration[i][0]).abs()).fold(0.0, f64::max)
    }

    fn kinetic(&self, work: &Workspace) -> f64 {
        let n = self.elements.len();
        (0..n).map(|i| 0.5 * self.mass_kg_m2[i] * work.now.velocity[i].iter().map(|v| v * v).sum::<f64>()).sum()
    }

    /// Energy of the step just converged, by the trapezoidal rule: work of the base on the column; stress and damping work.
    fn account(&self, work: &Workspace, dt: f64, summary: &mut RunSummary) {
        let n = self.elements.len();
        let base = |m: &Motion| m.force[n][0] * m.velocity[n][0];
        summary.work_j_m2 += 0.5 * dt * (base(&work.now) + base(&work.next));
        for (i, element) in self.elements.iter().enumerate() {
            for d in 0..2 {
                let stretch = (work.moved[i + 1][d] - work.moved[i][d]) / element.height_m;
                let stress = 0.5 * (work.now.stress[i][d] + work.next.stress[i][d]);
                summary.stored_and_dissipated_j_m2 += stress * stretch * element.height_m;
            }
        }
        let drag = |m: &Motion| -> f64 {
            (0..n)
                .map(|i| {
                    let v = m.velocity[i];
                    self.mass_damping[i] * ((v[0] - m.velocity[n][0]) * v[0] + v[1] * v[1])
                })
                .sum()
        };
        summary.stored_and_dissipated_j_m2 += 0.5 * dt * (drag(&work.now) + drag(&work.next));
    }
}
