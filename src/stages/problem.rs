//! What a diagnosis may look at: the array as declared and the records of training and validation events. The names of
//! held-out events count for the order of the array's history; their records are not opened.

use super::instrument::{Instrument, by_event};
use super::records;
use super::replay::{base_motions, replayed};
use super::shake::{Response, shake};
use crate::column::{Analysis, MassMatrix};
use crate::diagnosis::{self, DiagnoseSettings, Event, Motions, NoiseSpectrum, Problem, Replay};
use crate::effects::{Situation, Tolerances};
use crate::error::{Error, Result};
use crate::manifest::{ColumnSections, LayerSection};
use crate::numerics::resample::resample_band_limited;
use crate::pipeline::Task;
use crate::records::{Record, RecordSettings, Split};
use toml::Table;

/// Longest stretch of an event that is replayed, s: what is compared, and a lead for the column to forget that it began at rest.
const LONGEST_S: f64 = 45.0;
/// That lead, s.
const LEAD_S: f64 = 3.0;
/// Where replays are compared with records: small waves are slower by 0.3 % at the most.
const FINE: Resolution = Resolution { per_wave: 16.0, per_period: 20.0 };
/// Half of that, to tell what is not converged.
const HALVED: Resolution = Resolution { per_wave: 32.0, per_period: 40.0 };
/// Where replays are compared with each other only: by 1.2 %.
const ROUGH: Resolution = Resolution { per_wave: 8.0, per_period: 10.0 };

/// Elements and steps of a replay.
///
/// ```text
/// δc/c = (2π/n)²/24 − κ (2π/m)²,   κ = 0.095 of the HHT method with α = −0.05                 (1)
/// ```
///
/// | symbol | what       | argument   |
/// |--------|------------|------------|
/// | n      | elements to the shortest wave that is compared | per_wave   |
/// | m      | steps to its period                            | per_period |
///
/// with mass matched to steps as far as it can be, [`MassMatrix`].
///
/// Source: (1) as for [`MassMatrix`].
#[derive(Clone, Copy)]
struct Resolution {
    per_wave: f64,
    per_period: f64,
}

impl Resolution {
    /// `declared` in the elements and with the steps of a replay up to `high_hz`.
    fn of(self, declared: &ColumnSections, high_hz: f64) -> ColumnSections {
        let analysis = self.stepped(&declared.analysis, high_hz);
        ColumnSections { analysis, ..meshed(declared.clone(), self.per_wave, high_hz) }
    }

    /// Steps of a replay up to `high_hz`: whole output steps, or parts of one. Of one length: where they are shortened goes by limits,
    /// so that motions would jump by a little as parameters change.
    fn stepped(self, declared: &Analysis, high_hz: f64) -> Analysis {
        let step_s = 1.0 / (self.per_period * high_hz);
        let whole = (step_s / declared.output_step_s).floor().max(1.0) * declared.output_step_s;
        let max_step_s = step_s.min(whole);
        Analysis {
            max_step_s,
            initial_step_s: max_step_s,
            output_step_s: whole,
            mass: MassMatrix::Matched,
            max_jump: f64::INFINITY,
            ..declared.clone()
        }
    }
}

/// Sections that [`Bench::of`] needs of the stage that asks.
pub const READS: &[&str] = &[
    "site",
    "law",
    "effects",
    "sensors",
    "analysis",
    "tolerances",
    "diagnose",
    "records.format",
    "records.components",
    "records.train",
    "records.validation",
    "records.test",
];

/// The problem with what it takes to replay its events.
pub struct Bench<'a> {
    /// Where replays are cached; without one they are computed every time.
    task: Option<&'a Task<'a>>,
    sections: ColumnSections,
    /// The same in as many elements as waves need.
    fine: ColumnSections,
    /// The same in elements and steps half as large.
    halved: ColumnSections,
    /// The same in fewer elements and longer steps, for differences between replays.
    rough: ColumnSections,
    settings: RecordSettings,
    /// Their inputs without what is noise: what the column is shaken with.
    events: Vec<Vec<Record>>,
    /// What is known and what is to be explained.
    pub problem: Problem,
}

impl<'a> Bench<'a> {
    /// The problem of a stage that reads `READS` and has an input `records`.
    ///
    /// # Errors
    /// When a section is missing or a record cannot be read.
    pub fn of(task: &'a Task<'a>) -> Result<Self> {
        let sections = records::column(task)?;
        let settings: RecordSettings = task.section("records")?;
        let opened = records::settings_without_test(task)?;
        let found = by_event(records::read(task.input("records")?, &opened, &sections.sensors)?.records);
        let diagnose = task.section("diagnose")?;
        Self::new(Some(task), sections, &diagnose, task.section("tolerances")?, settings, found)
    }

    /// The problem that `events` of the array of `sections` pose, replayed as `diagnose` says; `settings` name its whole
    /// history.
    ///
    /// # Errors
    /// When the declared column cannot be built.
    pub fn new(
        task: Option<&'a Task<'a>>,
        sections: ColumnSections,
        diagnose: &DiagnoseSettings,
        tolerances: Tolerances,
        settings: RecordSettings,
        events: Vec<(Split, Vec<Record>)>,
    ) -> Result<Self> {
        let high_hz = diagnose.band_hz[1];
        let rough = no_finer(ROUGH.of(&sections, high_hz), &sections);
        let halved = HALVED.of(&sections, high_hz);
        // What is sought in soil is not to make up for what elements leave wrong.
        let fine = FINE.of(&sections, high_hz);
        let sections = no_finer(fine.clone(), &sections);
        let noise: Vec<_> =
            events.iter().map(|(_, r)| r.iter().map(|r| diagnosis::noise(r, settings.noise)).collect()).collect();
        let events: Vec<(Split, Vec<Record>)> = events.into_iter().map(|(split, r)| (split, strongest(r))).collect();
        let problem = problem(&sections, tolerances, &settings, &events, &noise)?;
        let quiet = |(mut record, noise): (Record, &Vec<NoiseSpectrum>)| {
            let input = &mut record.input.acceleration_m_s2;
            *input = diagnosis::denoised(input, record.dt_s, &noise[0]);
            record
        };
        let events =
            events.into_iter().zip(&noise).map(|((_, r), n)| r.into_iter().zip(n).map(quiet).collect()).collect();
        Ok(Self { task, sections, fine, halved, rough, settings, events, problem })
    }

    /// What the array would record of the replays under `effects` on top of the manifest's, event by event and component by
    /// component at the output step of the analysis.
    ///
    /// # Errors
    /// As [`Replay::replay`].
    pub fn recorded(&self, effects: &[Table], events: &[Vec<Record>]) -> Result<Vec<Response>> {
        let tables: Vec<Table> = self.sections.effects.iter().chain(effects).cloned().collect();
        let instrument = Instrument::new(&self.sections.sensors, self.sections.site.depth_m, &tables)?;
        replayed(self.task, &self.sections, &instrument, &self.settings, events)
    }
}

/// The records of an event, cut to the stretch with most input energy where they are long. Noise is that of the whole records.
fn strongest(records: Vec<Record>) -> Vec<Record> {
    let Some(first) = records.first().filter(|r| r.duration_s() > LONGEST_S) else { return records };
    let (n, longest) = (first.n_step(), ((LONGEST_S - LEAD_S) / first.dt_s) as usize);
    let power = |i: usize| records.iter().map(|r| r.input.acceleration_m_s2[i].powi(2)).sum::<f64>();
    let mut sum: f64 = (0..longest).map(power).sum();
    let (mut most, mut start) = (sum, 0);
    for i in longest..n {
        sum += power(i) - power(i - longest);
        // A little more energy is not worth losing the onset.
        if sum > 1.001 * most {
            (most, start) = (sum, i + 1 - longest);
        }
    }
    let start_s = (start as f64 * first.dt_s - LEAD_S).max(0.0);
    records.iter().map(|r| r.window(start_s, LONGEST_S)).collect()
}

/// `found` in the elements of `declared` where these are no more.
fn no_finer(found: ColumnSections, declared: &ColumnSections) -> ColumnSections {
    let site = if found.site.elements < declared.site.elements { found.site } else { declared.site.clone() };
    ColumnSections { site, ..found }
}

/// `sections` in `per_wave` elements to the shortest wave below `high_hz`, of one height but where those of each layer's own waves are
/// half as many.
fn meshed(mut sections: ColumnSections, per_wave: f64, high_hz: f64) -> ColumnSections {
    let even = evenly(&sections, per_wave, high_hz);
    let of = |l: &LayerSection| needed(l.thickness_m, per_wave, high_hz, l.vs_m_s);
    let by_layer: Vec<usize> = sections.site.layer.iter().map(of).collect();
    let graded: usize = by_layer.iter().sum();
    let is_graded = 2 * graded < even;
    let count = if is_graded { graded } else { even };
    let site = &mut sections.site;
    site.elements = count;
    for (layer, count) in site.layer.iter_mut().zip(by_layer) {
        let finer = count as f64 / graded as f64 * site.depth_m / layer.thickness_m;
        layer.fineness = if is_graded { finer } else { 1.0 };
    }
    sections
}

/// Elements that waves need in a layer.
fn needed(thickness_m: f64, per_wave: f64, high_hz: f64, vs_m_s: f64) -> usize {
    (thickness_m * per_wave * high_hz / vs_m_s).ceil() as usize
}

/// Elements of one height that waves need in the slowest layer, or up to twice as many where they then end at every layer and sensor.
/// Where they do not, an effect that cuts a layer also moves the others' elements, and its derivative is that of the mesh too.
fn evenly(sections: &ColumnSections, per_wave: f64, high_hz: f64) -> usize {
    let site = &sections.site;
    let slowest_m_s = site.layer.iter().map(|l| l.vs_m_s).fold(f64::INFINITY, f64::min);
    let least = needed(site.depth_m, per_wave, high_hz, slowest_m_s).max(site.layer.len());
    let mut depths_m: Vec<f64> = sections.sensors.output.iter().map(|s| s.depth_m).collect();
    depths_m.extend(site.layer.iter().scan(0.0, |depth_m, l| {
        *depth_m += l.thickness_m;
        Some(*depth_m)
    }));
    let ends_at = |depth_m: &f64, n: usize| {
        let above = depth_m / site.depth_m * n as f64;
        (above - above.round()).abs() < 1e-6
    };
    let ends_at_all = |n: &usize| depths_m.iter().all(|depth_m| ends_at(depth_m, *n));
    (least..=2 * least).find(ends_at_all).unwrap_or(least)
}

fn problem(
    sections: &ColumnSections,
    tolerances: Tolerances,
    settings: &RecordSettings,
    events: &[(Split, Vec<Record>)],
    noise: &[Vec<Vec<NoiseSpectrum>>],
) -> Result<Problem> {
    let event = |split: Split, record: &Record, noise: &[NoiseSpectrum]| {
        let component = settings.components.iter().position(|c| *c == record.component).unwrap_or(0);
        Event {
            name: record.event.clone(),
            situation: Situation::of(component, &record.event, settings.events().map(|(event, _)| event)),
            split,
            dt_s: record.dt_s,
            input: record.input.acceleration_m_s2.clone(),
            outputs: record.outputs.iter().map(|s| s.acceleration_m_s2.clone()).collect(),
            noise: noise.to_vec(),
        }
    };
    Ok(Problem {
        array: sections.array(&settings.components)?,
        declared: sections.effects.clone(),
        tolerances,
        events: events
            .iter()
            .zip(noise)
            .flat_map(|((split, records), noise)| records.iter().zip(noise).map(|(r, n)| event(*split, r, n)))
            .collect(),
    })
}

impl Replay for Bench<'_> {
    fn replay(&self, effects: &[Table]) -> Result<Motions> {
        self.replay_of(&self.fine, &self.events, effects)
    }

    fn replay_roughly(&self, effects: &[Table]) -> Result<Motions> {
        self.replay_of(&self.rough, &self.events, effects)
    }

    fn replay_in_halves(&self, effects: &[Table], is_wanted: &[bool]) -> Result<Option<[Motions; 2]>> {
        let of = |sections| self.replay_some(sections, effects, is_wanted);
        Ok(Some([of(&self.fine)?, of(&self.halved)?]))
    }
}

impl Bench<'_> {
    /// The replay of those events alone that are wanted.
    fn replay_some(&self, sections: &ColumnSections, effects: &[Table], is_wanted: &[bool]) -> Result<Motions> {
        let mut of_record = is_wanted.iter();
        let mut is_run = |n: usize| of_record.by_ref().take(n).filter(|wanted| **wanted).count() > 0;
        let is_run: Vec<bool> = self.events.iter().map(|records| is_run(records.len())).collect();
        let wanted = self.events.iter().zip(&is_run).filter(|(_, is_run)| **is_run);
        let events: Vec<Vec<Record>> = wanted.map(|(records, _)| records.clone()).collect();
        let mut found = self.replay_of(sections, &events, effects)?.into_iter();
        let nothing = || Err("not asked for".to_string());
        let by_record = self.events.iter().zip(is_run).flat_map(|(r, is_run)| std::iter::repeat_n(is_run, r.len()));
        Ok(by_record.map(|is_run| if is_run { found.next().unwrap_or_else(nothing) } else { nothing() }).collect())
    }

    fn replay_of(&self, sections: &ColumnSections, events: &[Vec<Record>], effects: &[Table]) -> Result<Motions> {
        let tables: Vec<Table> = sections.effects.iter().chain(effects).cloned().collect();
        let instrument = Instrument::new(&sections.sensors, sections.site.depth_m, &tables)?;
        let undone: Vec<Vec<Record>> = events.iter().map(|records| instrument.undone(records)).collect();
        let motions = base_motions(&undone, &self.settings);
        let shaken = shake(self.task, sections, instrument.effects(), &motions)?;
        if shaken.iter().all(Result::is_err) {
            let reason = shaken.into_iter().find_map(Result::err).unwrap_or_default();
            return Err(Error::new("the column finished in no event").cause(reason).of_model());
        }
        let step_s = sections.analysis.output_step_s;
        let at_records = |(record, response): (&Record, Response)| {
            let fitted = |history: &Vec<f64>| {
                let mut history = resample_band_limited(history, step_s, record.dt_s);
                history.resize(record.n_step(), 0.0);
                history
            };
            response.map(|histories| histories.iter().map(fitted).collect())
        };
        Ok(undone.iter().flatten().zip(shaken).map(at_records).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::Manifest;
    use std::path::Path;

    #[test]
    fn replays_have_elements_for_the_waves_that_are_compared() {
        let of = |name: &str| {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs").join(name);
            let site = Manifest::load(&path, &[]).expect("a sound site").site;
            let sections = site.column();
            let high_hz = DiagnoseSettings::default().band_hz[1];
            let [fine, rough] = [FINE, ROUGH].map(|resolution| no_finer(resolution.of(&sections, high_hz), &sections));
            assert_eq!([&fine, &rough].map(|s| s.analysis.max_step_s), [0.005, 0.01]);
            [fine.site.elements, rough.site.elements]
        };
        // 17 m and 16 elements to 110 m/s over 9.5 Hz are 24, but 17 layers end at whole metres.
        assert_eq!(of("lotung.toml"), [34, 17]);
        // 10 m to 130 m/s are 12, but a sensor is at 5 m and a layer ends at 4 m.
        assert_eq!(of("smoke.toml"), [20, 10]);
        // Thick rock below soil: 2 + 21 + 3 + 10 + 7, and 120 are declared.
        assert_eq!(of("fksh11.toml"), [43, 23]);
    }
}
