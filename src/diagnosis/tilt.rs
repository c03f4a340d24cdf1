//! Sensors that tilt: far below the first resonance a column moves as one, and what one sensor has there that another has not is
//! no soil's.

use super::interference::added;
use super::low_frequency::{Error, jackknife, travel_s};
use super::problem::{Event, Problem};
use super::standing;
use crate::effects::{self, Array, Effect};
use crate::error::Result;
use realfft::RealFftPlanner;
use realfft::num_complex::Complex;
use std::borrow::Cow;
use toml::{Table, Value};

type C64 = Complex<f64>;

/// The effect.
pub(super) const KIND: &str = "baseline_tilt";
/// Tilt that any instrument may have, °.
pub(super) const FIELD_DEG: f64 = 0.01;
/// Highest frequency compared, Hz, and over the declared first resonance.
const HIGHEST: [f64; 2] = [0.3, 0.15];
/// Fewest records that tell anything.
const FEWEST: usize = 4;
/// Tilt whose course is compared, °.
const UNIT_DEG: f64 = 0.1;
/// Estimates in turn of the tilt and of the noise around it.
const STEPS: usize = 6;

/// Tilt of each output sensor of `problem` against the input sensor, °.
///
/// ```text
/// Y − U = θ H + n,   H the spectrum of g h(t) for 1°                     (1)
/// θ = Σ_e Re⟨Y − U, H⟩/S_e / Σ_e |H|²/S_e                                (2)
/// ```
///
/// Y and U are the records of output and input sensor up to 0.3 Hz, the mean left out, h the course of a tilt that grows with the
/// energy of the shaking, S_e what (1) leaves of record e. Soil as far off as may be, wrong gains and instruments that filter leave
/// what has any sign, and count as noise n.
///
/// Check:  `a_tilt_is_found_under_a_profile_that_is_far_off`.
/// Source: `baseline_tilt` for h(t).
///
/// # Errors
/// When the effect is not registered.
pub fn tilts(problem: &Problem) -> Result<Vec<Error>> {
    let array = &problem.array;
    let highest_hz = HIGHEST[0].min(HIGHEST[1] * 0.25 / travel_s(&array.profile, array.profile.depth_m()));
    let nothing = Error { value: 0.0, deviation: 0.0 };
    let of = |(s, sensor): (usize, &String)| {
        let unit = effects::build_all(&[table(sensor, UNIT_DEG)])?;
        let compared = |event: &Event| compared(array, &unit, event, s, highest_hz);
        let pairs: Vec<(&str, Pair)> =
            problem.events.iter().filter_map(|e| Some((e.name.as_str(), compared(e)?))).collect();
        Ok(if pairs.len() < FEWEST { nothing } else { tilt(&pairs) })
    };
    array.outputs.iter().enumerate().map(of).collect()
}

/// `problem` with its records freed of what the instruments of `tables` add.
///
/// # Errors
/// When an effect cannot be built.
pub fn without<'a>(problem: &'a Problem, tables: &[Table]) -> Result<Cow<'a, Problem>> {
    let effects = effects::build_all(tables)?;
    let mut cleaned = Cow::Borrowed(problem);
    for e in 0..problem.events.len() {
        for channel in 0..=problem.array.outputs.len() {
            let Some(added) = added(&problem.array, &effects, &problem.events[e], channel) else { continue };
            let event = &mut cleaned.to_mut().events[e];
            let record = if channel == 0 { &mut event.input } else { &mut event.outputs[channel - 1] };
            record.iter_mut().zip(added).for_each(|(x, a)| *x -= a);
        }
    }
    Ok(cleaned)
}

/// The effect that tilts `sensor`.
pub fn table(sensor: &str, tilt_deg: f64) -> Table {
    let mut table = standing::table(KIND, sensor);
    table.insert("tilt_deg".into(), Value::from(tilt_deg));
    table
}

/// Y − U and H of one record.
struct Pair {
    apart: Vec<C64>,
    course: Vec<C64>,
}

fn compared(array: &Array, unit: &[Box<dyn Effect>], event: &Event, s: usize, highest_hz: f64) -> Option<Pair> {
    let course = added(array, unit, event, s + 1)?;
    let n = event.input.len();
    let last = (highest_hz * n as f64 * event.dt_s).floor() as usize;
    let plan = RealFftPlanner::<f64>::new().plan_fft_forward(n);
    let spectrum = |mut x: Vec<f64>| {
        let mut out = plan.make_output_vec();
        plan.process(&mut x, &mut out).ok()?;
        Some(out.get(1..=last)?.to_vec())
    };
    let apart = event.outputs.get(s)?.iter().zip(&event.input).map(|(y, u)| y - u).collect();
    let pair = Pair { apart: spectrum(apart)?, course: spectrum(course.iter().map(|h| h / UNIT_DEG).collect())? };
    (!pair.course.is_empty()).then_some(pair)
}

/// (2), with the larger of its formal standard deviation and that of leaving events out.
fn tilt(pairs: &[(&str, Pair)]) -> Error {
    let power = |x: &[C64]| x.iter().map(C64::norm_sqr).sum::<f64>();
    let mut noise: Vec<f64> = pairs.iter().map(|(_, p)| power(&p.apart).max(f64::MIN_POSITIVE)).collect();
    let fit = |noise: &[f64], left_out: Option<&str>| {
        let (mut product, mut square) = (0.0, 0.0);
        for ((_, p), s) in pairs.iter().zip(noise).filter(|((name, _), _)| Some(*name) != left_out) {
            product += p.apart.iter().zip(&p.course).map(|(d, h)| (d * h.conj()).re).sum::<f64>() / s;
            square += power(&p.course) / s;
        }
        [product / square, square]
    };
    for _ in 0..STEPS {
        let [value, _] = fit(&noise, None);
        for (s, (_, p)) in noise.iter_mut().zip(pairs) {
            let left: Vec<C64> = p.apart.iter().zip(&p.course).map(|(d, h)| d - h * value).collect();
            // Two numbers a bin, one of which the tilt may have taken.
            *s = power(&left) / (p.apart.len() as f64 - 0.5);
        }
    }
    let [value, square] = fit(&noise, None);
    let mut names: Vec<&str> = pairs.iter().map(|(name, _)| *name).collect();
    names.dedup();
    let without: Vec<f64> = names.iter().map(|name| fit(&noise, Some(name))[0]).collect();
    // |H|²/S counts each bin once, and S is the variance of both its numbers together.
    Error { value, deviation: (0.5 / square).sqrt().max(jackknife(&without)) }
}

#[cfg(test)]
mod tests {
    use super::super::made_up::{judged, problem};
    use super::super::settings::DiagnoseSettings;
    use super::super::standing::standing;
    use super::*;

    #[test]
    fn a_tilt_is_found_under_a_profile_that_is_far_off() {
        let settings = DiagnoseSettings::default();
        for (sensor, tilt_deg) in [("top", 0.1), ("mid", -0.2), ("base", 0.15)] {
            let text = format!("kind = 'baseline_tilt'\nsensor = '{sensor}'\ntilt_deg = {tilt_deg:?}");
            let found = standing(&problem(&text), None, &settings).unwrap();
            assert_eq!(found.len(), 1, "{text}: {found:?}");
            let found = &found[0].found;
            assert_eq!((found.kind.as_str(), found.target.as_str()), (KIND, sensor));
            let estimate = &found.parameters["tilt_deg"];
            assert!((estimate.value - tilt_deg).abs() < 0.02, "{text}: {estimate:?}");
            assert!((estimate.ci95[0]..estimate.ci95[1]).contains(&tilt_deg), "{text}: {estimate:?}");
            let known = Problem { declared: vec![table(sensor, tilt_deg)], ..judged(&text) };
            assert!(standing(&known, None, &settings).unwrap().is_empty(), "{text} is declared");
        }
    }

    #[test]
    fn what_filters_or_amplifies_does_not_tilt() {
        for text in [
            "",
            "kind = 'instrument_high_pass'\nsensor = 'top'\ncorner_hz = 0.15",
            "kind = 'sensor_gain'\nsensor = 'top'\nln_gain = 0.3",
            "kind = 'sensor_polarity'\nsensor = 'base'\ncomponent = 'NS'",
        ] {
            let found = standing(&problem(text), None, &DiagnoseSettings::default()).unwrap();
            assert!(found.iter().all(|s| s.found.kind != KIND), "{text}: {found:?}");
        }
    }
}
