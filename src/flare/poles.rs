//! The best linear model of given size that the latent equations can hold: damped oscillators in parallel, by rollout.
//!
//! Each pair of states is one complex oscillator driven by the base, stepped exactly as the rollout steps it,
//!
//! ```text
//! ζ_{t+1} = R(μ) ζ_t + g_0(μ) u_t + g_½(μ) u_{t+½} + g_1(μ) u_{t+1},   R(μ) = 1 + μ + μ²/2 + μ³/6 + μ⁴/24       (1)
//! ```
//!
//! and responses are linear in the states, `p ≈ D s`. For given poles μ the best D is a regression, so only the poles are
//! searched: Levenberg–Marquardt on the projected residual, with the derivative of D left out (Kaufman).
//!
//! Modes too fast for the step follow the base at once, and so does the soil near the base, but the decoder does not see
//! `u`. Poles at the zeros of R carry it there: their states hold combinations of `u_{t−1}, u_{t−½}, u_t` and nothing older.
//!
//! Limits: local search from poles spread over the band. Check: a system of two oscillators is found to its poles.

use super::case::Case;
use super::ridge::Regression;
use crate::error::Result;
use crate::numerics::spill::{Spill, Values};
use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, c64};

/// The zeros of R in the upper half plane.
pub const MEMORY: [c64; 2] = [c64::new(-1.729_444_231, 0.888_974_376), c64::new(-0.270_555_769, 2.504_775_904)];

/// Largest modulus of R(μ).
const LARGEST: f64 = 0.995;
/// Rounds of the search.
const N_ROUND: usize = 40;
/// Relative step of the numerical derivatives of the states.
const NUDGE: f64 = 1e-5;

/// R(μ) and the gains of the input at the beginning, the middle and the end of a step, eq. (1).
pub fn step_of(mu: c64) -> (c64, [c64; 3]) {
    let one = c64::new(1.0, 0.0);
    let (m2, m3) = (mu * mu, mu * mu * mu);
    let r = one + mu + m2 * 0.5 + m3 * (1.0 / 6.0) + m2 * m2 * (1.0 / 24.0);
    let g_0 = (one + mu + m2 * 0.5 + m3 * 0.25) * (1.0 / 6.0);
    let g_half = (one * 4.0 + mu * 2.0 + m2 * 0.5) * (1.0 / 6.0);
    (r, [g_0, g_half, one * (1.0 / 6.0)])
}

/// States of one oscillator through a case that starts from rest.
pub fn simulate(mu: c64, case: &Case) -> Vec<c64> {
    let (r, g) = step_of(mu);
    let mut zeta = c64::new(0.0, 0.0);
    let mut series = vec![zeta];
    for t in 1..case.u.len() {
        let u = [case.u[t - 1], case.u_half[t - 1], case.u[t]].map(f64::from);
        zeta = r * zeta + g[0] * u[0] + g[1] * u[1] + g[2] * u[2];
        series.push(zeta);
    }
    series
}

/// Responses of one case by spatial mode, `[n_step × n_mode]`.
pub struct Reduced {
    /// Column by column.
    values: Values<f64>,
    n_mode: usize,
}

impl Reduced {
    /// # Errors
    /// When `spill` cannot keep them.
    pub fn new(rows: &Mat<f64>, spill: &Spill) -> Result<Self> {
        let values = rows.col_iter().flat_map(|column| column.iter().copied()).collect();
        Ok(Self { values: spill.keep(values)?, n_mode: rows.ncols() })
    }

    /// They themselves.
    pub fn rows(&self) -> MatRef<'_, f64> {
        MatRef::from_column_major_slice(&self.values, self.values.len() / self.n_mode.max(1), self.n_mode)
    }
}

/// Poles of `n` oscillators, beside those of `memory`, that predict `responses` best.
///
/// # Errors
/// When the responses are too poor for a regression.
pub fn search(n: usize, memory: &[c64], cases: &[Case], responses: &[Reduced], weight: &[f32]) -> Result<Vec<c64>> {
    let mut poles: Vec<c64> = (0..n)
        .map(|k| {
            let omega = 0.25 * (10.0_f64).powf((k as f64 + 0.5) / n as f64);
            c64::new(-0.12 * omega, omega)
        })
        .collect();
    let mut damping = 1e-2;
    let mut best = Fit::new(&poles, memory, cases, responses, weight)?;
    for _ in 0..N_ROUND {
        let trial = best.moved(&poles, damping);
        let fit =
            if trial.iter().all(is_stable) { Some(Fit::new(&trial, memory, cases, responses, weight)?) } else { None };
        match fit.filter(|f| f.residual < best.residual) {
            Some(fit) => {
                let gain = 1.0 - fit.residual / best.residual;
                (poles, best) = (trial, fit);
                damping = (damping * 0.3).max(1e-9);
                if gain < 1e-5 {
                    break;
                }
            }
            None if damping > 1e6 => break,
            None => damping *= 5.0,
        }
    }
    Ok(poles)
}

fn is_stable(mu: &c64) -> bool {
    step_of(*mu).0.norm() < LARGEST && mu.im > 1e-3 && mu.im < 2.8 && mu.re < 0.5
}

/// The regression at given poles and its first derivatives by them.
struct Fit {
    residual: f64,
    normal: Mat<f64>,
    slope: Mat<f64>,
}

impl Fit {
    fn new(poles: &[c64], memory: &[c64], cases: &[Case], responses: &[Reduced], weight: &[f32]) -> Result<Self> {
        let (n_parameter, n_state) = (2 * poles.len(), 2 * (poles.len() + memory.len()));
        let n_mode = responses[0].n_mode;
        // columns: the states, then for each parameter the derivatives of the two states it moves
        let n_column = n_state + 2 * n_parameter;
        let mut gram = Mat::<f64>::zeros(n_column, n_column);
        let mut cross = Mat::<f64>::zeros(n_column, n_mode);
        let mut power = 0.0;
        for ((case, p), weight) in cases.iter().zip(responses).zip(weight) {
            let (columns, p) = (columns(poles, memory, case), p.rows());
            let scale = faer::Scale(f64::from(*weight));
            gram += scale * (columns.transpose() * &columns);
            cross += scale * (columns.transpose() * p);
            power += f64::from(*weight) * p.squared_norm_l2();
        }
        let states = gram.submatrix(0, 0, n_state, n_state);
        let lift = 1e-9 * (0..n_state).map(|i| states[(i, i)]).sum::<f64>() / n_state as f64;
        let lifted = states + faer::Scale(lift.max(f64::MIN_POSITIVE)) * Mat::<f64>::identity(n_state, n_state);
        let moment = cross.subrows(0, n_state);
        let decode = lifted.partial_piv_lu().solve(moment); // Dᵀ, [n_state × n_mode]
        let residual =
            power - 2.0 * trace_product(&decode, &moment.to_owned()) + trace_product(&decode, &(states * &decode));

        let metric = &decode * decode.transpose();
        let unexplained = (&cross - gram.subcols(0, n_state) * &decode) * decode.transpose(); // [column × state]
        let state_of = |parameter: usize, part: usize| (parameter / 2) * 2 + part;
        let column_of = |parameter: usize, part: usize| n_state + 2 * parameter + part;
        let parts = || (0..2).flat_map(|a| (0..2).map(move |b| (a, b)));
        let normal = Mat::from_fn(n_parameter, n_parameter, |j, k| {
            parts()
                .map(|(a, b)| metric[(state_of(j, a), state_of(k, b))] * gram[(column_of(j, a), column_of(k, b))])
                .sum()
        });
        let slope =
            Mat::from_fn(n_parameter, 1, |j, _| (0..2).map(|a| unexplained[(column_of(j, a), state_of(j, a))]).sum());
        Ok(Self { residual, normal, slope })
    }

    /// The poles after one damped Gauss–Newton step (parameters: real and imaginary part, relative to the modulus).
    fn moved(&self, poles: &[c64], damping: f64) -> Vec<c64> {
        let n = self.normal.nrows();
        let floor = 1e-12 * (0..n).map(|i| self.normal[(i, i)]).fold(0.0, f64::max).max(f64::MIN_POSITIVE);
        let damped = Mat::from_fn(n, n, |i, j| {
            self.normal[(i, j)] + if i == j { damping * self.normal[(i, i)] + floor } else { 0.0 }
        });
        let step = damped.partial_piv_lu().solve(&self.slope);
        let change = |i: usize, mu: c64| step[(i, 0)].clamp(-0.3, 0.3) * mu.norm();
        poles.iter().enumerate().map(|(k, mu)| mu + c64::new(change(2 * k, *mu), change(2 * k + 1, *mu))).collect()
    }
}

/// States and their derivatives by the parameters through one case, `[n_step × n_column]`.
fn columns(poles: &[c64], memory: &[c64], case: &Case) -> Mat<f64> {
    let mut series: Vec<Vec<f64>> = Vec::new();
    let mut push = |zeta: &[c64]| {
        series.push(zeta.iter().map(|z| z.re).collect());
        series.push(zeta.iter().map(|z| z.im).collect());
    };
    let states: Vec<Vec<c64>> = poles.iter().chain(memory).map(|mu| simulate(*mu, case)).collect();
    states.iter().for_each(|s| push(s));
    for (mu, plain) in poles.iter().zip(&states) {
        for direction in [c64::new(1.0, 0.0), c64::new(0.0, 1.0)] {
            let nudged = simulate(mu + direction * (NUDGE * mu.norm()), case);
            let slope: Vec<c64> = nudged.iter().zip(plain).map(|(a, b)| (a - b) * (1.0 / NUDGE)).collect();
            push(&slope);
        }
    }
    Mat::from_fn(case.u.len(), series.len(), |t, j| series[j][t])
}

fn trace_product(a: &Mat<f64>, b: &Mat<f64>) -> f64 {
    (0..a.ncols()).map(|j| (0..a.nrows()).map(|i| a[(i, j)] * b[(i, j)]).sum::<f64>()).sum()
}

/// Adds the rows of two tables of equal height to a regression of the second on the first.
pub fn add_rows(regression: &mut Regression, x: &Mat<f64>, y: &Mat<f64>, weight: f64) {
    let row = |m: &Mat<f64>, t: usize| (0..m.ncols()).map(|j| m[(t, j)]).collect::<Vec<f64>>();
    (0..x.nrows()).for_each(|t| regression.add(&row(x, t), &row(y, t), weight));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random::stream;
    use rand::RngExt;

    #[test]
    fn the_memory_poles_forget_everything_older_than_one_step() {
        assert!(MEMORY.iter().all(|mu| step_of(*mu).0.norm() < 1e-8));
    }

    #[test]
    fn the_poles_of_two_oscillators_are_found() {
        let mut random = stream(5, "poles test");
        let case = |n: usize, random: &mut rand_chacha::ChaCha12Rng| {
            let mut draw = |n: usize| (0..n).map(|_| random.random::<f32>() - 0.5).collect::<Vec<f32>>();
            Case {
                id: "a".into(),
                u: draw(n).into(),
                u_half: draw(n - 1).into(),
                dense: vec![].into(),
                sparse: vec![].into(),
            }
        };
        let cases = [case(300, &mut random), case(300, &mut random)];
        let truth = [c64::new(-0.04, 0.7), c64::new(-0.2, 1.6)];
        let responses: Vec<Reduced> = cases
            .iter()
            .map(|case| {
                let states: Vec<Vec<c64>> = truth.iter().map(|mu| simulate(*mu, case)).collect();
                let rows = Mat::from_fn(300, 3, |t, j| {
                    (0..2).map(|k| states[k][t].re * (j as f64 - 0.7) + states[k][t].im * (1.0 + (j * k) as f64)).sum()
                });
                Reduced::new(&rows, &Spill::none()).expect("kept")
            })
            .collect();
        let poles = search(2, &[], &cases, &responses, &[1.0, 1.0]).expect("regular");
        for (found, exact) in poles.iter().zip(&truth) {
            assert!((found - exact).norm() < 1e-4, "{poles:?}");
        }
    }
}
