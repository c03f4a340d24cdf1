//! Screening: what each effect would gain with the nuisances free to follow, linearly.

use super::fit::{Fitter, Point, difference, gram, project};
use super::line;
use super::unknowns::{MAX_DEVIATIONS, Unknowns};
use crate::effects::Instance;
use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};
use rayon::prelude::*;

/// Strengths tried on either side of zero, in typical sizes.
const GRID: [f64; 4] = [0.4, 1.0, 2.0, 4.0];

/// A point with the derivatives of the nuisances: costs of other residuals, nuisances marginalised.
///
/// ```text
/// c(r) = min over δ of |r + J δ|² + |n + δ|² = |r|² + |n|² − bᵀ M b,   b = Jᵀ r + n,   M = (I + JᵀJ)⁻¹      (1)
/// ```
///
/// Nuisances at an end of their range, from which J drives them outward, stay there.
///
/// Limits: J is that of the point without the effect.
/// Check:  `marginal_costs_are_those_of_the_explicit_minimum`.
/// Source: Woodbury's identity; Pintelon and Schoukens (2012) for the cost.
pub struct Marginal {
    jacobian: Mat<f64>,
    factor: Option<Llt<f64>>,
    /// Nuisances of the point that are free to follow.
    nuisances: Vec<f64>,
    /// Σ n² of the others.
    held: f64,
}

impl Marginal {
    /// Derivatives of the nuisances at `point`, whose effects stay as they are.
    pub fn new(fitter: &Fitter<'_>, unknowns: &Unknowns<'_>, point: &Point) -> Self {
        let count = unknowns.nuisances.len();
        let which: Vec<usize> = (0..count).collect();
        Self::of(&fitter.jacobian(unknowns, point, &which), &point.x[..count], &point.residual)
    }

    fn of(jacobian: &Mat<f64>, nuisances: &[f64], residual: &[f64]) -> Self {
        let slopes = project(jacobian, residual);
        let is_held = |i: &usize| {
            let (n, slope) = (nuisances[*i], slopes[*i] + nuisances[*i]);
            n.abs() >= MAX_DEVIATIONS && n * slope < 0.0
        };
        let (held, free): (Vec<usize>, Vec<usize>) = (0..nuisances.len()).partition(is_held);
        let jacobian = Mat::from_fn(jacobian.nrows(), free.len(), |i, j| jacobian[(i, free[j])]);
        let normal = gram(&jacobian, &jacobian) + Mat::<f64>::identity(free.len(), free.len());
        let of = |which: &[usize]| which.iter().map(|i| nuisances[*i]).collect::<Vec<f64>>();
        let held = of(&held).iter().map(|n| n * n).sum();
        Self { factor: normal.llt(Side::Lower).ok(), jacobian, nuisances: of(&free), held }
    }

    /// (1).
    pub fn cost(&self, residual: &[f64]) -> f64 {
        let mut b = project(&self.jacobian, residual);
        b.iter_mut().zip(&self.nuisances).for_each(|(b, n)| *b += n);
        let own = dot(residual, residual) + dot(&self.nuisances, &self.nuisances) + self.held;
        own - dot(&b, &self.solved(&b))
    }

    /// aᵀ C⁻¹ b with C = I + J Jᵀ.
    pub fn product(&self, a: &[f64], b: &[f64]) -> f64 {
        let (pa, pb) = (project(&self.jacobian, a), project(&self.jacobian, b));
        dot(a, b) - dot(&pa, &self.solved(&pb))
    }

    /// Effect coordinates that minimise (1) for residuals `r` + `columns`·δ, and their normal matrix.
    pub fn score(&self, residual: &[f64], columns: &Mat<f64>) -> Option<(Vec<f64>, Mat<f64>)> {
        let p = columns.ncols();
        let cross = gram(&self.jacobian, columns);
        let mut b = project(&self.jacobian, residual);
        b.iter_mut().zip(&self.nuisances).for_each(|(b, n)| *b += n);
        let solved = self.solved(&b);
        let direct = project(columns, residual);
        let gradient: Vec<f64> =
            (0..p).map(|j| direct[j] - cross.col(j).iter().zip(&solved).map(|(c, s)| c * s).sum::<f64>()).collect();
        let mut normal = gram(columns, columns);
        if let Some(factor) = &self.factor {
            let reduced = factor.solve(&cross);
            normal -= gram(&cross, &reduced);
        }
        let trace: f64 = (0..p).map(|i| normal[(i, i)]).sum();
        for i in 0..p {
            normal[(i, i)] += 1e-9 * trace + f64::MIN_POSITIVE;
        }
        let step = normal.llt(Side::Lower).ok()?.solve(Mat::from_fn(p, 1, |i, _| -gradient[i]));
        Some(((0..p).map(|i| step[(i, 0)]).collect(), normal))
    }

    fn solved(&self, b: &[f64]) -> Vec<f64> {
        match &self.factor {
            Some(factor) => {
                let x = factor.solve(Mat::from_fn(b.len(), 1, |i, _| b[i]));
                (0..b.len()).map(|i| x[(i, 0)]).collect()
            }
            None => vec![0.0; b.len()],
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// A screened effect.
#[derive(Debug, Clone)]
pub struct Screened {
    /// Index among the instances.
    pub instance: usize,
    /// Its coordinates where it gains most.
    pub start: Vec<f64>,
    /// Fall of the marginal cost, before any charge.
    pub fall: f64,
}

/// How an effect is screened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pass {
    /// A grid over the strength, for large effects.
    Grid,
    /// One Gauss–Newton step from its absence.
    Score,
}

/// Screens every instance at `point`.
pub fn screen(
    fitter: &Fitter<'_>,
    unknowns: &Unknowns<'_>,
    point: &Point,
    instances: &[Instance],
    pass: Pass,
) -> (Marginal, Vec<Screened>) {
    let marginal = Marginal::new(fitter, unknowns, point);
    let reference = marginal.cost(&point.residual);
    let found = instances
        .par_iter()
        .enumerate()
        .filter_map(|(index, instance)| {
            let trial = Trial { fitter, unknowns, point, marginal: &marginal, instance };
            let (start, cost) = trial.best(pass)?;
            Some(Screened { instance: index, start, fall: reference - cost })
        })
        .collect();
    (marginal, found)
}

/// One instance tried on top of a point.
struct Trial<'a> {
    fitter: &'a Fitter<'a>,
    unknowns: &'a Unknowns<'a>,
    point: &'a Point,
    marginal: &'a Marginal,
    instance: &'a Instance,
}

impl Trial<'_> {
    fn at(&self, coordinates: &[f64]) -> Option<Point> {
        with_effect(self.fitter, self.unknowns, self.point, self.instance, coordinates)
    }

    /// Coordinates of least marginal cost, and that cost.
    fn best(&self, pass: Pass) -> Option<(Vec<f64>, f64)> {
        let bounds = self.instance.bounds();
        let start = self.instance.zero().unwrap_or_else(|| self.instance.start());
        if line::hidden(self.instance) > 0.0 && bounds.len() == 2 {
            return self.best_line(&start, &bounds);
        }
        let mut tries: Vec<Vec<f64>> = Vec::new();
        if bounds.is_empty() {
            tries.push(Vec::new());
        } else {
            if pass == Pass::Grid {
                let [low, high] = bounds[0];
                let typical = self.instance.free[0].size;
                for size in GRID.into_iter().flat_map(|g| [g, -g]) {
                    let mut x = start.clone();
                    x[0] = (start[0] + size * typical).clamp(low, high);
                    if x[0] != start[0] && !tries.contains(&x) {
                        tries.push(x);
                    }
                }
            }
            tries.extend(self.scored(&start, &bounds));
        }
        let costs = tries.into_iter().filter_map(|x| {
            let cost = self.marginal.cost(&self.at(&x)?.residual);
            Some((x, cost))
        });
        costs.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// A line: its frequency from where the residual stands out, its amplitude by score.
    fn best_line(&self, start: &[f64], bounds: &[[f64; 2]]) -> Option<(Vec<f64>, f64)> {
        let array = &self.fitter.scene.problem.array;
        let name = self.instance.target.get("sensor").and_then(toml::Value::as_str);
        let sensor = array.outputs.iter().position(|s| Some(s.as_str()) == name);
        let frequency_hz = line::strongest(self.fitter, self.point, sensor)?;
        let tries = (-3..=3).filter_map(|k| {
            let at = (frequency_hz + 0.01 * f64::from(k)).clamp(bounds[1][0], bounds[1][1]);
            let x = self.scored(&[start[0], at], bounds)?;
            let cost = self.marginal.cost(&self.at(&x)?.residual);
            Some((x, cost))
        });
        tries.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The Gauss–Newton step of the strength; what only shapes the effect stays.
    fn scored(&self, start: &[f64], bounds: &[[f64; 2]]) -> Option<Vec<f64>> {
        let column = derivative(self.fitter, self.unknowns, self.point, self.instance, start)?;
        let (delta, _) = self.marginal.score(&self.point.residual, &column)?;
        let mut x = start.to_vec();
        // A step to or across zero would say nothing about the effect.
        x[0] = (x[0] + delta[0]).clamp(bounds[0][0], bounds[0][1]);
        Some(x)
    }
}

/// `point` with `instance` at `coordinates` on top; `None` where the column cannot be built.
pub(super) fn with_effect(
    fitter: &Fitter<'_>,
    unknowns: &Unknowns<'_>,
    point: &Point,
    instance: &Instance,
    coordinates: &[f64],
) -> Option<Point> {
    let mut effects = unknowns.effects.clone();
    effects.push(instance.clone());
    let unknowns = Unknowns { effects, ..*unknowns };
    let x: Vec<f64> = point.x.iter().chain(coordinates).copied().collect();
    let found = fitter.at(&unknowns, &x, Some(&point.responses)).ok()?;
    found.cost.is_finite().then_some(found)
}

/// ∂ρ/∂strength of `instance` at `start`, a column.
pub(super) fn derivative(
    fitter: &Fitter<'_>,
    unknowns: &Unknowns<'_>,
    point: &Point,
    instance: &Instance,
    start: &[f64],
) -> Option<Mat<f64>> {
    let free = instance.free.first()?;
    let step = 0.1 * free.size;
    let step = if start[0] + step > free.parameter.bounds()[1] { -step } else { step };
    let mut moved = start.to_vec();
    moved[0] += step;
    let found = with_effect(fitter, unknowns, point, instance, &moved)?;
    let column = difference(&found, point, step);
    Some(Mat::from_fn(column.len(), 1, |i, _| column[i]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marginal_costs_are_those_of_the_explicit_minimum() {
        let jacobian = Mat::from_fn(5, 2, |i, j| ((i + 1) as f64 * (j as f64 + 0.7)).sin());
        let nuisances = vec![0.4, -1.1];
        let r = [0.3, -0.9, 1.4, 0.2, -0.5];
        let marginal = Marginal::of(&jacobian, &nuisances, &r);
        let explicit = |d: [f64; 2]| -> f64 {
            let fit: f64 = (0..5).map(|i| (r[i] + jacobian[(i, 0)] * d[0] + jacobian[(i, 1)] * d[1]).powi(2)).sum();
            fit + (nuisances[0] + d[0]).powi(2) + (nuisances[1] + d[1]).powi(2)
        };
        let mut least = f64::INFINITY;
        for i in -400..=400 {
            for j in -400..=400 {
                least = least.min(explicit([i as f64 * 0.01, j as f64 * 0.01]));
            }
        }
        let cost = marginal.cost(&r);
        assert!(cost <= least && least - cost < 1e-3, "{cost} {least}");
        // Adding a column and minimising over it too can only lower the cost, by what the score says.
        let column = Mat::from_fn(5, 1, |i, _| (i as f64).cos());
        let (step, _) = marginal.score(&r, &column).unwrap();
        let moved = |s: f64| {
            let with: Vec<f64> = (0..5).map(|i| r[i] + s * column[(i, 0)]).collect();
            marginal.cost(&with)
        };
        assert!(moved(step[0]) < moved(step[0] + 0.01) && moved(step[0]) < moved(step[0] - 0.01));
        assert!(moved(step[0]) < cost);
    }

    #[test]
    fn a_nuisance_that_would_leave_its_range_does_not_take_what_an_effect_explains() {
        let jacobian = Mat::from_fn(4, 2, |i, j| if i == j { 50.0 } else { 0.0 });
        let r = [30.0, 1.0, 0.2, -0.1];
        let same = Mat::from_fn(4, 1, |i, _| if i == 0 { 5.0 } else { 0.0 });
        let strength = |n: f64| Marginal::of(&jacobian, &[n, 0.0], &r).score(&r, &same).unwrap().0[0];
        assert!((strength(-MAX_DEVIATIONS) + 6.0).abs() < 1e-6);
        // A nuisance that is free to follow does.
        let free = Marginal::of(&jacobian, &[MAX_DEVIATIONS, 0.0], &r);
        assert!(free.cost(&r) < 12.0 && Marginal::of(&jacobian, &[-MAX_DEVIATIONS, 0.0], &r).cost(&r) > 900.0);
    }
}
