//! Events of a twin site: base motion, truth column, and what the sensors record of it.

use super::Truth;
use super::draw::draw;
use super::outside::{self, Outside};
use crate::column::{Analysis, BaseMotion, Column, Profile};
use crate::dataset::sensor_histories;
use crate::effects::{self, Channels, Direction, Effect, Recording, Situation, Tolerances};
use crate::error::{Error, Result};
use crate::manifest::ColumnSections;
use crate::motion::{self, MotionSettings};
use crate::numerics::resample;
use crate::records::{Record, Sensor, add_noise};

/// Sampling of twin records, s.
const STEP_S: f64 = 0.01;

/// The truth of one site, ready to record events.
pub struct Recorder<'a> {
    site: &'a ColumnSections,
    truth: &'a Truth,
    profile: Profile,
    analysis: Analysis,
    /// The drawn tolerances, then what the truth file adds.
    effects: Vec<Box<dyn Effect>>,
    outside: Vec<Box<dyn Outside>>,
}

/// Prepares the truth of `site`.
///
/// # Errors
/// When the truth names an unknown law, effect or sensor, or the column cannot be built; a damping of its own needs laws with a
/// `damping_ratio`.
pub fn recorder<'a>(site: &'a ColumnSections, tolerances: &Tolerances, truth: &'a Truth) -> Result<Recorder<'a>> {
    let mut site_of_truth = site.clone();
    for (name, parameters) in &truth.law {
        let law = site_of_truth.law.get_mut(name).ok_or_else(|| {
            let known: Vec<&str> = site.law.keys().map(String::as_str).collect();
            Error::new(format!("the truth changes `[law.{name}]`, which the manifest does not have"))
                .hint(crate::registry::known(&known, name))
                .usage()
        })?;
        if parameters.contains_key("kind") {
            law.clear();
        }
        law.extend(parameters.clone());
    }
    if let Some(own) = &truth.damping {
        site_of_truth.site.rayleigh = own.rayleigh();
        for law in site_of_truth.law.values_mut() {
            law.insert("damping_ratio".into(), 0.0.into());
        }
    }
    let array = site_of_truth.array(&truth.components())?;
    let mut tables = draw(&array, tolerances, truth.seed);
    tables.extend(truth.effects.clone());
    effects::check(&truth.effects, &array)?;
    let mut analysis = site.analysis.clone();
    analysis.max_step_s = truth.max_step_s;
    analysis.initial_step_s = analysis.initial_step_s.min(truth.max_step_s);
    let recorder = Recorder {
        site,
        truth,
        profile: array.profile,
        analysis,
        effects: effects::build_all(&tables)?,
        outside: outside::build_all(&truth.outside)?,
    };
    recorder.column(&Situation::default())?;
    Ok(recorder)
}

impl Recorder<'_> {
    /// The truth column in a situation.
    fn column(&self, situation: &Situation) -> Result<Column> {
        let mut profile = self.profile.clone();
        for effect in &self.effects {
            effect.edit(&mut profile, situation);
        }
        profile.elements *= self.truth.mesh_factor;
        Column::new(&profile, &self.analysis).map_err(|e| e.at("the truth column"))
    }
}

/// Records of event `name`, one for each of `components` in the order given.
///
/// # Errors
/// When the truth does not have the event or component, or the truth column does not finish.
pub fn record_event(recorder: &Recorder<'_>, name: &str, components: &[String]) -> Result<Vec<Record>> {
    let Recorder { site, truth, profile, effects, outside, .. } = recorder;
    let section = truth.event.iter().find(|e| e.name == name).ok_or_else(|| {
        let known: Vec<&str> = truth.event.iter().map(|e| e.name.as_str()).collect();
        Error::new(format!("the truth has no event `{name}`")).hint(crate::registry::known(&known, name)).usage()
    })?;
    let names: Vec<String> = std::iter::once(site.sensors.input.clone()).chain(site.sensors.names()).collect();
    let declared_m: Vec<f64> = std::iter::once(profile.depth_m()).chain(site.sensors.depths_m()).collect();
    let sits_at = |(sensor, z): (&String, &f64)| effects::depth_m(effects, sensor, *z, profile.depth_m());
    let depths_m: Vec<f64> = names.iter().zip(&declared_m).skip(1).map(sits_at).collect();
    let mut motions: Vec<Channels> = vec![Vec::new(); names.len()];
    for (c, component) in components.iter().enumerate() {
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
        let column = recorder.column(&Situation::of(c, name, truth.event.iter().map(|e| e.name.as_str())))?;
        let base = BaseMotion { dt_s: motion.dt_s, acceleration_m_s2: &motion.acceleration_m_s2 };
        let histories = sensor_histories(&column, base, &depths_m)
            .map_err(|e| e.at(format!("event `{name}`, component `{component}`")))?;
        for (sensor, history) in motions.iter_mut().zip(histories) {
            sensor.push(resample::resample_band_limited(&history, site.analysis.output_step_s, STEP_S));
        }
    }
    let recording = Recording { event: name, dt_s: STEP_S, sensors: &names, depths_m: &declared_m, components };
    for extra in outside {
        extra.add(&recording, profile.fundamental_hz(), truth.seed, &mut motions)?;
    }
    let observed = effects::observe(&recording, &motions, effects, Direction::Distort);
    let records = components.iter().enumerate().map(|(c, component)| {
        let sensor = |s: usize| Sensor { name: names[s].clone(), acceleration_m_s2: observed[s][c].clone() };
        let mut record = Record {
            event: name.to_string(),
            component: component.clone(),
            dt_s: STEP_S,
            input: sensor(0),
            outputs: (1..names.len()).map(sensor).collect(),
        };
        add_noise(&mut record, &truth.noise, truth.seed);
        record
    });
    Ok(truth.processing.apply(records.collect()))
}

fn event_seed(seed: u64, event: &str, component: &str) -> u64 {
    let hash = blake3::hash(format!("twin event {seed} {event} {component}").as_bytes());
    let mut bytes = [0; 8];
    bytes.copy_from_slice(&hash.as_bytes()[..8]);
    // A manifest's seed is a TOML integer, so stay within 63 bits.
    u64::from_le_bytes(bytes) >> 1
}
