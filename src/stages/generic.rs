//! Where no named effect explains the records: corrections that are no physics, and what they are worth on held-out events.
//!
//! A smooth complex factor for each sensor on what the finite elements predict, fitted to the training events, its stiffness chosen
//! on the validation events; and FLARE-T with more terms in its latent equations ([`crate::flare::extend`]). Both are judged as
//! everything else is: on held-out events, against the same model without them.

use super::evaluate;
use super::extend::Outcome;
use crate::diagnosis::{Change, GenericCorrection, Pair, fit_generic};
use crate::metrics::{Claimed, median};
use crate::numerics::spectrum::{respond, spectrum};
use crate::records::Split;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Highest frequency of a factor, as a share of the Nyquist frequency.
const HIGHEST: f64 = 0.95;

/// NRMSE of the two models without and with such a correction, %; `None` where there is none. Medians are over the channels that have
/// both.
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
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// Sensor.
    pub sensor: String,
    /// What the event was used for.
    pub split: Split,
    /// The record, m/s².
    pub observed: Vec<f64>,
    /// What the finite elements predict, m/s².
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
    /// Held-out channels that FLARE-T predicts and, with more terms, does not: its state leaves its bounds.
    pub n_diverged: usize,
}

impl Generic {
    /// Fits the factors to the training and validation channels and judges both corrections on those held out.
    pub fn of(channels: &[Channel], step_s: f64, band_hz: [f64; 2], terms: BTreeMap<String, Outcome>) -> Self {
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
        let errors: Vec<Row> = channels.iter().map(|c| row(c, factors.get(&c.sensor), &terms, step_s)).collect();
        let held_out = || errors.iter().filter(|r| r.split == Split::Test);
        // Medians without and with a correction, over the channels that have both, and what they allow to say.
        let judged = |from: &str, to: &str, both: fn(&Four) -> Option<(f64, f64)>| {
            let both = |r: &Row| both(&r.nrmse_percent);
            let (plain, generic): (Vec<f64>, Vec<f64>) = held_out().filter_map(both).unzip();
            let differences = held_out().map(|r| (r.event.as_str(), both(r).map(|(plain, generic)| generic - plain)));
            Some(([median(&plain), median(&generic)], Change::of(Claimed::NrmsePercent, differences, from, to)?))
        };
        let fe = judged("fe", "fe_generic", |e| e.fe.zip(e.fe_generic));
        let mut flare_t = judged("flare_t", "flare_t_generic", |e| e.flare_t.zip(e.flare_t_generic));
        let n_diverged = channels.iter().filter(|c| c.split == Split::Test && is_diverged(c, &terms)).count();
        if let Some((_, change)) = &mut flare_t {
            // What predicts nothing of some events improves on nothing.
            change.is_improved &= n_diverged == 0;
        }
        let [fe_plain, fe_generic] = [0, 1].map(|i| fe.as_ref().map(|(medians, _)| medians[i]));
        let [flare_t_plain, flare_t_generic] = [0, 1].map(|i| flare_t.as_ref().map(|(medians, _)| medians[i]));
        Self {
            is_physical: false,
            factors,
            test_median_nrmse_percent: Four { fe: fe_plain, fe_generic, flare_t: flare_t_plain, flare_t_generic },
            changes: fe.into_iter().chain(flare_t).map(|(_, change)| change).collect(),
            n_diverged,
            terms,
            errors,
        }
    }

    /// What was found, for people.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.factors.is_empty() {
            notes.push("no smooth factor on the replays helps the validation events at any sensor".to_string());
        }
        for (component, Outcome { taken, validation: [before, after], tried, .. }) in &self.terms {
            let stable = tried.iter().find_map(|t| Some((t, t.stability?)));
            let found = match (taken, stable) {
                (Some(terms), _) => format!("{terms}: error of the validation events {before:.4} → {after:.4}"),
                (None, Some((t, stability))) => {
                    let why = if t.is_shared == Some(false) {
                        "not with each of these left out".to_string()
                    } else {
                        format!("in only {:.0} % of the fits with a training event left out", 100.0 * stability)
                    };
                    let lowered = t.validation_error;
                    let terms = &t.terms;
                    format!(
                        "none; {terms} would lower the error of the validation events, {before:.4} → {lowered:.4}, but {why}"
                    )
                }
                (None, None) if tried.is_empty() => "none, there are too few training events".to_string(),
                (None, None) => "none, no group of them helps the validation events".to_string(),
            };
            notes.push(format!("more terms in the latent equations of {component}: {found}"));
        }
        if self.n_diverged > 0 {
            notes.push(format!("with more terms FLARE-T diverges in {} held-out channels", self.n_diverged));
        }
        notes
    }
}

/// Whether the component of `channel` has more terms.
fn is_extended(channel: &Channel, terms: &BTreeMap<String, Outcome>) -> bool {
    terms.get(&channel.component).is_some_and(|outcome| outcome.taken.is_some())
}

/// Whether these terms lead to no prediction where there was one.
fn is_diverged(channel: &Channel, terms: &BTreeMap<String, Outcome>) -> bool {
    is_extended(channel, terms) && channel.flare_t[0].is_some() && channel.flare_t[1].is_none()
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

fn row(channel: &Channel, factor: Option<&GenericCorrection>, terms: &BTreeMap<String, Outcome>, step_s: f64) -> Row {
    let nrmse = |predicted: &Vec<f64>| evaluate::nrmse(predicted, &channel.observed);
    let fe = channel.fe.as_ref();
    let corrected = fe.zip(factor).map(|(fe, factor)| {
        let [corrected] = respond([fe], step_s, |f, [v]| [v * factor.factor(f)]);
        corrected
    });
    let [flare_t, extended] = channel.flare_t;
    Row {
        event: channel.event.clone(),
        component: channel.component.clone(),
        sensor: channel.sensor.clone(),
        split: channel.split,
        nrmse_percent: Four {
            fe: fe.and_then(nrmse),
            fe_generic: corrected.as_ref().and_then(nrmse),
            flare_t,
            flare_t_generic: extended.filter(|_| is_extended(channel, terms)),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flare::Tried;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    const DT_S: f64 = 0.05;

    /// Channels of nine events, three of which are held out; the record is the prediction with a smooth error and noise.
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
        (0..9).map(of).collect()
    }

    fn generic(channels: &[Channel]) -> Generic {
        Generic::of(channels, DT_S, [0.2, 9.5], BTreeMap::new())
    }

    #[test]
    fn a_smooth_error_is_taken_off_events_that_nobody_looked_at_and_claimed() {
        let found = generic(&channels(0.02, 0.7, 0.02));
        let Four { fe, fe_generic, flare_t, flare_t_generic } = found.test_median_nrmse_percent;
        assert!(fe.unwrap() > 30.0 && fe_generic.unwrap() < 0.35 * fe.unwrap(), "{fe:?} {fe_generic:?}");
        assert_eq!((flare_t, flare_t_generic), (None, None), "nothing to compare");
        let [change] = &found.changes[..] else { panic!("{:?}", found.changes) };
        assert!(change.is_improved && change.n_event == 3 && !found.is_physical);
    }

    #[test]
    fn what_held_out_events_do_not_confirm_is_not_claimed() {
        let mut channels = channels(0.02, 0.7, 0.02);
        // Held out, the prediction was right.
        for channel in channels.iter_mut().filter(|c| c.split == Split::Test) {
            channel.observed = channel.fe.clone().unwrap();
        }
        let found = generic(&channels);
        let [change] = &found.changes[..] else { panic!("{:?}", found.changes) };
        assert!(!change.is_improved && change.mean > 0.0, "{change:?}");
        // The fit has not looked at them.
        let others: Vec<Channel> = channels.into_iter().filter(|c| c.split != Split::Test).collect();
        assert_eq!(generic(&others).factors, found.factors);
    }

    #[test]
    fn what_has_no_correction_does_not_count() {
        let mut both = channels(0.02, 0.7, 0.02);
        // At another sensor nothing helps: what was wrong on training events is wrong the other way on the others.
        let mut other = channels(0.0, 0.5, 0.02);
        for channel in other.iter_mut().filter(|c| c.split != Split::Train) {
            channel.observed = channel.fe.iter().flatten().map(|x| 2.0 * x).collect();
        }
        both.extend(other.into_iter().map(|c| Channel { sensor: "T".into(), ..c }));
        let [found, alone] = [generic(&both), generic(&channels(0.02, 0.7, 0.02))];
        assert_eq!(found.factors.keys().collect::<Vec<_>>(), ["S"]);
        assert_eq!(found.changes[0], alone.changes[0]);
        assert_eq!(found.test_median_nrmse_percent, alone.test_median_nrmse_percent);
        assert!(found.errors.iter().all(|r| (r.sensor == "S") == r.nrmse_percent.fe_generic.is_some()));
    }

    #[test]
    fn a_correction_that_diverges_on_a_held_out_event_improves_nothing() {
        let taken = Outcome { is_asked: true, taken: Some("more".into()), validation: [0.2, 0.1], tried: Vec::new() };
        let terms = BTreeMap::from([("EW".to_string(), taken)]);
        let mut channels = channels(0.0, 1.0, 0.02);
        let of = |channels: &[Channel]| Generic::of(channels, DT_S, [0.2, 9.5], terms.clone());
        channels.iter_mut().for_each(|c| c.flare_t = [Some(30.0), Some(20.0)]);
        let is_improved = |g: &Generic| g.changes.iter().find(|c| c.to == "flare_t_generic").unwrap().is_improved;
        assert!(is_improved(&of(&channels)));
        let last = channels.len() - 1;
        let observed = channels[last].observed.clone();
        let (event, component, sensor) = ("E9".to_string(), "EW".to_string(), "S".to_string());
        let flare_t = [Some(30.0), None];
        channels.push(Channel { event, component, sensor, split: Split::Test, observed, fe: None, flare_t });
        let found = of(&channels);
        assert!(!is_improved(&found) && found.n_diverged == 1 && found.notes().last().unwrap().contains("diverges"));
        // A component without more terms is no part of it.
        let without = Generic::of(&channels, DT_S, [0.2, 9.5], BTreeMap::new());
        assert!(without.errors.iter().all(|r| r.nrmse_percent.flare_t_generic.is_none()) && without.n_diverged == 0);
    }

    #[test]
    fn why_terms_were_not_taken_is_said() {
        let tried = |stability, is_shared| Tried {
            terms: "slower memory".into(),
            n_coefficient: 9,
            weight: Some(1.0),
            validation_error: 0.1,
            stability,
            is_shared,
        };
        let note = |tried: Vec<Tried>| {
            let outcome = Outcome { is_asked: true, taken: None, validation: [0.2; 2], tried };
            let found = Generic::of(&[], DT_S, [0.2, 9.5], BTreeMap::from([("EW".to_string(), outcome)]));
            found.notes().pop().unwrap()
        };
        assert!(
            note(vec![tried(Some(1.0), Some(false))]).ends_with("0.2000 → 0.1000, but not with each of these left out")
        );
        assert!(
            note(vec![tried(Some(0.5), Some(true))])
                .ends_with("but in only 50 % of the fits with a training event left out")
        );
        assert!(note(vec![tried(None, None)]).ends_with("no group of them helps the validation events"));
        assert!(note(Vec::new()).ends_with("too few training events"));
    }
}
