//! Where training begins: oscillators that know nothing, or the best linear model of the training cases.
//!
//! The linear start puts the oscillators found by [`super::poles`] into the linear coefficients and regressions into the
//! straight paths of decoder (states → responses) and encoder (window → states). The networks beside those paths begin
//! at zero, so that training starts from the linear model exactly and has only to learn what is not linear.

use super::case::Case;
use super::library::Library;
use super::mlp::Mlp;
use super::model::SourceModel;
use super::poles::{MEMORY, add_rows, search, simulate};
use super::ridge::Regression;
use crate::error::{Error, Result};
use faer::{Mat, Side, c64};
use rand::{Rng, RngExt};

/// Proper orthogonal modes of the dense field taken into account, at most.
const N_MODE: usize = 16;

/// Damped oscillators of spread frequencies, lightly driven by the base: a stable start that knows nothing of the data.
pub fn oscillators(library: Library, random: &mut impl Rng) -> Vec<f32> {
    let n = library.latent / 2;
    let poles: Vec<c64> = (0..n).map(|i| c64::new(-0.1, 0.1 + 1.4 * i as f64 / n as f64)).collect();
    let scales: Vec<f64> = (0..library.latent).map(|_| 0.2 * (2.0 * random.random::<f64>() - 1.0)).collect();
    coefficients(library, &poles, &scales)
}

/// The coefficients of oscillators driven with given strengths; an odd state left over simply decays.
fn coefficients(library: Library, poles: &[c64], strength: &[f64]) -> Vec<f32> {
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
    if 2 * poles.len() < r {
        xi[library.linear_row(r - 1) * r + r - 1] = -0.1;
    }
    xi
}

/// Puts the best linear model into `model`; `weight` counts the cases.
///
/// # Errors
/// When the responses are too poor for the regressions.
pub fn linear_start(model: &mut SourceModel, train: &[Case], weight: &[f32]) -> Result<()> {
    let (channels, window, library) = (model.shape.channels, model.shape.window, model.shape.library());
    let modes = spatial_modes(train, weight, channels)?;
    let reduced: Vec<Mat<f64>> = train.iter().map(|case| &dense(case, channels) * &modes).collect();
    let n_pair = library.latent / 2;
    let memory = match n_pair {
        0 | 1 => &MEMORY[..0],
        2 => &MEMORY[..1],
        _ => &MEMORY[..],
    };
    let mut poles = search(n_pair - memory.len(), memory, train, &reduced, weight)?;
    poles.extend(memory);

    let raw: Vec<Vec<Vec<c64>>> =
        train.iter().map(|case| poles.iter().map(|mu| simulate(*mu, case)).collect()).collect();
    let strength: Vec<f64> = (0..n_pair)
        .map(|k| {
            let (power, count) =
                raw.iter().flat_map(|s| &s[k]).fold((0.0, 0.0), |(p, n), z| (p + z.norm_sqr(), n + 2.0));
            (count / f64::max(power, f64::MIN_POSITIVE)).sqrt() // states of order one over all cases together
        })
        .collect();
    let state = |case: usize, t: usize, i: usize| match raw[case].get(i / 2) {
        Some(zeta) if i.is_multiple_of(2) => strength[i / 2] * zeta[t].re,
        Some(zeta) => strength[i / 2] * zeta[t].im,
        None => 0.0, // the state left over by an odd number
    };
    let q = modes.ncols();
    let (mut decoding, mut encoding) =
        (Regression::new(library.latent, channels), Regression::new(window * q, library.latent));
    for (i, (case, p)) in train.iter().zip(&reduced).enumerate() {
        let n = case.u.len() + 1 - window;
        let states = Mat::from_fn(n, library.latent, |t, k| state(i, t + window - 1, k));
        let pasts = Mat::from_fn(n, window * q, |t, j| p[(t + j / q, j % q)]);
        let responses = dense(case, channels).subrows(window - 1, n).to_owned();
        add_rows(&mut decoding, &states, &responses, f64::from(weight[i]));
        add_rows(&mut encoding, &pasts, &states, f64::from(weight[i]));
    }
    let encode = encoding.solve(1e-8)?;
    let encoder_map = Mat::from_fn(library.latent, window * channels, |i, j| {
        (0..q).map(|m| encode[(i, (j / channels) * q + m)] * modes[(j % channels, m)]).sum::<f64>()
    });
    model.parameters[..library.n_coefficient()].copy_from_slice(&coefficients(library, &poles, &strength));
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
