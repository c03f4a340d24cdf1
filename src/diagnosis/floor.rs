//! The error that sensor noise leaves to a prediction by the right model.

use super::NoiseSpectrum;
use crate::numerics::smooth::running_mean;
use crate::numerics::spectrum::transforms;

/// Width over which spectra are smoothed before they are divided, Hz.
const SMOOTHED_HZ: f64 = 0.5;

/// Standard deviation of record less prediction when the model is right and only the sensors are noisy, m/s².
///
/// ```text
/// σ² = ∫₀^{f_max} [ S_out(f) + |H(f)|² S_in(f) ] df,   |H|² = ⟨|Y|²⟩ / ⟨|U|²⟩       (1)
/// ```
///
/// | symbol | argument                       | unit       |
/// |--------|--------------------------------|------------|
/// | U, Y   | `base`, `response` of a model  | m/s²       |
/// | S_in   | `noise[0]`                     | (m/s²)²/Hz |
/// | S_out  | `noise[1]`                     | (m/s²)²/Hz |
///
/// The noise of the input sensor shakes the column of the model along with the motion: at a resonance it counts many times.
///
/// Limits: the response is taken as linear for the noise; an estimate, exact only on average.
/// Check:  `noise_of_the_input_counts_with_the_amplification`.
/// Source: Pintelon and Schoukens (2012), System Identification, errors-in-variables cost.
pub fn noise_deviation_m_s2(
    base: &[f64],
    response: &[f64],
    dt_s: f64,
    noise: [&NoiseSpectrum; 2],
    f_max_hz: f64,
) -> f64 {
    let n = base.len().min(response.len());
    if n < 2 {
        return f64::NAN;
    }
    let step_hz = 1.0 / (n as f64 * dt_s);
    let half = (0.5 * SMOOTHED_HZ / step_hz).ceil() as usize;
    let [u, y] = [&base[..n], &response[..n]].map(|x| running_mean(&power(x), half));
    let last = ((f_max_hz / step_hz).floor() as usize).min(u.len() - 1);
    let variance: f64 = (1..=last)
        .map(|k| {
            let amplified = if u[k] > 0.0 { y[k] / u[k] } else { 0.0 };
            let f = k as f64 * step_hz;
            (noise[1].at(f) + amplified * noise[0].at(f)) * step_hz // (1)
        })
        .sum();
    variance.sqrt()
}

fn power(x: &[f64]) -> Vec<f64> {
    let (plan, _) = transforms(x.len());
    let mut spectrum = plan.make_output_vec();
    // Lengths agree by construction; a failure would leave the spectrum at zero.
    let _ = plan.process(&mut x.to_vec(), &mut spectrum);
    spectrum.iter().map(|z| z.norm_sqr()).collect()
}

#[cfg(test)]
mod tests {
    use super::super::NoiseSource;
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn noise_of_the_input_counts_with_the_amplification() {
        let mut random = random::stream(3, "floor");
        let dt_s = 0.01;
        let base: Vec<f64> = (0..4000).map(|_| StandardNormal.sample(&mut random)).collect();
        let response: Vec<f64> = base.iter().map(|u| 3.0 * u).collect();
        let [input, output] = [0.02, 0.05].map(|sd| NoiseSpectrum::white(sd, dt_s, NoiseSource::Declared));
        let whole = noise_deviation_m_s2(&base, &response, dt_s, [&input, &output], 50.0);
        let expected = (0.05f64.powi(2) + 9.0 * 0.02f64.powi(2)).sqrt();
        assert!((whole / expected - 1.0).abs() < 0.01, "{whole} {expected}");
        let half = noise_deviation_m_s2(&base, &response, dt_s, [&input, &output], 25.0);
        assert!((half / whole - 0.5f64.sqrt()).abs() < 0.01, "half the band holds half the power");
    }
}
