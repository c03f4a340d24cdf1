//! How well anything that does not change from event to event could predict: what other events teach, without a model.

use super::nrmse_percent;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};

/// Memory of the free filter, s.
const MEMORY_S: f64 = 3.0;
/// What resampling brings forward of a sample between two others, steps.
const AHEAD: usize = 5;
/// Shares of the mean diagonal that may be put on it.
const RIDGES: [f64; 9] = [1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0];

/// Input and output of one event at one sensor in one component, at the same step.
#[derive(Debug, Clone, Copy)]
pub struct Pair<'a> {
    /// Input from the beginning of the record, m/s².
    pub input: &'a [f64],
    /// Output from some sample of the input on, to the end, m/s²; no longer than the input.
    pub output: &'a [f64],
}

impl Pair<'_> {
    fn first(&self) -> usize {
        self.input.len() - self.output.len()
    }

    /// Sum of squares of the output.
    fn power(&self) -> f64 {
        self.output.iter().map(|v| v * v).sum()
    }
}

/// A filter with a tap a step, fitted to events by least squares.
///
/// ```text
/// ŷ_i = Σ_k h_k u_{i−k},   k = −5 … 3 s/dt                                                (1)
/// h   = ( Σ_e X_eᵀX_e/|y_e|² + λ d̄ I )⁻¹ Σ_e X_eᵀy_e/|y_e|²,   d̄ the mean of the diagonal            (2)
/// λ   with the least mean NRMSE when each event in turn is predicted from the others           (3)
/// ```
///
/// Every event counts the same. The filter is causal but for five steps: a wave that arrives between two samples has its resampled
/// image on either side.
///
/// Limits: no law of physics; what differs from event to event (angle of incidence, softening) is out of its reach, and so is an
/// answer longer than three seconds.
/// Check:  `the_ceiling_of_a_linear_system_is_its_noise`, `weak_events_of_a_real_site_have_the_ceiling_of_the_prototype`.
/// Source: Hoerl and Kennard (1970), Ridge regression, Technometrics 12, 55–67; Stone (1974), JRSS B 36, 111–147 for (3).
#[derive(Debug, Clone, PartialEq)]
pub struct FreeFilter {
    taps: Vec<f64>,
    /// λ of (2).
    pub ridge: f64,
}

impl FreeFilter {
    /// Fitted to all `events` of step `dt_s`; `None` for fewer than two, of which no ridge can be chosen, or without a motion.
    pub fn of(events: &[Pair<'_>], dt_s: f64) -> Option<Self> {
        let n_tap = AHEAD + (MEMORY_S / dt_s).round() as usize + 1;
        let events: Vec<&Pair<'_>> = events.iter().filter(|p| p.power() > 0.0).collect();
        if events.len() < 2 {
            return None;
        }
        let normals: Vec<Normal> = events.iter().map(|pair| Normal::of(pair, n_tap)).collect();
        let others_of =
            |left_out: usize| Normal::sum(normals.iter().enumerate().filter(|(i, _)| *i != left_out).map(|(_, n)| n));
        let without: Vec<Normal> = (0..events.len()).map(others_of).collect();
        let error = |ridge: f64| -> Option<f64> {
            let errors =
                normals.iter().zip(&without).map(|(own, others)| Some(own.error_percent(&others.solve(ridge)?)));
            Some(errors.collect::<Option<Vec<f64>>>()?.iter().sum::<f64>() / events.len() as f64)
        };
        let tried = RIDGES.iter().filter_map(|ridge| Some((*ridge, error(*ridge)?)));
        let (ridge, _) = tried.min_by(|a, b| a.1.total_cmp(&b.1))?; // (3)
        Some(Self { taps: Normal::sum(normals.iter()).solve(ridge)?, ridge })
    }

    /// What it makes of `input`, sample by sample.
    pub fn apply(&self, input: &[f64]) -> Vec<f64> {
        let n = input.len();
        let at = |i: usize| {
            let taps = self.taps.iter().enumerate();
            taps.filter_map(|(k, h)| Some(h * input[(i + AHEAD).checked_sub(k).filter(|j| *j < n)?])).sum() // (1)
        };
        (0..n).map(at).collect()
    }

    /// Its NRMSE on an event, %.
    pub fn nrmse_percent(&self, event: &Pair<'_>) -> f64 {
        nrmse_percent(&self.apply(event.input)[event.first()..], event.output)
    }
}

/// Normal equations of one or more events.
struct Normal {
    matrix: Mat<f64>,
    right: Mat<f64>,
    /// Events.
    n: usize,
}

impl Normal {
    /// Of one event, divided by the power of its output.
    fn of(pair: &Pair<'_>, n_tap: usize) -> Self {
        let (u, first, power) = (pair.input, pair.first(), pair.power());
        // Inputs of the output at sample i by tap, from the newest to the oldest: u[i + AHEAD − k].
        let padded: Vec<f64> =
            std::iter::repeat_n(0.0, n_tap).chain(u.iter().copied()).chain(std::iter::repeat_n(0.0, AHEAD)).collect();
        let newest = |i: usize| first + i + AHEAD + n_tap;
        let mut matrix = Mat::zeros(n_tap, n_tap);
        let mut right = Mat::zeros(n_tap, 1);
        let n = pair.output.len();
        for lag in 0..n_tap {
            // Along a diagonal the product only gains a sample in front and loses one behind.
            let mut sum: f64 = (0..n).map(|i| padded[newest(i)] * padded[newest(i) - lag]).sum();
            for k in 0..n_tap - lag {
                matrix[(k, k + lag)] = sum / power;
                matrix[(k + lag, k)] = sum / power;
                let [before, last] = [newest(0) - 1 - k, newest(n - 1) - k];
                if k + lag + 1 < n_tap {
                    sum += padded[before] * padded[before - lag] - padded[last] * padded[last - lag];
                }
            }
            right[(lag, 0)] = (0..n).map(|i| padded[newest(i) - lag] * pair.output[i]).sum::<f64>() / power;
        }
        Self { matrix, right, n: 1 }
    }

    fn sum<'a>(events: impl Iterator<Item = &'a Self>) -> Self {
        let add = |a: Self, b: &Self| Self { matrix: a.matrix + &b.matrix, right: a.right + &b.right, n: a.n + b.n };
        let mut events = events;
        let zero = |n_tap: usize| Self { matrix: Mat::zeros(n_tap, n_tap), right: Mat::zeros(n_tap, 1), n: 0 };
        let Some(first) = events.next() else { return zero(0) };
        events.fold(add(zero(first.matrix.nrows()), first), add)
    }

    /// (2).
    fn solve(&self, ridge: f64) -> Option<Vec<f64>> {
        let n_tap = self.matrix.nrows();
        let mean = (0..n_tap).map(|k| self.matrix[(k, k)]).sum::<f64>() / n_tap as f64;
        let mut matrix = self.matrix.clone();
        for k in 0..n_tap {
            matrix[(k, k)] += ridge * mean;
        }
        let taps = matrix.llt(Side::Lower).ok()?.solve(&self.right);
        Some((0..n_tap).map(|k| taps[(k, 0)]).collect())
    }

    /// NRMSE of `taps` on the one event of these equations, %.
    fn error_percent(&self, taps: &[f64]) -> f64 {
        let h = Mat::from_fn(taps.len(), 1, |k, _| taps[k]);
        let quadratic = (h.transpose() * &self.matrix * &h)[(0, 0)] - 2.0 * (h.transpose() * &self.right)[(0, 0)];
        100.0 * (f64::from(u32::try_from(self.n).unwrap_or(1)) + quadratic).max(0.0).sqrt()
    }
}

/// What predicts the waves of one sensor in one component best without a model, chosen and fitted on training events.
#[derive(Debug, Clone, PartialEq)]
pub enum Ceiling {
    /// The free filter from the other events.
    Filter,
    /// The amplitude-matched filter from the other events.
    Matched,
    /// Predicting nothing.
    Zero,
}

impl Ceiling {
    /// The way with the least mean error on training events, each predicted from the others: `filter` and `matched` are NRMSE in
    /// percent, one a training event.
    pub fn chosen(filter: &[f64], matched: &[f64]) -> Self {
        let mean = |errors: &[f64]| {
            let of = errors.iter().sum::<f64>() / errors.len() as f64;
            if of.is_finite() { of } else { f64::INFINITY }
        };
        let (filter, matched) = (mean(filter), mean(matched));
        if filter.min(matched) >= 100.0 {
            Self::Zero
        } else if filter <= matched {
            Self::Filter
        } else {
            Self::Matched
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::filter::low_pass_zero_phase;
    use crate::numerics::random;
    use crate::numerics::spectrum::respond;
    use rand_distr::{Distribution, StandardNormal};
    use realfft::num_complex::Complex;

    const DT_S: f64 = 0.05;

    /// Base and surface of a damped layer, with noise of `share` of the surface's RMS.
    fn event(number: u64, share: f64) -> (Vec<f64>, Vec<f64>) {
        let mut random = random::stream(number, "ceiling");
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let u: Vec<f64> = (0..900).map(|i| (-((f64::from(i) - 300.0) / 150.0).powi(2)).exp() * normal()).collect();
        // Resampled records hold little near the Nyquist frequency.
        let u = low_pass_zero_phase(&u, DT_S, 6.0);
        let layer = |f: f64| {
            let k = 0.55 * f;
            Complex::new(1.0, 0.0) / Complex::new(k.cos(), 0.25 * k.sin())
        };
        let [mut y] = respond([&u], DT_S, |f, [v]| [v * layer(f)]);
        let size = share * crate::metrics::rms(&y);
        y.iter_mut().for_each(|v| *v += size * normal());
        (u, y)
    }

    fn held_out_percent(share: f64, n: u64) -> f64 {
        let events: Vec<_> = (0..n).map(|e| event(e, share)).collect();
        let pairs: Vec<Pair<'_>> = events.iter().map(|(u, y)| Pair { input: u, output: &y[20..] }).collect();
        let (train, test) = pairs.split_at(pairs.len() - 2);
        let filter = FreeFilter::of(train, DT_S).unwrap();
        test.iter().map(|p| filter.nrmse_percent(p)).sum::<f64>() / 2.0
    }

    #[test]
    fn the_ceiling_of_a_linear_system_is_its_noise() {
        for share in [0.02, 0.2, 0.5] {
            let got = held_out_percent(share, 14);
            let noise = 100.0 * share / (1.0 + share * share).sqrt();
            println!("noise {noise:.1} %, ceiling {got:.1} %");
            assert!(got > 0.9 * noise && got < 1.2 * noise + 1.0, "{got} {noise}");
        }
    }

    #[test]
    fn outputs_that_follow_nothing_are_best_predicted_as_nothing() {
        let events: Vec<_> = (0..8).map(|e| (event(e, 0.0).0, event(e + 100, 0.0).1)).collect();
        let pairs: Vec<Pair<'_>> = events.iter().map(|(u, y)| Pair { input: u, output: y }).collect();
        let filter = FreeFilter::of(&pairs[..6], DT_S).unwrap();
        assert!(filter.ridge >= 0.1, "{}", filter.ridge);
        assert!(filter.nrmse_percent(&pairs[7]) < 115.0);
        assert_eq!(Ceiling::chosen(&[104.0, 101.0], &[150.0, 160.0]), Ceiling::Zero);
        assert_eq!(Ceiling::chosen(&[80.0], &[90.0]), Ceiling::Filter);
        assert_eq!(Ceiling::chosen(&[], &[90.0]), Ceiling::Matched);
    }

    #[test]
    fn the_normal_equations_are_those_of_the_filter() {
        let (u, y) = event(3, 0.1);
        let pair = Pair { input: &u, output: &y[15..] };
        let normal = Normal::of(&pair, 66);
        let taps: Vec<f64> = (0..66).map(|k| (0.3 * f64::from(k)).cos() / (1.0 + f64::from(k))).collect();
        let filter = FreeFilter { taps: taps.clone(), ridge: 0.0 };
        assert!((normal.error_percent(&taps) - filter.nrmse_percent(&pair)).abs() < 1e-8);
    }

    #[test]
    fn one_event_or_silence_has_no_filter() {
        let (u, y) = event(1, 0.0);
        let pair = Pair { input: &u, output: &y };
        assert!(FreeFilter::of(&[pair], DT_S).is_none());
        let silent = vec![0.0; 900];
        assert!(FreeFilter::of(&[pair, Pair { input: &u, output: &silent }], DT_S).is_none());
    }
}
