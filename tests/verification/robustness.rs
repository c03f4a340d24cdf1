//! Strong undrained motions: every run finishes, smoothly.

use crate::support::{lotung, peak, shake};
use flare_pipe::column::Analysis;
use rand::RngExt;
use std::time::Instant;

/// A band-limited random motion under an envelope, scaled to `pga_g`.
pub fn motion(seed: u64, pga_g: f64, duration_s: f64) -> Vec<f64> {
    let mut rng = flare_pipe::numerics::random::stream(seed, "robustness");
    let center = rng.random_range(0.8..4.0);
    let lines: Vec<(f64, f64, f64)> = (0..150)
        .map(|_| {
            let f: f64 = rng.random_range(0.3..10.0);
            let a = (-((f / center).ln() / 0.7).powi(2)).exp();
            (f, a * rng.random_range(0.3..1.0), rng.random_range(0.0..std::f64::consts::TAU))
        })
        .collect();
    let strong_s = rng.random_range(2.0..6.0);
    let n = (duration_s / 0.005).round() as usize + 1;
    let raw: Vec<f64> = (0..n)
        .map(|k| {
            let t = k as f64 * 0.005;
            let envelope = (t / strong_s).powi(2) * (2.0 * (1.0 - t / strong_s)).exp();
            envelope * lines.iter().map(|(f, a, p)| a * (std::f64::consts::TAU * f * t + p).sin()).sum::<f64>()
        })
        .collect();
    let scale = pga_g * 9.806_65 / peak(&raw);
    raw.iter().map(|a| a * scale).collect()
}

/// Largest departure of a sample from the mean of its neighbours, over the peak.
pub fn spike(x: &[f64]) -> f64 {
    let jump = x.windows(3).map(|w| (w[1] - 0.5 * (w[0] + w[2])).abs()).fold(0.0, f64::max);
    jump / peak(x)
}

#[test]
fn strong_undrained_lotung_motions_finish_without_spikes() {
    let profile = lotung(200);
    for (seed, pga_g) in [(1, 0.0075), (2, 0.02), (3, 0.05), (4, 0.08), (5, 0.112), (6, 0.112), (7, 0.112), (8, 0.1)] {
        let start = Instant::now();
        let base = motion(seed, pga_g, 15.0);
        let (rows, summary) = shake(&profile, &Analysis::default(), 0.005, &base);
        let elapsed = start.elapsed().as_secs_f64();
        let channel = |k: usize| -> Vec<f64> { rows.iter().map(|r| r[k]).collect() };
        let (at, worst) =
            (0..=200).map(|k| (k, spike(&channel(k)))).fold((0, 0.0), |m, x| if x.1 > m.1 { x } else { m });
        println!(
            "{pga_g} g: {summary:?} {elapsed:.2} s, peak surface {:.3} g, base spike {:.3}, worst spike {worst:.3} in channel {at}",
            peak(&channel(0)) / 9.81,
            spike(&base)
        );
    }
}

#[test]
#[ignore]
fn explore() {
    for (seed, pga) in [(2, 0.02), (4, 0.08), (7, 0.112), (8, 0.1)] {
        let base = motion(seed, pga, 15.0);
        let mut first: Option<Vec<f64>> = None;
        for law in [0.0, 1e-4, 2e-4, 5e-4, 1e-3] {
            let mut profile = lotung(200);
            profile.rayleigh.beta_s = law;
            let start = Instant::now();
            let (rows, summary) = shake(&profile, &Analysis::default(), 0.005, &base);
            let time = start.elapsed().as_secs_f64();
            let channel = |k: usize| -> Vec<f64> { rows.iter().map(|r| r[k]).collect() };
            let spikes: Vec<f64> = (0..=200).map(|k| spike(&channel(k))).collect();
            let x = channel(0);
            let miss = crate::support::relative_rms(&x, first.get_or_insert(x.clone()));
            println!(
                "{pga} {law:?}: {summary:?} {time:.2} s, spikes surface {:.3} worst {:.3}, peak {:.3}, differs {miss:.4}",
                spikes[0],
                spikes.iter().fold(0.0, |a: f64, b| a.max(*b)),
                peak(&x) / 9.81
            );
        }
    }
}
