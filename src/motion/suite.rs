//! The suite of nonstationary band-limited random base motions.

use super::assignment::target_pga_m_s2;
use super::baseline::correct_baseline;
use super::settings::MotionSettings;
use crate::error::{Error, Result};
use crate::numerics::filter;
use crate::numerics::random;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Length of the fade at each end of a motion, s.
const RAMP_S: f64 = 0.25;
/// Share of the duration over which the shaking fades in and out before it is filtered.
const END_FADE_SHARE: f64 = 0.12;

/// One base motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Case number with three digits or more: `"001"`.
    pub id: String,
    /// Time step, s.
    pub dt_s: f64,
    /// Horizontal acceleration of the base, m/s².
    pub acceleration_m_s2: Vec<f64>,
}

impl Motion {
    /// Peak absolute acceleration, m/s².
    pub fn pga_m_s2(&self) -> f64 {
        self.acceleration_m_s2.iter().fold(0.0, |m, a| m.max(a.abs()))
    }
}

/// Identifier of case `number` (from 1).
pub fn case_id(number: usize) -> String {
    format!("{number:03}")
}

/// All motions of the suite, in case order; each depends on the seed and its own number only.
///
/// ```text
/// a(t) = e_1(t) n_1(t) + w e_2(t) n_2(t),   then band-pass, fade, baseline, one factor to the target PGA     (1)
/// n_k  white noise shaped by |H(f)|² = (1 + 4ζ²r²) / ((1 − r²)² + 4ζ²r²),  r = f / f_k                        (2)
/// e_k  rises as a half cosine, stays one over the strong part, decays exponentially                          (3)
/// ```
///
/// The second part starts later and is lower in frequency, so that the content moves in time as in a real record.
///
/// | symbol | setting      | unit | drawn                                |
/// |--------|--------------|------|--------------------------------------|
/// | f_1    | dominant_hz  | Hz   | log-uniform; f_2 = 0.4…0.8 f_1       |
/// | ζ      |              | –    | 0.15…0.7                             |
/// | e_1    | strong_share | –    | duration of the strong part, uniform |
/// | w      |              | –    | 0.3…0.9                              |
///
/// Limits: no site, magnitude or distance is implied; the spectrum is not matched to a target.
/// Check:  `motions_end_at_rest_without_drift`, `content_lies_in_the_band`, `peaks_are_the_targets`.
/// Source: (2) Kanai (1957), Tajimi (1960); (3) Jennings, Housner and Tsai (1968).
///
/// # Errors
/// When a setting is out of range.
pub fn suite(settings: &MotionSettings) -> Result<Vec<Motion>> {
    if let Some((key, what)) = settings.problems().into_iter().next() {
        return Err(Error::new(what).at(format!("`motions.{key}`")).usage());
    }
    Ok(target_pga_m_s2(settings)
        .into_par_iter()
        .enumerate()
        .map(|(i, pga_m_s2)| motion(settings, i + 1, pga_m_s2))
        .collect())
}

fn motion(settings: &MotionSettings, number: usize, pga_m_s2: f64) -> Motion {
    let id = case_id(number);
    let dt_s = settings.step_s;
    let n = (settings.duration_s / dt_s).round() as usize + 1;
    let mut rng = random::stream(settings.seed, &format!("motion {id}"));
    let mut between = |[low, high]: [f64; 2]| low + (high - low) * rng.random::<f64>();

    let [low, high] = settings.dominant_hz;
    let f_1 = low * (high / low).powf(between([0.0, 1.0]));
    let f_2 = f_1 * between([0.4, 0.8]);
    let (zeta_1, zeta_2) = (between([0.15, 0.7]), between([0.15, 0.5]));
    let strong_s = settings.duration_s * between(settings.strong_share);
    let rise_s = strong_s * between([0.2, 0.6]);
    let start_s = RAMP_S + between([0.0, 0.08]) * settings.duration_s;
    let decay_s = between([0.08, 0.2]) * settings.duration_s;
    let first = Envelope { start_s, rise_s, strong_s, decay_s };
    let late = Envelope { start_s: start_s + rise_s + 0.5 * strong_s, rise_s, strong_s: 0.5 * strong_s, decay_s };
    let weight = between([0.3, 0.9]);

    let mut noise = |f_0: f64, zeta: f64| {
        let white: Vec<f64> = (0..n).map(|_| StandardNormal.sample(&mut rng)).collect();
        let shaped = filter::zero_phase(&white, dt_s, |f| kanai_tajimi(f / f_0, zeta));
        let rms = (shaped.iter().map(|v| v * v).sum::<f64>() / n as f64).sqrt();
        shaped.into_iter().map(|v| v / rms).collect::<Vec<f64>>()
    };
    let (n_1, n_2) = (noise(f_1, zeta_1), noise(f_2, zeta_2));
    // Silence on both sides, so that what the filter spreads in time comes to rest.
    let mut raw = vec![0.0; 3 * n];
    for i in 0..n {
        let t = i as f64 * dt_s;
        raw[n + i] = first.at(t) * n_1[i] + weight * late.at(t) * n_2[i]; // (1)
    }
    filter::taper_ends(&mut raw[n..2 * n], (END_FADE_SHARE * n as f64) as usize);
    let filtered = filter::zero_phase(&raw, dt_s, |f| band(f, settings.low_hz, settings.high_hz));
    let mut a = filtered[n..2 * n].to_vec();
    filter::taper_ends(&mut a, (RAMP_S / dt_s) as usize);
    correct_baseline(&mut a, dt_s, RAMP_S);
    let peak = a.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    a.iter_mut().for_each(|v| *v *= pga_m_s2 / peak);
    Motion { id, dt_s, acceleration_m_s2: a }
}

/// Amplitude gain of the Kanai–Tajimi filter at the frequency ratio `r`.
fn kanai_tajimi(r: f64, zeta: f64) -> f64 {
    let d = (2.0 * zeta * r).powi(2);
    ((1.0 + d) / ((1.0 - r * r).powi(2) + d)).sqrt() // (2)
}

/// One in the band, falling by half cosines to zero at 0.6 of its lower and at 1.1 of its upper edge.
fn band(f_hz: f64, low_hz: f64, high_hz: f64) -> f64 {
    let edge = |x: f64| 0.5 * (1.0 - (std::f64::consts::PI * x.clamp(0.0, 1.0)).cos());
    edge((f_hz / low_hz - 0.6) / 0.4) * edge((1.1 - f_hz / high_hz) / 0.4)
}

/// Amplitude in time: rise, strong part, exponential decay.
struct Envelope {
    start_s: f64,
    rise_s: f64,
    strong_s: f64,
    decay_s: f64,
}

impl Envelope {
    fn at(&self, t_s: f64) -> f64 {
        let t = t_s - self.start_s;
        // (3)
        if t <= 0.0 {
            0.0
        } else if t < self.rise_s {
            0.5 * (1.0 - (std::f64::consts::PI * t / self.rise_s).cos())
        } else if t < self.rise_s + self.strong_s {
            1.0
        } else {
            (-(t - self.rise_s - self.strong_s) / self.decay_s).exp()
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::motion::Band;
    use crate::numerics::integrate;
    use crate::units::G_M_S2;
    use proptest::prelude::*;

    pub(crate) fn lotung() -> MotionSettings {
        toml::from_str(
            "count = 100\nseed = 1\nduration_s = 15.0\ntrain = '1-80'\nvalidation = '81-100'\n\
             bands = [{ count = 60, min_pga_g = 0.0075, max_pga_g = 0.02 }, { count = 20, min_pga_g = 0.02, max_pga_g = 0.06 }, \
             { count = 20, min_pga_g = 0.06, max_pga_g = 0.112 }]",
        )
        .unwrap()
    }

    #[test]
    fn motions_end_at_rest_without_drift() {
        for motion in suite(&lotung()).unwrap() {
            let (v, d) = integrate::twice(&motion.acceleration_m_s2, motion.dt_s);
            let peak = |x: &[f64]| x.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            assert!(v.last().unwrap().abs() < 1e-10 * peak(&v), "{}", motion.id);
            assert!(d.last().unwrap().abs() < 1e-10 * peak(&d), "{}", motion.id);
            // No slow wander either: the displacement stays within what the lowest frequency passed can give.
            assert!(peak(&d) < 2.0 * peak(&v) / (2.0 * std::f64::consts::PI * 0.3), "{}", motion.id);
            assert_eq!(motion.acceleration_m_s2.len(), 3001);
            assert!(motion.acceleration_m_s2[0].abs() < 1e-15);
        }
    }

    #[test]
    fn peaks_are_the_targets() {
        let settings = lotung();
        let motions = suite(&settings).unwrap();
        for (motion, target) in motions.iter().zip(target_pga_m_s2(&settings)) {
            assert!((motion.pga_m_s2() / target - 1.0).abs() < 1e-12);
        }
        let smallest = motions.iter().map(Motion::pga_m_s2).fold(f64::MAX, f64::min) / G_M_S2;
        let largest = motions.iter().map(Motion::pga_m_s2).fold(0.0, f64::max) / G_M_S2;
        assert!((0.0075..0.0078).contains(&smallest) && (0.109..0.112).contains(&largest), "{smallest} {largest}");
        assert_eq!((motions[0].id.as_str(), motions[99].id.as_str()), ("001", "100"));
    }

    #[test]
    fn content_lies_in_the_band() {
        for motion in suite(&lotung()).unwrap() {
            let inside = filter::zero_phase(&motion.acceleration_m_s2, motion.dt_s, |f| {
                f64::from(u8::from((0.18..10.0).contains(&f)))
            });
            let rms = |x: &[f64]| (x.iter().map(|v| v * v).sum::<f64>() / x.len() as f64).sqrt();
            let outside: Vec<f64> = inside.iter().zip(&motion.acceleration_m_s2).map(|(a, b)| a - b).collect();
            let share = rms(&outside) / rms(&motion.acceleration_m_s2);
            assert!(share < 0.04, "{}: {share}", motion.id);
        }
    }

    #[test]
    fn dominant_frequency_and_duration_vary_over_the_suite() {
        let motions = suite(&lotung()).unwrap();
        let (mut frequencies, mut durations) = (Vec::new(), Vec::new());
        for m in &motions {
            let a = &m.acceleration_m_s2;
            let energy = integrate::cumulative(&a.iter().map(|v| v * v).collect::<Vec<_>>(), m.dt_s);
            let total = energy[energy.len() - 1];
            let time_at = |share: f64| energy.iter().position(|e| *e >= share * total).unwrap() as f64 * m.dt_s;
            durations.push(time_at(0.95) - time_at(0.05));
            let crossings = a.windows(2).filter(|w| w[0] < 0.0 && w[1] >= 0.0).count();
            frequencies.push(crossings as f64 / 15.0);
        }
        let spread = |x: &[f64]| {
            let (q10, q90) = (crate::metrics::quantile(x, 0.1), crate::metrics::quantile(x, 0.9));
            (q10, q90)
        };
        let ((f10, f90), (d10, d90)) = (spread(&frequencies), spread(&durations));
        assert!(f90 / f10 > 1.6, "frequency {f10:.2}…{f90:.2} Hz");
        assert!(d90 / d10 > 1.4, "duration {d10:.2}…{d90:.2} s");
    }

    #[test]
    fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
        let settings = MotionSettings {
            count: 8,
            bands: vec![Band { count: 8, min_pga_g: 0.01, max_pga_g: 0.1 }],
            train: "1-6".into(),
            validation: "7-8".into(),
            ..lotung()
        };
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| suite(&settings).unwrap())
        };
        assert_eq!(on(1), on(3));
        assert_ne!(on(1), suite(&MotionSettings { seed: 2, ..settings.clone() }).unwrap());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn motions_of_any_sound_settings_end_at_rest(
            seed: u64, duration_s in 4.0f64..40.0, step_s in 0.002f64..0.01, low_hz in 0.26f64..1.0, share in 0.05f64..0.8,
        ) {
            let settings = MotionSettings {
                count: 1,
                seed,
                duration_s,
                step_s,
                bands: vec![Band { count: 1, min_pga_g: 0.01, max_pga_g: 0.1 }],
                train: "1".into(),
                validation: String::new(),
                low_hz,
                dominant_hz: [1.0, 5.0],
                strong_share: [share, share],
                ..lotung()
            };
            let motion = motion(&settings, 1, 0.7);
            let (v, d) = integrate::twice(&motion.acceleration_m_s2, motion.dt_s);
            let peak = |x: &[f64]| x.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            prop_assert!((motion.pga_m_s2() / 0.7 - 1.0).abs() < 1e-12);
            prop_assert!(v[v.len() - 1].abs() < 1e-9 * peak(&v) && d[d.len() - 1].abs() < 1e-9 * peak(&d));
        }
    }

    #[test]
    fn settings_out_of_range_are_all_reported() {
        let settings =
            MotionSettings { count: 99, step_s: 1.0, high_hz: 90.0, validation: "80-120".into(), ..lotung() };
        let keys: Vec<String> = settings.problems().into_iter().map(|(key, _)| key).collect();
        assert_eq!(keys, ["step_s", "high_hz", "bands", "validation"]);
        assert!(suite(&settings).is_err());
        assert!(lotung().problems().is_empty());
    }
}
