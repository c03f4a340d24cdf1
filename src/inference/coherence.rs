//! How far the field follows its base, by frequency: read off bands as far as they tell of it.

use super::algebra;
use faer::Mat;
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// Knots of the coherence, between the ends of the frequency band at equal ratios.
pub const KNOTS: usize = 7;
/// Fewest independent bins of a band that tell of its coherence.
const LEAST_INDEPENDENT: f64 = 2.0;
/// How far below one a squared coherence is expected at most: the deviation of a half-normal prior.
const INCOHERENCE: f64 = 0.5;
/// How far apart the squared coherences of neighbouring knots are expected: the deviation of a normal prior.
const ROUGHNESS: f64 = 0.25;
/// How far a band may be off the line between knots, in squared coherence.
const UNEVEN: f64 = 0.05;
/// Steps towards the coherence.
const COHERENCE_STEPS: usize = 5;
/// Smallest coherence that is still told from none.
const LEAST_COHERENCE: f64 = 0.05;
/// Smallest power, as a share of the largest of a record.
pub const FLOOR: f64 = 1e-12;

/// Sums over the bins of a band in all records, each weighted by the power of its record.
#[derive(Debug, Clone, Copy, Default)]
pub struct Moments {
    /// Middle of the band, Hz.
    pub f_hz: f64,
    /// Σ |Y|² and Σ |Ŷ|², and what noise makes of them.
    pub recorded: f64,
    pub predicted: f64,
    pub noise: [f64; 2],
    /// Σ Y Ŷ*.
    pub cross: C64,
    /// Number of independent bins.
    pub n: f64,
}

impl Moments {
    /// Power of noise over that of the motion, recorded and predicted together; none where nothing is left beside noise.
    fn noise_ratio(&self) -> Option<f64> {
        let [recorded, predicted] = [self.recorded - self.noise[0], self.predicted - self.noise[1]];
        let has_motion = recorded > FLOOR && predicted > FLOOR;
        has_motion.then(|| self.recorded * self.predicted / (recorded * predicted) - 1.0)
    }

    /// Squared coherence of the motion; none where too few bins tell. Chance takes it beyond one, too.
    fn squared_coherence(&self) -> Option<f64> {
        let gamma = self.cross.norm_sqr() / (self.recorded * self.predicted).max(FLOOR);
        let less_chance = (gamma - 1.0 / self.n) / (1.0 - 1.0 / self.n);
        (self.n >= LEAST_INDEPENDENT).then_some((1.0 + self.noise_ratio()?) * less_chance)
    }
}

/// What a band tells of the coherence.
struct Told {
    knots: [(usize, f64); 2],
    n: f64,
    noise_ratio: f64,
    square: f64,
}

impl Told {
    fn of(m: &Moments, ends_hz: [f64; 2]) -> Option<Self> {
        let (noise_ratio, square) = (m.noise_ratio()?, m.squared_coherence()?);
        Some(Self { knots: hats(m.f_hz, ends_hz), n: m.n, noise_ratio, square })
    }

    /// Variance of its squared coherence where the line through all bands has the squared coherence `line`.
    fn variance(&self, line: f64) -> f64 {
        let noisy = 1.0 + self.noise_ratio;
        let g = (line / noisy).min(1.0);
        let of_chance = (noisy * (1.0 - g)).powi(2) * (2.0 * g + 1.0 / self.n) / self.n;
        of_chance + (line * self.noise_ratio).powi(2) + UNEVEN * UNEVEN
    }
}

/// Share of the power that strays, at the knots.
pub fn straying_at_knots(moments: &[Moments], ends_hz: [f64; 2]) -> Vec<f64> {
    let mut shares = [[0.0, f64::MIN_POSITIVE]; KNOTS];
    for m in moments {
        let Some(square) = m.squared_coherence() else { continue };
        let motion = m.recorded - m.noise[0];
        for (j, w) in hats(m.f_hz, ends_hz) {
            shares[j][0] += w * motion * (1.0 - square.clamp(0.0, 1.0));
            shares[j][1] += w * motion;
        }
    }
    shares.iter().map(|[strays, all]| strays / all).collect()
}

/// Coherence at the knots: squared, it is the line through that of the bands that is as smooth as [`ROUGHNESS`] says and no further below
/// one than [`INCOHERENCE`] says, as far as bands tell.
///
/// ```text
/// C²  = (1 + ν) (γ² − 1/n)/(1 − 1/n),   γ² = |Σ Y Ŷ*|² / (Σ |Ŷ|² Σ |Y|²)
/// var = (1 + ν)² (1 − g)² (2 g + 1/n)/n + (C² ν)² + u²,   g = C²/(1 + ν)
/// ```
///
/// Sums are over the bins of a band in all records, each weighted by the power of its record; n of them are independent. ν is the ratio
/// of noise to motion, known no better than to a factor of two: where noise prevails a band tells nothing, and the line goes on as it came.
/// u is [`UNEVEN`]. The variance is taken at the line and not at each band, where what chance raised would count for more.
///
/// Source: Bendat and Piersol (2010), Random Data, for the variance of γ².
/// Check:  `bands_in_which_noise_prevails_tell_no_coherence`, `chance_is_not_taken_for_a_field_that_strays`.
pub fn coherence_at_knots(moments: &[Moments], ends_hz: [f64; 2]) -> Vec<f64> {
    let told: Vec<Told> = moments.iter().filter_map(|m| Told::of(m, ends_hz)).collect();
    let certainty = INCOHERENCE.powi(-2);
    let own = vec![certainty; KNOTS];
    let mut prior = Mat::<f64>::from_fn(KNOTS, KNOTS, |i, j| if i == j { certainty } else { 0.0 });
    for i in 1..KNOTS {
        for (j, k, sign) in [(i, i, 1.0), (i - 1, i - 1, 1.0), (i, i - 1, -1.0), (i - 1, i, -1.0)] {
            prior[(j, k)] += sign * ROUGHNESS.powi(-2);
        }
    }
    let mut square = vec![1.0; KNOTS];
    for _ in 0..COHERENCE_STEPS {
        let (mut a, mut b) = (prior.clone(), own.clone());
        for band in &told {
            let weight = 1.0 / band.variance(at(&square, band.knots));
            for (j, u) in band.knots {
                b[j] += weight * u * band.square;
                for (k, v) in band.knots {
                    a[(j, k)] += weight * u * v;
                }
            }
        }
        let Some(solved) = algebra::solved(&a, &b) else { break };
        square = solved.into_iter().map(|q| q.clamp(LEAST_COHERENCE.powi(2), 1.0)).collect();
    }
    square.into_iter().map(f64::sqrt).collect()
}

/// Hat functions over ln f with [`KNOTS`] knots: the two knots around a frequency and their shares.
pub fn hats(frequency_hz: f64, [low, high]: [f64; 2]) -> [(usize, f64); 2] {
    let x = (frequency_hz / low).ln() / (high / low).ln() * (KNOTS - 1) as f64;
    let x = x.clamp(0.0, (KNOTS - 1) as f64);
    let i = (x.floor() as usize).min(KNOTS - 2);
    let w = x - i as f64;
    [(i, 1.0 - w), (i + 1, w)]
}

fn at(knots: &[f64], [(i, v), (j, w)]: [(usize, f64); 2]) -> f64 {
    knots[i] * v + knots[j] * w
}

/// Frequency of knot `k`, Hz.
pub fn knot_hz(k: usize, [low, high]: [f64; 2]) -> f64 {
    low * (high / low).powf(k as f64 / (KNOTS - 1) as f64)
}

/// Value at a frequency of what is given at the knots, linear over ln f.
pub fn interpolated(knots: &[f64], frequency_hz: f64, ends_hz: [f64; 2]) -> f64 {
    at(knots, hats(frequency_hz, ends_hz))
}

/// Share of the prediction that the mean motion is where the coherence is `c` and a share `added` of what strays is of another origin.
pub fn coherent(c: f64, added: f64) -> f64 {
    c / (1.0 - added * (1.0 - c * c)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::made_up::sample;
    use super::*;
    use crate::numerics::random;

    #[test]
    fn bands_in_which_noise_prevails_tell_no_coherence() {
        let ends_hz = [0.2, 20.0];
        let square = |f: f64| -> f64 { if f < 1.0 { 1.0 } else { 0.36 } };
        let band = |b: u32| {
            let f_hz = 0.2 * (f64::from(b) / 6.0).exp2();
            // From 8 Hz on there is hardly a prediction, and what is there is noise.
            let predicted = if f_hz < 8.0 { 1.0 } else { 1e-3 };
            let cross = C64::from(if f_hz < 8.0 { square(f_hz).sqrt() } else { 1e-3 });
            Moments { f_hz, recorded: 1.0, predicted, noise: [1e-4, 0.98e-3], cross, n: 50.0 }
        };
        let all: Vec<Moments> = (0..40).map(band).collect();
        let found = coherence_at_knots(&all, ends_hz);
        // Knots are at 0.2, 0.43, 0.93, 2, 4.3, 9.3 and 20 Hz; half the line between the third and the fourth is on the way.
        assert!(found[..2].iter().all(|c| (c - 1.0).abs() < 0.05), "{found:?}");
        assert!((found[4] - 0.6).abs() < 0.05, "{found:?}");
        assert!(found[5..].iter().all(|c| (0.55..0.85).contains(c)), "{found:?}");
    }

    #[test]
    fn chance_is_not_taken_for_a_field_that_strays() {
        // In bands of few bins squared coherence is one on average, and by chance beyond.
        let mut stream = random::stream(3, "coherence");
        let band = |b: u32, stream: &mut _| {
            let one = |_: u32| {
                let predicted = C64::new(sample(stream), sample(stream));
                let noise = C64::new(sample(stream), sample(stream));
                [predicted, predicted + 0.2 * noise]
            };
            let bins: Vec<[C64; 2]> = (0..8).map(one).collect();
            let power = |s: usize| bins.iter().map(|b| b[s].norm_sqr()).sum::<f64>();
            let cross = bins.iter().map(|[p, y]| y * p.conj()).sum();
            let f_hz = 0.2 * (f64::from(b) / 6.0).exp2();
            Moments { f_hz, recorded: power(1), predicted: power(0), noise: [0.64, 0.0], cross, n: 8.0 }
        };
        let all: Vec<Moments> = (0..40).map(|b| band(b, &mut stream)).collect();
        let found = coherence_at_knots(&all, [0.2, 20.0]);
        assert!(found.iter().all(|c| *c > 0.98), "{found:?}");
    }
}
