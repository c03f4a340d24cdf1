//! What the learned model is trained and judged on: simulated cases and measured events, already normalised.

use crate::error::{Error, Result};
use crate::numerics::spill::Values;

/// One simulated motion at the model's sampling interval, all series divided by their training standard deviations.
#[derive(Debug, Clone, PartialEq)]
pub struct Case {
    /// Name of the motion.
    pub id: String,
    /// Base acceleration, `[n_step]`.
    pub u: Values<f32>,
    /// Base acceleration half-way between samples, from the finer series, `[n_step − 1]`.
    pub u_half: Values<f32>,
    /// Dense response, `[n_step · n_channel]`, row-major in time.
    pub dense: Values<f32>,
    /// Response at the sensors, `[n_step · n_sensor]`.
    pub sparse: Values<f32>,
}

/// One component of a measured event, normalised with the statistics of the simulations.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// Name of the event.
    pub id: String,
    /// Base acceleration, `[n_step]`.
    pub u: Vec<f32>,
    /// Base acceleration half-way between samples, `[n_step − 1]`.
    pub u_half: Vec<f32>,
    /// Response at the sensors divided by the standard deviation of the sparse simulations, `[n_step · n_sensor]`.
    pub sparse: Vec<f32>,
}

impl Case {
    /// Checks shapes and numbers.
    ///
    /// # Errors
    /// When lengths do not belong together, the case is shorter than `window + 1`, or a value is no number.
    pub fn check(&self, n_channel: usize, n_sensor: usize, window: usize) -> Result<()> {
        check_series(&self.id, &self.u, &self.u_half, window)?;
        check_field(&self.id, "dense response", &self.dense, self.u.len(), n_channel)?;
        check_field(&self.id, "sensor response", &self.sparse, self.u.len(), n_sensor)
    }
}

impl Event {
    /// Checks shapes and numbers.
    ///
    /// # Errors
    /// As [`Case::check`].
    pub fn check(&self, n_sensor: usize, window: usize) -> Result<()> {
        check_series(&self.id, &self.u, &self.u_half, window)?;
        check_field(&self.id, "sensor response", &self.sparse, self.u.len(), n_sensor)
    }
}

fn check_series(id: &str, u: &[f32], u_half: &[f32], window: usize) -> Result<()> {
    let place = || format!("case `{id}`");
    if u.len() < window + 1 {
        return Err(
            Error::new(format!("needs at least {} samples (window + 1), got {}", window + 1, u.len())).at(place())
        );
    }
    if u_half.len() + 1 != u.len() {
        return Err(Error::new(format!("expected {} half-step inputs, got {}", u.len() - 1, u_half.len())).at(place()));
    }
    match u.iter().chain(u_half).position(|v| !v.is_finite()) {
        Some(i) => Err(Error::new(format!("base acceleration is no number at sample {}", i % u.len())).at(place())),
        None => Ok(()),
    }
}

fn check_field(id: &str, what: &str, field: &[f32], n_step: usize, n: usize) -> Result<()> {
    let place = || format!("case `{id}`");
    if field.len() != n_step * n {
        let expected = format!("expected {n_step} × {n} values of {what}, got {}", field.len());
        return Err(Error::new(expected).at(place()));
    }
    match field.iter().position(|v| !v.is_finite()) {
        Some(i) => {
            let at = format!("{what} is no number at sample {}, channel {}", i / n.max(1), i % n.max(1));
            Err(Error::new(at).at(place()))
        }
        None => Ok(()),
    }
}

/// Weights of cases, `rms^(−2p)` of their responses, scaled to mean 1. A still case counts like the weakest other.
pub fn amplitude_weights<'a>(responses: impl Iterator<Item = &'a [f32]>, power: f64) -> Vec<f32> {
    let mean_square = |x: &[f32]| x.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>() / x.len().max(1) as f64;
    let mut energy: Vec<f64> = responses.map(mean_square).collect();
    let smallest = energy.iter().copied().filter(|e| *e > 0.0).fold(f64::INFINITY, f64::min);
    let smallest = if smallest.is_finite() { smallest } else { 1.0 };
    energy.iter_mut().for_each(|e| *e = e.max(smallest).powf(-power));
    let mean = energy.iter().sum::<f64>() / energy.len().max(1) as f64;
    energy.iter().map(|e| (e / mean) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_amplitude_weighting_gives_all_cases_the_same_say() {
        let (weak, strong) = (vec![0.1_f32; 10], vec![2.0_f32; 10]);
        let weights = amplitude_weights([weak.as_slice(), strong.as_slice()].into_iter(), 1.0);
        assert!((weights[0] * 0.01 - weights[1] * 4.0).abs() < 1e-5);
        assert!((weights[0] + weights[1] - 2.0).abs() < 1e-5);
        assert_eq!(amplitude_weights([weak.as_slice(), strong.as_slice()].into_iter(), 0.0), [1.0, 1.0]);
    }

    #[test]
    fn a_case_with_a_gap_is_refused_with_its_place() {
        let mut case = Case {
            id: "007".into(),
            u: vec![0.0; 9].into(),
            u_half: vec![0.0; 8].into(),
            dense: vec![0.0; 18].into(),
            sparse: vec![0.0; 9].into(),
        };
        assert!(case.check(2, 1, 3).is_ok());
        let mut gap = vec![0.0; 18];
        gap[5] = f32::NAN;
        case.dense = gap.into();
        let text = case.check(2, 1, 3).expect_err("no number").to_string();
        assert_eq!(text, "dense response is no number at sample 2, channel 1\n  in case `007`");
    }
}
