//! Random layers, motions and parameters: never a panic, never a value that is not finite, failures typed.

use crate::robustness::motion;
use flare_pipe::column::{Analysis, Cause, Column, Features, Layer, Profile, Rayleigh, Vertical};
use proptest::prelude::*;

fn any_layer() -> impl Strategy<Value = Layer> {
    let kind = prop::sample::select(vec!["elastic", "hyperbolic", "mohr_coulomb", "cam_clay", "sanisand"]);
    (kind, 0.5..6.0, 1500.0..2200.0, 60.0..400.0, 0.45..0.9).prop_map(
        |(kind, thickness_m, density_kg_m3, vs_m_s, k0)| Layer {
            thickness_m,
            density_kg_m3,
            vs_m_s,
            k0,
            law_kind: kind.to_string(),
            law: toml::Table::new(),
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn any_column_ends_in_finite_numbers_or_a_typed_failure(
        layers in prop::collection::vec(any_layer(), 1..5),
        is_free in any::<bool>(),
        water_table_m in 0.0..8.0,
        seed in 0_u64..1000,
        pga_g in 0.001..0.8,
    ) {
        let vertical = if is_free { Vertical::Free } else { Vertical::Restrained };
        let rayleigh = Rayleigh { alpha_1_s: 0.0, beta_s: 1e-4 };
        let profile = Profile { layers, water_table_m, vertical, rayleigh, elements: 24, features: Features::default() };
        let analysis = Analysis { min_step_s: 1e-4, ..Analysis::default() };
        let Ok(column) = Column::new(&profile, &analysis) else { return Ok(()) };
        let mut frames = 0;
        let result = column.run(0.005, &motion(seed, pga_g, 3.0), &mut |frame| {
            frames += 1;
            assert!(frame.surface_m_s2.is_finite() && frame.elements_m_s2.iter().all(|a| a.is_finite()));
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
