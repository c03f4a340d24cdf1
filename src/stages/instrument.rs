//! Between the records as measured and the true motions, by the sensor effects of a manifest.
//!
//! A corrected manifest undoes its sensor effects on records before anything is learnt or shaken, and applies them to
//! every prediction, so that all errors compare with the **records as measured**. What an instrument adds by itself (hum,
//! tilt) nobody predicts: its estimate from the record is added to a prediction of that record. Without sensor effects
//! everything passes unchanged, to the bit.

use crate::effects::{self, Channels, Direction, Effect, Recording, observe};
use crate::error::Result;
use crate::manifest::SensorsSection;
use crate::numerics::resample::resample_band_limited;
use crate::pipeline::Task;
use crate::records::{Record, Split};
use toml::{Table, Value};

/// The sensors of an array and the effects that act on them.
pub struct Instrument {
    effects: Vec<Box<dyn Effect>>,
    /// The input sensor first.
    sensors: Vec<String>,
    depths_m: Vec<f64>,
}

impl Instrument {
    /// The sensors at their declared depths over a column `depth_m` deep, under the effects `tables`.
    ///
    /// # Errors
    /// When an effect cannot be built.
    pub fn new(sensors: &SensorsSection, depth_m: f64, tables: &[Table]) -> Result<Self> {
        let outputs = sensors.output.iter();
        Ok(Self {
            effects: effects::build_all(tables)?,
            sensors: std::iter::once(sensors.input.clone()).chain(sensors.names()).collect(),
            depths_m: std::iter::once(depth_m).chain(outputs.map(|s| s.depth_m)).collect(),
        })
    }

    /// That of the manifest a stage reads: its `sensors`, `site.depth_m` and `effects`.
    ///
    /// # Errors
    /// When a section is missing or an effect cannot be built.
    pub fn of(task: &Task<'_>) -> Result<Self> {
        let tables: Vec<Table> = task.optional("effects")?.unwrap_or_default();
        Self::new(&task.section("sensors")?, task.section("site.depth_m")?, &tables)
    }

    /// The effects.
    pub fn effects(&self) -> &[Box<dyn Effect>] {
        &self.effects
    }

    /// The true motions behind the `records` of one event, a record a component.
    pub fn undone(&self, records: &[Record]) -> Vec<Record> {
        self.changed(records, Direction::Undo)
    }

    /// The `records` of one event as if the effects acted on what was measured.
    pub fn distorted(&self, records: &[Record]) -> Vec<Record> {
        self.changed(records, Direction::Distort)
    }

    /// What the sensors would record of true motions (`[sensor][component][step]`, the input sensor first, `dt_s` apart)
    /// in the event of `records`, with what the instruments added to those.
    pub fn recorded(&self, records: &[Record], dt_s: f64, motions: &[Channels]) -> Vec<Channels> {
        if self.effects.is_empty() {
            return motions.to_vec();
        }
        let mut predicted = self.observe(records, dt_s, motions, Direction::Predict);
        let cleaned = self.changed(records, Direction::Clean);
        for (c, (record, clean)) in records.iter().zip(&cleaned).enumerate() {
            for (s, (measured, clean)) in record.sensors().zip(clean.sensors()).enumerate() {
                if measured == clean {
                    continue;
                }
                let pairs = measured.acceleration_m_s2.iter().zip(&clean.acceleration_m_s2);
                let added: Vec<f64> = pairs.map(|(m, c)| m - c).collect();
                let added = resample_band_limited(&added, record.dt_s, dt_s);
                predicted[s][c].iter_mut().zip(added).for_each(|(x, a)| *x += a);
            }
        }
        predicted
    }

    fn changed(&self, records: &[Record], direction: Direction) -> Vec<Record> {
        let Some(first) = records.first().filter(|_| !self.effects.is_empty()) else { return records.to_vec() };
        let changed = self.observe(records, first.dt_s, &channels(records), direction);
        let mut records = records.to_vec();
        for (c, record) in records.iter_mut().enumerate() {
            record.input.acceleration_m_s2 = changed[0][c].clone();
            for (s, output) in record.outputs.iter_mut().enumerate() {
                output.acceleration_m_s2 = changed[s + 1][c].clone();
            }
        }
        records
    }

    fn observe(&self, records: &[Record], dt_s: f64, motions: &[Channels], direction: Direction) -> Vec<Channels> {
        let components: Vec<String> = records.iter().map(|r| r.component.clone()).collect();
        let event = records.first().map_or("", |r| r.event.as_str());
        let recording =
            Recording { event, dt_s, sensors: &self.sensors, depths_m: &self.depths_m, components: &components };
        observe(&recording, motions, &self.effects, direction)
    }
}

/// Histories `[sensor][component][step]` of the records of one event, the input sensor first.
fn channels(records: &[Record]) -> Vec<Channels> {
    let n_sensor = records.first().map_or(0, |r| r.outputs.len() + 1);
    let history = |record: &Record, s: usize| match s {
        0 => record.input.acceleration_m_s2.clone(),
        _ => record.outputs[s - 1].acceleration_m_s2.clone(),
    };
    (0..n_sensor).map(|s| records.iter().map(|r| history(r, s)).collect()).collect()
}

/// Records event by event; components that do not share a time axis stand alone.
pub fn by_event(records: Vec<(Split, Record)>) -> Vec<(Split, Vec<Record>)> {
    let shares_axis = |a: &Record, b: &Record| a.event == b.event && a.dt_s == b.dt_s && a.n_step() == b.n_step();
    let mut events: Vec<(Split, Vec<Record>)> = Vec::new();
    for (split, record) in records {
        match events.last_mut() {
            Some((_, group)) if shares_axis(&group[0], &record) => group.push(record),
            _ => events.push((split, vec![record])),
        }
    }
    events
}

/// Which effects of a manifest concern a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Concern {
    /// Those that edit the column or move a sensor in it.
    Column,
    /// Those between the true motion and the record.
    Sensors,
}

/// Keeps those effects of a stage's parameters that concern it, so that the others rerun nothing.
pub fn narrow(parameters: &mut Table, concern: Concern) {
    let Some(Value::Array(tables)) = parameters.get_mut("effects") else { return };
    tables.retain(|table| {
        let Some(table) = table.as_table() else { return true };
        let kind = table.get("kind").and_then(Value::as_str).unwrap_or_default();
        // What cannot be found is kept: the stage says what is wrong with it.
        effects::find(kind).map_or(true, |entry| match (concern, entry.catalogue.class) {
            (Concern::Column, _) => effects::changes_motion(table),
            (Concern::Sensors, class) => !class.moves_column() || has_arrival(table),
        })
    });
    if tables.is_empty() {
        parameters.remove("effects");
    }
}

/// Whether an effect sends a further arrival, which sensors record beside the motion of the column.
fn has_arrival(table: &Table) -> bool {
    effects::build(table).is_ok_and(|effect| effect.arrival(0.0, 1.0).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::OutputSection;
    use crate::records::Sensor;

    fn table(text: &str) -> Table {
        toml::from_str(text).expect("the text is TOML")
    }

    fn instrument(effects: &[&str]) -> Instrument {
        let output = vec![OutputSection { name: "surface".into(), depth_m: 0.0 }];
        let tables: Vec<Table> = effects.iter().map(|e| table(e)).collect();
        Instrument::new(&SensorsSection { input: "base".into(), output }, 10.0, &tables).expect("sound effects")
    }

    fn records(n_step: usize) -> Vec<Record> {
        let wave = |i: usize, f: f64| (f * i as f64 * 0.01).sin() * (-((i as f64 - 500.0) / 150.0).powi(2)).exp();
        let sensor = |name: &str, f: f64| Sensor {
            name: name.into(),
            acceleration_m_s2: (0..n_step).map(|i| wave(i, f)).collect(),
        };
        let record = |component: &str, f: f64| Record {
            event: "E".into(),
            component: component.into(),
            dt_s: 0.01,
            input: sensor("base", f),
            outputs: vec![sensor("surface", 1.5 * f)],
        };
        vec![record("EW", 9.0), record("NS", 14.0)]
    }

    fn distance(a: &Channels, b: &Channels) -> f64 {
        let pairs = a.iter().flatten().zip(b.iter().flatten());
        pairs.fold(0.0, |m, (x, y)| f64::max(m, (x - y).abs()))
    }

    #[test]
    fn what_is_undone_and_recorded_again_is_the_record() {
        let records = records(1000);
        let measured = channels(&records);
        let idle = instrument(&["kind = 'layer_velocity'\nln_factor = 0.1"]);
        assert_eq!(idle.undone(&records), records);
        assert_eq!(idle.recorded(&records, 0.01, &measured), measured);
        let turned = instrument(&[
            "kind = 'sensor_orientation'\nsensor = 'surface'\nazimuth_deg = 20.0",
            "kind = 'sensor_gain'\nsensor = 'base'\nln_gain = -0.2",
            "kind = 'machine_hum'\nsensor = 'surface'\nfrequency_hz = 7.0\namplitude_m_s2 = 0.05",
        ]);
        let undone = turned.undone(&records);
        assert!(distance(&channels(&undone)[1], &measured[1]) > 0.1);
        let back = turned.recorded(&records, 0.01, &channels(&undone));
        for (back, measured) in back.iter().zip(&measured) {
            assert!(distance(back, measured) < 2e-3, "{}", distance(back, measured));
        }
    }

    #[test]
    fn a_stage_sees_the_effects_that_concern_it() {
        let text = "[[effects]]\nkind = 'sensor_gain'\nsensor = 'surface'\nln_gain = 0.1\n\
                    [[effects]]\nkind = 'sensor_depth'\nsensor = 'mid'\noffset_m = 0.4\n\
                    [[effects]]\nkind = 'small_strain_damping'\nmultiplier = 2.0\n";
        let kinds = |concern| {
            let mut parameters = table(text);
            narrow(&mut parameters, concern);
            let kept = parameters["effects"].as_array().expect("a list").iter();
            kept.map(|e| e["kind"].as_str().expect("a text").to_string()).collect::<Vec<_>>()
        };
        assert_eq!(kinds(Concern::Column), ["sensor_depth", "small_strain_damping"]);
        assert_eq!(kinds(Concern::Sensors), ["sensor_gain", "sensor_depth"]);
        let mut parameters = table("[[effects]]\nkind = 'small_strain_damping'\nmultiplier = 2.0\n");
        narrow(&mut parameters, Concern::Sensors);
        assert!(parameters.is_empty(), "as if there were none");
    }

    #[test]
    fn components_of_an_event_stand_together_where_they_share_their_time() {
        let mut all = records(1000);
        all.push(records(900).remove(0));
        all[2].event = "F".into();
        all.push(Record { component: "NS".into(), ..records(800).remove(0) });
        all[3].event = "F".into();
        let events = by_event(all.into_iter().map(|r| (Split::Train, r)).collect());
        assert_eq!(events.iter().map(|(_, records)| records.len()).collect::<Vec<_>>(), [2, 1, 1]);
    }
}
