//! Noise of each sensor: as declared, as its record shows it before the event, or as is usual.

use super::problem::{NoiseSource, NoiseSpectrum};
use crate::metrics::{median, rms};
use crate::numerics::filter;
use crate::records::{DeclaredNoise, Record, Sensor};
use realfft::RealFftPlanner;
use std::f64::consts::PI;

/// Shortest quiet stretch before the event that tells noise, s.
const QUIET_S: f64 = 4.0;
/// Blocks by which the quiet stretch is followed, s.
const BLOCK_S: f64 = 1.0;
/// Growth of a block's RMS over the median of those before that ends the quiet stretch.
const GROWTH: f64 = 2.5;
/// Largest RMS of a block of the quiet stretch over the peak; more is the coda of an earlier event, to which the soil responds.
const QUIET_SHARE: f64 = 0.02;
/// Segments of the averaged spectrum, s.
const SEGMENT_S: f64 = 2.56;
/// Amplitude over that of noise from which a frequency counts as signal, as is usual in the processing of accelerograms.
const SIGNAL: f64 = 3.0;
/// Noise where nothing tells it, as a share of the RMS of a record.
pub const USUAL_SHARE: f64 = 0.01;

/// Noise of every sensor of `record`, the input sensor first.
///
/// ```text
/// S(f) = 2 Δt / Σ w² · mean over segments of |F[w x](f)|²               (1)
/// ```
///
/// over the stretch before the event where no sensor's RMS grows. Where there is no such stretch of four seconds it is taken as white, a
/// hundredth of the record's RMS: processing may have emptied any band, so that none of them tells it.
///
/// Check:  `white_noise_is_found_before_the_event`, `what_processing_emptied_tells_no_noise`, `coloured_noise_keeps_its_colour`.
/// Source: Welch (1967), doi 10.1109/TAU.1967.1161901.
/// `declared` noise is taken as it is declared.
pub fn noise(record: &Record, declared: Option<DeclaredNoise>) -> Vec<NoiseSpectrum> {
    if let Some(declared) = declared {
        let of = |x: &[f64]| NoiseSpectrum::white(declared.deviation_m_s2(rms(x)), record.dt_s, NoiseSource::Declared);
        return record.sensors().map(|s| of(&s.acceleration_m_s2)).collect();
    }
    let quiet = quiet_samples(record);
    let of = |x: &[f64]| match quiet {
        Some(n) => averaged(&x[..n], record.dt_s),
        None => {
            let deviation = (USUAL_SHARE * rms(x)).max(f64::MIN_POSITIVE.sqrt());
            NoiseSpectrum::white(deviation, record.dt_s, NoiseSource::Usual)
        }
    };
    record.sensors().map(|s| of(&s.acceleration_m_s2)).collect()
}

/// Frequencies between which the motion of each sensor of `record` is three times its noise, Hz; `None` where it nowhere is, or where
/// nothing tells the noise.
pub fn signal_band_hz(record: &Record, declared: Option<DeclaredNoise>) -> Vec<Option<[f64; 2]>> {
    let of = |(sensor, noise): (&Sensor, NoiseSpectrum)| {
        let power = averaged(&sensor.acceleration_m_s2, record.dt_s);
        let at = |k: usize| k as f64 * power.step_hz;
        let ratio = |k: usize| power.power[k] / noise.at(at(k)).max(f64::MIN_POSITIVE);
        let bins = 1..power.power.len();
        let highest = bins.clone().max_by(|a, b| ratio(*a).total_cmp(&ratio(*b)))?;
        let is_signal = |k: &usize| ratio(*k) >= SIGNAL * SIGNAL;
        let low = (1..=highest).rev().take_while(is_signal).last()?;
        let high = (highest..bins.end).take_while(is_signal).last()?;
        (noise.source != NoiseSource::Usual).then(|| [at(low), at(high)])
    };
    record.sensors().zip(noise(record, declared)).map(of).collect()
}

/// Samples before the first block in which a sensor's motion grows; `None` where they are too few.
fn quiet_samples(record: &Record) -> Option<usize> {
    let block = (BLOCK_S / record.dt_s).round().max(1.0) as usize;
    let quiet_of = |x: &[f64]| {
        let fast = filter::zero_phase(x, record.dt_s, |f| 1.0 - 1.0 / (1.0 + (f / 0.5).powi(8)));
        let peak = fast.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let blocks: Vec<f64> = fast.chunks_exact(block).map(rms).collect();
        let grows = |(i, r): (usize, &f64)| *r > GROWTH * median(&blocks[..i.max(1)]) || *r > QUIET_SHARE * peak;
        // The block before the growth may already hold its beginning.
        blocks.iter().enumerate().position(grows).unwrap_or(blocks.len()).saturating_sub(1) * block
    };
    let shortest = record.sensors().map(|s| quiet_of(&s.acceleration_m_s2)).min()?;
    (shortest as f64 * record.dt_s >= QUIET_S).then_some(shortest)
}

/// Segments of `x` half a length apart, each as in (1) before the mean; and their length.
fn segments(x: &[f64], dt_s: f64) -> (Vec<Vec<f64>>, usize) {
    let length = ((SEGMENT_S / dt_s).round() as usize).clamp(2, x.len().max(2));
    let window: Vec<f64> =
        (0..length).map(|i| 0.5 - 0.5 * (2.0 * PI * (i as f64 + 0.5) / length as f64).cos()).collect();
    let scale = 2.0 * dt_s / window.iter().map(|w| w * w).sum::<f64>();
    let plan = RealFftPlanner::<f64>::new().plan_fft_forward(length);
    let mut spectrum = plan.make_output_vec();
    let mut found = Vec::new();
    for start in (0..(x.len() + 1).saturating_sub(length)).step_by((length / 2).max(1)) {
        let segment = &x[start..start + length];
        let mean = segment.iter().sum::<f64>() / length as f64;
        let mut tapered: Vec<f64> = segment.iter().zip(&window).map(|(x, w)| (x - mean) * w).collect();
        plan.process(&mut tapered, &mut spectrum).expect("buffers made by the plan itself");
        found.push(spectrum.iter().map(|v| scale * v.norm_sqr()).collect());
    }
    (found, length)
}

/// (1), smoothed over a fifth of the frequency to either side.
fn averaged(x: &[f64], dt_s: f64) -> NoiseSpectrum {
    let (found, length) = segments(x, dt_s);
    let mut power = vec![0.0; length / 2 + 1];
    for segment in &found {
        power.iter_mut().zip(segment).for_each(|(p, s)| *p += s / found.len() as f64);
    }
    // The mean was taken out of each segment.
    power[0] = power[1];
    let smooth = |k: usize| {
        let half = 1 + k / 5;
        let range = k.saturating_sub(half)..(k + half + 1).min(power.len());
        let n = range.len() as f64;
        power[range].iter().sum::<f64>() / n
    };
    let power = (0..power.len()).map(smooth).collect();
    NoiseSpectrum { step_hz: 1.0 / (length as f64 * dt_s), power, source: NoiseSource::BeforeTheEvent }
}

/// The motion behind the samples `x` of a sensor with this `noise`: every frequency by the share of its power that is not noise.
///
/// ```text
/// X(f) → X(f) · max(0, 1 − S(f)/P(f)),   P the density of x as in (1)       (2)
/// ```
///
/// Beyond the band of the shaking next to nothing is left. A law that yields at the smallest reversal would answer to that
/// noise as if it were shaking, and not in proportion.
///
/// Limits: one density for the whole record.
/// Check:  `noise_beyond_the_band_goes_and_the_motion_stays`.
/// Source: Wiener (1949), Extrapolation, Interpolation and Smoothing of Stationary Time Series.
pub fn denoised(x: &[f64], dt_s: f64, noise: &NoiseSpectrum) -> Vec<f64> {
    let power = averaged(x, dt_s);
    filter::zero_phase(x, dt_s, |f| kept(noise, &power, f))
}

/// The factor of (2).
fn kept(noise: &NoiseSpectrum, power: &NoiseSpectrum, frequency_hz: f64) -> f64 {
    (1.0 - noise.at(frequency_hz) / power.at(frequency_hz).max(f64::MIN_POSITIVE)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use crate::records::Sensor;
    use rand_distr::{Distribution, StandardNormal};

    const DT_S: f64 = 0.01;

    fn white(n: usize, label: &str) -> Vec<f64> {
        let mut stream = random::stream(1, label);
        (0..n).map(|_| StandardNormal.sample(&mut stream)).collect()
    }

    fn record(onset_s: f64, noise: &[Vec<f64>]) -> Record {
        let motion = |i: usize, size: f64| {
            let t = i as f64 * DT_S - onset_s;
            if t < 0.0 { 0.0 } else { size * t.min(1.0) * (-t / 4.0).exp() * ((11.0 * t).sin() + (29.0 * t).cos()) }
        };
        let sensor = |s: usize| Sensor {
            name: format!("s{s}"),
            acceleration_m_s2: noise[s].iter().enumerate().map(|(i, v)| v + motion(i, 1.0 + s as f64)).collect(),
        };
        Record { event: "E".into(), component: "EW".into(), dt_s: DT_S, input: sensor(0), outputs: vec![sensor(1)] }
    }

    #[test]
    fn the_band_of_a_record_is_where_it_stands_out_of_its_noise() {
        // Shaking from 1 to 8 Hz after 20 s, a hundred times the noise.
        let band = |f: f64| if (1.0..=8.0).contains(&f) { 1.0 } else { 0.0 };
        let shaking = filter::zero_phase(&white(8000, "shaking"), DT_S, band);
        let noise = white(8000, "noise");
        let sum = |k: usize| noise[k] * 0.01 + if k < 2000 { 0.0 } else { shaking[k] };
        let sensor = |name: &str| Sensor { name: name.into(), acceleration_m_s2: (0..8000).map(sum).collect() };
        let (event, component) = ("E".into(), "EW".into());
        let record = Record { event, component, dt_s: DT_S, input: sensor("base"), outputs: vec![sensor("top")] };
        for found in signal_band_hz(&record, None) {
            let [low, high] = found.unwrap();
            // Spectra are smoothed over a fifth of the frequency, and their bins are 0.39 Hz wide.
            assert!((0.3..=1.2).contains(&low) && (7.5..=8.0 * 1.25 + 0.8).contains(&high), "{low} {high}");
        }
    }

    #[test]
    fn noise_beyond_the_band_goes_and_the_motion_stays() {
        let n = 4000;
        let noise: Vec<f64> = white(n, "denoised").into_iter().map(|v| 0.05 * v).collect();
        let clean = record(0.0, &[vec![0.0; n], vec![0.0; n]]).input.acceleration_m_s2;
        let noisy: Vec<f64> = clean.iter().zip(&noise).map(|(x, v)| x + v).collect();
        let found = denoised(&noisy, DT_S, &NoiseSpectrum::white(0.05, DT_S, NoiseSource::Declared));
        let error: Vec<f64> = found.iter().zip(&clean).map(|(a, b)| a - b).collect();
        assert!(rms(&error) < 0.5 * rms(&noise), "{} of {}", rms(&error), rms(&noise));
        let beyond = |x: &[f64]| rms(&filter::zero_phase(x, DT_S, |f| if f > 15.0 { 1.0 } else { 0.0 }));
        assert!(beyond(&found) < 0.35 * beyond(&noise), "{} of {}", beyond(&found), beyond(&noise));
    }

    #[test]
    fn white_noise_is_found_before_the_event() {
        let level = [0.004, 0.02];
        let noise: Vec<Vec<f64>> =
            (0..2).map(|s| white(4000, &format!("n{s}")).iter().map(|v| level[s] * v).collect()).collect();
        for (spectrum, level) in super::noise(&record(10.0, &noise), None).iter().zip(level) {
            assert_eq!(spectrum.source, NoiseSource::BeforeTheEvent);
            let expected = 2.0 * DT_S * level * level;
            for f in [1.0, 3.0, 8.0] {
                let ratio = spectrum.at(f) / expected;
                assert!((0.5..2.0).contains(&ratio), "{f} Hz: {ratio}");
            }
        }
    }

    #[test]
    fn what_processing_emptied_tells_no_noise() {
        let whole = record(0.0, &[white(4000, "a"), white(4000, "b")].map(|x| x.iter().map(|v| 0.02 * v).collect()));
        let mut cut = whole.clone();
        cut.input.acceleration_m_s2 =
            filter::zero_phase(&cut.input.acceleration_m_s2, DT_S, |f| if f > 20.0 { 0.0 } else { 1.0 });
        let [whole, cut] = [whole, cut].map(|record| super::noise(&record, None).swap_remove(0));
        assert_eq!(cut.source, NoiseSource::Usual);
        assert!((cut.at(5.0) / whole.at(5.0) - 1.0).abs() < 0.01);
    }

    #[test]
    fn coloured_noise_keeps_its_colour() {
        let red = |label: &str| {
            let mut y = 0.0;
            let step = |v: f64| {
                y = 0.95 * y + 0.002 * v;
                y
            };
            white(6000, label).into_iter().map(step).collect::<Vec<f64>>()
        };
        let found = super::noise(&record(40.0, &[red("a"), red("b")]), None);
        let expected = |f: f64| {
            let z = realfft::num_complex::Complex::from_polar(0.95, -2.0 * PI * f * DT_S);
            2.0 * DT_S * (0.002 / (1.0 - z).norm()).powi(2)
        };
        for f in [1.0, 4.0, 20.0] {
            let ratio = found[1].at(f) / expected(f);
            assert!((0.6..1.6).contains(&ratio), "{f} Hz: {ratio}");
        }
    }

    #[test]
    fn a_record_that_is_all_shaking_or_silent_does_not_panic() {
        let silent = vec![vec![0.0; 300]; 2];
        assert!(super::noise(&record(0.0, &silent), None).iter().all(|s| s.at(3.0).is_finite()));
        assert_eq!(super::noise(&record(9.0, &silent), None).len(), 2);
    }
}
