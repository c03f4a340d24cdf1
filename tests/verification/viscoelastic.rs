//! Small-strain damping by memory of the stress: the complex modulus as stepped, a column against its exact transfer
//! function, the difference to programs without dispersion, and what happens beside hysteresis.

use crate::laws::build;
use crate::support::{layer, profile, shake};
use crate::transfer_function::{Complex, analysis, div, exact_with, pulse, transform};
use flare_pipe::column::{Profile, Rayleigh};
use flare_pipe::soil::{Damping, Increment, Law, Point, REFERENCE_HZ, Relaxation, Viscoelastic};
use std::f64::consts::TAU;

fn point() -> Point {
    Point { depth_m: 6.0, density_kg_m3: 1800.0, vs_m_s: 150.0, vertical_pa: 80e3, horizontal_pa: 48e3 }
}

/// Complex modulus over ρVs² of `law`, driven by a sinusoid of `gamma`, one of so many steps, over the last cycles.
fn driven(law: &dyn Law, gamma: f64, dt_s: f64, steps: usize) -> Complex {
    let mut state = vec![0.0; law.n_state()];
    law.start(&point(), &mut state).expect("a start");
    let mut next = state.clone();
    // The slowest spring relaxes in 4 s.
    let settle = (40.0 / (steps as f64 * dt_s)).ceil() as usize;
    let measured = 1 + 100 / steps;
    let mut sums = [0.0; 2];
    let mut last = 0.0;
    for k in 1..=(settle + measured) * steps {
        let (s, c) = (TAU * k as f64 / steps as f64).sin_cos();
        let strain = gamma * s;
        let increment = Increment { gamma: strain - last, eps_yy: 0.0, dt_s };
        let tau = law.update(increment, &state, &mut next).expect("a response").tau_pa;
        std::mem::swap(&mut state, &mut next);
        last = strain;
        if k > settle * steps {
            sums = [sums[0] + tau * s, sums[1] + tau * c];
        }
    }
    sums.map(|x| x / (0.5 * gamma * (measured * steps) as f64 * point().shear_modulus_pa()))
}

fn viscoelastic(kind: &str, table: &str) -> Viscoelastic {
    Viscoelastic::new(build(kind, table))
}

#[test]
fn damping_as_stepped_is_the_declared_one_from_a_tenth_to_25_hertz() {
    for dt_s in [0.005, 0.002] {
        for ratio in [0.005, 0.03, 0.1] {
            let law = viscoelastic("elastic", &format!("damping_ratio = {ratio}"));
            let mut worst: f64 = 0.0;
            for f in [0.1, 0.17, 0.3, 0.5, 0.8, 1.0, 1.5, 2.2, 3.0, 4.5, 6.0, 8.0, 10.0, 12.5, 15.4, 20.0, 25.0] {
                let [re, im] = driven(&law, 1e-5, dt_s, (1.0 / (f * dt_s)).round() as usize);
                worst = worst.max((0.5 * im / re / ratio - 1.0).abs());
            }
            println!("step {dt_s} s, ratio {ratio}: damping within {:.2} % over 0.1…25 Hz", 100.0 * worst);
            assert!(worst < 0.02);
        }
    }
}

/// Layers of 3 % on a rigid base, the upper one of 5 %.
fn column(kind: &str) -> Profile {
    let damping = |ratio: f64| format!("damping_ratio = {ratio}");
    let layers =
        vec![layer(6.0, 1800.0, 120.0, kind, &damping(0.05)), layer(14.0, 2000.0, 220.0, kind, &damping(0.03))];
    profile(layers, 320, 1e3, Rayleigh::default())
}

fn ratio_of(layer: &flare_pipe::column::Layer) -> f64 {
    layer.law["damping_ratio"].as_float().expect("a number")
}

fn causal(profile: &Profile, f: f64) -> Complex {
    exact_with(profile, f, |l| Relaxation::new(ratio_of(l), 0.0).modulus(f))
}

fn without_dispersion(profile: &Profile, f: f64) -> Complex {
    exact_with(profile, f, |l| [1.0, 2.0 * ratio_of(l)])
}

fn size(a: Complex) -> f64 {
    a[0].hypot(a[1])
}

/// Frequencies and heights of the first four peaks of a transfer function.
fn peaks(h: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
    let at = |k: u32| 0.005 * f64::from(k);
    let is_peak = |k: &u32| h(at(*k)) > h(at(k - 1)) && h(at(*k)) > h(at(k + 1));
    (40..4000).filter(is_peak).take(4).map(|k| (at(k), h(at(k)))).collect()
}

#[test]
fn a_column_has_the_first_four_peaks_of_the_exact_one_with_its_complex_modulus() {
    let profile = column("elastic");
    let dt_s = 0.0005;
    let base = pulse(dt_s, 30.0, 5.0);
    let (rows, summary) = shake(&profile, &analysis(dt_s), dt_s, &base);
    let surface: Vec<f64> = rows.iter().map(|r| r[0]).collect();
    assert_eq!(summary.newton_iterations, summary.steps, "a linear column needs one iteration a step");
    let peaks = peaks(|f| size(causal(&profile, f)));
    assert_eq!(peaks.len(), 4);
    for (f, height) in peaks {
        let ours = div(transform(&surface, dt_s, f), transform(&base, dt_s, f));
        let truth = causal(&profile, f);
        let miss = size([ours[0] - truth[0], ours[1] - truth[1]]) / height;
        println!(
            "peak at {f:.2} Hz: amplification {:.3}, exact {height:.3}, complex miss {:.2} %",
            size(ours),
            100.0 * miss
        );
        assert!((size(ours) / height - 1.0).abs() < 0.003 && miss < 0.01);
    }
}

#[test]
fn the_difference_to_programs_without_dispersion_is_the_stated_one() {
    let profile = column("elastic");
    let pairs = peaks(|f| size(causal(&profile, f))).into_iter().zip(peaks(|f| size(without_dispersion(&profile, f))));
    for ((f, height), (flat_hz, flat)) in pairs {
        println!(
            "peak {f:.3} Hz × {height:.3}; G(1 + 2iξ): {flat_hz:.3} Hz × {flat:.3}; {:+.1} % in frequency, {:+.1} % in height",
            100.0 * (f / flat_hz - 1.0),
            100.0 * (height / flat - 1.0)
        );
        // 2ξ/π ln(f/f_r) of velocity, ξ between those of the two layers, and heights within a few per cent.
        let per_ratio = (f / flat_hz - 1.0) / (2.0 / std::f64::consts::PI * (f / REFERENCE_HZ).ln());
        assert!((0.025..0.055).contains(&per_ratio), "{per_ratio}");
        assert!((height / flat - 1.0).abs() < 0.03);
    }
}

#[test]
fn beside_hysteresis_damping_is_added_and_the_secant_modulus_is_kept() {
    // At the reference frequency; the loop of the law alone, then with 4 % beside it.
    let steps = (1.0 / (REFERENCE_HZ * 0.002)).round() as usize;
    for gamma in [1e-5, 3e-4, 3e-3] {
        let plain = driven(build("hyperbolic", "damping_ratio = 0.0").as_ref(), gamma, 0.002, steps);
        let damped = driven(&viscoelastic("hyperbolic", "damping_ratio = 0.04"), gamma, 0.002, steps);
        let d = |k: Complex| 0.5 * k[1] / k[0];
        println!(
            "strain {gamma}: secant {:.4} and {:.4}, damping {:.4} and {:.4}",
            plain[0],
            damped[0],
            d(plain),
            d(damped)
        );
        // (1 + 2iD)(1 + 2iξ) = 1 − 4Dξ + 2i(D + ξ): secants differ by 4Dξ.
        let expected = (d(plain) + 0.04) / (1.0 - 4.0 * d(plain) * 0.04);
        assert!((d(damped) / expected - 1.0).abs() < 0.02);
        assert!((damped[0] / plain[0] - (1.0 - 4.0 * d(plain) * 0.04)).abs() < 0.01);
    }
}

#[test]
fn stress_stays_within_the_strength_but_for_a_share_of_about_the_damping_ratio() {
    // A sinusoid of 5 % at the reference frequency, far beyond the reference strain.
    let largest = |law: &dyn Law| {
        let mut state = vec![0.0; law.n_state()];
        law.start(&point(), &mut state).expect("a start");
        let mut next = state.clone();
        let (mut largest, mut last) = (0.0f64, 0.0);
        for k in 1..=3000 {
            let gamma = 0.05 * (TAU * REFERENCE_HZ * 0.002 * f64::from(k)).sin();
            let increment = Increment { gamma: gamma - last, eps_yy: 0.0, dt_s: 0.002 };
            largest = largest.max(law.update(increment, &state, &mut next).expect("a response").tau_pa);
            std::mem::swap(&mut state, &mut next);
            last = gamma;
        }
        largest
    };
    let table = |ratio: f64| format!("damping_ratio = {ratio}\ncurvature = 1.0");
    let plain = largest(build("hyperbolic", &table(0.0)).as_ref());
    let damped = largest(&viscoelastic("hyperbolic", &table(0.03)));
    println!("largest stress {damped:.0} Pa with 3 %, {plain:.0} Pa without");
    assert!((damped / plain - 1.0).abs() < 0.06);
}

#[test]
fn a_law_without_damping_is_itself_and_tangents_are_derivatives() {
    assert_eq!(Damping::Memory { ratio: 0.0, exponent: 0.3 }.relaxation(), None);
    let law = viscoelastic("hyperbolic", "damping_ratio = 0.05");
    let mut state = vec![0.0; law.n_state()];
    law.start(&point(), &mut state).expect("a start");
    let mut next = state.clone();
    for k in 0..60 {
        let increment = Increment { gamma: 2e-5 * (0.2 * f64::from(k)).cos(), eps_yy: 1e-6, dt_s: 0.005 };
        law.update(increment, &state, &mut next).expect("a response");
        std::mem::swap(&mut state, &mut next);
    }
    let mut at = |gamma: f64, eps_yy: f64| {
        law.update(Increment { gamma, eps_yy, dt_s: 0.003 }, &state, &mut next).expect("a response")
    };
    let tangent = at(1e-5, 1e-6).tangent_pa;
    let h = 1e-8;
    let shear = (at(1e-5 + h, 1e-6).tau_pa - at(1e-5 - h, 1e-6).tau_pa) / (2.0 * h);
    let vertical = (at(1e-5, 1e-6 + h).sigma_yy_pa - at(1e-5, 1e-6 - h).sigma_yy_pa) / (2.0 * h);
    assert!((shear / tangent[0] - 1.0).abs() < 1e-4 && (vertical / tangent[3] - 1.0).abs() < 1e-4);
}

/// Time of a run over that of the same one with Rayleigh damping; best of a few, interleaved.
#[test]
#[ignore = "a measurement: cargo test --release --test verification cost_of -- --ignored --nocapture"]
fn cost_of_memory_over_that_of_rayleigh_damping() {
    for (kind, table) in [("elastic", "damping_ratio = 0.02"), ("hyperbolic", "damping_ratio = 0.02")] {
        let layers = |law: &str| vec![layer(6.0, 1800.0, 120.0, kind, law), layer(14.0, 2000.0, 220.0, kind, law)];
        let rayleigh = crate::support::rayleigh(0.02, 2.6, 13.0);
        let profiles = [
            profile(layers("damping_ratio = 0.0"), 200, 1e3, rayleigh),
            profile(layers(table), 200, 1e3, Rayleigh::default()),
        ];
        let base: Vec<f64> = pulse(0.005, 20.0, 2.0).iter().map(|a| 10.0 * a).collect();
        let mut best = [f64::INFINITY; 2];
        let mut work = [(0, 0); 2];
        for _ in 0..7 {
            for (k, profile) in profiles.iter().enumerate() {
                let start = std::time::Instant::now();
                let (_, summary) = shake(profile, &flare_pipe::column::Analysis::default(), 0.005, &base);
                best[k] = best[k].min(start.elapsed().as_secs_f64() / summary.steps as f64);
                work[k] = (summary.steps, summary.newton_iterations);
            }
        }
        println!("{kind}: a step costs {:.2} times as much; steps and iterations {work:?}", best[1] / best[0]);
    }
}
