//! How far elements and steps are from converged.

use super::Forward;
use toml::Table;

impl Forward<'_> {
    /// What smaller elements and shorter steps would still change of the motions of the strongest event under `tables`, as the largest
    /// share over the output sensors.
    ///
    /// ```text
    /// d_s = (Σ |Y − Y½|²/Σ |Y½|²)^½,   Y½ with elements and steps half as large, over its records and bins              (1)
    /// ```
    ///
    /// None where there are none smaller, or where the column does not finish with them.
    pub fn discretisation_share(&self, tables: &[Table]) -> Option<f64> {
        let group = strongest(self);
        let mut is_wanted = vec![false; self.problem.events.len()];
        self.groups[group].records.iter().for_each(|r| is_wanted[r.event] = true);
        let [whole, halved] = self.replay.replay_in_halves(&self.shaken(tables), &is_wanted).ok()??;
        let n_sensor = self.names.len() - 1;
        let mut sums = vec![[0.0; 2]; n_sensor];
        for at in self.records.iter().filter(|at| at.group == group) {
            let event = self.groups[group].records[at.record].event;
            let [whole, halved] = [&whole[event], &halved[event]].map(|motion| motion.as_ref().ok());
            for ((sum, a), b) in sums.iter_mut().zip(whole?).zip(halved?) {
                for (a, b) in self.bins(*at, a).into_iter().zip(self.bins(*at, b)) {
                    *sum = [sum[0] + (a - b).norm_sqr(), sum[1] + b.norm_sqr()];
                }
            }
        }
        Some(sums.into_iter().map(|[d, all]| (d / all.max(f64::MIN_POSITIVE)).sqrt()).fold(0.0, f64::max))
    }
}

/// The strongest event.
fn strongest(forward: &Forward<'_>) -> usize {
    let strength = |g: &usize| -> f64 {
        let of = |event: usize| forward.problem.events[event].input.iter().fold(0.0, |m: f64, a| m.max(a.abs()));
        forward.groups[*g].records.iter().map(|r| of(r.event)).fold(0.0, f64::max)
    };
    (0..forward.groups.len()).max_by(|a, b| strength(a).total_cmp(&strength(b))).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::super::super::made_up::{Truth, Uniform, problem};
    use super::*;
    use crate::diagnosis::{DiagnoseSettings, Motions, Replay};
    use crate::error::Result;

    /// Smaller elements make the motion of the upper sensor a twentieth larger in the strongest event, and a tenth in the others.
    struct InHalves<'a>(Uniform<'a>);

    impl Replay for InHalves<'_> {
        fn replay(&self, effects: &[toml::Table]) -> Result<Motions> {
            self.0.replay(effects)
        }

        fn replay_in_halves(&self, effects: &[toml::Table], is_wanted: &[bool]) -> Result<Option<[Motions; 2]>> {
            let whole = self.replay(effects)?;
            let mut halved = whole.clone();
            for (motion, is_wanted) in halved.iter_mut().zip(is_wanted) {
                let factor = if *is_wanted { 1.05 } else { 1.1 };
                motion.as_mut().unwrap().last_mut().unwrap().iter_mut().for_each(|v| *v *= factor);
            }
            Ok(Some([whole, halved]))
        }
    }

    #[test]
    fn what_is_not_converged_is_told_of_the_strongest_event_and_the_worst_sensor() {
        let problem = problem(&Truth::default());
        let replay = InHalves(Uniform(&problem));
        let forward = Forward::new(&problem, &replay, &DiagnoseSettings::default()).unwrap();
        let share = forward.discretisation_share(&[]).unwrap();
        assert!((share - 0.05 / 1.05).abs() < 1e-9, "{share}");
        let silent = Uniform(&problem);
        let forward = Forward::new(&problem, &silent, &DiagnoseSettings::default()).unwrap();
        assert_eq!(forward.discretisation_share(&[]), None);
    }
}
