//! Random layers, laws, features and motions: never a panic, never a value that is not finite, failures typed.

use crate::robustness::motion;
use flare_pipe::column::{
    Analysis, Cause, Column, Container, Features, Layer, Profile, RateZone, Rayleigh, Slip, SofteningZone, Structure,
    Vertical,
};
use proptest::prelude::*;

/// Parameters within their ranges, for every law; what is out of joint (a geostatic stress beyond strength) is refused.
fn any_law() -> impl Strategy<Value = (String, toml::Table)> {
    let unit = || 0.0..1.0_f64;
    (0..5_usize, unit(), unit(), unit(), unit()).prop_map(|(kind, a, b, c, d)| {
        let (kind, text) = match kind {
            0 => ("elastic", format!("poisson_ratio = {}\ndamping_ratio = {}", 0.45 * a, 0.1 * b)),
            1 => (
                "hyperbolic",
                format!(
                    "plasticity_index = {}\nocr = {}\ncurvature = {}\nreduce_damping = {}",
                    100.0 * a,
                    1.0 + 9.0 * b,
                    0.7 + 0.5 * c,
                    d < 0.5
                ),
            ),
            2 => (
                "mohr_coulomb",
                format!(
                    "cohesion_kpa = {}\nfriction_angle_deg = {}\ndilation_angle_deg = {}",
                    20.0 * a,
                    20.0 + 20.0 * b,
                    15.0 * c
                ),
            ),
            3 => (
                "cam_clay",
                format!(
                    "lambda = {}\nkappa = {}\nm = {}\nocr = {}",
                    0.05 + 0.3 * a,
                    0.005 + 0.04 * b,
                    0.7 + 0.8 * c,
                    1.0 + 4.0 * d
                ),
            ),
            _ => (
                "sanisand",
                format!(
                    "e_ini = {}\nm = {}\nh_0 = {}\nviscosity_s = {}",
                    0.6 + 0.3 * a,
                    0.005 + 0.03 * b,
                    2.0 + 10.0 * c,
                    4e-4 * (d - 0.5).max(0.0)
                ),
            ),
        };
        (kind.to_string(), text.parse().expect("TOML"))
    })
}

fn any_layer() -> impl Strategy<Value = Layer> {
    (any_law(), 0.5..6.0, 1500.0..2200.0, 60.0..400.0, 0.45..0.9).prop_map(
        |((law_kind, law), thickness_m, density_kg_m3, vs_m_s, k0)| Layer {
            thickness_m,
            density_kg_m3,
            vs_m_s,
            k0,
            fineness: 1.0,
            law_kind,
            law: law.into(),
        },
    )
}

/// Nothing beyond layers half of the time; otherwise some of everything.
fn any_features() -> impl Strategy<Value = Features> {
    let some = (0.0..1.0, 0.0..8e3, 0.5..8.0, 0.5..2.0, 1e3..2e4, 0.0..1e4, 0.0..1.0, 0.0..0.2, 0.0..9.0).prop_map(
        |(q, mass_kg_m2, frequency_hz, depth_m, tau_max_pa, container, ru, rate, downgoing_corner_hz)| Features {
            base_impedance_ratio: q,
            downgoing_corner_hz,
            structure: Structure { mass_kg_m2, frequency_hz, damping_ratio: 0.05 },
            slips: vec![Slip { depth_m: 0.25 * depth_m, tau_max_pa }],
            container: Container { mass_kg_m2: container, stiffness_pa: 100.0 * container },
            softenings: vec![SofteningZone { top_m: 0.0, bottom_m: 5.0, ru_at_reference: ru, exponent: 1.5 }],
            rates: vec![RateZone { top_m: 1.0, bottom_m: 9.0, law_kind: None, per_log_cycle: rate }],
            boundaries: Vec::new(),
        },
    );
    prop_oneof![Just(Features::default()), some]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn any_column_ends_in_finite_numbers_or_a_typed_failure(
        layers in prop::collection::vec(any_layer(), 1..5),
        features in any_features(),
        is_free in any::<bool>(),
        water_table_m in 0.0..8.0,
        seed in 0_u64..1000,
        pga_g in 0.001..0.8,
    ) {
        let vertical = if is_free { Vertical::Free } else { Vertical::Restrained };
        let rayleigh = Rayleigh { alpha_1_s: 0.0, beta_s: 1e-4 };
        let profile = Profile { layers, water_table_m, vertical, rayleigh, elements: 24, features };
        let analysis = Analysis { min_step_s: 1e-4, ..Analysis::default() };
        let Ok(column) = Column::new(&profile, &analysis) else { return Ok(()) };
        let mut frames = 0;
        let result = column.run(0.005, &motion(seed, pga_g, 3.0), &mut |frame| {
            frames += 1;
            assert!(frame.surface_m_s2().is_finite() && frame.elements_m_s2.iter().all(|a| a.is_finite()));
            Ok(())
        });
        match result {
            Ok(_) => prop_assert_eq!(frames, 601),
            Err(failure) => {
                prop_assert!(failure.time_s >= 0.0 && failure.depth_m > 0.0);
                prop_assert!(!matches!(failure.cause, Cause::Input(_) | Cause::Sink(_)), "{}", failure);
            }
        }
    }
}

#[test]
fn a_motion_that_is_no_number_is_refused_and_a_sink_that_fails_is_told() {
    let profile = crate::support::lotung(20);
    let column = Column::new(&profile, &Analysis::default()).expect("a column");
    let failure = column.run(0.005, &[0.0, f64::NAN], &mut |_| Ok(())).expect_err("not finite");
    assert!(matches!(failure.cause, Cause::Input(_)));
    let full = || flare_pipe::Error::new("disk full");
    let failure = column.run(0.005, &[0.0; 10], &mut |_| Err(full())).expect_err("sink");
    assert!(matches!(failure.cause, Cause::Sink(_)));
}

#[test]
fn a_run_that_cannot_go_on_says_when_where_and_why() {
    let mut profile = crate::support::lotung(40);
    for layer in &mut profile.layers {
        layer.law = "max_substeps = 1\ntolerance = 1e-9".parse::<toml::Table>().expect("TOML").into();
    }
    let analysis = Analysis { min_step_s: 1e-3, ..Analysis::default() };
    let column = Column::new(&profile, &analysis).expect("a column");
    let mut last_s = -1.0;
    let failure = column
        .run(0.005, &motion(1, 0.5, 3.0), &mut |frame| {
            last_s = frame.time_s;
            Ok(())
        })
        .expect_err("one substep is too few");
    assert!(matches!(failure.cause, Cause::Law(_)), "{failure}");
    assert!(failure.time_s >= last_s && failure.time_s < last_s + 0.005 && (0.0..17.0).contains(&failure.depth_m));
    let text = flare_pipe::Error::from(failure).to_string();
    assert!(text.contains(" s, ") && text.contains(" m deep: the stress integration needs more substeps"), "{text}");
}
