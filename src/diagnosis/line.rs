//! Where a line stands out of what a model leaves of a sensor's records.

use super::fit::{Fitter, Point};
use crate::effects::Instance;

/// Width of the classes of frequency, Hz.
const CLASS_HZ: f64 = 0.04;
/// Classes on either side between which a line is compared with its neighbourhood.
const NEIGHBOURS: [usize; 2] = [3, 12];

/// Effects whose course in each record is estimated from the record itself: they have a hidden parameter a record.
const ESTIMATED: [&str; 2] = ["machine_hum", "baseline_tilt"];

/// Fall of the cost of a record that hidden parameters bring about where there is nothing.
pub fn hidden(instance: &Instance) -> f64 {
    if ESTIMATED.contains(&instance.kind) { 2.0 } else { 0.0 }
}

/// Frequency at which the residuals of `sensor` (`None`: of all output sensors) stand highest over their neighbourhood.
pub fn strongest(fitter: &Fitter<'_>, point: &Point, sensor: Option<usize>) -> Option<f64> {
    let scene = fitter.scene;
    let highest = scene.groups.iter().filter_map(|g| g.frequencies_hz.last()).fold(0.0f64, |m, f| m.max(*f));
    let count = (highest / CLASS_HZ) as usize + 1;
    let mut power = vec![[0.0; 3]; count];
    let mut at = 0;
    for g in fitter.groups {
        let group = &scene.groups[*g];
        for f in &group.frequencies_hz {
            let class = &mut power[((f / CLASS_HZ) as usize).min(count - 1)];
            for _ in &group.records {
                for s in 0..scene.problem.array.outputs.len() {
                    if sensor.is_none_or(|only| only == s) {
                        let p = point.residual[at].powi(2) + point.residual[at + 1].powi(2);
                        class[0] += p;
                        class[1] += 1.0;
                        class[2] += p * f;
                    }
                    at += 2;
                }
            }
        }
    }
    let level = |k: usize| if power[k][1] > 0.0 { power[k][0] / power[k][1] } else { 0.0 };
    let contrast = |k: &usize| {
        let mut around: Vec<f64> = (k.saturating_sub(NEIGHBOURS[1])..(k + NEIGHBOURS[1] + 1).min(count))
            .filter(|j| j.abs_diff(*k) >= NEIGHBOURS[0] && power[*j][1] > 0.0)
            .map(level)
            .collect();
        around.sort_by(f64::total_cmp);
        let median = around.get(around.len() / 2).copied().unwrap_or(f64::INFINITY);
        (level(*k) - median) * power[*k][1]
    };
    let best = (0..count).filter(|k| power[*k][1] > 0.0).max_by(|a, b| contrast(a).total_cmp(&contrast(b)))?;
    Some(power[best][2] / power[best][0])
}
