//! Linear columns on a rigid base against the exact transfer function, amplitude and phase, and fitted orders.

use crate::support::{layer, profile, rayleigh, shake};
use flare_pipe::column::{Analysis, Layer, MassMatrix, Profile, Rayleigh};
use std::f64::consts::{PI, TAU};

/// Real and imaginary part.
pub type Complex = [f64; 2];

/// a · b.
pub fn mul(a: Complex, b: Complex) -> Complex {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

/// a / b.
pub fn div(a: Complex, b: Complex) -> Complex {
    let d = b[0] * b[0] + b[1] * b[1];
    [(a[0] * b[0] + a[1] * b[1]) / d, (a[1] * b[0] - a[0] * b[1]) / d]
}

/// √a.
pub fn sqrt(a: Complex) -> Complex {
    let r = a[0].hypot(a[1]);
    let re = (0.5 * (r + a[0])).max(0.0).sqrt();
    [re, (0.5 * (r - a[0])).max(0.0).sqrt().copysign(a[1])]
}

/// cos a, sin a.
pub fn cos_sin(a: Complex) -> (Complex, Complex) {
    let (s, c) = a[0].sin_cos();
    ([c * a[1].cosh(), -s * a[1].sinh()], [s * a[1].cosh(), c * a[1].sinh()])
}

/// Absolute surface over base acceleration of Rayleigh-damped layers. With w relative to the base and mass damping on w,
/// w − w_p with w_p = −ω²/(ω² − iωα) obeys the homogeneous equation with k² = (ω² − iωα) ρ/(G(1 + iωβ)).
fn exact(profile: &Profile, f_hz: f64) -> Complex {
    exact_with(profile, f_hz, |_| [1.0, TAU * f_hz * profile.rayleigh.beta_s])
}

/// The same with the complex modulus of each layer over ρVs².
pub fn exact_with(profile: &Profile, f_hz: f64, modulus: impl Fn(&Layer) -> Complex) -> Complex {
    let w = TAU * f_hz;
    let rate = [w * w, -w * profile.rayleigh.alpha_1_s];
    let particular = div([-w * w, 0.0], rate);
    // Displacement and traction from the free surface down.
    let (mut y, mut tau) = ([1.0, 0.0], [0.0, 0.0]);
    for layer in &profile.layers {
        let Layer { thickness_m, density_kg_m3, vs_m_s, .. } = layer;
        let g = modulus(layer).map(|m| m * density_kg_m3 * vs_m_s * vs_m_s);
        let k = sqrt(div(rate.map(|x| x * density_kg_m3), g));
        let (c, s) = cos_sin(k.map(|x| x * thickness_m));
        let gk = mul(g, k);
        let (a, b) = (mul(c, y), div(mul(s, tau), gk));
        let (d, e) = (mul(mul(gk, s), y), mul(c, tau));
        y = [a[0] + b[0], a[1] + b[1]];
        tau = [e[0] - d[0], e[1] - d[1]];
    }
    let homogeneous = div([1.0, 0.0], y);
    let w_surface = mul([-particular[0], -particular[1]], homogeneous);
    [1.0 + particular[0] + w_surface[0], particular[1] + w_surface[1]]
}

/// Fourier transform of samples at one frequency.
pub fn transform(x: &[f64], dt_s: f64, f_hz: f64) -> Complex {
    let mut sum = [0.0; 2];
    for (k, x) in x.iter().enumerate() {
        let (s, c) = (TAU * f_hz * k as f64 * dt_s).sin_cos();
        sum = [sum[0] + x * c, sum[1] - x * s];
    }
    sum
}

/// A Ricker wavelet around `f_hz`.
pub fn pulse(dt_s: f64, duration_s: f64, f_hz: f64) -> Vec<f64> {
    let n = (duration_s / dt_s).round() as usize + 1;
    (0..n)
        .map(|k| {
            let x = (PI * f_hz * (k as f64 * dt_s - 1.2 / f_hz)).powi(2);
            0.1 * (1.0 - 2.0 * x) * (-x).exp()
        })
        .collect()
}

/// 6 m of soft over 10 m of stiffer ground, linear.
pub fn two_layers(elements: usize, rayleigh: Rayleigh) -> Profile {
    let layers = vec![layer(6.0, 1800.0, 120.0, "elastic", ""), layer(10.0, 2000.0, 220.0, "elastic", "")];
    profile(layers, elements, 1e3, rayleigh)
}

/// Constant steps, solved tightly.
pub fn analysis(dt_s: f64) -> Analysis {
    Analysis { initial_step_s: dt_s, max_step_s: dt_s, output_step_s: dt_s, tolerance: 1e-10, ..Analysis::default() }
}

/// Largest relative miss of the complex transfer function at these frequencies.
fn transfer_miss(profile: &Profile, dt_s: f64, frequencies_hz: &[f64]) -> f64 {
    transfer_miss_with(profile, &analysis(dt_s), frequencies_hz)
}

fn transfer_miss_with(profile: &Profile, analysis: &Analysis, frequencies_hz: &[f64]) -> f64 {
    let dt_s = analysis.max_step_s;
    let base = pulse(dt_s, 40.0, 3.0);
    let (rows, _) = shake(profile, analysis, dt_s, &base);
    let surface: Vec<f64> = rows.iter().map(|r| r[0]).collect();
    let miss = |f: &f64| {
        let ours = div(transform(&surface, dt_s, *f), transform(&base, dt_s, *f));
        let truth = exact(profile, *f);
        (ours[0] - truth[0]).hypot(ours[1] - truth[1]) / truth[0].hypot(truth[1])
    };
    frequencies_hz.iter().map(miss).fold(0.0, f64::max)
}

/// Least-squares slope of ln(error) over ln(size).
pub fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let (x, y): (Vec<f64>, Vec<f64>) = points.iter().map(|(h, e)| (h.ln(), e.ln())).unzip();
    let (mx, my) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let top: f64 = x.iter().zip(&y).map(|(x, y)| (x - mx) * (y - my)).sum();
    top / x.iter().map(|x| (x - mx) * (x - mx)).sum::<f64>()
}

#[test]
fn rigid_base_column_matches_the_exact_transfer_function_in_amplitude_and_phase() {
    let damped = two_layers(100, rayleigh(0.05, 1.0, 10.0));
    let miss = transfer_miss(&damped, 0.001, &[0.5, 1.0, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0]);
    println!("damped: complex transfer function within {miss:.2e}");
    assert!(miss < 5e-3);
    // Undamped, the coda does not end; away from resonance a little damping at all frequencies shows the same column.
    let nearly = two_layers(100, rayleigh(0.02, 1.0, 10.0));
    assert!(transfer_miss(&nearly, 0.001, &[0.5, 1.0, 1.5, 5.0]) < 1e-2);
}

#[test]
fn error_falls_with_the_square_of_the_element_height() {
    let points: Vec<(f64, f64)> = [8, 16, 32]
        .into_iter()
        .map(|n| (1.0 / n as f64, transfer_miss(&two_layers(n, rayleigh(0.05, 1.0, 10.0)), 0.0005, &[1.0, 3.0, 5.0])))
        .collect();
    let order = slope(&points);
    println!("spatial order {order:.3} from {points:?}");
    assert!((order - 2.0).abs() < 0.15);
}

#[test]
fn with_matched_mass_half_the_elements_and_twice_the_step_are_as_exact() {
    let of = |elements: usize, dt_s: f64, mass: MassMatrix| {
        let column = two_layers(elements, rayleigh(0.05, 1.0, 10.0));
        let analysis = Analysis { mass, max_jump: f64::INFINITY, ..analysis(dt_s) };
        transfer_miss_with(&column, &analysis, &[1.0, 3.0, 5.0, 8.0])
    };
    // Elements that the slower waves cross in 1.7 steps, where all cancels, and in 1.1, where the largest share does not suffice.
    for (elements, dt_s, is_as_exact) in [(16, 0.005, true), (32, 0.0025, true), (24, 0.005, false)] {
        let matched = of(elements, dt_s, MassMatrix::Matched);
        let lumped = of(elements, dt_s, MassMatrix::Lumped);
        let finer = of(2 * elements, 0.5 * dt_s, MassMatrix::Lumped);
        println!(
            "{elements} elements, {dt_s} s: matched {matched:.1e}, lumped {lumped:.1e}, twice as fine {finer:.1e}"
        );
        assert!(if is_as_exact { matched < finer } else { matched < 0.6 * lumped });
    }
}

#[test]
fn elements_are_worth_more_where_waves_are_short() {
    let miss = |fineness: f64| {
        let rock = Layer { fineness, ..layer(24.0, 2000.0, 500.0, "elastic", "") };
        let layers = vec![layer(6.0, 1800.0, 100.0, "elastic", ""), rock];
        transfer_miss(&profile(layers, 40, 1e3, rayleigh(0.05, 1.0, 10.0)), 0.0005, &[2.0, 5.0, 8.0])
    };
    let [even, graded] = [1.0, 0.2].map(miss);
    println!("40 elements of one height {even:.2e}, of so many a wave {graded:.2e}");
    // 22 instead of 8 in the slow layer, 18 instead of 32 in the fast one.
    assert!(graded < 0.5 * even);
}

#[test]
fn error_falls_with_the_square_of_the_time_step() {
    // The same mesh throughout: against a run with a step so small that only the mesh error is left in both.
    let profile = two_layers(16, rayleigh(0.05, 1.0, 10.0));
    let surface = |dt: f64| -> Vec<f64> {
        let (rows, _) = shake(&profile, &analysis(dt), dt, &pulse(dt, 3.0, 3.0));
        let every = (0.02 / dt).round() as usize;
        rows.iter().step_by(every).map(|r| r[0]).collect()
    };
    let fine = surface(0.000_125);
    let points: Vec<(f64, f64)> =
        [0.004, 0.002, 0.001].iter().map(|dt| (*dt, crate::support::relative_rms(&surface(*dt), &fine))).collect();
    let order = slope(&points);
    println!("temporal order {order:.3} from {points:?}");
    assert!((order - 2.0).abs() < 0.15);
}

#[test]
fn free_vibration_of_two_layers_has_the_exact_period() {
    // tan(k₁h₁)·tan(k₂h₂) = G₂k₂/(G₁k₁), lowest root by bisection.
    let residual = |w: f64| {
        let (k1, k2) = (w / 120.0, w / 220.0);
        (k1 * 6.0).tan() * (k2 * 10.0).tan() - (2000.0 * 220.0) / (1800.0 * 120.0)
    };
    let (mut low, mut high) = (1.0, PI / 2.0 * 120.0 / 6.0 * 0.8);
    for _ in 0..100 {
        let mid = 0.5 * (low + high);
        if residual(mid) < 0.0 { low = mid } else { high = mid }
    }
    let exact_hz = low / TAU;
    let dt_s = 0.001;
    let profile = two_layers(100, Rayleigh { alpha_1_s: 0.0, beta_s: 2e-3 });
    let (rows, _) = shake(&profile, &analysis(dt_s), dt_s, &{
        let mut base = pulse(dt_s, 12.0, 2.0);
        base.iter_mut().skip(1400).for_each(|a| *a = 0.0);
        base
    });
    let coda: Vec<f64> = rows[3000..].iter().map(|r| r[0]).collect();
    let crossings: Vec<f64> = (1..coda.len())
        .filter(|k| coda[k - 1] < 0.0 && coda[*k] >= 0.0)
        .map(|k| k as f64 - coda[k] / (coda[k] - coda[k - 1]))
        .collect();
    let n = crossings.len() - 1;
    let hz = n as f64 / ((crossings[n] - crossings[0]) * dt_s);
    println!("free vibration {hz:.4} Hz, exact {exact_hz:.4} Hz");
    assert!((hz / exact_hz - 1.0).abs() < 2e-3);
}

#[test]
fn linear_column_agrees_with_the_independent_one() {
    let Some(reference) = crate::reference::columns("linear_dt0.00125_tf.csv") else { return };
    let h = 0.085;
    let soil = |count: f64, vs: f64| layer(count * h, 1900.0, vs, "elastic", "");
    let layers = vec![soil(24.0, 120.0), soil(47.0, 140.0), soil(58.0, 165.0), soil(71.0, 190.0)];
    let profile = profile(layers, 200, 1e3, rayleigh(0.05, 1.0, 10.0));
    let amplitude = |f: f64| {
        let h = exact(&profile, f);
        h[0].hypot(h[1])
    };
    let miss = |k: usize| {
        reference[0].iter().zip(&reference[k]).map(|(f, a)| (amplitude(*f) / a - 1.0).abs()).fold(0.0, f64::max)
    };
    println!("closed form against the reference's closed form {:.2e}, its elements {:.2e}", miss(1), miss(4));
    assert!(miss(1) < 1e-5);
    let elements = transfer_miss(&profile, 0.001, &[0.6, 1.0, 2.0, 3.0, 4.0, 5.0]);
    println!("our elements against the closed form to 5 Hz: {elements:.2e}");
    assert!(elements < 4e-3);
}
