//! What may hold at a twin site and no effect of the catalogue describes: the diagnosis must give it no name.

mod late_surface_wave;
mod lateral_scattering;
mod second_input;

use crate::effects::{Channels, Recording};
use crate::error::{Error, Result};
use crate::registry::{self, Entry};

/// Something outside the catalogue of effects.
pub trait Outside: Send + Sync {
    /// Adds it to the true motions (`[sensor][component][step]`, the input sensor first) of a site with this fundamental frequency.
    ///
    /// # Errors
    /// When a motion it needs cannot be made.
    fn add(&self, recording: &Recording<'_>, fundamental_hz: f64, seed: u64, motions: &mut [Channels]) -> Result<()>;

    /// Whether part of it is the same in all events, so that it remains as something without a name; the rest of it is incoherent.
    fn repeats(&self) -> bool {
        false
    }
}

/// All of them, by their name in `[[outside]]`.
pub const OUTSIDE: &[Entry<dyn Outside>] = &[late_surface_wave::ENTRY, lateral_scattering::ENTRY, second_input::ENTRY];

/// Builds every `[[outside]]` table.
///
/// # Errors
/// When `kind` is missing or unknown, or a parameter is missing, unknown or out of range.
pub(super) fn build_all(tables: &[toml::Table]) -> Result<Vec<Box<dyn Outside>>> {
    let build = |table: &toml::Table| {
        let mut table = table.clone();
        let kind = match table.remove("kind") {
            Some(toml::Value::String(kind)) => kind,
            _ => return Err(Error::new("`[[outside]]` needs a `kind`").usage()),
        };
        (registry::find("thing outside the catalogue", OUTSIDE, &kind)?.build)(table)
    };
    tables.iter().enumerate().map(|(i, t)| build(t).map_err(|e| e.at(format!("`[[outside]]` {}", i + 1)))).collect()
}

/// Refuses numbers out of range: (name, value, lowest, highest, unit).
fn ranges(checks: &[(&str, f64, f64, f64, &str)]) -> Result<()> {
    match checks.iter().find(|(_, value, low, high, _)| !(value >= low && value <= high)) {
        None => Ok(()),
        Some((name, value, low, high, unit)) => {
            Err(Error::new(format!("`{name}` must be in {low}…{high}{unit}, got {value}")).usage())
        }
    }
}

/// A motion of its own for this event and component, as long as the others, with a peak of one.
fn own_motion(recording: &Recording<'_>, seed: u64, label: &str, n_step: usize, band_hz: [f64; 2]) -> Vec<f64> {
    use crate::numerics::{filter, random};
    use rand_distr::{Distribution, StandardNormal};
    let mut stream = random::stream(seed, &format!("{label} {}", recording.event));
    let duration_s = n_step as f64 * recording.dt_s;
    let white: Vec<f64> = (0..n_step)
        .map(|i| {
            let share = i as f64 / n_step as f64;
            let envelope = (-((share - 0.45) / 0.18).powi(2)).exp();
            let draw: f64 = StandardNormal.sample(&mut stream);
            envelope * draw
        })
        .collect();
    let low_hz = band_hz[0].max(2.0 / duration_s);
    let motion = filter::band_pass_zero_phase(&white, recording.dt_s, low_hz, band_hz[1]);
    let peak = motion.iter().fold(f64::MIN_POSITIVE, |m, v| m.max(v.abs()));
    motion.into_iter().map(|v| v / peak).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changed(toml: &str) -> (Vec<Channels>, Vec<Channels>) {
        let table: toml::Table = toml::from_str(toml).unwrap();
        let extra = build_all(&[table]).unwrap();
        let sensors = ["base", "mid", "top"].map(String::from);
        let components = ["EW", "NS"].map(String::from);
        let recording = Recording {
            event: "E1",
            dt_s: 0.01,
            sensors: &sensors,
            depths_m: &[10.0, 5.0, 0.0],
            components: &components,
        };
        let pulse = |i: usize| (-((i as f64 - 300.0) / 60.0).powi(2)).exp() * (0.2 * i as f64).sin();
        let history: Vec<f64> = (0..1500).map(pulse).collect();
        let before = vec![vec![history; 2]; 3];
        let mut after = before.clone();
        extra[0].add(&recording, 2.0, 7, &mut after).unwrap();
        let mut again = before.clone();
        extra[0].add(&recording, 2.0, 7, &mut again).unwrap();
        assert_eq!(after, again);
        (before, after)
    }

    #[test]
    fn each_changes_the_outputs_and_leaves_the_input_sensor_alone() {
        for toml in [
            "kind = 'late_surface_wave'\namplitude = 0.8\ndelay_s = 3.0",
            "kind = 'lateral_scattering'\nln_amplitude = 0.3\nphase_rad = 0.4",
            "kind = 'second_input'\nshare = 0.4",
        ] {
            let (before, after) = changed(toml);
            assert_eq!(before[0], after[0], "{toml}");
            for s in 1..3 {
                let change: f64 = before[s][1].iter().zip(&after[s][1]).map(|(a, b)| (a - b).powi(2)).sum();
                let size: f64 = before[s][1].iter().map(|a| a * a).sum();
                let share = (change / size).sqrt();
                assert!((0.03..1.5).contains(&share), "{toml}: sensor {s} changes by {share}");
            }
        }
    }

    #[test]
    fn nonsense_is_refused_with_a_hint() {
        let table: toml::Table = toml::from_str("kind = 'second_inputs'").unwrap();
        assert!(build_all(&[table]).err().unwrap().hint_text().unwrap().contains("second_input"));
        let table: toml::Table = toml::from_str("kind = 'second_input'\nshare = -1.0").unwrap();
        assert!(build_all(&[table]).err().unwrap().to_string().contains("`share` must be in"));
    }
}
