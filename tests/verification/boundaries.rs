//! Boundaries of the column: compliant base, structure, container against exact transfer functions; slip against closed
//! forms.

use crate::support::{layer, lotung, profile, shake};
use crate::transfer_function::{Complex, analysis, cos_sin, div, mul, pulse, slope, sqrt, transform, two_layers};
use flare_pipe::column::{
    Analysis, Column, Container, Features, MassMatrix, Profile, Rayleigh, Slip, Structure, Vertical,
};
use std::f64::consts::TAU;

/// Absolute surface over input acceleration of stiffness-damped layers between a structure and a half-space, inside a
/// container: U = 1 and τ = −m ω² T at the surface, marched down, over U + q τ/(iω ρV) at the base.
fn exact(profile: &Profile, f_hz: f64) -> Complex {
    let w = TAU * f_hz;
    let Features { base_impedance_ratio, downgoing_corner_hz, structure, container, .. } = &profile.features;
    let w_s = TAU * structure.frequency_hz;
    let (mut y, mut tau) = ([1.0, 0.0], [0.0, 0.0]);
    if structure.mass_kg_m2 > 0.0 {
        let link = [w_s * w_s, 2.0 * structure.damping_ratio * w_s * w];
        let t = div(link, [link[0] - w * w, link[1]]);
        tau = t.map(|x| -structure.mass_kg_m2 * w * w * x);
    }
    let (mut impedance, mut last) = (0.0, [0.0, 0.0]);
    for layer in &profile.layers {
        let rho = layer.density_kg_m3 + container.mass_kg_m2 / profile.depth_m();
        let g = layer.density_kg_m3 * layer.vs_m_s * layer.vs_m_s;
        impedance = layer.density_kg_m3 * layer.vs_m_s;
        let g = [g + container.stiffness_pa, g * w * profile.rayleigh.beta_s];
        let k = sqrt(div([rho * w * w, 0.0], g));
        let (c, s) = cos_sin(k.map(|x| x * layer.thickness_m));
        let gk = mul(g, k);
        last = gk.map(|x| x / w);
        let (a, b) = (mul(c, y), div(mul(s, tau), gk));
        let (d, e) = (mul(mul(gk, s), y), mul(c, tau));
        y = [a[0] + b[0], a[1] + b[1]];
        tau = [e[0] - d[0], e[1] - d[1]];
    }
    let share = div(tau.map(|x| base_impedance_ratio * x), [0.0, w * impedance]);
    let outcrop = [y[0] + share[0], y[1] + share[1]];
    if *downgoing_corner_hz == 0.0 {
        return div([1.0, 0.0], outcrop);
    }
    // Waves going up and down at the base, apart: their powers, and what of their product is coherent.
    let stress = div(tau, mul([0.0, w], last));
    let up = [0.5 * (y[0] + stress[0]), 0.5 * (y[1] + stress[1])];
    let down = [y[0] - up[0], y[1] - up[1]];
    let c = 1.0 / (1.0 + (f_hz / downgoing_corner_hz).powi(2));
    let power =
        up[0].hypot(up[1]).powi(2) + down[0].hypot(down[1]).powi(2) + 2.0 * c * (up[0] * down[0] + up[1] * down[1]);
    let coherent = [up[0] + c * down[0], up[1] + c * down[1]];
    let scale = power.sqrt() / coherent[0].hypot(coherent[1]);
    div([1.0, 0.0], coherent.map(|x| x * scale))
}

/// Largest relative miss of the complex transfer function.
fn miss(profile: &Profile, dt_s: f64) -> f64 {
    miss_after(profile, dt_s, 0.0)
}

/// The same of a motion with `lead_s` of rest before it.
fn miss_after(profile: &Profile, dt_s: f64, lead_s: f64) -> f64 {
    miss_with(profile, &analysis(dt_s), lead_s)
}

fn miss_with(profile: &Profile, analysis: &Analysis, lead_s: f64) -> f64 {
    let dt_s = analysis.max_step_s;
    let mut base = vec![0.0; (lead_s / dt_s) as usize];
    base.extend(pulse(dt_s, 30.0, 3.0));
    let (rows, _) = shake(profile, analysis, dt_s, &base);
    let surface: Vec<f64> = rows.iter().map(|r| r[0]).collect();
    let at = |f: f64| {
        let ours = div(transform(&surface, dt_s, f), transform(&base, dt_s, f));
        let truth = exact(profile, f);
        (ours[0] - truth[0]).hypot(ours[1] - truth[1]) / truth[0].hypot(truth[1])
    };
    [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0].into_iter().map(at).fold(0.0, f64::max)
}

fn column(elements: usize, features: Features) -> Profile {
    Profile { features, ..two_layers(elements, Rayleigh { alpha_1_s: 0.0, beta_s: 4e-3 }) }
}

fn base(q: f64) -> Features {
    Features { base_impedance_ratio: q, ..Features::default() }
}

fn standing(mass_kg_m2: f64, frequency_hz: f64, damping_ratio: f64) -> Features {
    Features { structure: Structure { mass_kg_m2, frequency_hz, damping_ratio }, ..Features::default() }
}

#[test]
fn compliant_base_matches_the_exact_solution() {
    for q in [0.05, 0.3, 1.0] {
        let found = miss(&column(100, base(q)), 0.001);
        println!("impedance ratio {q}: complex transfer function within {found:.2e}");
        assert!(found < 4e-3, "{q}");
    }
}

#[test]
fn undamped_layers_on_a_half_space_match_the_exact_solution() {
    // Only radiation takes energy away, so the coda of layers without any damping ends.
    let profile = Profile { features: base(0.3), ..two_layers(100, Rayleigh::default()) };
    let found = miss(&profile, 0.0005);
    println!("undamped: complex transfer function within {found:.2e}");
    assert!(found < 4e-3);
}

#[test]
fn compliant_base_tends_to_the_rigid_one_and_converges_with_the_square_of_the_mesh() {
    let motion = pulse(0.002, 5.0, 3.0);
    let surface = |q: f64| -> Vec<f64> {
        shake(&column(40, base(q)), &analysis(0.002), 0.002, &motion).0.iter().map(|r| r[0]).collect()
    };
    let rigid = surface(0.0);
    let away = |q: f64| crate::support::relative_rms(&surface(q), &rigid);
    let (far, near) = (away(1e-3), away(1e-4));
    println!("q = 1e-3 and 1e-4: {far:.2e} and {near:.2e} from the rigid base");
    assert!(near < 2e-3 && (far / near - 10.0).abs() < 1.0);
    let points: Vec<(f64, f64)> =
        [8, 16, 32].map(|n| (1.0 / f64::from(n), miss(&column(n as usize, base(0.3)), 0.0005))).to_vec();
    let order = slope(&points);
    println!("spatial order {order:.3} from {points:?}");
    assert!((order - 2.0).abs() < 0.2);
}

#[test]
fn a_sensor_below_sees_what_two_waves_of_less_coherence_leave() {
    let of = |corner_hz: f64| Features { downgoing_corner_hz: corner_hz, ..Features::default() };
    for corner_hz in [0.8, 2.0, 6.0] {
        // What the sensor records is a sum over motions before and after: some of it is before the pulse.
        let found = miss_after(&column(100, of(corner_hz)), 0.001, 8.0);
        println!("corner {corner_hz} Hz: complex transfer function within {found:.2e}");
        assert!(found < 1e-2, "{corner_hz}");
    }
    // Peaks are lower, and a motion of no frequency in particular passes.
    let peak = |corner_hz: f64| {
        let gain = |k: usize| exact(&column(10, of(corner_hz)), 0.05 * k as f64).into_iter().fold(0.0, f64::hypot);
        (1..200).map(gain).fold(0.0, f64::max)
    };
    assert!(peak(1.0) < 0.5 * peak(0.0), "{} {}", peak(1.0), peak(0.0));
    let near = miss(&column(100, of(1e4)), 0.001) - miss(&column(100, of(0.0)), 0.001);
    assert!(near.abs() < 1e-4, "{near}");
}

#[test]
fn matched_mass_is_closer_to_the_exact_solution_at_every_boundary() {
    let downgoing = Features { downgoing_corner_hz: 2.0, ..Features::default() };
    let container = Container { stiffness_pa: 4e6, mass_kg_m2: 3e3 };
    let cases = [
        ("compliant base", base(0.4)),
        ("down-going wave", downgoing),
        ("structure", standing(6e3, 3.0, 0.07)),
        ("container", Features { container, ..Features::default() }),
    ];
    for (name, features) in cases {
        let of = |mass: MassMatrix| {
            let analysis = Analysis { mass, max_jump: f64::INFINITY, ..analysis(0.004) };
            miss_with(&column(20, features.clone()), &analysis, 8.0)
        };
        let [matched, lumped] = [MassMatrix::Matched, MassMatrix::Lumped].map(of);
        println!("{name}: complex transfer function within {matched:.2e}, {lumped:.2e} with lumped mass");
        assert!(matched < 0.5 * lumped, "{name}: {matched} {lumped}");
    }
}

#[test]
fn structure_on_the_surface_matches_the_exact_solution() {
    for (mass, hz, damping) in [(2e3, 2.2, 0.05), (6e3, 3.0, 0.07), (8e3, 5.8, 0.02)] {
        let found = miss(&column(100, standing(mass, hz, damping)), 0.001);
        println!("{mass} kg/m² at {hz} Hz: complex transfer function within {found:.2e}");
        assert!(found < 1e-2, "{mass}");
    }
    let all = Features {
        base_impedance_ratio: 0.2,
        container: Container { mass_kg_m2: 4e3, stiffness_pa: 3e6 },
        ..standing(3e3, 2.5, 0.1)
    };
    let found = miss(&column(100, all), 0.001);
    println!("structure, container and compliant base: within {found:.2e}");
    assert!(found < 1e-2);
}

#[test]
fn a_container_matches_the_exact_solution() {
    for (mass_kg_m2, stiffness_pa) in [(1e4, 0.0), (0.0, 2e7), (5e3, 5e6)] {
        let container = Container { mass_kg_m2, stiffness_pa };
        for vertical in [Vertical::Restrained, Vertical::Free] {
            let profile = Profile { vertical, ..column(100, Features { container, ..Features::default() }) };
            let found = miss(&profile, 0.001);
            println!("{container:?}: complex transfer function within {found:.2e}");
            assert!(found < 5e-3);
        }
    }
}

#[test]
fn a_structure_weighs_on_the_ground_and_weak_sand_carries_it() {
    let mut profile = lotung(50);
    let plain = Column::new(&profile, &Analysis::default()).expect("a column").vertical_effective_stress_pa();
    profile.features = standing(6e3, 3.0, 0.05);
    let loaded = Column::new(&profile, &Analysis::default()).expect("a column").vertical_effective_stress_pa();
    assert!(plain.iter().zip(&loaded).all(|(a, b)| (b - a - 6e3 * 9.806_65).abs() < 1e-6));
    for (seed, pga_g) in [(1, 0.01), (2, 0.02), (3, 0.05), (4, 0.1)] {
        let motion = crate::robustness::motion(seed, pga_g, 10.0);
        let (rows, summary) = shake(&profile, &Analysis::default(), 0.005, &motion);
        println!(
            "{pga_g} g under 6 t/m² at 3 Hz: {summary:?}, surface {:.3} m/s²",
            crate::support::peak(&rows.iter().map(|r| r[0]).collect::<Vec<f64>>())
        );
        assert_eq!(rows.len(), 2001);
    }
}

/// Two metres of very stiff ground on an interface at 2 m, four more below it.
fn block(tau_max_pa: f64) -> Profile {
    let mut profile =
        profile(vec![layer(6.0, 2000.0, 2000.0, "elastic", "")], 60, 1e3, Rayleigh { alpha_1_s: 0.0, beta_s: 2e-3 });
    profile.features.slips = vec![Slip { depth_m: 2.01, tau_max_pa }];
    profile
}

#[test]
fn a_sliding_block_slips_as_far_as_the_closed_form_says() {
    // Newmark: a rectangular pulse A of length T moves the base by A T²/2 · (A/a_y − 1) under a block that yields at a_y.
    let (a, t, dt) = (3.0, 0.2, 0.0005);
    let base: Vec<f64> = (0..3000).map(|k| if k > 0 && f64::from(k) * dt <= t { a } else { 0.0 }).collect();
    for a_y in [0.6, 1.0, 2.0] {
        let column = Column::new(&block(a_y * 2000.0 * 2.05), &analysis(dt)).expect("a column");
        let (mut slip, mut largest) = (0.0, 0.0_f64);
        column
            .run(dt, &base, &mut |frame| {
                slip = frame.gamma[20] * 0.1;
                largest = largest.max(frame.surface_m_s2());
                Ok(())
            })
            .expect("a run");
        let exact = 0.5 * a * t * t * (a / a_y - 1.0);
        println!("a_y {a_y}: slip {slip:.5} m, closed form {exact:.5} m, block at most {largest:.3} m/s²");
        assert!((slip.abs() / exact - 1.0).abs() < 0.02);
    }
}

#[test]
fn acceleration_above_an_interface_stops_at_the_stress_over_the_mass() {
    let (tau_max, mass) = (8e3, 2000.0 * 2.05);
    let profile = block(tau_max);
    let base: Vec<f64> = (0..2000).map(|k| 4.0 * (f64::from(k) * 0.002 * TAU * 1.5).sin()).collect();
    let exact = Analysis { hht_alpha: 0.0, ..analysis(0.002) };
    let column = Column::new(&profile, &exact).expect("a column");
    let (mut largest, mut plateau) = (0.0_f64, 0);
    column
        .run(0.002, &base, &mut |frame| {
            // Node accelerations from the element means, bottom up; the mass down to the slipping element's centre.
            let (mut below, mut sum) = (frame.base_m_s2, 0.0);
            for (i, mean) in frame.elements_m_s2.iter().enumerate().rev() {
                below = 2.0 * mean - below;
                sum += if i > 20 { 0.0 } else { below * if i == 0 { 100.0 } else { 200.0 } };
            }
            let mean: f64 = sum / mass;
            largest = largest.max(mean.abs());
            plateau += usize::from((mean.abs() / (tau_max / mass) - 1.0).abs() < 0.02);
            Ok(())
        })
        .expect("a run");
    println!(
        "mean acceleration above at most {largest:.4}, τ_max/m {:.4} m/s²; {plateau} samples on it",
        tau_max / mass
    );
    assert!(largest < 1.0001 * tau_max / mass && plateau > 500);
}
