//! What a model lets every sensor record, in the frequency domain: motions of the column by replay, what sensors make of them by
//! their operators.
//!
//! ```text
//! θ ─► replay (rough + difference to the fine one at the anchor) ─► window, taper, transform ─► operators ─► prediction
//! ```
//!
//! Only what shakes the column is replayed; whatever else is asked for of the same shaking comes from memory.

mod discretisation;

use super::coherence::coherent;
use super::equivalent::Equivalent;
use crate::diagnosis::spectra::{self, Group};
use crate::diagnosis::{DiagnoseSettings, Motions, Problem, Replay};
use crate::effects::{self, Channel, Effect, Operator, Place};
use crate::error::{Error, Result};
use crate::numerics::spectrum;
use realfft::num_complex::Complex;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use toml::Table;

type C64 = Complex<f64>;

/// One value a bin for each sensor, `[sensor][bin]`.
pub type Bins = Vec<Vec<C64>>;

/// What a sensor is taken to be labelled with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Label {
    /// The channel on which it was recorded.
    pub channel: usize,
    /// Whether its components carry each other's name.
    pub is_crossed: bool,
}

/// What is predicted of one record.
#[derive(Debug, Clone)]
pub struct Predicted {
    /// What the output sensors record, `[sensor][bin]`.
    pub outputs: Bins,
    /// Motion of the base, by bin.
    pub base: Vec<C64>,
    /// What each output sensor recorded, less what instruments added by themselves, `[sensor][bin]`.
    pub measured: Bins,
    /// The label of each sensor, the input sensor first.
    pub labels: Vec<Label>,
    /// Share of the power that strays from the base which is of another origin and comes on top of the column's motion.
    pub added_share: f64,
}

impl Predicted {
    /// What output sensor `s` recorded at bin `k` beside the mean motion there, where its coherence is `c`.
    pub fn residual(&self, s: usize, k: usize, c: f64) -> C64 {
        self.measured[s][k] - coherent(c, self.added_share) * self.outputs[s][k]
    }
}

/// A prediction of every record, group by group.
pub type Prediction = Vec<Predicted>;

/// Motions at the output sensors by record.
type Replayed = Arc<Vec<Bins>>;

/// Where a record stands.
#[derive(Debug, Clone, Copy)]
pub struct At {
    /// Its group: the event.
    pub group: usize,
    /// Its place in the group: the component.
    pub record: usize,
}

/// What the fine replay at one state of the column corrects.
#[derive(Clone)]
struct Anchor {
    key: String,
    /// Fine less rough, by record.
    difference: Arc<Vec<Bins>>,
}

/// The column and the sensors of a problem.
pub struct Forward<'a> {
    /// What is known and what is to be explained.
    pub problem: &'a Problem,
    /// Events as spectra.
    pub groups: Arc<Vec<Group>>,
    /// Every record in order.
    pub records: Vec<At>,
    replay: &'a dyn Replay,
    /// What stands for replays but where it is anchored.
    equivalent: Option<Equivalent>,
    names: Vec<String>,
    /// Motions by what shakes the column; whoever asks for what is being replayed waits for it.
    known: Mutex<HashMap<String, Arc<Mutex<Option<Replayed>>>>>,
    anchor: Mutex<Option<Anchor>>,
    replays: Mutex<usize>,
}

impl<'a> Forward<'a> {
    /// Prepares `problem`.
    ///
    /// # Errors
    /// When an event is unusable.
    pub fn new(problem: &'a Problem, replay: &'a dyn Replay, settings: &DiagnoseSettings) -> Result<Self> {
        let groups = spectra::groups(problem, settings)?;
        Ok(Self::of(problem, replay, Arc::new(groups)))
    }

    fn of(problem: &'a Problem, replay: &'a dyn Replay, groups: Arc<Vec<Group>>) -> Self {
        let of_group = |(group, g): (usize, &Group)| (0..g.records.len()).map(move |record| At { group, record });
        let records: Vec<At> = groups.iter().enumerate().flat_map(of_group).collect();
        Self {
            problem,
            records,
            groups,
            replay,
            equivalent: None,
            names: problem.array.sensors().map(String::from).collect(),
            known: Mutex::default(),
            anchor: Mutex::default(),
            replays: Mutex::default(),
        }
    }

    /// The same, nothing replayed yet.
    pub fn again(&self) -> Self {
        Self::of(self.problem, self.replay, self.groups.clone())
    }

    /// The same with the equivalent-linear column in place of replays, known nowhere yet; see [`Forward::follow`].
    pub fn equivalent_linear(&self) -> Self {
        Self { equivalent: Some(Equivalent::default()), ..self.again() }
    }

    /// Whether the equivalent-linear column is what replays are taken for.
    pub fn is_equivalent_linear(&self) -> bool {
        self.equivalent.is_some()
    }

    /// Replays run so far.
    pub fn replays(&self) -> usize {
        *lock(&self.replays)
    }

    /// Frequencies of the bins of a record, Hz.
    pub fn frequencies_hz(&self, at: At) -> &[f64] {
        &self.groups[at.group].frequencies_hz
    }

    /// Whether an effect of this table changes how the column is shaken.
    fn is_shaken(&self, table: &Table) -> bool {
        let text = |key: &str| table.get(key).and_then(toml::Value::as_str);
        let input = Some(self.problem.array.input.as_str());
        effects::changes_column(table) || text("sensor") == input || text("with") == input
    }

    fn spectra_of(&self, motions: Motions) -> Result<Vec<Bins>> {
        let of = |at: &At| {
            let record = &self.groups[at.group].records[at.record];
            let event = &self.problem.events[record.event];
            let unfinished = |reason: &String| {
                let error = Error::new("the column did not finish").cause(reason.as_str()).of_model();
                error.at(format!("event `{}`", event.name))
            };
            let motion = motions[record.event].as_ref().map_err(unfinished)?;
            Ok(motion.iter().map(|history| self.bins(*at, history)).collect())
        };
        self.records.iter().map(of).collect()
    }

    /// Spectrum of a history as the record `at` is seen.
    fn bins(&self, at: At, history: &[f64]) -> Vec<C64> {
        self.groups[at.group].bins(at.record, history)
    }

    /// Those of `tables` that move the column.
    fn shaken(&self, tables: &[Table]) -> Vec<Table> {
        tables.iter().filter(|t| self.is_shaken(t)).cloned().collect()
    }

    /// Motions at the output sensors of the rough replay under the effects that move the column, as spectra.
    fn motions(&self, tables: &[Table]) -> Result<Replayed> {
        let shaken = self.shaken(tables);
        let key = key(&shaken);
        let entry = lock(&self.known).entry(key).or_default().clone();
        let mut known = lock(&entry);
        if let Some(known) = &*known {
            return Ok(known.clone());
        }
        *lock(&self.replays) += 1;
        let found = Arc::new(match &self.equivalent {
            Some(equivalent) => equivalent.motions(self, &shaken)?,
            None => self.spectra_of(self.replay.replay_roughly(&shaken)?)?,
        });
        *known = Some(found.clone());
        Ok(found)
    }

    /// Makes the fine replay at `tables` the anchor: from now on rough replays are corrected by what the two differ there.
    ///
    /// # Errors
    /// When the column cannot be replayed.
    pub fn anchor(&self, tables: &[Table]) -> Result<()> {
        let shaken = self.shaken(tables);
        let key = key(&shaken);
        if lock(&self.anchor).as_ref().is_some_and(|anchor| anchor.key == key) {
            return Ok(());
        }
        let mut difference = self.spectra_of(self.replay.replay(&shaken)?)?;
        add(&mut difference, &self.motions(tables)?, -1.0);
        *lock(&self.anchor) = Some(Anchor { key, difference: Arc::new(difference) });
        Ok(())
    }

    /// Takes over what `whole` knows of the same column under `tables`: its anchor, or the motions there for the equivalent-linear column,
    /// from which that leads on.
    ///
    /// # Errors
    /// When the column cannot be built or replayed.
    pub fn follow(&self, whole: &Self, tables: &[Table]) -> Result<()> {
        let anchor = if let Some(equivalent) = &self.equivalent {
            let shaken = self.shaken(tables);
            let mut difference = whole.corrected(&shaken)?.to_vec();
            let own = equivalent.tune(self, &shaken, &difference)?;
            add(&mut difference, &own, -1.0);
            lock(&self.known).clear();
            Some(Anchor { key: key(&shaken), difference: Arc::new(difference) })
        } else {
            lock(&whole.anchor).clone()
        };
        *lock(&self.anchor) = anchor;
        Ok(())
    }

    /// What few elements and long steps leave wrong at the anchor, by record: nothing before there is one.
    pub fn numerical_error(&self) -> Option<Arc<Vec<Bins>>> {
        lock(&self.anchor).as_ref().map(|anchor| anchor.difference.clone())
    }

    /// What every sensor records under `tables` on top of what is declared.
    ///
    /// # Errors
    /// When an effect cannot be built or the column cannot be replayed.
    pub fn predict(&self, tables: &[Table]) -> Result<Prediction> {
        self.recorded(tables, &self.corrected(tables)?)
    }

    /// Motions at the output sensors under `tables` by record, less what few elements and long steps leave wrong of them at the anchor.
    ///
    /// # Errors
    /// As [`Forward::predict`].
    pub fn corrected(&self, tables: &[Table]) -> Result<Replayed> {
        let rough = self.motions(tables)?;
        let Some(difference) = self.numerical_error() else { return Ok(rough) };
        let mut motions = rough.to_vec();
        add(&mut motions, &difference, 1.0);
        Ok(Arc::new(motions))
    }

    /// What every sensor records of `motions`, `[record][sensor][bin]`.
    ///
    /// # Errors
    /// When an effect cannot be built.
    pub fn recorded(&self, tables: &[Table], motions: &[Bins]) -> Result<Prediction> {
        let built = built(self.problem, tables)?;
        let labels = self.labels(&built);
        let mut prediction = Vec::with_capacity(self.records.len());
        let mut first = 0;
        for g in 0..self.groups.len() {
            let count = self.groups[g].records.len();
            prediction.extend(self.of_group(g, &built, &labels, &motions[first..first + count]));
            first += count;
        }
        Ok(prediction)
    }

    /// What records of group `g` become by `operators` in the component of record `to`, `inputs` those of each record.
    fn through(&self, g: usize, operators: Option<&Vec<Operator>>, to: usize, inputs: &[&[C64]]) -> Vec<C64> {
        let records = &self.groups[g].records;
        let component = |r: usize| self.problem.events[records[r].event].component();
        // What a single component loses to the other cannot be told from a gain.
        let entry = |o: &Operator, from: usize| match (records.len(), component(to), component(from)) {
            (1, ..) => o.0[0][0],
            (_, to @ (0 | 1), from @ (0 | 1)) => o.0[to][from],
            (_, a, b) => C64::from(f64::from(u8::from(a == b))),
        };
        let Some(operators) = operators else { return inputs[to].to_vec() };
        let at = |(k, o): (usize, &Operator)| (0..records.len()).map(|q| entry(o, q) * inputs[q][k]).sum();
        operators.iter().enumerate().map(at).collect()
    }

    /// Recorded channels of group `g` less interference, and the motion of its base, by record.
    fn bases_of(&self, g: usize, built: &[Box<dyn Effect>], labels: &[Label]) -> (Vec<Bins>, Bins) {
        let n_record = self.groups[g].records.len();
        let measured: Vec<Bins> = (0..n_record).map(|record| self.measured(At { group: g, record }, built)).collect();
        let undone: Option<Vec<Operator>> =
            self.operators(g, built, 0).map(|all| all.iter().map(Operator::undone).collect());
        let recorded: Vec<&[C64]> = measured.iter().map(|m| m[labels[0].channel].as_slice()).collect();
        let bases = (0..n_record).map(|r| self.through(g, undone.as_ref(), r, &recorded)).collect();
        (measured, bases)
    }

    /// The label of each sensor, the input sensor first.
    fn labels(&self, built: &[Box<dyn Effect>]) -> Vec<Label> {
        (0..self.names.len()).map(|s| self.label(built, s)).collect()
    }

    /// Motion of the base in each record.
    pub fn bases(&self, built: &[Box<dyn Effect>]) -> Bins {
        let labels = self.labels(built);
        (0..self.groups.len()).flat_map(|g| self.bases_of(g, built, &labels).1).collect()
    }

    fn of_group(&self, g: usize, built: &[Box<dyn Effect>], labels: &[Label], motions: &[Bins]) -> Vec<Predicted> {
        let n_record = self.groups[g].records.len();
        let (measured, bases) = self.bases_of(g, built, labels);
        let arriving: Vec<&dyn Effect> =
            built.iter().map(AsRef::as_ref).filter(|e| e.arrival(0.0, 1.0).is_some()).collect();
        let n_sensor = self.names.len() - 1;
        // What each output sensor records, by record.
        let recorded_by = |s: usize| -> Vec<Vec<C64>> {
            let operators = self.operators(g, built, s + 1);
            let own: Vec<Vec<C64>> = (0..n_record)
                .map(|r| {
                    let mut motion = motions[r][s].clone();
                    if !arriving.is_empty() {
                        let more = self.arrivals(At { group: g, record: r }, &arriving, s);
                        motion.iter_mut().zip(more).for_each(|(m, a)| *m += a);
                    }
                    motion
                })
                .collect();
            let own: Vec<&[C64]> = own.iter().map(Vec::as_slice).collect();
            (0..n_record).map(|r| self.through(g, operators.as_ref(), r, &own)).collect()
        };
        let mut outputs: Vec<Bins> = vec![Vec::with_capacity(n_sensor); n_record];
        for by_record in (0..n_sensor).map(recorded_by) {
            outputs.iter_mut().zip(by_record).for_each(|(outputs, own)| outputs.push(own));
        }
        let rows = outputs.into_iter().zip(bases).zip(measured);
        rows.map(|((outputs, base), channels)| Predicted {
            outputs,
            base,
            measured: labels[1..].iter().map(|label| channels[label.channel].clone()).collect(),
            labels: labels.to_vec(),
            added_share: 0.0,
        })
        .collect()
    }

    /// Recorded channels less interference, the input sensor first.
    fn measured(&self, at: At, built: &[Box<dyn Effect>]) -> Bins {
        let record = &self.groups[at.group].records[at.record];
        let event = &self.problem.events[record.event];
        let array = &self.problem.array;
        let channel = |s: usize| {
            let history = if s == 0 { &event.input } else { &event.outputs[s - 1] };
            let channel = Channel {
                sensor: &self.names[s],
                component: array.components.get(event.component()).map_or("", String::as_str),
                event: &event.name,
                dt_s: event.dt_s,
                acceleration_m_s2: history,
            };
            let mut bins = record.channels[s].clone();
            for added in built.iter().filter_map(|e| e.estimated_interference(&channel)) {
                bins.iter_mut().zip(self.bins(at, &added)).for_each(|(b, a)| *b -= a);
            }
            bins
        };
        (0..self.names.len()).map(channel).collect()
    }

    /// What sensor `index` makes of motions at the bins of group `g`; `None` where it changes nothing.
    fn operators(&self, g: usize, built: &[Box<dyn Effect>], index: usize) -> Option<Vec<Operator>> {
        let place = Place { sensor: &self.names[index], components: &self.problem.array.components };
        effects::operator(built, &place, 1.0)?;
        let at = |f: &f64| effects::operator(built, &place, *f).unwrap_or(Operator::IDENTITY);
        Some(self.groups[g].frequencies_hz.iter().map(at).collect())
    }

    /// What the motion of `sensor` is labelled with.
    fn label(&self, built: &[Box<dyn Effect>], sensor: usize) -> Label {
        let index = |name: &str| self.names.iter().position(|n| n == name);
        let pairs = || built.iter().filter_map(|e| e.exchange()).filter_map(|(a, b)| index(a).zip(index(b)));
        let channel = pairs().fold(sensor, |at, (a, b)| match at {
            at if at == a => b,
            at if at == b => a,
            at => at,
        });
        let crossings = pairs().filter(|(a, b)| *a == sensor && a == b).count();
        Label { channel, is_crossed: crossings % 2 == 1 }
    }

    /// Further arrivals at output sensor `s` of a record: what arrives late is beyond its end, not at its beginning.
    fn arrivals(&self, at: At, arriving: &[&dyn Effect], s: usize) -> Vec<C64> {
        let event = &self.problem.events[self.groups[at.group].records[at.record].event];
        let depth_m = self.problem.array.depths_m[s];
        let factor = |f: f64| arriving.iter().filter_map(|e| e.arrival(depth_m, f)).sum::<C64>();
        let [arrived] = spectrum::respond([event.input.as_slice()], event.dt_s, |f, [u]| [u * factor(f)]);
        self.bins(at, &arrived)
    }
}

fn add(to: &mut [Bins], from: &[Bins], factor: f64) {
    for (to, from) in to.iter_mut().flatten().flatten().zip(from.iter().flatten().flatten()) {
        *to += from * factor;
    }
}

/// The labels of the sensors of a prediction.
pub fn labels(prediction: &Prediction) -> &[Label] {
    prediction.first().map_or(&[], |p| &p.labels)
}

/// What is declared, and `tables` on top of it.
///
/// # Errors
/// When an effect cannot be built.
pub fn built(problem: &Problem, tables: &[Table]) -> Result<Vec<Box<dyn Effect>>> {
    let all: Vec<Table> = problem.declared.iter().chain(tables).cloned().collect();
    effects::build_all(&all)
}

/// What tells one state of the column from another.
fn key(tables: &[Table]) -> String {
    tables.iter().map(|t| format!("{t};")).collect()
}

pub fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
