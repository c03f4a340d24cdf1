//! Motions side by side: each as if the column were shaken by it alone, to the last bit.

use super::support::{layer, profile, rayleigh};
use flare_pipe::column::{
    Analysis, BaseMotion, Cause, Column, Features, MassMatrix, Profile, RateZone, RunSummary, SofteningZone, Structure,
    Vertical,
};
use flare_pipe::numerics::lanes::Width;

/// Motions of many strengths, lengths and steps, more than there are lanes: one that is no motion among them.
fn motions() -> Vec<(f64, Vec<f64>)> {
    let of = |i: usize| {
        let dt_s = [0.005, 0.01, 0.004][i % 3];
        let n = 200 + 130 * (i % 5);
        let peak_m_s2 = 0.02 * 2.2f64.powi(i as i32 % 8);
        let at = |k: usize| {
            let t = k as f64 * dt_s;
            peak_m_s2 * (t * (3.0 + i as f64)).sin() * ((17.0 + 1.3 * i as f64) * t).cos() * (1.0 - (-2.0 * t).exp())
        };
        (dt_s, (0..n).map(at).collect())
    };
    let mut all: Vec<(f64, Vec<f64>)> = (0..13).map(of).collect();
    all[4].1[30] = f64::NAN;
    all
}

/// Every number that a run shows, by its bits, and its work; or why it ended early.
type Shown = (Vec<u64>, Result<RunSummary, String>);

fn alone(column: &Column, (dt_s, base): &(f64, Vec<f64>)) -> Shown {
    let mut bits = Vec::new();
    let run = column.run(*dt_s, base, &mut |frame| {
        see(frame, &mut bits);
        Ok(())
    });
    (bits, run.map_err(|failure| failure.to_string()))
}

fn side_by_side(column: &Column, motions: &[(f64, Vec<f64>)], width: Width) -> Vec<Shown> {
    let mut bits = vec![Vec::new(); motions.len()];
    let bases: Vec<BaseMotion> =
        motions.iter().map(|(dt_s, base)| BaseMotion { dt_s: *dt_s, acceleration_m_s2: base }).collect();
    let runs = column.run_all_by(&bases, width, &mut |motion, frame| {
        see(frame, &mut bits[motion]);
        Ok(())
    });
    bits.into_iter().zip(runs).map(|(bits, run)| (bits, run.map_err(|failure| failure.to_string()))).collect()
}

fn see(frame: &flare_pipe::column::Frame, bits: &mut Vec<u64>) {
    let arrays =
        [frame.elements_m_s2, frame.gamma, frame.tau_pa, frame.vertical_effective_pa].into_iter().flatten().copied();
    // Zero has two signs, which are one number.
    let all = [frame.time_s, frame.base_m_s2, frame.surface_m_s2()].into_iter().chain(arrays);
    bits.extend(all.map(|x| (x + 0.0).to_bits()));
}

fn columns() -> Vec<(&'static str, Profile, Analysis)> {
    let steady = Analysis::default();
    let soft = || layer(4.0, 1900.0, 130.0, "hyperbolic", "plasticity_index = 5.0");
    let stiff = || layer(6.0, 1950.0, 220.0, "elastic", "damping_ratio = 0.02");
    let plain = || profile(vec![soft(), stiff()], 20, 2.0, rayleigh(0.0, 1.0, 5.0));
    let edited = |edit: &dyn Fn(&mut Features)| {
        let mut found = plain();
        edit(&mut found.features);
        found
    };
    let structure =
        |f: &mut Features| f.structure = Structure { mass_kg_m2: 5e3, frequency_hz: 4.0, damping_ratio: 0.05 };
    let few = Analysis { max_iterations: 2, min_step_s: 1e-3, tolerance: 1e-9, ..steady.clone() };
    let undamped = "damping_ratio = 0.0\nreduce_damping = false\ngamma_ref = 2e-4";
    let zone = SofteningZone { top_m: 1.0, bottom_m: 4.0, ru_at_reference: 0.8, exponent: 1.2 };
    vec![
        ("hyperbolic on elastic", plain(), steady.clone()),
        (
            "long steps of one length",
            plain(),
            Analysis { initial_step_s: 0.005, max_jump: f64::INFINITY, ..steady.clone() },
        ),
        ("matched mass", plain(), Analysis { mass: MassMatrix::Matched, ..steady.clone() }),
        (
            "matched mass on a compliant base in a container",
            edited(&|f| (f.base_impedance_ratio, f.container.stiffness_pa) = (0.3, 2e6)),
            Analysis { mass: MassMatrix::Matched, ..steady.clone() },
        ),
        ("compliant base", edited(&|f| f.base_impedance_ratio = 0.3), steady.clone()),
        ("container", edited(&|f| f.container.stiffness_pa = 2e6), steady.clone()),
        ("structure", edited(&structure), steady.clone()),
        ("Rayleigh damping", Profile { rayleigh: rayleigh(0.03, 2.0, 10.0), ..plain() }, steady.clone()),
        (
            "plain Masing loops",
            profile(vec![layer(8.0, 1900.0, 110.0, "hyperbolic", undamped)], 16, 9.0, rayleigh(0.01, 2.0, 9.0)),
            steady.clone(),
        ),
        ("softening", edited(&|f| f.softenings.push(zone)), steady.clone()),
        (
            "softening and rate dependence",
            edited(&|f| {
                f.softenings.push(zone);
                f.rates.push(RateZone { top_m: 0.0, bottom_m: 3.0, law_kind: None, per_log_cycle: 0.1 });
            }),
            steady.clone(),
        ),
        (
            "clay that does not move vertically",
            Profile {
                vertical: Vertical::Restrained,
                ..profile(vec![layer(10.0, 1700.0, 120.0, "cam_clay", "")], 10, 1.0, rayleigh(0.02, 2.0, 9.0))
            },
            steady.clone(),
        ),
        ("too few iterations", plain(), few.clone()),
        ("too few iterations for a structure", edited(&structure), few),
    ]
}

#[test]
fn motions_side_by_side_are_those_of_the_column_alone() {
    let motions = motions();
    for (what, profile, analysis) in columns() {
        let column = Column::new(&profile, &analysis).unwrap_or_else(|e| panic!("{what}: {e}"));
        let expected: Vec<Shown> = motions.iter().map(|m| alone(&column, m)).collect();
        let ends = expected.iter().filter(|(_, run)| run.is_ok()).count();
        println!("{what}: {ends} of {} end", motions.len());
        assert!(expected.iter().any(|(_, run)| run.as_ref().is_err_and(|why| why.contains("finite"))), "{what}");
        for width in Width::all() {
            for (i, (found, expected)) in side_by_side(&column, &motions, width).iter().zip(&expected).enumerate() {
                let first = found.0.iter().zip(&expected.0).position(|(a, b)| a != b);
                assert_eq!(found.1, expected.1, "{what}, {width:?}, motion {i}");
                assert!(
                    found.0.len() == expected.0.len() && first.is_none(),
                    "{what}, {width:?}, motion {i}: {first:?}"
                );
            }
        }
    }
}

#[test]
fn a_sink_that_refuses_ends_its_motion_alone() {
    let (_, profile, analysis) = columns().swap_remove(0);
    let column = Column::new(&profile, &analysis).unwrap();
    let motions = motions();
    let bases: Vec<BaseMotion> =
        motions.iter().map(|(dt_s, base)| BaseMotion { dt_s: *dt_s, acceleration_m_s2: base }).collect();
    let runs = column.run_all(&bases, &mut |motion, frame| {
        if motion == 2 && frame.time_s > 0.5 { Err(flare_pipe::Error::new("full")) } else { Ok(()) }
    });
    let failed: Vec<usize> = (0..runs.len()).filter(|i| runs[*i].is_err()).collect();
    assert_eq!(failed, [2, 4]);
    assert!(matches!(runs[2].as_ref().unwrap_err().cause, Cause::Sink(_)));
}
