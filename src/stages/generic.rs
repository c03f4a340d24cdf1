//! Where no named effect explains the records: corrections that are no physics, and what they are worth on held-out events.
//!
//! A smooth complex factor for each sensor on what the finite elements predict, fitted to the training events, its stiffness chosen
//! on the validation events; and FLARE-T with more terms in its latent equations ([`crate::flare::extend`]). Both are judged as
//! everything else is: on held-out events, against the same model without them.

use super::evaluate;
use super::extend::Outcome;
use crate::diagnosis::{Change, GenericCorrection, Pair, fit_generic};
use crate::metrics::median;
use crate::numerics::spectrum::{respond, spectrum};
use crate::records::Split;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Highest frequency of a factor, as a share of the Nyquist frequency.
const HIGHEST: f64 = 0.95;

/// One value each for the two models without and with such a correction; `None` where there is none.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Four {
    /// Finite elements, corrected where something was named and recalibrated where not.
    pub fe: Option<f64>,
    /// The same with the factors.
    pub fe_generic: Option<f64>,
    /// FLARE-T on the corrected or the declared column.
    pub flare_t: Option<f64>,
    /// The same with more terms.
    pub flare_t_generic: Option<f64>,
}

/// One channel: a sensor in one component of one event, on the axis of the evaluation.
pub struct Channel {
    pub event: String,
    pub component: String,
    pub sensor: String,
    pub split: Split,
    /// Record and prediction of the finite elements, m/s².
    pub observed: Vec<f64>,
    pub fe: Option<Vec<f64>>,
    /// NRMSE of FLARE-T without and with more terms, %.
    pub flare_t: [Option<f64>; 2],
}

/// Errors of one channel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// Sensor.
    pub sensor: String,
    /// What the event was used for.
    pub split: Split,
    /// NRMSE against the record as measured, %.
    pub nrmse_percent: Four,
}

/// Of `loop.json`: corrections without a name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Generic {
    /// Never: the file says so itself.
    pub is_physical: bool,
    /// Factor of each sensor; those that the validation events reject are missing.
    pub factors: BTreeMap<String, GenericCorrection>,
    /// Terms of the latent equations by component; empty where FLARE-T was not trained.
    pub terms: BTreeMap<String, Outcome>,
    /// Errors of each event, component and sensor.
    pub errors: Vec<Row>,
    /// Medians over held-out events, components and sensors.
    pub test_median_nrmse_percent: Four,
    /// Paired differences over held-out events.
    pub changes: Vec<Change>,
}

impl Generic {
    /// Fits the factors to the training and validation channels and judges both corrections on those held out.
    pub fn of(
        channels: &[Channel],
        step_s: f64,
        band_hz: [f64; 2],
        terms: BTreeMap<String, Outcome>,
        seed: u64,
    ) -> Self {
        let band_hz = [band_hz[0], band_hz[1].min(HIGHEST * 0.5 / step_s)];
        let mut sensors: Vec<&str> = channels.iter().map(|c| c.sensor.as_str()).collect();
        sensors.sort_unstable();
        sensors.dedup();
        let mut factors = BTreeMap::new();
        for sensor in sensors {
            let of = |split| -> Vec<Pair> {
                let own = channels.iter().filter(|c| c.split == split && c.sensor == sensor);
                own.filter_map(|c| pair(c, step_s, band_hz)).collect()
            };
            if let Some(factor) = fit_generic(&of(Split::Train), &of(Split::Validation), band_hz) {
                factors.insert(sensor.to_string(), factor);
            }
        }
        let errors: Vec<Row> = channels.iter().map(|c| row(c, factors.get(&c.sensor), step_s)).collect();
        let held_out = || errors.iter().filter(|r| r.split == Split::Test);
        let middle = |value: fn(&Four) -> Option<f64>| {
            let values: Vec<f64> = held_out().filter_map(|r| value(&r.nrmse_percent)).collect();
            (!values.is_empty()).then(|| median(&values))
        };
        let change = |from: &str, to: &str, value: fn(&Four) -> Option<f64>| {
            Change::of(held_out().map(|r| (r.event.as_str(), value(&r.nrmse_percent))), from, to, seed)
        };
        let is_extended = terms.values().any(|outcome| outcome.taken.is_some());
        let with_factors = change("fe", "fe_generic", |e| Some(e.fe_generic? - e.fe?)).filter(|_| !factors.is_empty());
        let with_terms =
            change("flare_t", "flare_t_generic", |e| Some(e.flare_t_generic? - e.flare_t?)).filter(|_| is_extended);
        Self {
            is_physical: false,
            terms,
            test_median_nrmse_percent: Four {
                fe: middle(|e| e.fe),
                fe_generic: middle(|e| e.fe_generic),
                flare_t: middle(|e| e.flare_t),
                flare_t_generic: middle(|e| e.flare_t_generic),
            },
            changes: with_factors.into_iter().chain(with_terms).collect(),
            factors,
            errors,
        }
    }

    /// What was found, for people.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.factors.is_empty() {
            notes.push("no smooth factor for any sensor helps the validation events".to_string());
        }
        for (component, outcome) in &self.terms {
            let [before, after] = outcome.validation;
            notes.push(match &outcome.taken {
                Some(terms) => format!(
                    "more terms in the latent equations of {component} ({terms}): error of the validation events {before:.4} → {after:.4}"
                ),
                None => format!("no more terms in the latent equations of {component} hold up on the validation events"),
            });
        }
        notes
    }
}

/// Spectra of prediction and record in the band.
fn pair(channel: &Channel, step_s: f64, band_hz: [f64; 2]) -> Option<Pair> {
    let (frequencies_hz, predicted) = spectrum(channel.fe.as_ref()?, step_s);
    let (_, measured) = spectrum(&channel.observed, step_s);
    let first = frequencies_hz.iter().position(|f| *f >= band_hz[0])?;
    let last = frequencies_hz.iter().rposition(|f| *f <= band_hz[1])?;
    (measured.len() == predicted.len() && first < last).then(|| Pair {
        frequencies_hz: frequencies_hz[first..=last].to_vec(),
        predicted: predicted[first..=last].to_vec(),
        measured: measured[first..=last].to_vec(),
    })
}

fn row(channel: &Channel, factor: Option<&GenericCorrection>, step_s: f64) -> Row {
    let fe = channel.fe.as_ref();
    let corrected = fe.map(|fe| match factor {
        Some(factor) => respond([fe], step_s, |f, [v]| [v * factor.factor(f)])[0].clone(),
        None => fe.clone(),
    });
    let [flare_t, flare_t_generic] = channel.flare_t;
    Row {
        event: channel.event.clone(),
        component: channel.component.clone(),
        sensor: channel.sensor.clone(),
        split: channel.split,
        nrmse_percent: Four {
            fe: fe.and_then(|fe| evaluate::nrmse(fe, &channel.observed)),
            fe_generic: corrected.and_then(|fe| evaluate::nrmse(&fe, &channel.observed)),
            flare_t,
            flare_t_generic,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    const DT_S: f64 = 0.05;

    /// Channels of eight events, two of which are held out; the record is the prediction with a smooth error and noise.
    fn channels(delay_s: f64, size: f64, noise: f64) -> Vec<Channel> {
        let of = |e: usize| {
            let mut stream = random::stream(e as u64, "generic");
            let mut normal = || -> f64 { StandardNormal.sample(&mut stream) };
            let mut fe: Vec<f64> =
                (0..400).map(|i| (-(i as f64 * DT_S - 6.0).powi(2) / 8.0).exp() * normal()).collect();
            // Below the Nyquist frequency, as records are.
            fe = fe.windows(4).map(|w| w.iter().sum::<f64>() / 4.0).collect();
            let late = |f: f64| realfft::num_complex::Complex::from_polar(size, -std::f64::consts::TAU * f * delay_s);
            let [mut observed] = respond([&fe], DT_S, |f, [v]| [v * late(f)]);
            observed.iter_mut().for_each(|x| *x += noise * normal());
            let split = [Split::Train, Split::Validation, Split::Test][(e >= 4) as usize + (e >= 6) as usize];
            let (event, component, sensor) = (format!("E{e}"), "EW".to_string(), "S".to_string());
            Channel { event, component, sensor, split, observed, fe: Some(fe), flare_t: [Some(30.0), None] }
        };
        (0..8).map(of).collect()
    }

    fn generic(channels: &[Channel]) -> Generic {
        Generic::of(channels, DT_S, [0.2, 9.5], BTreeMap::new(), 1)
    }

    #[test]
    fn a_smooth_error_is_taken_off_events_that_nobody_looked_at_and_claimed() {
        let found = generic(&channels(0.02, 0.7, 0.02));
        let Four { fe, fe_generic, flare_t, flare_t_generic } = found.test_median_nrmse_percent;
        assert!(fe.unwrap() > 30.0 && fe_generic.unwrap() < 0.35 * fe.unwrap(), "{fe:?} {fe_generic:?}");
        assert_eq!((flare_t, flare_t_generic), (Some(30.0), None));
        let [change] = &found.changes[..] else { panic!("{:?}", found.changes) };
        assert!(change.is_improved && change.n_event == 2 && !found.is_physical);
    }

    #[test]
    fn what_held_out_events_do_not_confirm_is_not_claimed() {
        let mut channels = channels(0.02, 0.7, 0.02);
        // Held out, the prediction was right.
        for channel in channels.iter_mut().filter(|c| c.split == Split::Test) {
            channel.observed = channel.fe.clone().unwrap();
        }
        let found = generic(&channels);
        assert!(found.changes.iter().all(|c| !c.is_improved && c.median_points > 0.0), "{:?}", found.changes);
        // The fit has not looked at them.
        let others: Vec<Channel> = channels.into_iter().filter(|c| c.split != Split::Test).collect();
        assert_eq!(generic(&others).factors, found.factors);
    }
}
