//! The shape of what remains: over frequency and depth, over the phases of the events, and over the strength of the motion.

use super::outcome::{EventRemainder, PHASES, Remainder, Verdict};
use super::search::{Model, Search, square};
use super::spectra::{history, taper};
use realfft::num_complex::Complex;
use std::collections::BTreeMap;

type C64 = Complex<f64>;

/// Edges of the bands, Hz.
const EDGES_HZ: [f64; 8] = [0.0, 0.5, 1.0, 2.0, 3.5, 5.0, 7.0, 100.0];

/// Mean squared whitened residuals of `model` by sensor and band, by sensor and phase of the events, and by record.
pub(super) fn remainder(search: &Search<'_>, model: &Model) -> Remainder {
    let array = &search.scene.problem.array;
    let bands = EDGES_HZ.len() - 1;
    let mut sums = vec![vec![[0.0; 2]; bands]; array.outputs.len()];
    let mut phases = vec![[[0.0; 2]; PHASES.len()]; array.outputs.len()];
    let mut event = Vec::new();
    for (groups, residual) in [(&search.train, &model.train.residual), (&search.validation, &model.validation.residual)]
    {
        let mut at = 0;
        for g in groups {
            let group = &search.scene.groups[*g];
            let whitened = &residual[at..];
            let mut own = vec![[0.0; 2]; group.records.len()];
            for f in &group.frequencies_hz {
                let band = EDGES_HZ.iter().rposition(|e| f >= e).unwrap_or(0).min(bands - 1);
                for own in &mut own {
                    for sums in &mut sums {
                        let power = square(&residual[at..at + 2]);
                        at += 2;
                        for sum in [&mut sums[band], &mut *own] {
                            sum[0] += power;
                            sum[1] += 2.0;
                        }
                    }
                }
            }
            for (r, record) in group.records.iter().enumerate() {
                let input = &search.scene.problem.events[record.event].input[record.window.clone()];
                for (s, phases) in phases.iter_mut().enumerate() {
                    let bins = group.residual_bins(whitened, array.outputs.len(), [r, s]);
                    add(phases, by_phase(&bins, &group.frequencies_hz, input));
                }
            }
            for (record, [power, count]) in group.records.iter().zip(own) {
                let of = &search.scene.problem.events[record.event];
                event.push(EventRemainder {
                    event: of.name.clone(),
                    component: array.components.get(of.component()).cloned().unwrap_or_default(),
                    input_pga_m_s2: of.input.iter().fold(0.0, |m, a| m.max(a.abs())),
                    level: power / f64::max(count, 1.0),
                });
            }
        }
    }
    let level = |[power, count]: [f64; 2]| if count > 0.0 { power / count } else { 1.0 };
    let named = |levels: Vec<Vec<f64>>| array.outputs.iter().cloned().zip(levels).collect();
    Remainder {
        edges_hz: EDGES_HZ.to_vec(),
        sensor_band: named(sums.into_iter().map(|s| s.into_iter().map(level).collect()).collect()),
        sensor_phase: named(phases.into_iter().map(|s| s.into_iter().map(level).collect()).collect()),
        event,
    }
}

/// Names of [`PHASES`], for people.
const NAMES: [&str; PHASES.len()] =
    ["at the beginning of the events", "in their strong phase", "after it", "in the coda"];

/// Where most of what remains is, where the verdict is that it has no name.
pub(super) fn strongest(remainder: &Remainder, verdict: Verdict) -> Option<String> {
    let most = |levels: &BTreeMap<String, Vec<f64>>| {
        let all =
            levels.iter().flat_map(|(sensor, levels)| levels.iter().enumerate().map(move |(i, l)| (sensor, i, *l)));
        all.max_by(|a, b| a.2.total_cmp(&b.2)).map(|(sensor, i, level)| (sensor.clone(), i, level))
    };
    let (sensor, band, level) = most(&remainder.sensor_band).filter(|_| verdict == Verdict::Unknown)?;
    let (at, phase, then) = most(&remainder.sensor_phase)?;
    let [low, high] = [remainder.edges_hz[band], remainder.edges_hz[band + 1]];
    // The last band is open.
    let is_last = band + 2 == remainder.edges_hz.len();
    let band = if is_last { format!("above {low} Hz") } else { format!("between {low} and {high} Hz") };
    Some(format!(
        "what remains is largest at {sensor} {band}, {level:.0} times the power of noise; over time it is at {at} {}, {then:.0} times",
        NAMES[phase]
    ))
}

fn add(sums: &mut [[f64; 2]], more: [[f64; 2]; PHASES.len()]) {
    for (sum, more) in sums.iter_mut().zip(more) {
        sum[0] += more[0];
        sum[1] += more[1];
    }
}

/// Power of the whitened residual with these `bins` in the phases of the recorded `input`, and what noise would have there:
///
/// ```text
/// power: Σ_t e² · Σ|ρ|²/(2 Σ_t e²)     noise: Σ_t w² · n_bin/Σ_t w²                         (1)
/// ```
///
/// e is the residual in time, w the taper; sums of both over all phases are those over the bins.
///
/// Limits: whitening spreads a residual over the inverse of the width of a resonance; phases are those of the input, at the base.
/// Check:  `a_residual_is_where_it_was_put`.
/// Source: (1) Parseval's theorem; phases by energy after Husid (1969).
fn by_phase(bins: &[C64], frequencies_hz: &[f64], input: &[f64]) -> [[f64; 2]; PHASES.len()] {
    let mut phases = [[0.0; 2]; PHASES.len()];
    let [low, next, ..] = frequencies_hz else { return phases };
    let n = input.len();
    let residual = history(bins, (low / (next - low)).round() as usize, n);
    let energy: f64 = input.iter().map(|u| u * u).sum();
    let mut passed = 0.0;
    for (t, (u, e)) in input.iter().zip(&residual).enumerate() {
        passed += u * u;
        let phase = PHASES.iter().position(|share| passed <= share * energy).unwrap_or(PHASES.len() - 1);
        phases[phase][0] += e * e;
        phases[phase][1] += taper(t, n).powi(2);
    }
    let power: f64 = bins.iter().map(C64::norm_sqr).sum();
    let [in_time, in_taper] = [0, 1].map(|i| phases.iter().map(|p| p[i]).sum::<f64>().max(f64::MIN_POSITIVE));
    phases.map(|[e, w]| [e * power / (2.0 * in_time), w * bins.len() as f64 / in_taper])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    const DT_S: f64 = 0.01;

    /// Bins of a tapered series below 10 Hz.
    fn bins(series: &[f64]) -> (Vec<C64>, Vec<f64>) {
        let n = series.len();
        let bin = |k: usize| -> C64 {
            let of = |(t, x): (usize, &f64)| C64::from_polar(x * taper(t, n), -TAU * (k * t) as f64 / n as f64);
            series.iter().enumerate().map(of).sum()
        };
        let (first, last) = (2, (10.0 * n as f64 * DT_S) as usize);
        ((first..last).map(bin).collect(), (first..last).map(|k| k as f64 / (n as f64 * DT_S)).collect())
    }

    #[test]
    fn a_residual_is_where_it_was_put() {
        // Strong shaking from 2 to 4 s of 12.
        let input: Vec<f64> = (0..1200)
            .map(|i| i as f64 * DT_S)
            .map(|t| (-(t - 3.0).powi(2) * 2.0).exp() * (TAU * 3.0 * t).sin())
            .collect();
        for (centre_s, phase) in [(1.0, 0), (3.0, 1), (3.4, 2), (8.0, 3)] {
            let burst = |t: f64| (-(t - centre_s).powi(2) * 60.0).exp() * (TAU * 4.0 * t).cos();
            let residual: Vec<f64> = (0..1200).map(|i| burst(i as f64 * DT_S)).collect();
            let (bins, frequencies_hz) = bins(&residual);
            let found = by_phase(&bins, &frequencies_hz, &input);
            let largest = (0..4).max_by(|a, b| found[*a][0].total_cmp(&found[*b][0])).unwrap();
            assert_eq!(largest, phase, "{centre_s} s: {found:?}");
            let power: f64 = bins.iter().map(C64::norm_sqr).sum();
            let sums = [0, 1].map(|i| found.iter().map(|p| p[i]).sum::<f64>());
            assert!((2.0 * sums[0] / power - 1.0).abs() < 1e-9 && (sums[1] / bins.len() as f64 - 1.0).abs() < 1e-9);
        }
    }
}
