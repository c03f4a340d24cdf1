//! The fast column against the exact layered column and against the nonlinear one in weak and strong motion.

use crate::support::{STEP_S, Truth, array, problem, settings, table};
use flare_pipe::column::{Layer, Profile, Rayleigh, Vertical};
use flare_pipe::diagnosis::{Curves, FastColumn, Grid, Replay, Scene, Tuning};
use flare_pipe::effects;
use flare_pipe::soil::Relaxation;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;

type C64 = Complex<f64>;

fn layer(thickness_m: f64, density_kg_m3: f64, vs_m_s: f64) -> Layer {
    Layer {
        thickness_m,
        density_kg_m3,
        vs_m_s,
        k0: 0.5,
        fineness: 1.0,
        law_kind: "elastic".into(),
        law: Default::default(),
    }
}

/// Absolute surface over base acceleration of layers on a rigid base with Rayleigh damping and a complex modulus over G; mass damping acts on the motion relative
/// to the base, whose particular solution is −ω²/(ω² − iωα).
fn exact(profile: &Profile, damping: &dyn Fn(f64) -> [f64; 2], f_hz: f64) -> C64 {
    let w = TAU * f_hz;
    let rate = C64::new(w * w, -w * profile.rayleigh.alpha_1_s);
    let particular = C64::new(-w * w, 0.0) / rate;
    let (mut y, mut tau) = (C64::new(1.0, 0.0), C64::default());
    for Layer { thickness_m, density_kg_m3, vs_m_s, .. } in &profile.layers {
        let [re, im] = damping(f_hz);
        let g = density_kg_m3 * vs_m_s * vs_m_s * C64::new(re, im + w * profile.rayleigh.beta_s);
        let k = (rate * *density_kg_m3 / g).sqrt();
        let (c, s) = ((k * *thickness_m).cos(), (k * *thickness_m).sin());
        (y, tau) = (c * y + s * tau / (g * k), c * tau - g * k * s * y);
    }
    C64::new(1.0, 0.0) + particular - particular / y
}

/// A way in which layers are damped.
struct Case<'a> {
    profile: Profile,
    /// Complex modulus over G at a frequency.
    modulus: &'a dyn Fn(f64) -> [f64; 2],
    is_dispersive: bool,
}

/// Largest relative miss of the complex transfer function with so many elements.
fn transfer_miss(case: &Case<'_>, elements: usize) -> f64 {
    let column = FastColumn::new(&case.profile, elements, &Curves::default()).unwrap();
    let column = if case.is_dispersive { column } else { column.without_dispersion() };
    let grid = Grid::around(0.2, 10.0, column.grid_step_hz());
    let march = column.march(grid, &vec![1e-5; column.n_element()], &[0.0], &Tuning::default());
    let mut worst = 0.0f64;
    for f in [0.33, 0.5, 1.0, 2.02, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 9.9] {
        let mut ours = [C64::default()];
        march.response(f, &mut ours);
        let truth = exact(&case.profile, case.modulus, f);
        worst = worst.max((ours[0] - truth).norm() / truth.norm());
    }
    worst
}

#[test]
fn elastic_layers_match_the_exact_transfer_function_and_converge_with_the_square_of_the_height() {
    let (w1, w2) = (TAU, 10.0 * TAU);
    let rayleigh = Rayleigh { alpha_1_s: 0.1 * w1 * w2 / (w1 + w2), beta_s: 0.1 / (w1 + w2) };
    let profile = |rayleigh: Rayleigh, ratio: f64| {
        let law: toml::Table = [("damping_ratio".to_string(), ratio.into())].into_iter().collect();
        let layers = [layer(6.0, 1800.0, 120.0), layer(10.0, 2000.0, 220.0)];
        let layers = layers.map(|l| Layer { law: law.clone().into(), ..l });
        let (water_table_m, vertical) = (1e3, Vertical::Free);
        Profile { layers: layers.into(), water_table_m, vertical, rayleigh, elements: 100, ..array().profile }
    };
    let relaxation = Relaxation::new(0.05, 0.0);
    let damped = || profile(Rayleigh::default(), 0.05);
    let cases = [
        Case { profile: profile(rayleigh, 0.0), modulus: &|_| [1.0, 0.0], is_dispersive: true },
        Case { profile: damped(), modulus: &|f| relaxation.modulus(f), is_dispersive: true },
        Case { profile: damped(), modulus: &|_| [1.0, 0.1], is_dispersive: false },
    ];
    for case in cases {
        let (coarse, fine) = (transfer_miss(&case, 32), transfer_miss(&case, 64));
        println!("complex transfer function within {coarse:.2e} and {fine:.2e}");
        assert!(fine < 0.02 && coarse / fine > 3.5 && coarse / fine < 4.5);
    }
}

#[test]
fn strains_are_those_of_the_marched_motion() {
    let profile = Profile { layers: vec![layer(10.0, 1900.0, 150.0)], ..array().profile };
    let column = FastColumn::new(&profile, 100, &Curves::default()).unwrap();
    let grid = Grid::around(0.2, 10.0, column.grid_step_hz());
    let depths: Vec<f64> = vec![5.0, 5.1];
    let march = column.march(grid, &vec![1e-5; column.n_element()], &depths, &Tuning::default());
    let (f, u) = (2.2, C64::new(0.01, 0.002));
    let mut motion = [C64::default(); 2];
    march.response(f, &mut motion);
    let expected = ((motion[1] - motion[0]) * u).norm() / 0.1;
    let norm = march.strain_norm(&[f], &[u]);
    let found = norm[(5.05 / 0.1) as usize];
    println!("strain {found:.4e}, from the motion {expected:.4e}");
    assert!((found / expected - 1.0).abs() < 0.02);
}

/// Relative miss of the fast column's surface spectrum, all events together, and the miss of doing nothing.
fn against_nonlinear(pga_scale: f64) -> f64 {
    let array = array();
    let mut problem = problem(&array, &[], Truth { elements: 60, max_step_s: 0.005, seed: 5, events: 4 });
    for event in &mut problem.events {
        event.input.iter_mut().for_each(|a| *a *= pga_scale);
    }
    let replays = crate::support::Replays(&problem).replay(&[]).unwrap();
    for (event, replayed) in problem.events.iter_mut().zip(replays) {
        event.outputs = replayed.unwrap();
    }
    let scene = Scene::new(&problem, &settings()).unwrap();
    let all: Vec<usize> = (0..scene.groups.len()).collect();
    let responses = scene.responses(&effects::build_all(&[]).unwrap(), &all, None).unwrap();
    let (mut miss, mut size) = (0.0, 0.0);
    for (g, group) in scene.groups.iter().enumerate() {
        for (r, record) in group.records.iter().enumerate() {
            for k in 0..group.frequencies_hz.len() {
                let model = responses.records[g][r].motion[3 * k + 2];
                miss += (model - record.channels[3][k]).norm_sqr();
                size += record.channels[3][k].norm_sqr();
            }
        }
    }
    (miss / size).sqrt()
}

#[test]
fn weak_motion_of_the_hyperbolic_column_is_that_of_the_nonlinear_one() {
    let (weak, strong) = (against_nonlinear(0.002), against_nonlinear(1.0));
    println!("relative miss at the surface: weak {weak:.3}, strong {strong:.3} (step {STEP_S} s)");
    assert!(weak < 0.08);
    assert!(strong < 0.6);
}

#[test]
fn an_effect_changes_the_fast_column_as_it_changes_the_nonlinear_one() {
    let array = array();
    let mut problem = problem(&array, &[], Truth { elements: 60, max_step_s: 0.005, seed: 6, events: 4 });
    for event in &mut problem.events {
        event.input.iter_mut().for_each(|a| *a *= 0.1);
    }
    let slow = [table("kind = 'layer_velocity'\nln_factor = -0.08\ntop_m = 0.0\nbottom_m = 6.0")];
    let replays = crate::support::Replays(&problem);
    let (before, after) = (replays.replay(&[]).unwrap(), replays.replay(&slow).unwrap());
    let scene = Scene::new(&problem, &settings()).unwrap();
    let all: Vec<usize> = (0..scene.groups.len()).collect();
    let at = |tables: &[toml::Table]| scene.responses(&effects::build_all(tables).unwrap(), &all, None).unwrap();
    let (fast_before, fast_after) = (at(&[]), at(&slow));
    let (mut miss, mut size) = (0.0, 0.0);
    for (g, group) in scene.groups.iter().enumerate() {
        for (r, record) in group.records.iter().enumerate() {
            let e = record.event;
            let bins = |x: &[f64]| scene.bins(g, r, x);
            let nonlinear = [&before, &after].map(|runs| bins(&runs[e].as_ref().unwrap()[2]));
            for (k, (start, end)) in nonlinear[0].iter().zip(&nonlinear[1]).enumerate() {
                let fast = [&fast_before, &fast_after].map(|x| x.records[g][r].motion[3 * k + 2]);
                let predicted = start + fast[1] - fast[0];
                miss += (predicted - end).norm_sqr();
                size += (end - start).norm_sqr();
            }
        }
    }
    let share = (miss / size).sqrt();
    println!("the fast column predicts the nonlinear column's change within {:.0} %", 100.0 * share);
    assert!(share < 0.6);
}
