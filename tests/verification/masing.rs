//! The hyperbolic law: loop area in closed form, and closure of inner loops.

use crate::laws::build;
use flare_pipe::soil::{Increment, Law, Point};

fn point() -> Point {
    Point { depth_m: 5.0, density_kg_m3: 2000.0, vs_m_s: 200.0, vertical_pa: 100e3, horizontal_pa: 50e3 }
}

/// Follows strains from corner to corner in so many steps each; `each` gets the increment and the stress after it, Pa.
fn follow(law: &dyn Law, corners: &[f64], pieces: usize, mut each: impl FnMut(f64, f64)) {
    let mut state = vec![0.0; law.n_state()];
    law.start(&point(), &mut state).expect("a start");
    let mut next = state.clone();
    let mut gamma = 0.0;
    for corner in corners {
        let d = (corner - gamma) / pieces as f64;
        for _ in 0..pieces {
            each(d, law.update(Increment::new(d, 0.0), &state, &mut next).expect("a response").tau_pa);
            std::mem::swap(&mut state, &mut next);
        }
        gamma = *corner;
    }
}

/// Stresses at the corners, and the work on the way.
fn walk(law: &dyn Law, corners: &[f64], pieces: usize) -> (Vec<f64>, f64) {
    let (mut taus, mut last, mut work) = (Vec::new(), 0.0, 0.0);
    follow(law, corners, pieces, |d, tau| {
        work += 0.5 * (tau + last) * d;
        last = tau;
        taus.push(tau);
    });
    (taus.into_iter().skip(pieces - 1).step_by(pieces).collect(), work)
}

#[test]
fn loop_damping_is_the_closed_form() {
    // ξ = (4/π)(1 + 1/y)(1 − ln(1 + y)/y) − 2/π for s = 1, y = γ_a/γ_r, times the reduction factor.
    let pi = std::f64::consts::PI;
    for (reduce, y) in [(false, 0.1), (false, 1.0), (false, 5.0), (true, 1.0), (true, 5.0)] {
        let law = build("hyperbolic", &format!("curvature = 1.0\ngamma_ref = 1e-3\nreduce_damping = {reduce}"));
        let a = y * 1e-3;
        let (_, first) = walk(law.as_ref(), &[a], 4000);
        let (taus, all) = walk(law.as_ref(), &[a, -a, a], 4000);
        let damping = (all - first) / (2.0 * pi * taus[0] * a);
        let masing = 4.0 / pi * (1.0 + 1.0 / y) * (1.0 - (1.0 + y).ln() / y) - 2.0 / pi;
        let factor = if reduce { (0.6329 - 0.0057 * 10.0_f64.ln()) * (1.0 / (1.0 + y)).powf(0.1) } else { 1.0 };
        println!("γ/γ_r {y}: loop damping {damping:.6}, closed form {:.6}", masing * factor);
        assert!((damping / (masing * factor) - 1.0).abs() < 1e-4);
    }
}

#[test]
fn an_inner_loop_leaves_no_trace() {
    let law = build("hyperbolic", "gamma_ref = 1e-3");
    let plain = walk(law.as_ref(), &[2e-3, -2e-3, 1e-3], 100).0;
    let nested = walk(law.as_ref(), &[2e-3, -2e-3, 0.0, -1e-3, -0.5e-3, -0.8e-3, 1e-3], 100).0;
    assert!((plain[2] - nested[6]).abs() < 1e-6 * plain[2].abs(), "{plain:?} {nested:?}");
    let beyond = walk(law.as_ref(), &[2e-3, -1e-3, 3e-3], 100).0;
    let backbone = walk(law.as_ref(), &[3e-3], 100).0;
    assert!((beyond[2] / backbone[0] - 1.0).abs() < 1e-9);
}

#[test]
fn stress_follows_strain_however_many_loops_are_open() {
    // What rings down opens a loop inside a loop every half cycle. Then it grows again, and closes them all.
    let law = build("hyperbolic", "gamma_ref = 1e-3");
    let size = |k: i32| 1e-3 * 0.9_f64.powi(k);
    let side = |k: i32| if k % 2 == 0 { 1.0 } else { -1.0 };
    let down = (0..60).map(|k| side(k) * size(k));
    let up = (0..60).map(|k| side(k) * size(59 - k) * 1.07);
    let corners: Vec<f64> = down.chain(up).chain([2e-3]).collect();
    let modulus_pa = point().density_kg_m3 * point().vs_m_s.powi(2);
    let (mut tau_pa, mut steepest) = (0.0, 0.0_f64);
    follow(law.as_ref(), &corners, 200, |d, there| {
        steepest = steepest.max((there - tau_pa).abs() / (modulus_pa * d.abs()));
        tau_pa = there;
    });
    assert!(steepest < 1.0 + 1e-9, "{steepest}");
    let backbone = walk(law.as_ref(), &[2e-3], 100).0[0];
    assert!((tau_pa / backbone - 1.0).abs() < 1e-9, "{tau_pa} {backbone}");
}
