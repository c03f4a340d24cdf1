//! Stage 3: the latent coefficients of one component from its measured events.

use super::instrument::{Concern, Instrument, by_event, narrow};
use super::{budget, dataset, records};
use crate::dataset::{Coarse, Normalisation};
use crate::error::{Error, Result};
use crate::flare::{
    self, CalibrateSettings, Case, Data, Event, Metric, Observation, SourceModel, SparseEncoder, calibrate,
};
use crate::manifest::SensorsSection;
use crate::pipeline::{Stage, Task};
use crate::records::{Record, Split};

/// Calibrates one component.
pub struct Calibrate;

impl Stage for Calibrate {
    fn kind(&self) -> &'static str {
        "calibrate"
    }

    fn about(&self) -> &'static str {
        "stage 3: latent coefficients from a few measured events, one component at a time"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        READS
    }

    fn unkeyed(&self) -> &'static [&'static str] {
        budget::UNKEYED
    }

    fn narrow(&self, parameters: &mut toml::Table) {
        narrow(parameters, Concern::Sensors);
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let bench = Bench::of(task)?;
        let checkpoint_dir = Some(task.checkpoint_dir()?);
        let Bench { model, encoder, observation, settings, .. } = &bench;
        let found = calibrate(model, encoder, observation, &bench.data(), settings, checkpoint_dir, task.progress())?;
        found.save(task.output_dir(), &model.shape)
    }
}

/// Sections that [`Bench::of`] needs of the stage that asks. Not `records.test`: what is held out is not even opened here.
pub const READS: &[&str] = &[
    "calibrate",
    "sensors",
    "site.depth_m",
    "effects",
    "records.format",
    "records.components",
    "records.train",
    "records.validation",
];

/// Models and events of the component of a stage that has the inputs `dataset`, `pretrain`, `distill` and `records`.
pub struct Bench {
    pub settings: CalibrateSettings,
    pub model: SourceModel,
    pub normalisation: flare::Normalisation,
    pub encoder: SparseEncoder,
    pub observation: Observation,
    simulations: Vec<Case>,
    train: Vec<Event>,
    validation: Vec<Event>,
}

impl Bench {
    /// # Errors
    /// When an input or a section is missing or damaged.
    pub fn of(task: &Task<'_>) -> Result<Self> {
        let settings: CalibrateSettings = task.section("calibrate")?;
        let record_settings = records::settings_without_test(task)?;
        let sensors: SensorsSection = task.section("sensors")?;
        let component = task.each().ok_or_else(|| Error::new("this stage needs `each = \"records.components\"`"))?;
        let card = dataset::card(task.input("dataset")?)?;
        let (model, normalisation) = SourceModel::load(task.input("pretrain")?)?;
        let (encoder, observation) = SparseEncoder::load(task.input("distill")?)?;
        let found = records::read(task.input("records")?, &record_settings, &sensors)?;
        let instrument = Instrument::of(task)?;
        let undone: Vec<(Split, Vec<Record>)> =
            by_event(found.records).into_iter().map(|(split, records)| (split, instrument.undone(&records))).collect();
        let events = |split| -> Vec<Event> {
            let records = undone.iter().filter(|(s, _)| *s == split).flat_map(|(_, records)| records);
            records.filter(|r| r.component == component).map(|r| event(r, card.step_s, &card.normalisation)).collect()
        };
        let (train, validation) = (events(Split::Train), events(Split::Validation));
        let simulations = match settings.metric {
            Metric::Field => dataset::cases(task.input("dataset")?, &card.train, &budget::spill(task)?)?,
            Metric::Coefficients => Vec::new(),
        };
        Ok(Self { settings, model, normalisation, encoder, observation, simulations, train, validation })
    }

    /// What the component is calibrated on.
    pub fn data(&self) -> Data<'_> {
        Data { simulations: &self.simulations, train: &self.train, validation: &self.validation }
    }
}

/// A record as the latent model sees it.
pub fn event(record: &Record, step_s: f64, normalisation: &Normalisation) -> Event {
    let coarse = Coarse::of_record(record, step_s);
    Event {
        id: record.event.clone(),
        u: normalisation.base(&coarse.base_m_s2),
        u_half: normalisation.base(&coarse.base_half_m_s2),
        sparse: normalisation.sparse(&coarse.sparse_m_s2),
    }
}
