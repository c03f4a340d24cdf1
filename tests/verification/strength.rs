//! Mohr–Coulomb and Cam-Clay against their closed-form strengths.

use crate::laws::{build, follow};
use flare_pipe::soil::{Increment, Point};

fn point(horizontal_pa: f64) -> Point {
    Point { depth_m: 6.0, density_kg_m3: 1700.0, vs_m_s: 90.0, vertical_pa: 100e3, horizontal_pa }
}

#[test]
fn undrained_cam_clay_reaches_the_exact_critical_state() {
    let (lambda, kappa, m) = (0.18675, 0.01737, 1.2);
    for ocr in [1.2, 2.0, 4.0] {
        let law = build("cam_clay", &format!("ocr = {ocr}"));
        // Isotropic start; constant volume: p_f = ½ p_c (p₀/(½p_c))^(κ/λ) and τ_f = M p_f/√3.
        let (response, _) = follow(law.as_ref(), &point(100e3), Increment::new(2e-4, 0.0), 4000);
        let (p0, pc): (f64, f64) = (100e3, ocr * 100e3);
        let p_f = 0.5 * pc * (2.0 * p0 / pc).powf(kappa / lambda);
        let exact = m * p_f / 3.0_f64.sqrt();
        println!("OCR {ocr}: s_u {:.4} kPa, exact {:.4} kPa", response.tau_pa / 1e3, exact / 1e3);
        assert!((response.tau_pa / exact - 1.0).abs() < 2e-3);
    }
}

#[test]
fn mohr_coulomb_stays_on_the_pyramid_and_reaches_the_limit_load() {
    let law = build("mohr_coulomb", "dilation_angle_deg = 0.0\ncohesion_kpa = 5.0");
    let phi = 35.0_f64.to_radians();
    // No dilation and no volume change: p' in the plane stays; τ ends at the Mohr circle with σ_xx = σ_yy.
    let (response, state) = follow(law.as_ref(), &point(60e3), Increment::new(1e-4, 0.0), 2000);
    let centre = 0.5 * (state[0] + state[1]);
    let exact = 5e3 * phi.cos() + 0.5 * (100e3 + 60e3) * phi.sin();
    println!(
        "limit load {:.4} kPa, exact {:.4} kPa; sigma_xx {:.2} sigma_yy {:.2}",
        response.tau_pa / 1e3,
        exact / 1e3,
        state[0] / 1e3,
        state[1] / 1e3
    );
    assert!((centre - 80e3).abs() < 1.0);
    assert!((response.tau_pa / exact - 1.0).abs() < 1e-3);
}

#[test]
fn mohr_coulomb_in_tension_ends_at_the_apex() {
    let law = build("mohr_coulomb", "cohesion_kpa = 5.0");
    let (_, state) = follow(law.as_ref(), &point(60e3), Increment::new(0.0, 1e-3), 50);
    let apex = -5e3 / 35.0_f64.to_radians().tan();
    assert!(state[..3].iter().all(|x| (x - apex).abs() < 1e-6 * apex.abs()), "{state:?}");
}
