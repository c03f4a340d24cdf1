//! Stress integration: exact elastic part, crossing of the yield surface, then modified-Euler substeps with error control.

use super::rates::{Constants, Deviator, Rates, State, add, dot};
use super::{N_STATE, Sanisand};
use crate::numerics::lanes::{Lane, WIDEST, Width, on_lanes};
use crate::soil::{Increment, Refusal, Response};

/// One point at a time.
pub(super) fn narrow(
    law: &Sanisand,
    increments: &[Increment],
    committed: &[f64],
    trial: &mut [f64],
    responses: &mut [Response],
) -> Result<(), (usize, Refusal)> {
    many::<f64>(law, increments, committed, trial, responses)
}

/// As many points at a time as this machine's registers hold; the same bytes as [`narrow`].
pub(super) fn widest(
    law: &Sanisand,
    increments: &[Increment],
    committed: &[f64],
    trial: &mut [f64],
    responses: &mut [Response],
) -> Result<(), (usize, Refusal)> {
    on_lanes!(
        Width::widest(),
        many(
            law: &Sanisand,
            increments: &[Increment],
            committed: &[f64],
            trial: &mut [f64],
            responses: &mut [Response],
        ) -> Result<(), (usize, Refusal)>
    )
}

#[inline(always)]
fn many<L: Lane>(
    law: &Sanisand,
    increments: &[Increment],
    committed: &[f64],
    trial: &mut [f64],
    responses: &mut [Response],
) -> Result<(), (usize, Refusal)> {
    let c = Constants::new(law);
    let n = increments.len();
    let mut first = 0;
    while first < n {
        // The last bundle repeats the last point.
        let bundle: [usize; WIDEST] = std::array::from_fn(|lane| (first + lane).min(n - 1));
        let state = State {
            s: gather3(committed, &bundle, 0),
            p: gather(committed, &bundle, 3),
            alpha: gather3(committed, &bundle, 4),
            z: gather3(committed, &bundle, 7),
            alpha_in: gather3(committed, &bundle, 10),
            e: gather(committed, &bundle, 13),
            g_0: gather(committed, &bundle, 14),
        };
        let d_gamma = L::from_fn(|lane| increments[bundle[lane]].gamma);
        let d_eps = L::from_fn(|lane| increments[bundle[lane]].eps_yy);
        let (end, tangent, failed) = advance(&c, state, d_gamma, d_eps);
        let refused = L::select(failed, L::splat(1.0), L::splat(0.0));
        let tau = end.s[2];
        let sigma = L::splat(c.p_t) - end.s[1] - end.p;
        for lane in 0..L::N.min(n - first) {
            let i = first + lane;
            if refused.lane(lane) != 0.0 {
                let is_finite = increments[i].gamma.is_finite() && increments[i].eps_yy.is_finite();
                return Err((i, if is_finite { Refusal::Substeps } else { Refusal::NotFinite }));
            }
            let fields = [
                end.s[0],
                end.s[1],
                end.s[2],
                end.p,
                end.alpha[0],
                end.alpha[1],
                end.alpha[2],
                end.z[0],
                end.z[1],
                end.z[2],
                end.alpha_in[0],
                end.alpha_in[1],
                end.alpha_in[2],
                end.e,
                end.g_0,
            ];
            for (slot, field) in trial[i * N_STATE..(i + 1) * N_STATE].iter_mut().zip(fields) {
                *slot = field.lane(lane);
            }
            responses[i] = Response {
                tau_pa: tau.lane(lane),
                sigma_yy_pa: sigma.lane(lane),
                tangent_pa: [
                    tangent[0].lane(lane),
                    tangent[1].lane(lane),
                    tangent[2].lane(lane),
                    tangent[3].lane(lane),
                ],
            };
        }
        first += L::N;
    }
    Ok(())
}

// Functions, not closures: only these are certain to be compiled for the registers of their caller.
#[inline(always)]
fn gather<L: Lane>(memory: &[f64], bundle: &[usize; WIDEST], k: usize) -> L {
    L::from_fn(|lane| memory[bundle[lane] * N_STATE + k])
}

#[inline(always)]
fn gather3<L: Lane>(memory: &[f64], bundle: &[usize; WIDEST], k: usize) -> Deviator<L> {
    [gather(memory, bundle, k), gather(memory, bundle, k + 1), gather(memory, bundle, k + 2)]
}

#[inline(always)]
fn select3<L: Lane>(mask: L::Mask, yes: Deviator<L>, no: Deviator<L>) -> Deviator<L> {
    [L::select(mask, yes[0], no[0]), L::select(mask, yes[1], no[1]), L::select(mask, yes[2], no[2])]
}

/// State and tangent after the increment, and where the integration gave up.
#[inline(always)]
fn advance<L: Lane>(c: &Constants, start: State<L>, d_gamma: L, d_eps: L) -> (State<L>, [L; 4], L::Mask) {
    let zero = L::splat(0.0);
    let one = L::splat(1.0);
    let half = L::splat(0.5);
    // Compression positive: volume −ε_yy, deviator (⅓, −⅔) ε_yy.
    let dv = -d_eps;
    let de = [L::splat(1.0 / 3.0) * d_eps, L::splat(-2.0 / 3.0) * d_eps, half * d_gamma];
    let e_end = start.e - (one + start.e) * dv;

    // Elastic trial. With G = a√p̄ and K in proportion the stress path is a straight line and √p̄ is linear in strain.
    let a = c.stiffness(start.g_0, start.e);
    let b = a * L::splat(c.k_per_g);
    let floor = L::splat(1e-6 * c.p_a);
    let shift = L::splat(c.stiffness_shift);
    let root_0 = (start.p - shift).max(floor).sqrt();
    let root_1 = (root_0 + half * b * dv).max(L::splat(1e-3));
    let mean_root = half * (root_0 + root_1);
    let ds = {
        let two_g = (a + a) * mean_root;
        [two_g * de[0], two_g * de[1], two_g * de[2]]
    };
    let dp = b * mean_root * dv;

    let mut start = start;
    if c.reset_on_reversal {
        let turned = dot(add(start.alpha, -one, start.alpha_in), ds);
        start.alpha_in = select3::<L>(L::lt(turned, zero), start.alpha, start.alpha_in);
    }

    // f² along the line: qa t² + qb t + qc.
    let k2 = L::splat(c.yield_radius * c.yield_radius);
    let from = add(start.s, -start.p, start.alpha);
    let along = add(ds, -dp, start.alpha);
    let qa = dot(along, along) - k2 * dp * dp;
    let qb = dot(from, along) - k2 * start.p * dp; // half of the linear coefficient
    let qc = (dot(from, from) - k2 * start.p * start.p).min(zero);
    let outside = qa + qb + qb + qc;
    let plastic = L::lt(zero, outside);
    let elastic_end = State { s: add(start.s, one, ds), p: start.p + dp, e: e_end, ..start };
    let root_end = (start.p + dp - shift).max(floor).sqrt();
    let g_end = a * root_end;
    let elastic_tangent = [g_end, zero, zero, L::splat(4.0 / 3.0) * g_end + b * root_end];
    // A negative p̄ after the elastic part or an increment that is no number is refused.
    let mut failed = L::not(L::and(L::lt(zero, start.p + dp), L::lt(outside.abs(), L::splat(1e300))));
    let mut active = L::and(plastic, L::not(failed));
    if !L::any(active) {
        return (elastic_end, elastic_tangent, failed);
    }

    // Where the line leaves the yield surface, as a share of stress (t) and of strain (beta).
    let disc = (qb * qb - qa * qc).max(zero).sqrt();
    let t_in = -qc / (qb + disc).max(L::splat(1e-300));
    let t_out = (disc - qb) / qa.max(L::splat(1e-300));
    let t = L::select(L::lt(zero, qb), t_in, t_out).max(zero).min(one);
    let p_cross = start.p + t * dp;
    let beta = (t * mean_root / (half * (root_0 + (p_cross - shift).max(floor).sqrt()))).min(one);
    let mut now = State { s: add(start.s, t, ds), p: p_cross, ..start };
    let rest = one - beta;
    let de = [rest * de[0], rest * de[1], rest * de[2]];
    let dv = rest * dv;
    now.e = start.e - (one + start.e) * (-d_eps) * beta;
    let de_void = e_end - now.e;

    let tolerance = L::splat(c.tolerance);
    let mut time = zero;
    let mut share = one;
    let mut tangent = elastic_tangent;
    let mut count = 0;
    while L::any(active) {
        count += 1;
        share = share.min(one - time);
        let (first, reversed) = Rates::at(c, &now);
        now.alpha_in = select3::<L>(L::and(reversed, active), now.alpha, now.alpha_in);
        let de_sub = [share * de[0], share * de[1], share * de[2]];
        let dv_sub = share * dv;
        let (d1, load_1) = derivative(c, &now, &first, de_sub, dv_sub);
        let radius = L::splat(c.yield_radius);
        let turning = Turning::new(&now, &first, &d1, load_1, radius);
        let mut middle = moved(&now, &d1, one, share * de_void);
        turning.settle(&mut middle, radius);
        let (second, _) = Rates::at(c, &middle);
        let (d2, load_2) = derivative(c, &middle, &second, de_sub, dv_sub);
        let mean = Change {
            s: add([half * d1.s[0], half * d1.s[1], half * d1.s[2]], half, d2.s),
            p: half * (d1.p + d2.p),
            alpha: add([half * d1.alpha[0], half * d1.alpha[1], half * d1.alpha[2]], half, d2.alpha),
            z: add([half * d1.z[0], half * d1.z[1], half * d1.z[2]], half, d2.z),
        };
        let mut next = moved(&now, &mean, one, share * de_void);

        let miss_s = add(d2.s, L::splat(-1.0), d1.s);
        let miss_p = d2.p - d1.p;
        let stress_2 = dot(miss_s, miss_s) + L::splat(3.0) * miss_p * miss_p;
        // Relative to the confinement, and to p_t where there is less.
        let error = half * stress_2.sqrt() / next.p.max(L::splat(c.p_t));
        let fine = L::and(L::lt(error, tolerance), L::lt(L::splat(2e-6 * c.p_a), next.p.min(middle.p)));
        let accept = L::and(fine, active);

        // The stress stands; α follows, so that the state stays on the yield surface, where the substep was plastic.
        let loading = L::lt(zero, load_1 + load_2);
        let mut settled = next;
        turning.settle(&mut settled, radius);
        next.alpha = select3::<L>(loading, settled.alpha, next.alpha);

        let pick = |new: L, old: L| L::select(accept, new, old);
        now = State {
            s: select3::<L>(accept, next.s, now.s),
            p: pick(next.p, now.p),
            alpha: select3::<L>(accept, next.alpha, now.alpha),
            z: select3::<L>(accept, next.z, now.z),
            e: pick(next.e, now.e),
            ..now
        };
        let candidate = second.tangent(L::lt(zero, load_2));
        for (kept, new) in tangent.iter_mut().zip(candidate) {
            *kept = pick(new, *kept);
        }
        time = pick(time + share, time);
        let factor = (L::splat(0.81) * tolerance / error.max(L::splat(1e-30))).sqrt();
        let factor = factor.max(L::splat(0.1)).min(L::select(fine, L::splat(5.0), L::splat(0.7)));
        // Not-a-number keeps the second operand: such a substep is cut by ten.
        share = share * factor;
        active = L::and(active, L::lt(time, L::splat(1.0 - 1e-12)));
        if count >= c.max_substeps {
            failed = L::or(failed, active);
            break;
        }
    }
    let end = State {
        s: select3::<L>(plastic, now.s, elastic_end.s),
        p: L::select(plastic, now.p, elastic_end.p),
        alpha: now.alpha,
        z: now.z,
        alpha_in: now.alpha_in,
        e: e_end,
        g_0: start.g_0,
    };
    let pick = |i: usize| L::select(plastic, tangent[i], elastic_tangent[i]);
    (end, [pick(0), pick(1), pick(2), pick(3)], failed)
}

/// How the loading direction turns within a substep.
///
/// X = r − α has the length k = √⅔ m of the tiny yield surface and follows the strain direction within a stress-ratio
/// path of that length, which makes explicit substeps unstable beyond it. With everything that acts along n left
/// out, X₀ + Δr gives the direction at the end implicitly, as radial return does; the shares blend from the explicit
/// second-order direction (‖Δr‖ ≪ k) to that one (‖Δr‖ ≫ k).
struct Turning<L> {
    implicit: Deviator<L>,
    weight: L,
}

impl<L: Lane> Turning<L> {
    #[inline(always)]
    fn new(state: &State<L>, r: &Rates<L>, d: &Change<L>, over_x: L, radius: L) -> Self {
        let one = L::splat(1.0);
        let inv_p = one / state.p;
        let ratio = [state.s[0] * inv_p, state.s[1] * inv_p, state.s[2] * inv_p];
        let along = over_x * (r.x * (r.g + r.g) * dot(r.flow, r.n) * inv_p + r.reach);
        let push = [
            (d.s[0] - ratio[0] * d.p) * inv_p - d.alpha[0] + along * r.n[0],
            (d.s[1] - ratio[1] * d.p) * inv_p - d.alpha[1] + along * r.n[1],
            (d.s[2] - ratio[2] * d.p) * inv_p - d.alpha[2] + along * r.n[2],
        ];
        let xi2 = dot(push, push) / (radius * radius);
        let implicit = add(push, radius, r.n);
        Self { implicit, weight: xi2 / (one + xi2) }
    }

    /// Puts α where the state lies on the yield surface with the turned direction.
    #[inline(always)]
    fn settle(&self, state: &mut State<L>, radius: L) {
        let inv_p = L::splat(1.0) / state.p;
        let ratio = [state.s[0] * inv_p, state.s[1] * inv_p, state.s[2] * inv_p];
        let explicit = add(ratio, L::splat(-1.0), state.alpha);
        let keep = L::splat(1.0) - self.weight;
        let x = [
            keep * explicit[0] + self.weight * self.implicit[0],
            keep * explicit[1] + self.weight * self.implicit[1],
            keep * explicit[2] + self.weight * self.implicit[2],
        ];
        let scale = -(radius / dot(x, x).sqrt().max(L::splat(1e-14)));
        state.alpha = add(ratio, scale, x);
    }
}

struct Change<L> {
    s: Deviator<L>,
    p: L,
    alpha: Deviator<L>,
    z: Deviator<L>,
}

#[inline(always)]
fn moved<L: Lane>(state: &State<L>, change: &Change<L>, c: L, de_void: L) -> State<L> {
    State {
        s: add(state.s, c, change.s),
        p: state.p + c * change.p,
        alpha: add(state.alpha, c, change.alpha),
        z: add(state.z, c, change.z),
        e: state.e + de_void,
        ..*state
    }
}

/// Change of the state over a strain increment at constant rates, and the loading multiplier over x.
#[inline(always)]
fn derivative<L: Lane>(c: &Constants, state: &State<L>, r: &Rates<L>, de: Deviator<L>, dv: L) -> (Change<L>, L) {
    let over_x = r.multiplier_over_x(de, dv);
    let l = over_x * r.x;
    let two_g = r.g + r.g;
    let dilation = (-(l * r.d)).max(L::splat(0.0)) * L::splat(-c.c_z);
    let change = Change {
        s: [two_g * (de[0] - l * r.flow[0]), two_g * (de[1] - l * r.flow[1]), two_g * (de[2] - l * r.flow[2])],
        p: r.k * (dv - l * r.d),
        alpha: [over_x * r.back[0], over_x * r.back[1], over_x * r.back[2]], // (6)
        z: [
            dilation * (L::splat(c.z_max) * r.n[0] + state.z[0]), // (8)
            dilation * (L::splat(c.z_max) * r.n[1] + state.z[1]),
            dilation * (L::splat(c.z_max) * r.n[2] + state.z[2]),
        ],
    };
    (change, over_x)
}
