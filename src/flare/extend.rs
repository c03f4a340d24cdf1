//! The latent equations with terms that no simulation has asked for: what records say beyond every named effect, without a name.
//!
//! ```text
//! dz/dt = Θ(z, u) Ξ + Θ_new(z, u) Ξ_new                                                                   (1)
//! min over Ξ_new of  mean ((C D(ẑ) − a_s)/σ_s)² + λ R(Ξ_new)                                               (2)
//! ```
//!
//! Ξ stays as stage 3 has left it. Θ_new are groups of terms that the model lacks: products of states and base acceleration with a
//! faster or a slower memory of the shaking (`u z_i`, `u²` and `|u| u` are of this kind, and these keep the sign of the motion), or
//! products of the states with one more level of their energy (of the kind `z_i |z_i|`); or all of them. The validation events choose
//! group and λ. A group is taken where it lowers their error by [`WORTH`], with each of them left out too, and still does in [`STABLE`]
//! of the fits with one training event left out.
//!
//! It is no physics: nothing says what the terms stand for, and the same terms at another site mean something else.
//!
//! Limits: few events choose among many fits, and Ξ has seen all training events; only held-out events tell what it is worth.
//! Check:  `terms_that_records_ask_for_are_taken_and_help_events_that_nobody_looked_at`, `noise_asks_for_no_terms`.
//! Source: after the idea of Fasel, Kutz, Brunton and Brunton (2022), Ensemble-SINDy, that terms must survive resampling.

use super::calibrate::{Calibration, Data, cosine_similarity};
use super::case::Event;
use super::events::{Reader, Records};
use super::gauss_newton::{Descent, FIRST_DAMPING, PATIENCE, SMALLEST_GAIN};
use super::history::History;
use super::library::ENERGY;
use super::model::{Shape, SourceModel, SparseEncoder};
use super::observation::Observation;
use super::penalty::Penalty;
use super::settings::CalibrateSettings;
use crate::progress::Progress;
use serde::{Deserialize, Serialize};

/// Share by which more terms must lower the error of the validation events.
const WORTH: f64 = 0.01;
/// Share of the fits with a training event left out that must do so too.
const STABLE: f64 = 0.8;
/// Fewest training events.
const FEWEST: usize = 2;
/// Time constants of the memories where none of the model fades, s.
const MEMORIES_S: [f64; 2] = [0.25, 4.0];
/// How much faster and slower than those it has they are.
const APART: f64 = 4.0;
/// Columns of the history: the place of the group among those tried, λ, error of the validation events.
const COLUMNS: [&str; 3] = ["group", "weight", "validation"];

/// Groups of terms that were tried, and what of them is there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tried {
    /// The group, for people.
    pub terms: String,
    /// Coefficients that it adds.
    pub n_coefficient: usize,
    /// λ of the best fit; none where no fit was better than none.
    pub weight: Option<f64>,
    /// Error of the validation events with it (mean squared, sensors in units of σ_s).
    pub validation_error: f64,
    /// Share of the fits with a training event left out that lower that error as well; for the best group alone.
    pub stability: Option<f64>,
    /// Whether it lowers that error with each validation event left out; for the best group alone.
    pub is_shared: Option<bool>,
}

/// A calibration with more terms, or the same one where none is worth it.
#[derive(Debug, Clone)]
pub struct Extension {
    /// The source model, Ξ₀ and all, with room for the terms.
    pub source: SourceModel,
    /// The calibrated coefficients and those of the terms.
    pub calibration: Calibration,
    /// The group that was taken.
    pub taken: Option<String>,
    /// All groups.
    pub tried: Vec<Tried>,
}

/// Terms to add.
#[derive(Debug, Clone, PartialEq)]
struct Group {
    terms: String,
    /// Time constants of fading memories, s.
    fading_s: Vec<f64>,
    energies: usize,
}

impl Extension {
    /// No more terms.
    pub fn none(source: &SourceModel, calibration: &Calibration, tried: Vec<Tried>) -> Self {
        Self { source: source.clone(), calibration: calibration.clone(), taken: None, tried }
    }
}

/// Extends the latent equations of `source` that were calibrated to `calibration`, with the events and the settings of that
/// calibration: its ladder of penalties, most steps on a rung, metric, weighting and bound, whatever its solver was.
pub fn extend(
    source: &SourceModel,
    calibration: &Calibration,
    (encoder, observation): (&SparseEncoder, &Observation),
    data: &Data<'_>,
    settings: &CalibrateSettings,
    progress: &dyn Progress,
) -> Extension {
    let mut tried = Vec::new();
    if data.train.len() < FEWEST {
        return Extension::none(source, calibration, tried);
    }
    let groups = groups(&source.shape);
    progress.start("extend", groups.len() as u64);
    let before = calibration.validation_error;
    let mut history = History::new(&COLUMNS);
    let mut best: Option<(usize, Bench<'_>, Fit)> = None;
    for (i, group) in groups.iter().enumerate() {
        let wide = Wide::new(source, (&calibration.coefficients, &calibration.mask), group);
        let penalty = Penalty::of(settings.metric, &wide.model, data.simulations);
        let bench = Bench { wide, penalty, encoder, observation, settings, data };
        let found = bench.ladder(before, |weight, judged| history.rows.push(vec![i as f64, weight, judged]));
        tried.push(Tried {
            terms: group.terms.clone(),
            n_coefficient: bench.wide.new.len(),
            weight: found.as_ref().map(|f| f.weight),
            validation_error: found.as_ref().map_or(before, |f| f.validation),
            stability: None,
            is_shared: None,
        });
        // All of them are more than any one.
        let is_more = best.is_none() || i + 1 == groups.len();
        let so_far = best.as_ref().map_or(before, |(.., fit)| fit.validation);
        let least = if is_more { (1.0 - WORTH) * so_far } else { so_far };
        if let Some(found) = found.filter(|f| f.validation < least) {
            best = Some((i, bench, found));
        }
        progress.advance(1);
    }
    let Some((i, bench, fit)) = best else { return Extension::none(source, calibration, tried) };
    let (stability, is_shared) = (bench.stability(fit.weight, before), bench.is_shared(&fit.xi));
    (tried[i].stability, tried[i].is_shared) = (Some(stability), Some(is_shared));
    if stability < STABLE || !is_shared {
        return Extension::none(source, calibration, tried);
    }
    let mask = bench.wide.model.mask.clone();
    let wide = Wide::new(source, (source.coefficients(), &source.mask), &groups[i]).model;
    let calibration = Calibration {
        cosine_similarity: cosine_similarity(wide.coefficients(), &fit.xi),
        mask,
        coefficients: fit.xi,
        validation_error: fit.validation,
        history,
    };
    Extension { source: wide, calibration, taken: Some(tried[i].terms.clone()), tried }
}

/// The groups that a model of this shape can be given, the one of all last.
fn groups(shape: &Shape) -> Vec<Group> {
    let known = || shape.memories.fading_s.iter().copied();
    let (shortest_s, longest_s) = (known().fold(f64::INFINITY, f64::min), known().fold(0.0, f64::max));
    let [fast_s, slow_s] = if longest_s > 0.0 { [shortest_s / APART, longest_s * APART] } else { MEMORIES_S };
    let memory = |terms: &str, fading_s: f64| Group {
        terms: format!("{terms} memory of {fading_s} s"),
        fading_s: vec![fading_s],
        energies: 0,
    };
    let mut groups = vec![memory("faster", fast_s), memory("slower", slow_s)];
    let energies = usize::from(shape.energy_levels < ENERGY.len());
    if energies > 0 {
        groups.push(Group { terms: "one more level of energy".into(), fading_s: Vec::new(), energies });
    }
    groups.push(Group { terms: "all of these".into(), fading_s: vec![fast_s, slow_s], energies });
    groups
}

/// A model with room for more terms, which are zero.
struct Wide {
    model: SourceModel,
    /// Indices of their coefficients.
    new: Vec<usize>,
}

impl Wide {
    /// The networks of `model` with these `coefficients` of its terms, kept where the `mask` says so.
    fn new(model: &SourceModel, (coefficients, mask): (&[f32], &[bool]), group: &Group) -> Self {
        let mut shape = model.shape.clone();
        let n_fading = shape.memories.fading_s.len();
        shape.memories.fading_s.extend(&group.fading_s);
        shape.energy_levels += group.energies;
        let (old, wide) = (model.shape.library(), shape.library());
        let r = old.latent;
        // The new memories follow those that fade; behind them everything is so many rows further down.
        let (first, shift) = (old.input_row() + 1 + n_fading * (r + 1), group.fading_s.len() * (r + 1));
        let place = |i: usize| if i / r < first { i } else { i + shift * r };
        let n = wide.n_coefficient();
        let (mut moved, mut kept, mut is_new) = (vec![0.0; n], vec![true; n], vec![true; n]);
        for (i, (coefficient, is_kept)) in coefficients.iter().zip(mask).enumerate() {
            (moved[place(i)], kept[place(i)], is_new[place(i)]) = (*coefficient, *is_kept, false);
        }
        let networks = &model.parameters[model.shape.coefficient_range().end..];
        let parameters = [&moved, networks].concat();
        let new = (0..n).filter(|i| is_new[*i]).collect();
        Self { model: SourceModel { shape, parameters, mask: kept }, new }
    }
}

/// Coefficients with more terms.
struct Fit {
    xi: Vec<f32>,
    weight: f64,
    validation: f64,
}

/// What a group is tried on.
struct Bench<'a> {
    wide: Wide,
    penalty: Penalty,
    encoder: &'a SparseEncoder,
    observation: &'a Observation,
    settings: &'a CalibrateSettings,
    data: &'a Data<'a>,
}

impl Bench<'_> {
    /// The best fit on the validation events of all down the ladder of penalties, where it is better than `before`; every rung with its
    /// error is `told`.
    fn ladder(&self, before: f64, mut told: impl FnMut(f64, f64)) -> Option<Fit> {
        let reader = Reader::new(&self.wide.model, self.observation);
        let validation = self.records(&reader, self.data.validation);
        let (mut best, mut lowest, mut idle): (Option<Fit>, f64, usize) = (None, before, 0);
        self.walk(&self.records(&reader, self.data.train), |weight, xi| {
            let judged = validation.error(xi, None);
            told(weight, judged);
            idle += 1;
            if judged < lowest {
                (lowest, idle) = (judged, 0);
                best = Some(Fit { xi: xi.to_vec(), weight, validation: judged });
            }
            idle < PATIENCE
        });
        best
    }

    /// Share of the fits at `weight` with one training event left out whose error of the validation events is clearly below `before`.
    fn stability(&self, weight: f64, before: f64) -> f64 {
        let reader = Reader::new(&self.wide.model, self.observation);
        let validation = self.records(&reader, self.data.validation);
        let is_better = |others: &Vec<Event>| {
            let mut judged = f64::INFINITY;
            self.walk(&self.records(&reader, others), |at, xi| {
                if at == weight {
                    judged = validation.error(xi, None);
                }
                at != weight
            });
            judged < (1.0 - WORTH) * before
        };
        let all = each_left_out(self.data.train);
        all.iter().filter(|others| is_better(others)).count() as f64 / all.len().max(1) as f64
    }

    /// Whether the coefficients `xi` lower the error of the validation events with each of these left out.
    fn is_shared(&self, xi: &[f32]) -> bool {
        let reader = Reader::new(&self.wide.model, self.observation);
        each_left_out(self.data.validation).iter().filter(|others| !others.is_empty()).all(|others| {
            let records = self.records(&reader, others);
            records.error(xi, None) < records.error(self.wide.model.coefficients(), None)
        })
    }

    /// Down the ladder of penalties on (2), each rung from where the last one ended, as long as `goes_on` says after one.
    fn walk(&self, train: &Records<'_>, mut goes_on: impl FnMut(f64, &[f32]) -> bool) {
        let penalty = &self.penalty;
        let mut xi = self.wide.model.coefficients().to_vec();
        for weight in self.settings.penalty_ladder.iter().copied() {
            let descent = Descent { train, penalty, weight, free: &self.wide.new };
            let mut damping = FIRST_DAMPING;
            for _ in 0..self.settings.steps {
                let old = train.misfit(&xi).0 + weight * penalty.value(&xi);
                let normal = train.normal(&xi, &self.wide.new);
                let Some((moved, observation)) = descent.step(&normal, &xi, old, &mut damping) else { break };
                xi = moved;
                if observation + weight * penalty.value(&xi) > (1.0 - SMALLEST_GAIN) * old {
                    break;
                }
            }
            if !goes_on(weight, &xi) {
                break;
            }
        }
    }

    fn records<'b>(&self, reader: &'b Reader<'b>, events: &[Event]) -> Records<'b> {
        let settings = self.settings;
        Records::new(self.encoder, reader, events, settings.amplitude_weighting, settings.state_bound as f32)
    }
}

/// The events without each of them in turn.
fn each_left_out(events: &[Event]) -> Vec<Vec<Event>> {
    let without = |left_out: usize| {
        let others = events.iter().enumerate().filter(|(i, _)| *i != left_out);
        others.map(|(_, event)| event.clone()).collect()
    };
    (0..events.len()).map(without).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flare::calibrate::tests::{event, random, with_hidden};
    use crate::flare::rollout::predict;
    use crate::flare::{Metric, Normalisation};
    use crate::progress::Quiet;

    fn calibrated(hidden: usize) -> (SourceModel, Calibration, SparseEncoder, Observation) {
        let (model, encoder, observation) = with_hidden(hidden);
        let calibration = Calibration {
            coefficients: model.coefficients().to_vec(),
            mask: model.mask.clone(),
            cosine_similarity: 1.0,
            validation_error: f64::INFINITY,
            history: History::default(),
        };
        (model, calibration, encoder, observation)
    }

    /// Events as `xi` makes them of `model`, with noise.
    fn made(
        (model, xi): (&SourceModel, &[f32]),
        (encoder, observation): (&SparseEncoder, &Observation),
        noise: f32,
    ) -> Vec<Event> {
        let of = |i: usize| {
            let mut e = event(120 + 10 * i, &format!("extension {i}"));
            // Strong and weak ones: memories tell them apart.
            let size = [0.3, 1.0, 3.0][i % 3];
            e.u.iter_mut().chain(&mut e.u_half).for_each(|u| *u *= size);
            let response =
                predict(model, encoder, xi, observation, &e.sparse[..4], &e.u, &e.u_half).expect("a bounded rollout");
            let noise = random(response.len() - 2, noise, &format!("noise {i}"));
            e.sparse.splice(4.., response[2..].iter().zip(noise).map(|(a, n)| a + n));
            e
        };
        (0..12).map(of).collect()
    }

    fn extended(noise: f32, truth: Option<&str>) -> (Extension, f64, f64) {
        let (model, mut calibration, encoder, observation) = calibrated(0);
        let settings =
            CalibrateSettings { metric: Metric::Coefficients, amplitude_weighting: 0.5, ..Default::default() };
        let group = truth.and_then(|t| groups(&model.shape).into_iter().find(|g| g.terms.contains(t)));
        let events = match &group {
            None => made((&model, model.coefficients()), (&encoder, &observation), noise),
            Some(group) => {
                let wide = Wide::new(&model, (&calibration.coefficients, &calibration.mask), group);
                let mut xi = wide.model.coefficients().to_vec();
                let strengths = random(wide.new.len(), 0.5, "strengths");
                wide.new.iter().zip(strengths).for_each(|(i, s)| xi[*i] = s);
                made((&wide.model, &xi), (&encoder, &observation), noise)
            }
        };
        let data = Data { simulations: &[], train: &events[..6], validation: &events[6..9] };
        let error = |model: &SourceModel, xi: &[f32], events: &[Event]| {
            let reader = Reader::new(model, &observation);
            Records::new(&encoder, &reader, events, 0.5, 1e3).error(xi, None)
        };
        calibration.validation_error = error(&model, &calibration.coefficients, data.validation);
        let found = extend(&model, &calibration, (&encoder, &observation), &data, &settings, &Quiet);
        let before = error(&model, &calibration.coefficients, &events[9..]);
        let after = error(&found.source, &found.calibration.coefficients, &events[9..]);
        (found, before, after)
    }

    #[test]
    fn terms_of_no_strength_change_nothing() {
        for (hidden, fading_s, lasting_s, energy_levels) in [(0, vec![], vec![], 0), (2, vec![1.0], vec![5.0], 1)] {
            let (mut model, mut calibration, encoder, observation) = calibrated(hidden);
            // Each term that a model has already must find its new place.
            let networks = model.parameters[model.shape.coefficient_range().end..].to_vec();
            (model.shape.memories.fading_s, model.shape.memories.lasting_s) = (fading_s, lasting_s);
            model.shape.energy_levels = energy_levels;
            let more = model.shape.library().n_coefficient() - calibration.coefficients.len();
            calibration.coefficients.extend(random(more, 0.2, "more"));
            calibration.mask = (0..calibration.coefficients.len()).map(|i| i % 5 != 2).collect();
            model.parameters = [calibration.coefficients.clone(), networks].concat();
            model.mask.clone_from(&calibration.mask);
            let events = made((&model, model.coefficients()), (&encoder, &observation), 0.5);
            let error = |model: &SourceModel| {
                let reader = Reader::new(model, &observation);
                Records::new(&encoder, &reader, &events, 0.5, 1e3).error(model.coefficients(), None)
            };
            let plain = error(&model);
            for group in groups(&model.shape) {
                let wide = Wide::new(&model, (&calibration.coefficients, &calibration.mask), &group);
                let found = error(&wide.model);
                assert!((found - plain).abs() < 1e-6 * plain, "{}: {found} {plain}", group.terms);
                assert_eq!(wide.new.len() + calibration.coefficients.len(), wide.model.coefficients().len());
                assert!(wide.new.iter().all(|i| wide.model.coefficients()[*i] == 0.0 && wide.model.mask[*i]));
                let dropped = |mask: &[bool]| mask.iter().filter(|is_kept| !**is_kept).count();
                assert_eq!(dropped(&wide.model.mask), dropped(&calibration.mask));
                // Terms keep their names.
                let (old, new) = (model.shape.library(), wide.model.shape.library());
                let r = old.latent;
                let place = new.names().iter().position(|n| *n == format!("e1 z{r}"));
                let before = old.names().iter().position(|n| *n == format!("e1 z{r}"));
                if let Some((place, before)) = place.zip(before) {
                    let rows = [(place, wide.model.coefficients()), (before, &calibration.coefficients[..])];
                    let [after, before] = rows.map(|(row, xi)| xi[row * r..(row + 1) * r].to_vec());
                    assert_eq!(after, before, "{}", group.terms);
                }
            }
        }
    }

    #[test]
    fn terms_that_records_ask_for_are_taken_and_help_events_that_nobody_looked_at() {
        for terms in ["slower", "energy"] {
            let (found, before, after) = extended(0.02, Some(terms));
            assert!(found.taken.is_some(), "{terms}: {:?}", found.tried);
            assert!(after < 0.2 * before, "{terms}: {before} {after}");
            assert!(found.calibration.cosine_similarity < 1.0 && !found.calibration.history.rows.is_empty());
            // On disk it is the same.
            let dir = tempfile::tempdir().unwrap();
            let source = dir.path().join("source");
            std::fs::create_dir(&source).unwrap();
            let scales = Normalisation { input_std_m_s2: 1.0, channel_depth_m: Vec::new(), dense_std_m_s2: Vec::new() };
            found.source.save(&source, &scales).unwrap();
            found.calibration.save(dir.path(), &found.source.shape).unwrap();
            let (loaded, _) = SourceModel::load(&source).unwrap();
            let calibration = Calibration::load(dir.path(), &loaded.shape).unwrap();
            assert_eq!((loaded, calibration.coefficients), (found.source, found.calibration.coefficients));
        }
    }

    #[test]
    fn one_training_event_is_too_few() {
        let (model, calibration, encoder, observation) = calibrated(0);
        let events = made((&model, model.coefficients()), (&encoder, &observation), 0.1);
        let data = Data { simulations: &[], train: &events[..1], validation: &events[1..] };
        let sight = (&encoder, &observation);
        let found = extend(&model, &calibration, sight, &data, &CalibrateSettings::default(), &Quiet);
        assert!(found.taken.is_none() && found.tried.is_empty());
    }

    #[test]
    fn noise_asks_for_no_terms() {
        for noise in [0.1, 0.3, 1.0] {
            let (found, before, after) = extended(noise, None);
            assert_eq!((found.taken, after), (None, before), "{noise}: {:?}", found.tried);
        }
    }
}
