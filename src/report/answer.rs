//! The answer in a few lines: what a run ends with and what the report begins with.

use super::closing::{listed_effects, words};
use super::closing_content::{Closing, NamedEffect};
use super::number;
use super::phrase::phrase;

/// Predictions that the second line compares, by their names in [`Closing::models`].
const MODELS: [(&str, &str); 7] = [
    ("FE declared", "declared"),
    ("FE recalibrated", "recalibrated"),
    ("FE corrected", "corrected"),
    ("FLARE-T before", "FLARE-T before"),
    ("FLARE-T after", "after"),
    ("Noise floor", "noise floor"),
    ("Ceiling", "ceiling of a filter from other events"),
];

/// What is named and how sure, what remains, the errors of held-out events, and what to do next: a line each.
pub fn answer(closing: &Closing) -> Vec<String> {
    let mut lines = vec![headline(closing)];
    lines.extend(closing.rest.as_ref().map(|rest| rest.sentence.clone()));
    lines.extend(errors(closing));
    lines.extend(spectra(closing));
    lines.push(next(closing));
    lines
}

/// What is named.
fn headline(closing: &Closing) -> String {
    let (open, sure) = listed_effects(closing);
    let said = |effects: &[&NamedEffect]| effects.iter().map(|e| phrase(e)).collect::<Vec<_>>().join("; ");
    match closing.verdict.as_str() {
        "none" => "None: the records ask for nothing beyond the declared tolerances.".into(),
        "known" => format!("Known: {}.", said(&sure)),
        "ambiguous" => {
            let kinds: Vec<String> = closing.ambiguity.iter().map(|(kind, _)| words(kind)).collect();
            let known = if sure.is_empty() { String::new() } else { format!("Known: {}. ", said(&sure)) };
            let applied = if open.is_empty() { "none of them".into() } else { said(&open) };
            format!(
                "{known}Ambiguous: one of {}, which these records cannot tell apart; applied: {applied}.",
                kinds.join(", ")
            )
        }
        _ => "Unknown: the records hold structure that no named effect explains; nothing was corrected.".into(),
    }
}

fn errors(closing: &Closing) -> Option<String> {
    let of = |(key, name): &(&str, &str)| {
        let percent = closing.models.iter().find(|m| m.name == *key)?.median_percent?;
        Some(format!("{name} {} %", number::significant(percent)))
    };
    let all: Vec<String> = MODELS.iter().filter_map(of).collect();
    (!all.is_empty()).then(|| format!("NRMSE of held-out events, median: {}.", all.join(", ")))
}

fn spectra(closing: &Closing) -> Option<String> {
    let rows = &closing.field.as_ref()?.rows;
    let of = |(key, name): &(&str, &str)| {
        let psa = rows.iter().find(|row| row.model == *key)?.psa_rms?;
        Some(format!("{name} {}", number::fixed(psa, 2)))
    };
    let all: Vec<String> = MODELS.iter().filter_map(of).collect();
    (!all.is_empty()).then(|| format!("Response spectra of held-out events, RMS error of ln PSA: {}.", all.join(", ")))
}

fn next(closing: &Closing) -> String {
    let keys: Vec<&str> = closing.ambiguity.iter().map(|(_, key)| key.as_str()).filter(|key| !key.is_empty()).collect();
    match closing.verdict.as_str() {
        "none" => "Next: `flare-pipe power` says what these records could not have shown.".into(),
        "known" => "Next: look at the report; `site.corrected.toml` is the corrected site and runs by itself.".into(),
        "ambiguous" if !keys.is_empty() => format!("Next: what would tell them apart: {}.", keys.join("; ")),
        _ => "Next: look at what remains in the report, by frequency and sensor.".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::closing_content::{Interval, Model, Rest};
    use super::*;

    fn closing(verdict: &str) -> Closing {
        let interval = |value: f64, ci95| Interval { value, ci95, ..Interval::default() };
        let effect = |kind: &str, target: &str, name: &str, value| NamedEffect {
            kind: kind.into(),
            target: target.into(),
            phrases: vec!["Vs of {place} is {ln_factor|lower|higher}".into()],
            parameters: vec![(name.into(), value)],
            ..NamedEffect::default()
        };
        Closing {
            verdict: verdict.into(),
            effects: vec![
                effect("layer_velocity", "0.0–6.0 m", "ln_factor", interval(-0.0834, [-0.128, -0.0305])),
                effect("small_strain_damping", "", "multiplier", interval(2.0, [1.5, 2.5])),
            ],
            rest: Some(Rest { sentence: "What remains is noise.".into(), ..Rest::default() }),
            models: vec![Model { name: "FE declared".into(), median_percent: Some(51.23), ..Model::default() }],
            ..Closing::default()
        }
    }

    #[test]
    fn the_answer_says_what_is_known_and_how_well() {
        let lines = answer(&closing("known"));
        assert_eq!(
            lines[0],
            "Known: Vs of 0.0–6.0 m is 8.00 % lower [3.00, 12.0]; small strain damping multiplier 2.00 [1.50, 2.50]."
        );
        assert_eq!(lines[1], "What remains is noise.");
        assert!(lines[2].contains("declared 51.2 %"), "{}", lines[2]);
        assert!(lines[3].contains("site.corrected.toml"));
    }

    #[test]
    fn what_is_one_of_several_is_not_said_to_be_known() {
        let key = |kind: &str| (kind.to_string(), "damping at higher frequencies".to_string());
        let ambiguity = vec![key("small_strain_damping"), key("frequency_dependent_damping")];
        let none = answer(&Closing { ambiguity: ambiguity.clone(), effects: Vec::new(), ..closing("ambiguous") });
        assert!(none[0].starts_with("Ambiguous: one of") && none[0].ends_with("applied: none of them."), "{}", none[0]);
        let lines = answer(&Closing { ambiguity, ..closing("ambiguous") });
        assert!(lines[0].starts_with("Known: Vs of 0.0–6.0 m"), "{}", lines[0]);
        assert!(
            lines[0].contains("Ambiguous: one of small strain damping, frequency dependent damping"),
            "{}",
            lines[0]
        );
        assert!(lines.last().unwrap().contains("damping at higher frequencies"));
        assert!(answer(&closing("unknown"))[0].contains("nothing was corrected"));
    }
}
