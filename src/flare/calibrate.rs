//! Stage 3: the latent equations corrected by records, everything else held.
//!
//! ```text
//! Ξ = Ξ₀ + ΔΞ,   L = mean ((C D(ẑ) − a_s)/σ_s)² + λ_Δ R(ΔΞ)                                                (1)
//! ```
//!
//! `ẑ` is the complete rollout from the sparse encoder's state at the end of the first window, `R` the relative size of the
//! correction in one of two metrics ([`super::penalty`]). Selection is by the complete-rollout error of the validation events; a
//! candidate that diverges on one of them cannot be selected. Called once for each component.
//!
//! Validation error of the choices at Lotung, mean squared in units of σ_s, all from the default source model but for the last
//! row, which has the published one (`flare-pipe run configs/lotung.toml --pipeline flare-t --until calibrate --set
//! calibrate.solver=…`, and `--set recipe=published`):
//!
//! | solver       | metric         | free terms  | EW     | NS     |
//! |--------------|----------------|-------------|--------|--------|
//! | Adam         | `coefficients` | all         | 0.0820 | 0.0643 |
//! | Gauss–Newton | `coefficients` | all         | 0.0797 | 0.0582 |
//! | Gauss–Newton | `coefficients` | linear      | 0.0776 | 0.0599 |
//! | Gauss–Newton | `field`        | all         | 0.0766 | 0.0599 |
//! | Gauss–Newton | `field`        | linear      | 0.0764 | 0.0620 |
//! | Gauss–Newton | `field`        | linear, all | 0.0764 | 0.0599 |
//! | Adam         | `coefficients` | all         | 0.1431 | 0.0879 |
//!
//! Most of it is one validation event stronger than every training event, where the source model itself errs by half: the
//! choices of this stage hardly matter there, the source model does.

use super::case::{Case, Event};
use super::descent::descend;
use super::events::{Reader, Records};
use super::gauss_newton::{Problem, search};
use super::history::History;
use super::model::{SourceModel, SparseEncoder};
use super::observation::Observation;
use super::penalty::Penalty;
use super::settings::{CalibrateSettings, Solver};
use super::snapshot::Fingerprint;
use crate::error::{Error, Result};
use crate::progress::Progress;
use std::path::Path;

/// Calibrated latent equations of one component.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Ξ per sample, `[n_term · r]`.
    pub coefficients: Vec<f32>,
    /// Which coefficients are kept.
    pub mask: Vec<bool>,
    /// Cosine similarity of Ξ and Ξ₀ as vectors.
    pub cosine_similarity: f64,
    /// Complete-rollout error of the validation events (mean squared, sensors in units of σ_s).
    pub validation_error: f64,
    /// Losses over the epochs.
    pub history: History,
}

impl Calibration {
    /// Number of coefficients kept.
    pub fn terms_kept(&self) -> usize {
        self.mask.iter().filter(|k| **k).count()
    }
}

/// What stage 3 learns from.
#[derive(Debug, Clone, Copy)]
pub struct Data<'a> {
    /// Training simulations; only the penalty looks at them, and only with [`super::Metric::Field`].
    pub simulations: &'a [Case],
    /// Events the coefficients are fitted to.
    pub train: &'a [Event],
    /// Events that choose among candidates.
    pub validation: &'a [Event],
}

/// Calibrates the coefficients on the training events and keeps those best on the validation events; `Ξ₀` itself is the
/// first candidate. With a `checkpoint_dir` an interrupted calibration goes on where it was.
///
/// # Errors
/// When events do not fit the model, or no candidate survives the validation events.
pub fn calibrate(
    model: &SourceModel,
    encoder: &SparseEncoder,
    observation: &Observation,
    data: &Data<'_>,
    settings: &CalibrateSettings,
    checkpoint_dir: Option<&Path>,
    progress: &dyn Progress,
) -> Result<Calibration> {
    check(model, encoder, observation, data, settings)?;
    let reader = Reader::new(model, observation);
    let bound = settings.state_bound as f32;
    let train = Records::new(encoder, &reader, data.train, settings.amplitude_weighting, bound);
    let validation = Records::new(encoder, &reader, data.validation, settings.amplitude_weighting, bound);
    let origin = model.coefficients();
    let start = Candidate { xi: origin.to_vec(), mask: model.mask.clone(), validation: validation.error(origin, None) };
    let penalty = Penalty::of(settings.metric, model, data.simulations);
    let library = model.shape.library();
    let problem = Problem { train: &train, validation: &validation, penalty: &penalty, library, settings };
    let print = Fingerprint::new("flare-pipe calibration v1")
        .text(&format!("{settings:?}"))
        .floats(&model.parameters)
        .floats(&encoder.parameters)
        .floats(&observation.normalised_matrix())
        .cases(data.simulations.iter())
        .events(data.train.iter().chain(data.validation))
        .finish();
    let checkpoint = checkpoint_dir.map(|dir| (dir, print));
    let (best, history) = match settings.solver {
        Solver::Adam => descend(&problem, &start, &checkpoint, progress),
        Solver::GaussNewton => search(&problem, &start, &checkpoint, progress),
    }?;
    if !best.validation.is_finite() {
        return Err(Error::new("no calibrated coefficients survive the validation events")
            .hint("raise `penalty` or the first of `penalty_ladder`"));
    }
    Ok(Calibration {
        cosine_similarity: cosine_similarity(origin, &best.xi),
        coefficients: best.xi,
        mask: best.mask,
        validation_error: best.validation,
        history,
    })
}

/// Coefficients on trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Ξ per sample, `[n_term · r]`.
    pub xi: Vec<f32>,
    /// Which coefficients are kept.
    pub mask: Vec<bool>,
    /// Complete-rollout error of the validation events, infinite where one diverges.
    pub validation: f64,
}

impl Candidate {
    /// Number of kept coefficients.
    pub fn terms(&self) -> f64 {
        self.mask.iter().filter(|k| **k).count() as f64
    }

    /// Removes kept coefficients below `threshold` for good; whether there were any.
    pub fn threshold(&mut self, threshold: f64) -> bool {
        let before = self.terms();
        for (c, keep) in self.xi.iter_mut().zip(&mut self.mask) {
            *keep &= f64::from(c.abs()) >= threshold;
            *c = if *keep { *c } else { 0.0 };
        }
        self.terms() < before
    }
}

fn check(
    model: &SourceModel,
    encoder: &SparseEncoder,
    observation: &Observation,
    data: &Data<'_>,
    settings: &CalibrateSettings,
) -> Result<()> {
    if let Some((key, problem)) = settings.problems().into_iter().next() {
        return Err(Error::new(format!("`{key}` {problem}")).usage());
    }
    observation.check()?;
    if observation.channel_depth_m.len() != model.shape.channels || observation.n_sensor() != encoder.n_sensor {
        return Err(Error::new(format!(
            "the observation has {} channels and {} sensors, the model {} and {}",
            observation.channel_depth_m.len(),
            observation.n_sensor(),
            model.shape.channels,
            encoder.n_sensor
        )));
    }
    for (events, what) in [(data.train, "training"), (data.validation, "validation")] {
        if events.is_empty() {
            return Err(Error::new(format!("there is no {what} event")));
        }
        events.iter().try_for_each(|e| e.check(encoder.n_sensor, encoder.window))?;
    }
    Ok(())
}

/// Cosine of the angle between two vectors.
pub(super) fn cosine_similarity(a: &[f32], b: &[f32]) -> f64 {
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    dot(a, b) / (dot(a, a) * dot(b, b)).sqrt().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::flare::events::Group;
    use crate::flare::mlp::Tape;
    use crate::flare::model::Shape;
    use crate::flare::rollout::{observe, predict};
    use crate::flare::{DistillSettings, Metric, PretrainSettings};
    use crate::numerics::random::stream;
    use rand::RngExt;

    pub fn random(n: usize, scale: f32, label: &str) -> Vec<f32> {
        let mut random = stream(6, label);
        (0..n).map(|_| scale * (2.0 * random.random::<f32>() - 1.0)).collect()
    }

    /// Soft limits of the models below, and how many of their states are hidden.
    const MODELS: [(&[f32], usize); 3] = [(&[], 0), (&[0.5, 0.7, 0.4], 0), (&[0.5, 0.7, 0.4, 0.3, 0.5], 2)];

    /// A small model, with soft limits well inside its states where `soft` says so.
    fn limited(soft: &[f32], hidden: usize) -> (SourceModel, SparseEncoder, Observation) {
        let (mut model, encoder, observation) = with_hidden(hidden);
        model.shape.soft_limits = soft.to_vec();
        (model, encoder, observation)
    }

    pub fn problem() -> (SourceModel, SparseEncoder, Observation) {
        with_hidden(0)
    }

    pub fn with_hidden(hidden: usize) -> (SourceModel, SparseEncoder, Observation) {
        let settings = PretrainSettings {
            latent: 3,
            hidden,
            channels: 4,
            encoder_hidden: vec![5],
            decoder_hidden: vec![6, 5],
            memories: Default::default(),
            energy_levels: 0,
            ..Default::default()
        };
        let shape = Shape::new(&settings);
        let mut parameters = random(shape.decoder_range().end, 0.5, "parameters");
        parameters[shape.coefficient_range()].iter_mut().for_each(|c| *c *= 0.2);
        let n = 3 + hidden;
        (0..n).for_each(|k| {
            parameters[shape.library().linear_row(k) * n + k] -= 0.6;
            parameters[shape.library().input_row() * n + k] += 0.8;
        });
        let mask = vec![true; shape.library().n_coefficient()];
        let distill = DistillSettings { window: 2, hidden: vec![5], ..Default::default() };
        let network = SparseEncoder::network(&distill, 2, 3);
        let parameters_s = random(network.n_parameter(), 0.5, "sparse");
        let encoder = SparseEncoder { window: 2, n_sensor: 2, network, parameters: parameters_s };
        let observation = Observation {
            sensors: vec!["a".into(), "b".into()],
            channel_depth_m: vec![1.0, 2.0, 3.0, 4.0],
            sensor_depth_m: vec![0.0, 2.3],
            dense_std_m_s2: vec![1.0, 0.8, 0.7, 0.6],
            sparse_std_m_s2: vec![1.1, 0.75],
        };
        (SourceModel { shape, parameters, mask }, encoder, observation)
    }

    pub fn event(n_step: usize, label: &str) -> Event {
        let u = random(n_step, 1.0, &format!("{label} u"));
        let u_half = random(n_step - 1, 1.0, &format!("{label} half"));
        Event { id: label.into(), u, u_half, sparse: random(2 * n_step, 1.0, &format!("{label} sparse")) }
    }

    #[test]
    fn the_gradient_by_the_coefficients_matches_finite_differences_for_events_of_unequal_length() {
        for (soft, hidden) in MODELS {
            let (model, encoder, observation) = limited(soft, hidden);
            let reader = Reader::new(&model, &observation);
            let events: Vec<Event> = (0..10).map(|i| event(12 + 3 * i, &format!("e{i}"))).collect();
            let records = Records::new(&encoder, &reader, &events, 0.5, 1e3);
            let xi = model.coefficients().to_vec();
            let mut gradient = vec![0.0; xi.len()];
            records.error(&xi, Some(&mut gradient));
            for i in 0..xi.len() {
                let (mut up, mut down) = (xi.clone(), xi.clone());
                up[i] += 2e-3;
                down[i] -= 2e-3;
                let slope = (records.error(&up, None) - records.error(&down, None)) / f64::from(up[i] - down[i]);
                assert!(
                    (f64::from(gradient[i]) - slope).abs() < 1e-3 * (1.0 + slope.abs()),
                    "{i}: {} {slope}",
                    gradient[i]
                );
            }
        }
    }

    #[test]
    fn the_normal_equations_match_the_reverse_pass_and_finite_differences_of_every_residual() {
        for (soft, hidden) in MODELS {
            let (model, encoder, observation) = limited(soft, hidden);
            let reader = Reader::new(&model, &observation);
            let events: Vec<Event> = (0..10).map(|i| event(90 + 3 * i, &format!("e{i}"))).collect();
            let records = Records::new(&encoder, &reader, &events, 0.5, 1e3);
            let xi = model.coefficients().to_vec();
            let kept: Vec<usize> = (0..xi.len()).filter(|i| i % 4 != 1).collect();
            let normal = records.normal(&xi, &kept);
            let mut gradient = vec![0.0; xi.len()];
            let error = records.error(&xi, Some(&mut gradient));
            let largest = gradient.iter().fold(0.0_f64, |top, g| top.max(f64::from(g.abs())));
            for (i, at) in kept.iter().enumerate() {
                let (found, exact) = (2.0 * normal.slope(i), f64::from(gradient[*at]));
                assert!((found - exact).abs() < 1e-4 * largest, "coefficient {at}: {found} {exact}");
            }
            // the responses, weighted as the residuals are, at coefficients moved by h
            let responses = |i: usize, h: f32| -> Vec<f64> {
                let mut moved = xi.clone();
                moved[i] += h;
                let mut all = Vec::new();
                for group in &records.groups {
                    let rolled = records.roll_out(group, &moved);
                    let n_step = rolled.forcing.n_step();
                    for (lane, weight) in group.weight.iter().enumerate() {
                        let scale = (f64::from(*weight) / records.count).sqrt();
                        let series = &rolled.response[lane * n_step * 2..][2..group.target(lane).len()];
                        all.extend(series.iter().map(|y| scale * f64::from(*y)));
                    }
                }
                all
            };
            let jacobian: Vec<Vec<f64>> = kept
                .iter()
                .map(|i| {
                    let (up, down) = (responses(*i, 4e-3), responses(*i, -4e-3));
                    up.iter().zip(&down).map(|(a, b)| (a - b) / 8e-3).collect()
                })
                .collect();
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            for i in 0..kept.len() {
                for j in 0..kept.len() {
                    let exact = dot(&jacobian[i], &jacobian[j]);
                    let size = (dot(&jacobian[i], &jacobian[i]) * dot(&jacobian[j], &jacobian[j])).sqrt();
                    let found = normal.curvature(i, j);
                    assert!((found - exact).abs() < 2e-3 * size, "({i}, {j}): {found} {exact}");
                }
            }
            assert!(error > 0.0);
            let thinned = records.normal_thinned(&xi, &kept, 4);
            for (i, at) in kept.iter().enumerate() {
                assert_eq!(2.0 * thinned.slope(i), f64::from(gradient[*at]));
                let (some, all) = (thinned.curvature(i, i), normal.curvature(i, i));
                assert!(some < 2.0 * all && all < 2.0 * some, "coefficient {at}: {some} {all}");
            }
            let is_limited = |g: &Group| {
                let states = records.roll_out(g, &xi).z;
                states.chunks(3).any(|z| z.iter().zip(soft).any(|(z, a)| z.abs() > *a))
            };
            assert_eq!(records.groups.iter().any(is_limited), !soft.is_empty());
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_byte_of_a_calibration() {
        let (model, encoder, observation) = problem();
        let events: Vec<Event> = (0..10).map(|i| event(70 + 3 * i, &format!("e{i}"))).collect();
        let settings = CalibrateSettings {
            metric: Metric::Coefficients,
            penalty_ladder: vec![1.0, 0.1],
            steps: 2,
            ..Default::default()
        };
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            let quiet = crate::progress::Quiet;
            pool.install(|| {
                let data = Data { simulations: &[], train: &events[..8], validation: &events[8..] };
                calibrate(&model, &encoder, &observation, &data, &settings, None, &quiet)
            })
            .expect("calibrates")
        };
        assert!(run(1) == run(3));
    }

    #[test]
    fn the_folded_decoder_reads_the_same_as_decoding_and_observing() {
        let (model, _, observation) = problem();
        let reader = Reader::new(&model, &observation);
        let z = random(3 * 7, 1.0, "states");
        let mut folded = Vec::new();
        reader.network.forward(&reader.parameters, &z, &mut Tape::default(), &mut folded);
        let plain = observe(&observation, &model.decode(&z));
        assert!(folded.iter().zip(&plain).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn coefficients_changed_on_purpose_are_found_again_from_sensor_series() {
        let (model, encoder, observation) = problem();
        let mut truth = model.coefficients().to_vec();
        for k in 0..3 {
            truth[model.shape.library().linear_row(k) * 3 + k] += 0.2;
        }
        let events: Vec<Event> = (0..6)
            .map(|i| {
                let mut e = event(80, &format!("twin {i}"));
                let response =
                    predict(&model, &encoder, &truth, &observation, &e.sparse[..4], &e.u, &e.u_half).expect("bounded");
                e.sparse.splice(4.., response[2..].iter().copied());
                e
            })
            .collect();
        let first = Records::new(&encoder, &Reader::new(&model, &observation), &events[4..], 1.0, 1e3)
            .error(model.coefficients(), None);
        let adam = CalibrateSettings {
            solver: Solver::Adam,
            metric: Metric::Coefficients,
            epochs: 1500,
            penalty: 0.0,
            threshold_every: 0,
            learning_rate: 2e-2,
            ..Default::default()
        };
        let gauss_newton = CalibrateSettings {
            solver: Solver::GaussNewton,
            metric: Metric::Coefficients,
            penalty_ladder: vec![1e-2, 1e-4, 1e-6],
            steps: 10,
            threshold: 0.0,
            ..Default::default()
        };
        for (settings, share) in [(adam, 0.02), (gauss_newton, 1e-4)] {
            let quiet = crate::progress::Quiet;
            let result = {
                let data = Data { simulations: &[], train: &events[..4], validation: &events[4..] };
                calibrate(&model, &encoder, &observation, &data, &settings, None, &quiet)
            }
            .expect("calibrates");
            assert!(result.validation_error < share * first, "{} from {first}", result.validation_error);
        }
    }
}
