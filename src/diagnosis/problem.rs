//! What a diagnosis is about: the declared array, its tolerances, and the events it may look at.

use crate::effects::{Array, Situation, Tolerances};
use crate::error::Result;
use crate::records::Split;
use serde::Serialize;

/// The array, what is declared of it, and the events to explain; never a held-out event.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Sensors, components and the column as declared, without effects.
    pub array: Array,
    /// `[[effects]]` that the manifest already has.
    pub declared: Vec<toml::Table>,
    /// Prior standard deviations of what is declared.
    pub tolerances: Tolerances,
    /// Records of training and validation events, one for each event and component.
    pub events: Vec<Event>,
}

/// One component of one event.
#[derive(Debug, Clone)]
pub struct Event {
    /// Name of the event; components of one event share it.
    pub name: String,
    /// Component and place in the history of the array.
    pub situation: Situation,
    /// Training events are fitted, validation events choose; nothing else may stand here.
    pub split: Split,
    /// Time step, s.
    pub dt_s: f64,
    /// Acceleration of the input sensor, m/s².
    pub input: Vec<f64>,
    /// Accelerations of the output sensors in the order of the array, m/s².
    pub outputs: Vec<Vec<f64>>,
    /// Noise of each sensor, the input sensor first.
    pub noise: Vec<NoiseSpectrum>,
}

impl Event {
    /// Index of its component.
    pub fn component(&self) -> usize {
        self.situation.component.unwrap_or(0)
    }
}

/// True motions at the output sensors in every event, `[sensor][step]`, m/s²; or why the column did not finish.
pub type Motions = Vec<std::result::Result<Vec<Vec<f64>>, String>>;

/// Power spectral density of a sensor's noise.
#[derive(Debug, Clone, PartialEq)]
pub struct NoiseSpectrum {
    /// Distance of the values, Hz; the first is at 0 Hz.
    pub step_hz: f64,
    /// One-sided density, (m/s²)²/Hz; the last value holds beyond the end.
    pub power: Vec<f64>,
    /// What tells it.
    pub source: NoiseSource,
}

/// What tells the noise of a sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoiseSource {
    /// The manifest.
    Declared,
    /// The record, before its event.
    BeforeTheEvent,
    /// Nothing: it is taken as is usual.
    Usual,
}

impl NoiseSpectrum {
    /// White noise of standard deviation `deviation_m_s2` sampled every `dt_s`, which `source` tells.
    pub fn white(deviation_m_s2: f64, dt_s: f64, source: NoiseSource) -> Self {
        let power = vec![2.0 * dt_s * deviation_m_s2 * deviation_m_s2];
        Self { step_hz: 1.0, power, source }
    }

    /// Density at `frequency_hz`, linear between the values.
    pub fn at(&self, frequency_hz: f64) -> f64 {
        let x = (frequency_hz / self.step_hz).max(0.0);
        let i = (x.floor() as usize).min(self.power.len() - 1);
        let j = (i + 1).min(self.power.len() - 1);
        let share = (x - i as f64).clamp(0.0, 1.0);
        self.power[i] + share * (self.power[j] - self.power[i])
    }
}

/// The nonlinear column, run by whoever knows how to cache it.
pub trait Replay: Sync {
    /// True motions at the output sensors of every event of the problem, in its order: `[sensor][step]` at the event's own
    /// time step and length, m/s²; or why the column did not finish.
    ///
    /// `effects` come on top of the declared ones. Soil and boundary effects edit the column and `sensor_depth` moves
    /// the place that is read; of the sensor effects only those of the **input** sensor count, undone before the column
    /// is shaken. What the output sensors make of the motion is left to the diagnosis.
    ///
    /// # Errors
    /// When the column cannot be built or no event finishes.
    fn replay(&self, effects: &[toml::Table]) -> Result<Motions>;

    /// The same in fewer elements and longer steps where there are such: what differs between two of these is what would
    /// differ between two of [`Replay::replay`], and costs less.
    ///
    /// # Errors
    /// As [`Replay::replay`].
    fn replay_roughly(&self, effects: &[toml::Table]) -> Result<Motions> {
        self.replay(effects)
    }

    /// As [`Replay::replay`], the wanted events alone, and the same once more in elements and steps half as large: what the two differ by
    /// is not converged. None where there is nothing smaller.
    ///
    /// # Errors
    /// As [`Replay::replay`].
    fn replay_in_halves(&self, effects: &[toml::Table], is_wanted: &[bool]) -> Result<Option<[Motions; 2]>> {
        let _ = (effects, is_wanted);
        Ok(None)
    }
}
