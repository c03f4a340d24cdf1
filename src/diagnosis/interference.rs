//! What instruments add by themselves, estimated from the records that carry it.

use super::responses::Scene;
use crate::effects::{Channel, Effect};
use realfft::num_complex::Complex;

type C64 = Complex<f64>;

impl Scene<'_> {
    /// Spectra to take out of the records of group `g`: `[record][channel]`, `None` where nothing was added.
    pub fn estimated_interference(&self, effects: &[Box<dyn Effect>], g: usize) -> Vec<Vec<Option<Vec<C64>>>> {
        let group = &self.groups[g];
        let array = &self.problem.array;
        let of_record = |(r, record): (usize, &super::spectra::RecordSpectra)| {
            let event = &self.problem.events[record.event];
            let component = array.components.get(event.component()).map_or("", String::as_str);
            let histories = std::iter::once(&event.input).chain(&event.outputs);
            let of_channel = |(sensor, history): (&str, &Vec<f64>)| {
                let channel =
                    Channel { sensor, component, event: &event.name, dt_s: event.dt_s, acceleration_m_s2: history };
                let added = effects.iter().filter_map(|e| e.estimated_interference(&channel)).reduce(|mut a, b| {
                    a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
                    a
                });
                added.map(|x| self.bins(g, r, &x))
            };
            array.sensors().zip(histories).map(of_channel).collect()
        };
        group.records.iter().enumerate().map(of_record).collect()
    }
}
