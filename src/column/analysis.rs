//! How the column is stepped through time: the manifest's `[analysis]`.

use crate::ranges::{Range, Ranged, problem, range};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Shortest step of a column and of its output, s, and shortest one before a run is given up, s.
const STEP_S: f64 = 1e-6;
const LEAST_STEP_S: f64 = 1e-12;

/// Mass matrix of an element.
///
/// ```text
/// M = (1 − a) lumped + a consistent,   δω/ω = (2a − 1)/24 (kh)² − κ (ω Δt)²                   (1)
/// κ = 1/12 − α/4 − 3α²/8                                                                      (2)
/// ```
///
/// | symbol | what                                             | unit |
/// |--------|--------------------------------------------------|------|
/// | k h    | wave number times height of the element          | –    |
/// | Δt     | [`Analysis::max_step_s`]                         | s    |
/// | α      | [`Analysis::hht_alpha`]                          | –    |
///
/// Sources: (1) for a = 0, ½, 1: Hughes (2000), The Finite Element Method, section 7.3.2 and chapter 9 (matched methods).
/// (2) is the expansion of the HHT method's amplification matrix. Check: `with_matched_mass_half_the_elements_and_twice_the_step_are_as_exact`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MassMatrix {
    /// Half of an element's mass at each of its nodes, a = 0: mesh and steps both make waves slower.
    #[default]
    Lumped,
    /// The a with which what elements and steps of `max_step_s` do to the velocity of small waves cancels, 1 at the most: half
    /// as many elements and steps twice as long are as exact.
    Matched,
}

impl MassMatrix {
    /// Share a of the consistent mass, 0…1, of elements that a small wave crosses in `crossing_s`.
    pub(super) fn consistent_share(self, crossing_s: f64, analysis: &Analysis) -> f64 {
        let alpha = analysis.hht_alpha;
        let kappa = 1.0 / 12.0 - alpha / 4.0 - 0.375 * alpha * alpha; // (2)
        match self {
            Self::Lumped => 0.0,
            Self::Matched => (0.5 + 12.0 * kappa * (analysis.max_step_s / crossing_s).powi(2)).min(1.0), // (1)
        }
    }
}

/// Time stepping of the column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Analysis {
    /// First time increment, s.
    pub initial_step_s: f64,
    /// Largest time increment, s.
    pub max_step_s: f64,
    /// Smallest time increment before the run is given up, s.
    pub min_step_s: f64,
    /// Output interval, s.
    pub output_step_s: f64,
    /// Numerical damping α of the HHT method, −1/3…0.
    pub hht_alpha: f64,
    /// Largest unbalanced nodal traction, as a share of the largest dynamic stress so far.
    pub tolerance: f64,
    /// Newton iterations allowed per increment before it is halved.
    pub max_iterations: u32,
    /// How the mass of elements is shared among nodes.
    pub mass: MassMatrix,
    /// Largest change of a nodal acceleration within an increment, as a share of the largest acceleration so far; a
    /// larger one is taken in shorter increments, down to an eighth of `max_step_s`.
    pub max_jump: f64,
}

impl Default for Analysis {
    fn default() -> Self {
        Self {
            initial_step_s: 0.001,
            max_step_s: 0.005,
            min_step_s: 1e-7,
            output_step_s: 0.005,
            hht_alpha: -0.05,
            tolerance: 1e-4,
            max_iterations: 12,
            mass: MassMatrix::Lumped,
            max_jump: 0.2,
        }
    }
}

impl Analysis {
    /// What is out of range, as (key, sentence).
    pub fn problems(&self) -> Vec<(String, String)> {
        let mut problems = self.beyond();
        // Where the end of a range is out of range itself, nothing is beyond it.
        if self.max_step_s >= STEP_S {
            problems.extend(problem("initial_step_s", [STEP_S, self.max_step_s], "s", self.initial_step_s));
        }
        if self.initial_step_s >= STEP_S {
            problems.extend(problem("min_step_s", [LEAST_STEP_S, self.initial_step_s], "s", self.min_step_s));
        }
        problems
    }
}

impl Ranged for Analysis {
    const RANGES: &'static [Range<Self>] = &[
        range!(max_step_s, "s", STEP_S, 1.0),
        range!(output_step_s, "s", STEP_S, 1.0),
        range!(hht_alpha, "", -1.0 / 3.0, 0.0),
        range!(tolerance, "", 1e-12, 0.05),
        range!(max_jump, "", 0.01, f64::INFINITY),
        range!(max_iterations, "", 2.0, 1000.0),
    ];
}
