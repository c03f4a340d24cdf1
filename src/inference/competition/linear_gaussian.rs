//! The competition in an array that is linear, with normal noise and priors, where all that it is to say is known exactly.

use super::super::algebra::{self, Quadratic};
use super::super::made_up::{Truth, Uniform, as_declared, in_competition, problem};
use super::super::posterior::{Fit, rows_of};
use super::super::weights::Rows;
use super::null::Null;
use super::proposals::{Direction, Linear};
use crate::numerics::random;
use faer::Mat;
use rand_distr::{Distribution, StandardNormal};

/// Of so many residuals one is taken, with their weight: few enough for a dense covariance of all.
const THINNED: usize = 24;

/// An array of which records are exactly linear in the coordinates of a model and the strengths of candidates.
struct Array<'c, 'a> {
    fit: &'c Fit<'a>,
    directions: &'c [Direction],
    /// Slopes of the coordinates, then of the strengths in units of their nodes.
    slopes: Vec<Vec<f64>>,
    /// Standard deviations of the priors of both.
    deviations: Vec<f64>,
    bounds: Vec<[f64; 2]>,
    /// ln of the prior of each candidate.
    ln_prior: Vec<f64>,
}

fn thinned(rows: &Rows) -> Vec<f64> {
    rows.iter().flatten().step_by(THINNED).map(|r| (THINNED as f64).sqrt() * r).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl<'c, 'a> Array<'c, 'a> {
    /// Coordinates of the model.
    fn n(&self) -> usize {
        self.fit.x.len()
    }

    /// Coordinates and the strength of candidate `i`.
    fn with(&self, i: usize) -> Vec<usize> {
        (0..self.n()).chain([self.n() + i]).collect()
    }

    /// Residuals of a draw: noise, coordinates from their prior, and a candidate `added` at this strength.
    fn drawn(&self, seed: u64, added: Option<(usize, f64)>) -> Vec<f64> {
        let mut normal = StandardNormal.sample_iter(random::stream(seed, "records of a linear array"));
        let mut next = || -> f64 { normal.next().unwrap() };
        let mut rows: Vec<f64> = self.slopes[0].iter().map(|_| next()).collect();
        let moved: Vec<f64> = self.deviations[..self.n()].iter().map(|sd| sd * next()).collect();
        // What is there and not predicted is in residuals with the other sign.
        let added = added.map(|(i, strength)| (self.n() + i, strength));
        for (k, value) in moved.into_iter().enumerate().chain(added) {
            rows.iter_mut().zip(&self.slopes[k]).for_each(|(r, slope)| *r -= value * slope);
        }
        rows
    }

    /// The linear problem of these residuals.
    fn linear(&self, rows: &[f64]) -> Linear<'c, 'a> {
        let known = |i: usize, j: usize| if i == j { self.deviations[i].powi(-2) } else { 0.0 };
        let count = self.slopes.len();
        let density = Quadratic {
            a: Mat::from_fn(count, count, |i, j| dot(&self.slopes[i], &self.slopes[j]) + known(i, j)),
            gradient: self.gradient(rows),
            bounds: self.bounds.clone(),
            size: self.deviations.clone(),
        };
        Linear::of(self.fit, self.directions, density).unwrap()
    }

    fn gradient(&self, rows: &[f64]) -> Vec<f64> {
        self.slopes.iter().map(|slope| -dot(slope, rows)).collect()
    }
}

fn in_array(check: impl Fn(&Array<'_, '_>)) {
    let problem = problem(&Truth { events: 2, ..Truth::default() });
    in_competition(&problem, &Uniform(&problem), as_declared, |competition| {
        let fit = &competition.fits[0];
        let directions = competition.directions(&competition.fitter, fit);
        let linear = Linear::new(&competition.fitter, fit, &directions).unwrap();
        let mut bounds = linear.density.bounds.clone();
        // No draw comes to an end of what is declared: there densities are not normal.
        bounds[..fit.x.len()].fill([f64::NEG_INFINITY, f64::INFINITY]);
        check(&Array {
            fit,
            directions: &directions,
            slopes: rows_of(&fit.slopes)
                .iter()
                .chain(directions.iter().map(|d| &d.change))
                .map(|r| thinned(r))
                .collect(),
            deviations: linear.density.size.clone(),
            bounds,
            ln_prior: competition.ln_priors(&linear),
        });
    });
}

#[test]
fn p_values_of_what_chance_brings_are_uniform() {
    in_array(|array| {
        let mut linear = array.linear(&array.drawn(0, None));
        let null = Null::of(&linear, &array.ln_prior).unwrap();
        let times = 1000;
        let mut p_value = |seed| {
            linear.density.gradient = array.gradient(&array.drawn(seed, None));
            let none = linear.proposal(&[]).unwrap().log_posterior;
            let odds = |i: usize| Some(linear.proposal(&[i])?.log_posterior + array.ln_prior[i] - none);
            null.p_value((0..array.directions.len()).filter_map(odds).fold(f64::NEG_INFINITY, f64::max))
        };
        let p_values: Vec<f64> = (0..times).map(&mut p_value).collect();
        // Within three standard deviations of the share of uniform numbers; where no candidate gains, p is one, and never too small.
        for (level, is_exact) in [(0.02, true), (0.05, true), (0.1, true), (0.25, false), (0.5, false), (0.75, false)] {
            let share = p_values.iter().filter(|p| **p <= level).count() as f64 / times as f64;
            let deviation = (level * (1.0 - level) / times as f64).sqrt();
            println!("p ≤ {level}: {share}");
            assert!(share < level + 3.0 * deviation, "{level}: {share}");
            assert!(!is_exact || share > level - 3.0 * deviation, "{level}: {share}");
        }
    });
}

#[test]
fn evidence_is_the_normal_density_of_all_records() {
    in_array(|array| {
        let rows = array.drawn(1, None);
        let linear = array.linear(&rows);
        let ln_density = |unknowns: &[usize]| {
            let entry = |i: usize, j: usize| {
                let of = |k: &usize| array.slopes[*k][i] * array.deviations[*k].powi(2) * array.slopes[*k][j];
                unknowns.iter().map(of).sum::<f64>() + f64::from(u8::from(i == j))
            };
            let covariance = Mat::from_fn(rows.len(), rows.len(), entry);
            let square = dot(&algebra::solved(&covariance, &rows).unwrap(), &rows);
            -0.5 * square - 0.5 * algebra::ln_determinant(&covariance).unwrap()
        };
        let of_none: Vec<usize> = (0..array.n()).collect();
        let none = [linear.proposal(&[]).unwrap().log_posterior, ln_density(&of_none)];
        // Where the mode is at a bound the density is no whole normal one.
        let is_inside = |i: &usize| {
            let (moved, _) = linear.density.of(&array.with(*i)).highest(f64::INFINITY).unwrap();
            let [low, high] = array.bounds[array.n() + i];
            let is_told = array.slopes[array.n() + i].iter().any(|s| *s != 0.0);
            is_told && low < moved[array.n()] && moved[array.n()] < high
        };
        let inside: Vec<usize> = (0..array.directions.len()).filter(is_inside).step_by(7).take(5).collect();
        assert_eq!(inside.len(), 5);
        for i in inside {
            let found = linear.proposal(&[i]).unwrap().log_posterior - none[0];
            let exact = ln_density(&array.with(i)) - none[1];
            println!("ln evidence {found}, exact {exact}");
            assert!((found - exact).abs() < 1e-6 * (1.0 + exact.abs()), "{i}: {found} {exact}");
        }
    });
}

#[test]
fn intervals_of_strengths_hold_the_truth_as_often_as_they_say() {
    in_array(|array| {
        let (n, times) = (array.n(), 1000);
        let mut linear = array.linear(&array.drawn(0, None));
        let deviation = |i: &usize| algebra::inverse(&linear.density.of(&array.with(*i)).a).unwrap()[(n, n)].sqrt();
        // One that the records tell well: its prior and its bounds are far.
        let two_sided = (0..array.directions.len()).filter(|i| array.bounds[n + i][0] < 0.0);
        let best = two_sided.min_by(|a, b| deviation(a).total_cmp(&deviation(b))).unwrap();
        let sd = deviation(&best);
        let mut is_held = |seed: u64| {
            let truth = 1.6 * (seed as f64 / times as f64 - 0.5);
            linear.density.gradient = array.gradient(&array.drawn(seed, Some((best, truth))));
            let (moved, _) = linear.density.of(&array.with(best)).highest(f64::INFINITY).unwrap();
            (moved[n] - truth).abs() < 1.96 * sd
        };
        let share = (0..times).map(&mut is_held).filter(|held| *held).count() as f64 / times as f64;
        println!("of 95 % intervals {share} hold the truth; their deviation {sd}");
        assert!((share - 0.95).abs() < 0.02, "{share}");
    });
}
