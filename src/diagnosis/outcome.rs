//! What a diagnosis says: verdict, named effects, what else was considered, and what remains.

use crate::effects::Class;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The answer in a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Nothing beyond the declared tolerances.
    None,
    /// Named effects explain what was there.
    Known,
    /// Something is there, besides named effects or alone, that effects of several kinds explain alike.
    Ambiguous,
    /// There is structure that no named effect explains.
    Unknown,
}

/// A parameter with its 95 % interval.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Value.
    pub value: f64,
    /// Unit; empty where there is none.
    pub unit: String,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// The value were every prior half and twice as wide: what it owes to them.
    #[serde(default)]
    pub by_prior: Option<[f64; 2]>,
}

/// A named effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Name of the effect.
    pub kind: String,
    /// Where it sits, for people; empty for the whole column.
    pub target: String,
    /// What it acts on.
    pub class: Class,
    /// The `[[effects]]` table of the corrected manifest.
    pub table: toml::Table,
    /// Its parameters by name.
    pub parameters: BTreeMap<String, Estimate>,
    /// Whether its parameter has in it what is recalibrated of the same declared value.
    #[serde(default)]
    pub is_total: bool,
    /// ln of the odds of the model with all named effects against what is declared.
    pub gain: f64,
    /// Fall of the cost on the validation events alone.
    pub validation_gain: f64,
    /// Probability that chance brings as much to the model without it, by draws of that model through the same search; `None` for what is
    /// there or not and what takes numbers from records.
    #[serde(default)]
    pub p_value: Option<f64>,
}

/// An effect that was tried.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Name of the effect.
    pub kind: String,
    /// Where it sits.
    pub target: String,
    /// What it acts on.
    pub class: Class,
    /// ln of the odds against what is declared.
    pub gain: f64,
    /// Fall of the cost on the validation events alone.
    pub validation_gain: f64,
    /// Share of the power of the recalibrated model's residual that it explains.
    pub explained_share: f64,
    /// Number of effects of the model.
    pub round: usize,
    /// Its `[[effects]]` table.
    pub table: toml::Table,
}

/// A declared value that may be off, beside the answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DeclaredValue {
    /// Name of the effect that moves it.
    pub kind: String,
    /// Where it sits; empty for the whole column.
    pub target: String,
    /// Parameter of the effect.
    pub parameter: String,
    /// Depths between which it is ln of a factor of the shear-wave velocity, m; none for other values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vs_range_m: Option<[f64; 2]>,
    /// Distance from what is declared, prior standard deviations.
    pub deviations: f64,
    /// Whether it is at the end of its tolerance: it stands in for something else.
    pub is_at_end: bool,
    /// Value of the parameter by the records and the tolerance.
    pub estimate: Estimate,
    /// By the records and the tolerances of everything else; none where they tell next to nothing of it, and where an effect is named that
    /// does the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by_records: Option<Estimate>,
}

/// An effect that the records would show least of all its places.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hidden {
    /// Name of the effect.
    pub kind: String,
    /// That place; empty for the whole column.
    pub target: String,
    /// Its strength parameter.
    pub parameter: String,
    /// Unit of the parameter.
    pub unit: String,
    /// The smallest strength that would be named in 80 % of cases; none where twice a typical one would not be.
    pub least: Option<f64>,
}

/// What remains beside the answer, in a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RestVerdict {
    /// No more than noise of sensors and the declared error of the model itself.
    Noise,
    /// Motion that does not follow the base in the same way in all events.
    Incoherent,
    /// Something that is the same in all events and has no name.
    Unnamed,
}

/// What remains beside the answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rest {
    /// In a word.
    pub verdict: RestVerdict,
    /// Its power over that of the records, noise of sensors taken off.
    pub share: f64,
    /// The part of it that is the same in all events.
    pub repeatable_share: f64,
    /// Coherence of each output sensor with the prediction: frequency in Hz, and c.
    pub coherence: BTreeMap<String, Vec<[f64; 2]>>,
    /// What is the same in all events of each output sensor, as a share of what the column adds to its base: frequency in Hz, real and
    /// imaginary part.
    #[serde(rename = "where")]
    pub place: BTreeMap<String, Vec<[f64; 3]>>,
    /// Error of the column over the declared one, at least 1.
    pub level: f64,
    /// Share of what does not follow the base that is of another origin and comes on top of the column's motion, 0 to 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub of_another_origin: Option<Estimate>,
}

impl Rest {
    /// The same in a sentence.
    pub fn sentence(&self) -> String {
        let percent = |share: f64| format!("{:.2} %", 100.0 * share);
        match self.verdict {
            RestVerdict::Noise => {
                "What remains is no more than noise of the sensors and the declared error of the column.".into()
            }
            RestVerdict::Incoherent => {
                let added = self.of_another_origin.as_ref().map_or_else(String::new, |added| {
                    let [value, low, high] = [added.value, added.ci95[0], added.ci95[1]].map(|v| 100.0 * v);
                    format!(" Of it, {value:.0} % [{low:.0}, {high:.0}] comes on top of what the column passes on, from another origin.")
                });
                format!(
                    "What remains, {} of the power of the records, does not follow the base in the same way in all events: no correction of \
                     the site removes it.{added}",
                    percent(self.share)
                )
            }
            RestVerdict::Unnamed => format!(
                "What remains has a part that is the same in all events and has no name: {} of the power of the records, {:.1} times the \
                 error that the column is declared to have (`tolerances.model`).",
                percent(self.repeatable_share),
                self.level
            ),
        }
    }
}

/// `diagnosis.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Diagnosis {
    /// The answer.
    pub verdict: Verdict,
    /// Effects that the records ask for, in the order they were found; empty without an alarm.
    pub effects: Vec<Found>,
    /// Kinds of which one explains what is there besides the other named effects, where none of them is sure.
    pub ambiguity: Vec<String>,
    /// Recalibrated declared values as `[[effects]]`, without any new effect.
    pub nuisances: Vec<toml::Table>,
    /// The same, fitted together with the named effects, and with them effects that the records ask for and that are not named: their
    /// strength may be none, or others that do alike are probable too.
    pub corrected_nuisances: Vec<toml::Table>,
    /// Models that were fitted, most probable first.
    pub candidates: Vec<Candidate>,
    /// Share of the power of the recalibrated model's residual that the named effects explain.
    pub explained_share: Option<f64>,
    /// Every declared value that may be off: velocities, then the others.
    pub declared: Vec<DeclaredValue>,
    /// Kinds that could be there unnoticed beside the answer, the best hidden first.
    #[serde(default)]
    pub hidden: Vec<Hidden>,
    /// What remains beside the answer, where the diagnosis says it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rest: Option<Rest>,
    /// What elements and steps half as large would change of the motions of the strongest event under the model of the answer, over these
    /// motions; none where that is not known.
    #[serde(default)]
    pub discretisation_share: Option<f64>,
    /// Remarks for people.
    pub notes: Vec<String>,
}

#[cfg(test)]
impl Diagnosis {
    /// One that found nothing and leaves nothing, but for the `given` keys.
    pub(crate) fn made_up(given: serde_json::Value) -> Self {
        let mut all = serde_json::json!({
            "verdict": "none", "effects": [], "ambiguity": [], "nuisances": [], "corrected_nuisances": [],
            "candidates": [], "explained_share": null, "declared": [], "notes": [],
        });
        given.as_object().into_iter().flatten().for_each(|(key, value)| all[key] = value.clone());
        serde_json::from_value(all).expect("a diagnosis")
    }
}
