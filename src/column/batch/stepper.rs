//! Increments of many motions at once.

use super::super::Column;
use super::super::oscillator::Oscillator;
use super::super::run::Frames;
use super::super::step::{Cut, is_front, newmark};
use crate::numerics::lanes::{Lane, WIDEST, Width, copy, on_lanes};
use crate::soil::{self, Batch, Refusal, Shear, Steps};
use std::ops::Range;

/// What an iteration made of the increment of a lane.
pub(super) enum Outcome {
    Open,
    /// Solved in so many iterations.
    Accepted(u32),
    Cut(Cut),
}

/// Increment of a lane.
#[derive(Clone, Copy, PartialEq)]
enum Phase {
    /// None.
    Rest,
    /// To be predicted.
    Begins,
    Iterates,
}

/// What of the increment of a lane is no array.
struct LaneState {
    phase: Phase,
    iterations: u32,
    outcome: Outcome,
    /// Largest dynamic stress and absolute acceleration so far: the scales of the residual and of the jumps.
    scale_pa: f64,
    scale_m_s2: f64,
}

/// The equations of motion of [`crate::column::step::Stepper`] with one degree of freedom a node, for a motion in each lane: arrays are
/// `[node][lane]` or `[element][lane]`.
pub(super) struct Stepper<'a> {
    pub column: &'a Column,
    width: Width,
    lanes: Vec<LaneState>,
    dt_s: Vec<f64>,
    base_m_s2: Vec<f64>,
    /// The structure on the surface of each lane, where there is one.
    structures: Vec<Oscillator>,
    laws: Vec<(Range<usize>, Box<dyn Batch + 'a>)>,
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
    trial_velocity: Vec<f64>,
    trial_acceleration: Vec<f64>,
    delta: Vec<f64>,
    correction: Vec<f64>,
    factor: Vec<f64>,
    force: Vec<f64>,
    trial_force: Vec<f64>,
    tau: Vec<f64>,
    tangent: Vec<f64>,
    trial_tau: Vec<f64>,
    trial_tangent: Vec<f64>,
    increments: Vec<f64>,
    gamma: Vec<f64>,
}

impl<'a> Stepper<'a> {
    pub fn new(column: &'a Column, width: Width) -> Self {
        let mesh = &column.mesh;
        let n = width.lanes();
        let node = vec![0.0; mesh.mass.len() * n];
        let element = vec![0.0; mesh.elements.len() * n];
        let responses = mesh.responses();
        let laws = mesh.stretches.iter().map(|s| {
            let own = s.elements.start * n..s.elements.end * n;
            (own, soil::batch(s.law.as_ref(), &s.start, &responses[s.elements.clone()], width))
        });
        let lane =
            || LaneState { phase: Phase::Rest, iterations: 0, outcome: Outcome::Open, scale_pa: 0.0, scale_m_s2: 0.0 };
        Self {
            column,
            width,
            lanes: (0..n).map(|_| lane()).collect(),
            dt_s: vec![1.0; n],
            base_m_s2: vec![0.0; n],
            structures: (0..n).filter_map(|_| Oscillator::new(&mesh.structure, 0.0)).collect(),
            laws: laws.collect(),
            velocity: node.clone(),
            acceleration: node.clone(),
            trial_velocity: node.clone(),
            trial_acceleration: node.clone(),
            delta: node.clone(),
            correction: node.clone(),
            factor: node.clone(),
            force: node.clone(),
            trial_force: node,
            tau: element.clone(),
            tangent: element.clone(),
            trial_tau: element.clone(),
            trial_tangent: element.clone(),
            increments: element.clone(),
            gamma: element,
        }
    }

    /// Puts a lane to rest under a base acceleration.
    pub fn restart(&mut self, lane: usize, base_m_s2: f64) {
        let mesh = &self.column.mesh;
        for array in [&mut self.velocity, &mut self.force, &mut self.delta, &mut self.tau, &mut self.gamma] {
            self.width.of_lane(array, lane).for_each(|x| *x = 0.0);
        }
        self.width.of_lane(&mut self.acceleration, lane).for_each(|a| *a = -base_m_s2);
        for (tangent, element) in self.width.of_lane(&mut self.tangent, lane).zip(&mesh.elements) {
            *tangent = element.elastic_pa[0];
        }
        self.laws.iter_mut().for_each(|(_, law)| law.restart(lane));
        if let (Some(own), Some(rests)) = (self.structures.get_mut(lane), Oscillator::new(&mesh.structure, base_m_s2)) {
            *own = rests;
        }
        let state = &mut self.lanes[lane];
        (state.scale_m_s2, state.scale_pa) = (base_m_s2.abs(), mesh.least_scale_pa());
    }

    /// Begins an increment.
    pub fn begin(&mut self, lane: usize, dt_s: f64, base_m_s2: f64) {
        (self.dt_s[lane], self.base_m_s2[lane]) = (dt_s, base_m_s2);
        let state = &mut self.lanes[lane];
        (state.phase, state.iterations) = (Phase::Begins, 0);
    }

    /// Leaves a lane without a motion.
    pub fn rest(&mut self, lane: usize) {
        self.lanes[lane].phase = Phase::Rest;
        self.dt_s[lane] = 1.0;
    }

    /// What the last iteration made of the increment of a lane.
    pub fn outcome(&mut self, lane: usize) -> Outcome {
        std::mem::replace(&mut self.lanes[lane].outcome, Outcome::Open)
    }

    /// One iteration of every lane that has an increment: Newton's step from the state that its last one led to.
    pub fn iterate(&mut self) {
        let n = self.width.lanes();
        let begins = self.lanes_where(|phase| phase == Phase::Begins);
        let active = self.lanes_where(|phase| phase != Phase::Rest);
        self.predict(&begins[..n]);
        let mut refused: [Option<(usize, Refusal)>; WIDEST] = [None; WIDEST];
        let regular = correct(self.width, self);
        let steps = Steps { lanes: &active[..n], dt_s: &self.dt_s };
        for (own, law) in &mut self.laws {
            let mut of_law = [None; WIDEST];
            let shear = &mut Shear {
                tau_pa: &mut self.trial_tau[own.clone()],
                tangent_pa: &mut self.trial_tangent[own.clone()],
            };
            law.update(&steps, &self.increments[own.clone()], shear, &mut of_law[..n]);
            let first = own.start / n;
            for (all, own) in refused.iter_mut().zip(of_law) {
                *all = all.or(own.map(|(point, refusal)| (first + point, refusal)));
            }
        }
        let [sizes, dynamic_pa] = residual(self.width, self);
        let mut accepted = [false; WIDEST];
        for lane in (0..n).filter(|lane| active[*lane]) {
            let cut = match refused[lane] {
                _ if regular[lane].is_nan() || regular[lane] == 0.0 => Some(Cut::Singular),
                Some((element, refusal)) => Some(Cut::Law { element, refusal }),
                None => {
                    self.scale(lane, dynamic_pa[lane]);
                    self.judged(lane, sizes[lane], &mut accepted[lane])
                }
            };
            if let Some(cut) = cut {
                self.lanes[lane].outcome = Outcome::Cut(cut);
            }
        }
        self.accept(&accepted[..n]);
    }

    fn lanes_where(&self, is_meant: impl Fn(Phase) -> bool) -> [bool; WIDEST] {
        let mut lanes = [false; WIDEST];
        lanes.iter_mut().zip(&self.lanes).for_each(|(lane, state)| *lane = is_meant(state.phase));
        lanes
    }

    /// Starts the increments of the lanes that begin one: solved with the tangent and stress of their last accepted state, relaxed.
    fn predict(&mut self, begins: &[bool]) {
        if begins.iter().all(|begins| !begins) {
            return;
        }
        let n = begins.len();
        reset(self.width, self, begins);
        let structures = self.structures.iter_mut().zip(begins);
        structures.filter(|(_, begins)| **begins).for_each(|(structure, _)| structure.begin());
        let steps = Steps { lanes: begins, dt_s: &self.dt_s };
        for (own, law) in &mut self.laws {
            let shear = &mut Shear {
                tau_pa: &mut self.trial_tau[own.clone()],
                tangent_pa: &mut self.trial_tangent[own.clone()],
            };
            law.relax(&steps, shear);
        }
        let [_, dynamic_pa] = residual(self.width, self);
        for lane in (0..n).filter(|lane| begins[*lane]) {
            self.scale(lane, dynamic_pa[lane]);
            self.lanes[lane].phase = Phase::Iterates;
        }
    }

    fn scale(&mut self, lane: usize, dynamic_pa: f64) {
        let scale_pa = &mut self.lanes[lane].scale_pa;
        if dynamic_pa.is_finite() {
            *scale_pa = scale_pa.max(dynamic_pa);
        }
    }

    /// Whether the increment of a lane is solved, with unbalanced tractions of this size, or has to be halved.
    fn judged(&mut self, lane: usize, size: f64, is_accepted: &mut bool) -> Option<Cut> {
        let (analysis, n) = (&self.column.analysis, self.width.lanes());
        let state = &mut self.lanes[lane];
        state.iterations += 1;
        let share = size / state.scale_pa;
        if share <= analysis.tolerance {
            let of_lane = |array: &[f64], node: usize| array[node * n + lane];
            let jump = || {
                let change = |i| (of_lane(&self.trial_acceleration, i) - of_lane(&self.acceleration, i)).abs();
                (0..self.acceleration.len() / n).map(change).fold(0.0, f64::max)
            };
            if is_front(analysis, self.dt_s[lane], state.scale_m_s2, jump) {
                return Some(Cut::Front);
            }
            *is_accepted = true;
            state.outcome = Outcome::Accepted(state.iterations);
        } else if !share.is_finite() || state.iterations == analysis.max_iterations {
            // The first of the largest; what is no number is larger than any.
            let mut worst = (0, self.structures.get(lane).map_or(0.0, |structure| structure.unbalanced().abs()));
            for (node, traction) in self.correction.iter().skip(lane).step_by(n).enumerate() {
                if traction.abs() > worst.1 || traction.is_nan() {
                    worst = (node, traction.abs());
                }
            }
            return Some(Cut::Unbalanced { node: worst.0, share });
        }
        None
    }

    fn accept(&mut self, lanes: &[bool]) {
        if lanes.iter().all(|is_accepted| !is_accepted) {
            return;
        }
        let largest_m_s2 = take_trial(self.width, self, lanes);
        for (lane, state) in self.lanes.iter_mut().enumerate().filter(|(lane, _)| lanes[*lane]) {
            state.scale_m_s2 = state.scale_m_s2.max(self.base_m_s2[lane].abs()).max(largest_m_s2[lane]);
        }
        let structures = self.structures.iter_mut().zip(&self.delta).zip(lanes);
        structures.filter(|(_, is_accepted)| **is_accepted).for_each(|((own, surface), _)| own.accept(*surface));
        self.laws.iter_mut().for_each(|(_, law)| law.accept(lanes));
    }

    /// Condenses the structures out of the equations of the steps in each lane: what they add to the effective tangent and to the
    /// unbalanced traction of the surface.
    fn condensed(&mut self, [beta, gamma]: [f64; 2], hht: f64) -> [OfLanes; 2] {
        let mut added = [[0.0; WIDEST]; 2];
        for (lane, (structure, dt)) in self.structures.iter_mut().zip(&self.dt_s).enumerate() {
            added[0][lane] = structure.condensed(1.0 / (beta * dt * dt), hht, gamma / (beta * dt));
            added[1][lane] = structure.condensed_residual();
        }
        added
    }

    /// Tractions of the structures on the surface with velocity `velocity_m_s`, and their own imbalances.
    fn tractions(&mut self, velocity_m_s: &OfLanes) -> [OfLanes; 2] {
        let alpha = self.column.analysis.hht_alpha;
        let mut tractions = [[0.0; WIDEST]; 2];
        for (lane, structure) in self.structures.iter_mut().enumerate() {
            let surface = [self.delta[lane], velocity_m_s[lane]];
            (tractions[0][lane], tractions[1][lane]) =
                structure.residual(self.dt_s[lane], self.base_m_s2[lane], alpha, surface);
        }
        tractions
    }

    /// Writes what there is to see in a lane to `frames`.
    pub fn show(&self, lane: usize, frames: &mut Frames) {
        let n = self.width.lanes();
        let acceleration = |node: usize| self.acceleration.get(node * n + lane).copied().unwrap_or(0.0);
        for i in 0..self.column.mesh.elements.len() {
            frames.gamma[i] = self.gamma[i * n + lane];
            frames.tau_pa[i] = self.tau[i * n + lane];
        }
        frames.nodes_m_s2.iter_mut().enumerate().for_each(|(i, node)| *node = acceleration(i));
        for (own, law) in &self.laws {
            law.vertical_pa(lane, &mut frames.vertical_pa[own.start / n..own.end / n]);
        }
        frames.vertical_pa.iter_mut().for_each(|sigma| *sigma = -*sigma);
    }
}

fn reset(width: Width, stepper: &mut Stepper, lanes: &[bool]) {
    on_lanes!(width, put_back(stepper: &mut Stepper, lanes: &[bool]))
}

/// Trial state of `lanes` to the accepted one.
#[inline(always)]
fn put_back<L: Lane>(s: &mut Stepper, lanes: &[bool]) {
    let (is_meant, zero) = (L::mask(lanes), L::splat(0.0));
    copy::<L>(is_meant, &s.tau, &mut s.trial_tau);
    copy::<L>(is_meant, &s.tangent, &mut s.trial_tangent);
    for array in [&mut s.delta, &mut s.increments] {
        for to in array.chunks_exact_mut(L::N) {
            L::select(is_meant, zero, L::load(to)).store(to);
        }
    }
}

fn take_trial(width: Width, stepper: &mut Stepper, lanes: &[bool]) -> OfLanes {
    on_lanes!(width, took_trial(stepper: &mut Stepper, lanes: &[bool]) -> OfLanes)
}

/// Accepted state of `lanes` to the trial one; the largest absolute acceleration of each.
#[inline(always)]
fn took_trial<L: Lane>(s: &mut Stepper, lanes: &[bool]) -> OfLanes {
    let (is_meant, base) = (L::mask(lanes), L::load(&s.base_m_s2));
    let mut largest = L::splat(0.0);
    for a in s.trial_acceleration.chunks_exact(L::N) {
        largest = (L::load(a) + base).abs().max(largest);
    }
    for (to, from) in [
        (&mut s.velocity, &s.trial_velocity),
        (&mut s.acceleration, &s.trial_acceleration),
        (&mut s.force, &s.trial_force),
        (&mut s.tau, &s.trial_tau),
        (&mut s.tangent, &s.trial_tangent),
    ] {
        copy::<L>(is_meant, from, to);
    }
    for (gamma, increment) in s.gamma.chunks_exact_mut(L::N).zip(s.increments.chunks_exact(L::N)) {
        let more = L::load(gamma) + L::load(increment);
        L::select(is_meant, more, L::load(gamma)).store(gamma);
    }
    let mut all = [0.0; WIDEST];
    largest.store(&mut all);
    all
}

/// One number of each lane.
type OfLanes = [f64; WIDEST];

fn correct(width: Width, stepper: &mut Stepper) -> OfLanes {
    on_lanes!(width, corrected(stepper: &mut Stepper) -> OfLanes)
}

/// Solves for a correction of the displacement increments with the effective tangent of each lane's step, and derives the strain
/// increments; above nothing where the tangent is regular.
#[inline(always)]
fn corrected<L: Lane>(s: &mut Stepper) -> OfLanes {
    let mesh = &s.column.mesh;
    let alpha = s.column.analysis.hht_alpha;
    let (beta, gamma) = newmark(alpha);
    let dt = L::load(&s.dt_s);
    let hht = L::splat(1.0 + alpha);
    let (one, zero) = (L::splat(1.0), L::splat(0.0));
    let c_mass = one / (L::splat(beta) * dt * dt);
    let c_rate = L::splat(gamma) / (L::splat(beta) * dt);
    let [condensed, of_structure] = s.condensed([beta, gamma], 1.0 + alpha);
    let (mut stiffness_above, mut factor, mut x) = (zero, zero, zero);
    let (mut beyond, mut least) = (zero, L::splat(f64::INFINITY));
    for (i, (mass, damping)) in mesh.mass.iter().zip(&mesh.dashpot).enumerate() {
        let row = i * L::N..(i + 1) * L::N;
        let mut diagonal = L::splat(mass[0]) * c_mass + hht * c_rate * L::splat(damping[0]);
        if i > 0 {
            diagonal = diagonal + stiffness_above;
        }
        let mut stiffness = zero;
        if let Some(e) = mesh.elements.get(i) {
            let viscous = c_rate * L::splat(e.beta_s);
            let tangent = L::load(&s.trial_tangent[row.clone()]) + L::splat(e.container_pa);
            stiffness = hht / L::splat(e.height_m) * (tangent + viscous * L::splat(e.elastic_pa[0]))
                - L::splat(e.coupling_kg_m2[0]) * c_mass;
            diagonal = diagonal + stiffness;
        }
        let mut unbalanced = L::load(&s.correction[row.clone()]);
        if i == 0 {
            diagonal = diagonal + L::load(&condensed);
            unbalanced = unbalanced + L::load(&of_structure);
        }
        let below = -stiffness;
        let above = -stiffness_above;
        let inverse = one / (diagonal - above * factor);
        beyond = beyond + inverse * zero;
        least = inverse.abs().min(least);
        x = inverse * (unbalanced - above * x);
        factor = inverse * below;
        x.store(&mut s.correction[row.clone()]);
        factor.store(&mut s.factor[row]);
        stiffness_above = stiffness;
    }
    let n_node = mesh.mass.len();
    let mut displacement_below = zero;
    for i in (0..n_node).rev() {
        let row = i * L::N..(i + 1) * L::N;
        if i + 1 < n_node {
            x = L::load(&s.correction[row.clone()]) - L::load(&s.factor[row.clone()]) * x;
        }
        let displacement = L::load(&s.delta[row.clone()]) - x;
        displacement.store(&mut s.delta[row.clone()]);
        if let Some(e) = mesh.elements.get(i) {
            let strain = (displacement_below - displacement) / L::splat(e.height_m);
            strain.store(&mut s.increments[row]);
        }
        displacement_below = displacement;
    }
    let mut surface = [0.0; WIDEST];
    x.store(&mut surface);
    s.structures.iter_mut().zip(surface).for_each(|(structure, surface)| structure.correct(surface));
    let mut all = [0.0; WIDEST];
    (least + beyond).store(&mut all);
    all
}

fn residual(width: Width, stepper: &mut Stepper) -> [OfLanes; 2] {
    on_lanes!(width, unbalanced(stepper: &mut Stepper) -> [OfLanes; 2])
}

/// Writes the unbalanced tractions to `correction`; the largest of them and the largest dynamic stress in each lane.
#[inline(always)]
fn unbalanced<L: Lane>(s: &mut Stepper) -> [OfLanes; 2] {
    let mesh = &s.column.mesh;
    let alpha = s.column.analysis.hht_alpha;
    let (beta, gamma) = newmark(alpha);
    let base = L::load(&s.base_m_s2);
    let (now, before) = (L::splat(1.0 + alpha), L::splat(alpha));
    let zero = L::splat(0.0);
    let n_node = mesh.mass.len();
    let (mut tau_above, mut pull_above) = (zero, zero);
    let (mut beyond, mut size, mut dynamic) = (zero, zero, zero);
    let (mut v, mut a) = moved::<L>(s, 0, [beta, gamma]);
    for i in 0..n_node {
        let row = i * L::N..(i + 1) * L::N;
        let (below, a_below) = if i + 1 < n_node { moved::<L>(s, i + 1, [beta, gamma]) } else { (zero, zero) };
        let mut force = L::splat(mesh.dashpot[i][0]) * v;
        if i > 0 {
            force = force + tau_above;
        }
        let mut pull = zero;
        if let Some(e) = mesh.elements.get(i) {
            pull = L::splat(e.coupling_kg_m2[0]) * (a_below - a);
            let strain = L::load(&s.gamma[row.clone()]) + L::load(&s.increments[row.clone()]);
            let viscous = L::splat(e.beta_s / e.height_m * e.elastic_pa[0]);
            let tau = L::load(&s.trial_tau[row.clone()]) + L::splat(e.container_pa) * strain + viscous * (below - v);
            force = force - tau;
            // What is no number is left out.
            dynamic = tau.abs().max(dynamic);
            tau_above = tau;
        }
        if i == 0 && !s.structures.is_empty() {
            let mut velocity_m_s = [0.0; WIDEST];
            v.store(&mut velocity_m_s);
            let [traction, imbalance] = s.tractions(&velocity_m_s).map(|of| L::load(&of));
            force = force - traction;
            size = imbalance.abs();
            beyond = beyond + imbalance * zero;
        }
        force.store(&mut s.trial_force[row.clone()]);
        let inertia = L::splat(mesh.mass[i][0]) * (a + base) + (pull - pull_above);
        pull_above = pull;
        let traction = inertia + now * force - before * L::load(&s.force[row.clone()]);
        traction.store(&mut s.correction[row]);
        size = traction.abs().max(size);
        // Nothing where tractions are finite.
        beyond = beyond + traction * zero;
        (v, a) = (below, a_below);
    }
    let mut all = [[0.0; WIDEST]; 2];
    (size + beyond).store(&mut all[0]);
    dynamic.store(&mut all[1]);
    all
}

/// Trial velocity and acceleration of a node.
#[inline(always)]
fn moved<L: Lane>(s: &mut Stepper, node: usize, [beta, gamma]: [f64; 2]) -> (L, L) {
    let row = node * L::N..(node + 1) * L::N;
    let dt = L::load(&s.dt_s);
    let (v, a) = (L::load(&s.velocity[row.clone()]), L::load(&s.acceleration[row.clone()]));
    let moved = L::load(&s.delta[row.clone()]) / dt - v;
    let new_a = moved / (L::splat(beta) * dt) - L::splat(0.5 / beta - 1.0) * a;
    let new_v = v + dt * (L::splat(1.0 - gamma) * a + L::splat(gamma) * new_a);
    new_a.store(&mut s.trial_acceleration[row.clone()]);
    new_v.store(&mut s.trial_velocity[row]);
    (new_v, new_a)
}
