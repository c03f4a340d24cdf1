//! Where training begins: oscillators that know nothing, or the best linear model of the training cases.
//!
//! The linear start puts the oscillators found by [`super::poles`] into the linear coefficients and regressions into the
//! straight paths of decoder (states → responses) and encoder (window → states). The networks beside those paths begin
//! at zero, so that training starts from the linear model exactly and has only to learn what is not linear.

use super::case::Case;
use super::library::Library;
use super::mlp::Mlp;
use super::model::SourceModel;
use super::poles::{MEMORY, Reduced, add_rows, search, simulate};
use super::ridge::Regression;
use crate::error::{Error, Result};
use crate::numerics::spill::Spill;
use faer::{Mat, Side, c64};
use rand::{Rng, RngExt};

/// Proper orthogonal modes of the dense field taken into account, at most.
const N_MODE: usize = 16;

/// Damped oscillators of spread frequencies, lightly driven by the base: a stable start that knows nothing of the data.
pub fn oscillators(library: Library, visible: usize, random: &mut impl Rng) -> Vec<f32> {
    let n = visible / 2;
    let poles: Vec<c64> = (0..n).map(|i| c64::new(-0.1, 0.1 + 1.4 * i as f64 / n as f64)).collect();
    let scales: Vec<f64> = (0..visible).map(|_| 0.2 * (2.0 * random.random::<f64>() - 1.0)).collect();
    coefficients(library, visible, &poles, &scales)
}

/// The coefficients of oscillators driven with given strengths; an odd state left over simply decays.
fn coefficients(library: Library, visible: usize, poles: &[c64], strength: &[f64]) -> Vec<f32> {
    let r = library.latent;
    let mut xi = vec![0.0; library.n_coefficient()];
    for (k, mu) in poles.iter().enumerate() {
        let (re, im) = (2 * k, 2 * k + 1);
        xi[library.linear_row(re) * r + re] = mu.re as f32;
        xi[library.linear_row(im) * r + re] = -mu.im as f32;
        xi[library.linear_row(re) * r + im] = mu.im as f32;
        xi[library.linear_row(im) * r + im] = mu.re as f32;
        xi[library.input_row() * r + re] = strength[k] as f32;
    }
    if 2 * poles.len() < visible {
        xi[library.linear_row(visible - 1) * r + visible - 1] = -0.1;
    }
    xi
}

/// Wakes the hidden states: decays of spread rates, driven a little by states, their products and the base. Nothing listens to
/// them yet, so that the model is the same as without.
pub fn wake_hidden(model: &mut SourceModel, random: &mut impl Rng) {
    let (library, visible, hidden) = (model.shape.library(), model.shape.latent, model.shape.hidden);
    let n = library.latent;
    let mut draw = |scale: f64| (scale * (2.0 * random.random::<f64>() - 1.0)) as f32;
    for (k, equation) in (visible..n).enumerate() {
        let xi = &mut model.parameters;
        for i in 0..visible {
            xi[library.linear_row(i) * n + equation] = draw(0.5 / (visible as f64).sqrt());
        }
        let mut row = library.linear_row(n);
        for i in 0..n {
            for j in i..n {
                if j < visible {
                    xi[row * n + equation] = draw(0.03);
                }
                row += 1;
            }
        }
        xi[library.input_row() * n + equation] = draw(0.2);
        let share = k as f64 / (hidden.max(2) - 1) as f64;
        xi[library.linear_row(equation) * n + equation] = -(SLOWEST * (FASTEST / SLOWEST).powf(share)) as f32;
    }
}

/// Rates of decay of hidden states at the start (1/sample).
const SLOWEST: f64 = 0.02;
const FASTEST: f64 = 0.5;

/// Puts the best linear model into `model`; `weight` counts the cases.
///
/// # Errors
/// When the responses are too poor for the regressions, or `spill` cannot keep their modes.
pub fn linear_start(model: &mut SourceModel, train: &[Case], weight: &[f32], spill: &Spill) -> Result<()> {
    let (channels, window, library) = (model.shape.channels, model.shape.window, model.shape.library());
    let modes = spatial_modes(train, weight, channels)?;
    let reduced: Vec<Reduced> =
        train.iter().map(|case| Reduced::new(&(&dense(case, channels) * &modes), spill)).collect::<Result<_>>()?;
    let r = model.shape.latent;
    let n_pair = r / 2;
    let memory = match n_pair {
        0 | 1 => &MEMORY[..0],
        2 => &MEMORY[..1],
        _ => &MEMORY[..],
    };
    let mut poles = search(n_pair - memory.len(), memory, train, &reduced, weight)?;
    poles.extend(memory);

    let strength: Vec<f64> = poles
        .iter()
        .map(|mu| {
            let states = train.iter().flat_map(|case| simulate(*mu, case));
            let (power, count) = states.fold((0.0, 0.0), |(p, n), z| (p + z.norm_sqr(), n + 2.0));
            (count / f64::max(power, f64::MIN_POSITIVE)).sqrt() // states of order one over all cases together
        })
        .collect();
    let state = |raw: &[Vec<c64>], t: usize, i: usize| match raw.get(i / 2) {
        Some(zeta) if i.is_multiple_of(2) => strength[i / 2] * zeta[t].re,
        Some(zeta) => strength[i / 2] * zeta[t].im,
        None => 0.0, // the state left over by an odd number
    };
    let q = modes.ncols();
    let (mut decoding, mut encoding) = (Regression::new(r, channels), Regression::new(window * q, r));
    for (i, (case, p)) in train.iter().zip(&reduced).enumerate() {
        let (n, p) = (case.u.len() + 1 - window, p.rows());
        let raw: Vec<Vec<c64>> = poles.iter().map(|mu| simulate(*mu, case)).collect();
        let states = Mat::from_fn(n, r, |t, k| state(&raw, t + window - 1, k));
        let pasts = Mat::from_fn(n, window * q, |t, j| p[(t + j / q, j % q)]);
        let responses = dense(case, channels).subrows(window - 1, n).to_owned();
        add_rows(&mut decoding, &states, &responses, f64::from(weight[i]));
        add_rows(&mut encoding, &pasts, &states, f64::from(weight[i]));
    }
    let encode = encoding.solve(1e-8)?;
    let encoder_map = Mat::from_fn(r, window * channels, |i, j| {
        (0..q).map(|m| encode[(i, (j / channels) * q + m)] * modes[(j % channels, m)]).sum::<f64>()
    });
    model.parameters[..library.n_coefficient()].copy_from_slice(&coefficients(library, r, &poles, &strength));
    set_linear(&model.shape.encoder(), &mut model.parameters[model.shape.encoder_range()], &encoder_map);
    set_linear(&model.shape.decoder(), &mut model.parameters[model.shape.decoder_range()], &decoding.solve(1e-9)?);
    Ok(())
}

/// Makes a network exactly linear: `map` in the straight path, zero in the last layer.
fn set_linear(network: &Mlp, parameters: &mut [f32], map: &Mat<f64>) {
    let tensors = network.tensors();
    let last = &tensors[2 * (network.widths.len() - 2)];
    parameters[last.range.clone()].fill(0.0);
    if let Some(range) = network.skip_range() {
        let columns = map.ncols();
        parameters[range].iter_mut().enumerate().for_each(|(i, p)| *p = map[(i / columns, i % columns)] as f32);
    }
}

/// The strongest spatial modes `[channel × mode]`, weighted over the cases.
fn spatial_modes(train: &[Case], weight: &[f32], channels: usize) -> Result<Mat<f64>> {
    let mut covariance = Mat::<f64>::zeros(channels, channels);
    for (case, weight) in train.iter().zip(weight) {
        let x = dense(case, channels);
        covariance += faer::Scale(f64::from(*weight)) * (x.transpose() * &x);
    }
    let eigen =
        covariance.self_adjoint_eigen(Side::Lower).map_err(|_| Error::new("a covariance has no eigenvalues"))?;
    let values = eigen.S().column_vector();
    let floor = 1e-9 * values[channels - 1].max(f64::MIN_POSITIVE);
    let n = (0..channels).filter(|i| values[*i] > floor).count().clamp(1, N_MODE);
    Ok(Mat::from_fn(channels, n, |i, j| eigen.U()[(i, channels - 1 - j)]))
}

fn dense(case: &Case, channels: usize) -> Mat<f64> {
    Mat::from_fn(case.u.len(), channels, |t, c| f64::from(case.dense[t * channels + c]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flare::PretrainSettings;
    use crate::flare::model::Shape;
    use crate::numerics::random::stream;

    #[test]
    fn woken_hidden_states_move_and_change_nothing_that_is_seen() {
        let mut random = stream(4, "hidden start");
        let mut draw = |n: usize| (0..n).map(|_| 2.0 * random.random::<f32>() - 1.0).collect::<Vec<f32>>();
        let [u, u_half, dense] = [60, 59, 240].map(|n| draw(n).into());
        let case = Case { id: "a".into(), u, u_half, dense, sparse: vec![].into() };
        let model = |hidden: usize| {
            let settings = PretrainSettings { latent: 5, hidden, channels: 4, ..Default::default() };
            let shape = Shape::new(&settings);
            let mut random = stream(9, "same for both");
            let mut parameters = oscillators(shape.library(), 5, &mut random);
            parameters.extend(shape.encoder().initial(&mut random));
            parameters.extend(shape.decoder().initial(&mut random));
            let mask = vec![true; shape.library().n_coefficient()];
            let mut model = SourceModel { shape, parameters, mask };
            wake_hidden(&mut model, &mut random);
            model
        };
        let (without, with) = (model(0), model(3));
        let states = with.states(&case).expect("a bounded rollout");
        assert!((5..8).all(|k| states.iter().skip(k).step_by(8).any(|h| h.abs() > 0.01)));
        let seen = |model: &SourceModel| model.roll_out(&case).expect("a bounded rollout");
        for (a, b) in seen(&with).iter().zip(&seen(&without)) {
            assert!((a - b).abs() < 1e-5, "{a} {b}");
        }
    }
}
