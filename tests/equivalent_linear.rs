//! The equivalent-linear column against the exact layered column and against the nonlinear one in weak and strong motion.

use flare_pipe::column::{Analysis, BaseMotion, Column, Features, Layer, Profile, Rayleigh, Vertical};
use flare_pipe::dataset::sensor_histories;
use flare_pipe::equivalent_linear::{Base, Compatible, Curves, EquivalentColumn, Nodes, Tuning, Wanted};
use flare_pipe::motion::{self, Band, MotionSettings};
use flare_pipe::numerics::grid::Grid;
use flare_pipe::numerics::resample::resample_band_limited;
use flare_pipe::soil::Relaxation;
use realfft::RealFftPlanner;
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

fn plain(layers: Vec<Layer>) -> Profile {
    Profile {
        layers,
        water_table_m: 1e3,
        vertical: Vertical::Free,
        rayleigh: Rayleigh::default(),
        elements: 100,
        features: Features::default(),
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
    let column = EquivalentColumn::new(&case.profile, elements, &Curves::default()).unwrap();
    let column = if case.is_dispersive { column } else { column.without_dispersion() };
    let nodes = Nodes::new(Grid::around(0.2, 10.0, column.grid_step_hz()));
    let march =
        column.march(&nodes, &vec![1e-5; column.n_element()], Wanted::Motions { depths_m: &[0.0] }, &Tuning::default());
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
        Profile { layers: layers.into(), water_table_m, vertical, rayleigh, elements: 100, ..plain(Vec::new()) }
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
    for alpha_1_s in [0.0, 2.0] {
        let rayleigh = Rayleigh { alpha_1_s, ..Rayleigh::default() };
        let profile = Profile { rayleigh, ..plain(vec![layer(10.0, 1900.0, 150.0)]) };
        let column = EquivalentColumn::new(&profile, 100, &Curves::default()).unwrap();
        let nodes = Nodes::new(Grid::around(0.2, 10.0, column.grid_step_hz()));
        let depths: Vec<f64> = vec![5.0, 5.1];
        let march = |wanted| column.march(&nodes, &vec![1e-5; column.n_element()], wanted, &Tuning::default());
        let (f, u) = (2.2, C64::new(0.01, 0.002));
        let mut motion = [C64::default(); 2];
        march(Wanted::Motions { depths_m: &depths }).response(f, &mut motion);
        let expected = ((motion[1] - motion[0]) * u).norm() / 0.1;
        let norm = march(Wanted::Strains).strain_norm(&[f], &[u]);
        let found = norm[(5.05 / 0.1) as usize];
        println!("strain {found:.4e}, from the motion {expected:.4e}");
        assert!((found / expected - 1.0).abs() < 0.02);
    }
}

/// Time step of the records, s.
const STEP_S: f64 = 0.02;
/// Time of rest after a motion, s.
const REST_S: f64 = 8.0;

/// A hyperbolic column of 17 m, velocities growing with depth, those of the upper six metres by a factor.
fn soft(factor: f64) -> Profile {
    let layers = [(3.0, 115.0 * factor), (3.0, 140.0 * factor), (5.0, 160.0), (6.0, 190.0)];
    let law = toml::Table::from_iter([("plasticity_index".to_string(), 10.0.into())]);
    let of = |(thickness_m, vs_m_s)| Layer {
        law_kind: "hyperbolic".into(),
        law: law.clone().into(),
        ..layer(thickness_m, 1900.0, vs_m_s)
    };
    Profile { elements: 60, water_table_m: 2.0, ..plain(layers.map(of).into()) }
}

/// Base motions that end at rest.
fn motions(scale: f64) -> Vec<Vec<f64>> {
    let settings = MotionSettings {
        count: 4,
        seed: 5,
        duration_s: 16.0,
        step_s: 0.005,
        bands: vec![Band { count: 4, min_pga_g: 0.01, max_pga_g: 0.09 }],
        train: "1".into(),
        validation: "2".into(),
        low_hz: 0.3,
        high_hz: 9.0,
        dominant_hz: [1.0, 5.0],
        strong_share: [0.25, 0.5],
    };
    let of = |m: &motion::Motion| {
        let mut x = resample_band_limited(&m.acceleration_m_s2, m.dt_s, STEP_S);
        x.resize(x.len() + (REST_S / STEP_S) as usize, 0.0);
        x.iter_mut().for_each(|x| *x *= scale);
        x
    };
    motion::suite(&settings).expect("motions").iter().map(of).collect()
}

/// Bins between 0.3 and 9 Hz: frequencies, and the spectrum there.
fn spectrum(x: &[f64]) -> (Vec<f64>, Vec<C64>) {
    let plan = RealFftPlanner::<f64>::new().plan_fft_forward(x.len());
    let mut out = plan.make_output_vec();
    plan.process(&mut x.to_vec(), &mut out).unwrap();
    let step_hz = 1.0 / (x.len() as f64 * STEP_S);
    let bins = out.into_iter().enumerate().map(|(k, x)| (k as f64 * step_hz, x));
    bins.filter(|(f, _)| (0.3..9.0).contains(f)).unzip()
}

/// Surface spectra of the nonlinear and of the equivalent-linear column.
fn surface(profile: &Profile, base: &[f64]) -> [Vec<C64>; 2] {
    let analysis = Analysis { max_step_s: 0.005, ..Analysis::default() };
    let column = Column::new(profile, &analysis).unwrap();
    let histories = sensor_histories(&column, BaseMotion { dt_s: STEP_S, acceleration_m_s2: base }, &[0.0]).unwrap();
    let mut nonlinear = resample_band_limited(&histories[1], analysis.output_step_s, STEP_S);
    nonlinear.resize(base.len(), 0.0);
    let (frequencies_hz, acceleration_m_s2) = spectrum(base);
    let velocity: Vec<f64> = base
        .iter()
        .scan(0.0, |v, a| {
            Some({
                *v += a * STEP_S;
                *v
            })
        })
        .collect();
    let rms = (velocity.iter().map(|v| v * v).sum::<f64>() / velocity.len() as f64).sqrt();
    let base = Base {
        frequencies_hz: &frequencies_hz,
        acceleration_m_s2: &acceleration_m_s2,
        samples: base.len(),
        peak_factor: velocity.iter().fold(0.0f64, |m, v| m.max(v.abs())) / rms,
    };
    let equivalent = EquivalentColumn::new(profile, 60, &Curves::default()).unwrap();
    let found = Compatible::new(equivalent, &base).motions(&base, &[0.0], &Tuning::default());
    [spectrum(&nonlinear).1, found.into_iter().next().unwrap()]
}

/// Root of the power of `a` − `b` over that of `size`, all motions together.
fn share<'x>(pairs: impl Iterator<Item = (C64, C64, &'x C64)>) -> f64 {
    let (miss, size) =
        pairs.fold((0.0, 0.0), |(miss, size), (a, b, s)| (miss + (a - b).norm_sqr(), size + s.norm_sqr()));
    (miss / size).sqrt()
}

#[test]
fn weak_motion_of_the_hyperbolic_column_is_that_of_the_nonlinear_one() {
    let [weak, strong] = [0.002, 1.0].map(|scale| {
        let found: Vec<_> = motions(scale).iter().map(|base| surface(&soft(1.0), base)).collect();
        share(found.iter().flat_map(|[fe, fast]| fe.iter().zip(fast).map(|(a, b)| (*a, *b, a))))
    });
    println!("relative miss at the surface: weak {weak:.3}, strong {strong:.3}");
    assert!(weak < 0.08);
    assert!(strong < 0.6);
}

#[test]
fn a_slower_layer_changes_the_equivalent_linear_column_as_it_changes_the_nonlinear_one() {
    // In weak motion, where one modulus and damping stand for the whole of it.
    let found: Vec<_> =
        motions(0.002).iter().map(|base| [1.0, (-0.08f64).exp()].map(|f| surface(&soft(f), base))).collect();
    let changes: Vec<[C64; 2]> = found
        .iter()
        .flat_map(|[before, after]| {
            let change = |which: usize| after[which].iter().zip(&before[which]).map(|(a, b)| a - b);
            change(0).zip(change(1)).map(|(fe, fast)| [fe, fast]).collect::<Vec<_>>()
        })
        .collect();
    let share = share(changes.iter().map(|[fe, fast]| (*fe, *fast, fe)));
    println!("the equivalent-linear column predicts the nonlinear column's change within {:.0} %", 100.0 * share);
    assert!(share < 0.25);
}

#[test]
fn tuning_brings_strong_motion_closer() {
    let base = &motions(1.0)[3];
    let (frequencies_hz, acceleration_m_s2) = spectrum(base);
    let [nonlinear, untuned] = surface(&soft(1.0), base);
    let base = Base {
        frequencies_hz: &frequencies_hz,
        acceleration_m_s2: &acceleration_m_s2,
        samples: base.len(),
        peak_factor: 3.0,
    };
    let column = EquivalentColumn::new(&soft(1.0), 60, &Curves::default()).unwrap();
    let column = Compatible::new(column, &base);
    let tuning = column.tuned(&base, &[0.0], std::slice::from_ref(&nonlinear));
    let tuned = column.motions(&base, &[0.0], &tuning);
    let miss = |of: &[C64]| share(nonlinear.iter().zip(of).map(|(a, b)| (*a, *b, a)));
    println!("miss {:.3}, tuned {:.3}", miss(&untuned), miss(&tuned[0]));
    assert!(miss(&tuned[0]) < miss(&untuned));
}

#[test]
fn modulus_and_damping_are_those_of_the_law_and_of_what_is_declared_for_small_strains() {
    let law = "damping_ratio = 0.03\ngamma_ref = 1e-3\ncurvature = 1.0".parse::<toml::Table>().unwrap();
    let one = Layer { law_kind: "hyperbolic".into(), law: law.into(), ..layer(20.0, 1900.0, 200.0) };
    let column = EquivalentColumn::new(&Profile { elements: 20, ..plain(vec![one]) }, 20, &Curves::default()).unwrap();
    let (modulus, damping) = column.modulus_and_damping(10.0, 1e-7, 1.0);
    assert!((modulus - 1.0).abs() < 0.01 && (damping - 0.03).abs() < 0.002, "{modulus} {damping}");
    let (modulus, damping) = column.modulus_and_damping(10.0, 1e-3, 1.0);
    assert!((modulus - 0.5).abs() < 0.08 && damping > 0.1, "{modulus} {damping}");
    // Rayleigh's dashpot β gives βω/2.
    let rayleigh = Rayleigh { alpha_1_s: 0.0, beta_s: 0.004 };
    let elastic = Profile { rayleigh, ..plain(vec![layer(20.0, 1900.0, 200.0)]) };
    let column = EquivalentColumn::new(&elastic, 20, &Curves::default()).unwrap();
    for f_hz in [1.0, 3.0] {
        let (modulus, damping) = column.modulus_and_damping(10.0, 1e-4, f_hz);
        assert!(modulus == 1.0 && (damping - 0.002 * TAU * f_hz).abs() < 1e-9, "{modulus} {damping}");
    }
}
