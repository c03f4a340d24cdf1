//! What came of many twins: how often the right name was found, how often a wrong one, and what correcting was worth.

use crate::diagnosis::{RestVerdict, Verdict};
use crate::effects::{self, Class};
use crate::metrics::{median, quantile};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What a diagnosis made of one twin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// Its cell.
    pub cell: String,
    /// Number within the cell.
    pub number: usize,
    /// What held, as `[[effects]]`.
    pub truth: Vec<toml::Table>,
    /// Kinds that hold in the truth's own column, at no strength that was drawn as an effect: naming one is neither asked for nor wrong.
    #[serde(default)]
    pub besides: Vec<String>,
    /// What held outside the catalogue.
    pub outside: Vec<String>,
    /// Whether part of that is the same in all events.
    #[serde(default)]
    pub outside_repeats: bool,
    /// The answer.
    pub verdict: Verdict,
    /// Effects that were named.
    pub found: Vec<toml::Table>,
    /// Kinds that explain the records about as well.
    pub ambiguity: Vec<String>,
    /// What remains, where that was told.
    #[serde(default)]
    pub rest: Option<RestVerdict>,
    /// Kinds of models of one effect, best first.
    pub ranked: Vec<String>,
    /// Gain of the best candidate.
    pub gain: f64,
    /// Share of the residual power that was explained.
    pub explained_share: Option<f64>,
    /// Parameters of rightly named effects.
    pub parameters: Vec<Recovered>,
    /// Median NRMSE over the held-out events, %.
    pub nrmse_percent: Four,
    /// Where there are several effects: the same error without one of them in turn, the others known and the rest recalibrated.
    pub without_one_percent: Vec<f64>,
    /// Wall time of the diagnosis, s.
    #[serde(skip)]
    pub seconds: f64,
}

/// A parameter of a rightly named effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recovered {
    /// Kind and name: `sensor_gain.ln_gain`.
    pub name: String,
    /// What held.
    pub truth: f64,
    /// What was found.
    pub value: f64,
    /// Its 95 % interval.
    pub ci95: [f64; 2],
}

/// Errors of the models of a twin; `None` where there is none.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Four {
    /// As declared.
    pub declared: Option<f64>,
    /// Recalibrated within the tolerances.
    pub recalibrated: Option<f64>,
    /// Corrected.
    pub corrected: Option<f64>,
    /// By what really holds, driven by the recorded input; of a foreign truth, by the declared law with the effects that hold and the rest
    /// recalibrated.
    pub floor: Option<f64>,
}

/// A share with its 95 % interval after Wilson.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Share {
    /// How many.
    pub hits: usize,
    /// Of how many.
    pub of: usize,
    /// 95 % interval of the share.
    pub ci95: [f64; 2],
}

/// Middle and 90 % quantile of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Median.
    pub median: f64,
    /// 90 % of the sample lie below.
    pub q90: f64,
    /// Size of the sample.
    pub of: usize,
}

/// The figures of one group of twins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Twins whose answer is of the right class: `none` where nothing held; where only something outside the catalogue did, `unknown` if
    /// part of that is the same in all events and otherwise `none` with an incoherent rest; the right name where one holds.
    pub right_class: Share,
    /// Of the twins in which nothing held, those with an answer other than `none`.
    pub null_alarms: Share,
    /// Of the twins with something outside the catalogue and nothing in it, those whose answer is of the right class.
    pub outside_right: Share,
    /// Of the twins with a field that strays, those whose rest is called incoherent.
    #[serde(default)]
    pub incoherent: Option<Share>,
    /// Twins with an answer other than `none`.
    pub alarms: Share,
    /// Twins called unknown.
    pub unknown: Share,
    /// Twins whose effects were all named, surely or as one of several kinds, and nothing else surely.
    pub right: Share,
    /// Twins in whose answer a name that is said to be sure does not hold.
    pub wrong: Share,
    /// Twins whose first effect is the best model of one effect, whatever was announced.
    pub top_1: Share,
    /// Twins whose first effect is among the best three kinds.
    pub top_3: Share,
    /// Intervals that hold the truth.
    pub coverage: Share,
    /// Relative error of parameters, share.
    pub parameter_error: Option<Spread>,
    /// Error of the corrected model over that of the truth itself.
    pub corrected_over_floor: Option<Spread>,
    /// Medians of the errors, %.
    pub nrmse_percent: Four,
}

/// `twins.json`: tallies by cell, of all its twins and of those whose error outlives recalibration, and every outcome.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Seed of the matrix.
    pub seed: u64,
    /// Factor on the half-widths of all 95 % intervals with which they would hold 95 % of their truths.
    #[serde(default)]
    pub inflation: Option<f64>,
    /// Tally of each cell.
    pub cells: BTreeMap<String, Tally>,
    /// The same of twins with effects whose recalibrated error exceeds the floor by more than 15 %; of several effects each must, where
    /// the others are known.
    pub surviving: BTreeMap<String, Tally>,
    /// What held (first effect, thing outside, or `nothing`) → answer → twins.
    pub confusion: BTreeMap<String, BTreeMap<String, usize>>,
    /// Twins that could not be computed: name and reason.
    pub failed: Vec<(String, String)>,
    /// Every twin.
    pub outcomes: Vec<Outcome>,
}

/// Error of the recalibrated model, over the floor, from which an effect outlives recalibration.
const SURVIVES: f64 = 1.15;

impl Report {
    /// The report of `outcomes`.
    pub fn new(seed: u64, outcomes: Vec<Outcome>, failed: Vec<(String, String)>) -> Self {
        let mut cells: BTreeMap<String, Vec<&Outcome>> = BTreeMap::new();
        let mut confusion: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
        for outcome in &outcomes {
            cells.entry(outcome.cell.clone()).or_default().push(outcome);
            *confusion.entry(outcome.held()).or_default().entry(outcome.answer()).or_default() += 1;
        }
        let mut surviving = cells.clone();
        surviving.values_mut().for_each(|group| group.retain(|o| o.survives()));
        surviving.retain(|_, group| !group.is_empty());
        let of = |groups: BTreeMap<String, Vec<&Outcome>>| {
            groups.into_iter().map(|(name, group)| (name, Tally::of(&group))).collect()
        };
        let (cells, surviving) = (of(cells), of(surviving));
        let distances: Vec<f64> = outcomes.iter().flat_map(|o| &o.parameters).map(Recovered::distance).collect();
        let inflation = (!distances.is_empty()).then(|| quantile(&distances, 0.95));
        Self { seed, inflation, cells, surviving, confusion, failed, outcomes }
    }
}

impl Recovered {
    /// How far the truth is from what was found, over the distance of the end of the interval on that side.
    fn distance(&self) -> f64 {
        let [low, high] = self.ci95;
        let off = self.truth - self.value;
        let half = if off < 0.0 { self.value - low } else { high - self.value };
        if off == 0.0 { 0.0 } else { off.abs() / half.max(0.0) }
    }
}

impl Outcome {
    fn kinds(tables: &[toml::Table]) -> Vec<&str> {
        tables.iter().filter_map(|t| t.get("kind")?.as_str()).collect()
    }

    /// What held and could be named.
    fn nameable(&self) -> Vec<&str> {
        Self::kinds(&self.truth).into_iter().filter(|kind| !strays(kind)).collect()
    }

    fn held(&self) -> String {
        let kinds = Self::kinds(&self.truth);
        match (kinds.is_empty(), self.outside.is_empty()) {
            (false, _) => kinds.join(" + "),
            (true, false) => format!("outside: {}", self.outside.join(" + ")),
            (true, true) => "nothing".into(),
        }
    }

    fn answer(&self) -> String {
        match self.verdict {
            Verdict::None => "none".into(),
            Verdict::Unknown => "unknown".into(),
            Verdict::Known => Self::kinds(&self.found).join(" + "),
            Verdict::Ambiguous => {
                let known = self.sure().map(|kind| format!("{kind} + ")).collect::<String>();
                format!("ambiguous: {known}{}", self.ambiguity.join(" | "))
            }
        }
    }

    fn survives(&self) -> bool {
        let Four { recalibrated: Some(recalibrated), floor: Some(floor), .. } = self.nrmse_percent else {
            return false;
        };
        let all = self.without_one_percent.iter().chain([&recalibrated]);
        !self.nameable().is_empty() && all.fold(f64::INFINITY, |least, e| e.min(least)) > SURVIVES * floor
    }

    fn is_null(&self) -> bool {
        self.nameable().is_empty() && self.outside.is_empty()
    }

    fn is_outside(&self) -> bool {
        self.nameable().is_empty() && !self.outside.is_empty()
    }

    fn is_of_right_class(&self) -> bool {
        if self.is_null() {
            self.verdict == Verdict::None
        } else if self.is_outside() {
            let is_incoherent = self.verdict == Verdict::None && self.rest == Some(RestVerdict::Incoherent);
            if self.outside_repeats { self.verdict == Verdict::Unknown } else { is_incoherent }
        } else {
            self.is_right()
        }
    }

    /// Whether a kind that was named does not hold.
    fn is_false(&self, kind: &str) -> bool {
        !self.nameable().contains(&kind) && !self.besides.iter().any(|known| known == kind)
    }

    fn is_right(&self) -> bool {
        let (held, found) = (self.nameable(), Self::kinds(&self.found));
        let named = |kind: &&str| found.contains(kind) || self.ambiguity.iter().any(|k| k == kind);
        matches!(self.verdict, Verdict::Known | Verdict::Ambiguous)
            && !held.is_empty()
            && held.iter().all(named)
            && !self.is_wrong()
    }

    /// Kinds that were named and are not among those of which one may hold.
    fn sure(&self) -> impl Iterator<Item = &str> {
        Self::kinds(&self.found).into_iter().filter(|kind| !self.ambiguity.iter().any(|open| open == kind))
    }

    /// Whether a name that is said to be sure does not hold.
    fn is_wrong(&self) -> bool {
        self.sure().any(|kind| self.is_false(kind))
    }

    fn rank(&self) -> Option<usize> {
        let first = *self.nameable().first()?;
        self.ranked.iter().position(|kind| kind == first)
    }
}

/// Whether an effect lets the field stray.
fn strays(kind: &str) -> bool {
    effects::find(kind).is_ok_and(|e| e.catalogue.class == Class::Field)
}

impl Tally {
    fn of(group: &[&Outcome]) -> Self {
        let n = group.len();
        let share = |is: &dyn Fn(&Outcome) -> bool| Share::new(group.iter().filter(|o| is(o)).count(), n);
        let recovered: Vec<&Recovered> = group.iter().flat_map(|o| &o.parameters).collect();
        let is_inside = |r: &&&Recovered| (r.ci95[0]..=r.ci95[1]).contains(&r.truth);
        let errors = recovered.iter().filter(|r| r.truth != 0.0).map(|r| ((r.value - r.truth) / r.truth).abs());
        let ratios = group.iter().filter_map(|o| Some(o.nrmse_percent.corrected? / o.nrmse_percent.floor?));
        let middle = |pick: fn(&Four) -> Option<f64>| {
            let values: Vec<f64> = group.iter().filter_map(|o| pick(&o.nrmse_percent)).collect();
            (!values.is_empty()).then(|| median(&values))
        };
        let of_those = |are: &dyn Fn(&Outcome) -> bool, is: &dyn Fn(&Outcome) -> bool| {
            let those: Vec<&&Outcome> = group.iter().filter(|o| are(o)).collect();
            Share::new(those.iter().filter(|o| is(o)).count(), those.len())
        };
        let is_straying = |o: &Outcome| Outcome::kinds(&o.truth).into_iter().any(strays);
        let incoherent = of_those(&is_straying, &|o| o.rest == Some(RestVerdict::Incoherent));
        Self {
            right_class: share(&Outcome::is_of_right_class),
            null_alarms: of_those(&Outcome::is_null, &|o| o.verdict != Verdict::None),
            outside_right: of_those(&Outcome::is_outside, &Outcome::is_of_right_class),
            incoherent: (incoherent.of > 0).then_some(incoherent),
            alarms: share(&|o| o.verdict != Verdict::None),
            unknown: share(&|o| o.verdict == Verdict::Unknown),
            right: share(&Outcome::is_right),
            wrong: share(&Outcome::is_wrong),
            top_1: share(&|o| o.rank() == Some(0)),
            top_3: share(&|o| o.rank().is_some_and(|rank| rank < 3)),
            coverage: Share::new(recovered.iter().filter(is_inside).count(), recovered.len()),
            parameter_error: Spread::of(errors.collect()),
            corrected_over_floor: Spread::of(ratios.collect()),
            nrmse_percent: Four {
                declared: middle(|f| f.declared),
                recalibrated: middle(|f| f.recalibrated),
                corrected: middle(|f| f.corrected),
                floor: middle(|f| f.floor),
            },
        }
    }
}

impl Share {
    /// `hits` of `of`, with the interval of Wilson (1927).
    pub fn new(hits: usize, of: usize) -> Self {
        if of == 0 {
            return Self { hits, of, ci95: [0.0, 1.0] };
        }
        let (n, p, z) = (of as f64, hits as f64 / of as f64, 1.96f64);
        let middle = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
        let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
        Self { hits, of, ci95: [(middle - half).max(0.0), (middle + half).min(1.0)] }
    }
}

impl Spread {
    fn of(values: Vec<f64>) -> Option<Self> {
        let values: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
        (!values.is_empty()).then(|| Self { median: median(&values), q90: quantile(&values, 0.9), of: values.len() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outcome(held: &[&str], verdict: Verdict, found: &[&str], ranked: &[&str]) -> Outcome {
        let tables = |kinds: &[&str]| -> Vec<toml::Table> {
            kinds.iter().map(|k| toml::Table::from_iter([("kind".to_string(), (*k).into())])).collect()
        };
        Outcome {
            cell: "c".into(),
            number: 1,
            truth: tables(held),
            besides: Vec::new(),
            outside: Vec::new(),
            outside_repeats: false,
            verdict,
            found: tables(found),
            ambiguity: Vec::new(),
            rest: None,
            ranked: ranked.iter().map(|k| (*k).to_string()).collect(),
            gain: 0.0,
            explained_share: None,
            parameters: vec![Recovered { name: "a.x".into(), truth: 2.0, value: 2.2, ci95: [2.1, 2.3] }],
            nrmse_percent: Four {
                declared: Some(40.0),
                recalibrated: Some(20.0),
                corrected: Some(11.0),
                floor: Some(10.0),
            },
            without_one_percent: Vec::new(),
            seconds: 0.0,
        }
    }

    #[test]
    fn right_wrong_and_missed_names_are_told_apart() {
        let mut outcomes = vec![
            outcome(&["a"], Verdict::Known, &["a"], &["a", "b"]),
            outcome(&["a"], Verdict::Known, &["b"], &["b", "a"]),
            outcome(&["a"], Verdict::None, &[], &["c", "d", "e", "a"]),
            outcome(&["a", "b"], Verdict::Known, &["a"], &["a"]),
            outcome(&[], Verdict::Known, &["b"], &["b"]),
        ];
        outcomes[3].without_one_percent = vec![20.0, 11.0];
        let report = Report::new(1, outcomes, Vec::new());
        let tally = &report.cells["c"];
        let counts = [&tally.right, &tally.wrong, &tally.top_1, &tally.top_3, &tally.alarms].map(|s| s.hits);
        assert_eq!(counts, [1, 2, 2, 3, 4]);
        assert_eq!((tally.right_class.hits, tally.right_class.of), (1, 5));
        assert_eq!((tally.null_alarms.hits, tally.null_alarms.of, tally.outside_right.of), (1, 1, 0));
        assert_eq!(tally.coverage.hits, 0);
        assert!(tally.parameter_error.is_some_and(|s| (s.median - 0.1).abs() < 1e-12));
        assert!(tally.corrected_over_floor.is_some_and(|s| (s.median - 1.1).abs() < 1e-12));
        assert_eq!(
            report.surviving["c"].right.of, 3,
            "a null twin survives nothing, nor does one of two effects that hides"
        );
        assert_eq!(report.confusion["nothing"]["b"], 1);
        assert_eq!(report.confusion["a + b"]["a"], 1);
    }

    #[test]
    fn what_holds_besides_is_neither_asked_for_nor_wrong_but_names_nothing_alone() {
        let of = |held: &[&str], found: &[&str]| {
            let named = Outcome { besides: vec!["b".into()], ..outcome(held, Verdict::Known, found, found) };
            let Tally { right_class, wrong, null_alarms, .. } = Tally::of(&[&named]);
            [right_class.hits, wrong.hits, null_alarms.hits]
        };
        assert_eq!(of(&["a"], &["a"]), [1, 0, 0]);
        assert_eq!(of(&["a"], &["a", "b"]), [1, 0, 0]);
        assert_eq!(of(&["a"], &["b"]), [0, 0, 0]);
        assert_eq!(of(&["a"], &["a", "c"]), [0, 1, 0]);
        assert_eq!(of(&[], &["b"]), [0, 0, 1]);
    }

    #[test]
    fn the_class_of_an_answer_is_judged_by_what_held() {
        let outside = |verdict, rest, outside_repeats| Outcome {
            outside: vec!["something".into()],
            outside_repeats,
            rest: Some(rest),
            ..outcome(&[], verdict, &[], &[])
        };
        let outcomes = vec![
            outcome(&[], Verdict::None, &[], &[]),
            outside(Verdict::Unknown, RestVerdict::Unnamed, true),
            outside(Verdict::None, RestVerdict::Incoherent, false),
            outside(Verdict::None, RestVerdict::Incoherent, true),
            outside(Verdict::Unknown, RestVerdict::Unnamed, false),
            outside(Verdict::None, RestVerdict::Noise, false),
        ];
        let report = Report::new(1, outcomes, Vec::new());
        let tally = &report.cells["c"];
        let shares = [&tally.right_class, &tally.null_alarms, &tally.outside_right].map(|s| (s.hits, s.of));
        assert_eq!(shares, [(3, 6), (0, 1), (2, 5)]);
    }

    #[test]
    fn the_interval_of_a_share_is_that_of_wilson() {
        let none = Share::new(0, 60);
        assert!(none.ci95[0] == 0.0 && (none.ci95[1] - 0.0602).abs() < 1e-3, "{none:?}");
        let most = Share::new(31, 36);
        assert!((most.ci95[0] - 0.713).abs() < 2e-3 && (most.ci95[1] - 0.939).abs() < 2e-3, "{most:?}");
    }

    #[test]
    fn a_field_that_strays_is_not_to_be_named_and_its_rest_is_counted() {
        let right =
            Outcome { rest: Some(RestVerdict::Incoherent), ..outcome(&["incoherence"], Verdict::None, &[], &[]) };
        let missed = Outcome { rest: Some(RestVerdict::Noise), ..right.clone() };
        let alarm = outcome(&["incoherence"], Verdict::Known, &["small_strain_damping"], &["small_strain_damping"]);
        let tally = Tally::of(&[&right, &missed, &alarm]);
        assert_eq!((tally.right_class.hits, tally.null_alarms.hits, tally.wrong.hits), (2, 1, 1));
        assert_eq!(tally.incoherent.map(|share| (share.hits, share.of)), Some((1, 3)));
        assert!(Tally::of(&[&outcome(&[], Verdict::None, &[], &[])]).incoherent.is_none());
    }

    #[test]
    fn the_factor_on_intervals_is_that_with_which_they_would_hold() {
        // Truths at multiples of the half-width from 0.1 to 2.0, on either side in turn.
        let parameter = |i: i32| {
            let off = 0.1 * f64::from(i) * if i % 2 == 0 { 0.5 } else { -0.2 };
            Recovered { name: "p".into(), truth: 3.0 + off, value: 3.0, ci95: [2.8, 3.5] }
        };
        let mut one = outcome(&["a"], Verdict::Known, &["a"], &["a"]);
        one.parameters = (1..=20).map(parameter).collect();
        let report = Report::new(1, vec![one], Vec::new());
        assert!(report.inflation.is_some_and(|f| (1.8..=2.0).contains(&f)), "{:?}", report.inflation);
        assert_eq!(report.cells["c"].coverage.hits, 10);
        assert_eq!(Report::new(1, Vec::new(), Vec::new()).inflation, None);
    }
}
