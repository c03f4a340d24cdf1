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
//! group and λ. A group is taken where it lowers their error by [`WORTH`], and still does in [`STABLE`] of the fits with one training
//! event left out.
//!
//! It is no physics: nothing says what the terms stand for, and the same terms at another site mean something else.
//!
//! Source: Fasel, Kutz, Brunton and Brunton (2022), Ensemble-SINDy, for the choice of terms by resampling.

use super::calibrate::{Calibration, Data, cosine_similarity};
use super::case::Event;
use super::events::{Reader, Records};
use super::gauss_newton::{Descent, FIRST_DAMPING};
use super::library::ENERGY;
use super::model::{Shape, SourceModel, SparseEncoder};
use super::observation::Observation;
use super::penalty::Penalty;
use super::settings::{CalibrateSettings, Metric};
use crate::progress::Progress;
use serde::{Deserialize, Serialize};

/// Share by which more terms must lower the error of the validation events.
const WORTH: f64 = 0.01;
/// Share of the fits with a training event left out that must do so too.
const STABLE: f64 = 0.8;
/// A rung of the ladder ends when a step lowers the objective by less than this share.
const SMALLEST_GAIN: f64 = 5e-3;
/// Rungs in a row without a better validation that end the ladder.
const PATIENCE: usize = 3;
/// Time constants of the memories where the model has none, s.
const MEMORIES_S: [f64; 2] = [0.25, 4.0];
/// How much faster and slower than those it has they are.
const APART: f64 = 4.0;

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
}

/// A calibration with more terms, or the same one where none is worth it.
#[derive(Debug, Clone)]
pub struct Extension {
    /// The source model with room for the terms.
    pub model: SourceModel,
    /// The coefficients with theirs.
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

/// Extends the latent equations of `model` that were calibrated to `calibration`, with the events and the settings of that
/// calibration.
pub fn extend(
    model: &SourceModel,
    calibration: &Calibration,
    (encoder, observation): (&SparseEncoder, &Observation),
    data: &Data<'_>,
    settings: &CalibrateSettings,
    progress: &dyn Progress,
) -> Extension {
    let groups = groups(&model.shape);
    progress.start("extend", groups.len() as u64);
    let before = calibration.validation_error;
    let mut tried = Vec::new();
    let mut best: Option<(usize, Wide, Fit)> = None;
    for (i, group) in groups.iter().enumerate() {
        let wide = Wide::new(model, calibration, group);
        let bench = Bench { wide: &wide, encoder, observation, settings, data };
        let found = bench.ladder(before);
        tried.push(Tried {
            terms: group.terms.clone(),
            n_coefficient: wide.new.len(),
            weight: found.as_ref().map(|f| f.weight),
            validation_error: found.as_ref().map_or(before, |f| f.validation),
            stability: None,
        });
        let so_far = best.as_ref().map_or((1.0 - WORTH) * before, |(.., fit)| fit.validation);
        if let Some(found) = found.filter(|f| f.validation < so_far) {
            best = Some((i, wide, found));
        }
        progress.advance(1);
    }
    let unchanged = |tried| Extension { model: model.clone(), calibration: calibration.clone(), taken: None, tried };
    let Some((i, wide, fit)) = best else { return unchanged(tried) };
    let stability = Bench { wide: &wide, encoder, observation, settings, data }.stability(fit.weight, before);
    tried[i].stability = Some(stability);
    progress
        .note(&format!("{}: validation {before:.4} → {:.4}, stable in {stability:.2}", tried[i].terms, fit.validation));
    if stability < STABLE {
        return unchanged(tried);
    }
    let Wide { model: wide, .. } = wide;
    let calibration = Calibration {
        cosine_similarity: cosine_similarity(wide.coefficients(), &fit.xi),
        mask: wide.mask.clone(),
        coefficients: fit.xi,
        validation_error: fit.validation,
        history: calibration.history.clone(),
    };
    Extension { model: wide, calibration, taken: Some(tried[i].terms.clone()), tried }
}

/// The groups that a model of this shape can be given.
fn groups(shape: &Shape) -> Vec<Group> {
    let known = || shape.memories.fading_s.iter().chain(&shape.memories.lasting_s).copied();
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

/// A calibrated model with room for more terms, which are zero.
struct Wide {
    model: SourceModel,
    /// Indices of their coefficients.
    new: Vec<usize>,
}

impl Wide {
    fn new(model: &SourceModel, calibration: &Calibration, group: &Group) -> Self {
        let mut shape = model.shape.clone();
        let n_fading = shape.memories.fading_s.len();
        shape.memories.fading_s.extend(&group.fading_s);
        shape.energy_levels += group.energies;
        let (old, wide) = (model.shape.library(), shape.library());
        let r = old.latent;
        // The new memories follow those that fade; behind them everything is so many rows further down.
        let (first, shift) = (old.input_row() + 1 + n_fading * (r + 1), group.fading_s.len() * (r + 1));
        let place = |i: usize| if i / r < first { i } else { i + shift * r };
        let mut coefficients = vec![0.0; wide.n_coefficient()];
        let mut mask = vec![true; wide.n_coefficient()];
        let mut is_new = vec![true; wide.n_coefficient()];
        for (i, (coefficient, is_kept)) in calibration.coefficients.iter().zip(&calibration.mask).enumerate() {
            coefficients[place(i)] = *coefficient;
            mask[place(i)] = *is_kept;
            is_new[place(i)] = false;
        }
        let networks = &model.parameters[model.shape.coefficient_range().end..];
        let parameters = [&coefficients, networks].concat();
        let new = (0..is_new.len()).filter(|i| is_new[*i]).collect();
        Self { model: SourceModel { shape, parameters, mask }, new }
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
    wide: &'a Wide,
    encoder: &'a SparseEncoder,
    observation: &'a Observation,
    settings: &'a CalibrateSettings,
    data: &'a Data<'a>,
}

impl Bench<'_> {
    /// The best fit on the validation events of all down the ladder of penalties, where it is better than `before`.
    fn ladder(&self, before: f64) -> Option<Fit> {
        let reader = Reader::new(&self.wide.model, self.observation);
        let [train, validation] = [self.data.train, self.data.validation].map(|events| self.records(&reader, events));
        let penalty = self.penalty();
        let mut xi = self.wide.model.coefficients().to_vec();
        let (mut best, mut lowest, mut idle): (Option<Fit>, f64, usize) = (None, before, 0);
        for weight in &self.settings.penalty_ladder {
            self.descend((&train, &penalty), *weight, &mut xi);
            let judged = validation.error(&xi, None);
            idle += 1;
            if judged < lowest {
                (lowest, idle) = (judged, 0);
                best = Some(Fit { xi: xi.clone(), weight: *weight, validation: judged });
            }
            if idle >= PATIENCE {
                break;
            }
        }
        best
    }

    /// Share of the fits at `weight` with one training event left out whose error of the validation events is below `before`.
    fn stability(&self, weight: f64, before: f64) -> f64 {
        let reader = Reader::new(&self.wide.model, self.observation);
        let (penalty, validation) = (self.penalty(), self.records(&reader, self.data.validation));
        let n = self.data.train.len();
        let is_better = |left_out: usize| {
            let others = self.data.train.iter().enumerate().filter(|(i, _)| *i != left_out);
            let others: Vec<Event> = others.map(|(_, event)| event.clone()).collect();
            let mut xi = self.wide.model.coefficients().to_vec();
            if others.is_empty() {
                return false;
            }
            self.descend((&self.records(&reader, &others), &penalty), weight, &mut xi);
            validation.error(&xi, None) < (1.0 - WORTH) * before
        };
        (0..n).filter(|i| is_better(*i)).count() as f64 / n.max(1) as f64
    }

    /// Steps on (2) from `xi` as long as they pay.
    fn descend(&self, (train, penalty): (&Records<'_>, &Penalty), weight: f64, xi: &mut Vec<f32>) {
        let descent = Descent { train, penalty, weight, free: &self.wide.new };
        let mut damping = FIRST_DAMPING;
        for _ in 0..self.settings.steps {
            let old = train.misfit(xi).0 + weight * penalty.value(xi);
            let normal = train.normal(xi, &self.wide.new);
            let Some((moved, observation)) = descent.step(&normal, xi, old, &mut damping) else { break };
            *xi = moved;
            if observation + weight * penalty.value(xi) > (1.0 - SMALLEST_GAIN) * old {
                break;
            }
        }
    }

    fn records<'b>(&self, reader: &'b Reader<'b>, events: &[Event]) -> Records<'b> {
        let settings = self.settings;
        Records::new(self.encoder, reader, events, settings.amplitude_weighting, settings.state_bound as f32)
    }

    /// How large the terms are, in the metric of the calibration.
    fn penalty(&self) -> Penalty {
        match self.settings.metric {
            Metric::Coefficients => Penalty::coefficients(&self.wide.model),
            Metric::Field => Penalty::field(&self.wide.model, self.data.simulations),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flare::calibrate::tests::{event, problem, random};
    use crate::flare::history::History;
    use crate::flare::rollout::predict;
    use crate::progress::Quiet;

    fn calibrated() -> (SourceModel, Calibration, SparseEncoder, Observation) {
        let (model, encoder, observation) = problem();
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
        let (model, mut calibration, encoder, observation) = calibrated();
        let settings =
            CalibrateSettings { metric: Metric::Coefficients, amplitude_weighting: 0.5, ..Default::default() };
        let group = truth.and_then(|t| groups(&model.shape).into_iter().find(|g| g.terms.contains(t)));
        let events = match &group {
            None => made((&model, model.coefficients()), (&encoder, &observation), noise),
            Some(group) => {
                let wide = Wide::new(&model, &calibration, group);
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
        let after = error(&found.model, &found.calibration.coefficients, &events[9..]);
        (found, before, after)
    }

    #[test]
    fn terms_of_no_strength_change_nothing() {
        let (model, calibration, encoder, observation) = calibrated();
        let events = made((&model, model.coefficients()), (&encoder, &observation), 0.5);
        let error = |model: &SourceModel| {
            let reader = Reader::new(model, &observation);
            Records::new(&encoder, &reader, &events, 0.5, 1e3).error(model.coefficients(), None)
        };
        for mut known in [vec![], vec![1.0]] {
            let mut model = model.clone();
            let mut calibration = calibration.clone();
            if !known.is_empty() {
                // A model that has memories and a level of energy already: each of its terms must find its new place.
                model.shape.memories.lasting_s = vec![5.0];
                model.shape.memories.fading_s.append(&mut known);
                model.shape.energy_levels = 1;
                let more = model.shape.library().n_coefficient() - calibration.coefficients.len();
                calibration.coefficients.extend(random(more, 0.2, "more"));
                calibration.mask.extend(vec![true; more]);
                let networks = model.parameters[problem().0.shape.coefficient_range().end..].to_vec();
                model.parameters = [calibration.coefficients.clone(), networks].concat();
                model.mask.clone_from(&calibration.mask);
            }
            let plain = error(&model);
            for group in groups(&model.shape) {
                let wide = Wide::new(&model, &calibration, &group);
                let found = error(&wide.model);
                assert!((found - plain).abs() < 1e-6 * plain, "{}: {found} {plain}", group.terms);
                assert_eq!(wide.new.len() + calibration.coefficients.len(), wide.model.coefficients().len());
            }
        }
    }

    #[test]
    fn terms_that_records_ask_for_are_taken_and_help_events_that_nobody_looked_at() {
        for terms in ["slower", "energy"] {
            let (found, before, after) = extended(0.02, Some(terms));
            assert!(found.taken.is_some(), "{terms}: {:?}", found.tried);
            assert!(after < 0.2 * before, "{terms}: {before} {after}");
        }
    }

    #[test]
    fn noise_asks_for_no_terms() {
        let (found, before, after) = extended(0.3, None);
        assert_eq!((found.taken, after), (None, before), "{:?}", found.tried);
    }
}
