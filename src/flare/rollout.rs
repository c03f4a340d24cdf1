//! Whole-motion rollouts: of simulated cases from their dense window, of events from their sensor window.

use super::case::Case;
use super::integrator::{Forcing, Trajectory, rollout_limited};
use super::kernels::{LANES, Lanes};
use super::library::Library;
use super::limits::Limits;
use super::memory::Drive;
use super::model::{SourceModel, SparseEncoder};
use super::observation::Observation;
use crate::error::{Error, Result};
use rayon::prelude::*;

/// States beyond this count as diverged when predicting.
pub const STATE_BOUND: f32 = 1e4;

/// One sequence to roll out: initial state `[r]` and what drives it from there on.
#[derive(Debug, Clone, Copy)]
pub struct Start<'a> {
    /// Initial latent state.
    pub z0: &'a [f32],
    /// Drive of the whole motion.
    pub drive: &'a Drive,
    /// The sample of the initial state.
    pub from: usize,
}

impl Start<'_> {
    /// Samples to roll out, the initial one included.
    pub fn n_step(&self) -> usize {
        self.drive.n_step() - self.from
    }
}

/// Latent states `[n · r]` of each sequence, with the number of valid samples (fewer than n where it diverged).
pub fn roll_out(library: Library, xi: &[f32], starts: &[Start<'_>], limits: &Limits) -> Vec<(Vec<f32>, usize)> {
    let r = library.latent;
    let groups: Vec<Vec<(Vec<f32>, usize)>> = starts
        .par_chunks(LANES)
        .map(|group| {
            let (forcing, z0) = load_group(r, group);
            let mut to = Trajectory::default();
            rollout_limited(library, xi, &z0, &forcing, limits, &mut to);
            let lane = |(lane, start): (usize, &Start<'_>)| {
                (to.z[..start.n_step() * r].iter().map(|z| z.0[lane]).collect(), to.valid[lane])
            };
            group.iter().enumerate().map(lane).collect()
        })
        .collect();
    groups.into_iter().flatten().collect()
}

/// Lays up to [`LANES`] sequences side by side.
pub fn load_group(r: usize, group: &[Start<'_>]) -> (Forcing, Vec<Lanes>) {
    let mut forcing = Forcing::default();
    let width = group.first().map_or(1, |s| s.drive.width);
    forcing.reset(group.iter().map(Start::n_step).max().unwrap_or(0), width);
    let mut z0 = vec![Lanes::ZERO; r];
    for (lane, start) in group.iter().enumerate() {
        forcing.set(lane, start.drive, start.from..start.drive.n_step(), 1.0);
        z0.iter_mut().zip(start.z0).for_each(|(to, z)| to.0[lane] = *z);
    }
    (forcing, z0)
}

impl SourceModel {
    /// Rolls a case out through its whole motion from its first window: dense response `[(n_step − L + 1) · n_channel]`,
    /// normalised, from sample L − 1 on.
    ///
    /// # Errors
    /// When the latent state leaves every bound.
    pub fn roll_out(&self, case: &Case) -> Result<Vec<f32>> {
        Ok(self.decode(&self.shape.visible(self.states(case)?)))
    }

    /// The states `[(n_step − L + 1) · (r + hidden)]` of that rollout.
    ///
    /// # Errors
    /// As [`SourceModel::roll_out`].
    pub fn states(&self, case: &Case) -> Result<Vec<f32>> {
        let t0 = self.shape.window - 1;
        let z0 = self.encode(&case.dense[..self.shape.window * self.shape.channels]);
        let drive = self.shape.drive(&case.u, &case.u_half, 1.0);
        let start = Start { z0: &z0, drive: &drive, from: t0 };
        one(self, self.coefficients(), start).map_err(|e| e.at(format!("case `{}`", case.id)))
    }
}

impl SourceModel {
    /// The states `[(n_step − L + 1) · (r + hidden)]` a simulation went through: encoded, and where hidden, rolled out.
    pub fn simulated_states(&self, case: &Case) -> Vec<f32> {
        let (r, width) = (self.shape.latent, self.shape.library().latent);
        let encoded = self.encode(&case.dense);
        if r == width {
            return encoded;
        }
        let mut states = self.states(case).unwrap_or_else(|_| vec![0.0; encoded.len() / r * width]);
        states.chunks_exact_mut(width).zip(encoded.chunks_exact(r)).for_each(|(s, z)| s[..r].copy_from_slice(z));
        states
    }
}

/// Response at the sensors read from the sensors themselves through the latent space, `C D(E_S(windows))`, normalised,
/// `[(n_step − L + 1) · n_sensor]` from sample L − 1 on: what the distilled encoder knows of the state.
pub fn reconstruct(
    model: &SourceModel,
    encoder: &SparseEncoder,
    observation: &Observation,
    sparse: &[f32],
) -> Vec<f32> {
    observe(observation, &model.decode(&encoder.encode(sparse)))
}

/// Predicts an event from its first `L` sensor samples and its base acceleration alone.
///
/// `xi[n_term · r]` are coefficients per sample (`Ξ₀` or a calibrated set); `window[L · n_sensor]` and `u[n_step]`,
/// `u_half[n_step − 1]` are normalised and begin together. Returns the normalised response at the sensors
/// `[(n_step − L + 1) · n_sensor]` from sample L − 1 on; multiply by `sparse_std_m_s2` for m/s².
///
/// # Errors
/// When the latent state leaves every bound, or lengths do not belong together.
pub fn predict(
    model: &SourceModel,
    encoder: &SparseEncoder,
    xi: &[f32],
    observation: &Observation,
    window: &[f32],
    u: &[f32],
    u_half: &[f32],
) -> Result<Vec<f32>> {
    let expected = encoder.window * encoder.n_sensor;
    if window.len() != expected {
        return Err(Error::new(format!(
            "initial window needs {} samples of {} sensors, got {} values",
            encoder.window,
            encoder.n_sensor,
            window.len()
        )));
    }
    if u.len() < encoder.window || u_half.len() + 1 != u.len() {
        return Err(Error::new(format!("base acceleration has {} samples and {} half steps", u.len(), u_half.len())));
    }
    let t0 = encoder.window - 1;
    let z0 = encoder.encode(window);
    let drive = model.shape.drive(u, u_half, 1.0);
    let z = one(model, xi, Start { z0: &z0, drive: &drive, from: t0 })?;
    Ok(observe(observation, &model.decode(&model.shape.visible(z))))
}

/// Normalised sensors `[n · n_sensor]` of normalised dense channels `[n · n_channel]`.
pub fn observe(observation: &Observation, dense: &[f32]) -> Vec<f32> {
    let n_channel = observation.channel_depth_m.len();
    let matrix = observation.normalised_matrix();
    let dot = |row: &[f32], x: &[f32]| row.iter().zip(x).map(|(w, x)| w * x).sum::<f32>();
    dense.chunks_exact(n_channel).flat_map(|x| matrix.chunks_exact(n_channel).map(move |row| dot(row, x))).collect()
}

fn one(model: &SourceModel, xi: &[f32], start: Start<'_>) -> Result<Vec<f32>> {
    let (z, valid) = roll_out(model.shape.library(), xi, &[start], &model.shape.limits(STATE_BOUND)).remove(0);
    if valid < start.n_step() {
        let time_s = valid as f64 * model.shape.step_s;
        return Err(Error::new(format!(
            "the latent state leaves ±{STATE_BOUND} {time_s:.2} s after the initial window"
        ))
        .hint("the motion lies far outside the motions the model was trained on"));
    }
    Ok(z)
}
