//! Was it worth it? Six errors side by side on every recorded event, the ceiling beside them, and which of their differences may be
//! claimed, measure by measure.

use crate::metrics::{Claimed, FieldSummary, Measures, PairedDifference, SensorTransfer, median};
use crate::records::Split;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One value for each of six predictions, in the order in which a loop is closed, and the ceiling beside them; `None` where there is
/// none.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Six<T> {
    /// Finite elements as declared.
    pub declared: T,
    /// Finite elements with the declared values recalibrated within their tolerances: the null hypothesis.
    pub recalibrated: T,
    /// Finite elements with the effects that were found.
    pub corrected: T,
    /// FLARE-T, all stages on the declared column.
    pub flare_before: T,
    /// FLARE-T, all stages on the corrected column.
    pub flare_after: T,
    /// What sensor noise leaves to the right model.
    pub noise_floor: T,
    /// What anything that is the same in all events leaves: the best of filters fitted to training events.
    pub ceiling: T,
}

/// Names of the predictions among [`Six`], in their order.
pub const PREDICTIONS: [&str; 5] = ["declared", "recalibrated", "corrected", "flare_before", "flare_after"];

impl<T> Six<T> {
    /// The value of that name.
    pub fn get(&self, name: &str) -> Option<&T> {
        self.named().into_iter().find(|(own, _)| *own == name).map(|(_, value)| value)
    }

    /// Names and values in order.
    pub fn named(&self) -> [(&'static str, &T); 7] {
        [
            ("declared", &self.declared),
            ("recalibrated", &self.recalibrated),
            ("corrected", &self.corrected),
            ("flare_before", &self.flare_before),
            ("flare_after", &self.flare_after),
            ("noise_floor", &self.noise_floor),
            ("ceiling", &self.ceiling),
        ]
    }

    /// The same of other values.
    pub fn map<U>(&self, mut change: impl FnMut(&T) -> U) -> Six<U> {
        Six {
            declared: change(&self.declared),
            recalibrated: change(&self.recalibrated),
            corrected: change(&self.corrected),
            flare_before: change(&self.flare_before),
            flare_after: change(&self.flare_after),
            noise_floor: change(&self.noise_floor),
            ceiling: change(&self.ceiling),
        }
    }
}

/// The errors at one sensor of one event and component.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErrorRow {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// Sensor.
    pub sensor: String,
    /// What the event was used for.
    pub split: Split,
    /// NRMSE against the record as measured, %.
    pub nrmse_percent: Six<Option<f64>>,
    /// The same in the band in which the site is coherent, %; over all frequencies where no coherence is known.
    pub nrmse_coherent_percent: Six<Option<f64>>,
    /// That of the coherent mean, %: of the prediction times the coherence.
    pub nrmse_coherent_mean_percent: Six<Option<f64>>,
    /// The field's measures by model: the predictions, `ceiling`, and `other_component`, the other horizontal record taken for a
    /// prediction of this one.
    pub measures: BTreeMap<String, Option<Measures>>,
}

/// The paired difference of two predictions over the held-out events.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// What is compared.
    pub measure: Claimed,
    /// The prediction that is compared with.
    pub from: String,
    /// The prediction that should be better.
    pub to: String,
    /// Mean over events of the difference, in the unit of the measure; negative is better.
    pub mean: f64,
    /// 95 % interval of that mean after Student; `None` for one event.
    pub ci95: Option<[f64; 2]>,
    /// Two-sided p of the exact sign test.
    pub sign_test_p: f64,
    /// Whether the whole interval lies below zero, with three events or more behind it.
    pub is_improved: bool,
    /// Events that both predictions have.
    pub n_event: usize,
}

/// What the held-out events say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Medians over events, components and sensors.
    pub test_median_nrmse_percent: Six<Option<f64>>,
    /// Means over events of the means over components and sensors.
    pub test_mean_nrmse_percent: Six<Option<f64>>,
    /// 95 % intervals of those means after Student.
    pub test_ci95_nrmse_percent: Six<Option<[f64; 2]>>,
    /// Medians in the coherent band.
    pub test_median_nrmse_coherent_percent: Six<Option<f64>>,
    /// Medians of the coherent mean.
    pub test_median_nrmse_coherent_mean_percent: Six<Option<f64>>,
    /// Median with the simulations as declared and the calibration alone on the corrected manifest.
    pub test_median_ablation_percent: Option<f64>,
    /// Edges of the bands of the Fourier amplitude, Hz.
    pub fourier_bands_hz: Vec<[f64; 2]>,
    /// Edges of the bands of the response spectrum, s.
    pub psa_bands_s: Vec<[f64; 2]>,
    /// The field's measures by model.
    pub test_measures: BTreeMap<String, FieldSummary>,
    /// Transfer functions of all weak events, by component and sensor.
    pub transfer: Vec<SensorTransfer>,
    /// Paired differences, measure by measure.
    pub changes: Vec<Change>,
}

/// Pairs whose difference answers a question: what recalibration repaired, what the effects earned beyond it, and the
/// same for FLARE-T.
const PAIRS: [(&str, &str); 4] = [
    ("declared", "recalibrated"),
    ("recalibrated", "corrected"),
    ("flare_before", "flare_after"),
    ("corrected", "flare_after"),
];

impl ErrorRow {
    /// One error of one model; `None` where there is none.
    fn error(&self, measure: Claimed, model: &str) -> Option<f64> {
        let of_field = || self.measures.get(model)?.as_ref();
        match measure {
            Claimed::NrmsePercent => self.nrmse_percent.get(model).copied().flatten(),
            Claimed::LnFourier => of_field()?.ln_fourier_by_hz.rms,
            Claimed::LnPsa => of_field()?.ln_psa_by_s.rms,
            Claimed::CoherentNrmsePercent => self.nrmse_coherent_percent.get(model).copied().flatten(),
            Claimed::LnPga => of_field()?.ln_pga.map(f64::abs),
            Claimed::LnArias => of_field()?.ln_arias.map(f64::abs),
            Claimed::LnDuration => of_field()?.ln_duration_5_95.map(f64::abs),
        }
    }
}

impl Summary {
    /// Medians, means and paired differences over the held-out `rows`, `ablation` being the errors of the ablation beside them, and the
    /// transfer functions as given.
    pub fn of(rows: &[ErrorRow], ablation: &[Option<f64>], transfer: Vec<SensorTransfer>) -> Self {
        let tests: Vec<&ErrorRow> = rows.iter().filter(|r| r.split == Split::Test).collect();
        let names = Six {
            declared: "declared",
            recalibrated: "recalibrated",
            corrected: "corrected",
            flare_before: "flare_before",
            flare_after: "flare_after",
            noise_floor: "noise_floor",
            ceiling: "ceiling",
        };
        let middle = |values: Vec<f64>| (!values.is_empty()).then(|| median(&values));
        let median_of = |pick: fn(&ErrorRow) -> &Six<Option<f64>>| {
            let values = |name: &&str| tests.iter().filter_map(|row| pick(row).get(name).copied().flatten()).collect();
            names.map(|name| middle(values(name)))
        };
        let over_events = |measure: Claimed, name: &str| {
            PairedDifference::of(&by_event(tests.iter().map(|row| (row.event.as_str(), row.error(measure, name)))))
        };
        let means = names.map(|name| over_events(Claimed::NrmsePercent, name));
        let beside =
            rows.iter().zip(ablation).filter(|(row, _)| row.split == Split::Test).filter_map(|(_, value)| *value);
        let changes = Claimed::ALL.into_iter().flat_map(|measure| PAIRS.map(|pair| (measure, pair)));
        let changes = changes.filter_map(|(measure, (from, to))| {
            let difference = |row: &ErrorRow| Some(row.error(measure, to)? - row.error(measure, from)?);
            Change::of(measure, tests.iter().map(|row| (row.event.as_str(), difference(row))), from, to)
        });
        Self {
            test_median_nrmse_percent: median_of(|row| &row.nrmse_percent),
            test_mean_nrmse_percent: means.map(|m| m.map(|m| m.mean)),
            test_ci95_nrmse_percent: means.map(|m| m.and_then(|m| m.ci95)),
            test_median_nrmse_coherent_percent: median_of(|row| &row.nrmse_coherent_percent),
            test_median_nrmse_coherent_mean_percent: median_of(|row| &row.nrmse_coherent_mean_percent),
            test_median_ablation_percent: middle(beside.collect()),
            fourier_bands_hz: crate::metrics::fourier_bands().edges,
            psa_bands_s: crate::metrics::psa_bands().edges,
            test_measures: measures(&tests),
            transfer,
            changes: changes.collect(),
        }
    }
}

/// Which held-out records a prediction lacks that others have, in sentences: medians and claims are then of other records.
pub fn missing_predictions(rows: &[ErrorRow]) -> Vec<String> {
    let tests = || rows.iter().filter(|row| row.split == Split::Test);
    let of = |model: &str| {
        let has = |row: &&ErrorRow| row.nrmse_percent.get(model).is_some_and(Option::is_some);
        let mut lacking: Vec<String> =
            tests().filter(|row| !has(row)).map(|r| format!("{} {}", r.event, r.component)).collect();
        lacking.dedup();
        let is_there = tests().any(|row| has(&row));
        (is_there && !lacking.is_empty()).then(|| {
            format!(
                "`{model}` predicts nothing of {}: its medians are of the other held-out records.",
                lacking.join(", ")
            )
        })
    };
    PREDICTIONS.into_iter().filter_map(of).collect()
}

/// The field's measures of each model over `rows`.
fn measures(rows: &[&ErrorRow]) -> BTreeMap<String, FieldSummary> {
    let mut models: Vec<&String> = rows.iter().flat_map(|row| row.measures.keys()).collect();
    models.sort_unstable();
    models.dedup();
    let of = |model: &&String| {
        let own: Vec<&Measures> = rows.iter().filter_map(|row| row.measures.get(*model)?.as_ref()).collect();
        Some(((*model).clone(), FieldSummary::of(&own)?))
    };
    models.iter().filter_map(of).collect()
}

impl Change {
    /// The change `from` one prediction `to` another by their `differences` in `measure`, each with its event; `None` without any.
    ///
    /// The differences of one event share its motion: their mean counts, once.
    pub fn of<'a>(
        measure: Claimed,
        differences: impl Iterator<Item = (&'a str, Option<f64>)>,
        from: &str,
        to: &str,
    ) -> Option<Self> {
        let found = PairedDifference::of(&by_event(differences))?;
        let PairedDifference { mean, ci95, sign_test_p, n } = found;
        let is_improved = found.is_below_zero();
        Some(Self { measure, from: from.into(), to: to.into(), mean, ci95, sign_test_p, is_improved, n_event: n })
    }

    /// Whether it is told without being asked for: the first measures always, others where they differ for sure.
    pub fn is_told(&self) -> bool {
        self.measure.is_first() || self.is_improved || self.is_worse()
    }

    fn is_worse(&self) -> bool {
        PairedDifference::is_above_zero(self.ci95, self.n_event)
    }

    /// What the difference allows to say, for people.
    pub fn claim(&self) -> String {
        let Self { measure, from, to, n_event, .. } = self;
        let held_out = if *n_event == 1 { "held-out event" } else { "held-out events" };
        let interval = self.ci95.map_or(String::new(), |ends| {
            let [low, high] = ends.map(|v| measure.written(v));
            format!(" [{low}, {high}]")
        });
        let (mean, unit, p) = (measure.written(self.mean), measure.unit(), self.sign_test_p);
        let numbers = format!("{mean}{unit}{interval} over {n_event} {held_out}, sign test p = {p:.2}");
        let what = measure.name();
        if self.is_improved {
            format!("{what}: {to} improves on {from}: {numbers}")
        } else if *n_event < PairedDifference::FEWEST {
            let needed = PairedDifference::FEWEST;
            format!("{what}: nothing is claimed of {to} against {from}, that takes {needed} held-out events: {numbers}")
        } else if self.is_worse() {
            format!("{what}: {to} is worse than {from}: {numbers}")
        } else {
            format!("{what}: no improvement of {to} on {from} can be claimed: {numbers}")
        }
    }
}

/// Means of the finite values of each event, in the order in which the events come.
fn by_event<'a>(values: impl Iterator<Item = (&'a str, Option<f64>)>) -> Vec<f64> {
    let mut events: Vec<(&str, Vec<f64>)> = Vec::new();
    for (event, value) in values {
        let Some(value) = value.filter(|v| v.is_finite()) else { continue };
        match events.iter_mut().find(|(known, _)| *known == event) {
            Some((_, values)) => values.push(value),
            None => events.push((event, vec![value])),
        }
    }
    events.into_iter().map(|(_, values)| values.iter().sum::<f64>() / values.len() as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::LnRatio;

    fn row(event: &str, split: Split, recalibrated: f64, corrected: Option<f64>) -> ErrorRow {
        let nrmse_percent = Six { recalibrated: Some(recalibrated), corrected, ..Six::default() };
        let (event, component, sensor) = (event.into(), "EW".into(), "S".into());
        ErrorRow {
            event,
            component,
            sensor,
            split,
            nrmse_percent,
            nrmse_coherent_percent: Six::default(),
            nrmse_coherent_mean_percent: Six::default(),
            measures: BTreeMap::new(),
        }
    }

    fn summary(rows: &[ErrorRow]) -> Summary {
        Summary::of(rows, &[], Vec::new())
    }

    #[test]
    fn an_improvement_is_claimed_only_where_the_interval_excludes_none() {
        let clear: Vec<ErrorRow> =
            (0..5).map(|i| row(&format!("E{i}"), Split::Test, 40.0 + f64::from(i), Some(20.0))).collect();
        let found = summary(&clear);
        let change = &found.changes[0];
        assert_eq!((change.from.as_str(), change.to.as_str(), change.n_event), ("recalibrated", "corrected", 5));
        assert!(change.is_improved && (change.mean + 22.0).abs() < 1e-9 && change.claim().contains("improves on"));
        assert_eq!(found.test_median_nrmse_percent.corrected, Some(20.0));
        assert_eq!(found.test_median_nrmse_percent.flare_after, None);
        let back: Vec<ErrorRow> =
            (0..5).map(|i| row(&format!("E{i}"), Split::Test, 20.0, Some(40.0 + f64::from(i)))).collect();
        let worse = &summary(&back).changes[0];
        assert!(!worse.is_improved && worse.claim().contains("corrected is worse than recalibrated"));
        let mixed =
            [clear.clone(), vec![row("E9", Split::Test, 10.0, Some(60.0)), row("E8", Split::Test, 10.0, Some(60.0))]];
        assert!(!summary(&mixed.concat()).changes[0].is_improved);
    }

    #[test]
    fn an_event_counts_once_however_many_sensors_it_has() {
        let mut rows: Vec<ErrorRow> = (0..20).map(|_| row("A", Split::Test, 50.0, Some(20.0))).collect();
        rows.push(row("B", Split::Test, 30.0, Some(29.0)));
        rows.push(row("C", Split::Test, 30.0, Some(29.5)));
        let change = &summary(&rows).changes[0];
        assert_eq!(change.n_event, 3);
        assert!((change.mean + 31.5 / 3.0).abs() < 1e-9 && !change.is_improved, "{change:?}");
    }

    #[test]
    fn two_events_claim_nothing_and_say_so() {
        let rows = [row("A", Split::Test, 50.0, Some(20.0)), row("B", Split::Test, 50.0, Some(20.1))];
        let change = &summary(&rows).changes[0];
        assert!(!change.is_improved && change.claim().contains("that takes 3 held-out events"), "{}", change.claim());
    }

    #[test]
    fn one_measure_may_improve_and_another_not() {
        let rows: Vec<ErrorRow> = (0..4)
            .map(|i| {
                let mut row = row(&format!("E{i}"), Split::Test, 100.0, Some(100.0 + f64::from(i % 2)));
                for (model, rms) in [("recalibrated", 0.8), ("corrected", 0.3 + 0.01 * f64::from(i))] {
                    let ln_fourier_by_hz = LnRatio { rms: Some(rms), ..LnRatio::default() };
                    row.measures.insert(model.into(), Some(Measures { ln_fourier_by_hz, ..Measures::default() }));
                }
                row.measures.insert("flare_after".into(), None);
                row
            })
            .collect();
        let found = summary(&rows);
        let of = |measure| found.changes.iter().find(|c| c.measure == measure);
        assert!(!of(Claimed::NrmsePercent).unwrap().is_improved && of(Claimed::LnFourier).unwrap().is_improved);
        assert!(of(Claimed::LnPsa).is_none());
        assert!((found.test_measures["corrected"].ln_fourier_by_hz.rms.unwrap() - 0.315).abs() < 1e-3);
        assert!(!found.test_measures.contains_key("flare_after"));
    }

    #[test]
    fn a_record_that_a_prediction_lacks_is_told() {
        let rows = [
            row("A", Split::Test, 30.0, Some(20.0)),
            row("B", Split::Test, 30.0, None),
            row("B", Split::Test, 30.0, None),
            row("C", Split::Train, 30.0, None),
        ];
        let told = missing_predictions(&rows);
        assert_eq!(told, ["`corrected` predicts nothing of B EW: its medians are of the other held-out records."]);
        assert!(missing_predictions(&rows[..1]).is_empty());
    }

    #[test]
    fn only_held_out_events_count() {
        let rows = [row("A", Split::Train, 90.0, Some(1.0)), row("B", Split::Test, 30.0, None)];
        let summary = Summary::of(&rows, &[Some(5.0), Some(7.0)], Vec::new());
        assert_eq!(summary.test_median_nrmse_percent.recalibrated, Some(30.0));
        assert_eq!(summary.test_median_ablation_percent, Some(7.0));
        assert!(summary.changes.is_empty());
    }
}
