//! Intervals of the parameters of effects: of one model, and over all that may hold.

use super::parameters::Total;
use super::posterior::Fit;
use crate::effects::Instance;
use crate::metrics::{normal_probability, t_quantile};

/// Two-sided 95 % quantile of a normal number.
pub const NORMAL: f64 = 1.96;
/// Probability on either side of a 95 % interval.
const TAIL: f64 = 0.025;
/// Halvings of what holds a quantile.
const BISECTIONS: usize = 60;

/// A model that may hold.
pub struct Member<'c, 'a> {
    /// The model.
    pub fit: &'c Fit<'a>,
    /// Its probability over that of the answer.
    pub odds: f64,
    /// Of 95 % intervals of its coordinates.
    pub half_widths: Vec<f64>,
    /// What is off in all where each of its effects is, and the half width of the 95 % interval of that; none where that is no more than the
    /// effect.
    pub totals: Vec<Option<[f64; 2]>>,
}

impl<'c, 'a> Member<'c, 'a> {
    /// Coordinate `k` of effect `effect`, and the half width of its interval.
    fn coordinate(&self, effect: usize, k: usize) -> [f64; 2] {
        let at = self.fit.model.start(effect) + k;
        [self.fit.x[at], self.half_widths[at]]
    }

    /// Intervals of `fit` by events, which are `groups`.
    pub fn new(fit: &'c Fit<'a>, odds: f64, groups: &[usize]) -> Self {
        let of = |total: Total| [total.coordinate, half_widths_along(fit, groups, &[total.slopes])[0]];
        let totals = (0..fit.model.effects.len()).map(|index| fit.model.total(&fit.x, index).map(of)).collect();
        Self { fit, odds, half_widths: half_widths(fit, groups), totals }
    }
}

/// 95 % intervals of the coordinates of effect `index` of `fit`, one of `members`, or of what is off in all. What else may hold widens them:
/// every member that has that effect counts by its probability, here, and elsewhere in the soil; what another sensor does is a number of its
/// own.
///
/// ```text
/// Σ p_m Φ((q − x_m)/s_m) = 0.025 and 0.975, Σ p_m = 1                     (1)
/// ```
///
/// Source: (1) Hoeting et al. (1999), doi 10.1214/ss/1009212519, distribution of an average over models, normal in each.
pub fn averaged(fit: &Fit<'_>, index: usize, members: &[Member<'_, '_>]) -> Vec<[f64; 2]> {
    let own = &fit.model.effects[index];
    let of = |k: usize| {
        let mixture = mixture(own, members, own.class().moves_column(), |m, effect| {
            m.totals[effect].unwrap_or_else(|| m.coordinate(effect, k))
        });
        [TAIL, 1.0 - TAIL].map(|p| quantile(&mixture, p))
    };
    (0..own.free.len()).map(of).collect()
}

/// Whether effect `index` of `fit`, wherever `members` have it, may be none: the 95 % interval of each of its strengths holds nothing, on
/// whichever side of that a member has it.
pub fn may_be_none(fit: &Fit<'_>, index: usize, members: &[Member<'_, '_>]) -> bool {
    let own = &fit.model.effects[index];
    are_nothing(own, |k, zero| holds(&mixture(own, members, true, |m, effect| m.coordinate(effect, k)), zero))
}

/// Whether `own` has strengths, and each of their coordinates, with that at which it is nothing, is as `is_nothing` says.
fn are_nothing(own: &Instance, is_nothing: impl Fn(usize, f64) -> bool) -> bool {
    let zero = own.zero().unwrap_or_default();
    let mut strengths = (0..zero.len()).filter(|k| own.free[*k].zero.is_some()).peekable();
    strengths.peek().is_some() && strengths.all(|k| is_nothing(k, zero[k]))
}

/// What `members` say of the effect `own`, where they have it, and with `elsewhere` where they have it at another place; `value` is a value
/// of an effect of one of them, by index, and the half width of its interval.
fn mixture<'m, 'c, 'a>(
    own: &Instance,
    members: &'m [Member<'c, 'a>],
    elsewhere: bool,
    value: impl Fn(&'m Member<'c, 'a>, usize) -> [f64; 2],
) -> Vec<Normal> {
    let of = |m: &'m Member<'c, 'a>| {
        let model = &m.fit.model;
        let there = || model.effects.iter().position(|e| elsewhere && e.is_alike(own));
        let [mean, half_width] = value(m, model.index_of(own).or_else(there)?);
        Some(Normal { weight: m.odds, mean, deviation: half_width / NORMAL })
    };
    members.iter().filter_map(of).collect()
}

/// A normal distribution with a weight.
struct Normal {
    weight: f64,
    mean: f64,
    deviation: f64,
}

/// Whether 95 % intervals about the means of a mixture hold `value`, all of them together.
fn holds(mixture: &[Normal], value: f64) -> bool {
    let total: f64 = mixture.iter().map(|n| n.weight).sum();
    let beyond = |n: &Normal| n.weight * normal_probability(-(n.mean - value).abs() / n.deviation);
    mixture.iter().map(beyond).sum::<f64>() > TAIL * total
}

/// Quantile of a mixture.
fn quantile(mixture: &[Normal], probability: f64) -> f64 {
    let total: f64 = mixture.iter().map(|n| n.weight).sum();
    // Where all deviations end: no quantile that is asked for lies beyond.
    let end = |sign: f64| {
        let ends = mixture.iter().map(|n| sign * (n.mean + sign * 4.0 * n.deviation));
        sign * ends.fold(f64::NEG_INFINITY, f64::max)
    };
    let [mut low, mut high] = [end(-1.0), end(1.0)];
    if !(low.is_finite() && high.is_finite()) {
        return if probability < 0.5 { f64::NEG_INFINITY } else { f64::INFINITY };
    }
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (low + high);
        let below: f64 = mixture.iter().map(|n| n.weight * normal_probability((middle - n.mean) / n.deviation)).sum();
        if below < probability * total { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Half widths of 95 % intervals of the coordinates.
pub fn half_widths(fit: &Fit<'_>, groups: &[usize]) -> Vec<f64> {
    let n = fit.x.len();
    let each = |i: usize| (0..n).map(|j| f64::from(u8::from(i == j))).collect();
    half_widths_along(fit, groups, &(0..n).map(each).collect::<Vec<_>>())
}

/// Half widths of 95 % intervals of sums of coordinates with these factors: by the curvature of the cost, or by what each event left out
/// changes, whichever is wider; `groups` are the events of the records.
pub fn half_widths_along(fit: &Fit<'_>, groups: &[usize], directions: &[Vec<f64>]) -> Vec<f64> {
    let covariance = fit.covariance();
    let left_out = fit.without_each_event(groups);
    let e = left_out.len() as f64;
    let of = |direction: &Vec<f64>| {
        let told: Vec<usize> = (0..direction.len()).filter(|i| direction[*i] != 0.0).collect();
        let sum = |of: &dyn Fn(usize) -> f64| told.iter().map(|i| direction[*i] * of(*i)).sum::<f64>();
        let variance = covariance.as_ref().map_or(f64::INFINITY, |c| sum(&|i| sum(&|j| c[(i, j)])));
        let curved = NORMAL * variance.sqrt();
        if left_out.len() < 2 {
            return curved;
        }
        let values: Vec<f64> = left_out.iter().map(|x| sum(&|i| x[i])).collect();
        let mean = values.iter().sum::<f64>() / e;
        let square: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        let jackknife = ((e - 1.0) / e * square).sqrt() * t_quantile(0.975, left_out.len() - 1);
        curved.max(jackknife)
    };
    directions.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Truth, problem};
    use super::*;
    use crate::effects;

    #[test]
    fn an_interval_that_holds_no_effect_claims_none() {
        let instances = effects::instances(&problem(&Truth::default()).array);
        // Intervals are given by their ends as values; those of an inverse that reaches past infinity by a negative one.
        let of = |kind: &str, intervals: &[(&str, [f64; 2])]| {
            let own = instances.iter().find(|i| i.kind == kind).unwrap();
            are_nothing(own, |k, zero| {
                let parameter = own.free[k].parameter;
                let (_, ends) = intervals.iter().find(|(name, _)| *name == parameter.name).unwrap();
                let [a, b] = ends.map(|end| parameter.coordinate(end));
                holds(&[Normal { weight: 1.0, mean: 0.5 * (a + b), deviation: 0.5 * (b - a).abs() / NORMAL }], zero)
            })
        };
        assert!(of("sensor_gain", &[("ln_gain", [-0.1, 0.2])]));
        assert!(!of("sensor_gain", &[("ln_gain", [0.1, 0.2])]));
        assert!(of("small_strain_damping", &[("multiplier", [0.2, 2.4])]));
        assert!(of("downgoing_wave", &[("corner_hz", [2.0, -900.0])]));
        assert!(!of("downgoing_wave", &[("corner_hz", [2.0, 9.0])]));
        // What only shapes it says nothing, and an exchange of labels has no strength.
        assert!(!of("surface_wave", &[("amplitude", [0.1, 0.2]), ("delay_s", [-1.0, 4.0])]));
        assert!(!of("swapped_channels", &[]));
    }

    #[test]
    fn quantiles_of_a_mixture_are_those_of_its_parts_and_between_them() {
        let normal = |weight, mean, deviation| Normal { weight, mean, deviation };
        let alone = [normal(3.0, 2.0, 0.5)];
        assert!((quantile(&alone, 0.025) - (2.0 - 0.5 * 1.959_964)).abs() < 1e-6);
        // A tenth of the weight far below: a quarter of that is below its own lower quartile.
        let two = [normal(0.9, 1.0, 0.01), normal(0.1, -1.0, 0.01)];
        assert!((quantile(&two, 0.025) - (-1.0 - 0.01 * 0.674_490)).abs() < 1e-6);
        assert!((quantile(&two, 0.975) - (1.0 + 0.01 * 1.914_506)).abs() < 1e-4, "{}", quantile(&two, 0.975));
        assert_eq!(quantile(&[normal(1.0, 0.0, f64::INFINITY)], 0.975), f64::INFINITY);
        // At one of two places, with either sign: neither holds nothing.
        assert!(!holds(&[normal(0.5, 0.2, 0.03), normal(0.5, -0.2, 0.03)], 0.0));
        assert!(holds(&[normal(0.9, 0.2, 0.03), normal(0.1, -0.2, 0.3)], 0.0));
        assert!(holds(&[normal(1.0, 0.2, 0.11)], 0.0) && !holds(&[normal(1.0, 0.2, 0.1)], 0.0));
        assert!(holds(&[normal(1.0, 0.2, f64::INFINITY)], 0.0));
    }
}
