//! What the nonlinear column makes of noise in its input beyond what is proportional to it.

use super::anchor::Anchor;
use super::neighbours::Seen;
use super::responses::{Responses, Scene};
use super::spectra::smoothing_bins;
use crate::numerics::smooth::running_mean;

/// Power added to the noise of the output sensors: `[group][record][bin and sensor]`, empty where it is not known.
pub(super) type Propagated = Vec<Vec<Vec<f64>>>;

/// Of two replays with different noise in the input,
///
/// ```text
/// S_out += max(0, ⟨|V' − V|²⟩ − ⟨|A|² S_u⟩)
/// ```
///
/// A being the derivative of the motion by the input on which the cost relies, and ⟨⟩ a mean over neighbouring bins. A column
/// that yields, most of all one that loses its confinement, answers noise more than a linear one, and not alike twice.
///
/// Limits: one draw of the noise.
/// Check:  `noise_that_grows_in_the_column_is_added_and_what_is_proportional_is_not`.
pub(super) fn propagated(
    scene: &Scene<'_>,
    [plain, noisier]: [&[Vec<Option<Seen>>]; 2],
    anchor: &Anchor,
    responses: &Responses,
) -> Propagated {
    let count = scene.problem.array.outputs.len();
    let of = |[g, r]: [usize; 2]| {
        let (Some(plain), Some(noisier), Some(own)) = (&plain[g][r], &noisier[g][r], &anchor.records[g][r]) else {
            return Vec::new();
        };
        let input_noise = &scene.groups[g].records[r].noise[0];
        let transfer = &responses.records[g][r].transfer;
        let moved = plain.spectrum.iter().zip(&noisier.spectrum).map(|(a, b)| (b - a).norm_sqr()).collect::<Vec<_>>();
        let linear = (0..moved.len()).map(|i| (own.factor[i] * transfer[i]).norm_sqr() * input_noise[i / count]);
        beyond(&moved, &linear.collect::<Vec<_>>(), count, smoothing_bins(&scene.groups[g].frequencies_hz))
    };
    let all = scene.groups.iter().enumerate();
    all.map(|(g, group)| (0..group.records.len()).map(|r| of([g, r])).collect()).collect()
}

/// Mean of `moved` over bins to either side, less that of `linear`, where that is more than nothing; `[bin and sensor]`.
fn beyond(moved: &[f64], linear: &[f64], count: usize, half: usize) -> Vec<f64> {
    let mean = |x: &[f64]| -> Vec<Vec<f64>> {
        (0..count).map(|s| running_mean(&x.iter().skip(s).step_by(count).copied().collect::<Vec<_>>(), half)).collect()
    };
    let (moved_mean, linear_mean) = (mean(moved), mean(linear));
    (0..moved.len()).map(|i| (moved_mean[i % count][i / count] - linear_mean[i % count][i / count]).max(0.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_that_grows_in_the_column_is_added_and_what_is_proportional_is_not() {
        let linear = [1.0, 4.0, 1.0, 4.0, 1.0, 4.0];
        let moved = [0.5, 12.0, 1.5, 4.0, 1.0, 8.0];
        let added = beyond(&moved, &linear, 2, 2);
        assert!(added.iter().step_by(2).all(|x| x.abs() < 1e-12), "{added:?}");
        assert!(added.iter().skip(1).step_by(2).all(|x| (x - 4.0).abs() < 1e-12), "{added:?}");
    }
}
