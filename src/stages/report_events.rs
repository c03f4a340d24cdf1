//! From records, manifests and the comparison's histories to the report's sections on the site, its events and spectra.

use super::instrument::Instrument;
use super::{compare, correct, histories, records};
use crate::column::Column;
use crate::dataset::DepthProfile;
use crate::effects::Situation;
use crate::error::Result;
use crate::manifest::ColumnSections;
use crate::metrics::{DAMPING, arias_build_up_m_s, peak, peak_velocity_m_s, psa, psa_periods_s};
use crate::numerics::resample::resample_band_limited;
use crate::pipeline::Task;
use crate::records::{Record, RecordSettings, Split};
use crate::report::content::{
    Content, DepthModel, DepthView, EventRow, EventView, LayerView, ModelView, ProfileView, ResidualView, SensorPlace,
    SensorView, Series, SiteView, TransferView,
};
use crate::units::{G_M_S2, KPA};
use rayon::prelude::*;

/// Finest step spectra are computed at, s.
const SPECTRUM_STEP_S: f64 = 0.005;
/// Longest period of the spectra, s.
const LONGEST_S: f64 = 10.0;
/// Depth over which velocities are averaged to class a site, m.
const CLASS_DEPTH_M: f64 = 30.0;
/// Lowest Vs30 of the classes A to D of Eurocode 8 (EN 1998-1:2004, table 3.1) and of A to D of NEHRP (ASCE 7-16, table 20.3-1), m/s.
const EUROCODE_M_S: [(f64, &str); 3] = [(800.0, "A"), (360.0, "B"), (180.0, "C")];
const NEHRP_M_S: [(f64, &str); 4] = [(1500.0, "A"), (760.0, "B"), (360.0, "C"), (180.0, "D")];

/// `content` with the site, its events and spectra, where the pipeline closes the loop.
///
/// # Errors
/// When an output cannot be read.
pub fn added(task: &Task<'_>, content: Content) -> Result<Content> {
    if !["compare", "recalibrate", "correct", "records"].iter().all(|role| task.has_input(role)) {
        return Ok(content);
    }
    let declared: ColumnSections = records::column(task)?;
    let found = compare::read(task.input("compare")?)?;
    let events = events(task, &declared, &found)?;
    let transfer = |place: &crate::metrics::SensorTransfer| TransferView {
        component: place.component.clone(),
        sensor: place.sensor.clone(),
        frequencies_hz: place.curves.frequencies_hz.clone(),
        recorded_ln: place.curves.recorded_ln.clone(),
        sigma_ln: place.curves.recorded_sigma_ln.clone(),
        predicted_ln: place.curves.predicted_ln.clone().into_iter().collect(),
        n_event: place.curves.n_event,
    };
    let transfers = found.summary.transfer.iter().filter(|place| place.curves.n_event > 0).map(transfer).collect();
    let depth = over_depth(task, &declared)?;
    Ok(Content {
        depth,
        site_view: Some(site(task, &declared)?),
        residuals: residuals(&events),
        events,
        transfers,
        ..content
    })
}

fn site(task: &Task<'_>, declared: &ColumnSections) -> Result<SiteView> {
    let profile = declared.declared_profile()?;
    let mut depth_m = 0.0;
    let mut layers = Vec::new();
    for layer in &profile.layers {
        let top_m = depth_m;
        depth_m += layer.thickness_m;
        layers.push(LayerView { top_m, bottom_m: depth_m, law: layer.law_kind.clone() });
    }
    let mut profiles = Vec::new();
    let corrected = [("recalibrated", "recalibrate"), ("corrected", "correct")];
    for (model, role) in std::iter::once(("declared", None)).chain(corrected.map(|(model, role)| (model, Some(role)))) {
        let sections = match role {
            None => declared.clone(),
            Some(role) => with_effects_of(&task.input(role)?.join(correct::FILE), declared)?,
        };
        let mut top_m = 0.0;
        let tops = sections.profile()?.layers.into_iter().map(|layer| {
            let top = [top_m, layer.vs_m_s];
            top_m += layer.thickness_m;
            top
        });
        profiles.push(ProfileView { model: model.into(), tops: tops.collect() });
    }
    let sensors = &declared.sensors;
    let input = SensorPlace { name: sensors.input.clone(), depth_m: profile.depth_m(), is_input: true };
    let outputs =
        sensors.output.iter().map(|s| SensorPlace { name: s.name.clone(), depth_m: s.depth_m, is_input: false });
    Ok(SiteView {
        depth_m,
        layers,
        facts: facts(&profile),
        profiles,
        sensors: std::iter::once(input).chain(outputs).collect(),
        water_table_m: Some(profile.water_table_m).filter(|w| *w > 0.0 && *w < depth_m),
        events: rows(task, declared)?,
    })
}

/// The column as declared and corrected under the strongest motion of the held-out events; a model that cannot finish it is left out.
fn over_depth(task: &Task<'_>, declared: &ColumnSections) -> Result<Option<DepthView>> {
    let settings: RecordSettings = task.section("records")?;
    let read = records::read(task.input("records")?, &settings, &declared.sensors)?.records;
    let held_out = read.iter().filter(|(split, _)| *split == Split::Test).map(|(_, record)| record);
    let Some(strongest) = held_out.max_by(|a, b| a.input_pga_m_s2().total_cmp(&b.input_pga_m_s2())) else {
        return Ok(None);
    };
    let event: Vec<Record> = read.iter().filter(|(_, r)| r.event == strongest.event).map(|(_, r)| r.clone()).collect();
    let component = settings.components.iter().position(|c| *c == strongest.component).unwrap_or(0);
    let situation = Situation::of(component, &strongest.event, settings.events().map(|(event, _)| event));
    let corrected = with_effects_of(&task.input("correct")?.join(correct::FILE), declared)?;
    let mut models = Vec::new();
    for (model, sections) in [("declared", declared), ("corrected", &corrected)] {
        let instrument = Instrument::new(&sections.sensors, sections.site.depth_m, &sections.effects)?;
        let undone = instrument.undone(&event);
        let Some(motion) = undone.iter().find(|r| r.component == strongest.component) else { continue };
        let column = Column::new(&sections.profile_for(&situation)?, &sections.analysis)?;
        let step_s = sections.analysis.output_step_s;
        let Ok(found) = DepthProfile::of(&column, &motion.input.acceleration_m_s2, motion.dt_s, step_s) else {
            continue;
        };
        let scaled = |values: &[f64], factor: f64| values.iter().map(|v| factor * v).collect::<Vec<f64>>();
        models.push(DepthModel {
            model: model.into(),
            pga_g: scaled(&found.acceleration_m_s2, 1.0 / G_M_S2),
            strain_percent: scaled(&found.gamma, 100.0),
            stress_kpa: scaled(&found.tau_pa, 1.0 / KPA),
            pore_ratio: found.pore_ratio.clone(),
            loop_depth_m: found.depth_m[found.weakest],
            stress_strain: found.loop_gamma.iter().zip(&found.loop_tau_pa).map(|(g, t)| (100.0 * g, t / KPA)).collect(),
            depth_m: found.depth_m,
        });
    }
    let (event, component) = (strongest.event.clone(), strongest.component.clone());
    Ok(Some(DepthView { event, component, pga_g: strongest.input_pga_m_s2() / G_M_S2, models }))
}

/// The declared sections with the effects of a manifest that a stage wrote; it holds those it adds and those before them.
fn with_effects_of(path: &std::path::Path, declared: &ColumnSections) -> Result<ColumnSections> {
    #[derive(serde::Deserialize)]
    struct Changed {
        effects: Option<Vec<toml::Table>>,
    }
    let changed: Changed = super::artifact::read_toml(path)?;
    Ok(ColumnSections { effects: changed.effects.unwrap_or_else(|| declared.effects.clone()), ..declared.clone() })
}

fn facts(profile: &crate::column::Profile) -> Vec<(String, String)> {
    let depth_m = profile.depth_m();
    let mut facts = vec![
        ("Depth of the column".to_string(), format!("{depth_m} m")),
        (
            "Fundamental frequency f₀ by travel time".to_string(),
            format!("{:.2} Hz as declared", profile.fundamental_hz()),
        ),
    ];
    let (mut top_m, mut travel_s) = (0.0, 0.0);
    for layer in &profile.layers {
        let within_m = (CLASS_DEPTH_M - top_m).clamp(0.0, layer.thickness_m);
        travel_s += within_m / layer.vs_m_s;
        top_m += layer.thickness_m;
    }
    if depth_m < CLASS_DEPTH_M {
        let mean_m_s = depth_m / profile.travel_time_s();
        facts.push((
            format!("Mean Vs of {depth_m} m"),
            format!("{mean_m_s:.0} m/s; no Vs30: the column ends above 30 m"),
        ));
        return facts;
    }
    let vs30_m_s = CLASS_DEPTH_M / travel_s;
    let class = |limits: &[(f64, &'static str)], last: &'static str| {
        limits.iter().find(|(from, _)| vs30_m_s > *from).map_or(last, |(_, class)| class)
    };
    facts.push(("Vs30".into(), format!("{vs30_m_s:.0} m/s as declared")));
    let classes = format!("{} (Eurocode 8), {} (NEHRP)", class(&EUROCODE_M_S, "D"), class(&NEHRP_M_S, "E"));
    facts.push(("Site class by Vs30".into(), classes));
    facts
}

fn rows(task: &Task<'_>, declared: &ColumnSections) -> Result<Vec<EventRow>> {
    let settings: RecordSettings = task.section("records")?;
    let read = records::read(task.input("records")?, &settings, &declared.sensors)?;
    let row = |(split, record): &(Split, crate::records::Record)| EventRow {
        event: record.event.clone(),
        component: record.component.clone(),
        split: match split {
            Split::Train => "calibration",
            Split::Validation => "selection",
            Split::Test => "held out",
        }
        .into(),
        pga_g: record.sensors().map(|s| peak(&s.acceleration_m_s2) / G_M_S2).collect(),
        duration_s: record.duration_s(),
    };
    Ok(read.records.iter().map(row).collect())
}

fn events(task: &Task<'_>, declared: &ColumnSections, found: &compare::Compared) -> Result<Vec<EventView>> {
    let period_s: Vec<f64> = psa_periods_s().into_iter().filter(|period_s| *period_s <= LONGEST_S * 1.001).collect();
    let depth_m = |sensor: &str| declared.sensors.output.iter().find(|s| s.name == sensor).map(|s| s.depth_m);
    let events = histories::read(task.input("compare")?)?;
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

/// Mean and standard deviation of the ln ratio of spectra over all events and components, by sensor.
fn residuals(events: &[EventView]) -> Vec<ResidualView> {
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
