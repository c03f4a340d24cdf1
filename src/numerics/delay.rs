//! Band-limited time shift.

use realfft::RealFftPlanner;
use realfft::num_complex::Complex;
use std::f64::consts::PI;

/// `x` later by `delay_s`, any fraction of a sample; the record is padded with zeros, so nothing wraps around.
///
/// ```text
/// X(f) → X(f) · exp(−i 2π f τ)                                          (1)
/// ```
pub fn delay(x: &[f64], dt_s: f64, delay_s: f64) -> Vec<f64> {
    if delay_s == 0.0 || x.is_empty() {
        return x.to_vec();
    }
    let margin = (delay_s.abs() / dt_s).ceil() as usize + 64;
    let n = x.len() + 2 * margin;
    let mut planner = RealFftPlanner::<f64>::new();
    let mut padded = vec![0.0; n];
    padded[margin..margin + x.len()].copy_from_slice(x);
    let forward = planner.plan_fft_forward(n);
    let mut spectrum = forward.make_output_vec();
    let mut moved = vec![0.0; n];
    let inverse = planner.plan_fft_inverse(n);
    if forward.process(&mut padded, &mut spectrum).is_err() {
        return x.to_vec();
    }
    let last = spectrum.len() - 1;
    for (k, value) in spectrum.iter_mut().enumerate() {
        let phase = -2.0 * PI * k as f64 / (n as f64 * dt_s) * delay_s;
        *value *= Complex::from_polar(1.0, phase); // (1)
        if k == 0 || (k == last && n.is_multiple_of(2)) {
            value.im = 0.0;
        }
    }
    if inverse.process(&mut spectrum, &mut moved).is_err() {
        return x.to_vec();
    }
    moved[margin..margin + x.len()].iter().map(|v| v / n as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smooth_pulse_moves_by_a_fraction_of_a_sample() {
        let dt = 0.01;
        let pulse = |t: f64| (-((t - 1.0) / 0.05).powi(2)).exp();
        let x: Vec<f64> = (0..200).map(|i| pulse(i as f64 * dt)).collect();
        let moved = delay(&x, dt, 0.0137);
        for (i, v) in moved.iter().enumerate() {
            assert!((v - pulse(i as f64 * dt - 0.0137)).abs() < 1e-9);
        }
        assert_eq!(delay(&x, dt, 0.0), x);
    }
}
