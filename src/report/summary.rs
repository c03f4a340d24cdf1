//! The top of the page: what came out, in a sentence that is true whichever way it went.

use std::cmp::Ordering;

use kuva::plot::scatter::MarkerShape;
use maud::{Markup, html};

use super::answer::answer;
use super::chart::{self, Axis, Curve, Dots, Frame};
use super::closing_content::Closing;
use super::content::{Content, Pair, Score};
use super::figure::{Section, listed};
use super::scores::{compare, median_ceiling, median_pair};
use super::{number, site};

/// How many rows FLARE-T wins, ties and loses, and how many cannot be compared.
#[derive(Debug, Default, PartialEq)]
struct Tally {
    better: usize,
    equal: usize,
    worse: usize,
    incomparable: usize,
}

impl Tally {
    fn of(scores: &[Score], pick: fn(&Score) -> Pair, higher_is_better: bool) -> Self {
        let mut tally = Self::default();
        for score in scores {
            match compare(pick(score), higher_is_better) {
                Some(Ordering::Less) => tally.better += 1,
                Some(Ordering::Equal) => tally.equal += 1,
                Some(Ordering::Greater) => tally.worse += 1,
                None => tally.incomparable += 1,
            }
        }
        tally
    }

    fn compared(&self) -> usize {
        self.better + self.equal + self.worse
    }
}

/// The section: always there, because notices and description stand in it.
pub(super) fn section(content: &Content) -> Option<Section> {
    let body = html! {
        @if let Some(closing) = &content.closing {
            div.first {
                div { (said(closing)) }
                @if let Some(picture) = site::picture(content) { div { (picture) } }
            }
        }
        @for notice in &content.notices { p.notice { strong { "Note. " } (notice) } }
        @for paragraph in &content.description { p { (paragraph) } }
        @if !content.scores.is_empty() { (verdict(&content.scores)) (tiles(&content.scores)) (scatter(&content.scores)) }
    };
    Some(Section { id: "summary", title: "Summary".into(), entries: Vec::new(), body })
}

/// A line whose parts between backticks are typed.
fn with_code(line: &str) -> Markup {
    html! { @for (i, part) in line.split('`').enumerate() { @if i % 2 == 1 { code { (part) } } @else { (part) } } }
}

/// The answer, as the run ended with it.
fn said(closing: &Closing) -> Markup {
    let lines = answer(closing);
    html! {
        @if let Some((first, others)) = lines.split_first() {
            p.verdict { (first) }
            ul.answer { @for line in others { li { (with_code(line)) } } }
        }
    }
}

/// One sentence on NRMSE, then where FLARE-T is worse.
fn verdict(scores: &[Score]) -> Markup {
    let tally = Tally::of(scores, |s| s.nrmse_percent, false);
    let medians = median_pair(scores, |s| s.nrmse_percent);
    let n = tally.compared();
    html! {
        p.verdict { (judgement(&tally, medians)) }
        @if let Some(ceiling) = median_ceiling(scores) {
            p { "A filter fitted to the training events, without a model, reaches a median NRMSE of " (number::fixed(ceiling, 1))
                " %: what is left there differs from event to event." }
        }
        @if tally.worse > 0 && tally.worse < n { p { "FE is closer to the record at " (listed(&worse(scores))) "." } }
        @if tally.incomparable > 0 {
            p { "Not comparable, because a model gave no finite prediction: " (tally.incomparable) " of " (scores.len()) "." }
        }
    }
}

fn judgement(tally: &Tally, medians: Pair) -> String {
    let n = tally.compared();
    let (Some(fe), Some(flare_t)) = (medians.fe, medians.flare_t) else {
        return "No held-out prediction can be compared: at least one model gave no finite answer anywhere.".into();
    };
    let errors = format!("median NRMSE {} % against {} % for FE", number::fixed(flare_t, 1), number::fixed(fe, 1));
    let share = format!("{} of {n} sensor records of held-out events", tally.better);
    if tally.better == n {
        format!(
            "FLARE-T is closer to the record than the finite-element model in all {n} sensor records of held-out events: {errors}."
        )
    } else if tally.better * 2 > n && flare_t < fe {
        format!("FLARE-T is closer to the record than the finite-element model in {share}: {errors}.")
    } else if flare_t < fe {
        format!("Mixed: FLARE-T has the lower median error ({errors}) but is closer to the record in only {share}.")
    } else if tally.better * 2 > n {
        format!("Mixed: FLARE-T is closer to the record in {share}, but its median error is not lower: {errors}.")
    } else {
        format!("FLARE-T does not improve on the finite-element model here: it is closer in {share}; {errors}.")
    }
}

fn worse(scores: &[Score]) -> Vec<String> {
    scores
        .iter()
        .filter(|s| compare(s.nrmse_percent, false) == Some(Ordering::Greater))
        .map(|s| format!("{} {} {}", s.event, s.component, s.sensor))
        .collect()
}

fn tiles(scores: &[Score]) -> Markup {
    let tile = |name: &str, pick: fn(&Score) -> Pair, digits: usize, unit: &str, higher: bool| {
        let (tally, pair) = (Tally::of(scores, pick, higher), median_pair(scores, pick));
        html! {
            div.tile {
                h3 { (name) }
                dl {
                    dt.fe { "FE" } dd { (number::optional(pair.fe, digits)) (unit) }
                    dt.flare { "FLARE-T" } dd { (number::optional(pair.flare_t, digits)) (unit) }
                }
                p.soft { "FLARE-T better in " (tally.better) " of " (tally.compared()) }
            }
        }
    };
    html! {
        div.tiles {
            (tile("Median NRMSE", |s| s.nrmse_percent, 1, " %", false))
            (tile("Median R²", |s| s.r2, 3, "", true))
            (tile("Median PSA error (ln)", |s| s.psa_ln_rmse, 3, "", false))
        }
    }
}

fn scatter(scores: &[Score]) -> Markup {
    const SHAPES: [MarkerShape; 5] = [
        MarkerShape::Circle,
        MarkerShape::Square,
        MarkerShape::Triangle,
        MarkerShape::Diamond,
        MarkerShape::TriangleDown,
    ];
    const SIGNS: [&str; 5] = ["●", "■", "▲", "◆", "▼"];
    let mut sensors: Vec<&str> = Vec::new();
    for score in scores {
        if !sensors.contains(&score.sensor.as_str()) {
            sensors.push(&score.sensor);
        }
    }
    let is_shown = |v: f64| v.is_finite() && v > 0.0;
    let point =
        |s: &Score| Some((s.nrmse_percent.fe?, s.nrmse_percent.flare_t?)).filter(|p| is_shown(p.0) && is_shown(p.1));
    // Every mark is where it is, on either side of the line: 2 and 80 % may share the axes.
    let all: Vec<f64> = scores.iter().filter_map(point).flat_map(|p| [p.0, p.1]).collect();
    let [low, top] =
        [all.iter().copied().fold(f64::INFINITY, f64::min) / 1.3, all.iter().copied().fold(0.0, f64::max) * 1.3];
    if all.is_empty() {
        return html! {};
    }
    let color = |i: usize| chart::SERIES[i % chart::SERIES.len()];
    let clouds: Vec<Dots> = sensors
        .iter()
        .enumerate()
        .map(|(i, sensor)| Dots {
            points: scores.iter().filter(|s| s.sensor == *sensor).filter_map(point).collect(),
            color: color(i),
            shape: SHAPES[i % SHAPES.len()],
        })
        .collect();
    let frame = Frame {
        size: (460.0, 400.0),
        x: Axis { label: "NRMSE of FE (%)", range: (low, top), log: true },
        y: Axis { label: "NRMSE of FLARE-T (%)", range: (low, top), log: true },
        alt: "NRMSE of FLARE-T over NRMSE of FE, one mark per event, component and sensor, with the line of equality"
            .into(),
    };
    let equal = Curve { points: vec![(low, low), (top, top)], color: "#5f6670", width: 1.0, dash: Some("4 3") };
    let caption = html! {
        "One mark for each event, component and sensor. Below the dashed line FLARE-T is closer to the record, above it FE."
        ul {
            @for (i, sensor) in sensors.iter().enumerate() {
                li { span.mark style={ "color:" (color(i)) } { (SIGNS[i % SIGNS.len()]) } " " (sensor) }
            }
        }
    };
    html! { figure.aside { div.picture { (chart::dots(&frame, &clouds, &[equal])) } figcaption { (caption) } } }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(fe: Option<f64>, flare_t: Option<f64>) -> Score {
        let pair = Pair { fe, flare_t };
        Score { nrmse_percent: pair, r2: pair, psa_ln_rmse: pair, sensor: "S".into(), ..Score::default() }
    }

    fn says(scores: &[Score]) -> String {
        let tally = Tally::of(scores, |s| s.nrmse_percent, false);
        judgement(&tally, median_pair(scores, |s| s.nrmse_percent))
    }

    #[test]
    fn the_verdict_follows_the_numbers_in_both_directions() {
        let won = [score(Some(80.0), Some(40.0)), score(Some(60.0), Some(50.0))];
        assert!(says(&won).starts_with("FLARE-T is closer") && says(&won).contains("all 2"), "{}", says(&won));
        let lost = [score(Some(40.0), Some(80.0)), score(Some(50.0), Some(60.0))];
        assert!(says(&lost).starts_with("FLARE-T does not improve"), "{}", says(&lost));
        let mixed = [score(Some(10.0), Some(12.0)), score(Some(20.0), Some(21.0)), score(Some(90.0), Some(15.0))];
        assert!(says(&mixed).starts_with("Mixed"), "{}", says(&mixed));
        assert!(says(&[score(Some(1.0), None)]).starts_with("No held-out prediction can be compared"));
    }

    #[test]
    fn a_higher_r2_wins_and_a_missing_value_is_not_counted() {
        let scores = [score(Some(0.5), Some(0.9)), score(None, Some(0.9)), score(Some(0.5), Some(f64::NAN))];
        let tally = Tally::of(&scores, |s| s.r2, true);
        assert_eq!(tally, Tally { better: 1, equal: 0, worse: 0, incomparable: 2 });
    }
}
