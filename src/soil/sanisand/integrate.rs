//! Integration over a strain increment: exact elastic exit, then modified Euler with error control.

use super::rates::{Change, Stiffness};
use super::tensor::Tensor;
use super::{Placed, Refusal, State};

/// Largest relative error of a substep.
const TOLERANCE: f64 = 1e-5;
const MAX_SUBSTEPS: usize = 2000;
const MIN_FRACTION: f64 = 1e-5;
/// p̄ below this share of p_t counts as no confinement.
const MIN_PRESSURE: f64 = 1e-3;

impl Placed {
    /// End state and stiffness after `strain` from `start`.
    pub(super) fn integrate(&self, start: &State, strain: Tensor) -> Result<(State, Stiffness), Refusal> {
        let p_bar = start.stress.trace() / 3.0 + self.p_t;
        let (shear, bulk) = self.moduli(p_bar, start.void_ratio);
        let elastic = strain.deviator() * (2.0 * shear) + Tensor::UNIT * (bulk * strain.trace());
        let exit = self.elastic_share(start, p_bar, elastic);
        let mut state = *start;
        if exit > 0.0 {
            state.stress = state.stress + elastic * exit;
            state.void_ratio -= (1.0 + state.void_ratio) * strain.trace() * exit;
        }
        if exit >= 1.0 {
            self.admissible(&state)?;
            return Ok((state, Stiffness { shear, bulk, flow: None }));
        }
        let rest = strain * (1.0 - exit);
        let mut done = 0.0;
        let mut fraction: f64 = 1.0;
        for _ in 0..MAX_SUBSTEPS {
            fraction = fraction.min(1.0 - done);
            self.turn(&mut state);
            let part = rest * fraction;
            let first = self.plastic_change(&state, &self.flow(&state), part);
            let middle = advanced(&state, &first);
            if self.admissible(&middle).is_err() {
                fraction *= 0.25;
                if fraction < MIN_FRACTION {
                    return Err(Refusal::NoConfinement);
                }
                continue;
            }
            let second = self.plastic_change(&middle, &self.flow(&middle), part);
            let error = self.error(&state, &first, &second);
            if error > TOLERANCE && fraction > MIN_FRACTION {
                fraction = (fraction * (0.9 * (TOLERANCE / error).sqrt()).max(0.1)).max(MIN_FRACTION);
                continue;
            }
            state = advanced(&state, &mean(&first, &second));
            self.admissible(&state)?;
            self.recentre(&mut state);
            done += fraction;
            if done >= 1.0 - 1e-12 {
                let flow = self.flow(&state);
                return Ok((state, Stiffness { shear: flow.shear, bulk: flow.bulk, flow: Some(flow) }));
            }
            fraction *= (0.9 * (TOLERANCE / error.max(1e-16)).sqrt()).clamp(0.2, 4.0);
        }
        Err(Refusal::TooManySubsteps)
    }

    /// Share of the elastic stress change `elastic` that stays inside the yield surface: the larger root of
    /// ‖x + t y‖² = ⅔ m² (p̄ + t Δp)², x = s − p̄ α, y = Δs − Δp α.
    fn elastic_share(&self, state: &State, p_bar: f64, elastic: Tensor) -> f64 {
        let size = 2.0 / 3.0 * self.law.m * self.law.m;
        let dp = elastic.trace() / 3.0;
        let x = state.stress.deviator() - state.alpha * p_bar;
        let y = elastic.deviator() - state.alpha * dp;
        let a = y.dot(y) - size * dp * dp;
        let b = x.dot(y) - size * p_bar * dp;
        let mut c = x.dot(x) - size * p_bar * p_bar;
        if c > -1e-9 * size * p_bar * p_bar {
            c = 0.0;
        }
        if a <= 0.0 {
            return if b > 0.0 && c == 0.0 { 0.0 } else { 1.0 };
        }
        let root = ((-b + (b * b - a * c).max(0.0).sqrt()) / a).max(0.0);
        root.min(1.0)
    }

    /// Moves α_in to α at a reversal.
    fn turn(&self, state: &mut State) {
        if (state.alpha - state.alpha_in).dot(self.direction(state)) < 0.0 {
            state.alpha_in = state.alpha;
        }
    }

    /// Shifts α so that the stress lies on the yield surface again; the stress is left alone.
    fn recentre(&self, state: &mut State) {
        let p_bar = state.stress.trace() / 3.0 + self.p_t;
        let n = self.direction(state);
        state.alpha = state.stress.deviator() * (1.0 / p_bar) - n * ((2.0f64 / 3.0).sqrt() * self.law.m);
    }

    fn admissible(&self, state: &State) -> Result<(), Refusal> {
        let p_bar = state.stress.trace() / 3.0 + self.p_t;
        if !p_bar.is_finite() || !state.stress.0[3].is_finite() {
            return Err(Refusal::NotFinite);
        }
        if p_bar < MIN_PRESSURE * self.p_t { Err(Refusal::NoConfinement) } else { Ok(()) }
    }

    fn error(&self, state: &State, first: &Change, second: &Change) -> f64 {
        let p_bar = state.stress.trace() / 3.0 + self.p_t;
        let stress = 0.5 * (second.stress - first.stress).norm() / p_bar;
        let alpha = 0.5 * (second.alpha - first.alpha).norm();
        let fabric = 0.5 * (second.fabric - first.fabric).norm() / self.law.z_max.max(1.0);
        stress.max(alpha).max(fabric)
    }
}

fn advanced(state: &State, change: &Change) -> State {
    State {
        stress: state.stress + change.stress,
        alpha: state.alpha + change.alpha,
        fabric: state.fabric + change.fabric,
        alpha_in: state.alpha_in,
        void_ratio: state.void_ratio + change.void_ratio,
    }
}

fn mean(a: &Change, b: &Change) -> Change {
    Change {
        stress: (a.stress + b.stress) * 0.5,
        alpha: (a.alpha + b.alpha) * 0.5,
        fabric: (a.fabric + b.fabric) * 0.5,
        void_ratio: 0.5 * (a.void_ratio + b.void_ratio),
    }
}
