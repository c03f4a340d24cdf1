//! Softening, rate dependence and sliders around every law: closed forms, tangents, and nothing where they are nothing.

use crate::laws::build;
use crate::support::{lotung, shake};
use flare_pipe::column::{Analysis, Features, RateZone, Slip, SofteningZone};
use flare_pipe::soil::{Increment, Law, Point, Rate, Response, Scaled, Scaling, Slider, Softening};

const KINDS: [&str; 5] = ["elastic", "hyperbolic", "mohr_coulomb", "cam_clay", "sanisand"];

fn point() -> Point {
    Point { depth_m: 6.0, density_kg_m3: 1800.0, vs_m_s: 150.0, vertical_pa: 80e3, horizontal_pa: 48e3 }
}

fn softened(kind: &str, ru_at_reference: f64) -> Scaled {
    Scaled::new(build(kind, ""), vec![Box::new(Softening { ru_at_reference, exponent: 1.5 }) as Box<dyn Scaling>])
}

fn rated(kind: &str, table: &str, per_log_cycle: f64) -> Scaled {
    Scaled::new(build(kind, table), vec![Box::new(Rate { per_log_cycle }) as Box<dyn Scaling>])
}

/// Stress along `gammas`, each increment taking `dt_s`.
fn walk(law: &dyn Law, gammas: impl IntoIterator<Item = f64>, dt_s: f64) -> (Vec<Response>, Vec<f64>) {
    let mut state = vec![0.0; law.n_state()];
    law.start(&point(), &mut state).expect("a start");
    let mut next = state.clone();
    let mut last = 0.0;
    let mut responses = Vec::new();
    for gamma in gammas {
        let increment = Increment { gamma: gamma - last, eps_yy: 0.0, dt_s };
        responses.push(law.update(increment, &state, &mut next).expect("a response"));
        std::mem::swap(&mut state, &mut next);
        last = gamma;
    }
    (responses, state)
}

fn cycles(amplitude: f64, count: usize, pieces: usize) -> impl Iterator<Item = f64> {
    (1..=count * pieces).map(move |k| amplitude * (std::f64::consts::TAU * k as f64 / pieces as f64).sin())
}

#[test]
fn nothing_around_a_law_is_the_law_to_the_last_bit() {
    for kind in KINDS {
        let plain = walk(build(kind, "").as_ref(), cycles(1e-3, 3, 100), 0.005).0;
        assert_eq!(walk(&softened(kind, 0.0), cycles(1e-3, 3, 100), 0.005).0, plain, "{kind}");
        assert_eq!(walk(&rated(kind, "", 0.0), cycles(1e-3, 3, 100), 0.005).0, plain, "{kind}");
        assert_eq!(walk(&Slider::new(build(kind, ""), 1e9), cycles(1e-3, 3, 100), 0.005).0, plain, "{kind}");
    }
}

#[test]
fn pore_pressure_ratio_of_uniform_cycles_is_the_closed_form() {
    // Elastic, little softening: N cycles of τ_a give E = 2 N (τ_a/σ'_v)².
    let g = 1800.0 * 150.0 * 150.0;
    let tau_a = 8e3;
    let softening = Softening { ru_at_reference: 1e-3, exponent: 1.5 };
    let (responses, state) = walk(&softened("elastic", 1e-3), cycles(tau_a / g, 5, 400), 0.005);
    let e = 2.0 * 5.0 * (tau_a / 80e3_f64).powi(2);
    let exact = 1e-3 * (e / 0.2_f64).powf(0.75);
    let ours = softening.pore_ratio(state[4]);
    println!("r_u {ours:.6e}, closed form {exact:.6e}; E {:.5} against {e:.5}", state[4]);
    assert!((ours / exact - 1.0).abs() < 2e-3);
    let next = responses[1999].tangent_pa[0] / g;
    assert!((next - (1.0 - exact).sqrt()).abs() < 1e-6);
}

#[test]
fn strength_grows_with_the_rate_as_stated_and_stiffness_does_not() {
    // Overconsolidated Cam-Clay at constant volume: the strength without rate dependence is the reference.
    let beta = 0.1;
    let end = |law: &dyn Law, rate: f64| {
        let gammas = (1..=4000).map(|k| 5e-5 * f64::from(k));
        walk(law, gammas, 5e-5 / rate).0
    };
    let plain = build("cam_clay", "ocr = 2.0");
    let reference = end(plain.as_ref(), 1.0).last().expect("a response").tau_pa;
    for rate in [1e-4, 1e-3, 1e-2] {
        let rated = rated("cam_clay", "ocr = 2.0", beta);
        let responses = end(&rated, rate);
        let ratio = responses.last().expect("a response").tau_pa / reference;
        let exact = 1.0 + beta * (1.0 + rate / 1e-5_f64).log10();
        println!("rate {rate:e} 1/s: strength ratio {ratio:.5}, closed form {exact:.5}");
        assert!((ratio / exact - 1.0).abs() < 2e-3);
        assert!((responses[0].tangent_pa[0] / (1800.0 * 150.0 * 150.0) - 1.0).abs() < 1e-9);
    }
}

#[test]
fn tangents_around_a_law_are_derivatives() {
    for kind in ["elastic", "hyperbolic", "mohr_coulomb", "cam_clay"] {
        let laws: [(&str, Box<dyn Law>); 3] = [
            ("softened", Box::new(softened(kind, 1.0))),
            ("rated", Box::new(rated(kind, "", 0.1))),
            ("slider", Box::new(Slider::new(build(kind, ""), 10e3))),
        ];
        for (name, law) in laws {
            let (_, state) = walk(law.as_ref(), (1..=80).map(|k| 1e-5 * f64::from(k)), 0.005);
            let mut next = state.clone();
            let base = Increment { gamma: 2e-5, eps_yy: 1e-7, dt_s: 0.005 };
            let mut at = |i: Increment| law.update(i, &state, &mut next).expect("a response");
            let tangent = at(base).tangent_pa;
            let h = 1e-8;
            let gamma = [-h, h].map(|d| at(Increment { gamma: base.gamma + d, ..base }));
            let eps = [-h, h].map(|d| at(Increment { eps_yy: base.eps_yy + d, ..base }));
            let numeric = [
                (gamma[1].tau_pa - gamma[0].tau_pa) / (2.0 * h),
                (eps[1].tau_pa - eps[0].tau_pa) / (2.0 * h),
                (gamma[1].sigma_yy_pa - gamma[0].sigma_yy_pa) / (2.0 * h),
                (eps[1].sigma_yy_pa - eps[0].sigma_yy_pa) / (2.0 * h),
            ];
            let miss = tangent.iter().zip(numeric).map(|(a, b)| (a - b).abs() / tangent[3]).fold(0.0, f64::max);
            println!("{name} {kind}: tangent within {miss:.1e} of M");
            assert!(miss < 1e-3, "{name} {kind}: {tangent:?} against {numeric:?}");
        }
    }
}

#[test]
fn a_slider_never_carries_more_than_its_cap() {
    for kind in KINDS {
        let law = Slider::new(build(kind, ""), 6e3);
        let (responses, _) = walk(&law, cycles(2e-3, 3, 200), 0.005);
        assert!(responses.iter().all(|r| r.tau_pa.abs() <= 6e3), "{kind}");
        assert!(responses.iter().any(|r| r.tau_pa.abs() == 6e3), "{kind}");
    }
}

#[test]
fn many_points_around_a_law_give_the_same_bytes_as_one() {
    for kind in ["hyperbolic", "sanisand"] {
        let scalings = || -> Vec<Box<dyn Scaling>> {
            vec![Box::new(Softening { ru_at_reference: 0.8, exponent: 1.5 }), Box::new(Rate { per_log_cycle: 0.1 })]
        };
        let law = Scaled::new(build(kind, ""), scalings());
        let n = 70;
        let points: Vec<Point> = (0..n)
            .map(|i| Point { vertical_pa: 60e3 + 1e3 * i as f64, horizontal_pa: 40e3 + 5e2 * i as f64, ..point() })
            .collect();
        let mut old = vec![0.0; n * law.n_state()];
        let mut elastic = vec![[0.0; 4]; n];
        assert!(law.start_all(&points, &mut old, &mut elastic).is_ok());
        let mut new = old.clone();
        let mut responses = vec![Response::default(); n];
        let mut single: Vec<Vec<f64>> = points
            .iter()
            .map(|p| {
                let mut state = vec![0.0; law.n_state()];
                law.start(p, &mut state).expect("a start");
                state
            })
            .collect();
        for k in 0..40 {
            let d = 2e-4 * (0.3 * f64::from(k)).sin();
            let increments: Vec<Increment> =
                (0..n).map(|i| Increment { gamma: d * (1.0 + 0.01 * i as f64), eps_yy: 0.0, dt_s: 0.005 }).collect();
            law.update_all(&increments, &old, &mut new, &mut responses).expect("responses");
            std::mem::swap(&mut old, &mut new);
            for (i, state) in single.iter_mut().enumerate() {
                let mut next = state.clone();
                assert_eq!(law.update(increments[i], state, &mut next).expect("a response"), responses[i]);
                *state = next;
            }
        }
    }
}

#[test]
fn features_of_no_strength_leave_the_column_as_it_is_to_the_last_bit() {
    // An element that may slip has no viscosity, so there is none to begin with.
    let mut plain = lotung(40);
    for layer in &mut plain.layers {
        layer.law = "viscosity_s = 0.0".parse::<toml::Table>().expect("TOML").into();
    }
    let mut nothing = plain.clone();
    nothing.features = Features {
        softenings: vec![SofteningZone { top_m: 0.0, bottom_m: 17.0, ru_at_reference: 0.0, exponent: 1.5 }],
        rates: vec![RateZone { top_m: 0.0, bottom_m: 17.0, law_kind: None, per_log_cycle: 0.0 }],
        ..Features::default()
    };
    let mut stuck = plain.clone();
    stuck.features.slips = vec![Slip { depth_m: 5.0, tau_max_pa: 1e8 }];
    let motion = crate::robustness::motion(4, 0.05, 4.0);
    let run = |profile: &flare_pipe::column::Profile| shake(profile, &Analysis::default(), 0.005, &motion).0;
    let declared = run(&plain);
    assert_eq!(run(&nothing), declared);
    assert_eq!(run(&stuck), declared);
}

#[test]
fn a_softening_column_is_slower_after_the_strong_phase_and_finishes() {
    let mut profile = lotung(100);
    profile.rayleigh.beta_s = 2e-4;
    let motion = crate::robustness::motion(11, 0.1, 15.0);
    let run = |profile: &flare_pipe::column::Profile| shake(profile, &Analysis::default(), 0.005, &motion);
    let (declared, before) = run(&profile);
    for zone in [(2.0, 8.0), (0.0, 17.0)] {
        profile.features.softenings =
            vec![SofteningZone { top_m: zone.0, bottom_m: zone.1, ru_at_reference: 0.8, exponent: 1.5 }];
        let (softer, summary) = run(&profile);
        let part =
            |rows: &[Vec<f64>], from: usize, to: usize| -> Vec<f64> { rows[from..to].iter().map(|r| r[0]).collect() };
        let early = crate::support::relative_rms(&part(&softer, 0, 200), &part(&declared, 0, 200));
        let late = crate::support::relative_rms(&part(&softer, 1500, 3001), &part(&declared, 1500, 3001));
        println!("{zone:?}: {summary:?} (declared {before:?}), differs by {early:.3} early and {late:.3} late");
        assert!(early < 0.02 && late > 0.15);
    }
}

#[test]
fn closed_cycles_around_a_law_create_no_energy() {
    for kind in KINDS {
        let laws: [(&str, Box<dyn Law>); 3] = [
            ("softened", Box::new(softened(kind, 1.0))),
            ("rated", Box::new(rated(kind, "", 0.1))),
            ("slider", Box::new(Slider::new(build(kind, ""), 8e3))),
        ];
        for (name, law) in laws {
            for amplitude in [1e-5, 1e-4, 1e-3] {
                let gammas: Vec<f64> = cycles(amplitude, 5, 400).collect();
                let (responses, _) = walk(law.as_ref(), gammas.iter().copied(), 0.005);
                let (mut work, mut largest, mut last) = (0.0, 0.0_f64, (0.0, 0.0));
                for (gamma, response) in gammas.iter().zip(&responses) {
                    work += 0.5 * (last.1 + response.tau_pa) * (gamma - last.0);
                    largest = largest.max(response.tau_pa.abs());
                    last = (*gamma, response.tau_pa);
                }
                assert!(work > -1e-6 * largest * amplitude, "{name} {kind} at {amplitude:e}: {work:e} J/m³");
            }
        }
    }
}
