//! The undrained 0.02 g column against the independent one.

use crate::reference::columns;
use crate::support::{layer, lotung, peak, profile, rayleigh, relative_rms, shake};
use flare_pipe::column::{Analysis, Profile};
use std::time::Instant;

/// The reference's column: four velocities, G₀ as given there, uniform elements.
pub fn reference_profile() -> Profile {
    let h = 0.085;
    let soil = |count: f64, vs: f64, g_0: f64| {
        layer(count * h, 1900.0, vs, "sanisand", &format!("g_0 = {g_0}\np_t_in_moduli = false"))
    };
    let layers =
        vec![soil(24.0, 120.0, 364.9), soil(47.0, 140.0, 296.9), soil(58.0, 165.0, 294.2), soil(71.0, 190.0, 308.4)];
    profile(layers, 200, 0.6, rayleigh(0.01, 1.0, 10.0))
}

#[test]
fn weak_motion_column_agrees_with_the_independent_one() {
    let (Some(base), Some(reference)) = (columns("base_motion_pga020.csv"), columns("col_pt005_pga020_acc.csv")) else {
        return;
    };
    let start = Instant::now();
    let (rows, summary) = shake(&reference_profile(), &Analysis::default(), 0.005, &base[1]);
    println!("{summary:?} in {:.3} s", start.elapsed().as_secs_f64());
    let at = |k: usize| -> Vec<f64> { rows[1..=reference[0].len()].iter().map(|r| r[k]).collect() };
    let between = |a: Vec<f64>, b: Vec<f64>| -> Vec<f64> { a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect() };
    for (name, ours, theirs) in [
        ("surface", at(0), &reference[2]),
        ("6.035 m", between(at(71), at(72)), &reference[3]),
        ("10.965 m", between(at(129), at(130)), &reference[4]),
    ] {
        let miss = relative_rms(&ours, theirs);
        println!(
            "{name}: peak {:.4} g against {:.4} g, relative rms difference {:.4}",
            peak(&ours) / 9.81,
            peak(theirs) / 9.81,
            miss
        );
    }
}

#[test]
fn strong_motion_finishes() {
    let Some(base) = columns("base_motion_pga100.csv") else { return };
    for (name, profile) in [("reference", reference_profile()), ("lotung", lotung(200))] {
        let start = Instant::now();
        let (rows, summary) = shake(&profile, &Analysis::default(), 0.005, &base[1]);
        println!("{name}: {summary:?} in {:.3} s", start.elapsed().as_secs_f64());
        let surface: Vec<f64> = rows.iter().map(|r| r[0]).collect();
        println!("peak {:.4} g", peak(&surface) / 9.81);
    }
}
