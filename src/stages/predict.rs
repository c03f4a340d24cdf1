//! The calibrated model of one component, ready to predict events in physical units.

use super::dataset::{self, Card};
use super::extend::SOURCE;
use crate::error::{Error, Result};
use crate::flare::{self, Calibration, Observation, SourceModel, SparseEncoder};
use std::path::Path;

/// Sparse encoder, calibrated latent equations and decoder with their normalisation.
pub struct Predictor {
    card: Card,
    model: SourceModel,
    encoder: SparseEncoder,
    observation: Observation,
    calibration: Calibration,
}

impl Predictor {
    /// Loads the outputs of the stages `dataset`, `pretrain`, `distill` and `calibrate`; instead of the last that of `extend`, which has
    /// a source model of its own.
    ///
    /// # Errors
    /// When a checkpoint cannot be read.
    pub fn load(dataset: &Path, pretrain: &Path, distill: &Path, calibrate: &Path) -> Result<Self> {
        let own = calibrate.join(SOURCE);
        let (model, _) = SourceModel::load(if own.is_dir() { &own } else { pretrain })?;
        let (encoder, observation) = SparseEncoder::load(distill)?;
        let calibration = Calibration::load(calibrate, &model.shape)?;
        Ok(Self { card: dataset::card(dataset)?, model, encoder, observation, calibration })
    }

    /// Step of the latent model, s.
    pub fn step_s(&self) -> f64 {
        self.card.step_s
    }

    /// Samples of the initial window; the first prediction is of the sample after them.
    pub fn window(&self) -> usize {
        self.encoder.window
    }

    /// Scales the model was trained with.
    pub fn card(&self) -> &Card {
        &self.card
    }

    /// Histories at the sensors from sample [`Predictor::window`] on, m/s².
    ///
    /// `initial_m_s2` holds one history a sensor (only its first [`Predictor::window`] samples are used); `base_m_s2` and
    /// `half_m_s2` the base at the steps and half a step later, from the same start.
    ///
    /// # Errors
    /// When the window is too short, the latent state leaves its bounds, or the prediction is not finite.
    pub fn predict(&self, initial_m_s2: &[Vec<f64>], base_m_s2: &[f64], half_m_s2: &[f64]) -> Result<Vec<Vec<f64>>> {
        let (window, n_sensor) = (self.encoder.window, self.observation.n_sensor());
        if let Some(short) = initial_m_s2.iter().find(|h| h.len() < window) {
            let needed = (window - 1) as f64 * self.card.step_s;
            return Err(Error::new(format!(
                "the initial window must span {needed} s ({window} samples), got {}",
                short.len()
            )));
        }
        let rows: Vec<f64> = (0..window).flat_map(|k| initial_m_s2.iter().map(move |h| h[k])).collect();
        let scales = &self.card.normalisation;
        let predicted = flare::predict(
            &self.model,
            &self.encoder,
            &self.calibration.coefficients,
            &self.observation,
            &scales.sparse(&rows),
            &scales.base(base_m_s2),
            &scales.base(half_m_s2),
        )?;
        let rows = scales.sparse_to_m_s2(&predicted);
        if let Some(i) = rows.iter().position(|v| !v.is_finite()) {
            let time_s = (window + i / n_sensor) as f64 * self.card.step_s;
            return Err(Error::new(format!("the prediction is not finite at {time_s:.3} s")));
        }
        Ok((0..n_sensor).map(|j| rows.iter().skip(n_sensor + j).step_by(n_sensor).copied().collect()).collect())
    }
}
