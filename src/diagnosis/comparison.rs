//! Was it worth it? Six errors side by side on every recorded event, and which of their differences may be claimed.

use crate::metrics::{median, median_interval};
use crate::records::Split;
use serde::{Deserialize, Serialize};

/// One value for each of six predictions, in the order in which a loop is closed; `None` where there is none.
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
}

impl<T> Six<T> {
    /// Names and values in order.
    pub fn named(&self) -> [(&'static str, &T); 6] {
        [
            ("declared", &self.declared),
            ("recalibrated", &self.recalibrated),
            ("corrected", &self.corrected),
            ("flare_before", &self.flare_before),
            ("flare_after", &self.flare_after),
            ("noise_floor", &self.noise_floor),
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
}

/// The paired difference of two predictions over the held-out events.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// The prediction that is compared with.
    pub from: String,
    /// The prediction that should be better.
    pub to: String,
    /// Median of the differences of NRMSE, percentage points; negative is better.
    pub median_points: f64,
    /// 95 % interval of that median over events.
    pub ci95_points: [f64; 2],
    /// Whether the whole interval lies below zero, with two events or more behind it.
    pub is_improved: bool,
    /// Events that both predictions have.
    pub n_event: usize,
}

/// What the held-out events say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Medians over events, components and sensors.
    pub test_median_nrmse_percent: Six<Option<f64>>,
    /// 95 % intervals of those medians over events.
    pub test_ci95_nrmse_percent: Six<Option<[f64; 2]>>,
    /// Median with the simulations as declared and the calibration alone on the corrected manifest.
    pub test_median_ablation_percent: Option<f64>,
    /// Paired differences.
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

impl Summary {
    /// Medians and paired differences over the held-out `rows`, `ablation` being the errors of the ablation beside them.
    pub fn of(rows: &[ErrorRow], ablation: &[Option<f64>], seed: u64) -> Self {
        let tests: Vec<&ErrorRow> = rows.iter().filter(|r| r.split == Split::Test).collect();
        let pick = |row: &ErrorRow, name: &str| {
            row.nrmse_percent.named().iter().find(|(n, _)| *n == name)?.1.as_ref().copied()
        };
        let over = |name: &str| by_event(tests.iter().map(|row| (row.event.as_str(), pick(row, name))));
        let names = Six {
            declared: "declared",
            recalibrated: "recalibrated",
            corrected: "corrected",
            flare_before: "flare_before",
            flare_after: "flare_after",
            noise_floor: "noise_floor",
        };
        let all = |events: Vec<Vec<f64>>| events.concat();
        let middle = |values: Vec<f64>| (!values.is_empty()).then(|| median(&values));
        let beside =
            rows.iter().zip(ablation).filter(|(row, _)| row.split == Split::Test).filter_map(|(_, value)| *value);
        let changes = PAIRS.iter().filter_map(|(from, to)| {
            let difference = |row: &ErrorRow| Some(pick(row, to)? - pick(row, from)?);
            Change::of(tests.iter().map(|row| (row.event.as_str(), difference(row))), from, to, seed)
        });
        Self {
            test_median_nrmse_percent: names.map(|name| middle(all(over(name)))),
            test_ci95_nrmse_percent: names.map(|name| median_interval(&over(name), seed)),
            test_median_ablation_percent: middle(beside.collect()),
            changes: changes.collect(),
        }
    }
}

impl Change {
    /// The change `from` one prediction `to` another by their `differences` of NRMSE, each with its event; `None` without any.
    pub fn of<'a>(
        differences: impl Iterator<Item = (&'a str, Option<f64>)>,
        from: &str,
        to: &str,
        seed: u64,
    ) -> Option<Self> {
        let events = by_event(differences);
        let ci95_points = median_interval(&events, seed)?;
        let n_event = events.len();
        let is_improved = n_event >= 2 && ci95_points[1] < 0.0;
        let median_points = median(&events.concat());
        Some(Self { from: from.into(), to: to.into(), median_points, ci95_points, is_improved, n_event })
    }
}

/// The finite ones of the values, one list an event.
fn by_event<'a>(values: impl Iterator<Item = (&'a str, Option<f64>)>) -> Vec<Vec<f64>> {
    let mut events: Vec<(&str, Vec<f64>)> = Vec::new();
    for (event, value) in values {
        let Some(value) = value.filter(|v| v.is_finite()) else { continue };
        match events.iter_mut().find(|(known, _)| *known == event) {
            Some((_, values)) => values.push(value),
            None => events.push((event, vec![value])),
        }
    }
    events.into_iter().map(|(_, values)| values).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(event: &str, split: Split, recalibrated: f64, corrected: Option<f64>) -> ErrorRow {
        let nrmse_percent = Six { recalibrated: Some(recalibrated), corrected, ..Six::default() };
        ErrorRow { event: event.into(), component: "EW".into(), sensor: "S".into(), split, nrmse_percent }
    }

    #[test]
    fn an_improvement_is_claimed_only_where_every_resample_agrees() {
        let clear: Vec<ErrorRow> =
            (0..5).map(|i| row(&format!("E{i}"), Split::Test, 40.0 + f64::from(i), Some(20.0))).collect();
        let summary = Summary::of(&clear, &[None; 5], 1);
        let change = &summary.changes[0];
        assert_eq!((change.from.as_str(), change.to.as_str(), change.n_event), ("recalibrated", "corrected", 5));
        assert!(change.is_improved && change.median_points == -22.0 && change.ci95_points[1] <= -20.0);
        assert_eq!(summary.test_median_nrmse_percent.corrected, Some(20.0));
        assert_eq!(summary.test_median_nrmse_percent.flare_after, None);
        let mixed =
            [clear.clone(), vec![row("E9", Split::Test, 10.0, Some(60.0)), row("E8", Split::Test, 10.0, Some(60.0))]];
        assert!(!Summary::of(&mixed.concat(), &[], 1).changes[0].is_improved);
    }

    #[test]
    fn only_held_out_events_count() {
        let rows = [row("A", Split::Train, 90.0, Some(1.0)), row("B", Split::Test, 30.0, None)];
        let summary = Summary::of(&rows, &[Some(5.0), Some(7.0)], 1);
        assert_eq!(summary.test_median_nrmse_percent.recalibrated, Some(30.0));
        assert_eq!(summary.test_median_ablation_percent, Some(7.0));
        assert!(summary.changes.is_empty());
    }
}
