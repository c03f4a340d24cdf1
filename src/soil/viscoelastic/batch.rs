//! The relaxation under several motions at once; shear alone.

use super::{INSTANT, N_OWN, REST, TAU, WEIGHTS};
use crate::numerics::lanes::{Lane, Width, on_lanes, take_over};
use crate::soil::relaxation::{N_BODY, times_s};
use crate::soil::{Batch, Refusal, Shear, Steps};

/// Numbers of memory of a point and lane: stress of the law, A of (3), stresses of the springs.
const N_LANE: usize = 2 + N_BODY;
const LAW: usize = 0;
const TANGENT: usize = 1;
const SPRINGS: usize = 2;

/// Points under several motions, around those of a law.
pub(super) struct Points<'l> {
    law: Box<dyn Batch + 'l>,
    width: Width,
    start: &'l [f64],
    /// `[point][number][lane]`.
    own: Vec<f64>,
    trial: Vec<f64>,
}

impl<'l> Points<'l> {
    /// Points of which the law has a batch already, and the relaxation starts with this memory.
    pub fn new(law: Box<dyn Batch + 'l>, start: &'l [f64], width: Width) -> Self {
        let own = vec![0.0; start.len() / N_OWN * N_LANE * width.lanes()];
        Self { law, width, start, trial: own.clone(), own }
    }
}

impl Batch for Points<'_> {
    fn restart(&mut self, lane: usize) {
        self.law.restart(lane);
        let lanes = self.width.lanes();
        for (own, start) in self.own.chunks_exact_mut(N_LANE * lanes).zip(self.start.chunks_exact(N_OWN)) {
            self.width.of_lane(own, lane).for_each(|x| *x = 0.0);
            own[LAW * lanes + lane] = start[TAU];
            own[TANGENT * lanes + lane] = start[INSTANT];
        }
    }

    fn relax(&mut self, steps: &Steps, shear: &mut Shear) {
        relax(self.width, self, steps, shear);
    }

    fn update(
        &mut self,
        steps: &Steps,
        increments: &[f64],
        shear: &mut Shear,
        refused: &mut [Option<(usize, Refusal)>],
    ) {
        self.law.update(steps, increments, shear, refused);
        follow(self.width, self, steps, shear);
    }

    fn accept(&mut self, lanes: &[bool]) {
        self.law.accept(lanes);
        take_over(self.width, lanes, &self.trial, &mut self.own);
    }

    fn vertical_pa(&self, lane: usize, sigma_yy_pa: &mut [f64]) {
        self.law.vertical_pa(lane, sigma_yy_pa);
    }
}

/// (2) for a step of each lane: factors on s_j and on Δτ_law.
#[inline(always)]
fn factors<L: Lane>(dt_s: &[f64]) -> [[L; 2]; N_BODY] {
    let (one, two, half) = (L::splat(1.0), L::splat(2.0), L::splat(0.5));
    let dt = L::load(dt_s);
    let mut factors = [[one; 2]; N_BODY];
    // No closure: one is compiled without the registers.
    for (own, time_s) in factors.iter_mut().zip(times_s()) {
        let gain = one / (one + half * dt / L::splat(*time_s));
        *own = [two * gain - one, gain];
    }
    factors
}

fn relax(width: Width, points: &Points, steps: &Steps, shear: &mut Shear) {
    on_lanes!(width, relaxed(points: &Points, steps: &Steps, shear: &mut Shear))
}

#[inline(always)]
fn relaxed<L: Lane>(points: &Points, steps: &Steps, shear: &mut Shear) {
    let n = L::N;
    let is_meant = L::mask(steps.lanes);
    let factors = factors::<L>(steps.dt_s);
    let one = L::splat(1.0);
    for (point, start) in points.start.chunks_exact(N_OWN).enumerate() {
        let own = &points.own[point * N_LANE * n..(point + 1) * N_LANE * n];
        let row = point * n..(point + 1) * n;
        let (mut lost, mut instant) = (L::splat(0.0), L::splat(0.0));
        for (j, [fade, gain]) in factors.into_iter().enumerate() {
            let weight = L::splat(start[WEIGHTS + j]);
            lost = lost + weight * ((fade - one) * L::load(&own[(SPRINGS + j) * n..]));
            instant = instant + weight * gain;
        }
        let instant = L::splat(start[REST]) + instant;
        let (tau, tangent) = (L::load(&shear.tau_pa[row.clone()]), L::load(&shear.tangent_pa[row.clone()]));
        let ratio = instant / L::load(&own[TANGENT * n..]);
        L::select(is_meant, tau + lost, tau).store(&mut shear.tau_pa[row.clone()]);
        L::select(is_meant, ratio * tangent, tangent).store(&mut shear.tangent_pa[row]);
    }
}

fn follow(width: Width, points: &mut Points, steps: &Steps, shear: &mut Shear) {
    on_lanes!(width, followed(points: &mut Points, steps: &Steps, shear: &mut Shear))
}

/// (1)–(3) after the law gave `shear`.
#[inline(always)]
fn followed<L: Lane>(points: &mut Points, steps: &Steps, shear: &mut Shear) {
    let n = L::N;
    let factors = factors::<L>(steps.dt_s);
    for (point, start) in points.start.chunks_exact(N_OWN).enumerate() {
        let own = &points.own[point * N_LANE * n..(point + 1) * N_LANE * n];
        let new = &mut points.trial[point * N_LANE * n..(point + 1) * N_LANE * n];
        let row = point * n..(point + 1) * n;
        let of_law = L::load(&shear.tau_pa[row.clone()]);
        let change = of_law - L::load(&own[LAW * n..]);
        let (mut tau, mut instant) = (L::splat(0.0), L::splat(0.0));
        for (j, [fade, gain]) in factors.into_iter().enumerate() {
            let weight = L::splat(start[WEIGHTS + j]);
            let spring = fade * L::load(&own[(SPRINGS + j) * n..]) + gain * change; // (2)
            spring.store(&mut new[(SPRINGS + j) * n..]);
            tau = tau + weight * spring;
            instant = instant + weight * gain;
        }
        let rest = L::splat(start[REST]);
        let instant = instant + rest;
        of_law.store(&mut new[LAW * n..]);
        instant.store(&mut new[TANGENT * n..]);
        (rest * of_law + tau).store(&mut shear.tau_pa[row.clone()]); // (1)
        let tangent = instant * L::load(&shear.tangent_pa[row.clone()]);
        tangent.store(&mut shear.tangent_pa[row]); // (3)
    }
}
