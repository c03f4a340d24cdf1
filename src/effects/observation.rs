//! Between the true motion of the ground and the records of it: every sensor effect, in both directions.
//!
//! ```text
//! true motion ─► + further arrivals ─► response of each sensor ─► exchanged channels ─► + interference ─► record
//! ```

use super::{Channel, Effect, Operator, Place};
use crate::numerics::spectrum;
use realfft::num_complex::Complex;

/// Histories of one sensor, `[component][step]`, m/s².
pub type Channels = Vec<Vec<f64>>;

/// Whose histories are observed; sensors start with the input sensor.
#[derive(Debug, Clone, Copy)]
pub struct Recording<'a> {
    /// Name of the event.
    pub event: &'a str,
    /// Time step, s.
    pub dt_s: f64,
    /// Names of the sensors, the input sensor first.
    pub sensors: &'a [String],
    /// Their declared depths, m.
    pub depths_m: &'a [f64],
    /// Names of the components.
    pub components: &'a [String],
}

/// Which way [`observe`] goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From true motions to what is recorded, noise apart.
    Distort,
    /// The same without interference, whose course nobody can predict: compare with records that were cleaned.
    Predict,
    /// Takes the interference, estimated from the records themselves, out of records.
    Clean,
    /// From records to true motions; inverse responses are held back where a sensor passes little.
    Undo,
}

/// Applies `effects` to `motions` (`[sensor][component][step]`, all of one length) in the given direction.
///
/// Without an effect that acts on sensors the motions come back bit-identical.
pub fn observe(
    recording: &Recording<'_>,
    motions: &[Channels],
    effects: &[Box<dyn Effect>],
    direction: Direction,
) -> Vec<Channels> {
    let mut motions = motions.to_vec();
    match direction {
        Direction::Distort | Direction::Predict => {
            let base = motions[0].clone();
            arrivals(recording, &mut motions, &base, effects, 1.0);
            responses(recording, &mut motions, effects, false);
            exchange(recording, &mut motions, effects.iter());
            if direction == Direction::Distort {
                interference(recording, &mut motions, effects, |e, c| e.interference(c), 1.0);
            }
        }
        Direction::Clean => {
            interference(recording, &mut motions, effects, |e, c| e.estimated_interference(c), -1.0);
        }
        Direction::Undo => {
            interference(recording, &mut motions, effects, |e, c| e.estimated_interference(c), -1.0);
            exchange(recording, &mut motions, effects.iter().rev());
            responses(recording, &mut motions, effects, true);
            let base = motions[0].clone();
            arrivals(recording, &mut motions, &base, effects, -1.0);
        }
    }
    motions
}

/// The composed response of all `effects` at one place; `None` where nothing acts.
pub fn operator(effects: &[Box<dyn Effect>], place: &Place<'_>, frequency_hz: f64) -> Option<Operator> {
    let acting = effects.iter().filter_map(|e| e.response(place, frequency_hz));
    acting.reduce(|all, next| next.after(&all))
}

/// Depth of `sensor` under all `effects`, within the column of depth `base_m`.
pub fn depth_m(effects: &[Box<dyn Effect>], sensor: &str, declared_m: f64, base_m: f64) -> f64 {
    let moved = effects.iter().fold(declared_m, |z, e| e.depth_m(sensor, z));
    if moved == declared_m { declared_m } else { moved.clamp(0.0, base_m) }
}

/// Adds `sign` times the further arrivals at the output sensors.
fn arrivals(
    recording: &Recording<'_>,
    motions: &mut [Channels],
    base: &Channels,
    effects: &[Box<dyn Effect>],
    sign: f64,
) {
    let base_m = recording.depths_m[0];
    for (s, channels) in motions.iter_mut().enumerate().skip(1) {
        let depth = depth_m(effects, &recording.sensors[s], recording.depths_m[s], base_m);
        for effect in effects.iter().filter(|e| e.arrival(depth, 1.0).is_some()) {
            for (history, base) in channels.iter_mut().zip(base) {
                let factor = |f| effect.arrival(depth, f).unwrap_or(Complex::new(0.0, 0.0));
                let [arriving] = spectrum::respond([base], recording.dt_s, |f, [u]| [u * factor(f)]);
                history.iter_mut().zip(arriving).for_each(|(x, a)| *x += sign * a);
            }
        }
    }
}

fn responses(recording: &Recording<'_>, motions: &mut [Channels], effects: &[Box<dyn Effect>], is_undone: bool) {
    for (name, channels) in recording.sensors.iter().zip(motions) {
        let place = Place { sensor: name, components: recording.components };
        if operator(effects, &place, 1.0).is_none() {
            continue;
        }
        let is_single = channels.len() == 1;
        let at = |f| {
            let o = operator(effects, &place, f).unwrap_or(Operator::IDENTITY);
            // What a single component loses to the other cannot be told from a gain.
            let o = if is_single { Operator::scalar(o.0[0][0]) } else { o };
            if is_undone { o.undone() } else { o }
        };
        match channels.as_mut_slice() {
            [only] => [*only] = spectrum::respond([only.as_slice()], recording.dt_s, |f, [x]| [at(f).0[0][0] * x]),
            [first, second, ..] => {
                [*first, *second] = spectrum::respond([first, second], recording.dt_s, |f, x| at(f).apply(x));
            }
            [] => {}
        }
    }
}

fn exchange<'e>(
    recording: &Recording<'_>,
    motions: &mut [Channels],
    effects: impl Iterator<Item = &'e Box<dyn Effect>>,
) {
    let index = |name: &str| recording.sensors.iter().position(|s| s == name);
    for (one, other) in effects.filter_map(|e| e.exchange()) {
        if let (Some(i), Some(j)) = (index(one), index(other)) {
            motions.swap(i, j);
        }
    }
}

fn interference(
    recording: &Recording<'_>,
    motions: &mut [Channels],
    effects: &[Box<dyn Effect>],
    added: impl Fn(&dyn Effect, &Channel<'_>) -> Option<Vec<f64>>,
    sign: f64,
) {
    for effect in effects {
        for (sensor, channels) in recording.sensors.iter().zip(motions.iter_mut()) {
            for (component, history) in recording.components.iter().zip(channels) {
                let Recording { event, dt_s, .. } = *recording;
                let channel = Channel { sensor, component, event, dt_s, acceleration_m_s2: history };
                if let Some(extra) = added(effect.as_ref(), &channel) {
                    history.iter_mut().zip(extra).for_each(|(x, a)| *x += sign * a);
                }
            }
        }
    }
}
