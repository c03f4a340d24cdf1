//! What a closed loop left: records, manifests of its models, and histories of the held-out events. The report and the export read it.

use super::instrument::Instrument;
use super::{compare, correct, histories, records};
use crate::column::Column;
use crate::dataset::DepthProfile;
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

/// Folders of the stages, and the sections of the manifest that say what is in them.
#[derive(Debug, Clone)]
pub struct Closed {
    /// Output of the comparison.
    pub compare: PathBuf,
    /// Outputs with the recalibrated and the corrected manifest.
    pub manifests: [PathBuf; 2],
    /// Output with the records.
    pub records: PathBuf,
    /// `[records]`
    pub settings: RecordSettings,
    /// The declared column.
    pub declared: ColumnSections,
}

/// A column and its motion.
pub struct Shaken {
    /// The column.
    pub column: Column,
    /// Step of the motion, s.
    pub dt_s: f64,
    /// Motion at the base, m/s².
    pub base_m_s2: Vec<f64>,
    /// Step of the output, s.
    pub output_step_s: f64,
}

/// Stages whose outputs are read.
pub const ROLES: [&str; 4] = ["compare", "recalibrate", "correct", "records"];

impl Closed {
    /// Of the inputs of a stage; none where it does not have them.
    ///
    /// # Errors
    /// When a section of the manifest is missing.
    pub fn of(task: &Task<'_>) -> Result<Option<Self>> {
        if !ROLES.iter().all(|role| task.has_input(role)) {
            return Ok(None);
        }
        let folder = |role: &str| task.input(role).map(Path::to_path_buf);
        Ok(Some(Self {
            compare: folder("compare")?,
            manifests: [folder("recalibrate")?, folder("correct")?],
            records: folder("records")?,
            settings: task.section("records")?,
            declared: records::column(task)?,
        }))
    }

    /// Records with their split.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn read_records(&self) -> Result<Vec<(Split, Record)>> {
        Ok(records::read(&self.records, &self.settings, &self.declared.sensors)?.records)
    }

    /// The column as declared, recalibrated and corrected.
    ///
    /// # Errors
    /// When a manifest cannot be read.
    pub fn models(&self) -> Result<[(&'static str, ColumnSections); 3]> {
        let [recalibrated, corrected] = &self.manifests;
        let of = |folder: &Path| with_effects_of(&folder.join(correct::FILE), &self.declared);
        Ok([("declared", self.declared.clone()), ("recalibrated", of(recalibrated)?), ("corrected", of(corrected)?)])
    }

    /// The held-out events with the record and every model.
    ///
    /// # Errors
    /// When the histories cannot be read.
    pub fn events(&self, found: &compare::Compared) -> Result<Vec<EventView>> {
        let period_s: Vec<f64> =
            psa_periods_s().into_iter().filter(|period_s| *period_s <= LONGEST_S * 1.001).collect();
        let depth_m = |sensor: &str| self.declared.sensors.output.iter().find(|s| s.name == sensor).map(|s| s.depth_m);
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
                        let fine = resample_band_limited(x, axis.step_s, SPECTRUM_STEP_S.min(axis.step_s));
                        let step_s = SPECTRUM_STEP_S.min(axis.step_s);
                        ModelView {
                            model: model.clone(),
                            psa_m_s2: psa(&fine, step_s, DAMPING, &period_s),
                            pgv_m_s: peak_velocity_m_s(x, axis.step_s),
                            arias_m_s: arias_build_up_m_s(x, axis.step_s).last().copied().unwrap_or(0.0),
                            nrmse_percent: errors.and_then(|row| of_model(&row.nrmse_percent, model)),
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

    /// The column of `sections` and the motion that shakes it in one component of an event, m/s² at the step returned.
    ///
    /// # Errors
    /// When a record cannot be read or the column not be built.
    pub fn shaken(&self, event: &str, component: &str, sections: &ColumnSections) -> Result<Option<Shaken>> {
        let read = self.read_records()?;
        let records: Vec<Record> = read.into_iter().map(|(_, r)| r).filter(|r| r.event == event).collect();
        let number = self.settings.components.iter().position(|c| c == component).unwrap_or(0);
        let situation = Situation::of(number, event, self.settings.events().map(|(event, _)| event));
        let instrument = Instrument::new(&sections.sensors, sections.site.depth_m, &sections.effects)?;
        let undone = instrument.undone(&records);
        let Some(motion) = undone.into_iter().find(|r| r.component == component) else { return Ok(None) };
        Ok(Some(Shaken {
            column: Column::new(&sections.profile_for(&situation)?, &sections.analysis)?,
            dt_s: motion.dt_s,
            base_m_s2: motion.input.acceleration_m_s2,
            output_step_s: sections.analysis.output_step_s,
        }))
    }

    /// The column as declared and corrected under the motion of one component of an event; a model that cannot finish it is left out.
    ///
    /// # Errors
    /// When a record cannot be read or a column not be built.
    pub fn over_depth(&self, event: &str, component: &str) -> Result<DepthView> {
        let mut view = DepthView { event: event.into(), component: component.into(), ..DepthView::default() };
        for (model, sections) in self.models()?.into_iter().filter(|(model, _)| *model != "recalibrated") {
            let Some(shaken) = self.shaken(event, component, &sections)? else { continue };
            view.pga_g = peak(&shaken.base_m_s2) / G_M_S2;
            let found = DepthProfile::of(&shaken.column, &shaken.base_m_s2, shaken.dt_s, shaken.output_step_s);
            let Ok(found) = found else { continue };
            let scaled = |values: &[f64], factor: f64| values.iter().map(|v| factor * v).collect::<Vec<f64>>();
            let stress_strain = found.loop_gamma.iter().zip(&found.loop_tau_pa).map(|(g, t)| (100.0 * g, t / KPA));
            view.models.push(DepthModel {
                model: model.into(),
                pga_g: scaled(&found.acceleration_m_s2, 1.0 / G_M_S2),
                strain_percent: scaled(&found.gamma, 100.0),
                stress_kpa: scaled(&found.tau_pa, 1.0 / KPA),
                pore_ratio: found.pore_ratio.clone(),
                loop_depth_m: found.depth_m[found.weakest],
                stress_strain: stress_strain.collect(),
                depth_m: found.depth_m,
            });
        }
        Ok(view)
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

fn of_model(six: &crate::diagnosis::Six<Option<f64>>, model: &str) -> Option<f64> {
    match model {
        "declared" => six.declared,
        "recalibrated" => six.recalibrated,
        "corrected" => six.corrected,
        "flare_before" => six.flare_before,
        "flare_after" => six.flare_after,
        _ => None,
    }
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
        let models = ["declared", "recalibrated", "corrected", "flare_before", "flare_after"];
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
            models: models.iter().filter_map(by_period).collect(),
            n: views.len(),
        }
    };
    sensors.iter().map(of).collect()
}
