//! Stage 2: a sparse encoder that finds the source model's latent states from the sensors alone.
//!
//! ```text
//! L = MSE(E_S(H_L[a_s]), E_T(H_L[a_d])), windows ending at the same sample                                  (1)
//! ```
//!
//! Only E_S is trained; the targets are constants. The candidate with the lowest validation error (1) is kept.

use super::adam::{Adam, cosine};
use super::case::{Case, amplitude_weights};
use super::history::History;
use super::mlp::{Mlp, Tape};
use super::model::{SourceModel, SparseEncoder, tame};
use super::ridge::Regression;
use super::settings::DistillSettings;
use super::snapshot::Fingerprint;
use super::training::Training;
use crate::error::{Error, Result};
use crate::numerics::random::stream;
use crate::numerics::spill::{Spill, Values};
use crate::ranges::Ranged as _;
use rand::RngExt;
use rand::seq::SliceRandom;
use rayon::prelude::*;

/// Rows of one chunk; a batch is cut alike on any number of threads.
const CHUNK: usize = 128;
/// Epochs between checkpoints.
const CHECKPOINT_EVERY: usize = 10;

/// Trains a sparse encoder and returns the best candidate with the loss history.
///
/// # Errors
/// When cases do not fit the settings or the source model, or its state or their latent states cannot be kept.
pub fn distill(
    model: &SourceModel,
    train: &[Case],
    validation: &[Case],
    settings: &DistillSettings,
    seed: u64,
    training: &Training<'_>,
) -> Result<(SparseEncoder, History)> {
    let Training { checkpoint_dir, spill, progress } = training;
    let n_sensor = check(model, train, validation, settings)?;
    let network = SparseEncoder::network(settings, n_sensor, model.shape.latent);
    let signs = &[1.0, -1.0][..if settings.mirror { 2 } else { 1 }];
    let sizes = Sizes { window: settings.window, n_sensor, latent: model.shape.latent };
    let pairs = Pairs::new(model, train, settings.amplitude_weighting, sizes, signs, spill)?;
    let check = Pairs::new(model, validation, settings.amplitude_weighting, sizes, &[1.0], spill)?;
    let mut parameters = network.initial(&mut stream(seed, "distill start"));
    if let Some(range) = network.skip_range() {
        parameters[range].copy_from_slice(&pairs.linear_map()?);
    }
    let print = Fingerprint::new("flare-pipe distillation v2")
        .text(&format!("{settings:?} {seed}"))
        .floats(&model.parameters)
        .cases(train.iter().chain(validation))
        .sensors(train.iter().chain(validation))
        .finish();
    let mut state =
        checkpoint_dir.and_then(|dir| DistillState::load(dir, &print)).unwrap_or_else(|| DistillState::new(parameters));
    progress.start("distill", settings.epochs as u64);
    progress.advance(state.epoch as u64);
    while state.epoch < settings.epochs {
        let mean = epoch(&network, &pairs, settings, seed, &mut state);
        let all: Vec<usize> = (0..check.n_row).collect();
        let error = check.loss(&network, &state.parameters, &all, None);
        if error < state.best.0 {
            state.best = (error, state.parameters.clone());
        }
        state.epoch += 1;
        state.history.rows.push(vec![state.epoch as f64, mean, error]);
        if let Some(dir) = checkpoint_dir
            && state.epoch.is_multiple_of(CHECKPOINT_EVERY)
        {
            state.save(dir, &print)?;
        }
        progress.advance(1);
    }
    let DistillState { best, history, .. } = state;
    if !best.0.is_finite() {
        return Err(Error::new("the sparse encoder never gave a finite error").hint("lower `learning_rate`"));
    }
    Ok((SparseEncoder { window: settings.window, n_sensor, network, parameters: best.1 }, history))
}

/// All that the next epoch depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct DistillState {
    /// Epochs done.
    pub epoch: usize,
    /// Parameters of the network.
    pub parameters: Vec<f32>,
    /// The optimiser.
    pub adam: Adam,
    /// The lowest validation error and its parameters.
    pub best: (f64, Vec<f32>),
    /// Losses so far.
    pub history: History,
}

impl DistillState {
    fn new(parameters: Vec<f32>) -> Self {
        Self {
            epoch: 0,
            adam: Adam::new(parameters.len()),
            best: (f64::INFINITY, parameters.clone()),
            parameters,
            history: History::new(&["epoch", "latent", "validation_latent"]),
        }
    }
}

/// One pass over the training windows; returns its mean loss.
fn epoch(network: &Mlp, pairs: &Pairs, settings: &DistillSettings, seed: u64, state: &mut DistillState) -> f64 {
    let factor = cosine(state.epoch as f64 / settings.epochs as f64, settings.final_rate_share);
    let groups = [(0..state.parameters.len(), factor * settings.learning_rate)];
    let mut gradient = vec![0.0; state.parameters.len()];
    let mut random = stream(seed, &format!("distill epoch {}", state.epoch));
    let n = pairs.n_row / pairs.n_sign;
    let mut order: Vec<usize> = (0..n).map(|i| i + n * random.random_range(0..pairs.n_sign)).collect();
    order.shuffle(&mut random);
    let mut mean = 0.0;
    for batch in order.chunks(settings.batch) {
        let loss = pairs.loss(network, &state.parameters, batch, Some(&mut gradient));
        mean += loss * batch.len() as f64 / n as f64;
        state.adam.update(&mut state.parameters, &gradient, &groups, f64::INFINITY);
    }
    mean
}

fn check(model: &SourceModel, train: &[Case], validation: &[Case], settings: &DistillSettings) -> Result<usize> {
    if let Some((key, problem)) = settings.beyond().into_iter().next() {
        return Err(Error::new(format!("`{key}` {problem}")).usage());
    }
    let first = train.first().ok_or_else(|| Error::new("there is no training case"))?;
    let n_sensor = first.sparse.len() / first.u.len().max(1);
    if n_sensor == 0 || validation.is_empty() {
        return Err(Error::new("distillation needs at least one sensor and one validation case"));
    }
    let window = settings.window.max(model.shape.window);
    train.iter().chain(validation).try_for_each(|c| c.check(model.shape.channels, n_sensor, window))?;
    Ok(n_sensor)
}

/// Sizes of the network.
#[derive(Debug, Clone, Copy)]
struct Sizes {
    window: usize,
    n_sensor: usize,
    latent: usize,
}

impl Sizes {
    /// Values of a window of the sensors.
    fn n_x(self) -> usize {
        self.window * self.n_sensor
    }
}

/// A case or its mirror image: windows of its sensors beside the latent states of the dense windows that end with them.
struct Sequence<'a> {
    sparse: &'a [f32],
    sign: f32,
    weight: f32,
    /// Row of its first window among all.
    first_row: usize,
    /// Sample at which that ends.
    first: usize,
    /// `[row][latent]`
    z: Values<f32>,
}

/// All of them.
struct Pairs<'a> {
    sizes: Sizes,
    n_row: usize,
    n_sign: usize,
    parts: Vec<Sequence<'a>>,
}

/// One row of the pairs.
struct Pair<'p> {
    weight: f32,
    z: &'p [f32],
}

impl<'a> Pairs<'a> {
    fn new(
        model: &SourceModel,
        cases: &'a [Case],
        amplitude_weighting: f64,
        sizes: Sizes,
        signs: &[f32],
        spill: &Spill,
    ) -> Result<Self> {
        let case_weight = amplitude_weights(cases.iter().map(|c| &c.dense[..]), amplitude_weighting);
        let first = sizes.window.max(model.shape.window) - 1;
        let (mut parts, mut n_row) = (Vec::with_capacity(cases.len() * signs.len()), 0);
        for sign in signs {
            for (case, weight) in cases.iter().zip(&case_weight) {
                let dense: Vec<f32> = case.dense.iter().map(|v| v * sign).collect();
                let mut z = model.encode(&dense);
                z.drain(..(first + 1 - model.shape.window) * sizes.latent);
                let rows = z.len() / sizes.latent;
                let z = spill.keep(z)?;
                parts.push(Sequence { sparse: &case.sparse, sign: *sign, weight: *weight, first_row: n_row, first, z });
                n_row += rows;
            }
        }
        Ok(Self { sizes, n_row, n_sign: signs.len(), parts })
    }

    /// Row `i`; its window is put at the end of `x`.
    fn pair(&self, i: usize, x: &mut Vec<f32>) -> Pair<'_> {
        let part = &self.parts[self.parts.partition_point(|part| part.first_row <= i) - 1];
        let Sizes { window, n_sensor, latent } = self.sizes;
        let row = i - part.first_row;
        let end = part.first + row + 1;
        let values = &part.sparse[(end - window) * n_sensor..end * n_sensor];
        x.extend(values.iter().map(|v| tame(v * part.sign)));
        Pair { weight: part.weight, z: &part.z[row * latent..(row + 1) * latent] }
    }

    /// Row-major `[r · n_x]` of the best linear encoder.
    fn linear_map(&self) -> Result<Vec<f32>> {
        let (n_x, n_z) = (self.sizes.n_x(), self.sizes.latent);
        let mut regression = Regression::new(n_x, n_z);
        let double = |x: &[f32]| x.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>();
        let mut x = Vec::with_capacity(n_x);
        for i in 0..self.n_row {
            x.clear();
            let pair = self.pair(i, &mut x);
            regression.add(&double(&x), &double(pair.z), f64::from(pair.weight));
        }
        let map = regression.solve(1e-6)?;
        Ok((0..n_z).flat_map(|i| (0..n_x).map(move |j| (i, j))).map(|at| map[at] as f32).collect())
    }

    /// Weighted mean squared latent error (1) of some rows, and its gradient where wanted (overwritten).
    fn loss(&self, network: &Mlp, parameters: &[f32], rows: &[usize], gradient: Option<&mut [f32]>) -> f64 {
        let is_wanted = gradient.is_some();
        let (n_x, n_z) = (self.sizes.n_x(), self.sizes.latent);
        let count = (rows.len() * n_z) as f64;
        let parts: Vec<(f64, Vec<f32>)> = rows
            .par_chunks(CHUNK)
            .map(|rows| {
                let mut x = Vec::with_capacity(rows.len() * n_x);
                let pairs: Vec<Pair<'_>> = rows.iter().map(|i| self.pair(*i, &mut x)).collect();
                let (mut tape, mut z, mut sum) = (Tape::default(), Vec::new(), 0.0);
                network.forward(parameters, &x, &mut tape, &mut z);
                for (z, pair) in z.chunks_exact_mut(n_z).zip(pairs) {
                    let scale = (2.0 * f64::from(pair.weight) / count) as f32;
                    for (z, target) in z.iter_mut().zip(pair.z) {
                        *z -= target;
                        sum += f64::from(pair.weight * *z * *z) / count;
                        *z *= scale;
                    }
                }
                let mut gradient = vec![0.0; if is_wanted { parameters.len() } else { 0 }];
                if is_wanted {
                    network.backward(parameters, &x, &mut tape, &z, Some(&mut gradient), None);
                }
                (sum, gradient)
            })
            .collect();
        if let Some(gradient) = gradient {
            gradient.fill(0.0);
            parts.iter().for_each(|(_, part)| gradient.iter_mut().zip(part).for_each(|(a, b)| *a += b));
        }
        parts.iter().map(|(sum, _)| sum).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_of_the_latent_error_matches_finite_differences() {
        let network = Mlp::new(3, &[6], 2, true);
        let mut random = stream(2, "distill test");
        let mut draw = |n: usize| (0..n).map(|_| random.random::<f32>() - 0.5).collect::<Vec<f32>>();
        let n_row = 300;
        let sizes = Sizes { window: 1, n_sensor: 3, latent: 2 };
        let sparse = draw(3 * n_row);
        let part = |sign: f32, weight: f32, first_row: usize, z: Vec<f32>| {
            let (sparse, first) = (&sparse[3 * first_row..], 0);
            Sequence { sparse, sign, weight, first_row, first, z: z.into() }
        };
        let parts = vec![part(1.0, 0.7, 0, draw(2 * 130)), part(-1.0, 1.6, 130, draw(2 * (n_row - 130)))];
        let pairs = Pairs { sizes, n_row, n_sign: 1, parts };
        let parameters = draw(network.n_parameter());
        let rows: Vec<usize> = (0..n_row).collect();
        let mut gradient = vec![0.0; parameters.len()];
        pairs.loss(&network, &parameters, &rows, Some(&mut gradient));
        for (i, g) in gradient.iter().enumerate() {
            let (mut up, mut down) = (parameters.clone(), parameters.clone());
            up[i] += 1e-2;
            down[i] -= 1e-2;
            let rise = pairs.loss(&network, &up, &rows, None) - pairs.loss(&network, &down, &rows, None);
            let slope = rise / f64::from(up[i] - down[i]);
            assert!((f64::from(*g) - slope).abs() < 1e-4 * (1.0 + slope.abs()), "parameter {i}: {g} {slope}");
        }
    }
}
