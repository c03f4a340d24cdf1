//! How the source model behaves where it was not trained: a motion twice as strong, a motion ten times as long.

use super::case::Case;
use super::model::SourceModel;
use super::rollout::{STATE_BOUND, Start, roll_out};
use serde::{Deserialize, Serialize};

/// A rollout beyond the training.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Guard {
    /// Whether it ends with a number at every sample.
    pub is_finite: bool,
    /// Size of the response against that of the plain rollout: peak over peak for the doubled motion, root mean square of the
    /// last repetition over that of the first for the tenfold one. Nothing where the rollout ends early.
    pub ratio: Option<f64>,
    /// Share of the samples at which a state is beyond the beginning of its soft limit.
    pub limited_share: f64,
}

impl SourceModel {
    /// The motion and the first window of a case twice as strong. A linear column would answer twice as strongly.
    pub fn guard_doubled(&self, case: &Case) -> Guard {
        let (plain, _) = self.guarded(case, 1.0, 1);
        let (doubled, limited_share) = self.guarded(case, 2.0, 1);
        let peak = |x: &[f32]| x.iter().fold(0.0_f64, |top, v| top.max(f64::from(v.abs())));
        let ratio = plain.zip(doubled.as_ref()).map(|(a, b)| peak(b) / peak(&a).max(f64::MIN_POSITIVE));
        Guard { is_finite: doubled.is_some(), ratio, limited_share }
    }

    /// The motion of a case ten times in a row. A column that forgets would answer to the last as to the first.
    pub fn guard_tenfold(&self, case: &Case) -> Guard {
        let (response, limited_share) = self.guarded(case, 1.0, 10);
        let ratio = response.as_ref().map(|x| {
            let n = x.len() / 10;
            let power = |x: &[f32]| x.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
            (power(&x[x.len() - n..]) / power(&x[..n]).max(f64::MIN_POSITIVE)).sqrt()
        });
        Guard { is_finite: response.is_some(), ratio, limited_share }
    }

    /// Dense response to the case `factor` times as strong and `times` in a row, if it is finite, and the share of limited
    /// samples.
    fn guarded(&self, case: &Case, factor: f32, times: usize) -> (Option<Vec<f32>>, f64) {
        let shape = &self.shape;
        let u = case.u.repeat(times);
        // half a step after the last sample of one repetition lies between it and the first sample of the next
        let between = 0.5 * (case.u.first().unwrap_or(&0.0) + case.u.last().unwrap_or(&0.0));
        let mut u_half = [&case.u_half[..], &[between]].concat().repeat(times);
        u_half.pop();
        let window: Vec<f32> = case.dense[..shape.window * shape.channels].iter().map(|v| v * factor).collect();
        let z0 = self.encode(&window);
        let drive = shape.drive(&u, &u_half, factor);
        let start = Start { z0: &z0, drive: &drive, from: shape.window - 1 };
        let (z, valid) = roll_out(shape.library(), self.coefficients(), &[start], &shape.limits(STATE_BOUND)).remove(0);
        let is_limited = |z: &&[f32]| z.iter().zip(&shape.soft_limits).any(|(z, a)| z.abs() > *a);
        let share = z.chunks_exact(shape.library().latent).filter(is_limited).count() as f64 / start.n_step() as f64;
        let response = self.decode(&shape.visible(z));
        let is_whole = valid == start.n_step() && response.iter().all(|v| v.is_finite());
        (is_whole.then_some(response), share)
    }
}
