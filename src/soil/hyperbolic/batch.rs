//! The law under several motions at once.

use super::{Branch, G, GAMMA_REF, Hyperbolic, MAX_REVERSALS, SIGMA, STACK};
use crate::numerics::lanes::{Lane, WIDEST, Width, copy, on_lanes};
use crate::soil::{Batch, Refusal, Shear, Steps};

/// Numbers of memory of a point and lane beside the reversals: those of the present branch among them, so that most updates look at these
/// alone.
const N_OWN: usize = 9;
const STRESS: usize = 0;
const STRAIN: usize = 1;
const LARGEST: usize = 2;
const SECANT_PA: usize = 3;
const REDUCTION: usize = 4;
const OPEN: usize = 5;
/// Strain and stress at the last reversal, and strain at the one before.
const LAST: usize = 6;
const LAST_STRESS: usize = 7;
const BEFORE: usize = 8;
/// Numbers of the reversals, and of the memory of a point as [`Hyperbolic`] lays it out.
const N_REVERSAL: usize = 2 * MAX_REVERSALS;
const N_ALONE: usize = STACK + N_REVERSAL;

/// Points under several motions.
pub(super) struct Points<'l> {
    law: &'l Hyperbolic,
    width: Width,
    start: &'l [f64],
    /// `[point][number][lane]`.
    own: Vec<f64>,
    trial: Vec<f64>,
    /// Strain at which the backbone is taken, and the power of it, `[point][lane]`.
    at: Vec<f64>,
    powers: Vec<f64>,
    /// Reversals of the accepted state, `[point][lane][number]`.
    reversals: Vec<f64>,
}

impl<'l> Points<'l> {
    /// Points that start with this memory.
    pub fn new(law: &'l Hyperbolic, start: &'l [f64], width: Width) -> Self {
        let lanes = width.lanes();
        let at = vec![0.0; start.len() / N_ALONE * lanes];
        let own = vec![0.0; at.len() * N_OWN];
        let reversals = vec![0.0; at.len() * N_REVERSAL];
        Self { law, width, start, trial: own.clone(), own, powers: at.clone(), at, reversals }
    }
}

impl Batch for Points<'_> {
    fn restart(&mut self, lane: usize) {
        self.width.of_lane(&mut self.own, lane).for_each(|x| *x = 0.0);
    }

    fn relax(&mut self, _: &Steps, _: &mut Shear) {}

    fn update(&mut self, _: &Steps, increments: &[f64], shear: &mut Shear, refused: &mut [Option<(usize, Refusal)>]) {
        if !follow(self.width, self, increments, shear) {
            let lanes = self.width.lanes();
            for (lane, refused) in refused.iter_mut().enumerate() {
                let is_finite = |i: usize| (shear.tau_pa[i] + increments[i]).is_finite();
                let first = (0..increments.len() / lanes).find(|point| !is_finite(point * lanes + lane));
                *refused = refused.or(first.map(|point| (point, Refusal::NotFinite)));
            }
        }
    }

    fn accept(&mut self, lanes: &[bool]) {
        accept(self.width, self, lanes);
    }

    fn vertical_pa(&self, _: usize, sigma_yy_pa: &mut [f64]) {
        sigma_yy_pa.iter_mut().zip(self.start.chunks_exact(N_ALONE)).for_each(|(sigma, start)| *sigma = start[SIGMA]);
    }
}

fn accept(width: Width, points: &mut Points, lanes: &[bool]) {
    on_lanes!(width, accepted(points: &mut Points, lanes: &[bool]))
}

#[inline(always)]
fn accepted<L: Lane>(points: &mut Points, lanes: &[bool]) {
    let (n, is_meant) = (L::N, L::mask(lanes));
    let rows = points.own.chunks_exact_mut(N_OWN * n).zip(points.trial.chunks_exact(N_OWN * n));
    for (point, (own, trial)) in rows.enumerate() {
        let (old, new) = (L::load(&own[LAST * n..]), L::load(&trial[LAST * n..]));
        if L::any(L::and(is_meant, L::or(old.lt(new), new.lt(old)))) {
            for lane in 0..n {
                let open = trial[OPEN * n + lane] as usize;
                if lanes[lane] && open > 0 {
                    let last = (point * n + lane) * N_REVERSAL + 2 * (open - 1);
                    points.reversals[last] = trial[LAST * n + lane];
                    points.reversals[last + 1] = trial[LAST_STRESS * n + lane];
                }
            }
        }
        copy::<L>(is_meant, trial, own);
    }
}

fn follow(width: Width, points: &mut Points, increments: &[f64], shear: &mut Shear) -> bool {
    on_lanes!(width, followed(points: &mut Points, increments: &[f64], shear: &mut Shear) -> bool)
}

/// Follows increments; whether all of it is finite.
#[inline(always)]
fn followed<L: Lane>(points: &mut Points, increments: &[f64], shear: &mut Shear) -> bool {
    turn::<L>(points, increments);
    let curvature = L::splat(points.law.curvature);
    // Powers cost more than all else, and wait least for each other where nothing comes between.
    for y in points.powers.chunks_exact_mut(L::N) {
        L::load(y).powf(curvature).store(y);
    }
    respond::<L>(points, shear)
}

/// The branch on which each point is, and the strain at which (1) is taken there; see [`Hyperbolic::turn`].
#[inline(always)]
fn turn<L: Lane>(points: &mut Points, increments: &[f64]) {
    let n = L::N;
    let (zero, one, half) = (L::splat(0.0), L::splat(1.0), L::splat(0.5));
    for (point, start) in points.start.chunks_exact(N_ALONE).enumerate() {
        let row = point * n..(point + 1) * n;
        let own = &points.own[point * N_OWN * n..(point + 1) * N_OWN * n];
        let new = &mut points.trial[point * N_OWN * n..(point + 1) * N_OWN * n];
        let increment = L::load(&increments[row.clone()]);
        let (mut strain, mut open, mut last) =
            (L::load(&own[STRAIN * n..]), L::load(&own[OPEN * n..]), L::load(&own[LAST * n..]));
        let (largest, before) = (L::load(&own[LARGEST * n..]), L::load(&own[BEFORE * n..]));
        for number in 0..N_OWN {
            L::load(&own[number * n..]).store(&mut new[number * n..]);
        }
        let turns = (increment * (strain - last)).lt(zero);
        strain = strain + increment;
        // A reversal, a loop that closes, or strain beyond the largest so far.
        let closes = L::and(one.lt(open), zero.lt((strain - before) * (before - last)));
        let passes = L::and(zero.lt(open), largest.lt(strain.abs()));
        let changes = L::or(turns, L::or(closes, passes));
        if L::any(changes) {
            let mut changed = [0.0; WIDEST];
            L::select(changes, one, zero).store(&mut changed);
            for lane in 0..n {
                if changed[lane] != 0.0 {
                    let gamma = own[STRAIN * n + lane] + increments[row.start + lane];
                    let reversals = &points.reversals[(point * n + lane) * N_REVERSAL..][..N_REVERSAL];
                    change_branch(points.law, gamma, start, reversals, new, lane);
                }
            }
            (open, last) = (L::load(&new[OPEN * n..]), L::load(&new[LAST * n..]));
        }
        let at = L::select(zero.lt(open), half * (strain - last), strain);
        strain.store(&mut new[STRAIN * n..]);
        at.store(&mut points.at[row.clone()]);
        (at.abs() / L::splat(start[GAMMA_REF])).store(&mut points.powers[row]);
    }
}

/// Stresses and tangents; whether all are finite. See [`Hyperbolic::respond`].
#[inline(always)]
fn respond<L: Lane>(points: &mut Points, shear: &mut Shear) -> bool {
    let n = L::N;
    let (zero, one, two) = (L::splat(0.0), L::splat(1.0), L::splat(2.0));
    let curvature = L::splat(points.law.curvature);
    let mut beyond = zero;
    for (point, start) in points.start.chunks_exact(N_ALONE).enumerate() {
        let row = point * n..(point + 1) * n;
        let new = &mut points.trial[point * N_OWN * n..(point + 1) * N_OWN * n];
        let (at, y) = (L::load(&points.at[row.clone()]), L::load(&points.powers[row.clone()]));
        let is_branch = zero.lt(L::load(&new[OPEN * n..]));
        let (secant, reduction) = (L::load(&new[SECANT_PA * n..]), L::load(&new[REDUCTION * n..]));
        let g = L::splat(start[G]);
        let d = one / (one + y);
        let backbone = g * at * d; // (1)
        let backbone_slope = g * d * (one - curvature * y * d);
        let x = two * at;
        let branch = L::load(&new[LAST_STRESS * n..]) + reduction * (two * backbone - secant * x) + secant * x; // (2)
        let branch_slope = reduction * (backbone_slope - secant) + secant;
        let stress = L::select(is_branch, branch, backbone);
        stress.store(&mut new[STRESS * n..]);
        stress.store(&mut shear.tau_pa[row.clone()]);
        L::select(is_branch, branch_slope, backbone_slope).store(&mut shear.tangent_pa[row]);
        // Nothing where both are finite.
        let strain = L::load(&new[STRAIN * n..]);
        beyond = beyond + stress * zero + strain * zero;
    }
    !L::any(L::not(beyond.lt(one)))
}

/// The branch of a lane on which `gamma` lies after what is in `new`, `[number][lane]`, to there.
fn change_branch(law: &Hyperbolic, gamma: f64, start: &[f64], reversals: &[f64], new: &mut [f64], lane: usize) {
    let n = new.len() / N_OWN;
    let of = |number: usize| new[number * n + lane];
    let old = Branch {
        gamma_max: of(LARGEST),
        secant: of(SECANT_PA),
        factor: of(REDUCTION),
        count: of(OPEN) as usize,
        last: [of(LAST), of(LAST_STRESS)],
        before: of(BEFORE),
    };
    let found = law.follow(old, [of(STRAIN), of(STRESS)], gamma, [start[G], start[GAMMA_REF]], reversals);
    for (number, value) in [
        (LARGEST, found.gamma_max),
        (SECANT_PA, found.secant),
        (REDUCTION, found.factor),
        (OPEN, found.count as f64),
        (LAST, found.last[0]),
        (LAST_STRESS, found.last[1]),
        (BEFORE, found.before),
    ] {
        new[number * n + lane] = value;
    }
}
