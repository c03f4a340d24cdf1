//! From fitted models to an answer: what is named, with intervals, and what remains.

mod bagged;
mod claims;
mod declared;
mod kinds;
mod residuals;

use super::competition::Competition;
use super::convention::conventions;
use super::forward::Forward;
use super::intervals::{Member, NORMAL, averaged};
use super::parameters::{Declared, Model};
use super::posterior::{Fit, Fitter, Start, Stop};
use super::recalibration::recalibrated;
use super::spread::{Spread, band_hz, residual_powers};
use super::weights::Expected;
use crate::diagnosis::{
    Candidate, DeclaredValue, DiagnoseSettings, Diagnosis, Estimate, Found, Problem, Replay, Rest, RestVerdict, Verdict,
};
use crate::effects::{self, Instance};
use crate::error::Result;
use crate::progress::Progress;
use crate::records::Split;
use bagged::probabilities;
use declared::declared_values;
use kinds::{Masses, alternatives, besides, has_all, is_taken, known_kinds};
use residuals::{Residuals, closest_to_mean};
use std::collections::{BTreeMap, BTreeSet};

/// Probability up to which a model does not count: that nothing is missing where an effect is named, say.
pub(super) const NOTHING: f64 = 0.05;
/// Widths of priors, over what they are, with which values are found again.
const PRIOR_RATIOS: [f64; 2] = [0.5, 2.0];
/// Level of the column's error, over the declared one, from which something is missing that has no name.
const UNNAMED: f64 = 2.0;

/// Names what the declared model lacks.
///
/// # Errors
/// When an event is unusable, the column cannot be built, or the declared column cannot be replayed.
pub fn diagnose(
    problem: &Problem,
    replay: &dyn Replay,
    settings: &DiagnoseSettings,
    progress: &dyn Progress,
) -> Result<Diagnosis> {
    let forward = Forward::new(problem, replay, settings)?;
    let plain = Declared::new(problem)?;
    forward.anchor(&[])?;
    let (expected, start) = recalibrated(&forward, &plain, Vec::new())?;
    progress.note(&format!("recalibrated: level {:.2}, {} replays", expected.spread.level, forward.replays()));
    // What few elements leave wrong is taken out where it matters.
    let tables = start.0.tables(&start.1);
    forward.anchor(&tables)?;
    let declared = plain.clone().with_conventions(conventions(&forward, &tables)?);
    let model = Model { declared: &declared, effects: Vec::new() };
    let mut x = start.1;
    x.resize(model.len(), 0.0);
    let reference = std::sync::Arc::new(forward.predict(&tables)?);
    let fitter = Fitter::new(&forward, Expected { reference, ..expected });
    let fit = fitter.fit(Start::at(model, x), Stop::CLOSE)?;
    let surrogate = forward.equivalent_linear();
    let mut competition = Competition::new(fitter, fit, &surrogate, settings.max_effects);
    competition.run(progress)?;
    let mut most = BTreeMap::new();
    loop {
        let probabilities = probabilities(&forward, &competition);
        let answer = Answer { forward: &forward, competition: &competition, problem, most: &most, probabilities };
        // What is known may be part of several models and no model by itself.
        if let Some(effects) = answer.unfitted() {
            competition.fit_part(&effects)?;
        } else if let Some((kind, n)) = answer.doubtful() {
            most.insert(kind, n);
        } else {
            progress.note(&competition.replays());
            return Ok(answer.assembled());
        }
    }
}

struct Answer<'c, 'a> {
    forward: &'c Forward<'a>,
    competition: &'c Competition<'a>,
    problem: &'c Problem,
    /// How often effects of a kind are named at most, where that is limited.
    most: &'c BTreeMap<&'static str, usize>,
    /// Posterior probability of each fitted model.
    probabilities: Vec<f64>,
}

impl<'a> Answer<'_, 'a> {
    fn assembled(&self) -> Diagnosis {
        let plain = &self.competition.fits[0];
        let mass = self.masses();
        let nothing = mass.get(&Vec::new()).copied().unwrap_or(0.0);
        let best = self.competition.best();
        let is_missing = !best.model.effects.is_empty() && nothing < NOTHING;
        // What may be there besides, and may not, is not claimed: the median probability model.
        let known = known_kinds(&mass);
        let sure = self.sure(&known).filter(|_| is_missing);
        // Something besides is surely there, and no name for it is sure.
        let is_more = is_missing && mass.get(&known).copied().unwrap_or(0.0) < NOTHING;
        let has_known = |fit: &Fit<'a>| has_all(&self.claimed_kinds(fit), &known);
        let with_known = self.closest_to_mean(has_known).or(self.competition.best_of(has_known)).unwrap_or(best);
        // A response without a name is one of the models: where it is needed, something remains whatever is named.
        let unnamed = self.probabilities().filter(|(fit, _)| !fit.model.is_named()).map(|(_, p)| p).sum::<f64>();
        let is_unnamed = unnamed > 0.5;
        let mut answer = if is_more || sure.is_some() { with_known } else { plain };
        let mut rest = self.rest(answer, is_unnamed);
        // Where what is surely there has no name, names compete for what is not theirs.
        let is_ambiguous = is_more && rest.verdict != RestVerdict::Unnamed;
        if is_more && !is_ambiguous {
            answer = sure.unwrap_or(plain);
            rest = self.rest(answer, is_unnamed);
        }
        let verdict = match sure {
            _ if is_ambiguous => Verdict::Ambiguous,
            Some(_) => Verdict::Known,
            None if is_more || rest.verdict == RestVerdict::Unnamed => Verdict::Unknown,
            None => Verdict::None,
        };
        let is_named = matches!(verdict, Verdict::Known | Verdict::Ambiguous);
        let ambiguity = if is_ambiguous { alternatives(&mass, &known) } else { Vec::new() };
        // What the model that is applied has besides these is not named.
        let mut sure_kinds = known.clone();
        let is_named_kind = |kind: &&str| is_taken(&mut sure_kinds, kind) || ambiguity.iter().any(|k| k == kind);
        let named = self.claimed_kinds(answer).into_iter().filter(is_named_kind).collect();
        let open =
            (verdict == Verdict::Known).then(|| self.open_places(&known).into_iter().chain(besides(&mass, &known)));
        let members = self.members(answer);
        let claims = self.claims(answer, named, &members);
        let effects = if is_named { self.found(answer, &members, &claims.claimed) } else { Vec::new() };
        let tables: Vec<toml::Table> = effects.iter().map(|found| found.table.clone()).collect();
        let discretisation_share = self.forward.discretisation_share(&answer.model.tables(&answer.x));
        // What is in the strength of an effect is told there; velocities are a profile, which has no gaps.
        let is_told = |value: &DeclaredValue| {
            let same = |found: &Found| {
                let is_there = (&found.kind, &found.target) == (&value.kind, &value.target);
                found.is_total && is_there && found.parameters.contains_key(&value.parameter)
            };
            value.vs_range_m.is_none() && effects.iter().any(same)
        };
        let declared = declared_values(answer, &self.groups()).into_iter().filter(|value| !is_told(value)).collect();
        let left_alone = effects::left_alone(&tables, &self.problem.array.profile);
        Diagnosis {
            verdict,
            effects,
            ambiguity,
            nuisances: plain.model.declared.tables(&plain.x),
            corrected_nuisances: claims.recalibrated(answer),
            candidates: self.candidates(),
            explained_share: is_named.then(|| self.explained_share(answer)),
            declared,
            notes: [rest.sentence()]
                .into_iter()
                .chain(discretisation_share.and_then(|share| self.not_converged(share)))
                .chain(open.into_iter().flatten())
                .chain(self.not_named())
                .chain(claims.not_left_out(answer))
                .chain(left_alone)
                .collect(),
            hidden: self.competition.hidden(answer),
            rest: Some(rest),
            discretisation_share,
        }
    }

    /// A sentence where what elements and steps leave wrong is more than the error that is declared of the column.
    fn not_converged(&self, share: f64) -> Option<String> {
        let declared = self.problem.tolerances.model;
        (share > declared).then(|| {
            format!(
                "Strong motion is not converged: with elements and steps half as large that of the strongest event changes by {:.1} %, and                  the column is declared to err by {:.1} %. What is named may stand for that; `tolerances.model = {:.3}` allows for it.",
                100.0 * share,
                100.0 * declared,
                share
            )
        })
    }

    /// The most probable model of which the `known` kinds and no other are claimed, if any are known.
    fn sure(&self, known: &[&'static str]) -> Option<&Fit<'a>> {
        self.competition.best_of(|fit| !known.is_empty() && self.claimed_kinds(fit) == known)
    }

    /// The one of the probable models that `is_meant` takes whose prediction is closest to the mean over all models by their probability,
    /// in shares of the power of the records: that of the least expected square error. Where effects do alike, the mean has what they do
    /// and none of them is probable by itself, so that a model of the probable ones alone predicts worse than any that has one of them. A
    /// model that has several of them may be closer to the mean still; where it is not probable itself, it is no answer.
    ///
    /// Source: Barbieri et al. (2021), doi 10.1214/20-BA1249, for models of what is probable where effects do alike.
    fn closest_to_mean(&self, is_meant: impl Fn(&Fit<'a>) -> bool) -> Option<&Fit<'a>> {
        let probable = self.probabilities().filter(|(_, p)| *p > NOTHING).map(|(fit, _)| fit);
        let meant: Vec<&Fit<'a>> = probable.filter(|fit| is_meant(fit)).collect();
        let candidates: Vec<Residuals> = meant.iter().map(|fit| self.residuals(fit)).collect();
        let all = self.probabilities().map(|(fit, p)| (Residuals::of(&fit.prediction), p));
        closest_to_mean(&candidates, all).map(|i| meant[i])
    }

    /// Residuals beside the named effects of `fit`.
    fn residuals(&self, fit: &Fit<'a>) -> Residuals {
        Residuals::of(&self.competition.named(fit))
    }

    /// Effects of the best model that has all known kinds, where no model has these alone.
    fn unfitted(&self) -> Option<Vec<Instance>> {
        let known = known_kinds(&self.masses());
        if self.competition.fits.iter().any(|fit| self.claimed_kinds(fit) == known) {
            return None;
        }
        let of = |fit: &Fit<'a>| {
            let mut wanted = known.clone();
            let effects = fit.model.effects.iter().filter(|e| is_taken(&mut wanted, e.kind)).cloned();
            let effects: Vec<Instance> = effects.collect();
            wanted.is_empty().then_some((self.competition.log_posterior(fit), effects))
        };
        let all = self.competition.fits.iter().filter_map(of);
        all.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, effects)| effects)
    }

    /// Models that were fitted, most probable first.
    fn candidates(&self) -> Vec<Candidate> {
        let plain = &self.competition.fits[0];
        let of = |fit: &Fit<'a>| {
            let first = fit.model.effects.first()?;
            let joined = |of: &dyn Fn(&Instance) -> String| {
                fit.model.effects.iter().map(of).filter(|t| !t.is_empty()).collect::<Vec<_>>().join(" + ")
            };
            Some(Candidate {
                kind: joined(&|e| e.kind.to_string()),
                target: joined(&|e| e.place()),
                class: first.class(),
                gain: self.competition.log_posterior(fit) - self.competition.log_posterior(plain),
                validation_gain: self.validation_cost(plain) - self.validation_cost(fit),
                explained_share: self.explained_share(fit),
                round: fit.model.effects.len(),
                table: fit.model.effect_table(&fit.x, 0),
            })
        };
        let mut all: Vec<Candidate> = self.competition.fits.iter().filter_map(of).collect();
        all.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        all
    }

    /// Half the squared residuals of the validation events.
    fn validation_cost(&self, fit: &Fit<'_>) -> f64 {
        let is_meant = |at: &&super::forward::At| self.forward.groups[at.group].split == Split::Validation;
        let records = self.forward.records.iter().zip(fit.rows.iter()).filter(|(at, _)| is_meant(at));
        records.flat_map(|(_, rows)| rows).map(|r| 0.5 * r * r).sum()
    }

    /// Share of the power of the recalibrated model's residual that is not there any more.
    fn explained_share(&self, fit: &Fit<'a>) -> f64 {
        let plain = self.residuals(&self.competition.fits[0]).share();
        1.0 - self.residuals(fit).share() / plain.max(f64::MIN_POSITIVE)
    }

    /// Every fitted model with its posterior probability.
    fn probabilities(&self) -> impl Iterator<Item = (&Fit<'a>, f64)> {
        self.competition.fits.iter().zip(self.probabilities.iter().copied())
    }

    /// Posterior probability of each set of kinds.
    fn masses(&self) -> Masses {
        let mut mass: Masses = BTreeMap::new();
        for (fit, p) in self.probabilities() {
            *mass.entry(self.claimed_kinds(fit)).or_default() += p;
        }
        mass
    }

    /// A sentence for each of the `known` kinds whose place is not known with it.
    fn open_places(&self, known: &[&'static str]) -> Vec<String> {
        let of = |kind: &&'static str| {
            let mut mass: BTreeMap<String, f64> = BTreeMap::new();
            for (fit, p) in self.probabilities() {
                let own = fit.model.effects.iter().filter(|e| e.kind == *kind);
                *mass.entry(own.map(Instance::place).collect::<Vec<_>>().join(" and ")).or_default() += p;
            }
            mass.remove("");
            let mut places: Vec<(String, f64)> = mass.into_iter().filter(|(_, p)| *p > NOTHING).collect();
            places.sort_by(|a, b| b.1.total_cmp(&a.1));
            let named: Vec<String> = places.iter().map(|(place, p)| format!("{place} ({p:.2})")).collect();
            (named.len() > 1)
                .then(|| format!("{} is at one of (probability): {}.", kind.replace('_', " "), named.join(", ")))
        };
        let once: BTreeSet<&&'static str> = known.iter().collect();
        once.into_iter().filter_map(of).collect()
    }

    /// What remains beside the named effects of `fit`, and whether part of it is known to have no name.
    fn rest(&self, fit: &Fit<'a>, is_unnamed: bool) -> Rest {
        let prediction = self.competition.named(fit);
        let spread = Spread::estimated(self.forward, &prediction);
        let [repeatable, strays, recorded] = residual_powers(self.forward, &prediction, &spread);
        let share = [repeatable, strays].map(|p| p / recorded.max(f64::MIN_POSITIVE));
        let level = spread.shared_level(self.forward);
        // What repeats is what remains where it is most of it; more data would not name what strays.
        let is_mostly_repeatable = level > UNNAMED && share[0] > share[1];
        let verdict = if is_unnamed || is_mostly_repeatable {
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
            place: outputs.iter().enumerate().map(|(s, name)| (name.clone(), spread.by_band(s))).collect(),
            level,
            of_another_origin: Some(of_another_origin(fit)),
        }
    }

    /// Events of the records.
    fn groups(&self) -> Vec<usize> {
        self.forward.records.iter().map(|at| at.group).collect()
    }

    /// Models that are not much less probable than `fit`.
    fn members(&self, fit: &Fit<'_>) -> Vec<Member<'_, 'a>> {
        let groups = self.groups();
        let highest = self.competition.log_posterior(fit);
        let odds = |other: &Fit<'_>| (self.competition.log_posterior(other) - highest).exp();
        let all = self.competition.fits.iter().chain(&self.competition.modes);
        let close = all.filter(|other| odds(other) > NOTHING);
        close.map(|other| Member::new(other, odds(other), &groups)).collect()
    }

    /// Those effects of `fit` that are `claimed`, with their intervals: where declared values do the same, what is off in all.
    fn found(&self, fit: &Fit<'a>, members: &[Member<'_, 'a>], claimed: &[usize]) -> Vec<Found> {
        let by_prior = PRIOR_RATIOS.map(|ratio| fit.with_priors(ratio));
        let of = |index: usize| {
            let instance = &fit.model.effects[index];
            let (start, intervals) = (fit.model.start(index), averaged(fit, index, members));
            let total = |x: &[f64]| fit.model.total(x, index).map(|total| total.coordinate);
            let own = total(&fit.x);
            let at = |x: &[f64], i: usize| total(x).unwrap_or(x[start + i]);
            let parameters = instance.free.iter().enumerate().map(|(i, free)| {
                let (x, p) = (at(&fit.x, i), free.parameter);
                let [low, high] = p.bounds();
                let ends = intervals[i].map(|e| p.value(e.clamp(low, high)));
                let ci95 = if ends[0] <= ends[1] { ends } else { [ends[1], ends[0]] };
                let by_prior = Some(by_prior.each_ref().map(|x| p.value(at(x, i))));
                (p.name.to_string(), Estimate { value: p.value(x), unit: p.unit.to_string(), ci95, by_prior })
            });
            Found {
                kind: instance.kind.to_string(),
                target: instance.place(),
                class: instance.class(),
                table: own.map_or_else(|| fit.model.effect_table(&fit.x, index), |x| instance.at(&[x])),
                parameters: parameters.collect(),
                is_total: own.is_some(),
                gain: self.competition.log_posterior(fit) - self.competition.log_posterior(&self.competition.fits[0]),
                validation_gain: self.validation_cost(&self.competition.fits[0]) - self.validation_cost(fit),
                p_value: self.competition.p_value(fit, index),
            }
        };
        claimed.iter().map(|index| of(*index)).collect()
    }
}

/// Share of what strays that is of another origin.
fn of_another_origin(fit: &Fit<'_>) -> Estimate {
    let at = fit.model.declared.added();
    let half = NORMAL * fit.covariance().map_or(1.0, |c| c[(at, at)].sqrt());
    let value = fit.x[at];
    let ci95 = [value - half, value + half].map(|end| end.clamp(0.0, 1.0));
    let by_prior = Some(PRIOR_RATIOS.map(|ratio| fit.with_priors(ratio)[at]));
    Estimate { value, unit: String::new(), ci95, by_prior }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{DAMPING, Truth, Uniform, problem};
    use super::*;
    use crate::progress::Quiet;

    const FEW: Truth<'static> =
        Truth { table: "", soil: [200.0, DAMPING], noise_m_s2: 0.01, coherence: |_| 1.0, seed: 5, events: 4 };

    fn diagnosed(truth: &Truth<'_>) -> Diagnosis {
        let problem = problem(truth);
        diagnose(&problem, &Uniform(&problem), &DiagnoseSettings::default(), &Quiet).unwrap()
    }

    #[test]
    fn nothing_is_named_where_nothing_is_missing() {
        let found = diagnosed(&Truth { soil: [204.0, 0.022], ..FEW });
        assert_eq!((found.verdict, found.effects.len()), (Verdict::None, 0), "{:?}", found.candidates.first());
        assert_eq!(found.rest.unwrap().verdict, RestVerdict::Noise);
        let kinds: BTreeSet<&String> = found.hidden.iter().map(|hidden| &hidden.kind).collect();
        assert_eq!(kinds.len(), found.hidden.len());
        // What is named in the next test is more than what could hide.
        let least = found.hidden.iter().find(|hidden| hidden.kind == "clock_offset").unwrap().least.unwrap();
        assert!(0.0 < least && least < 0.025, "{least}");
    }

    #[test]
    fn a_late_clock_is_named_with_an_interval_that_holds() {
        let table = "kind = 'clock_offset'\nsensor = 'mid'\noffset_s = 0.025";
        let found = diagnosed(&Truth { table, ..FEW });
        assert_eq!((found.verdict, found.effects.len()), (Verdict::Known, 1), "{:?}", found.candidates);
        assert_eq!(found.effects[0].kind, "clock_offset");
        let [low, high] = found.effects[0].parameters["offset_s"].ci95;
        assert!(low <= 0.025 && 0.025 <= high, "{:?}", found.effects[0].parameters);
        assert!(found.explained_share.unwrap() > 0.8, "{:?}", found.explained_share);
    }

    #[test]
    fn a_tilt_is_named() {
        let table = "kind = 'baseline_tilt'\nsensor = 'top'\ntilt_deg = -0.2";
        let found = diagnosed(&Truth { table, ..FEW });
        assert_eq!((found.verdict, found.effects.len()), (Verdict::Known, 1), "{:?}", found.candidates);
        let [low, high] = found.effects[0].parameters["tilt_deg"].ci95;
        assert!(low <= -0.2 && -0.2 <= high && high - low < 0.16, "{:?}", found.effects[0].parameters);
        assert!(-0.3 < low && high < -0.1, "{:?}", found.effects[0].parameters);
    }

    #[test]
    fn exchanged_labels_are_named() {
        // The input too: what is recalibrated beside another input is far from what holds.
        for [sensor, with] in [["mid", "top"], ["base", "mid"]] {
            let table = format!("kind = 'swapped_channels'\nsensor = '{sensor}'\nwith = '{with}'");
            let found = diagnosed(&Truth { table: &table, ..FEW });
            let tables: Vec<String> = found.effects.iter().map(|e| e.table.to_string().replace('"', "'")).collect();
            assert_eq!(tables, [format!("{table}\n")], "{:?}", found.candidates);
        }
    }

    #[test]
    fn what_is_known_is_named_beside_a_field_that_strays() {
        let coherence = |f: f64| if f < 1.0 { 0.97 } else { (0.97 - 0.25 * f.ln()).max(0.4) };
        let found = diagnosed(&Truth { soil: [200.0, 0.1], coherence, ..FEW });
        assert_eq!(found.verdict, Verdict::Known, "{:?}", found.candidates);
        let gains: Vec<_> = found.candidates.iter().map(|c| (&c.kind, c.gain)).collect();
        assert_eq!(found.effects[0].kind, "small_strain_damping", "{gains:?}");
        let beside = found.corrected_nuisances.iter().find(|t| t["kind"].as_str() == Some("small_strain_damping"));
        let beside = beside.and_then(|t| t["multiplier"].as_float()).unwrap_or(1.0);
        let damping_ratio = DAMPING * beside * found.effects[0].parameters["multiplier"].value;
        assert!((damping_ratio / 0.1 - 1.0).abs() < 0.1, "{damping_ratio}");
        let rest = found.rest.unwrap();
        assert_eq!(rest.verdict, RestVerdict::Incoherent);
        assert!(rest.coherence["top"].iter().all(|[f, c]| (c - coherence(*f)).abs() < 0.1), "{:?}", rest.coherence);
    }
}
