//! CPU time of one 15 s undrained Lotung motion, weak and strong, over the number of elements.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use flare_pipe::column::{Analysis, Column, Features, Layer, Profile, Rayleigh, Vertical};

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
        law_kind: "sanisand".into(),
        law: toml::Table::new(),
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

/// A chirp from 0.5 to 8 Hz under an envelope, 15 s.
fn motion(pga_g: f64) -> Vec<f64> {
    (0..=3000)
        .map(|k| {
            let t = f64::from(k) * 0.005;
            let envelope = (t / 4.0) * (1.0 - t / 4.0).exp();
            pga_g * 9.806_65 * envelope * (std::f64::consts::TAU * (0.5 + 0.25 * t) * t).sin()
        })
        .collect()
}

fn column(c: &mut Criterion) {
    let mut group = c.benchmark_group("lotung_15s");
    group.sample_size(10);
    for (elements, pga_g) in [(100, 0.02), (200, 0.02), (400, 0.02), (200, 0.1)] {
        let column = lotung(elements);
        let base = motion(pga_g);
        group.bench_function(BenchmarkId::new(format!("{pga_g}g"), elements), |b| {
            b.iter(|| column.run(0.005, &base, &mut |_| Ok(())).map_err(|failure| failure.to_string()));
        });
    }
    group.finish();
}

criterion_group!(benches, column);
criterion_main!(benches);
