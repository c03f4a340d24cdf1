//! What is said of an effect that was found: `Vs of 0–6 m is 8 % lower [3, 12]`.

use super::closing::{interval, words};
use super::closing_content::{Interval, NamedEffect};
use super::number;

/// Ends of names of parameters that say the unit, which stands behind the value for people.
const UNITS: [&str; 6] = ["_m_s2", "_kpa", "_deg", "_hz", "_m", "_s"];

/// An effect in words: the first of its phrases whose parameters it has, or kind, place and parameters where none fits.
pub(super) fn phrase(effect: &NamedEffect) -> String {
    let filled = effect.phrases.iter().find_map(|phrase| filled(phrase, effect));
    filled.unwrap_or_else(|| {
        let place = if effect.target.is_empty() { String::new() } else { format!(" ({})", effect.target) };
        let of = |(name, value): &(String, Interval)| {
            let unit = UNITS.iter().find_map(|unit| name.strip_suffix(unit)).filter(|_| !value.unit.is_empty());
            format!("{} {}", words(unit.unwrap_or(name)), interval(value))
        };
        let values: Vec<String> = effect.parameters.iter().map(of).collect();
        format!("{}{place} {}", words(&effect.kind), values.join(", ")).trim_end().to_string()
    })
}

/// `phrase` with place and parameters of `effect`; `None` where it lacks one.
fn filled(phrase: &str, effect: &NamedEffect) -> Option<String> {
    let mut text = String::new();
    for (i, part) in phrase.split(['{', '}']).enumerate() {
        if i % 2 == 0 {
            text.push_str(part);
            continue;
        }
        let mut words = part.split('|');
        let name = words.next()?;
        if name == "place" {
            text.push_str(if effect.target.is_empty() { "the whole column" } else { &effect.target });
            continue;
        }
        let (_, value) = effect.parameters.iter().find(|(own, _)| own == name)?;
        text.push_str(&match (words.next(), words.next()) {
            (Some(less), Some(more)) => by_sign(name, value, [less, more]),
            _ => valued(value),
        });
    }
    Some(text)
}

/// A value with its unit, and its interval: `2.42 Hz [1.92, 3.34]`.
fn valued(value: &Interval) -> String {
    let [low, high] = value.ci95.map(number::significant);
    format!("{} [{low}, {high}]", with_unit(value.value, &value.unit))
}

/// The size of a value, the word for its sign, and the interval of what the word says: ln of a factor as a change in percent.
fn by_sign(name: &str, value: &Interval, [less, more]: [&str; 2]) -> String {
    let is_factor = name.starts_with("ln_") && value.unit.is_empty();
    let change = |v: f64| if is_factor { 100.0 * v.exp_m1() } else { v };
    let unit = if is_factor { "%" } else { &value.unit };
    let is_less = value.value < 0.0;
    let sign = if is_less { -1.0 } else { 1.0 };
    let [a, b] = value.ci95.map(|end| sign * change(end));
    let [low, high] = [a.min(b), a.max(b)].map(number::significant);
    let word = if is_less { less } else { more };
    format!("{} {word} [{low}, {high}]", with_unit(sign * change(value.value), unit))
}

fn with_unit(value: f64, unit: &str) -> String {
    format!("{} {unit}", number::significant(value)).trim_end().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{EFFECTS, Instance};
    use crate::manifest::Manifest;

    fn value(value: f64, ci95: [f64; 2], unit: &str) -> Interval {
        Interval { value, ci95, unit: unit.into(), by_prior: None }
    }

    fn effect(kind: &str, target: &str, parameters: &[(&str, Interval)]) -> NamedEffect {
        let entry = EFFECTS.iter().find(|entry| entry.name == kind).unwrap();
        NamedEffect {
            kind: kind.into(),
            target: target.into(),
            phrases: entry.phrases.iter().map(|p| (*p).into()).collect(),
            parameters: parameters.iter().map(|(name, value)| ((*name).into(), value.clone())).collect(),
            ..NamedEffect::default()
        }
    }

    #[test]
    fn effects_are_said_in_the_words_of_the_field() {
        let said = |kind, target, name, value| phrase(&effect(kind, target, &[(name, value)]));
        let velocity = value(-0.0834, [-0.128, -0.0305], "");
        assert_eq!(
            said("layer_velocity", "0.0–6.0 m", "ln_factor", velocity),
            "Vs of 0.0–6.0 m is 8.00 % lower [3.00, 12.0]"
        );
        let faster = value(0.1, [-0.02, 0.2], "");
        assert_eq!(
            said("layer_velocity", "", "ln_factor", faster),
            "Vs of the whole column is 10.5 % higher [−1.98, 22.1]"
        );
        let late = value(0.025, [0.024, 0.026], "s");
        assert_eq!(
            said("clock_offset", "surface", "offset_s", late),
            "the clock of surface is 0.0250 s late [0.0240, 0.0260]"
        );
        let corner = value(2.42, [1.92, 3.34], "Hz");
        assert_eq!(
            said("downgoing_wave", "", "corner_hz", corner),
            "the down-going wave at the input sensor loses coherence above 2.42 Hz [1.92, 3.34]"
        );
        let other = value(1.0, [0.5, 2.0], "");
        assert_eq!(
            said("layer_velocity", "0.0–6.0 m", "factor", other),
            "layer velocity (0.0–6.0 m) factor 1.00 [0.500, 2.00]"
        );
    }

    /// Every form of every effect at an array of its kind has a phrase with all that is estimated of its strength.
    #[test]
    fn every_form_of_every_effect_has_a_phrase() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
        for site in ["lotung.toml", "fksh11.toml"] {
            let manifest = Manifest::load(&root.join(site), &[]).unwrap();
            let array = manifest.site.column().array(&["NS".into(), "EW".into()]).unwrap();
            for instance in EFFECTS.iter().flat_map(|entry| (entry.catalogue.instances)(&array)) {
                let parameters: Vec<(&str, Interval)> = instance
                    .free
                    .iter()
                    .map(|f| (f.parameter.name, value(1.0, [0.5, 2.0], f.parameter.unit)))
                    .collect();
                let said = effect(instance.kind, &instance.place(), &parameters);
                let found = said.phrases.iter().find_map(|p| filled(p, &said));
                let names = |i: &Instance| i.free.iter().map(|f| f.parameter.name).collect::<Vec<_>>().join(", ");
                assert!(found.is_some(), "no phrase of {} has {}", instance.kind, names(&instance));
            }
        }
    }
}
