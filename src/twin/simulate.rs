//! Events of a twin site: base motion, truth column, and what the sensors record of it.

use super::observe::{Channels, observe};
use super::{Draw, Truth};
use crate::column::Column;
use crate::dataset::sensor_histories;
use crate::effects::{self, Situation};
use crate::error::{Error, Result};
use crate::manifest::{ColumnSections, Tolerances};
use crate::motion::{self, MotionSettings};
use crate::numerics::resample;
use crate::records::{Record, Sensor, add_noise};

/// Sampling of twin records, s.
const STEP_S: f64 = 0.01;

/// The truth of one site, ready to record events.
pub struct Recorder<'a> {
    site: &'a ColumnSections,
    truth: &'a Truth,
    draw: Draw,
    column: Column,
}

/// Prepares the truth column of `site` under `truth`.
///
/// # Errors
/// When the truth names an unknown law or effect, or the column cannot be built.
pub fn recorder<'a>(site: &'a ColumnSections, tolerances: &Tolerances, truth: &'a Truth) -> Result<Recorder<'a>> {
    let mut site_of_truth = site.clone();
    for (name, parameters) in &truth.law {
        let law = site_of_truth.law.get_mut(name).ok_or_else(|| {
            let known: Vec<&str> = site.law.keys().map(String::as_str).collect();
            Error::new(format!("the truth changes `[law.{name}]`, which the manifest does not have"))
                .hint(crate::registry::known(&known, name))
                .usage()
        })?;
        law.extend(parameters.clone());
    }
    let mut profile = site_of_truth.declared_profile()?;
    let draw = Draw::new(tolerances, profile.layers.len(), site.sensors.output.len() + 1, truth.seed);
    draw.apply(&mut profile);
    effects::apply(&truth.effects, &mut profile, &Situation::default())?;
    profile.elements *= truth.mesh_factor;
    let mut analysis = site.analysis.clone();
    analysis.max_step_s = truth.max_step_s;
    analysis.initial_step_s = analysis.initial_step_s.min(truth.max_step_s);
    let column = Column::new(&profile, &analysis).map_err(|e| e.at("the truth column"))?;
    Ok(Recorder { site, truth, draw, column })
}

/// Records of event `name`, one for each of `components` in the order given.
///
/// # Errors
/// When the truth does not have the event or component, or the truth column does not finish.
pub fn record_event(recorder: &Recorder<'_>, name: &str, components: &[String]) -> Result<Vec<Record>> {
    let Recorder { site, truth, draw, column } = recorder;
    let section = truth.event.iter().find(|e| e.name == name).ok_or_else(|| {
        let known: Vec<&str> = truth.event.iter().map(|e| e.name.as_str()).collect();
        Error::new(format!("the truth has no event `{name}`")).hint(crate::registry::known(&known, name)).usage()
    })?;
    let mut motions: Vec<Channels> = vec![Vec::new(); site.sensors.output.len() + 1];
    for component in components {
        let pga_g = *section
            .pga_g
            .get(component)
            .ok_or_else(|| Error::new(format!("event `{name}` of the truth has no `pga_g.{component}`")).usage())?;
        let settings = MotionSettings {
            seed: event_seed(truth.seed, name, component),
            duration_s: section.duration_s,
            ..truth.motions(pga_g)
        };
        let motion = motion::suite(&settings)?.remove(0);
        let depths = site.sensors.depths_m();
        let histories = sensor_histories(column, motion.dt_s, &motion.acceleration_m_s2, &depths)
            .map_err(|e| e.at(format!("event `{name}`, component `{component}`")))?;
        for (sensor, history) in motions.iter_mut().zip(histories) {
            sensor.push(resample::resample_band_limited(&history, site.analysis.output_step_s, STEP_S));
        }
    }
    let observed = observe(&motions, STEP_S, draw);
    let names = site.sensors.names();
    let records = components.iter().enumerate().map(|(c, component)| {
        let sensor =
            |s: usize, name: &str| Sensor { name: name.to_string(), acceleration_m_s2: observed[s][c].clone() };
        let mut record = Record {
            event: name.to_string(),
            component: component.clone(),
            dt_s: STEP_S,
            input: sensor(0, &site.sensors.input),
            outputs: names.iter().enumerate().map(|(s, name)| sensor(s + 1, name)).collect(),
        };
        add_noise(&mut record, &truth.noise, truth.seed);
        record
    });
    Ok(records.collect())
}

fn event_seed(seed: u64, event: &str, component: &str) -> u64 {
    let hash = blake3::hash(format!("twin event {seed} {event} {component}").as_bytes());
    let mut bytes = [0; 8];
    bytes.copy_from_slice(&hash.as_bytes()[..8]);
    // A manifest's seed is a TOML integer, so stay within 63 bits.
    u64::from_le_bytes(bytes) >> 1
}
