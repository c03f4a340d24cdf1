//! Stage 3: the latent equations corrected by records, everything else held.
//!
//! ```text
//! Ξ = Ξ₀ + ΔΞ,   L = mean ((C D(ẑ) − a_s)/σ_s)² + λ_Δ · mean_k |Δξ_k|²/|ξ₀_k|²                             (1)
//! ```
//!
//! `ẑ` is the complete rollout from the sparse encoder's state at the end of the first window, `k` counts the latent
//! equations. Selection is by the complete-rollout error of the validation events; a candidate that diverges on one of
//! them cannot be selected. Called once for each component.

use super::adam::{Adam, cosine};
use super::case::Event;
use super::events::{Reader, Records};
use super::history::History;
use super::model::{SourceModel, SparseEncoder};
use super::observation::Observation;
use super::pretrain::thresholds_after;
use super::settings::CalibrateSettings;
use crate::error::{Error, Result};
use crate::progress::Progress;

/// Longest gradient an optimiser step may follow.
const CLIP: f64 = 10.0;

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

/// Calibrates the coefficients on `train` and keeps those best on `validation`; `Ξ₀` itself is the first candidate.
///
/// # Errors
/// When events do not fit the model, or no candidate survives the validation events.
pub fn calibrate(
    model: &SourceModel,
    encoder: &SparseEncoder,
    observation: &Observation,
    train: &[Event],
    validation: &[Event],
    settings: &CalibrateSettings,
    progress: &dyn Progress,
) -> Result<Calibration> {
    check(model, encoder, observation, train, validation, settings)?;
    let reader = Reader::new(model, observation);
    let bound = settings.state_bound as f32;
    let train = Records::new(encoder, &reader, train, settings.amplitude_weighting, bound);
    let validation = Records::new(encoder, &reader, validation, settings.amplitude_weighting, bound);
    let origin = model.coefficients();
    let mut xi = origin.to_vec();
    let mut mask = model.mask.clone();
    let mut adam = Adam::new(xi.len());
    let mut gradient = vec![0.0; xi.len()];
    let mut best = (validation.error(&xi, None), xi.clone(), mask.clone());
    let mut history = History::new(&["epoch", "total", "observation", "penalty", "terms", "validation"]);
    history.rows.push(vec![0.0, f64::NAN, train.error(&xi, None), 0.0, count(&mask), finite_or_nan(best.0)]);
    progress.start("calibrate", settings.epochs as u64);
    for epoch in 0..settings.epochs {
        let error = train.error(&xi, Some(&mut gradient));
        let penalty = relative_penalty(origin, &xi, model.shape.latent, settings.penalty, &mut gradient);
        gradient.iter_mut().zip(&mask).filter(|(_, keep)| !**keep).for_each(|(g, _)| *g = 0.0);
        let rate = settings.learning_rate * cosine(epoch as f64 / settings.epochs as f64, settings.final_rate_share);
        adam.update(&mut xi, &gradient, &[(0..origin.len(), rate)], CLIP);
        let done = epoch + 1;
        if thresholds_after(done, settings.epochs, settings.threshold_every) {
            for (c, keep) in xi.iter_mut().zip(&mut mask) {
                *keep &= f64::from(c.abs()) >= settings.threshold;
                *c = if *keep { *c } else { 0.0 };
            }
            adam.restart();
        }
        let is_judged = done == settings.epochs || done.is_multiple_of(settings.validate_every);
        let judged = if is_judged { validation.error(&xi, None) } else { f64::INFINITY };
        if judged < best.0 {
            best = (judged, xi.clone(), mask.clone());
        }
        let total = error + settings.penalty * penalty;
        history.rows.push(vec![done as f64, total, error, penalty, count(&mask), finite_or_nan(judged)]);
        progress.advance(1);
    }
    let (validation_error, coefficients, mask) = best;
    if !validation_error.is_finite() {
        return Err(Error::new("no calibrated coefficients survive the validation events")
            .hint("lower `learning_rate`, or raise `penalty`"));
    }
    let cosine_similarity = cosine_similarity(origin, &coefficients);
    Ok(Calibration { coefficients, mask, cosine_similarity, validation_error, history })
}

fn check(
    model: &SourceModel,
    encoder: &SparseEncoder,
    observation: &Observation,
    train: &[Event],
    validation: &[Event],
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
    for (events, what) in [(train, "training"), (validation, "validation")] {
        if events.is_empty() {
            return Err(Error::new(format!("there is no {what} event")));
        }
        events.iter().try_for_each(|e| e.check(encoder.n_sensor, encoder.window))?;
    }
    Ok(())
}

/// `mean_k |Δξ_k|²/|ξ₀_k|²`; `factor` times its gradient is added.
fn relative_penalty(origin: &[f32], xi: &[f32], r: usize, factor: f64, gradient: &mut [f32]) -> f64 {
    let norms = |x: &dyn Fn(usize) -> f64| -> Vec<f64> {
        (0..r).map(|k| (k..origin.len()).step_by(r).map(|i| x(i).powi(2)).sum()).collect()
    };
    let size = norms(&|i| f64::from(origin[i])).into_iter().map(|s| s.max(1e-12)).collect::<Vec<f64>>();
    let change = norms(&|i| f64::from(xi[i] - origin[i]));
    for (i, g) in gradient.iter_mut().enumerate() {
        *g += (2.0 * factor * f64::from(xi[i] - origin[i]) / (size[i % r] * r as f64)) as f32;
    }
    change.iter().zip(&size).map(|(c, s)| c / s).sum::<f64>() / r as f64
}

fn count(mask: &[bool]) -> f64 {
    mask.iter().filter(|k| **k).count() as f64
}

fn finite_or_nan(value: f64) -> f64 {
    if value.is_finite() { value } else { f64::NAN }
}

fn cosine_similarity(a: &[f32], b: &[f32]) -> f64 {
    let dot = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
    dot(a, b) / (dot(a, a) * dot(b, b)).sqrt().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flare::mlp::Tape;
    use crate::flare::model::Shape;
    use crate::flare::rollout::{observe, predict};
    use crate::flare::{DistillSettings, PretrainSettings};
    use crate::numerics::random::stream;
    use rand::RngExt;

    fn random(n: usize, scale: f32, label: &str) -> Vec<f32> {
        let mut random = stream(6, label);
        (0..n).map(|_| scale * (2.0 * random.random::<f32>() - 1.0)).collect()
    }

    fn problem() -> (SourceModel, SparseEncoder, Observation) {
        let settings = PretrainSettings {
            latent: 3,
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
        (0..3).for_each(|k| {
            parameters[shape.library().linear_row(k) * 3 + k] -= 0.6;
            parameters[shape.library().input_row() * 3 + k] += 0.8;
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

    fn event(n_step: usize, label: &str) -> Event {
        let u = random(n_step, 1.0, &format!("{label} u"));
        let u_half = random(n_step - 1, 1.0, &format!("{label} half"));
        Event { id: label.into(), u, u_half, sparse: random(2 * n_step, 1.0, &format!("{label} sparse")) }
    }

    #[test]
    fn the_gradient_by_the_coefficients_matches_finite_differences_for_events_of_unequal_length() {
        let (model, encoder, observation) = problem();
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

    #[test]
    fn the_gradient_of_the_penalty_matches_finite_differences() {
        let (model, ..) = problem();
        let origin = model.coefficients();
        let xi: Vec<f32> = origin.iter().zip(random(origin.len(), 0.1, "delta")).map(|(a, b)| a + b).collect();
        let value = |xi: &[f32]| relative_penalty(origin, xi, 3, 0.7, &mut vec![0.0; xi.len()]);
        let mut gradient = vec![0.0; xi.len()];
        relative_penalty(origin, &xi, 3, 0.7, &mut gradient);
        for i in 0..xi.len() {
            let (mut up, mut down) = (xi.clone(), xi.clone());
            up[i] += 1e-3;
            down[i] -= 1e-3;
            let slope = 0.7 * (value(&up) - value(&down)) / f64::from(up[i] - down[i]);
            assert!((f64::from(gradient[i]) - slope).abs() < 1e-4 * (1.0 + slope.abs()));
        }
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
        let settings = CalibrateSettings {
            epochs: 1500,
            penalty: 0.0,
            threshold_every: 0,
            learning_rate: 2e-2,
            ..Default::default()
        };
        let quiet = crate::progress::Quiet;
        let result = calibrate(&model, &encoder, &observation, &events[..4], &events[4..], &settings, &quiet)
            .expect("calibrates");
        let first = result.history.column("validation").expect("column")[0];
        assert!(result.validation_error < 0.02 * first, "{} from {first}", result.validation_error);
    }
}
