//! Closing the loop: what the model lacked, what correcting it was worth, and what remains.

use maud::{Markup, html};

use crate::metrics::PairedDifference;

use super::chart::{self, Axis, Column, Frame};
use super::closing_content::{Candidate, Change, Closing, ErrorRow, Interval, Model, NamedEffect};
use super::content::Content;
use super::figure::{Section, figure};
use super::{closing_field, closing_rest, number};

/// Colours of the six predictions and the ceiling, in order.
const COLORS: [&str; 7] = ["#e8a56b", "#e07b2a", chart::FE, "#7fb3d5", chart::FLARE_T, "#8a8f98", "#5f6670"];
/// Their names below a box.
const SHORT: [&str; 7] = ["declared", "recalibrated", "corrected", "before", "after", "floor", "ceiling"];

/// The section, if a loop was closed.
pub(super) fn section(content: &Content) -> Option<Section> {
    let closing = content.closing.as_ref()?;
    let body = html! {
        @for note in &closing.notes { p { (note) } }
        @if !closing.effects.is_empty() { (effects(&closing.effects)) }
        @if closing.ambiguity.len() > 1 { (ambiguity(closing)) }
        @if !closing.errors.is_empty() { h3 id="loop-errors" { "Errors before and after" } (errors(closing)) }
        @if !closing.candidates.is_empty() { h3 id="loop-candidates" { "What was tried" } (candidates(&closing.candidates)) }
        (closing_rest::rest(closing))
    };
    let entries = [
        ("loop-errors", "Errors before and after", !closing.errors.is_empty()),
        ("loop-candidates", "What was tried", !closing.candidates.is_empty()),
        ("loop-rest", "What remains", closing_rest::is_any(closing)),
    ];
    let entries = entries.iter().filter(|e| e.2).map(|e| (e.0.to_string(), e.1.to_string())).collect();
    Some(Section { id: "loop", title: "Closing the loop".into(), entries, body })
}

/// Named effects of which there may be others instead, and those that are sure.
pub(super) fn listed_effects(closing: &Closing) -> (Vec<&NamedEffect>, Vec<&NamedEffect>) {
    closing.effects.iter().partition(|e| closing.ambiguity.iter().any(|(kind, _)| *kind == e.kind))
}

/// `small_strain_damping` as words.
pub(super) fn words(kind: &str) -> String {
    kind.replace('_', " ")
}

/// A value with its interval: `2.41 [2.2, 2.6] Hz`.
pub(super) fn interval(interval: &Interval) -> String {
    let [low, high] = interval.ci95.map(number::significant);
    let unit = if interval.unit.is_empty() { String::new() } else { format!(" {}", interval.unit) };
    format!("{} [{low}, {high}]{unit}", number::significant(interval.value))
}

fn effects(effects: &[NamedEffect]) -> Markup {
    html! {
        div.scroll { table {
            caption { "The effects of the corrected manifest, with 95 % intervals, in brackets the value were every prior half and twice as wide, and how often chance would bring as much to the model without them." }
            thead { tr { th scope="col" { "Effect" } th scope="col" { "Where" } th scope="col" { "Acts on" } th scope="col" { "Parameters" } } }
            tbody { @for effect in effects {
                tr {
                    td { b { (words(&effect.kind)) } @if !effect.about.is_empty() { br; span.soft { (effect.about) } } }
                    td { @if effect.target.is_empty() { "whole column" } @else { (effect.target) } }
                    td { (effect.class) }
                    td { @for (i, (name, value)) in effect.parameters.iter().enumerate() {
                        @if i > 0 { br; } code { (name) } " " (interval(value))
                        @if let Some([half, twice]) = value.by_prior { " " span.soft { "(" (number::significant(half)) ", " (number::significant(twice)) ")" } }
                    } @if let Some(p) = effect.p_value { br; span.soft { "p = " (number::significant(p)) } } }
                }
            } }
        } }
    }
}

fn ambiguity(closing: &Closing) -> Markup {
    html! {
        p { "These kinds explain the records about equally well. What would tell them apart:" }
        ul { @for (kind, key) in &closing.ambiguity { li { b { (words(kind)) } @if !key.is_empty() { ": " (key) } } } }
    }
}

fn errors(closing: &Closing) -> Markup {
    let held_out: Vec<&ErrorRow> = closing.errors.iter().filter(|r| r.is_held_out).collect();
    html! {
        @if !held_out.is_empty() { (boxes(closing, &held_out)) }
        @if !closing.changes.is_empty() { (changes(closing)) }
        (closing_field::field(closing))
        (table(closing, &held_out, "held-out events"))
        @let others: Vec<&ErrorRow> = closing.errors.iter().filter(|r| !r.is_held_out).collect();
        @if !others.is_empty() {
            details { summary { "Events that were used for calibration, diagnosis or selection" } (table(closing, &others, "events that were used")) }
        }
    }
}

/// Indices of the models that have an error in one of the `rows`.
fn shown(closing: &Closing, rows: &[&ErrorRow]) -> Vec<usize> {
    (0..closing.models.len()).filter(|i| rows.iter().any(|row| error(row, *i).is_some())).collect()
}

/// Error of a model, %.
fn error(row: &ErrorRow, model: usize) -> Option<f64> {
    row.nrmse_percent.get(model).copied().flatten()
}

fn boxes(closing: &Closing, rows: &[&ErrorRow]) -> Markup {
    let shown = shown(closing, rows);
    let errors = |i: &usize| rows.iter().filter_map(|row| error(row, *i)).collect::<Vec<f64>>();
    let values: Vec<Vec<f64>> = shown.iter().map(errors).collect();
    let names: Vec<&str> = shown.iter().map(|i| closing.models[*i].name.as_str()).collect();
    let columns: Vec<Column> =
        values.iter().zip(&shown).map(|(values, i)| Column { label: SHORT[*i], values, color: COLORS[*i] }).collect();
    let frame = Frame {
        size: (760.0, 320.0),
        x: Axis { label: &names.join(" · "), range: (0.0, shown.len() as f64 + 1.0), log: false },
        y: Axis { label: "NRMSE (%)", range: chart::box_range(values.iter().map(Vec::as_slice), 0.0), log: false },
        alt: format!("NRMSE over held-out events: {}", names.join(", ")),
    };
    let caption = html! {
        "NRMSE at every sensor of the held-out events. The credit of an effect is the step from recalibrated to corrected, not "
        "from declared: the first step repairs values that were merely inaccurate. The noise floor is what sensor noise leaves to "
        "the right model; the ceiling is what filters fitted to training events reach, which no model that is the same in all events is "
        "likely to beat by much. All errors compare with the records as measured: where a sensor is at fault, part of the error before was "
        "measurement error."
    };
    figure(&chart::boxes(&frame, &columns, None, 0.6, None), &caption)
}

fn changes(closing: &Closing) -> Markup {
    html! {
        ul {
            @for change in &closing.changes { (claim(change)) }
            @if let Some(ablation) = closing.ablation_percent {
                li { "Simulations as declared, calibration alone on the corrected site: median " (number::fixed(ablation, 1)) " %" }
            }
        }
        p.soft { "Mean of paired differences, an event counting once, with its 95 % interval after Student and the exact sign test; “improved” only where the whole interval lies below zero, measure by measure, and never from fewer than three events. Measures beside waveforms, amplitudes and response spectra are listed where they differ for sure." }
    }
}

/// What a difference allows to say.
pub(super) fn claim(change: &Change) -> Markup {
    let name = |key: &str| match key {
        "fe" => "FE".to_string(),
        "fe_generic" => "FE with factors".to_string(),
        "flare_t" => "FLARE-T".to_string(),
        "flare_t_generic" => "FLARE-T with more terms".to_string(),
        other => other.replace("flare_", "FLARE-T "),
    };
    let measure = change.measure;
    let interval = change.ci95.map_or(String::new(), |ends| {
        let [low, high] = ends.map(|v| measure.written(v));
        format!(" [{low}, {high}]")
    });
    let numbers = format!(
        "{} {}{}{interval}, {} events, sign test p = {}",
        measure.name(),
        measure.written(change.mean),
        measure.unit(),
        change.n_event,
        number::fixed(change.sign_test_p, 2)
    );
    let is_enough = change.n_event >= PairedDifference::FEWEST;
    let is_worse = PairedDifference::is_above_zero(change.ci95, change.n_event);
    html! {
        li {
            (name(&change.from)) " → " (name(&change.to)) ": " (numbers) " – "
            @if change.is_improved { b { "improved" } } @else if is_worse { b { "worse" } } @else if is_enough { "no improvement can be claimed" }
            @else { "too few events for any claim" }
        }
    }
}

fn table(closing: &Closing, rows: &[&ErrorRow], what: &str) -> Markup {
    let shown = shown(closing, rows);
    let models: Vec<&Model> = shown.iter().map(|i| &closing.models[*i]).collect();
    html! {
        div.scroll { table.scores {
            caption { "NRMSE (%) on " (what) "." }
            thead { tr { th scope="col" { "Event" } th scope="col" { "Component" } th scope="col" { "Sensor" } @for model in &models { th.n scope="col" { (model.name) } } } }
            tbody { @for (i, row) in rows.iter().enumerate() {
                tr.new[i > 0 && rows[i - 1].event != row.event] {
                    td { (row.event) } td { (row.component) } td { (row.sensor) }
                    @for i in &shown { td.n { (number::optional(error(row, *i), 1)) } }
                }
            } }
            @if rows.first().is_some_and(|r| r.is_held_out) {
                tfoot {
                    tr { th colspan="3" { "Median" } @for model in &models { td.n { (number::optional(model.median_percent, 1)) } } }
                    tr { th colspan="3" { "Mean over events [95 %]" } @for model in &models { td.n {
                        (number::optional(model.mean_percent, 1))
                        @if let Some([low, high]) = model.ci95_percent { br; span.soft { "[" (number::fixed(low, 1)) ", " (number::fixed(high, 1)) "]" } }
                    } } }
                }
            }
        } }
    }
}

fn candidates(candidates: &[Candidate]) -> Markup {
    const SHOWN: usize = 12;
    html! {
        div.scroll { table {
            caption {
                "Models fitted with the nonlinear column. ln odds: against what is declared, priors included."
                @if candidates.len() > SHOWN { " The best " (SHOWN) " of " (candidates.len()) "." }
            }
            thead { tr { th scope="col" { "Effect" } th scope="col" { "Where" } th scope="col" { "Acts on" } th.n scope="col" { "Effects" } th.n scope="col" { "ln odds" } th.n scope="col" { "Fall of the cost on validation" } th.n scope="col" { "Explains" } } }
            tbody { @for c in candidates.iter().take(SHOWN) {
                tr {
                    td { (words(&c.kind)) } td { (c.target) } td { (c.class) } td.n { (c.round) }
                    td.n { (number::fixed(c.gain, 0)) } td.n { (number::fixed(c.validation_gain, 0)) }
                    td.n { (number::fixed(100.0 * c.explained_share, 0)) " %" }
                }
            } }
        } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_carry_their_unit_once() {
        let hertz = Interval { value: 2.4123, unit: "Hz".into(), ci95: [2.2, 2.61], by_prior: None };
        assert_eq!(interval(&hertz), "2.41 [2.20, 2.61] Hz");
    }
}
