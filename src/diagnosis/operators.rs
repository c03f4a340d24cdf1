//! The sensor side of a set of effects, sorted by sensor once for many frequencies.

use super::responses::Scene;
use crate::effects::{Effect, Operator, Place};
use realfft::num_complex::Complex;
use std::sync::{Arc, Mutex, PoisonError};

type C64 = Complex<f64>;

/// What each sensor makes of the motion, and what else arrives there.
pub struct Operators<'e> {
    /// Effects at each sensor, the input sensor first.
    acting: Vec<Vec<&'e dyn Effect>>,
    arriving: Vec<&'e dyn Effect>,
    names: Vec<&'e str>,
    components: &'e [String],
    /// What undoes the input sensor.
    undone: Tables,
    /// What output sensors make of the motion, `[bin][sensor]`.
    outputs: Tables,
}

/// Operators at the frequencies asked for so far.
#[derive(Default)]
struct Tables(Mutex<Vec<Table>>);

struct Table {
    frequencies_hz: Vec<f64>,
    operators: Arc<Vec<Operator>>,
}

impl Tables {
    /// The table at these frequencies, made by `of` where it is not known yet.
    fn at(&self, frequencies_hz: &[f64], of: impl FnOnce() -> Vec<Operator>) -> Arc<Vec<Operator>> {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(table) = known.iter().find(|k| k.frequencies_hz == frequencies_hz) {
            return table.operators.clone();
        }
        let operators = Arc::new(of());
        known.push(Table { frequencies_hz: frequencies_hz.to_vec(), operators: operators.clone() });
        operators
    }
}

impl<'e> Operators<'e> {
    /// Sorts `effects` by the sensors of `scene`.
    pub fn new(scene: &'e Scene<'_>, effects: &'e [Box<dyn Effect>]) -> Self {
        let names: Vec<&str> = scene.problem.array.sensors().collect();
        let components = scene.problem.array.components.as_slice();
        let at = |name: &&str| -> Vec<&dyn Effect> {
            let place = Place { sensor: name, components };
            effects.iter().map(AsRef::as_ref).filter(|e| e.response(&place, 1.0).is_some()).collect()
        };
        Self {
            acting: names.iter().map(at).collect(),
            arriving: effects.iter().map(AsRef::as_ref).filter(|e| e.arrival(0.0, 1.0).is_some()).collect(),
            names,
            components,
            undone: Tables::default(),
            outputs: Tables::default(),
        }
    }

    /// What sensor `index` (0: input) makes of the motion.
    pub fn at(&self, index: usize, frequency_hz: f64) -> Operator {
        let place = Place { sensor: self.names[index], components: self.components };
        let all = self.acting[index].iter().filter_map(|e| e.response(&place, frequency_hz));
        all.reduce(|all, next| next.after(&all)).unwrap_or(Operator::IDENTITY)
    }

    /// What undoes the input sensor at these frequencies: once for all records that share them.
    pub fn input_undone(&self, frequencies_hz: &[f64]) -> Arc<Vec<Operator>> {
        self.undone.at(frequencies_hz, || frequencies_hz.iter().map(|f| self.at(0, *f).undone()).collect())
    }

    /// What output sensors make of the motion at these frequencies, `[bin][sensor]`: once for all events that share them.
    pub fn outputs(&self, frequencies_hz: &[f64]) -> Arc<Vec<Operator>> {
        let at = |f: &f64| (1..self.names.len()).map(|sensor| self.at(sensor, *f)).collect::<Vec<_>>();
        self.outputs.at(frequencies_hz, || frequencies_hz.iter().flat_map(at).collect())
    }

    /// Whether there are further arrivals.
    pub fn has_arrivals(&self) -> bool {
        !self.arriving.is_empty()
    }

    /// Further arrivals at `depth_m`, as a factor on the true base motion.
    pub fn arrival(&self, depth_m: f64, frequency_hz: f64) -> C64 {
        self.arriving.iter().filter_map(|e| e.arrival(depth_m, frequency_hz)).sum()
    }
}

/// Entry of an operator between two components; components beyond the second pass unchanged.
pub fn entry(operator: &Operator, to: usize, from: usize) -> C64 {
    match (to, from) {
        (0 | 1, 0 | 1) => operator.0[to][from],
        _ if to == from => C64::new(1.0, 0.0),
        _ => C64::default(),
    }
}

impl Scene<'_> {
    /// The channel on which the motion of `sensor` (0: input) was recorded.
    pub fn source(&self, effects: &[Box<dyn Effect>], sensor: usize) -> usize {
        let array = &self.problem.array;
        let index = |name: &str| array.sensors().position(|s| s == name);
        let mut at = sensor;
        for (a, b) in effects.iter().filter_map(|e| e.exchange()) {
            if let (Some(a), Some(b)) = (index(a), index(b)) {
                at = if at == a {
                    b
                } else if at == b {
                    a
                } else {
                    at
                };
            }
        }
        at
    }

    /// `operator` applied to the records of group `g`, for the component of `event`.
    pub fn mixed(&self, operator: &Operator, g: usize, event: usize, value: impl Fn(usize) -> C64) -> C64 {
        let to = self.problem.events[event].component();
        let records = self.groups[g].records.iter().enumerate();
        records.map(|(r, record)| entry(operator, to, self.problem.events[record.event].component()) * value(r)).sum()
    }

    /// True base motion of record `r` of group `g`, by bin.
    pub fn true_input(&self, effects: &[Box<dyn Effect>], operators: &Operators<'_>, g: usize, r: usize) -> Vec<C64> {
        let group = &self.groups[g];
        let source = self.source(effects, 0);
        let added = |c: usize| Some(self.bins(g, c, &self.added(effects, [g, c], source)?));
        let added: Vec<Option<Vec<C64>>> = (0..group.records.len()).map(added).collect();
        let recorded = |c: usize, k: usize| group.records[c].channels[source][k] - taken(&added[c], k);
        let event = group.records[r].event;
        let undone = operators.input_undone(&group.frequencies_hz);
        undone.iter().enumerate().map(|(k, undone)| self.mixed(undone, g, event, |c| recorded(c, k))).collect()
    }

    /// The same at the frequencies of the convolver.
    pub fn padded_input(&self, effects: &[Box<dyn Effect>], operators: &Operators<'_>, g: usize, r: usize) -> Vec<C64> {
        let group = &self.groups[g];
        let source = self.source(effects, 0);
        let added = |c: usize| {
            let added = self.added(effects, [g, c], source)?;
            Some(group.convolver.forward(added.get(group.records[c].window.clone())?))
        };
        let added: Vec<Option<Vec<C64>>> = (0..group.records.len()).map(added).collect();
        let recorded = |c: usize, k: usize| group.records[c].padded[source][k] - taken(&added[c], k);
        let event = group.records[r].event;
        let undone = operators.input_undone(&group.convolver.frequencies_hz);
        undone.iter().enumerate().map(|(k, undone)| self.mixed(undone, g, event, |c| recorded(c, k))).collect()
    }
}

fn taken(added: &Option<Vec<C64>>, k: usize) -> C64 {
    added.as_ref().map_or(C64::default(), |added| added[k])
}
