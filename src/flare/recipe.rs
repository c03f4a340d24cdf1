//! The published method, exactly, in place of what this program puts on top of it.
//!
//! Sizes, epochs and thresholds stay what the manifest says; all that was added since is switched off. What was not
//! published, the batch and the weights of the terms, is that of the benchmark.

use super::memory::Memories;
use super::settings::{CalibrateSettings, DistillSettings, FreeTerms, LossWeights, Metric, PretrainSettings, Solver};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How the three stages are trained.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Recipe {
    /// As the sections say.
    #[default]
    Tuned,
    /// As published, whatever the sections say of it.
    Published,
}

impl PretrainSettings {
    /// Without linear start, memories, hidden states, energies, weighting, mirroring, polish and limits, at constant rates.
    #[must_use]
    pub fn as_published(&self) -> Self {
        Self {
            final_segments: self.segments,
            batch: 32,
            loss: LossWeights { reconstruction: 1.0, rollout: 1.0, latent: 0.1, equation: 0.1, sparsity: 1e-4 },
            dynamics_learning_rate: self.learning_rate,
            final_rate_share: 1.0,
            amplitude_weighting: 0.0,
            linear_start: false,
            memories: Memories::default(),
            hidden: 0,
            energy_levels: 0,
            mirror: false,
            jitter: false,
            limit_factor: 0.0,
            polish_steps: 0,
            ..self.clone()
        }
    }
}

impl DistillSettings {
    /// Without linear start, weighting and mirroring, at a constant rate.
    #[must_use]
    pub fn as_published(&self) -> Self {
        Self { final_rate_share: 1.0, amplitude_weighting: 0.0, mirror: false, linear_start: false, ..self.clone() }
    }
}

impl CalibrateSettings {
    /// By Adam at a constant rate, all terms free, corrections measured by the coefficients, events unweighted.
    #[must_use]
    pub fn as_published(&self) -> Self {
        Self {
            solver: Solver::Adam,
            metric: Metric::Coefficients,
            final_rate_share: 1.0,
            free_terms: vec![FreeTerms::All],
            amplitude_weighting: 0.0,
            ..self.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ranges::Ranged as _;

    #[test]
    fn as_published_keeps_sizes_and_is_in_range() {
        let own = PretrainSettings { latent: 14, hidden: 6, channels: 70, epochs: 9, ..Default::default() };
        let published = own.as_published();
        assert_eq!((published.latent, published.hidden, published.channels, published.epochs), (14, 0, 70, 9));
        assert_eq!(published.as_published(), published);
        assert!(published.problems().is_empty());
        assert!(DistillSettings::default().as_published().beyond().is_empty());
        assert!(CalibrateSettings::default().as_published().problems().is_empty());
    }
}
