//! What a closed loop left: records, manifests of its models, and histories of the held-out events. The report and the export read it.

use super::instrument::Instrument;
use super::{compare, correct, histories, records};
use crate::column::Column;
use crate::dataset::DepthProfile;
use crate::diagnosis::PREDICTIONS;
use crate::effects::Situation;
use crate::error::Result;
use crate::manifest::ColumnSections;
use crate::metrics::{DAMPING, SensorTransfer, arias_build_up_m_s, peak, peak_velocity_m_s, psa, psa_periods_s};
use crate::numerics::resample::resample_band_limited;
use crate::pipeline::Task;
use crate::records::{Record, RecordSettings, Split};
use crate::report::content::{
    DepthModel, DepthView, EventView, ModelView, ResidualView, SensorView, Series, TransferView,
};
use crate::units::{G_M_S2, KPA};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Finest step spectra are computed at, s.
const SPECTRUM_STEP_S: f64 = 0.005;
/// Longest period of the spectra, s.
const LONGEST_S: f64 = 10.0;

/// What is read of the outputs of the stages.
#[derive(Debug, Clone)]
pub struct Closed {
    /// Folder of the comparison.
    pub compare: PathBuf,
    /// The column as declared, recalibrated and corrected, the last two where anything was changed.
    pub models: Vec<(&'static str, ColumnSections)>,
    /// Records with their split.
    pub records: Vec<(Split, Record)>,
    settings: RecordSettings,
}

/// A column shaken by the motion of one component of an event.
pub struct Shaken {
    /// `declared` or `corrected`.
    pub model: &'static str,
    /// Largest acceleration at the base, g.
    pub pga_g: f64,
    /// What it does over depth.
    pub profile: DepthProfile,
}

impl Closed {
    /// Of the inputs of a stage; none where it does not have them.
    ///
    /// # Errors
    /// When a section of the manifest is missing, or an output cannot be read.
    pub fn of(task: &Task<'_>) -> Result<Option<Self>> {
        if !["compare", "recalibrate", "correct", "records"].iter().all(|role| task.has_input(role)) {
            return Ok(None);
        }
        let folder = |role: &str| task.input(role).map(Path::to_path_buf);
        Self::read(folder, task.section("records")?, records::column(task)?).map(Some)
    }

    /// Of the folders of the stages with `[records]` and the declared column.
    ///
    /// # Errors
    /// When an output cannot be read.
    pub fn read(
        folder: impl Fn(&str) -> Result<PathBuf>,
        settings: RecordSettings,
        declared: ColumnSections,
    ) -> Result<Self> {
        let of = |stage: &str| with_effects_of(&folder(stage)?.join(correct::FILE), &declared);
        let changed = [("recalibrated", of("recalibrate")?), ("corrected", of("correct")?)];
        let changed = changed.into_iter().filter(|(_, sections)| sections.effects != declared.effects);
        let models = changed.collect::<Vec<_>>();
        Ok(Self {
            compare: folder("compare")?,
            records: records::read(&folder("records")?, &settings, &declared.sensors)?.records,
            models: std::iter::once(("declared", declared)).chain(models).collect(),
            settings,
        })
    }

    /// The declared column.
    pub fn declared(&self) -> &ColumnSections {
        &self.models[0].1
    }

    /// The held-out events with the record and every model.
    ///
    /// # Errors
    /// When the histories cannot be read.
    pub fn events(&self, found: &compare::Compared) -> Result<Vec<EventView>> {
        let period_s: Vec<f64> =
            psa_periods_s().into_iter().filter(|period_s| *period_s <= LONGEST_S * 1.001).collect();
        let depth_m =
            |sensor: &str| self.declared().sensors.output.iter().find(|s| s.name == sensor).map(|s| s.depth_m);
        let events = histories::read(&self.compare)?;
        let view = |event: &histories::Event| {
            let sensors = event.sensors.iter().enumerate().map(|(j, sensor)| {
                let errors = found
                    .errors
                    .iter()
                    .find(|r| r.event == event.event && r.component == event.component && r.sensor == *sensor);
                let models = event.axes.iter().flat_map(|axis| {
                    axis.models.iter().map(|(model, of_sensors)| {
                        let x = &of_sensors[j];
                        let step_s = SPECTRUM_STEP_S.min(axis.step_s);
                        let fine = resample_band_limited(x, axis.step_s, step_s);
                        ModelView {
                            model: model.clone(),
                            psa_m_s2: psa(&fine, step_s, DAMPING, &period_s),
                            pgv_m_s: peak_velocity_m_s(x, axis.step_s),
                            arias_m_s: arias_build_up_m_s(x, axis.step_s).last().copied().unwrap_or(0.0),
                            nrmse_percent: errors.and_then(|row| row.nrmse_percent.get(model).copied().flatten()),
                            history: Series { start_s: axis.start_s, step_s: axis.step_s, values: x.clone() },
                        }
                    })
                });
                SensorView {
                    sensor: sensor.clone(),
                    depth_m: depth_m(sensor),
                    period_s: period_s.clone(),
                    models: models.collect(),
                }
            });
            EventView {
                event: event.event.clone(),
                component: event.component.clone(),
                input: Series { start_s: 0.0, step_s: event.axes[0].step_s, values: event.input.clone() },
                sensors: sensors.collect(),
            }
        };
        Ok(events.par_iter().map(view).collect())
    }

    /// The column as declared and corrected under the motion of one component of an event; a model that cannot finish it is left out.
    ///
    /// # Errors
    /// When a column cannot be built.
    pub fn shaken(&self, event: &str, component: &str) -> Result<Vec<Shaken>> {
        let records: Vec<Record> = self.records.iter().map(|(_, r)| r).filter(|r| r.event == event).cloned().collect();
        let number = self.settings.components.iter().position(|c| c == component).unwrap_or(0);
        let situation = Situation::of(number, event, self.settings.events().map(|(event, _)| event));
        let mut found = Vec::new();
        for (model, sections) in self.models.iter().filter(|(model, _)| *model != "recalibrated") {
            let instrument = Instrument::new(&sections.sensors, sections.site.depth_m, &sections.effects)?;
            let undone = instrument.undone(&records);
            let Some(motion) = undone.into_iter().find(|r| r.component == component) else { continue };
            let column = Column::new(&sections.profile_for(&situation)?, &sections.analysis)?;
            let base_m_s2 = &motion.input.acceleration_m_s2;
            let output_step_s = sections.analysis.output_step_s;
            if let Ok(profile) = DepthProfile::of(&column, base_m_s2, motion.dt_s, output_step_s) {
                found.push(Shaken { model, pga_g: peak(base_m_s2) / G_M_S2, profile });
            }
        }
        Ok(found)
    }
}

/// What columns do over depth under the motion of one component of an event.
pub fn over_depth(event: &str, component: &str, shaken: &[Shaken]) -> DepthView {
    let scaled = |values: &[f64], factor: f64| values.iter().map(|v| factor * v).collect::<Vec<f64>>();
    let of = |Shaken { model, profile, .. }: &Shaken| {
        let weakest = &profile.histories[profile.weakest];
        let stress_strain =
            weakest.gamma.iter().zip(&weakest.tau_pa).map(|(g, t)| (100.0 * f64::from(*g), f64::from(*t) / KPA));
        DepthModel {
            model: (*model).into(),
            pga_g: scaled(&profile.acceleration_m_s2, 1.0 / G_M_S2),
            strain_percent: scaled(&profile.gamma, 100.0),
            stress_kpa: scaled(&profile.tau_pa, 1.0 / KPA),
            pore_ratio: profile.pore_ratio.clone(),
            loop_depth_m: profile.depth_m[profile.weakest],
            stress_strain: stress_strain.collect(),
            depth_m: profile.depth_m.clone(),
        }
    };
    DepthView {
        event: event.into(),
        component: component.into(),
        pga_g: shaken.last().map_or(0.0, |s| s.pga_g),
        models: shaken.iter().map(of).collect(),
    }
}

/// The declared sections with the effects of a manifest that a stage wrote; it holds those it adds and those before them.
fn with_effects_of(path: &Path, declared: &ColumnSections) -> Result<ColumnSections> {
    #[derive(serde::Deserialize)]
    struct Changed {
        effects: Option<Vec<toml::Table>>,
    }
    let changed: Changed = super::artifact::read_toml(path)?;
    Ok(ColumnSections { effects: changed.effects.unwrap_or_else(|| declared.effects.clone()), ..declared.clone() })
}

/// Transfer functions of weak events.
pub fn transfers(found: &compare::Compared) -> Vec<TransferView> {
    let numbers = |values: &[Option<f64>]| values.iter().map(|v| v.unwrap_or(f64::NAN)).collect::<Vec<f64>>();
    let of = |place: &SensorTransfer| TransferView {
        component: place.component.clone(),
        sensor: place.sensor.clone(),
        frequencies_hz: place.curves.frequencies_hz.clone(),
        recorded_ln: numbers(&place.curves.recorded_ln),
        sigma_ln: numbers(&place.curves.recorded_sigma_ln),
        predicted_ln: place.curves.predicted_ln.iter().map(|(model, ln)| (model.clone(), numbers(ln))).collect(),
        n_event: place.curves.n_event,
    };
    found.summary.transfer.iter().filter(|place| place.curves.n_event > 0).map(of).collect()
}

/// Mean and standard deviation of the ln ratio of spectra over all events and components, by sensor.
pub fn residuals(events: &[EventView]) -> Vec<ResidualView> {
    let mut sensors: Vec<&str> = Vec::new();
    for sensor in events.iter().flat_map(|e| &e.sensors) {
        if !sensors.contains(&sensor.sensor.as_str()) {
            sensors.push(&sensor.sensor);
        }
    }
    let of = |name: &&str| {
        let views: Vec<&SensorView> = events.iter().flat_map(|e| &e.sensors).filter(|s| s.sensor == **name).collect();
        let by_period = |model: &&str| {
            let ratios: Vec<Vec<f64>> = views
                .iter()
                .filter_map(|view| {
                    let of = |key: &str| view.models.iter().find(|m| m.model == key);
                    let (predicted, record) = (of(model)?, of("record")?);
                    Some(predicted.psa_m_s2.iter().zip(&record.psa_m_s2).map(|(p, a)| (p / a).ln()).collect())
                })
                .collect();
            let n = ratios.len() as f64;
            let n_period = ratios.first()?.len();
            let mean: Vec<f64> = (0..n_period).map(|k| ratios.iter().map(|r| r[k]).sum::<f64>() / n).collect();
            let deviation =
                |k: usize| (ratios.iter().map(|r| (r[k] - mean[k]).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            let sigma = (0..n_period).map(deviation).collect();
            Some(((*model).to_string(), mean, sigma))
        };
        ResidualView {
            sensor: (*name).to_string(),
            period_s: views.first().map(|v| v.period_s.clone()).unwrap_or_default(),
            models: PREDICTIONS.iter().filter_map(by_period).collect(),
            n: views.len(),
        }
    };
    sensors.iter().map(of).collect()
}
