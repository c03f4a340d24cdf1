//! The three training sections of a site manifest, with their defaults and range checks.

use super::memory::Memories;
use crate::ranges::{Range, Ranged, outside, range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Most states of a model, hidden ones included.
const LATENT: usize = 32;
/// Widest hidden layer.
const WIDEST: f64 = 4096.0;
/// Most epochs, and most of what is counted in them.
const MOST: f64 = 1e6;

/// Stage 1: the source model from dense simulations (`[pretrain]`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PretrainSettings {
    /// Samples in the encoder's window, L.
    pub window: usize,
    /// Latent dimension, r (1…32).
    pub latent: usize,
    /// Hidden states beside them: at rest in the beginning, moved by the same library, not encoded and not decoded; none
    /// as published.
    pub hidden: usize,
    /// Dense channels kept, evenly spaced over the elements.
    pub channels: usize,
    /// Sampling interval of the model (s).
    pub step_s: f64,
    /// Sequences each training motion is divided into.
    pub segments: usize,
    /// Sequences each motion is divided into in the second half of the epochs (longer rollouts).
    pub final_segments: usize,
    /// Widths of the encoder's hidden layers.
    pub encoder_hidden: Vec<usize>,
    /// Widths of the decoder's hidden layers.
    pub decoder_hidden: Vec<usize>,
    /// Memories of the shaking that the latent equations may multiply their linear terms with; none as published.
    pub memories: Memories,
    /// Levels of latent energy that they may multiply the states with (0…3); none as published.
    pub energy_levels: usize,
    /// Passes over the training sequences.
    pub epochs: usize,
    /// Sequences per step of the optimiser.
    pub batch: usize,
    /// Learning rate of encoder and decoder at the start.
    pub learning_rate: f64,
    /// Learning rate of the coefficients at the start (coefficients are per sample).
    pub dynamics_learning_rate: f64,
    /// Share of the learning rates left at the last epoch (half a cosine; 1 keeps them constant).
    pub final_rate_share: f64,
    /// Weights of the five loss terms.
    pub loss: LossWeights,
    /// Coefficients below this (per sample) are removed for good at each thresholding.
    pub threshold: f64,
    /// Epochs between thresholdings, each of which restarts the optimiser; 0 for none. The last quarter has none.
    pub threshold_every: usize,
    /// Each case counts with its response amplitude to the power −2 × this: 0 as published, 1 all motions alike.
    pub amplitude_weighting: f64,
    /// Start encoder, dynamics and decoder from the best linear state-space model, with straight linear paths.
    pub linear_start: bool,
    /// Half of the sequences, drawn anew each epoch, are turned over in sign (the column knows no left and right).
    pub mirror: bool,
    /// Sequences begin at places drawn anew each epoch.
    pub jitter: bool,
    /// Gauss–Newton steps on the coefficients over whole motions, taken each time; none as published.
    pub polish_steps: usize,
    /// Epochs between two times, counted back from the last epoch to half of them.
    pub polish_every: usize,
    /// Epochs between validations by whole-motion rollout.
    pub validate_every: usize,
    /// Validations between checkpoints of the training state.
    pub checkpoint_every: usize,
    /// Latent states beyond this count as diverged.
    pub state_bound: f64,
    /// A candidate must also survive the validation motions multiplied by this (1 asks for the motions alone).
    pub stress_factor: f64,
    /// The trained states are limited softly from this multiple of their range in the training simulations on; 0 for never,
    /// as published.
    pub limit_factor: f64,
}

impl Default for PretrainSettings {
    fn default() -> Self {
        Self {
            window: 3,
            latent: 8,
            hidden: 2,
            channels: 100,
            step_s: 0.05,
            segments: 5,
            final_segments: 2,
            encoder_hidden: vec![128, 128],
            decoder_hidden: vec![128, 128],
            memories: Memories { fading_s: vec![1.0], lasting_s: vec![5.0] },
            energy_levels: 2,
            epochs: 250,
            batch: 16,
            learning_rate: 1e-3,
            dynamics_learning_rate: 1e-3,
            final_rate_share: 0.01,
            loss: LossWeights::default(),
            threshold: 1e-3,
            threshold_every: 100,
            amplitude_weighting: 1.0,
            linear_start: true,
            mirror: true,
            jitter: true,
            polish_steps: 8,
            polish_every: 125,
            validate_every: 5,
            checkpoint_every: 5,
            state_bound: 1e3,
            stress_factor: 1.0,
            limit_factor: 0.75,
        }
    }
}

impl PretrainSettings {
    /// Every value out of range, with its key.
    pub fn problems(&self) -> Vec<(String, String)> {
        let mut list = self.beyond();
        if let Some(most) = LATENT.checked_sub(self.latent)
            && let Some(what) = outside([0.0, most as f64], "", self.hidden as f64)
        {
            list.push(("hidden".into(), format!("must be {what}: `latent` and `hidden` are {LATENT} at the most")));
        }
        list
    }
}

impl Ranged for PretrainSettings {
    const RANGES: &'static [Range<Self>] = &[
        range!(window, "", 1.0, 100.0),
        range!(latent, "", 1.0, LATENT as f64),
        range!(channels, "", 1.0, 10_000.0),
        range!(step_s, "s", 1e-4, 10.0),
        range!(segments, "", 1.0, 1000.0),
        range!(final_segments, "", 1.0, 1000.0),
        range!(each encoder_hidden, "", 1.0, WIDEST),
        range!(each decoder_hidden, "", 1.0, WIDEST),
        range!(energy_levels, "", 0.0, 3.0),
        range!(each memories.fading_s, "s", 0.01, 1e4),
        range!(each memories.lasting_s, "s", 0.01, 1e4),
        range!(epochs, "", 1.0, MOST),
        range!(batch, "", 1.0, 1e5),
        range!(learning_rate, "", 1e-8, 1.0),
        range!(dynamics_learning_rate, "", 0.0, 1.0),
        range!(final_rate_share, "", 0.0, 1.0),
        range!(threshold, "1/sample", 0.0, 10.0),
        range!(amplitude_weighting, "", 0.0, 1.0),
        range!(validate_every, "", 1.0, MOST),
        range!(checkpoint_every, "", 1.0, MOST),
        range!(state_bound, "", 1.0, 1e12),
        range!(stress_factor, "", 1.0, 100.0),
        range!(limit_factor, "", 0.0, 100.0),
        range!(loss.reconstruction, "", 0.0, 1e6),
        range!(loss.rollout, "", 0.0, 1e6),
        range!(loss.latent, "", 0.0, 1e6),
        range!(loss.equation, "", 0.0, 1e6),
        range!(loss.sparsity, "", 0.0, 1e6),
    ];
}

/// Weights of the stage-1 loss terms (`[pretrain.loss]`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LossWeights {
    /// λ_rec, decoded encoded state against the response.
    pub reconstruction: f64,
    /// λ_roll, decoded rollout against the response.
    pub rollout: f64,
    /// λ_lat, rollout against the encoded state (held fixed).
    pub latent: f64,
    /// λ_eq, central difference of the encoded state against Θ Ξ.
    pub equation: f64,
    /// λ_1, mean absolute coefficient.
    pub sparsity: f64,
}

impl Default for LossWeights {
    fn default() -> Self {
        Self { reconstruction: 0.5, rollout: 1.0, latent: 0.01, equation: 0.001, sparsity: 1e-4 }
    }
}

/// Stage 2: the sparse encoder by latent matching (`[distill]`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DistillSettings {
    /// Samples in the sparse encoder's window, L.
    pub window: usize,
    /// Widths of its hidden layers.
    pub hidden: Vec<usize>,
    /// Passes over the training windows.
    pub epochs: usize,
    /// Windows per step of the optimiser.
    pub batch: usize,
    /// Learning rate at the start.
    pub learning_rate: f64,
    /// Share of it left at the last epoch.
    pub final_rate_share: f64,
    /// As in `[pretrain]`.
    pub amplitude_weighting: f64,
    /// As in `[pretrain]`.
    pub mirror: bool,
    /// Add a straight linear path, started from linear least squares.
    pub linear_start: bool,
}

impl Default for DistillSettings {
    fn default() -> Self {
        Self {
            window: 3,
            hidden: vec![128, 128],
            epochs: 150,
            batch: 512,
            learning_rate: 2e-3,
            final_rate_share: 0.01,
            amplitude_weighting: 1.0,
            mirror: true,
            linear_start: true,
        }
    }
}

impl Ranged for DistillSettings {
    const RANGES: &'static [Range<Self>] = &[
        range!(window, "", 1.0, 100.0),
        range!(each hidden, "", 1.0, WIDEST),
        range!(epochs, "", 1.0, MOST),
        range!(batch, "", 1.0, MOST),
        range!(learning_rate, "", 1e-8, 1.0),
        range!(final_rate_share, "", 0.0, 1.0),
        range!(amplitude_weighting, "", 0.0, 1.0),
    ];
}

/// Stage 3: the correction of the coefficients by records (`[calibrate]`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CalibrateSettings {
    /// How the coefficients are searched.
    pub solver: Solver,
    /// How the size of a correction is measured.
    pub metric: Metric,
    /// Adam: passes over the training events.
    pub epochs: usize,
    /// Adam: learning rate of the coefficients at the start (coefficients are per sample).
    pub learning_rate: f64,
    /// Adam: share of it left at the last epoch.
    pub final_rate_share: f64,
    /// Adam: λ_Δ, weight of the relative size of the correction.
    pub penalty: f64,
    /// Gauss–Newton, and more terms without a name: values of λ_Δ tried one after the other, falling; the validation events choose.
    pub penalty_ladder: Vec<f64>,
    /// Gauss–Newton: which terms may move, tried one after the other; the validation events choose.
    pub free_terms: Vec<FreeTerms>,
    /// The same: most steps for one value of λ_Δ; thresholding follows.
    pub steps: usize,
    /// Calibrated coefficients below this (per sample) are removed for good at each thresholding.
    pub threshold: f64,
    /// Adam: epochs between thresholdings, each of which restarts the optimiser; 0 for none. The last quarter has none.
    pub threshold_every: usize,
    /// Each event counts with its response amplitude to the power −2 × this: 0 as published, 1 all events alike.
    pub amplitude_weighting: f64,
    /// Adam: epochs between validations by complete rollout.
    pub validate_every: usize,
    /// Latent states beyond this count as diverged.
    pub state_bound: f64,
}

/// How stage 3 searches the coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Solver {
    /// Gradient descent, as published.
    Adam,
    /// Gauss–Newton steps with forward sensitivities.
    GaussNewton,
}

/// Which terms of the latent equations stage 3 may correct.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FreeTerms {
    /// All but the products of two states.
    Linear,
    /// All, as published.
    All,
}

/// How stage 3 measures the size of a correction, one latent equation at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Metric {
    /// By the coefficients themselves, as published.
    Coefficients,
    /// By the change of the equation where the simulations have been.
    Field,
}

impl Default for CalibrateSettings {
    fn default() -> Self {
        Self {
            solver: Solver::GaussNewton,
            metric: Metric::Field,
            epochs: 600,
            learning_rate: 5e-4,
            final_rate_share: 0.02,
            penalty: 1.0,
            penalty_ladder: vec![300.0, 100.0, 30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001],
            free_terms: vec![FreeTerms::Linear, FreeTerms::All],
            steps: 6,
            threshold: 1e-3,
            threshold_every: 200,
            amplitude_weighting: 1.0,
            validate_every: 5,
            state_bound: 1e3,
        }
    }
}

impl CalibrateSettings {
    /// Every value out of range, with its key.
    pub fn problems(&self) -> Vec<(String, String)> {
        let mut list = self.beyond();
        let mut length = |key: &str, n: usize, most: f64| {
            let what =
                outside([1.0, most], "", n as f64).map(|what| (key.to_string(), format!("must have a length {what}")));
            list.extend(what);
        };
        length("penalty_ladder", self.penalty_ladder.len(), 100.0);
        length("free_terms", self.free_terms.len(), 10.0);
        list
    }
}

impl Ranged for CalibrateSettings {
    const RANGES: &'static [Range<Self>] = &[
        range!(epochs, "", 1.0, MOST),
        range!(learning_rate, "", 1e-8, 1.0),
        range!(final_rate_share, "", 0.0, 1.0),
        range!(penalty, "", 0.0, 1e6),
        range!(each penalty_ladder, "", 0.0, 1e6),
        range!(steps, "", 1.0, 1000.0),
        range!(threshold, "1/sample", 0.0, 10.0),
        range!(amplitude_weighting, "", 0.0, 1.0),
        range!(validate_every, "", 1.0, MOST),
        range!(state_bound, "", 1.0, 1e12),
    ];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_in_range_and_all_problems_are_listed_at_once() {
        assert!(PretrainSettings::default().problems().is_empty());
        assert!(DistillSettings::default().beyond().is_empty());
        assert!(CalibrateSettings::default().problems().is_empty());
        let wrong = PretrainSettings { latent: 40, step_s: -0.05, encoder_hidden: vec![0], ..Default::default() };
        let keys: Vec<String> = wrong.problems().into_iter().map(|(key, _)| key).collect();
        assert_eq!(keys, ["latent", "step_s", "encoder_hidden[1]"]);
    }

    #[test]
    fn a_short_section_takes_the_rest_from_the_defaults_and_unknown_keys_are_refused() {
        let settings: PretrainSettings = toml::from_str("latent = 14\nloss = { equation = 0.0 }").expect("parses");
        assert_eq!(settings.latent, 14);
        assert_eq!(settings.loss.rollout, 1.0);
        assert!(toml::from_str::<PretrainSettings>("latnet = 14").is_err());
    }
}
