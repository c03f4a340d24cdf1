//! Complete rollouts of measured events and their error by the coefficients: what the calibration minimises.

use super::adjoint::reverse;
use super::case::{Event, amplitude_weights};
use super::integrator::{Forcing, Trajectory, rollout_limited};
use super::kernels::{LANES, Lanes};
use super::limits::Limits;
use super::memory::Drive;
use super::mlp::{Mlp, Tape};
use super::model::{SourceModel, SparseEncoder};
use super::objective::{from_lanes, to_lanes};
use super::observation::Observation;
use super::rollout::{Start, load_group};
use crate::numerics::spill::Values;
use rayon::prelude::*;

/// `C D` as one network: the observation matrix folded into the decoder's last layer.
pub struct Reader<'a> {
    pub(super) model: &'a SourceModel,
    /// The folded network.
    pub network: Mlp,
    /// Its parameters.
    pub parameters: Vec<f32>,
}

impl<'a> Reader<'a> {
    /// Folds C into the decoder of `model`.
    pub fn new(model: &'a SourceModel, observation: &Observation) -> Self {
        let decoder = model.shape.decoder();
        let matrix = observation.normalised_matrix();
        let (n_channel, n_sensor) = (model.shape.channels, observation.n_sensor());
        let network = Mlp::new(model.shape.latent, &model.shape.decoder_hidden, n_sensor, model.shape.has_linear_path);
        let last = decoder.widths.len() - 2;
        let mut parameters = Vec::with_capacity(network.n_parameter());
        for tensor in decoder.tensors() {
            let values = &model.decoder_parameters()[tensor.range.clone()];
            if tensor.name.starts_with(&format!("{last}.")) || tensor.name.starts_with("linear.") {
                let n = values.len() / n_channel;
                for row in matrix.chunks_exact(n_channel) {
                    parameters.extend((0..n).map(|j| (0..n_channel).map(|c| row[c] * values[c * n + j]).sum::<f32>()));
                }
            } else {
                parameters.extend_from_slice(values);
            }
        }
        debug_assert_eq!(parameters.len(), network.n_parameter());
        debug_assert_eq!(n_sensor, network.n_output());
        Self { model, network, parameters }
    }
}

/// Events ready to be rolled out, in groups of lanes.
pub struct Records<'a> {
    pub(super) reader: &'a Reader<'a>,
    pub(super) groups: Vec<Group>,
    limits: Limits,
    /// Predicted values of all events.
    pub(super) count: f64,
}

/// A motion to roll out and what its sensors recorded.
pub(super) struct Motion {
    /// State at the first sample that is rolled out, `[r]`.
    pub z0: Vec<f32>,
    pub drive: Drive,
    /// From the first sample of the record on, `[n_step · n_sensor]`.
    pub sparse: Values<f32>,
}

/// Up to [`LANES`] motions side by side.
pub(super) struct Group {
    motions: Vec<Motion>,
    /// Where in their records they are rolled out from.
    from: usize,
    pub weight: Vec<f32>,
}

impl Group {
    pub fn n_lane(&self) -> usize {
        self.motions.len()
    }

    /// What the sensors recorded of a lane, from the sample of the initial state on.
    pub fn target(&self, lane: usize) -> &[f32] {
        let motion = &self.motions[lane];
        let n_sensor = motion.sparse.len() / motion.drive.n_step();
        &motion.sparse[self.from * n_sensor..]
    }
}

impl<'a> Records<'a> {
    /// Encodes the first windows of `events` and weights them by amplitude.
    pub fn new(encoder: &SparseEncoder, reader: &'a Reader<'a>, events: &[Event], power: f64, bound: f32) -> Self {
        let motion = |e: &Event| Motion {
            z0: encoder.encode(&e.sparse[..encoder.window * encoder.n_sensor]),
            drive: reader.model.shape.drive(&e.u, &e.u_half, 1.0),
            sparse: e.sparse.clone().into(),
        };
        Self::of(events.iter().map(motion).collect(), encoder.window - 1, reader, power, bound)
    }

    /// Rolls `motions` out from sample `from` on, weighted by amplitude.
    pub(super) fn of(mut motions: Vec<Motion>, from: usize, reader: &'a Reader<'a>, power: f64, bound: f32) -> Self {
        let n_sensor = reader.network.n_output();
        let weight = amplitude_weights(motions.iter().map(|m| &m.sparse[..]), power);
        let count: usize = motions.iter().map(|m| m.sparse.len() - (from + 1) * n_sensor).sum();
        let mut groups = Vec::with_capacity(motions.len().div_ceil(LANES));
        for weight in weight.chunks(LANES) {
            let own = motions.drain(..weight.len()).collect();
            groups.push(Group { motions: own, from, weight: weight.to_vec() });
        }
        Self { reader, groups, limits: reader.model.shape.limits(bound), count: count as f64 }
    }

    /// Weighted mean squared rollout error, infinite when a rollout diverges and no gradient is asked for; with one
    /// (overwritten) the samples past a divergence count as a response of zero.
    pub fn error(&self, xi: &[f32], gradient: Option<&mut [f32]>) -> f64 {
        let is_wanted = gradient.is_some();
        let parts: Vec<Part> = self.groups.par_iter().map(|g| self.part(g, xi, is_wanted)).collect();
        if !is_wanted && parts.iter().any(|p| !p.is_bounded) {
            return f64::INFINITY;
        }
        if let Some(gradient) = gradient {
            gradient.fill(0.0);
            parts.iter().for_each(|p| gradient.iter_mut().zip(&p.gradient).for_each(|(a, b)| *a += b));
        }
        parts.iter().map(|p| p.sum).sum()
    }

    /// The same error with samples past a divergence counted as a response of zero, and whether no rollout diverges.
    pub fn misfit(&self, xi: &[f32]) -> (f64, bool) {
        let parts: Vec<Part> = self.groups.par_iter().map(|g| self.part(g, xi, false)).collect();
        (parts.iter().map(|p| p.sum).sum(), parts.iter().all(|p| p.is_bounded))
    }

    fn part(&self, group: &Group, xi: &[f32], is_wanted: bool) -> Part {
        let library = self.reader.model.shape.library();
        let (r, n_sensor) = (self.reader.model.shape.latent, self.reader.network.n_output());
        let mut rolled = self.roll_out(group, xi);
        let n_step = rolled.forcing.n_step();
        let valid = rolled.trajectory.valid;
        let is_bounded = valid == rolled.forcing.length;
        let mut sum = 0.0;
        for (lane, series) in rolled.response.chunks_exact_mut(n_step * n_sensor).enumerate() {
            let scale = f64::from(group.weight[lane]) / self.count;
            let (inside, beyond) = series.split_at_mut(group.target(lane).len());
            beyond.fill(0.0);
            let (initial, predicted) = inside.split_at_mut(n_sensor);
            initial.fill(0.0); // part of the window, not of the prediction
            for (i, (a, target)) in predicted.iter_mut().zip(&group.target(lane)[n_sensor..]).enumerate() {
                let is_valid = i / n_sensor + 1 < valid[lane];
                let error = if is_valid { *a - target } else { -target };
                sum += scale * f64::from(error).powi(2);
                *a = if is_valid { (2.0 * scale) as f32 * error } else { 0.0 };
            }
        }
        if !is_wanted {
            return Part { sum, is_bounded, gradient: Vec::new() };
        }
        let Rolled { forcing, trajectory, z, mut tape, response } = rolled;
        let mut d_z = vec![0.0; z.len()];
        self.reader.network.backward(&self.reader.parameters, &z, &mut tape, &response, None, Some(&mut d_z));
        let mut dz = Vec::new();
        to_lanes(&d_z, (r, library.latent), n_step, group.n_lane(), &mut dz);
        let mut dxi = vec![Lanes::ZERO; xi.len()];
        reverse(library, xi, &forcing, &trajectory, &mut dz, &mut dxi);
        Part { sum, is_bounded, gradient: dxi.iter().map(Lanes::sum).collect() }
    }

    /// Rolls a group out and reads the sensors.
    pub(super) fn roll_out(&self, group: &Group, xi: &[f32]) -> Rolled {
        let library = self.reader.model.shape.library();
        let starts: Vec<Start<'_>> =
            group.motions.iter().map(|m| Start { z0: &m.z0, drive: &m.drive, from: group.from }).collect();
        let (forcing, z0) = load_group(library.latent, &starts);
        let mut trajectory = Trajectory::default();
        rollout_limited(library, xi, &z0, &forcing, &self.limits, &mut trajectory);
        let n_step = forcing.n_step();
        let r = self.reader.model.shape.latent;
        let mut z = vec![0.0; group.n_lane() * n_step * r];
        from_lanes(&trajectory.z, (r, library.latent), n_step, &mut z);
        let (mut tape, mut response) = (Tape::default(), Vec::new());
        self.reader.network.forward(&self.reader.parameters, &z, &mut tape, &mut response);
        Rolled { forcing, trajectory, z, tape, response }
    }
}

/// What one group adds to the error.
struct Part {
    sum: f64,
    is_bounded: bool,
    gradient: Vec<f32>,
}

/// A group rolled out, and what its sensors would read.
pub(super) struct Rolled {
    pub forcing: Forcing,
    pub trajectory: Trajectory,
    /// States `[lane][t][r]`.
    pub z: Vec<f32>,
    pub tape: Tape,
    /// `[lane][t][n_sensor]`.
    pub response: Vec<f32>,
}
