//! Profiles and runs that several verifications share.

use flare_pipe::column::{Analysis, Column, Features, Layer, Profile, Rayleigh, RunSummary, Vertical};
use std::sync::Arc;

/// A layer with a law table written as TOML.
pub fn layer(thickness_m: f64, density_kg_m3: f64, vs_m_s: f64, law_kind: &str, law: &str) -> Layer {
    let law = Arc::new(law.parse().expect("a TOML table"));
    Layer { thickness_m, density_kg_m3, vs_m_s, k0: 0.5, fineness: 1.0, law_kind: law_kind.into(), law }
}

/// A profile of these layers.
pub fn profile(layers: Vec<Layer>, elements: usize, water_table_m: f64, rayleigh: Rayleigh) -> Profile {
    Profile { layers, water_table_m, vertical: Vertical::Free, rayleigh, elements, features: Features::default() }
}

/// α and β of Rayleigh damping with `ratio` at two frequencies.
pub fn rayleigh(ratio: f64, f1_hz: f64, f2_hz: f64) -> Rayleigh {
    let (w1, w2) = (std::f64::consts::TAU * f1_hz, std::f64::consts::TAU * f2_hz);
    Rayleigh { alpha_1_s: 2.0 * ratio * w1 * w2 / (w1 + w2), beta_s: 2.0 * ratio / (w1 + w2) }
}

/// The published Lotung profile under SANISAND.
pub fn lotung(elements: usize) -> Profile {
    let vs = [
        110.0, 118.8, 127.1, 134.9, 142.4, 149.5, 156.3, 163.0, 169.3, 175.6, 181.6, 187.5, 193.2, 198.9, 204.4, 209.8,
        215.1,
    ];
    let layers =
        vs.iter().enumerate().map(|(i, vs)| layer(1.0, 2065.0 - 7.5 * i as f64, *vs, "sanisand", "")).collect();
    profile(layers, elements, 0.6, Rayleigh::default())
}

/// Accelerations of a run: per output time, surface first and then the elements, and the work done.
pub fn shake(profile: &Profile, analysis: &Analysis, dt_s: f64, base: &[f64]) -> (Vec<Vec<f64>>, RunSummary) {
    let column = Column::new(profile, analysis).expect("a column");
    let mut rows = Vec::new();
    let summary = column
        .run(dt_s, base, &mut |frame| {
            let mut row = vec![frame.surface_m_s2()];
            row.extend_from_slice(frame.elements_m_s2);
            rows.push(row);
            Ok(())
        })
        .unwrap_or_else(|failure| panic!("{failure}"));
    (rows, summary)
}

/// √(Σ(a−b)²/Σb²).
pub fn relative_rms(a: &[f64], b: &[f64]) -> f64 {
    let miss: f64 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
    (miss / b.iter().map(|b| b * b).sum::<f64>()).sqrt()
}

/// Largest absolute value.
pub fn peak(x: &[f64]) -> f64 {
    x.iter().fold(0.0, |m, x| m.max(x.abs()))
}
