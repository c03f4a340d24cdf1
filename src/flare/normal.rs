//! The normal equations of the calibration: JᵀJ and Jᵀρ of all residuals by the kept coefficients.
//!
//! ```text
//! ρ = √(w/N) (C D(z_t) − a_s)/σ_s,   J = √(w/N) G_t S_t,   G_t = ∂(C D/σ_s)/∂z at z_t                      (1)
//! ```
//!
//! `S_t` are forward sensitivities, so that `2 Jᵀρ` is the gradient of the weighted mean squared error and `2 JᵀJ` its
//! Gauss–Newton matrix. Rows are built in single precision for a stretch of time, sums over stretches in double. Stretches
//! and tiles are the same whatever the number of threads, hence so are the bytes.

use super::events::{Group, Records, Rolled};
use super::mlp::{product, view, view_mut};
use super::sensitivity::{Sensitivity, StepSlope, linearise};
use faer::Accum;
use rayon::prelude::*;

/// Samples linearised at once.
const STRETCH: usize = 64;
/// Width of a tile of JᵀJ.
const TILE: usize = 192;

/// `[J ρ]ᵀ [J ρ]`, upper tiles.
pub struct Normal {
    n: usize,
    /// Jᵀρ of all residuals, where the tiles hold some of them only.
    slope: Option<Vec<f64>>,
    tiles: Vec<Tile>,
}

struct Tile {
    row: usize,
    column: usize,
    sum: Vec<f64>,
}

impl Normal {
    fn new(n: usize) -> Self {
        let starts: Vec<usize> = (0..n).step_by(TILE).collect();
        let tiles = starts.iter().flat_map(|row| starts.iter().filter(|c| *c >= row).map(|column| (*row, *column)));
        let size = |at: usize| TILE.min(n - at);
        let tile = |(row, column)| Tile { row, column, sum: vec![0.0; size(row) * size(column)] };
        Self { n, slope: None, tiles: tiles.map(tile).collect() }
    }

    /// Entry of Jᵀρ.
    pub fn slope(&self, i: usize) -> f64 {
        self.slope.as_ref().map_or_else(|| self.curvature(i, self.n - 1), |slope| slope[i])
    }

    /// Entry of JᵀJ.
    pub fn curvature(&self, i: usize, j: usize) -> f64 {
        let (i, j) = (i.min(j), i.max(j));
        let n_tile = self.n.div_ceil(TILE);
        let (a, b) = (i / TILE, j / TILE);
        let tile = &self.tiles[a * n_tile - a * a.saturating_sub(1) / 2 + b - a];
        let width = TILE.min(self.n - tile.column);
        tile.sum[(i - tile.row) * width + j - tile.column]
    }

    /// Adds the products of `rows[n_row · n]`.
    fn add(&mut self, rows: &[f32]) {
        let n = self.n;
        let all = view(rows, rows.len() / n, n);
        self.tiles.par_iter_mut().for_each(|tile| {
            let (height, width) = (TILE.min(n - tile.row), TILE.min(n - tile.column));
            let mut part = vec![0.0; height * width];
            let (left, right) = (all.subcols(tile.row, height), all.subcols(tile.column, width));
            product(view_mut(&mut part, height, width), Accum::Replace, left.transpose(), right);
            tile.sum.iter_mut().zip(&part).for_each(|(sum, p)| *sum += f64::from(*p));
        });
    }
}

impl Records<'_> {
    /// Normal equations at `xi` for the coefficients `kept` (indices into Ξ); samples past a divergence have no part.
    pub fn normal(&self, xi: &[f32], kept: &[usize]) -> Normal {
        self.accumulate(xi, kept, 1)
    }

    /// The same with JᵀJ from every `every`-th sample only, weighted up; Jᵀρ is that of all samples.
    pub fn normal_thinned(&self, xi: &[f32], kept: &[usize], every: usize) -> Normal {
        let mut normal = self.accumulate(xi, kept, every);
        let mut gradient = vec![0.0; xi.len()];
        self.error(xi, Some(&mut gradient));
        normal.slope = Some(kept.iter().map(|i| 0.5 * f64::from(gradient[*i])).collect());
        normal
    }

    fn accumulate(&self, xi: &[f32], kept: &[usize], every: usize) -> Normal {
        let mut normal = Normal::new(kept.len() + 1);
        for group in &self.groups {
            let mut rolled = self.roll_out(group, xi);
            let reading = self.reading_slopes(&mut rolled);
            Linearised { records: self, group, rolled, reading, kept, every }.add_to(&mut normal, xi);
        }
        normal
    }

    /// G at every state, one `[lane][t][r]` a sensor.
    fn reading_slopes(&self, rolled: &mut Rolled) -> Vec<Vec<f32>> {
        let network = &self.reader.network;
        let n_sensor = network.n_output();
        let slope_of = |j: usize| {
            let unit: Vec<f32> =
                (0..rolled.response.len()).map(|i| if i % n_sensor == j { 1.0 } else { 0.0 }).collect();
            let mut slope = vec![0.0; rolled.z.len()];
            let (z, tape) = (&rolled.z, &mut rolled.tape);
            network.backward(&self.reader.parameters, z, tape, &unit, None, Some(&mut slope));
            slope
        };
        (0..n_sensor).map(slope_of).collect()
    }
}

/// A group rolled out, with the slopes of its readings.
struct Linearised<'a> {
    records: &'a Records<'a>,
    group: &'a Group,
    rolled: Rolled,
    reading: Vec<Vec<f32>>,
    kept: &'a [usize],
    every: usize,
}

impl Linearised<'_> {
    fn add_to(&self, normal: &mut Normal, xi: &[f32]) {
        let library = self.records.reader.model.shape.library();
        let (forcing, trajectory) = (&self.rolled.forcing, &self.rolled.trajectory);
        let n_step = forcing.n_step();
        let mut lanes: Vec<Sensitivity> = (0..self.group.n_lane()).map(|_| Sensitivity::new(library)).collect();
        for begin in (1..n_step).step_by(STRETCH) {
            let samples: Vec<usize> = (begin..(begin + STRETCH).min(n_step)).collect();
            let slopes: Vec<StepSlope> =
                samples.par_iter().map(|t| linearise(library, xi, forcing, trajectory, *t)).collect();
            let of_lane = |(lane, s): (usize, &mut Sensitivity)| {
                let mut rows = Vec::new();
                for (t, slope) in samples.iter().zip(&slopes).filter(|(t, _)| **t < trajectory.valid[lane]) {
                    s.advance(library, slope, lane);
                    if t.is_multiple_of(self.every) {
                        self.push_rows(lane, *t, &s.state, &mut rows);
                    }
                }
                rows
            };
            let rows: Vec<Vec<f32>> = lanes.par_iter_mut().enumerate().map(of_lane).collect();
            normal.add(&rows.concat());
        }
    }

    /// The rows `[J ρ]` of one lane and sample (1).
    fn push_rows(&self, lane: usize, t: usize, sensitivity: &[f32], rows: &mut Vec<f32>) {
        let shape = &self.records.reader.model.shape;
        let (r, width) = (shape.latent, shape.library().latent);
        let (n, n_sensor) = (sensitivity.len() / width, self.reading.len());
        let at = lane * self.rolled.forcing.n_step() + t;
        let scale = (self.every as f64 * f64::from(self.group.weight[lane]) / self.records.count).sqrt() as f32;
        let slopes: Vec<f32> = self.reading.iter().flat_map(|g| &g[at * r..(at + 1) * r]).map(|g| scale * g).collect();
        let mut all = vec![0.0; n_sensor * n];
        let answers = view(sensitivity, n, width).subcols(0, r).transpose();
        product(view_mut(&mut all, n_sensor, n), Accum::Replace, view(&slopes, n_sensor, r), answers);
        for (j, row) in all.chunks_exact(n).enumerate() {
            rows.extend(self.kept.iter().map(|i| row[*i]));
            let error = self.rolled.response[at * n_sensor + j] - self.group.target(lane)[t * n_sensor + j];
            rows.push(scale * error);
        }
    }
}
