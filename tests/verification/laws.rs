//! What every law owes: tangents that are derivatives, paths that do not depend on the step, no energy from cycles.

use flare_pipe::soil::{Increment, LAWS, Law, Point, Response};

/// A law from its kind and a TOML table.
pub fn build(kind: &str, table: &str) -> Box<dyn Law> {
    let entry = flare_pipe::registry::find("soil law", LAWS, kind).expect("registered");
    (entry.build)(table.parse().expect("TOML")).expect("valid parameters")
}

/// Repeats `increment` from the geostatic state; the last response and memory.
pub fn follow(law: &dyn Law, point: &Point, increment: Increment, times: usize) -> (Response, Vec<f64>) {
    let mut state = vec![0.0; law.n_state()];
    law.start(point, &mut state).expect("a start");
    let mut next = state.clone();
    let mut response = Response::default();
    for _ in 0..times {
        response = law.update(increment, &state, &mut next).expect("a response");
        std::mem::swap(&mut state, &mut next);
    }
    (response, state)
}

fn point() -> Point {
    Point { depth_m: 6.0, density_kg_m3: 1800.0, vs_m_s: 150.0, vertical_pa: 80e3, horizontal_pa: 48e3 }
}

const KINDS: [&str; 5] = ["elastic", "hyperbolic", "mohr_coulomb", "cam_clay", "sanisand"];

#[test]
fn every_registered_law_is_verified_here() {
    let names: Vec<&str> = LAWS.iter().map(|entry| entry.name).collect();
    assert!(names.iter().all(|name| KINDS.contains(name)), "{names:?}");
}

#[test]
fn tangent_is_the_derivative_of_stress_for_every_law() {
    for kind in KINDS {
        let law = build(kind, if kind == "sanisand" { "tolerance = 1e-9\nmax_substeps = 100000" } else { "" });
        for (times, step) in [(3, 1e-5), (200, 2e-5), (300, -3e-5)] {
            let along = Increment::new(step, 1e-8);
            let (_, state) = follow(law.as_ref(), &point(), along, times);
            // SANISAND's tangent is the rate at the end of the increment: compared over a small one.
            let base = if kind == "sanisand" { Increment::new(0.01 * step, 1e-10) } else { along };
            let mut next = state.clone();
            let mut at = |i: Increment| law.update(i, &state, &mut next).expect("a response");
            let tangent = at(base).tangent_pa;
            let h = if kind == "sanisand" { 1e-9 } else { 1e-8 };
            let gamma = [-h, h].map(|d| at(Increment { gamma: base.gamma + d, ..base }));
            let eps = [-h, h].map(|d| at(Increment { eps_yy: base.eps_yy + d, ..base }));
            let slope = |a: f64, b: f64| (b - a) / (2.0 * h);
            let numeric = [
                slope(gamma[0].tau_pa, gamma[1].tau_pa),
                slope(eps[0].tau_pa, eps[1].tau_pa),
                slope(gamma[0].sigma_yy_pa, gamma[1].sigma_yy_pa),
                slope(eps[0].sigma_yy_pa, eps[1].sigma_yy_pa),
            ];
            let scale = tangent[3];
            let miss = tangent.iter().zip(numeric).map(|(a, b)| (a - b).abs() / scale).fold(0.0, f64::max);
            println!("{kind} after {times} × {step:e}: tangent within {miss:.1e} of M");
            assert!(miss < if kind == "sanisand" { 2e-2 } else { 1e-4 }, "{kind}: {tangent:?} against {numeric:?}");
        }
    }
}

#[test]
fn closed_cycles_create_no_energy() {
    for kind in KINDS {
        let law = build(kind, "");
        for amplitude in [1e-5, 1e-4, 1e-3] {
            let mut state = vec![0.0; law.n_state()];
            law.start(&point(), &mut state).expect("a start");
            let mut next = state.clone();
            let (mut work, mut last_tau, mut largest) = (0.0, 0.0, 0.0_f64);
            let n = 400;
            for k in 1..=5 * n {
                let phase = |k: usize| amplitude * (std::f64::consts::TAU * k as f64 / n as f64).sin();
                let d = phase(k) - phase(k - 1);
                let response = law.update(Increment::new(d, 0.0), &state, &mut next).expect("a response");
                work += 0.5 * (last_tau + response.tau_pa) * d;
                last_tau = response.tau_pa;
                largest = largest.max(response.tau_pa.abs());
                std::mem::swap(&mut state, &mut next);
            }
            assert!(work > -1e-6 * largest * amplitude, "{kind} at {amplitude:e}: {work:e} J/m³");
        }
    }
}

#[test]
fn paths_do_not_depend_on_the_step() {
    for kind in KINDS {
        let law = build(kind, "");
        let end = |pieces: usize| {
            let up = Increment::new(1e-3 / pieces as f64, -1e-6 / pieces as f64);
            follow(law.as_ref(), &point(), up, pieces).0.tau_pa
        };
        let (coarse, fine) = (end(20), end(2000));
        println!("{kind}: 20 against 2000 increments {:.2e}", coarse / fine - 1.0);
        assert!((coarse / fine - 1.0).abs() < 5e-3, "{kind}");
    }
}

#[test]
fn cyclic_paths_do_not_depend_on_the_step() {
    // Triangles of ±0.05 % whose corners every step size meets.
    for kind in KINDS {
        let law = build(kind, "");
        let end = |pieces: usize| {
            let mut state = vec![0.0; law.n_state()];
            law.start(&point(), &mut state).expect("a start");
            let mut next = state.clone();
            let mut taus = Vec::new();
            for (quarters, sign) in [(1, 1.0), (2, -1.0), (2, 1.0), (2, -1.0), (2, 1.0)] {
                for _ in 0..quarters * pieces {
                    let step = Increment::new(sign * 5e-4 / pieces as f64, 0.0);
                    taus.push(law.update(step, &state, &mut next).expect("a response").tau_pa);
                    std::mem::swap(&mut state, &mut next);
                }
            }
            taus.into_iter().skip(pieces - 1).step_by(pieces).collect::<Vec<f64>>()
        };
        let (coarse, fine) = (end(10), end(1000));
        let miss = crate::support::relative_rms(&coarse, &fine);
        println!("{kind}: 10 against 1000 increments a quarter cycle {miss:.2e}");
        assert!(miss < 1e-2, "{kind}: {coarse:?} {fine:?}");
    }
}
