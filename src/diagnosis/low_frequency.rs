//! What every column passes alike: well below its first resonance a motion reaches each depth with the same amplitude and
//! without delay, whatever the profile. Errors of sensors show there even where the declared profile is poor.

mod column;
mod shots;

pub use column::travel_s;

use super::problem::{Motions, Problem};
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use realfft::num_complex::Complex;
use shots::{DEEPEST, Declared, FEWEST, Shot, ln_h};
use std::f64::consts::TAU;

type C64 = Complex<f64>;

/// Prior standard deviations of ln a/a₀, ξ − ξ₀ and κ − 1.
const SHAPE: [f64; 3] = [0.5, 0.05, 0.5];
/// Fall of χ² that each further parameter must bring.
const CHARGE: f64 = 16.0;
/// Steps of a fit, and of one without an event.
const STEPS: [usize; 2] = [10, 4];

/// What the low frequencies say about one output sensor against the input sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Passed {
    /// Index of the output sensor.
    pub output: usize,
    /// Wrong sign of the first or second component, or exchanged components; the identity is `[[1, 0], [0, 1]]`.
    pub reflection: [[f64; 2]; 2],
    /// ln of the gain, delay in s, corner of a high-pass in Hz, azimuth in rad; `None` where the records do not ask for it.
    pub errors: [Option<Error>; 4],
}

/// An estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Error {
    /// Value; that of the output sensor if the input sensor is right.
    pub value: f64,
    /// Standard deviation: the larger of the formal one and the jackknife's over events.
    pub deviation: f64,
}

/// Compares every output sensor of `problem` with the input sensor, from `low_hz` to about half the declared first resonance, and
/// with what the declared column makes of each event where `replays` tell.
///
/// ```text
/// Y(f)    = g e^{−2πifτ} / (1 − i f_h/f)² · h/h₀ (f) · R(φ) M · h₀ U                                   (1)
/// ln h    = a f² (1 − 2iξ) + κ/3 · (1 + r²)/(1 − r²) · a² f⁴ (1 − 4iξ)                               (2)
/// a₀      = (2π)² ∫_z^H m(z')/G(z') dz'       m the mass above z', r = travel times 0…z over 0…H      (3)
/// ```
///
/// (2) is the column's transfer function up to f⁴, real and positive but for damping, exact for a uniform one with κ = 1. Its
/// a, ξ and κ are free within wide priors around the declared ones, so that the declared profile is not trusted. M is the identity
/// or a reflection. The noise of each event is what (1) leaves of it.
///
/// h₀ U is the replay's motion: strong shaking makes soil soft and damps it, and lowers its resonance. a₀ of the event is then
/// its regression on f², and the event counts up to half its own resonance. Without a replay h₀ is (2) with (3), less the share
/// of noise in the input, which lowers a regression.
///
/// Limits: below the first resonance a delay and a low-pass of corner 1/(2πτ) are the same, and an error of an output sensor
/// is the opposite one of the input sensor; needs records with power there. A high-pass of the input sensor is one of f_h < 0, for which
/// (1) has (1 + i f_h/f)² in the place of its inverse.
/// Check:  `errors_of_a_sensor_are_found_under_a_profile_that_is_far_off`, `soil_that_gets_soft_is_no_late_clock`.
/// Source: Kramer (1996), Geotechnical Earthquake Engineering, section 7.2, for the uniform column.
pub fn passed(problem: &Problem, replays: Option<&Motions>, low_hz: f64) -> Vec<Passed> {
    let declared = Declared::new(problem, replays, low_hz);
    let shots = declared.shots();
    if shots.len() < FEWEST {
        return Vec::new();
    }
    let of = |(output, [_, ratio]): (usize, &[f64; 2])| {
        let comparison = Comparison { shots: &shots, output, ratio: *ratio, reflection: IDENTITY };
        (*ratio < DEEPEST).then(|| comparison.judged())
    };
    declared.shapes.iter().enumerate().filter_map(of).collect()
}

const IDENTITY: [[f64; 2]; 2] = [[1.0, 0.0], [0.0, 1.0]];

/// One output sensor against the input sensor.
struct Comparison<'a> {
    shots: &'a [Shot],
    output: usize,
    ratio: f64,
    reflection: [[f64; 2]; 2],
}

/// Unknowns of (1) and (2): ln a/a₀, ξ − ξ₀, κ − 1, then ln g, τ, f_h, φ.
const N: usize = 7;
/// Bounds of the unknowns to either side: beyond them a step has gone astray.
const BOUNDS: [f64; N] = [2.0, 0.5, 4.0, 3.0, 0.3, 1.0, 7.0];
/// Unknowns of the shape.
const N_SHAPE: usize = SHAPE.len();

/// A fit.
struct Fit {
    x: [f64; N],
    chi2: f64,
    deviations: [f64; N],
}

impl Comparison<'_> {
    fn judged(mut self) -> Passed {
        let n_component = self.shots[0].components;
        self.reflection = self.reflected();
        let can = [true, true, true, n_component > 1];
        let noise = self.noise(can);
        let everyone: Vec<usize> = (0..self.shots.len()).collect();
        let sets = (0..16usize).map(|bits| std::array::from_fn(|i| bits & (1 << i) != 0));
        let fits = sets.filter(|set: &[bool; 4]| set.iter().zip(can).all(|(s, c)| !s || c)).map(|set| {
            let fit = self.fit(set, &noise, &everyone, self.start(set), STEPS[0]);
            (fit.chi2 + CHARGE * set.iter().filter(|s| **s).count() as f64, set, fit)
        });
        let best = fits.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, set, fit)| (set, fit));
        let Some((set, fit)) = best else {
            return Passed { output: self.output, reflection: self.reflection, errors: [None; 4] };
        };
        let without: Vec<[f64; N]> = everyone
            .iter()
            .map(|left_out| {
                let others: Vec<usize> = everyone.iter().copied().filter(|e| e != left_out).collect();
                self.fit(set, &noise, &others, fit.x, STEPS[1]).x
            })
            .collect();
        let error = |i: usize| {
            let at = N_SHAPE + i;
            let values: Vec<f64> = without.iter().map(|x| x[at]).collect();
            let deviation = fit.deviations[at].max(jackknife(&values));
            set[i].then_some(Error { value: fit.x[at], deviation })
        };
        Passed { output: self.output, reflection: self.reflection, errors: std::array::from_fn(error) }
    }

    /// The reflection that is closer to the records than a rotation, if there is one.
    fn reflected(&self) -> [[f64; 2]; 2] {
        if self.shots[0].components < 2 {
            let product: f64 = self.pairs().map(|(y, u, weight)| weight * (y[0] * u[0].conj()).re).sum();
            return if product < 0.0 { [[-1.0, 0.0], [0.0, 1.0]] } else { IDENTITY };
        }
        let (mut cross, mut own) = ([[0.0; 2]; 2], [[0.0; 2]; 2]);
        for (y, u, weight) in self.pairs() {
            for i in 0..2 {
                for j in 0..2 {
                    cross[i][j] += weight * (y[i] * u[j].conj()).re;
                    own[i][j] += weight * (u[i] * u[j].conj()).re;
                }
            }
        }
        let determinant = own[0][0] * own[1][1] - own[0][1] * own[1][0];
        let inverse = [[own[1][1], -own[0][1]], [-own[1][0], own[0][0]]];
        let t: [[f64; 2]; 2] = std::array::from_fn(|i| {
            std::array::from_fn(|j| (cross[i][0] * inverse[0][j] + cross[i][1] * inverse[1][j]) / determinant)
        });
        let size: f64 = t.iter().flatten().map(|v| v * v).sum();
        if t[0][0] * t[1][1] - t[0][1] * t[1][0] > -0.25 * size {
            return IDENTITY;
        }
        let reflections = [
            [[-1.0, 0.0], [0.0, 1.0]],
            [[1.0, 0.0], [0.0, -1.0]],
            [[0.0, 1.0], [1.0, 0.0]],
            [[0.0, -1.0], [-1.0, 0.0]],
        ];
        let likeness =
            |m: &[[f64; 2]; 2]| -> f64 { m.iter().flatten().zip(t.iter().flatten()).map(|(m, t)| m * t).sum() };
        reflections.into_iter().max_by(|a, b| likeness(a).total_cmp(&likeness(b))).unwrap_or(IDENTITY)
    }

    /// (y, u, weight) of every bin, events weighing alike.
    fn pairs(&self) -> impl Iterator<Item = ([C64; 2], [C64; 2], f64)> {
        self.shots.iter().flat_map(|shot| {
            let passed = &shot.passed[self.output];
            let power: f64 = passed.iter().flatten().map(C64::norm_sqr).sum();
            shot.outputs[self.output].iter().zip(passed).map(move |(y, u)| (*y, *u, 1.0 / power))
        })
    }

    fn start(&self, set: [bool; 4]) -> [f64; N] {
        let mut x = [0.0; N];
        if set[3] {
            // A rotation may be far from none, so the angle starts where the records point.
            let (mut sin, mut cos) = (0.0, 0.0);
            for (y, u, weight) in self.pairs() {
                let u = self.seen(u);
                cos += weight * (y[0] * u[0].conj() + y[1] * u[1].conj()).re;
                sin += weight * (y[0] * u[1].conj() - y[1] * u[0].conj()).re;
            }
            x[6] = f64::atan2(sin, cos);
        }
        x
    }

    fn seen(&self, u: [C64; 2]) -> [C64; 2] {
        self.reflection.map(|row| u[0] * row[0] + u[1] * row[1])
    }

    /// (1) at bin `k` of `shot`.
    fn predicted(&self, shot: &Shot, k: usize, x: &[f64; N]) -> [C64; 2] {
        let f = shot.frequencies_hz[k];
        let [ln_a, xi, kappa, ln_g, tau, corner_hz, phi] = *x;
        let a0 = shot.a0[self.output] * f * f;
        let column = ln_h(a0, self.ratio, [ln_a, xi, kappa]) - ln_h(a0, self.ratio, [0.0; 3]);
        let stage = C64::new(1.0, -corner_hz.abs() / f);
        let passes = if corner_hz > 0.0 { stage.inv() } else { stage };
        let sensor = C64::new(ln_g, -TAU * f * tau).exp() * passes * passes;
        let factor = sensor * column.exp();
        let [u, v] = self.seen(shot.passed[self.output][k]);
        let (sin, cos) = phi.sin_cos();
        [factor * (u * cos + v * sin), factor * (v * cos - u * sin)] // (1)
    }

    /// Variance of a bin of each event under the model with the unknowns of `set`.
    fn noise(&self, set: [bool; 4]) -> Vec<f64> {
        let everyone: Vec<usize> = (0..self.shots.len()).collect();
        let powers = |shot: &Shot| shot.outputs[self.output].iter().flatten().map(C64::norm_sqr).sum::<f64>();
        let mut noise: Vec<f64> = self.shots.iter().map(powers).collect();
        let mut x = self.start(set);
        for _ in 0..STEPS[0] {
            x = self.fit(set, &noise, &everyone, x, 2).x;
            for (noise, shot) in noise.iter_mut().zip(self.shots) {
                let left: f64 = (0..shot.input.len())
                    .map(|k| self.residual(shot, k, &x).iter().map(C64::norm_sqr).sum::<f64>())
                    .sum();
                let count = (shot.components * shot.input.len()) as f64;
                // Two unknowns an event, whose share the few bins would otherwise hide.
                *noise = (left / (count - 2.0)).max(1e-9 * powers(shot) / count);
            }
        }
        noise
    }

    fn residual(&self, shot: &Shot, k: usize, x: &[f64; N]) -> [C64; 2] {
        let (measured, predicted) = (shot.outputs[self.output][k], self.predicted(shot, k, x));
        let second = if shot.components > 1 { measured[1] - predicted[1] } else { C64::default() };
        [measured[0] - predicted[0], second]
    }

    /// Gauss–Newton steps from `x` on the events `who`; χ² = Σ 2|r|²/S + priors.
    fn fit(&self, set: [bool; 4], noise: &[f64], who: &[usize], mut x: [f64; N], steps: usize) -> Fit {
        let is_free = |i: usize| i < N_SHAPE || set[i - N_SHAPE];
        let mut deviations = [0.0; N];
        for i in (0..N).filter(|i| !is_free(*i)) {
            x[i] = 0.0;
        }
        for _ in 0..steps {
            let (mut normal, mut gradient) = ([[0.0; N]; N], [0.0; N]);
            for i in 0..N {
                match SHAPE.get(i) {
                    Some(deviation) => {
                        normal[i][i] = deviation.powi(-2);
                        gradient[i] = -x[i] * deviation.powi(-2);
                    }
                    None => normal[i][i] = if is_free(i) { 1e-9 } else { 1.0 },
                }
            }
            for e in who {
                let shot = &self.shots[*e];
                for k in 0..shot.input.len() {
                    let residual = self.residual(shot, k, &x);
                    let columns: [[C64; 2]; N] = std::array::from_fn(|i| {
                        if !is_free(i) {
                            return [C64::default(); 2];
                        }
                        let mut moved = x;
                        moved[i] += DIFFERENCE;
                        let there = self.residual(shot, k, &moved);
                        [(residual[0] - there[0]) / DIFFERENCE, (residual[1] - there[1]) / DIFFERENCE]
                    });
                    let weight = 2.0 / noise[*e];
                    let product = |a: &[C64; 2], b: &[C64; 2]| weight * (a[0].conj() * b[0] + a[1].conj() * b[1]).re;
                    for i in 0..N {
                        gradient[i] += product(&columns[i], &residual);
                        for j in 0..N {
                            normal[i][j] += product(&columns[i], &columns[j]);
                        }
                    }
                }
            }
            let matrix = Mat::from_fn(N, N, |i, j| normal[i][j]);
            let Ok(factor) = matrix.llt(Side::Lower) else { break };
            let step = factor.solve(Mat::from_fn(N, 1, |i, _| gradient[i]));
            let inverse = factor.solve(Mat::<f64>::identity(N, N));
            for i in 0..N {
                x[i] += step[(i, 0)];
                deviations[i] = inverse[(i, i)].max(0.0).sqrt();
            }
            x.iter_mut().zip(BOUNDS).for_each(|(x, bound)| *x = x.clamp(-bound, bound));
        }
        let left = |e: &usize| -> f64 {
            let shot = &self.shots[*e];
            let of = |k: usize| self.residual(shot, k, &x).iter().map(C64::norm_sqr).sum::<f64>();
            (0..shot.input.len()).map(of).sum::<f64>() * 2.0 / noise[*e]
        };
        let prior: f64 = SHAPE.iter().zip(&x).map(|(deviation, x)| (x / deviation).powi(2)).sum();
        Fit { x, chi2: who.iter().map(left).sum::<f64>() + prior, deviations }
    }
}

/// Step of finite differences.
const DIFFERENCE: f64 = 1e-6;

/// Standard deviation from estimates that each lack one event.
pub fn jackknife(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    ((n - 1.0) / n * values.iter().map(|v| (v - mean).powi(2)).sum::<f64>()).sqrt()
}

#[cfg(test)]
mod tests;
