//! The undrained 0.02 g column against the independent one.

use crate::reference::columns;
use crate::robustness::overshoot;
use crate::support::{layer, peak, profile, rayleigh, relative_rms, shake};
use flare_pipe::column::{Analysis, Profile};

/// The reference's column: four velocities, G₀ as given there, uniform elements, and that code's two conventions: moduli
/// without p_t, and α_in moved at every reversal, and like that code no viscosity. With ours for the second the surface peak is 0.0389 g, not 0.0407 g.
pub fn reference_profile() -> Profile {
    let h = 0.085;
    let soil = |count: f64, vs: f64, g_0: f64| {
        layer(
            count * h,
            1900.0,
            vs,
            "sanisand",
            &format!("g_0 = {g_0}\np_t_in_moduli = false\nreset_on_reversal = true\nviscosity_s = 0.0"),
        )
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
    // Stepped as that code is (Newmark, 5 ms throughout), and as ours is by default. The reference holds its own 5 ms: at
    // 1 ms ours moves away from both by 9 to 10 %, which is the error of 5 ms steps in a motion to 10 Hz.
    let like_it = Analysis { hht_alpha: 0.0, max_jump: f64::INFINITY, initial_step_s: 0.005, ..Analysis::default() };
    for (analysis, limit) in [(like_it, 0.02), (Analysis::default(), 0.03)] {
        let (rows, summary) = shake(&reference_profile(), &analysis, 0.005, &base[1]);
        println!("{summary:?}");
        let at = |k: usize| -> Vec<f64> { rows[1..=reference[0].len()].iter().map(|r| r[k]).collect() };
        let between = |a: Vec<f64>, b: Vec<f64>| -> Vec<f64> { a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect() };
        for (name, ours, theirs) in [
            ("surface", at(0), &reference[2]),
            ("6.035 m", between(at(71), at(72)), &reference[3]),
            ("10.965 m", between(at(129), at(130)), &reference[4]),
        ] {
            let miss = relative_rms(&ours, theirs);
            let (a, b) = (peak(&ours) / 9.806_65, peak(theirs) / 9.806_65);
            println!("{name}: peak {a:.4} g against {b:.4} g, relative rms difference {miss:.4}");
            assert!(miss < limit && (a / b - 1.0).abs() < 0.01, "{name}");
        }
    }
}

#[test]
fn soil_points_follow_the_stress_of_the_independent_column() {
    for (name, vertical_pa, g_0) in
        [("col_pt005_pga020_loop_z3.csv", 32_478.5, 296.9), ("col_pt005_pga020_loop_z11.csv", 103_022.0, 308.4)]
    {
        let Some(reference) = columns(name) else { return };
        let law =
            crate::laws::build("sanisand", &format!("g_0 = {g_0}\np_t_in_moduli = false\nreset_on_reversal = true"));
        let point = flare_pipe::soil::Point {
            depth_m: 3.0,
            density_kg_m3: 1900.0,
            vs_m_s: 140.0,
            vertical_pa,
            horizontal_pa: 0.5 * vertical_pa,
        };
        let mut state = vec![0.0; law.n_state()];
        law.start(&point, &mut state).expect("a start");
        let mut next = state.clone();
        let mut taus = Vec::new();
        for k in 0..reference[0].len() {
            let d = |c: usize| if k == 0 { 0.0 } else { reference[c][k] - reference[c][k - 1] };
            let step = flare_pipe::soil::Increment::new(d(6), d(5));
            taus.push(law.update(step, &state, &mut next).expect("a response").tau_pa / 1e3);
            std::mem::swap(&mut state, &mut next);
        }
        // The strains are given at every second step of that column, so a turning point may be missed later on.
        let until = reference[0].iter().position(|t| *t > 1.3).expect("a longer record");
        let miss = relative_rms(&taus[..until], &reference[3][..until]);
        let later = relative_rms(&taus, &reference[3]);
        println!("{name}: τ relative rms difference {miss:.4} until 1.3 s, {later:.4} in all");
        assert!(miss < 2e-3 && later < 0.05, "{name}");
    }
}

#[test]
fn strong_undrained_motion_finishes_where_the_independent_column_does_not() {
    let Some(base) = columns("base_motion_pga100.csv") else { return };
    let (rows, summary) = shake(&reference_profile(), &Analysis::default(), 0.005, &base[1]);
    let surface: Vec<f64> = rows.iter().map(|r| r[0]).collect();
    println!(
        "{summary:?}, peak {:.4} g, single samples stand out by {:.3}",
        peak(&surface) / 9.806_65,
        overshoot(&surface)
    );
    assert_eq!(rows.len(), base[1].len());
    assert!(summary.cuts < 30 && overshoot(&surface) < 0.3);
}
