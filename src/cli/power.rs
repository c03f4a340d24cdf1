//! `flare-pipe power`: before any data, which effects an array could reveal and which it would confuse.

use super::SiteArguments;
use super::output::{data, write_json};
use super::workspace::Workspace;
use crate::diagnosis::Problem;
use crate::error::{Error, Result};
use crate::inference::{self, Power, Sensitivity};
use crate::manifest::Site;
use crate::motion::suite;
use crate::numerics::resample::resample_band_limited;
use crate::records::{DeclaredNoise, Record, RecordSettings, Sensor, Split};
use crate::stages::Bench;
use crate::units::AccelerationUnit;
use clap::Args;
use toml::Table;

/// Which site, how noisy its sensors are, and in what form.
#[derive(Debug, Args)]
pub struct PowerArguments {
    #[command(flatten)]
    site: SiteArguments,
    /// Noise of every sensor, as a share of the RMS of the base motion
    #[arg(long, value_name = "SHARE", default_value = "0.03")]
    noise: f64,
}

/// Time step of the assumed records, s.
const STEP_S: f64 = 0.01;
/// Events assumed for training and validation where the manifest has no records.
const EVENTS: [usize; 2] = [8, 3];

/// Prints what the array, its split and the noise could reveal. Base motions of the suite, weak to strong, stand in for the
/// events.
///
/// # Errors
/// When the manifest is wrong or its column cannot be built.
pub fn power(arguments: &PowerArguments, json: bool) -> Result<()> {
    if !(1e-4..=1.0).contains(&arguments.noise) {
        return Err(Error::new(format!("`--noise` must be in 0.0001…1, got {}", arguments.noise)).usage());
    }
    let workspace = Workspace::open(&arguments.site)?;
    let site = &workspace.manifest.site;
    let bench = assumed(site, arguments.noise)?;
    let found = inference::power(&bench.problem, &bench, &site.diagnose)?;
    if json { write_json(&found) } else { print(&bench.problem, &found) }
}

/// The array with motions of the suite as events, as many as the manifest names, in each component another.
fn assumed(site: &Site, noise: f64) -> Result<Bench<'static>> {
    let sections = site.column();
    let (components, counts) = match &site.records {
        Some(records) => (records.components.clone(), [records.train.len(), records.validation.len()]),
        None => (vec!["X".to_string()], EVENTS),
    };
    let mut motions = suite(&site.motions)?;
    motions.sort_by(|a, b| a.pga_m_s2().total_cmp(&b.pga_m_s2()));
    let n_event = counts[0] + counts[1];
    let names: Vec<String> = (1..=n_event).map(|i| format!("{i:03}")).collect();
    let is_validation = spread(n_event, counts[1]);
    let chosen = spread_indices(motions.len(), n_event * components.len());
    let record = |e: usize, c: usize| {
        let motion = &motions[chosen[e * components.len() + c]];
        let input = resample_band_limited(&motion.acceleration_m_s2, motion.dt_s, STEP_S);
        let sensor = |name: &str| Sensor { name: name.into(), acceleration_m_s2: input.clone() };
        Record {
            event: names[e].clone(),
            component: components[c].clone(),
            dt_s: STEP_S,
            input: sensor(&sections.sensors.input),
            outputs: sections.sensors.output.iter().map(|s| sensor(&s.name)).collect(),
        }
    };
    let event = |e: usize| {
        let split = if is_validation[e] { Split::Validation } else { Split::Train };
        (split, (0..components.len()).map(|c| record(e, c)).collect())
    };
    let events = (0..n_event).map(event).collect();
    let named =
        |of: bool| names.iter().zip(&is_validation).filter(|(_, v)| **v == of).map(|(n, _)| n.clone()).collect();
    let settings = RecordSettings {
        format: "csv".into(),
        dir: None,
        unit: Some(AccelerationUnit::MetrePerSecondSquared),
        truth: None,
        train: named(false),
        validation: named(true),
        test: Vec::new(),
        noise: Some(DeclaredNoise { rms_share: Some(noise), floor_m_s2: None }),
        channels: Default::default(),
        options: Table::new(),
        components,
    };
    Bench::new(None, sections, &site.diagnose, site.tolerances.clone(), settings, events)
}

/// `count` of `n` places, evenly spread.
fn spread_indices(n: usize, count: usize) -> Vec<usize> {
    (0..count).map(|i| ((i as f64 + 0.5) / count as f64 * n as f64) as usize).map(|i| i.min(n - 1)).collect()
}

fn spread(n: usize, count: usize) -> Vec<bool> {
    let chosen = spread_indices(n.max(1), count);
    (0..n).map(|i| chosen.contains(&i)).collect()
}

fn print(problem: &Problem, power: &Power) -> Result<()> {
    let n_event = problem.events.len();
    data!("assumed: {n_event} records at {} output sensors; noise in every sensor", problem.array.outputs.len())?;
    data!("{:28} {:22} {:>9} {:>9}  visible  smallest visible", "effect", "best place", "expected", "needed")?;
    let mut kinds: Vec<&str> = Vec::new();
    for effect in &power.effects {
        if kinds.contains(&effect.kind.as_str()) {
            continue;
        }
        kinds.push(&effect.kind);
        let Sensitivity { kind, target, expected_score, needed_score, .. } = effect;
        let visible = if effect.is_visible { "yes" } else { "no" };
        data!(
            "{kind:28} {target:22} {expected_score:9.1} {needed_score:9.1}  {visible:7}  {}",
            match effect.detectable {
                Some(value) => format!("{} {} {}", effect.parameter, significant(value), effect.unit),
                None if effect.parameter.is_empty() => "–".into(),
                None => "none up to twice the typical strength".into(),
            }
        )?;
    }
    for class in &power.classes {
        data!("cannot be told apart: {}", class.join(", "))?;
    }
    Ok(())
}

/// Three significant figures.
fn significant(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let digits = (2 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_figures() {
        assert_eq!([0.000_351, -0.0123, 41.26, 391.52].map(significant), ["0.000351", "-0.0123", "41.3", "392"]);
    }

    #[test]
    fn motions_are_taken_evenly_and_every_split_gets_its_share() {
        assert_eq!(spread_indices(100, 4), [12, 37, 62, 87]);
        assert_eq!(spread(6, 2).iter().filter(|v| **v).count(), 2);
        assert_eq!(spread_indices(3, 6), [0, 0, 1, 1, 2, 2]);
    }
}
