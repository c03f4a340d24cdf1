//! Replays of the nonlinear column as the point from which the fast column extrapolates.

use super::followed::place;
use super::operators::Operators;
use super::responses::{InputSensor, RecordResponse, Responses, Scene};
use super::secants::Secants;
use super::spectra::smoothing_bins;
use super::unknowns::Placed;
use crate::effects::Effect;
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// Bounds of the factor between the two columns.
const FACTOR: [f64; 2] = [0.33, 3.0];

/// What the nonlinear column does beyond the fast one at one set of effects.
///
/// ```text
/// V(θ) = K · V_fast(θ) + (V_FE(a) − K · V_fast(a)),   K = ⟨V_FE V_fast*⟩ / ⟨|V_fast|²⟩ at a          (1)
/// ```
///
/// exact at the anchor a; ⟨⟩ is a mean over neighbouring bins. Where the fast column is nearly silent, K would be a
/// quotient of two small numbers; the mean and the second part of (1) keep that from mattering.
///
/// From the anchors before, (1) had been wrong by what the replays of the steps between them have told; it goes on being wrong
/// along these steps.
///
/// Where θ says that the input sensor is not what it was at a, the second part of (1) follows the true input u,
///
/// ```text
/// rest → rest · ⟨u(θ) u(a)*⟩ / ⟨|u(a)|²⟩                               (2)
/// ```
///
/// or a gain or a clock that all sensors share, which no record can tell, would seem to matter.
///
/// Limits: of an input sensor that is turned, (2) follows what the components share; the rest is left to the fast column.
/// Check:  `a_late_input_turns_what_the_anchor_adds`; `errors_of_a_linear_model_are_known_wherever_steps_have_gone`.
#[derive(Clone)]
pub struct Anchor {
    /// By group and record; `None` without a replay, where the fast column stands alone.
    pub records: Vec<Vec<Option<RecordAnchor>>>,
    /// Its [`place`].
    at: Vec<f64>,
    /// Number of effects there.
    n_effect: usize,
    /// What it knows from the anchors before.
    pub(super) secants: Secants,
}

/// K and the second part of (1), `[bin][sensor]`.
#[derive(Clone)]
pub struct RecordAnchor {
    /// K.
    pub factor: Vec<C64>,
    /// V_FE(a) − K · V_fast(a).
    pub rest: Vec<C64>,
    /// True input at a, and the sensor that it was taken from.
    input: Vec<C64>,
    seen_by: InputSensor,
    /// The soil of the anchor, as neighbours follow it.
    soil: Placed,
}

impl RecordAnchor {
    /// The factor of (2) for the true `input` that the input sensor in the state `seen_by` stands for, by bin; empty where it
    /// is one.
    pub fn turned(&self, input: &[C64], seen_by: &InputSensor, half: usize) -> Vec<C64> {
        if *seen_by == self.seen_by {
            return Vec::new();
        }
        let n = input.len();
        let ratio = |k: usize| {
            let range = k.saturating_sub(half)..(k + half + 1).min(n);
            let cross: C64 = range.clone().map(|m| input[m] * self.input[m].conj()).sum();
            let power: f64 = range.map(|m| self.input[m].norm_sqr()).sum();
            if power > 0.0 { cross / power } else { C64::new(1.0, 0.0) }
        };
        (0..n).map(ratio).collect()
    }
}

impl Anchor {
    /// The fast column alone.
    pub fn fast(scene: &Scene<'_>) -> Self {
        let none = |g: &super::spectra::Group| g.records.iter().map(|_| None).collect();
        Self {
            records: scene.groups.iter().map(none).collect(),
            at: Vec::new(),
            n_effect: 0,
            secants: Secants::default(),
        }
    }

    /// Compares `replays` at the unknowns `x` with the fast column's `responses` there.
    pub fn of(
        scene: &Scene<'_>,
        replays: &[Option<Vec<Vec<f64>>>],
        (effects, placed): (&[Box<dyn Effect>], &Placed),
        responses: &Responses,
        before: Option<&Self>,
    ) -> Self {
        let x = &placed.x;
        let mut anchor = Self { at: place(scene, effects, x), n_effect: effects.len(), ..Self::fast(scene) };
        let mut errors: Vec<Vec<Vec<C64>>> =
            scene.groups.iter().map(|g| g.records.iter().map(|_| Vec::new()).collect()).collect();
        for (g, group) in scene.groups.iter().enumerate() {
            let half = smoothing_bins(&group.frequencies_hz);
            for (r, record) in group.records.iter().enumerate() {
                let (Some(Some(replayed)), Some(response)) = (replays.get(record.event), responses.records[g].get(r))
                else {
                    continue;
                };
                let nonlinear: Vec<Vec<C64>> = replayed.iter().map(|x| scene.bins(g, r, x)).collect();
                let mut own = compare(&group.frequencies_hz, &nonlinear, response);
                own.soil = responses.deviations([g, r], placed);
                if let Some((before, earlier)) = before.and_then(|b| Some((b, b.records[g][r].as_ref()?))) {
                    let followed = before.followed(scene, responses, [g, r], placed);
                    let turned = earlier.turned(&response.input, &response.seen_by, half);
                    let count = nonlinear.len();
                    let error = |i: usize| {
                        let (k, s) = (i / count, i % count);
                        let rest = earlier.rest[i] + followed.get(i).copied().unwrap_or_default();
                        let rest = turned.get(k).map_or(rest, |f| f * rest);
                        nonlinear[s][k] - earlier.factor[i] * response.motion[i] - rest
                    };
                    errors[g][r] = (0..own.rest.len()).map(error).collect();
                }
                anchor.records[g][r] = Some(own);
            }
        }
        if let Some(before) = before {
            anchor.secants = before.secants.clone();
            if before.n_effect == anchor.n_effect && before.at.len() == x.len() {
                anchor.secants.push(before.at.iter().zip(&anchor.at).map(|(a, b)| b - a).collect(), errors);
            }
        }
        anchor
    }

    /// The same for a twin of the scene, in which `truth` holds: its true inputs were those of the anchor, and its own records
    /// tell them, with their noise.
    pub fn heard_in(mut self, scene: &Scene<'_>, truth: &[Box<dyn Effect>]) -> Self {
        let operators = Operators::new(scene, truth);
        for (g, group) in self.records.iter_mut().enumerate() {
            for (r, record) in group.iter_mut().enumerate() {
                if let Some(record) = record {
                    record.input = scene.true_input(truth, &operators, g, r);
                    record.seen_by = scene.input_sensor(truth, &operators, g);
                }
            }
        }
        self
    }

    /// What neighbours tell of the way of record `r` of group `g` from the anchor to the unknowns `x`, `[bin][sensor]`; empty
    /// where they tell nothing.
    pub fn followed(&self, scene: &Scene<'_>, responses: &Responses, [g, r]: [usize; 2], x: &Placed) -> Vec<C64> {
        let (Some(neighbours), Some(own)) = (&scene.neighbours, &self.records[g][r]) else { return Vec::new() };
        neighbours.moved([g, r], &own.soil, &responses.deviations([g, r], x))
    }

    /// What each step known counts on the way from the anchor to the unknowns `x`.
    pub fn amounts(&self, scene: &Scene<'_>, effects: &[Box<dyn Effect>], x: &Placed) -> Vec<f64> {
        self.secants.weights(&self.at, &place(scene, effects, &x.x))
    }
}

fn compare(frequencies_hz: &[f64], replayed: &[Vec<C64>], response: &RecordResponse) -> RecordAnchor {
    let (n, count, motion) = (frequencies_hz.len(), replayed.len(), &response.motion);
    let half = smoothing_bins(frequencies_hz);
    let mut anchor = RecordAnchor {
        factor: vec![C64::new(1.0, 0.0); n * count],
        rest: vec![C64::default(); n * count],
        input: response.input.clone(),
        seen_by: response.seen_by,
        soil: Placed::default(),
    };
    for (s, nonlinear) in replayed.iter().enumerate() {
        let fast: Vec<C64> = (0..n).map(|k| motion[k * count + s]).collect();
        for k in 0..n {
            let range = k.saturating_sub(half)..(k + half + 1).min(n);
            let cross: C64 = range.clone().map(|m| nonlinear[m] * fast[m].conj()).sum();
            let power: f64 = range.map(|m| fast[m].norm_sqr()).sum();
            let raw = if power > 0.0 { cross / power } else { C64::new(1.0, 0.0) };
            let size = raw.norm();
            let factor = if size > 0.0 { raw * (size.clamp(FACTOR[0], FACTOR[1]) / size) } else { C64::new(1.0, 0.0) };
            anchor.factor[k * count + s] = factor;
            anchor.rest[k * count + s] = nonlinear[k] - factor * fast[k];
        }
    }
    anchor
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::Operator;

    #[test]
    fn a_late_input_turns_what_the_anchor_adds() {
        let seen_by = InputSensor { source: 0, probes: [Operator::IDENTITY; 3], added: 0.0 };
        let record = RecordAnchor {
            factor: Vec::new(),
            rest: vec![C64::new(1.0, 0.0)],
            input: vec![C64::new(0.0, 1.0), C64::new(2.0, 0.0)],
            seen_by,
            soil: Placed::default(),
        };
        assert!(record.turned(&record.input, &seen_by, 1).is_empty());
        let late = InputSensor { source: 1, ..seen_by };
        let factor = C64::new(0.6, -0.8);
        let input: Vec<C64> = record.input.iter().map(|u| u * factor).collect();
        assert!(record.turned(&input, &late, 1).iter().all(|f| (f - factor).norm() < 1e-12));
    }
}
