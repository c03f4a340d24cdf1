//! How far what strays goes together at the output sensors.

use super::coherence::{KNOTS, hats, interpolated};
use super::forward::{Forward, Prediction};
use super::spread::{band_hz, powers, seen};
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

/// Correlation of what strays from output sensor to output sensor at the knots, taken to arrive everywhere at once, so that it is a real number
/// from 0 to 1 and the same between all of them; drawn towards none as far as chance may have made it.
///
/// ```text
/// γ = Σ Re r_s r_t* / √(Σ |r_s|² Σ |r_t|²),   ρ = λ γ,   λ = 1 − (1 − γ²)²/(n γ²)        (1)
/// ```
///
/// Sums are over pairs of sensors and the bins around the knot in all records, n of them independent, each record weighted by one over its
/// power. Were ρ free in phase and from band to band it would be a transfer function without a column, which wrong labels make good use of.
///
/// Source: Schäfer and Strimmer (2005), doi 10.2202/1544-6115.1175, for λ.
/// Check:  `what_strays_at_one_sensor_strays_at_others`.
pub fn correlation_at_knots(forward: &Forward<'_>, prediction: &Prediction, coherence: &[Vec<f64>]) -> Vec<f64> {
    let (n, ends) = (coherence.len(), band_hz(forward));
    // Σ Re r_s r_t*, Σ |r_s|² and Σ |r_t|² over the pairs, and the number of independent bins.
    let mut sums = vec![([0.0; 3], 0.0); KNOTS];
    for (at, p) in forward.records.iter().zip(prediction) {
        let weight = |y: &Vec<C64>| 1.0 / powers(y).iter().sum::<f64>().max(f64::MIN_POSITIVE).sqrt();
        let weights: Vec<f64> = p.measured.iter().map(weight).collect();
        let lasting = p.labels[1..].iter().map(|l| seen(forward, *at).lasting[l.channel]).fold(1.0, f64::min);
        for (k, f) in forward.frequencies_hz(*at).iter().enumerate() {
            let residual = |s: usize| p.residual(s, k, interpolated(&coherence[s], *f, ends)) * weights[s];
            let r: Vec<C64> = (0..n).map(residual).collect();
            for (knot, share) in hats(*f, ends) {
                let (sum, count) = &mut sums[knot];
                for (i, j) in (0..n).flat_map(|i| (0..i).map(move |j| (i, j))) {
                    sum[0] += share * (r[i] * r[j].conj()).re;
                    sum[1] += share * r[i].norm_sqr();
                    sum[2] += share * r[j].norm_sqr();
                }
                *count += share * lasting;
            }
        }
    }
    let drawn = |([cross, one, other], count): &([f64; 3], f64)| {
        let gamma = (cross / (one * other).sqrt().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        let chance = (1.0 - gamma * gamma).powi(2) / count.max(1.0);
        gamma * (1.0 - chance / (gamma * gamma).max(f64::MIN_POSITIVE)).max(0.0)
    };
    sums.iter().map(drawn).collect()
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{Truth, Uniform, problem, sample};
    use super::super::spread::Spread;
    use super::*;
    use crate::diagnosis::DiagnoseSettings;
    use crate::numerics::random;

    #[test]
    fn what_strays_at_one_sensor_strays_at_others() {
        let problem = problem(&Truth::default());
        let replay = Uniform(&problem);
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        let right = forward.predict(&[]).unwrap();
        let ends = band_hz(&forward);
        // Between the two output sensors, in the middle of the band, where a share of what strays is the same at both.
        let correlation = |share: f64| {
            let mut stream = random::stream(11, "strays");
            let mut one = || C64::new(sample(&mut stream), sample(&mut stream));
            let mut astray = right.clone();
            for p in &mut astray {
                for k in 0..p.base.len() {
                    let same = one();
                    for y in &mut p.measured {
                        let size = 0.5 * y[k].norm();
                        y[k] += (same * share.sqrt() + one() * (1.0 - share).sqrt()) * size;
                    }
                }
            }
            interpolated(&Spread::estimated(&forward, &astray).correlation, (ends[0] * ends[1]).sqrt(), ends)
        };
        let [none, half, all] = [0.0, 0.5, 1.0].map(correlation);
        assert!(none < 0.15, "{none}");
        assert!((half - 0.5).abs() < 0.15, "{half}");
        assert!(all > 0.85, "{all}");
    }
}
