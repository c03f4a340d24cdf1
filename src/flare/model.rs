//! The learned models as plain data: the source model (encoder, latent equations, decoder) and the sparse encoder.

use super::case::Case;
use super::library::Library;
use super::limits::Limits;
use super::memory::{Drive, Memories};
use super::mlp::{Mlp, Tape};
use super::settings::{DistillSettings, PretrainSettings};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Sizes of a source model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shape {
    /// Samples in the encoder's window, L.
    pub window: usize,
    /// Latent dimension, r.
    pub latent: usize,
    /// Hidden states beside them, see [`PretrainSettings::hidden`].
    #[serde(default)]
    pub hidden: usize,
    /// Dense channels.
    pub channels: usize,
    /// Sampling interval (s).
    pub step_s: f64,
    /// Widths of the encoder's hidden layers.
    pub encoder_hidden: Vec<usize>,
    /// Widths of the decoder's hidden layers.
    pub decoder_hidden: Vec<usize>,
    /// Whether encoder and decoder have a straight linear path.
    pub has_linear_path: bool,
    /// Memories of the shaking in the latent equations.
    #[serde(default)]
    pub memories: Memories,
    /// Where the soft limit of each state begins; empty for none.
    #[serde(default)]
    pub soft_limits: Vec<f32>,
    /// Levels of energy in the latent equations.
    #[serde(default)]
    pub energy_levels: usize,
}

impl Shape {
    /// The sizes asked for.
    pub fn new(settings: &PretrainSettings) -> Self {
        Self {
            window: settings.window,
            latent: settings.latent,
            hidden: settings.hidden,
            channels: settings.channels,
            step_s: settings.step_s,
            encoder_hidden: settings.encoder_hidden.clone(),
            decoder_hidden: settings.decoder_hidden.clone(),
            has_linear_path: settings.linear_start,
            memories: settings.memories.clone(),
            soft_limits: Vec::new(),
            energy_levels: settings.energy_levels,
        }
    }

    /// The candidate library.
    pub fn library(&self) -> Library {
        Library { latent: self.latent + self.hidden, memories: self.memories.count(), energies: self.energy_levels }
    }

    /// Of states `[n · (r + hidden)]` those that are encoded and decoded, `[n · r]`.
    pub fn visible(&self, states: Vec<f32>) -> Vec<f32> {
        if self.hidden == 0 {
            return states;
        }
        states.chunks_exact(self.latent + self.hidden).flat_map(|row| &row[..self.latent]).copied().collect()
    }

    /// The limits of the latent states of a rollout.
    pub fn limits(&self, bound: f32) -> Limits {
        Limits { bound, soft: self.soft_limits.clone() }
    }

    /// What drives the latent equations through a motion `u[n_step]`, `u_half[n_step − 1]`, multiplied by `factor`.
    pub fn drive(&self, u: &[f32], u_half: &[f32], factor: f32) -> Drive {
        let tame = |x: &[f32]| x.iter().map(|v| tame(*v)).collect::<Vec<f32>>();
        Drive::new(&self.memories, self.step_s, &tame(u), &tame(u_half), factor)
    }

    /// The source encoder E_T.
    pub fn encoder(&self) -> Mlp {
        Mlp::new(self.window * self.channels, &self.encoder_hidden, self.latent, self.has_linear_path)
    }

    /// The decoder D.
    pub fn decoder(&self) -> Mlp {
        Mlp::new(self.latent, &self.decoder_hidden, self.channels, self.has_linear_path)
    }

    /// Where the coefficients lie in the flat parameters.
    pub fn coefficient_range(&self) -> Range<usize> {
        0..self.library().n_coefficient()
    }

    /// Where the encoder lies in the flat parameters.
    pub fn encoder_range(&self) -> Range<usize> {
        let start = self.library().n_coefficient();
        start..start + self.encoder().n_parameter()
    }

    /// Where the decoder lies in the flat parameters.
    pub fn decoder_range(&self) -> Range<usize> {
        let start = self.encoder_range().end;
        start..start + self.decoder().n_parameter()
    }
}

/// A trained source model: `z = E_T(window)`, `dz/dt = Θ(z, u) Ξ₀`, `a_d = D(z)`.
#[derive(Debug, Clone, PartialEq)]
pub struct SourceModel {
    /// Sizes.
    pub shape: Shape,
    /// Coefficients (per sample), encoder and decoder in one slice.
    pub parameters: Vec<f32>,
    /// Which coefficients are kept, `[n_term · r]`.
    pub mask: Vec<bool>,
}

impl SourceModel {
    /// Begins the soft limit of each state at `factor` times its largest size in `cases`, encoded or rolled out; 0 for never.
    pub fn limit_softly(&mut self, cases: &[Case], factor: f64) {
        self.shape.soft_limits.clear();
        if factor == 0.0 {
            return;
        }
        let mut range = vec![0.0_f32; self.shape.library().latent];
        let mut widen = |z: &[f32], n: usize| {
            for row in z.chunks_exact(n) {
                range.iter_mut().zip(row).for_each(|(a, z)| *a = a.max(z.abs()));
            }
        };
        for case in cases {
            widen(&self.encode(&case.dense), self.shape.latent);
            if let Ok(z) = self.states(case) {
                widen(&z, self.shape.latent + self.shape.hidden);
            }
        }
        self.shape.soft_limits = range.into_iter().map(|a| (factor as f32 * a).max(f32::MIN_POSITIVE)).collect();
    }

    /// Ξ₀ per sample, `[n_term · r]`.
    pub fn coefficients(&self) -> &[f32] {
        &self.parameters[self.shape.coefficient_range()]
    }

    /// Ξ₀ in 1/s, `[n_term · r]`.
    pub fn coefficients_per_s(&self) -> Vec<f64> {
        self.coefficients().iter().map(|c| f64::from(*c) / self.shape.step_s).collect()
    }

    /// Parameters of the encoder.
    pub fn encoder_parameters(&self) -> &[f32] {
        &self.parameters[self.shape.encoder_range()]
    }

    /// Parameters of the decoder.
    pub fn decoder_parameters(&self) -> &[f32] {
        &self.parameters[self.shape.decoder_range()]
    }

    /// Latent states `[(n_step − L + 1) · r]` of a dense series `[n_step · n_channel]`.
    pub fn encode(&self, dense: &[f32]) -> Vec<f32> {
        let mut z = Vec::new();
        let x = windows(dense, self.shape.channels, self.shape.window);
        self.shape.encoder().forward(self.encoder_parameters(), &x, &mut Tape::default(), &mut z);
        z
    }

    /// Dense response `[n · n_channel]` of latent states `[n · r]`.
    pub fn decode(&self, z: &[f32]) -> Vec<f32> {
        let mut response = Vec::new();
        self.shape.decoder().forward(self.decoder_parameters(), z, &mut Tape::default(), &mut response);
        response
    }
}

/// A trained sparse encoder E_S, in the coordinates of one source model.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseEncoder {
    /// Samples in its window, L.
    pub window: usize,
    /// Number of sensors.
    pub n_sensor: usize,
    /// The network.
    pub network: Mlp,
    /// Its parameters.
    pub parameters: Vec<f32>,
}

impl SparseEncoder {
    /// The network asked for.
    pub fn network(settings: &DistillSettings, n_sensor: usize, latent: usize) -> Mlp {
        Mlp::new(settings.window * n_sensor, &settings.hidden, latent, settings.linear_start)
    }

    /// Latent states `[(n_step − L + 1) · r]` of a sensor series `[n_step · n_sensor]`.
    pub fn encode(&self, sparse: &[f32]) -> Vec<f32> {
        let mut z = Vec::new();
        let x = windows(sparse, self.n_sensor, self.window);
        self.network.forward(&self.parameters, &x, &mut Tape::default(), &mut z);
        z
    }
}

/// Largest normalised acceleration an encoder or the latent equations are given: a million standard deviations are no earthquake,
/// and squares of them are still numbers.
const LARGEST_INPUT: f32 = 1e6;

pub(super) fn tame(value: f32) -> f32 {
    value.clamp(-LARGEST_INPUT, LARGEST_INPUT)
}

/// All flattened windows of a series `[n_step · n]`: `[(n_step − L + 1) · L · n]`.
pub fn windows(series: &[f32], n: usize, length: usize) -> Vec<f32> {
    let n_window = (series.len() / n + 1).saturating_sub(length);
    (0..n_window).flat_map(|t| &series[t * n..(t + length) * n]).map(|v| tame(*v)).collect()
}
