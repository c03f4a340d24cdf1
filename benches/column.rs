//! CPU time of one undrained Lotung motion, weak and strong, over the number of elements and its length; and of the
//! parts: law evaluations and the solution of the equations.
//!
//! Measured on one core with 512-bit registers, 200 elements, motions of 15 s with content to 10 Hz:
//!
//! | motion | steps | iterations | CPU s | stress update | solve | residual | assembly | correction | step control, frames |
//! |--------|------:|-----------:|------:|--------------:|------:|---------:|---------:|-----------:|------:|
//! | 0.02 g | 3261  | 4686       | 0.12  | 59 % | 15 % | 14 % | 4 % | 2 % | 3 % |
//! | 0.10 g | 4258  | 7918       | 0.47  | 81 % | 7 %  | 7 %  | 2 % | 1 % | 1 % |
//!
//! Elements cost the same however many there are: 50, 100, 200, 400, 800 elements take 0.037, 0.070, 0.133, 0.277,
//! 0.560 s (weak) and 0.133, 0.257, 0.520, 1.017, 1.993 s (strong). They did not before SANISAND had its trace of
//! viscosity: undamped fronts steepen with the mesh, and 400 elements then took 3.3 times as long as 200, in cuts.
//!
//! The floor of this design is one stress update, residual, assembly and solution a step: 3000 steps × 200 elements ×
//! 120 ns (weak, few substeps) or 280 ns (strong) = 0.07 or 0.17 s. What is above it: the second iteration that most
//! strong steps need, and steps shortened for acceleration fronts (a third of the strong motion's).

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use flare_pipe::column::{Analysis, Column, Features, Layer, Profile, Rayleigh, Vertical};
use flare_pipe::numerics::block_tridiagonal::BlockTridiagonal;
use flare_pipe::soil::{Increment, LAWS, Point, Response};

fn lotung(elements: usize) -> Column {
    let vs = [
        110.0, 118.8, 127.1, 134.9, 142.4, 149.5, 156.3, 163.0, 169.3, 175.6, 181.6, 187.5, 193.2, 198.9, 204.4, 209.8,
        215.1,
    ];
    let layers = vs.iter().enumerate().map(|(i, vs)| Layer {
        thickness_m: 1.0,
        density_kg_m3: 2065.0 - 7.5 * i as f64,
        vs_m_s: *vs,
        k0: 0.5,
        fineness: 1.0,
        law_kind: "sanisand".into(),
        law: Default::default(),
    });
    let profile = Profile {
        layers: layers.collect(),
        water_table_m: 0.6,
        vertical: Vertical::Free,
        rayleigh: Rayleigh::default(),
        elements,
        features: Features::default(),
    };
    Column::new(&profile, &Analysis::default()).expect("a column")
}

/// A chirp from 0.5 to 8 Hz in 15 s under an envelope, stretched to `duration_s`.
fn motion(pga_g: f64, duration_s: f64) -> Vec<f64> {
    (0..=(duration_s / 0.005) as u32)
        .map(|k| {
            let t = f64::from(k) * 0.005 * 15.0 / duration_s;
            let envelope = (t / 4.0) * (1.0 - t / 4.0).exp();
            pga_g * 9.806_65 * envelope * (std::f64::consts::TAU * (0.5 + 0.25 * t) * t).sin()
        })
        .collect()
}

fn column(c: &mut Criterion) {
    let mut group = c.benchmark_group("lotung");
    group.sample_size(10);
    for pga_g in [0.02, 0.1] {
        for (elements, duration_s) in [(100, 15.0), (200, 15.0), (400, 15.0), (800, 15.0), (200, 7.5), (200, 30.0)] {
            let column = lotung(elements);
            let base = motion(pga_g, duration_s);
            group.bench_function(BenchmarkId::new(format!("{pga_g}g_{duration_s}s"), elements), |b| {
                b.iter(|| column.run(0.005, &base, &mut |_| Ok(())).map_err(|failure| failure.to_string()));
            });
        }
    }
    group.finish();
}

/// One evaluation of 200 points by every law, at small and large increments of strain.
fn laws(c: &mut Criterion) {
    let mut group = c.benchmark_group("law_200_points");
    let n = 200;
    let point = |i: usize| Point {
        depth_m: 1.0 + 0.08 * i as f64,
        density_kg_m3: 2000.0,
        vs_m_s: 150.0,
        vertical_pa: 1e4 + 1e3 * i as f64,
        horizontal_pa: 5e3 + 5e2 * i as f64,
    };
    let points: Vec<Point> = (0..n).map(point).collect();
    for entry in LAWS {
        let law = (entry.build)(toml::Table::new()).expect("defaults");
        for gamma in [1e-6, 3e-5] {
            let mut old = vec![0.0; n * law.n_state()];
            let mut elastic_pa = vec![[0.0; 4]; n];
            law.start_all(&points, &mut old, &mut elastic_pa).map_err(|(_, error)| error.to_string()).expect("a start");
            let (mut new, mut responses) = (old.clone(), vec![Response::default(); n]);
            let increments = vec![Increment::new(gamma, 0.0); n];
            group.bench_function(BenchmarkId::new(entry.name, gamma), |b| {
                b.iter(|| law.update_all(&increments, &old, &mut new, &mut responses));
            });
        }
    }
    group.finish();
}

/// One solution of the equations of 200 nodes.
fn solve(c: &mut Criterion) {
    let n = 200;
    let mut matrix = BlockTridiagonal::new(n);
    matrix.diagonal.fill([[4.0, 0.1], [0.1, 4.0]]);
    matrix.upper.fill([[-1.0, 0.0], [0.0, -1.0]]);
    matrix.lower.fill([[-1.0, 0.0], [0.0, -1.0]]);
    let mut x = vec![[1.0, 0.5]; n];
    c.bench_function("solve_200_nodes", |b| b.iter(|| matrix.solve(&mut x)));
}

criterion_group!(benches, column, laws, solve);
criterion_main!(benches);
