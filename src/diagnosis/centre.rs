//! Where to look around: the damping of the soil is found before its velocities.

use super::problem::{Replay, Roughly};
use super::responses::Scene;
use super::search::Search;
use super::settings::DiagnoseSettings;
use super::unknowns::MAX_DEVIATIONS;
use crate::error::Result;
use crate::progress::Progress;

/// Steps of the damping that are tried, prior standard deviations.
const STEPS: [f64; 3] = [1.0, 2.0, MAX_DEVIATIONS];

/// Share of the declared cost that is left where the damping was what is wrong.
const DECISIVE: f64 = 0.7;

/// Nuisances near which the column is worth replaying: declared values, but for the small-strain damping of least cost.
///
/// An undamped column rings on, and each slope of its motions by a velocity is that of the ringing. Where the soil is damped
/// that says nothing; so damping comes first, by the cost of a few replays and a parabola through the best.
///
/// # Errors
/// When a replay is impossible.
pub(super) fn centre(
    scene: &Scene<'_>,
    replay: &dyn Replay,
    settings: &DiagnoseSettings,
    progress: &dyn Progress,
) -> Result<Vec<f64>> {
    let replay = Roughly(replay);
    let search = Search::new(scene, settings, Some(&replay))?;
    let zero = vec![0.0; search.nuisances.len()];
    let Some(damping) = search.nuisances.iter().position(|n| n.instance.kind == "small_strain_damping") else {
        return Ok(zero);
    };
    let at = |x: f64| -> Result<(Vec<f64>, f64)> {
        let mut nuisances = zero.clone();
        nuisances[damping] = x;
        let anchor = search.anchored(&[], &nuisances, None)?;
        let cost = search.settle(&[], &nuisances, &anchor, None, 0)?.cost();
        Ok((nuisances, cost))
    };
    let declared = at(0.0)?.1;
    let mut tried = vec![(0.0, declared)];
    let mut best = (zero.clone(), declared);
    for sign in [1.0, -1.0] {
        for step in STEPS {
            let found = at(sign * step)?;
            tried.push((sign * step, found.1));
            if found.1 >= 0.995 * best.1 {
                break;
            }
            best = found;
        }
        if best.0[damping] != 0.0 {
            break;
        }
    }
    if let Some(x) = least(&mut tried) {
        let found = at(x)?;
        if found.1 < best.1 {
            best = found;
        }
    }
    if best.1 > DECISIVE * declared {
        best = (zero, declared);
    }
    progress.note(&format!(
        "damping {:.1} standard deviations from the declared: cost {:.0}, declared {declared:.0}",
        best.0[damping], best.1
    ));
    Ok(best.0)
}

/// Where a parabola through the least of `tried` and its neighbours, in the ln of the cost, is least; `None` at an end.
fn least(tried: &mut [(f64, f64)]) -> Option<f64> {
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    let middle = (0..tried.len()).min_by(|a, b| tried[*a].1.total_cmp(&tried[*b].1))?;
    let around = tried.get(middle.checked_sub(1)?..middle + 2)?;
    let [(a, fa), (b, fb), (c, fc)] = [around[0], around[1], around[2]].map(|(x, f)| (x, f.ln()));
    let (left, right) = ((fb - fa) / (b - a), (fc - fb) / (c - b));
    let curvature = (right - left) / (c - a);
    (curvature > 0.0).then(|| (0.5 * (a + b) - 0.5 * left / curvature).clamp(a, c))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_of_a_parabola_is_found_between_its_points() {
        let cost = |x: f64| (3.0 + 0.2 * (x - 2.1) * (x - 2.1)).exp();
        let mut tried: Vec<(f64, f64)> = [0.0, 1.5, 3.0, 6.0].map(|x| (x, cost(x))).to_vec();
        assert!((least(&mut tried).unwrap() - 2.1).abs() < 1e-9);
        assert_eq!(least(&mut [(0.0, 1.0), (1.5, 2.0)]), None);
    }
}
