//! How a candidate source model is judged: by rolling whole validation motions out, never by segments.
//!
//! ```text
//! score = rollout + 0.25 reconstruction + 0.05 latent    (mean squared errors, weighted as in training)        (1)
//! ```
//!
//! A candidate that diverges on any validation motion, or on one multiplied by the stress factor, scores infinity.

use super::case::Case;
use super::memory::Drive;
use super::model::SourceModel;
use super::rollout::{Start, roll_out};

/// Errors of a candidate over whole motions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Score {
    /// Mean squared error of the decoded rollout.
    pub rollout: f64,
    /// Mean squared error of the decoded encoded states.
    pub reconstruction: f64,
    /// Mean squared distance of rolled-out from encoded states.
    pub latent: f64,
    /// Median over cases of the median over channels of the NRMSE of the rollout (%).
    pub nrmse_percent: f64,
    /// What is selected on, eq. (1).
    pub score: f64,
}

/// Cases whose states are in memory together.
const AT_ONCE: usize = 128;

/// Judges `model` on `cases`, with the weight of each case in the means.
pub fn judge(model: &SourceModel, cases: &[Case], weight: &[f32], stress_factor: f64, bound: f64) -> Score {
    let mut errors = Errors { sums: [0.0; 3], nrmse_percent: Vec::new(), is_bounded: true };
    let share: Vec<f64> = weight.iter().map(|w| f64::from(*w) / cases.len() as f64).collect();
    for (cases, share) in cases.chunks(AT_ONCE).zip(share.chunks(AT_ONCE)) {
        errors.add(model, cases, share, stress_factor, bound);
    }
    let [rollout, reconstruction, latent] = errors.sums;
    let score = rollout + 0.25 * reconstruction + 0.05 * latent; // (1)
    let score = if errors.is_bounded && score.is_finite() { score } else { f64::INFINITY };
    Score { rollout, reconstruction, latent, nrmse_percent: median(&mut errors.nrmse_percent), score }
}

/// Errors of the cases so far.
struct Errors {
    /// Weighted: of the rollout, of the reconstruction, of the latent states.
    sums: [f64; 3],
    /// Median over the channels of each case.
    nrmse_percent: Vec<f64>,
    is_bounded: bool,
}

impl Errors {
    fn add(&mut self, model: &SourceModel, cases: &[Case], share: &[f64], stress_factor: f64, bound: f64) {
        let t0 = model.shape.window - 1;
        let (r, channels) = (model.shape.latent, model.shape.channels);
        let encoded: Vec<Vec<f32>> = cases.iter().map(|c| model.encode(&c.dense)).collect();
        let roll = |factor: f32| -> Vec<(Vec<f32>, usize)> {
            let drives: Vec<Drive> = cases.iter().map(|c| model.shape.drive(&c.u, &c.u_half, factor)).collect();
            let first: Vec<Vec<f32>> = encoded.iter().map(|z| z[..r].iter().map(|z| z * factor).collect()).collect();
            let starts: Vec<Start<'_>> =
                drives.iter().zip(&first).map(|(drive, z0)| Start { z0, drive, from: t0 }).collect();
            roll_out(model.shape.library(), model.coefficients(), &starts, &model.shape.limits(bound as f32))
        };
        let rolled = roll(1.0);
        let stressed = if stress_factor > 1.0 { roll(stress_factor as f32) } else { Vec::new() };
        let mut ends = rolled.iter().zip(cases).chain(stressed.iter().zip(cases));
        self.is_bounded &= ends.all(|((_, valid), case)| *valid == case.u.len() - t0);
        for (((case, z), (z_roll, _)), share) in cases.iter().zip(&encoded).zip(&rolled).zip(share) {
            let target = &case.dense[t0 * channels..];
            let z_roll = &model.shape.visible(z_roll.clone());
            let response = model.decode(z_roll);
            self.sums[0] += share * mean_square_error(&response, target);
            self.sums[1] += share * mean_square_error(&model.decode(z), target);
            self.sums[2] += share * mean_square_error(z_roll, z);
            self.nrmse_percent.push(median(&mut nrmse_percent(&response, target, channels)));
        }
    }
}

/// Mean squared difference.
pub fn mean_square_error(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / b.len().max(1) as f64
}

/// Root-mean-square error of each channel over the root mean square of its target (%).
pub fn nrmse_percent(response: &[f32], target: &[f32], n: usize) -> Vec<f64> {
    let (mut error, mut power) = (vec![0.0; n], vec![0.0; n]);
    for (response, target) in response.chunks_exact(n).zip(target.chunks_exact(n)) {
        for j in 0..n {
            error[j] += f64::from(response[j] - target[j]).powi(2);
            power[j] += f64::from(target[j]).powi(2);
        }
    }
    error.iter().zip(&power).map(|(e, p)| 100.0 * (e / p.max(f64::MIN_POSITIVE)).sqrt()).collect()
}

/// Median; not a number for an empty list.
pub fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n => 0.5 * (values[(n - 1) / 2] + values[n / 2]),
    }
}
