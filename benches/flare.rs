//! Seconds per stage-1 epoch at the two sizes of the applications, and how much of the processor its matrix products use.
//!
//! `cargo bench --bench flare`, with `-- --json` one JSON object a line for scripts (`benches/torch.sh` compares them with
//! PyTorch). Both sizes train exactly the published loss and networks (no linear path), so the seconds
//! compare with any other implementation of it: sequences × 60 samples, window 3, hidden 128-128, RK4, Adam.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, Par};
use flare_pipe::flare::{Case, PretrainSettings, Training, pretrain};
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
                sparse: vec![0.0; n_step].into(),
            }
        })
        .collect()
}

/// Wall and processor seconds of one epoch: the difference between a long and a short training, the best of three.
fn epoch_s(cases: &[Case], settings: &PretrainSettings, threads: usize) -> (f64, f64) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("thread pool");
    let validation = [Case { id: "v".into(), ..cases[0].clone() }];
    let time = |epochs: usize| {
        let settings = PretrainSettings { epochs, ..settings.clone() };
        let (start, busy) = (Instant::now(), processor_s());
        pool.install(|| pretrain(cases, &validation, &settings, 0, &Training::in_memory(&Quiet))).expect("trains");
        (start.elapsed().as_secs_f64(), processor_s() - busy)
    };
    let once = || {
        let (long, short) = (time(7), time(1));
        ((long.0 - short.0) / 6.0, (long.1 - short.1) / 6.0)
    };
    (0..3).map(|_| once()).fold((f64::INFINITY, f64::INFINITY), |best, now| (best.0.min(now.0), best.1.min(now.1)))
}

/// Processor seconds this process has used, where the system tells (to a hundredth of a second).
fn processor_s() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = text.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    fields.iter().skip(11).take(2).filter_map(|f| f.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// GFLOP/s of `rows × from` by `from × to` on one thread.
fn product_gflop_s(rows: usize, from: usize, to: usize) -> f64 {
    let a = Mat::<f32>::from_fn(rows, from, |i, j| ((i * 7 + j * 3) % 11) as f32);
    let b = Mat::<f32>::from_fn(from, to, |i, j| ((i * 5 + j) % 13) as f32);
    let mut c = Mat::<f32>::zeros(rows, to);
    let mut best = f64::INFINITY;
    for _ in 0..30 {
        let start = Instant::now();
        matmul(&mut c, Accum::Replace, &a, &b, 1.0, Par::Seq);
        best = best.min(start.elapsed().as_secs_f64());
    }
    2.0 * (rows * from * to) as f64 / best / 1e9
}

/// GFLOP/s of the products of a training step on one thread, each at the sizes of a chunk of eight segments.
fn products_gflop_s(channels: usize, latent: usize) -> f64 {
    let rows = 8 * 60;
    let encoder = [3 * channels, 128, 128, latent];
    let decoder = [latent, 128, 128, channels];
    let (mut work, mut seconds) = (0.0, 0.0);
    for (rows, widths, is_first_free) in [(rows, encoder, true), (2 * rows, decoder, false)] {
        for (i, w) in widths.windows(2).enumerate() {
            let flop = 2.0 * (rows * w[0] * w[1]) as f64;
            // forward, derivative by the weights, derivative by the input (not of the windows)
            let shapes = [(rows, w[0], w[1]), (w[1], rows, w[0]), (rows, w[1], w[0])];
            for (m, k, n) in shapes.into_iter().take(if i == 0 && is_first_free { 2 } else { 3 }) {
                work += flop;
                seconds += flop / product_gflop_s(m, k, n);
            }
        }
    }
    work / seconds
}

/// Chains of multiply-adds that stay in registers.
const N_CHAIN: usize = 192;

/// GFLOP/s of fused multiply-adds of the widest vectors this processor has, on one core.
fn peak_gflop_s() -> f64 {
    #[cfg(target_arch = "x86_64")]
    {
        let is = (std::arch::is_x86_feature_detected!("avx512f"), std::arch::is_x86_feature_detected!("fma"));
        // SAFETY: the features were detected on this processor.
        let wide = if is.0 { best_gflop_s(|sums, n| unsafe { chains_512(sums, n) }) } else { f64::NAN };
        let narrow = if is.1 { best_gflop_s(|sums, n| unsafe { chains_256(sums, n) }) } else { f64::NAN };
        wide.max(narrow)
    }
    #[cfg(not(target_arch = "x86_64"))]
    f64::NAN
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
fn chains_512(sums: &mut [f32; N_CHAIN], rounds: usize) {
    chains(sums, rounds);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn chains_256(sums: &mut [f32; N_CHAIN], rounds: usize) {
    // half of the chains fill the sixteen registers of this width
    for half in sums.chunks_exact_mut(N_CHAIN / 2) {
        let mut own: [f32; N_CHAIN / 2] = std::array::from_fn(|i| half[i]);
        for _ in 0..rounds {
            own.iter_mut().for_each(|s| *s = s.mul_add(0.999_9, 1e-3));
        }
        half.copy_from_slice(&own);
    }
}

#[inline(always)]
fn chains(sums: &mut [f32; N_CHAIN], rounds: usize) {
    for _ in 0..rounds {
        sums.iter_mut().for_each(|s| *s = s.mul_add(0.999_9, 1e-3));
    }
}

fn best_gflop_s(work: impl Fn(&mut [f32; N_CHAIN], usize)) -> f64 {
    let mut sums: [f32; N_CHAIN] = std::array::from_fn(|i| i as f32);
    let rounds = 1_000_000;
    let mut best = f64::INFINITY;
    for _ in 0..10 {
        let start = Instant::now();
        work(&mut sums, rounds);
        best = best.min(start.elapsed().as_secs_f64());
    }
    assert!(std::hint::black_box(sums).iter().all(|s| s.is_finite()));
    2.0 * (N_CHAIN * rounds) as f64 / best / 1e9
}

fn main() {
    let is_json = std::env::args().any(|a| a == "--json");
    let peak = peak_gflop_s();
    if !is_json {
        println!("peak of one core {peak:.0} GFLOP/s, multiply-adds of its widest vectors");
    }
    for (n_case, segments, channels, latent) in [(80, 10, 200, 8), (80, 5, 100, 14)] {
        let n_step = segments * 60 + 2;
        let cases = cases(n_case, n_step, channels);
        let sequences = n_case * segments;
        let product_share = products_gflop_s(channels, latent) / peak;
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
                let (wall_s, busy_s) = epoch_s(&cases, &settings, threads);
                if is_json {
                    println!(
                        "{{\"sequences\": {sequences}, \"channels\": {channels}, \"latent\": {latent}, \"batch\": {batch}, \
                         \"threads\": {threads}, \"wall_min\": {wall_s}, \"user_min\": {busy_s}, \
                         \"product_share\": {product_share}}}"
                    );
                } else {
                    println!(
                        "{sequences} × 60 × {channels}, r = {latent}, batch {batch}, {threads} threads: {wall_s:.3} s/epoch, \
                         {busy_s:.3} processor s; products at {:.0} % of the peak",
                        100.0 * product_share
                    );
                }
            }
        }
    }
}
