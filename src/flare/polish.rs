//! The last part of stage 1: Gauss–Newton steps on the coefficients over complete motions, networks held fixed.
//!
//! ```text
//! (JᵀJ + μ P) δ = −Jᵀρ,   ρ = √(w/N) (D(ẑ_t) − a_d) at some channels                                        (1)
//! ```
//!
//! The first-order optimiser learns the networks well and the coefficients slowly: encoded states decode to a few per cent
//! while rolled-out ones are several times off. Here every step uses the exact derivative of each whole rollout. `μ P` is
//! the damping of Levenberg and Marquardt in the metric of the relative penalty; a step is taken if it lowers the error.
//! Every other motion is turned over in sign, for the column knows no left and right.

use super::case::Case;
use super::events::{Motion, Reader, Records};
use super::gauss_newton::{Descent, FIRST_DAMPING};
use super::model::SourceModel;
use super::observation::Observation;
use super::penalty::Penalty;
use super::settings::PretrainSettings;
use crate::error::Result;
use crate::numerics::spill::Spill;

/// Channels that stand for all of them.
const N_CHANNEL: usize = 8;
/// JᵀJ is summed over every so many samples: successive ones of a motion say nearly the same.
const THINNING: usize = 4;
/// A polish ends when a step lowers the error by less than this share.
const SMALLEST_GAIN: f64 = 1e-3;

/// Takes up to `steps` steps; `judge` sees the model after each, with the error of the training motions.
///
/// # Errors
/// When `spill` cannot keep what is read of them.
pub fn polish(
    model: &mut SourceModel,
    train: &[Case],
    spill: &Spill,
    settings: &PretrainSettings,
    steps: usize,
    judge: &mut dyn FnMut(&SourceModel, f64),
) -> Result<()> {
    let mut fixed = model.clone();
    fixed.limit_softly(train, settings.limit_factor);
    let (channels, window) = (model.shape.channels, model.shape.window);
    let n = N_CHANNEL.min(channels);
    let picks: Vec<usize> = (0..n).map(|i| i * (channels - 1) / (n - 1).max(1)).collect();
    let observation = Observation {
        sensors: picks.iter().map(|c| format!("channel {c}")).collect(),
        channel_depth_m: (0..channels).map(|c| c as f64).collect(),
        sensor_depth_m: picks.iter().map(|c| *c as f64).collect(),
        dense_std_m_s2: vec![1.0; channels],
        sparse_std_m_s2: vec![1.0; n],
    };
    let sign = |i: usize| if settings.mirror && i % 2 == 1 { -1.0 } else { 1.0 };
    let motion = |(i, case): (usize, &Case)| {
        let first: Vec<f32> = case.dense[..window * channels].iter().map(|v| v * sign(i)).collect();
        let rows = case.dense.chunks_exact(channels);
        Ok(Motion {
            z0: fixed.encode(&first),
            drive: fixed.shape.drive(&case.u, &case.u_half, sign(i)).kept(spill)?,
            sparse: spill.keep(rows.flat_map(|row| picks.iter().map(|c| row[*c] * sign(i))).collect())?,
        })
    };
    let motions = train.iter().enumerate().map(motion).collect::<Result<_>>()?;
    let reader = Reader::new(&fixed, &observation);
    let bound = settings.state_bound as f32;
    let records = Records::of(motions, window - 1, &reader, settings.amplitude_weighting, bound);
    let penalty = Penalty::coefficients(&fixed);
    let n_coefficient = fixed.shape.library().n_coefficient();
    let free: Vec<usize> = (0..n_coefficient).filter(|i| model.mask[*i]).collect();
    let mut xi = fixed.coefficients().to_vec();
    let descent = Descent { train: &records, penalty: &penalty, weight: 0.0, free: &free };
    let (mut error, mut damping) = (records.misfit(&xi).0, FIRST_DAMPING);
    for _ in 0..steps {
        let normal = records.normal_thinned(&xi, &free, THINNING);
        let Some((moved, new)) = descent.step(&normal, &xi, error, &mut damping) else {
            return Ok(());
        };
        xi = moved;
        model.parameters[..n_coefficient].copy_from_slice(&xi);
        judge(model, new);
        if new > (1.0 - SMALLEST_GAIN) * error {
            break;
        }
        error = new;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flare::model::Shape;
    use crate::numerics::random::stream;
    use rand::RngExt;

    #[test]
    fn every_step_lowers_the_error_of_whole_motions_and_moves_kept_coefficients_only() {
        let settings = PretrainSettings {
            latent: 3,
            hidden: 1,
            channels: 5,
            encoder_hidden: vec![6],
            decoder_hidden: vec![6],
            ..Default::default()
        };
        let shape = Shape::new(&settings);
        let mut random = stream(3, "polish");
        let mut draw = |n: usize, scale: f32| -> Vec<f32> {
            (0..n).map(|_| scale * (2.0 * random.random::<f32>() - 1.0)).collect()
        };
        let mut parameters = draw(shape.decoder_range().end, 0.4);
        let n_coefficient = shape.library().n_coefficient();
        parameters[..n_coefficient].iter_mut().for_each(|c| *c *= 0.1);
        (0..4).for_each(|k| parameters[shape.library().linear_row(k) * 4 + k] -= 0.5);
        let mask: Vec<bool> = (0..n_coefficient).map(|i| i % 5 != 2).collect();
        let mut model = SourceModel { shape, parameters, mask };
        let cases: Vec<Case> = (0..4)
            .map(|i| Case {
                id: i.to_string(),
                u: draw(80, 1.0).into(),
                u_half: draw(79, 1.0).into(),
                dense: draw(400, 1.0).into(),
                sparse: vec![].into(),
            })
            .collect();
        let before = model.clone();
        let mut errors = Vec::new();
        polish(&mut model, &cases, &Spill::none(), &settings, 4, &mut |_, error| errors.push(error)).expect("kept");
        assert!(!errors.is_empty() && errors.windows(2).all(|e| e[1] < e[0]), "{errors:?}");
        for (i, (a, b)) in model.parameters.iter().zip(&before.parameters).enumerate() {
            let may_move = i < n_coefficient && before.mask[i];
            assert!(may_move || a == b, "parameter {i} moved from {b} to {a}");
        }
        assert!(model.parameters != before.parameters);
    }
}
