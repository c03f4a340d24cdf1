//! SANISAND: one soil point against independent element paths, its tangent, its widths and its step size.

use crate::reference::columns;
use flare_pipe::soil::{Increment, LAWS, Law, Point, Response};

fn law(table: &str) -> Box<dyn Law> {
    let entry = flare_pipe::registry::find("soil law", LAWS, "sanisand").expect("registered");
    (entry.build)(table.parse().expect("TOML")).expect("valid parameters")
}

fn point() -> Point {
    Point { depth_m: 6.0, density_kg_m3: 1900.0, vs_m_s: 150.0, vertical_pa: 75e3, horizontal_pa: 37.5e3 }
}

/// Follows strains γ at constant volume; (τ, p') in kPa after each.
fn constant_volume(law: &dyn Law, gammas: &[f64]) -> Vec<(f64, f64)> {
    let mut state = vec![0.0; law.n_state()];
    law.start(&point(), &mut state).expect("a start");
    let mut next = state.clone();
    let mut last = 0.0;
    gammas
        .iter()
        .map(|gamma| {
            let step = Increment::new(gamma - last, 0.0);
            last = *gamma;
            let response =
                law.update(step, &state, &mut next).unwrap_or_else(|r| panic!("{r} at {gamma} from {state:?}"));
            state.copy_from_slice(&next);
            (response.tau_pa / 1e3, state[3] / 1e3 - 5.0)
        })
        .collect()
}

#[test]
fn constant_volume_shear_agrees_with_independent_paths() {
    // The independent codes leave p_t out of the elastic moduli. The cv paths end where p' reaches that code's floor,
    // 1e-4 of its p_a (0.05 kPa): there it puts the stress back to p' = 5.03 kPa and τ to almost nothing, and goes on
    // from a state that is on no path of the law. Ours follows on to p' = 0 and below.
    let law = law("g_0 = 300\np_t_in_moduli = false\nmax_substeps = 100000");
    for (name, limit_kpa) in [
        ("dm04_indep_g0p1pct_K0_pt005_alin_alpha.csv", 0.03),
        ("cv_g0p1pct_K0_pt005_alinALPHA0.csv", 0.03),
        ("cv_g1pct_K0_pt005_alinALPHA0.csv", 0.21),
    ] {
        let Some(reference) = columns(name) else { return };
        let ours = constant_volume(law.as_ref(), &reference[0]);
        let until = reference[2].windows(2).position(|p| p[1] > p[0] + 4.0).map_or(ours.len(), |k| k + 1);
        let miss = |pick: fn(&(f64, f64)) -> f64, k: usize| {
            ours[..until].iter().map(pick).zip(&reference[k]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        let (tau, p) = (miss(|o| o.0, 1), miss(|o| o.1, 2));
        println!(
            "{name}, first {until} of {} rows: tau within {tau:.4} kPa of {:.1}, p' within {p:.4} kPa",
            ours.len(),
            crate::support::peak(&reference[1][..until])
        );
        assert!(tau < limit_kpa && p < limit_kpa);
    }
}

#[test]
fn wide_registers_give_the_same_bytes_as_one_point_at_a_time() {
    let law = law("");
    let n = 21;
    let increments: Vec<Increment> =
        (0..n).map(|i| Increment::new(1e-4 * (f64::from(i) * 0.7).sin(), 1e-7 * f64::from(i))).collect();
    let mut old = vec![0.0; law.n_state() * n as usize];
    for state in old.chunks_exact_mut(law.n_state()) {
        law.start(&point(), state).expect("a start");
    }
    let (mut wide, mut narrow) = (old.clone(), old.clone());
    let mut responses = vec![Response::default(); n as usize];
    for _ in 0..5 {
        law.update_all(&increments, &old, &mut wide, &mut responses).expect("responses");
        let points = old.chunks_exact(law.n_state()).zip(narrow.chunks_exact_mut(law.n_state()));
        for (i, (from, to)) in points.enumerate() {
            assert_eq!(law.update(increments[i], from, to).expect("a response"), responses[i]);
        }
        assert_eq!(wide, narrow);
        old.copy_from_slice(&wide);
    }
}

#[test]
fn drained_shear_ends_on_the_critical_state() {
    // Constant vertical stress, to 300 % shear: p̄ and e meet the critical state line, and the stress ratio M(θ).
    let law = law("g_0 = 300\nmax_substeps = 100000");
    let mut state = vec![0.0; law.n_state()];
    law.start(&point(), &mut state).expect("a start");
    let mut next = state.clone();
    for _ in 0..30_000 {
        let mut step = Increment::new(1e-4, 0.0);
        for _ in 0..6 {
            let response = law.update(step, &state, &mut next).expect("a response");
            step.eps_yy -= (response.sigma_yy_pa + 75e3) / response.tangent_pa[3];
        }
        law.update(step, &state, &mut next).expect("a response");
        std::mem::swap(&mut state, &mut next);
    }
    let (p_bar, e) = (state[3], state[13]);
    let psi = e - 0.934 + 0.019 * (p_bar / 1e5).powf(0.7);
    println!("critical state: e {e:.4}, p̄ {:.3} kPa, Ψ {psi:.5}", p_bar / 1e3);
    assert!(psi.abs() < 3e-3);
}
