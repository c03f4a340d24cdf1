//! Replays of the nonlinear column as the point from which the fast column extrapolates.

use super::responses::{InputSensor, RecordResponse, Responses, Scene};
use super::spectra::SMOOTH_HZ;
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
/// From the anchor before, a step Δ away, (1) had been wrong by D = V_FE(a) − V_before(a). It goes on being wrong in that
/// direction, which the second replay has paid for:
///
/// ```text
/// V(θ) += D · Δᵀ(θ − a) / |Δ|²                                          (2)
/// ```
///
/// Where θ says that the input sensor is not what it was at a, the second part of (1) follows the true input u,
///
/// ```text
/// rest → rest · ⟨u(θ) u(a)*⟩ / ⟨|u(a)|²⟩                               (3)
/// ```
///
/// or a gain or a clock that all sensors share, which no record can tell, would seem to matter.
///
/// Limits: (2) holds along the last step only, and no farther than its length.
/// Check:  `a_second_anchor_knows_the_error_of_the_first_along_the_step`.
/// Source: Broyden (1965), doi 10.1090/S0025-5718-1965-0198670-6, for (2).
#[derive(Clone)]
pub struct Anchor {
    /// By group and record; `None` without a replay, where the fast column stands alone.
    pub records: Vec<Vec<Option<RecordAnchor>>>,
    /// Unknowns of the anchor.
    at: Vec<f64>,
    /// Step from the anchor before, over its squared length; empty without one.
    direction: Vec<f64>,
}

/// K and the second part of (1), `[bin][sensor]`.
#[derive(Clone)]
pub struct RecordAnchor {
    /// K.
    pub factor: Vec<C64>,
    /// V_FE(a) − K · V_fast(a).
    pub rest: Vec<C64>,
    /// D of (2); empty without an anchor before.
    drift: Vec<C64>,
    /// True input at a, and the sensor that it was taken from.
    input: Vec<C64>,
    seen_by: InputSensor,
}

impl RecordAnchor {
    /// The second part of (1) with (2), `amount` being its scalar product.
    pub fn rest_at(&self, index: usize, amount: f64) -> C64 {
        self.drift.get(index).map_or(self.rest[index], |d| self.rest[index] + d * amount)
    }

    /// The factor of (3) for the true `input` that the input sensor in the state `seen_by` stands for, by bin; empty where it
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
        Self { records: scene.groups.iter().map(none).collect(), at: Vec::new(), direction: Vec::new() }
    }

    /// Compares `replays` at the unknowns `x` with the fast column's `responses` there.
    pub fn of(
        scene: &Scene<'_>,
        replays: &[Option<Vec<Vec<f64>>>],
        x: &[f64],
        responses: &Responses,
        before: Option<&Self>,
    ) -> Self {
        let mut anchor = Self { at: x.to_vec(), ..Self::fast(scene) };
        let step = before.map(|b| step(&b.at, x)).unwrap_or_default();
        for (g, group) in scene.groups.iter().enumerate() {
            for (r, record) in group.records.iter().enumerate() {
                let (Some(Some(replayed)), Some(response)) = (replays.get(record.event), responses.records[g].get(r))
                else {
                    continue;
                };
                let nonlinear: Vec<Vec<C64>> = replayed.iter().map(|x| scene.bins(g, r, x)).collect();
                let mut own = compare(&group.frequencies_hz, &nonlinear, response);
                if let Some((before, earlier)) = before.and_then(|b| Some((b, b.records[g][r].as_ref()?)))
                    && !step.is_empty()
                {
                    let amount = before.amount(x);
                    own.drift = (0..own.rest.len())
                        .map(|i| {
                            let factor = own.factor[i] - earlier.factor[i];
                            factor * response.motion[i] + own.rest[i] - earlier.rest_at(i, amount)
                        })
                        .collect();
                }
                anchor.records[g][r] = Some(own);
            }
        }
        anchor.direction = step;
        anchor
    }

    /// The scalar product of (2) at `x`.
    pub fn amount(&self, x: &[f64]) -> f64 {
        if self.direction.len() != x.len() {
            return 0.0;
        }
        let product: f64 = self.direction.iter().zip(x).zip(&self.at).map(|((d, x), a)| d * (x - a)).sum();
        product.clamp(-1.0, 1.0)
    }
}

/// Δ/|Δ|² from `a` to `b`; empty where they are not of one model or the same.
fn step(a: &[f64], b: &[f64]) -> Vec<f64> {
    let squared: f64 = a.iter().zip(b).map(|(a, b)| (b - a) * (b - a)).sum();
    if a.len() != b.len() || squared < 1e-6 {
        return Vec::new();
    }
    a.iter().zip(b).map(|(a, b)| (b - a) / squared).collect()
}

/// Bins to either side of a smoothed one.
pub fn smoothing(frequencies_hz: &[f64]) -> usize {
    (SMOOTH_HZ / (frequencies_hz[1] - frequencies_hz[0])).round().max(1.0) as usize
}

fn compare(frequencies_hz: &[f64], replayed: &[Vec<C64>], response: &RecordResponse) -> RecordAnchor {
    let (n, count, motion) = (frequencies_hz.len(), replayed.len(), &response.motion);
    let half = smoothing(frequencies_hz);
    let mut anchor = RecordAnchor {
        factor: vec![C64::new(1.0, 0.0); n * count],
        rest: vec![C64::default(); n * count],
        drift: Vec::new(),
        input: response.input.clone(),
        seen_by: response.seen_by,
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
    fn a_second_anchor_knows_the_error_of_the_first_along_the_step() {
        let anchor = Anchor { records: Vec::new(), at: vec![1.0, 2.0], direction: step(&[0.0, 0.0], &[1.0, 2.0]) };
        let seen_by = InputSensor { source: 0, probes: [Operator::IDENTITY; 3] };
        let record = RecordAnchor {
            factor: Vec::new(),
            rest: vec![C64::new(1.0, 0.0)],
            drift: vec![C64::new(0.0, 2.0)],
            input: vec![C64::new(0.0, 1.0), C64::new(2.0, 0.0)],
            seen_by,
        };
        assert_eq!(anchor.amount(&[1.0, 2.0]), 0.0);
        assert!((anchor.amount(&[1.5, 3.0]) - 0.5).abs() < 1e-12);
        assert_eq!(anchor.amount(&[3.0, 1.0]), 0.0, "across the step nothing is known");
        assert_eq!(anchor.amount(&[9.0, 9.0]), 1.0, "no farther than the step");
        assert_eq!(record.rest_at(0, 0.5), C64::new(1.0, 1.0));
        assert!(record.turned(&record.input, &seen_by, 1).is_empty());
        let late = InputSensor { source: 1, ..seen_by };
        let factor = C64::new(0.6, -0.8);
        let input: Vec<C64> = record.input.iter().map(|u| u * factor).collect();
        assert!(record.turned(&input, &late, 1).iter().all(|f| (f - factor).norm() < 1e-12));
    }
}
