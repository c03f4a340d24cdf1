//! From fitted models to an answer: what is named, with intervals, and what remains.

use super::competition::Competition;
use super::convention::conventions;
use super::forward::{Forward, Prediction};
use super::parameters::{Declared, Model};
use super::posterior::{Fit, Fitter, Start, Stop};
use super::weights::{Spread, band_hz, residual_powers};
use crate::diagnosis::{DiagnoseSettings, Estimate, Problem, Replay, Verdict};
use crate::effects;
use crate::error::Result;
use crate::metrics::t_quantile;
use crate::progress::Progress;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Largest probability that nothing is missing beside which an effect is named.
const NOTHING: f64 = 0.05;
/// Least probability of the kinds that are named without alternatives.
const KNOWN: f64 = 0.9;
/// Two-sided 95 % quantile of a normal number.
const NORMAL: f64 = 1.96;
/// Most rounds of recalibration, and the change of the column's level (ln) below which they end.
const RECALIBRATIONS: usize = 4;
const STILL: f64 = 0.1;
/// When a fit of these rounds ends.
const ROUGHLY: Stop = Stop { steps: 12, gain: 0.5, is_exact: true };
/// Level of the column's error, over the declared one, from which something is missing that has no name.
const UNNAMED: f64 = 2.0;

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
}

/// A named effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Named {
    /// Name of the effect.
    pub kind: String,
    /// Where it sits, for people; empty for the whole column.
    pub target: String,
    /// Its `[[effects]]` table.
    pub table: toml::Table,
    /// Its parameters by name, with 95 % intervals.
    pub parameters: BTreeMap<String, Estimate>,
}

/// A set of kinds with its posterior probability.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Probable {
    /// Kinds of the effects; none where nothing is missing.
    pub kinds: Vec<String>,
    /// Posterior probability among all models that were fitted.
    pub probability: f64,
}

/// `competition.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// What is named: `unknown` only where nothing is and something that is the same in all events remains.
    pub verdict: Verdict,
    /// Named effects.
    pub effects: Vec<Named>,
    /// Sets of kinds, most probable first.
    pub probabilities: Vec<Probable>,
    /// Declared values recalibrated without any effect, as `[[effects]]`.
    pub recalibrated: Vec<toml::Table>,
    /// The same beside the named effects.
    pub beside: Vec<toml::Table>,
    /// Power of the residual over that of the records, mean over training and validation records and sensors: as declared,
    /// recalibrated, with the answer.
    pub residual_share: [f64; 3],
    /// What remains.
    pub rest: Rest,
}

/// Names what the declared model lacks.
///
/// # Errors
/// When an event is unusable, the column cannot be built, or the declared column cannot be replayed.
pub fn compete(
    problem: &Problem,
    replay: &dyn Replay,
    settings: &DiagnoseSettings,
    progress: &dyn Progress,
) -> Result<Compared> {
    let forward = Forward::new(problem, replay, settings)?;
    let plain = Declared::new(problem)?;
    let declared_error = forward.predict(&[])?;
    let (spread, start) = recalibrated(&forward, &plain)?;
    progress.note(&format!("recalibrated: level {:.2}, {} replays", spread.level, forward.replays()));
    // What few elements leave wrong is taken out where it matters.
    let tables = start.0.tables(&start.1);
    forward.anchor(&tables)?;
    let declared = plain.clone().with_conventions(conventions(&forward, settings, &tables)?);
    let model = Model { declared: &declared, effects: Vec::new() };
    let mut x = start.1;
    x.resize(model.len(), 0.0);
    let prediction = std::sync::Arc::new(forward.predict(&tables)?);
    let fitter = Fitter::new(&forward, spread, prediction);
    let fit = fitter.fit(Start { model, x, slopes: Vec::new() }, Stop::EXACT)?;
    let mut competition = Competition::new(fitter, fit, settings.max_effects);
    competition.run(progress)?;
    progress.note(&format!("{} replays", forward.replays()));
    Ok(Answer { forward: &forward, competition: &competition, problem }.assembled(&declared_error))
}

/// What is declared, most probable within its tolerances: what the records say of the field and of the column's error is read off
/// beside it, until that stands still.
fn recalibrated<'a>(forward: &Forward<'a>, declared: &'a Declared) -> Result<(Spread, (Model<'a>, Vec<f64>))> {
    let model = Model { declared, effects: Vec::new() };
    let mut x = vec![0.0; model.len()];
    let mut prediction = std::sync::Arc::new(forward.predict(&[])?);
    let mut spread = Spread::estimated(forward, &prediction);
    for _ in 0..RECALIBRATIONS {
        let fitter = Fitter::new(forward, spread.clone(), prediction.clone());
        let fit = fitter.fit(Start { model: model.clone(), x, slopes: Vec::new() }, ROUGHLY)?;
        (x, prediction) = (fit.x, fit.prediction);
        let found = Spread::estimated(forward, &prediction);
        let is_still = (found.level / spread.level).ln().abs() < STILL;
        spread = found;
        if is_still {
            break;
        }
    }
    Ok((spread, (model, x)))
}

struct Answer<'c, 'a> {
    forward: &'c Forward<'a>,
    competition: &'c Competition<'a>,
    problem: &'c Problem,
}

impl Answer<'_, '_> {
    fn assembled(&self, declared: &Prediction) -> Compared {
        let plain = &self.competition.fits[0];
        let mass = self.masses();
        let nothing = mass.get(&Vec::new()).copied().unwrap_or(0.0);
        let best = self.competition.best();
        let is_named = !best.model.effects.is_empty() && nothing < NOTHING;
        let answer = if is_named { best } else { plain };
        let is_alone = mass.get(&kinds(answer)).copied().unwrap_or(0.0) >= KNOWN;
        let rest = self.rest(answer);
        let verdict = match (is_named, is_alone, rest.verdict) {
            (true, true, _) => Verdict::Known,
            (true, false, _) => Verdict::Ambiguous,
            (false, _, RestVerdict::Unnamed) => Verdict::Unknown,
            (false, ..) => Verdict::None,
        };
        let mut probabilities: Vec<Probable> = mass
            .iter()
            .filter(|(_, p)| **p > 0.001)
            .map(|(kinds, p)| Probable { kinds: kinds.iter().map(ToString::to_string).collect(), probability: *p })
            .collect();
        probabilities.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let range = answer.model.declared.len();
        Compared {
            verdict,
            effects: if is_named { self.found(answer) } else { Vec::new() },
            probabilities,
            recalibrated: plain.model.declared.tables(&plain.x),
            beside: answer.model.declared.tables(&answer.x[..range]),
            residual_share: [declared, &plain.prediction, &answer.prediction].map(|p| self.misfit(p)),
            rest,
        }
    }

    /// Posterior probability of each set of kinds.
    fn masses(&self) -> BTreeMap<Vec<&'static str>, f64> {
        let fits = &self.competition.fits;
        let highest = self.competition.log_posterior(self.competition.best());
        let mut mass: BTreeMap<Vec<&'static str>, f64> = BTreeMap::new();
        for fit in fits {
            *mass.entry(kinds(fit)).or_default() += (self.competition.log_posterior(fit) - highest).exp();
        }
        let total: f64 = mass.values().sum();
        mass.values_mut().for_each(|m| *m /= total);
        mass
    }

    /// Residual power over that of the records, mean over records and sensors.
    fn misfit(&self, prediction: &Prediction) -> f64 {
        let mut sum = [0.0, 0.0];
        for p in prediction {
            for (y, m) in p.outputs.iter().zip(&p.measured) {
                let power: f64 = m.iter().map(|m| m.norm_sqr()).sum();
                let rest: f64 = m.iter().zip(y).map(|(m, y)| (m - y).norm_sqr()).sum();
                sum[0] += rest / power.max(f64::MIN_POSITIVE);
                sum[1] += 1.0;
            }
        }
        sum[0] / f64::max(sum[1], 1.0)
    }

    /// What remains beside `fit`.
    fn rest(&self, fit: &Fit<'_>) -> Rest {
        let spread = Spread::estimated(self.forward, &fit.prediction);
        let [repeatable, strays, recorded] = residual_powers(self.forward, &fit.prediction, &spread);
        let share = [repeatable, strays].map(|p| p / recorded.max(f64::MIN_POSITIVE));
        let verdict = if spread.level > UNNAMED {
            RestVerdict::Unnamed
        } else if share[1] > self.problem.tolerances.model.powi(2) {
            RestVerdict::Incoherent
        } else {
            RestVerdict::Noise
        };
        let outputs = &self.problem.array.outputs;
        let ends = band_hz(self.forward);
        let coherence = outputs.iter().enumerate().map(|(s, name)| (name.clone(), spread.at_knots(s, ends)));
        Rest {
            verdict,
            share: share[0] + share[1],
            repeatable_share: share[0],
            coherence: coherence.collect(),
            place: outputs.iter().cloned().zip(spread.repeatable.iter().cloned()).collect(),
            level: spread.level,
        }
    }

    /// Named effects; an interval is that of the curvature or of leaving one event out, whichever is wider.
    fn found(&self, fit: &Fit<'_>) -> Vec<Named> {
        let groups: Vec<usize> = self.forward.records.iter().map(|at| at.group).collect();
        let spread = half_widths(fit, &groups);
        let of = |(index, instance): (usize, &effects::Instance)| {
            let start = fit.model.start(index);
            let parameters = instance.free.iter().enumerate().map(|(i, free)| {
                let (x, half, p) = (fit.x[start + i], spread[start + i], free.parameter);
                let [low, high] = p.bounds();
                let ends = [x - half, x + half].map(|e| p.value(e.clamp(low, high)));
                let ci95 = if ends[0] <= ends[1] { ends } else { [ends[1], ends[0]] };
                (p.name.to_string(), Estimate { value: p.value(x), unit: p.unit.to_string(), ci95 })
            });
            Named {
                kind: instance.kind.to_string(),
                target: instance.place(),
                table: fit.model.effect_table(&fit.x, index),
                parameters: parameters.collect(),
            }
        };
        fit.model.effects.iter().enumerate().map(of).collect()
    }
}

/// Half widths of 95 % intervals of the coordinates.
fn half_widths(fit: &Fit<'_>, groups: &[usize]) -> Vec<f64> {
    let n = fit.x.len();
    let covariance = fit.covariance();
    let left_out = fit.without_each_event(groups);
    let e = left_out.len() as f64;
    (0..n)
        .map(|i| {
            let curved = NORMAL * covariance.as_ref().map_or(f64::INFINITY, |c| c[(i, i)].sqrt());
            if left_out.len() < 2 {
                return curved;
            }
            let mean = left_out.iter().map(|x| x[i]).sum::<f64>() / e;
            let square: f64 = left_out.iter().map(|x| (x[i] - mean).powi(2)).sum();
            let jackknife = ((e - 1.0) / e * square).sqrt() * t_quantile(0.975, left_out.len() - 1);
            curved.max(jackknife)
        })
        .collect()
}

fn kinds(fit: &Fit<'_>) -> Vec<&'static str> {
    let mut kinds: Vec<&'static str> = fit.model.effects.iter().map(|e| e.kind).collect();
    kinds.sort_unstable();
    kinds
}

impl Compared {
    /// The same as a [`crate::diagnosis::Diagnosis`].
    pub fn diagnosis(&self) -> crate::diagnosis::Diagnosis {
        use crate::diagnosis::{Candidate, Found};
        let class = |kind: &str| effects::find(kind).map_or(effects::Class::Soil, |e| e.catalogue.class);
        let found: Vec<Found> = self.effects.iter().map(|n| Found { kind: n.kind.clone(), target: n.target.clone(), class: class(&n.kind), table: n.table.clone(), parameters: n.parameters.clone(), gain: 0.0, validation_gain: 0.0, is_standing: false }).collect();
        let candidates: Vec<Candidate> = self.probabilities.iter().filter(|p| !p.kinds.is_empty()).map(|p| Candidate { kind: p.kinds[0].clone(), target: String::new(), class: class(&p.kinds[0]), gain: p.probability, validation_gain: 0.0, explained_share: 0.0, round: 1, is_confirmed: true, table: toml::Table::new() }).collect();
        let mut ambiguity: Vec<String> = Vec::new();
        if self.verdict == Verdict::Ambiguous { for p in &self.probabilities { for k in &p.kinds { if p.probability > 0.05 && !ambiguity.contains(k) { ambiguity.push(k.clone()); } } } }
        crate::diagnosis::Diagnosis {
            verdict: self.verdict, effects: found, ambiguity, nuisances: self.recalibrated.clone(), corrected_nuisances: self.beside.clone(), candidates,
            explained_share: None, input_coherent_share: None, declared: Default::default(), recalibrated: Default::default(), corrected: Default::default(),
            tolerance_alarms: Vec::new(), upper_bounds: Vec::new(),
            remainder: crate::diagnosis::Remainder { edges_hz: Vec::new(), sensor_band: BTreeMap::new(), sensor_phase: BTreeMap::new(), event: Vec::new() },
            evidence: Default::default(), notes: Vec::new(),
        }
    }
}
