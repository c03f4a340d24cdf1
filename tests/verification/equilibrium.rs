//! Rest, weight and energy.

use crate::support::{layer, lotung, profile, shake};
use flare_pipe::column::{Analysis, Column, Rayleigh};

#[test]
fn a_column_at_rest_stays_at_rest_to_round_off() {
    let (rows, _) = shake(&lotung(200), &Analysis::default(), 0.005, &[0.0; 200]);
    assert!(rows.iter().flatten().all(|a| *a == 0.0));
}

#[test]
fn geostatic_stress_carries_the_buoyant_weight() {
    let column = Column::new(&lotung(200), &Analysis::default()).expect("a column");
    let stress = column.vertical_effective_stress_pa();
    let depths = column.channel_depths_m();
    let weight = |z: f64| -> f64 {
        (0..17).map(|i| (2065.0 - 7.5 * i as f64) * (z - i as f64).clamp(0.0, 1.0)).sum::<f64>()
            - 1000.0 * (z - 0.6).max(0.0)
    };
    for (z, s) in depths.iter().zip(stress) {
        assert!((s - 9.806_65 * weight(*z)).abs() < 1e-6 * s.abs().max(1.0), "{z} m: {s}");
    }
}

#[test]
fn lotung_elastic_constants_cover_the_published_range() {
    let column = Column::new(&lotung(200), &Analysis::default()).expect("a column");
    let g_0: Vec<f64> = column
        .shear_modulus_pa()
        .iter()
        .zip(column.vertical_effective_stress_pa())
        .map(|(g, v)| g / (1e5 * (2.97_f64 - 0.86).powi(2) / 1.86 * ((v * 2.0 / 3.0 + 5e3) / 1e5).sqrt()))
        .collect();
    let (low, high) = g_0.iter().fold((f64::MAX, 0.0_f64), |(l, h), g| (l.min(*g), h.max(*g)));
    println!("Lotung G0 {low:.2}…{high:.2}, published 266.99…430.82");
    assert!((low / 266.99 - 1.0).abs() < 0.05 && (high / 430.82 - 1.0).abs() < 0.05);
}

#[test]
fn energy_in_equals_energy_stored_without_damping() {
    let n = 20;
    let profile = profile(vec![layer(10.0, 2000.0, 150.0, "elastic", "")], n, 1e3, Rayleigh::default());
    let dt = 0.005;
    let (hht_alpha, max_jump) = (0.0, f64::INFINITY);
    let analysis =
        Analysis { hht_alpha, max_jump, initial_step_s: dt, max_step_s: dt, tolerance: 1e-11, ..Analysis::default() };
    let base: Vec<f64> = (0..800).map(|k| (k as f64 * dt * 12.0).sin() * (-(k as f64) * dt).exp()).collect();
    let column = Column::new(&profile, &analysis).expect("a column");
    let (h, g) = (0.5, 2000.0 * 150.0 * 150.0);
    let mass: Vec<f64> = (0..n).map(|i| if i == 0 { 500.0 } else { 1000.0 }).collect();
    let mut velocity = vec![0.0; n];
    let mut acceleration: Vec<f64> = Vec::new();
    let (mut last_base, mut input, mut worst, mut largest) = (0.0, 0.0, 0.0_f64, 0.0_f64);
    column
        .run(dt, &base, &mut |frame| {
            // Node accelerations relative to the base, from the element means, bottom up.
            let mut now = vec![0.0; n];
            let mut below = 0.0;
            for i in (0..n).rev() {
                now[i] = 2.0 * (frame.elements_m_s2[i] - frame.base_m_s2) - below;
                below = now[i];
            }
            if !acceleration.is_empty() {
                for i in 0..n {
                    let next = velocity[i] + 0.5 * dt * (acceleration[i] + now[i]);
                    let move_m = 0.5 * dt * (velocity[i] + next);
                    input -= mass[i] * 0.5 * (last_base + frame.base_m_s2) * move_m;
                    velocity[i] = next;
                }
            }
            last_base = frame.base_m_s2;
            acceleration = now;
            let kinetic: f64 = mass.iter().zip(&velocity).map(|(m, v)| 0.5 * m * v * v).sum();
            let strain: f64 = frame.gamma.iter().map(|gamma| 0.5 * g * gamma * gamma * h).sum();
            worst = worst.max((kinetic + strain - input).abs());
            largest = largest.max(kinetic + strain);
            Ok(())
        })
        .expect("a run");
    println!("energy balance within {:.1e} of the largest energy", worst / largest);
    assert!(worst < 1e-7 * largest);
}
