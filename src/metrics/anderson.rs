//! Anderson's score: ten criteria in up to ten bands, ten points each.

use super::history::{History, fourier_frequencies_hz, psa_periods_s};
use super::peaks::peak;
use crate::numerics::{filter, integrate};
use serde::{Deserialize, Serialize};

/// Bands of the score, Hz; the last one is all of them together.
pub const BANDS_HZ: [[f64; 2]; 10] = [
    [0.05, 0.1],
    [0.1, 0.2],
    [0.2, 0.5],
    [0.5, 1.0],
    [1.0, 2.0],
    [2.0, 5.0],
    [5.0, 10.0],
    [10.0, 20.0],
    [20.0, 50.0],
    [0.05, 50.0],
];
/// Periods of its lowest frequency that a history must hold for a band to count.
const FEWEST_PERIODS: f64 = 2.0;

/// Anderson's score of one history against another.
///
/// ```text
/// S(p, q) = 10 exp(−[(p − q)/min(p, q)]²)                                                     (1)
/// C1  10 (1 − max_t |N_a(t) − N_a'(t)|),  N_a(t) = ∫₀ᵗ a² / ∫ a²    Arias duration              (2)
/// C2  the same of the velocity                                     energy duration
/// C3  S(I_A, I_A'), I_A = π/(2g) ∫ a²      C4  S(E, E'), E = ∫ v²                                (3)
/// C5, C6, C7  S of the peaks of a, v and d
/// C8  mean S(PSA(T), PSA'(T)), 1/T in the band     C9  mean S(A(f), A'(f)), f in the band        (4)
/// C10 10 max(0, ∫ a a' / √(∫ a² ∫ a'²))                                                         (5)
/// score = mean over bands of the mean of C1 … C10                                               (6)
/// ```
///
/// Below 4 the fit is poor, from 4 to 6 fair, to 8 good, above excellent; the two horizontal components of one record typically fit each
/// other well. Bands of [`BANDS_HZ`]; a, v and d are filtered into the band without phase, v and d once more after each
/// integration, against drift.
///
/// Limits: a band counts where it lies within the band asked for and below the Nyquist frequency, and where the histories hold two of its
/// longest periods; the last band is cut to what is asked for. The spectra of (4) are those of the whole history, of 5 % damping and
/// smoothed after Konno and Ohmachi; the source takes those of the filtered one.
/// Check:  `criteria_are_those_of_the_broadband_platform`, `the_same_scores_ten`, `a_factor_two_costs_what_the_formulas_say`.
/// Source: Anderson (2004), Quantitative measure of the goodness-of-fit of synthetic seismograms, 13th World Conf. Earthq. Eng., 243.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Anderson {
    /// (6), 0 … 10.
    pub score: f64,
    /// C1 … C10, means over the bands; `None` where no band has it.
    pub criteria: Vec<Option<f64>>,
}

/// What one history shows in one band.
#[derive(Debug, Clone)]
pub(super) struct Scored {
    acceleration: Vec<f64>,
    energy: Energy,
    peaks: [f64; 3],
    psa: Vec<f64>,
    fourier: Vec<f64>,
}

/// Squared acceleration and velocity: their build-up, ending at one, and their integrals.
#[derive(Debug, Clone)]
struct Energy {
    build_up: [Vec<f64>; 2],
    whole: [f64; 2],
}

impl Scored {
    /// Of `x` in each band of [`BANDS_HZ`] that counts.
    pub(super) fn of(x: &[f64], dt_s: f64, within_hz: [f64; 2], fourier: &[f64], psa: &[f64]) -> Vec<Option<Self>> {
        let (frequencies_hz, periods_s) = (fourier_frequencies_hz(), psa_periods_s());
        let [lowest_hz, highest_hz] = [within_hz[0], within_hz[1].min(0.5 / dt_s)];
        let in_band = |i: usize| {
            let mut band = BANDS_HZ[i];
            if i == BANDS_HZ.len() - 1 {
                band = [band[0].max(lowest_hz), band[1].min(highest_hz)];
            }
            let [low_hz, high_hz] = band;
            let is_counted = low_hz >= lowest_hz * (1.0 - 1e-9)
                && high_hz <= highest_hz * (1.0 + 1e-9)
                && low_hz < high_hz
                && x.len() as f64 * dt_s * low_hz >= FEWEST_PERIODS;
            let inside = |f: &f64| *f >= low_hz && *f <= high_hz;
            is_counted.then(|| {
                let filtered = |x: &[f64]| filter::band_pass_zero_phase(x, dt_s, low_hz, high_hz);
                let acceleration = filtered(x);
                let velocity = filtered(&integrate::cumulative(&acceleration, dt_s));
                let displacement = filtered(&integrate::cumulative(&velocity, dt_s));
                Self {
                    energy: Energy::of([&acceleration, &velocity], dt_s),
                    peaks: [peak(&acceleration), peak(&velocity), peak(&displacement)],
                    psa: psa.iter().zip(&periods_s).filter(|(_, t)| inside(&(1.0 / *t))).map(|(v, _)| *v).collect(),
                    fourier: fourier.iter().zip(&frequencies_hz).filter(|(_, f)| inside(f)).map(|(v, _)| *v).collect(),
                    acceleration,
                }
            })
        };
        (0..BANDS_HZ.len()).map(in_band).collect()
    }

    fn criteria(&self, other: &Self) -> [f64; 10] {
        let duration = |k: usize| {
            let pairs = self.energy.build_up[k].iter().zip(&other.energy.build_up[k]);
            10.0 * (1.0 - pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)).max(0.0) // (2)
        };
        let size = |k: usize| similarity(self.energy.whole[k], other.energy.whole[k]); // (3)
        let [pga, pgv, pgd] = std::array::from_fn(|k| similarity(self.peaks[k], other.peaks[k]));
        [
            duration(0),
            duration(1),
            size(0),
            size(1),
            pga,
            pgv,
            pgd,
            mean_similarity(&self.psa, &other.psa),
            mean_similarity(&self.fourier, &other.fourier), // (4)
            correlation(&self.acceleration, &other.acceleration),
        ]
    }
}

impl Energy {
    fn of(motions: [&[f64]; 2], dt_s: f64) -> Self {
        let mut build_up = motions.map(|x| {
            let squares: Vec<f64> = x.iter().map(|v| v * v).collect();
            integrate::cumulative(&squares, dt_s)
        });
        let whole = [0, 1].map(|k| build_up[k].last().copied().unwrap_or(0.0));
        for (rising, end) in build_up.iter_mut().zip(whole) {
            rising.iter_mut().for_each(|v| *v /= end);
        }
        Self { build_up, whole }
    }
}

impl Anderson {
    /// Of two histories of the same step, compared over the length of the shorter one; `None` where no band counts.
    pub fn of(predicted: &History, observed: &History) -> Option<Self> {
        let bands: Vec<[f64; 10]> = predicted
            .scored
            .iter()
            .zip(&observed.scored)
            .filter_map(|(p, a)| Some(p.as_ref()?.criteria(a.as_ref()?)))
            .collect();
        let mean = |values: &[f64]| {
            let seen: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
            (!seen.is_empty()).then(|| seen.iter().sum::<f64>() / seen.len() as f64)
        };
        let by_band: Vec<f64> = bands.iter().filter_map(|criteria| mean(criteria)).collect();
        let criteria = (0..10).map(|c| mean(&bands.iter().map(|band| band[c]).collect::<Vec<_>>()));
        Some(Self { score: mean(&by_band)?, criteria: criteria.collect() }) // (6)
    }
}

/// (1), from 0 to 10.
fn similarity(p: f64, q: f64) -> f64 {
    10.0 * (-((p - q) / p.min(q)).powi(2)).exp()
}

fn mean_similarity(p: &[f64], q: &[f64]) -> f64 {
    let seen: Vec<f64> = p.iter().zip(q).map(|(p, q)| similarity(*p, *q)).filter(|v| v.is_finite()).collect();
    if seen.is_empty() { f64::NAN } else { seen.iter().sum::<f64>() / seen.len() as f64 }
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    10.0 * super::cosine_similarity(&a[..n], &b[..n]).max(0.0) // (5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::made_up::{DT_S, observed, predicted};

    const BAND_HZ: [f64; 2] = [0.1, 20.0];

    fn score(predicted: &[f64], observed: &[f64]) -> Anderson {
        let [p, a] = [predicted, observed].map(|x| History::new(x, DT_S, BAND_HZ));
        Anderson::of(&p, &a).expect("bands that count")
    }

    /// Criteria of `anderson_gof` of the Broadband Platform of SCEC, written from its published text, on histories that no band filters;
    /// `python tests/metrics/vectors.py` with `BBP_COMPS` asks that module itself. Its sums are of rectangles and its C10 is Simpson's, which makes differences below 1e-3.
    #[test]
    fn criteria_are_those_of_the_broadband_platform() {
        let scored = |x: &[f64], spectrum: [f64; 3]| {
            let velocity = integrate::cumulative(x, DT_S);
            let displacement = integrate::cumulative(&velocity, DT_S);
            Scored {
                energy: Energy::of([x, &velocity], DT_S),
                peaks: [peak(x), peak(&velocity), peak(&displacement)],
                psa: spectrum.to_vec(),
                fourier: spectrum.to_vec(),
                acceleration: x.to_vec(),
            }
        };
        let [p, a] = [scored(&predicted(), [1.0, 2.0, 4.0]), scored(&observed(), [1.1, 1.5, 4.0])];
        let expected = [
            9.355100859,
            9.803650542,
            8.941756167,
            8.303642286,
            9.985311404,
            9.696525411,
            9.614556985,
            9.616297169,
            9.616297169,
            9.383287090,
        ];
        for (c, (found, expected)) in p.criteria(&a).into_iter().zip(expected).enumerate() {
            println!("C{}: {found:.9} {expected}", c + 1);
            assert!((found - expected).abs() < 1e-3, "C{}: {found} {expected}", c + 1);
        }
    }

    #[test]
    fn the_same_scores_ten() {
        let found = score(&observed(), &observed());
        assert!((found.score - 10.0).abs() < 1e-9, "{found:?}");
        assert!(found.criteria.iter().all(|c| c.is_some_and(|c| (c - 10.0).abs() < 1e-9)), "{found:?}");
    }

    #[test]
    fn a_factor_two_costs_what_the_formulas_say() {
        let twice: Vec<f64> = observed().iter().map(|v| 2.0 * v).collect();
        let found = score(&twice, &observed());
        let [amplitude, energy] = [10.0 * (-1f64).exp(), 10.0 * (-9f64).exp()];
        let expected = [10.0, 10.0, energy, energy, amplitude, amplitude, amplitude, amplitude, amplitude, 10.0];
        for (found, expected) in found.criteria.iter().zip(expected) {
            assert!((found.expect("a number") - expected).abs() < 1e-6, "{found:?} {expected}");
        }
        assert!((found.score - expected.iter().sum::<f64>() / 10.0).abs() < 1e-6, "{found:?}");
        assert_eq!(found, score(&observed(), &twice), "neither history comes first");
    }

    #[test]
    fn what_is_alike_scores_between_and_reversed_time_less() {
        let alike = score(&predicted(), &observed());
        assert!((5.0..9.5).contains(&alike.score), "{alike:?}");
        let turned: Vec<f64> = observed().into_iter().rev().collect();
        let reversed = score(&turned, &observed());
        let worst = |a: &Anderson| a.criteria[0].unwrap() + a.criteria[9].unwrap();
        assert!(worst(&reversed) < worst(&alike), "{reversed:?}");
    }

    #[test]
    fn bands_beyond_the_records_do_not_count() {
        let counted = |within: [f64; 2], n: usize| {
            let history = History::new(&observed()[..n], DT_S, within);
            history.scored.iter().map(Option::is_some).collect::<Vec<_>>()
        };
        let all = counted([0.05, 50.0], 2001);
        assert_eq!(all.iter().filter(|c| **c).count(), 8, "20 s hold two periods of 0.1 Hz: {all:?}");
        assert!(!all[0] && !all[9] && all[1]);
        assert_eq!(
            counted([0.2, 20.0], 2001),
            [2, 3, 4, 5, 6, 7, 9].iter().fold([false; 10], |mut c, i| {
                c[*i] = true;
                c
            })
        );
        assert!(counted([0.2, 20.0], 10).iter().all(|c| !c));
        let silent = History::new(&[0.0; 2001], DT_S, BAND_HZ);
        assert!(Anderson::of(&silent, &silent).is_none_or(|a| a.score.is_finite()));
    }
}
