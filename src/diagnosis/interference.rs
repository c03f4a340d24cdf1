//! What instruments add by themselves, estimated from the records that carry it.

use super::problem::Event;
use super::responses::Scene;
use crate::effects::{Array, Channel, Effect};
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

impl Scene<'_> {
    /// Spectra to take out of the records of group `g`: `[record][channel]`, `None` where nothing was added.
    pub fn estimated_interference(&self, effects: &[Box<dyn Effect>], g: usize) -> Vec<Vec<Option<Vec<C64>>>> {
        let n_channel = self.problem.array.sensors().count();
        let of_channel = |r: usize, channel: usize| Some(self.bins(g, r, &self.added(effects, [g, r], channel)?));
        let of_record = |r: usize| (0..n_channel).map(|channel| of_channel(r, channel)).collect();
        (0..self.groups[g].records.len()).map(of_record).collect()
    }

    /// The same in time on one `channel` (0: input) of record `r` of group `g`, m/s², as long as the event.
    pub(super) fn added(&self, effects: &[Box<dyn Effect>], [g, r]: [usize; 2], channel: usize) -> Option<Vec<f64>> {
        let event = &self.problem.events[self.groups[g].records[r].event];
        added(&self.problem.array, effects, event, channel)
    }
}

/// What `effects` add to one `channel` (0: input) of `event`, m/s², as far as the record tells; `None` where that is nothing.
pub(super) fn added(array: &Array, effects: &[Box<dyn Effect>], event: &Event, channel: usize) -> Option<Vec<f64>> {
    let acceleration_m_s2 = if channel == 0 { &event.input } else { event.outputs.get(channel - 1)? };
    let channel = Channel {
        sensor: array.sensors().nth(channel)?,
        component: array.components.get(event.component()).map_or("", String::as_str),
        event: &event.name,
        dt_s: event.dt_s,
        acceleration_m_s2,
    };
    effects.iter().filter_map(|e| e.estimated_interference(&channel)).reduce(|mut a, b| {
        a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
        a
    })
}

#[cfg(test)]
mod tests {
    use super::super::made_up::judged;
    use super::super::operators::Operators;
    use super::super::problem::Problem;
    use super::super::settings::DiagnoseSettings;
    use super::*;
    use crate::effects;

    #[test]
    fn what_the_input_sensor_adds_is_not_in_the_true_input() {
        let table = "kind = 'baseline_tilt'\nsensor = 'base'\ntilt_deg = 0.3\n";
        let tilt = effects::build_all(&[toml::from_str(table).unwrap()]).unwrap();
        let input = |problem: &Problem, effects: &[Box<dyn Effect>]| {
            let scene = Scene::new(problem, &DiagnoseSettings::default()).unwrap();
            let operators = Operators::new(&scene, effects);
            let padded = scene.padded_input(effects, &operators, 0, 0);
            (scene.true_input(effects, &operators, 0, 0), padded, scene.input_sensor(effects, &operators, 0))
        };
        let (plain, tilted) = (judged(""), judged(table));
        let (wanted, wanted_padded, _) = input(&plain, &[]);
        let far = |a: &[C64], b: &[C64]| a.iter().zip(b).map(|(a, b)| (a - b).norm_sqr()).sum::<f64>().sqrt();
        let (wrong, wrong_padded, as_it_is) = input(&tilted, &[]);
        let (found, found_padded, undone) = input(&tilted, &tilt);
        let (miss, without) = (far(&found, &wanted), far(&wrong, &wanted));
        assert!(miss < 0.02 * without, "{miss} of {without}");
        let (miss, without) = (far(&found_padded, &wanted_padded), far(&wrong_padded, &wanted_padded));
        assert!(miss < 0.02 * without, "{miss} of {without} to the convolver");
        assert!(as_it_is != undone, "another state of the input sensor");
    }
}
