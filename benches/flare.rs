//! Seconds per stage-1 epoch at the two sizes of the applications, and the speed of one matrix product beside it.
//!
//! `cargo bench --bench flare`. Both sizes train exactly the published loss and networks (no linear path), so the seconds
//! compare with any other implementation of it: sequences × 60 samples, window 3, hidden 128-128, RK4, Adam.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use flare_pipe::flare::{Case, PretrainSettings, pretrain};
use flare_pipe::numerics::random::stream;
use flare_pipe::progress::Quiet;
use rand::RngExt;
use std::f32::consts::TAU;
use std::time::Instant;

/// Smooth signals of six sources seen through a random nonlinear map.
fn cases(n_case: usize, n_step: usize, channels: usize) -> Vec<Case> {
    let mut random = stream(0, "bench");
    let mix: Vec<f32> = (0..6 * channels).map(|_| random.random::<f32>() - 0.5).collect();
    (0..n_case)
        .map(|id| {
            let waves: Vec<(f32, f32)> =
                (0..6).map(|_| (0.5 + 3.0 * random.random::<f32>(), TAU * random.random::<f32>())).collect();
            let source = |t: f32| waves.iter().map(move |(f, phase)| (TAU * f * t * 0.02 + phase).sin());
            let channel = |t: usize, c: usize| {
                source(t as f32).enumerate().map(|(k, s)| s * mix[k * channels + c]).sum::<f32>().tanh()
            };
            Case {
                id: id.to_string(),
                u: (0..n_step).map(|t| source(t as f32).next().unwrap_or(0.0)).collect(),
                u_half: (0..n_step - 1).map(|t| source(t as f32 + 0.5).next().unwrap_or(0.0)).collect(),
                dense: (0..n_step)
                    .flat_map(|t| (0..channels).map(move |c| (t, c)))
                    .map(|(t, c)| channel(t, c))
                    .collect(),
                sparse: vec![0.0; n_step],
            }
        })
        .collect()
}

/// Seconds of one epoch: the difference between a long and a short training, the best of three.
fn epoch_s(cases: &[Case], settings: &PretrainSettings, threads: usize) -> f64 {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("thread pool");
    let validation = [Case { id: "v".into(), ..cases[0].clone() }];
    let time = |epochs: usize| {
        let settings = PretrainSettings { epochs, ..settings.clone() };
        let start = Instant::now();
        pool.install(|| pretrain(cases, &validation, &settings, 0, None, &Quiet)).expect("trains");
        start.elapsed().as_secs_f64()
    };
    (0..3).map(|_| (time(5) - time(1)) / 4.0).fold(f64::INFINITY, f64::min)
}

/// GFLOP/s of the encoder's first product on one thread.
fn product_gflop_s(rows: usize, from: usize, to: usize) -> f64 {
    let a = Mat::<f32>::from_fn(rows, from, |i, j| ((i * 7 + j * 3) % 11) as f32);
    let b = Mat::<f32>::from_fn(from, to, |i, j| ((i * 5 + j) % 13) as f32);
    let mut c = Mat::<f32>::zeros(rows, to);
    let mut best = f64::INFINITY;
    for _ in 0..50 {
        let start = Instant::now();
        matmul(&mut c, Accum::Replace, &a, &b, 1.0, Par::Seq);
        best = best.min(start.elapsed().as_secs_f64());
    }
    2.0 * (rows * from * to) as f64 / best / 1e9
}

fn main() {
    println!("product 480×600×128: {:.0} GFLOP/s on one thread", product_gflop_s(480, 600, 128));
    for (n_case, segments, channels, latent) in [(80, 10, 200, 8), (80, 5, 100, 14)] {
        let n_step = segments * 60 + 2;
        let cases = cases(n_case, n_step, channels);
        for batch in [32, 64] {
            let base = PretrainSettings { window: 3, latent, channels, segments, batch, ..Default::default() };
            let settings = PretrainSettings {
                threshold_every: 0,
                validate_every: 1000,
                stress_factor: 1.0,
                state_bound: 1e6,
                batch,
                ..base.as_published()
            };
            for threads in [1, 2] {
                let seconds = epoch_s(&cases, &settings, threads);
                println!(
                    "{} × 60 × {channels}, r = {latent}, batch {batch}, {threads} threads: {seconds:.3} s/epoch",
                    n_case * segments
                );
            }
        }
    }
}
