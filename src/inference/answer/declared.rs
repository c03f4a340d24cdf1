//! What the records say of each declared value that may be off.

use super::PRIOR_RATIOS;
use crate::diagnosis::{DeclaredValue, Estimate};
use crate::effects::{Instance, velocity_between};
use crate::inference::intervals::{NORMAL, half_widths_along};
use crate::inference::posterior::Fit;

/// Posterior over prior variance from which the records tell a value themselves.
const TOLD: f64 = 0.5;

/// Velocities of the ranges between depth modes, then the other tolerances of `fit`; `groups` are the events of the records.
///
/// ```text
/// 1/v_r = 1/v − 1,   z_r = v_r/v · (z + Σ_j C_ij g_j)                      (1)
/// ```
///
/// z and v are mean and variance of a value in standard deviations of its prior, N(0, 1); z_r and v_r are those by the records and the
/// priors of everything else. C g, with the covariance C and the slope g of ln of the density, is how far beyond the end of its tolerance
/// the records would have it. v is that of the half width of the interval, so that events that disagree widen both.
///
/// Check: `what_records_say_is_what_a_wide_tolerance_leaves_of_them`.
pub(super) fn declared_values(fit: &Fit<'_>, groups: &[usize]) -> Vec<DeclaredValue> {
    let declared = fit.model.declared;
    let n = fit.x.len();
    let unit = |at: usize| (0..n).map(|i| f64::from(u8::from(i == at))).collect::<Vec<f64>>();
    let by_prior = PRIOR_RATIOS.map(|ratio| fit.with_priors(ratio));
    let beyond = fit.beyond_bounds();
    let velocities = declared.cuts_m.windows(2).zip(&declared.modes).filter(|_| declared.n_mode() > 0);
    let mut directions: Vec<Vec<f64>> = velocities
        .clone()
        .map(|(_, row)| row.iter().copied().chain(std::iter::repeat(0.0)).take(n).collect())
        .collect();
    let n_range = directions.len();
    let others = declared.n_mode()..declared.n_mode() + declared.others.len();
    directions.extend(others.clone().map(unit));
    let halves = half_widths_along(fit, groups, &directions);
    let along = |x: &[f64], direction: &[f64]| x.iter().zip(direction).map(|(x, d)| x * d).sum::<f64>();
    let of = |instance: &Instance, index: usize, value: &dyn Fn(f64) -> f64| {
        let direction = &directions[index];
        let z = along(&fit.x, direction);
        let deviation = along(direction, direction).sqrt();
        // Without a covariance no more is known than before.
        let half = if halves[index].is_finite() { halves[index] } else { NORMAL * deviation };
        let estimate = |z: f64, half: f64, by_prior| Estimate {
            value: value(z),
            unit: instance.free[0].parameter.unit.to_string(),
            ci95: [value(z - half), value(z + half)],
            by_prior,
        };
        let share = (half / (NORMAL * deviation)).powi(2);
        let by_records = (share < TOLD && deviation > 0.0).then(|| {
            let wider = 1.0 / (1.0 - share);
            estimate(wider * along(&beyond, direction), wider.sqrt() * half, None)
        });
        DeclaredValue {
            kind: instance.kind.to_string(),
            target: instance.place(),
            parameter: instance.free[0].parameter.name.to_string(),
            vs_range_m: (index < n_range).then(|| [declared.cuts_m[index], declared.cuts_m[index + 1]]),
            deviations: z / deviation,
            is_at_end: index.checked_sub(n_range).is_some_and(|i| fit.model.is_strained(&fit.x, others.start + i)),
            estimate: estimate(z, half, Some(by_prior.each_ref().map(|x| value(along(x, direction))))),
            by_records,
        }
    };
    let ranges = velocities.enumerate().map(|(i, (cuts_m, _))| {
        let instance = velocity_between([cuts_m[0], cuts_m[1]]);
        of(&instance, i, &|ln| ln)
    });
    let rest = declared.others.iter().enumerate().map(|(i, tolerance)| {
        let parameter = tolerance.instance.free[0].parameter;
        of(&tolerance.instance, n_range + i, &|z| parameter.value(tolerance.coordinate(z)))
    });
    ranges.chain(rest).collect()
}

#[cfg(test)]
mod tests {
    use crate::diagnosis::{DiagnoseSettings, Estimate, Problem};
    use crate::inference::answer::declared::declared_values;
    use crate::inference::forward::Forward;
    use crate::inference::made_up::{DAMPING, Truth, Uniform, problem};
    use crate::inference::parameters::Declared;
    use crate::inference::posterior::{Fitter, Start, Stop};
    use crate::inference::recalibration::recalibrated;

    #[test]
    fn what_records_say_is_what_a_wide_tolerance_leaves_of_them() {
        let made = problem(&Truth { soil: [204.0, DAMPING], ..Truth::default() });
        let of = |vs_ln: f64| {
            let mut problem: Problem = made.clone();
            problem.tolerances.vs_ln = vs_ln;
            let replay = Uniform(&problem);
            let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
            let declared = Declared::new(&problem).unwrap();
            forward.anchor(&[]).unwrap();
            let (expected, (model, x)) = recalibrated(&forward, &declared, Vec::new()).unwrap();
            let fit = Fitter::new(&forward, expected).fit(Start::at(model, x), Stop::EXACT).unwrap();
            let groups: Vec<usize> = forward.records.iter().map(|at| at.group).collect();
            let found = declared_values(&fit, &groups).swap_remove(0);
            assert_eq!((found.kind.as_str(), found.target.as_str()), ("layer_velocity", "0.0–40.0 m"));
            found
        };
        let half = |e: &Estimate| 0.5 * (e.ci95[1] - e.ci95[0]);
        // What is known of all velocities together, 0.01, holds back a velocity that is higher by 0.02.
        let (narrow, held) = (of(0.001), of(1.0).estimate);
        let alone = narrow.by_records.unwrap_or_else(|| panic!("{:?} {held:?}", narrow.estimate));
        let all = [&narrow.estimate, &alone, &held];
        assert!(narrow.estimate.value < alone.value && half(&narrow.estimate) < half(&alone), "{all:?}");
        assert!((alone.value - held.value).abs() < 0.2 * half(&held), "{all:?}");
        assert!((half(&alone) / half(&held) - 1.0).abs() < 0.2, "{all:?}");
        assert!(alone.ci95[0] < 1.02_f64.ln() && 1.02_f64.ln() < alone.ci95[1], "{all:?}");
    }
}
