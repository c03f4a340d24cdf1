//! Kinds of effects that are named: by the probability of each set of kinds, over all models that have it.

use super::NOTHING;
use crate::effects::Instance;
use std::collections::{BTreeMap, BTreeSet};

/// Least probability of a kind, over all models that have it, for it to be named.
const KNOWN: f64 = 0.9;

/// Probability of each set of kinds.
pub(super) type Masses = BTreeMap<Vec<&'static str>, f64>;

/// Kinds that are there with a probability of [`KNOWN`] by `mass`, that of each set of kinds; as often as is that probable.
///
/// Source: Barbieri & Berger (2004), doi 10.1214/009053604000000238, for models of what is probable by itself.
pub(super) fn known_kinds(mass: &Masses) -> Vec<&'static str> {
    let is_known = |kind: &str, n: usize| probability_of(mass, kind, n) >= KNOWN;
    all_kinds(mass).flat_map(|kind| (1..).take_while(move |n| is_known(kind, *n)).map(move |_| kind)).collect()
}

/// Kinds of all sets, each once.
fn all_kinds(mass: &Masses) -> impl Iterator<Item = &'static str> {
    mass.keys().flatten().copied().collect::<BTreeSet<_>>().into_iter()
}

/// Probability that an effect of `kind` is there at least `n` times.
fn probability_of(mass: &Masses, kind: &str, n: usize) -> f64 {
    let count = |set: &[&str]| set.iter().filter(|k| **k == kind).count();
    mass.iter().filter(|(set, _)| count(set) >= n).map(|(_, p)| p).sum()
}

/// Whether `kinds` hold all of `wanted`, each as often.
pub(super) fn has_all(kinds: &[&'static str], wanted: &[&'static str]) -> bool {
    let mut open = wanted.to_vec();
    kinds.iter().for_each(|kind| _ = is_taken(&mut open, kind));
    open.is_empty()
}

/// Kinds that may be what is there besides the `known` ones, where something is.
pub(super) fn alternatives(mass: &Masses, known: &[&'static str]) -> Vec<String> {
    let mut all = BTreeSet::new();
    for (set, _) in mass.iter().filter(|(_, p)| **p > NOTHING) {
        let mut own = known.to_vec();
        all.extend(set.iter().filter(|kind| !is_taken(&mut own, kind)).map(ToString::to_string));
    }
    all.into_iter().collect()
}

/// Kinds that may be there besides the `known` ones, and may not, in a sentence.
pub(super) fn besides(mass: &Masses, known: &[&'static str]) -> Option<String> {
    let open = |kind: &'static str| {
        let n = 1 + known.iter().filter(|k| **k == kind).count();
        let probability = probability_of(mass, kind, n);
        (probability > NOTHING).then(|| format!("{} ({probability:.2})", kind.replace('_', " ")))
    };
    let named: Vec<String> = all_kinds(mass).filter_map(open).collect();
    (!named.is_empty())
        .then(|| format!("Besides, and not named because not probable enough (probability): {}.", named.join(", ")))
}

/// Kinds of the named ones of `effects`.
pub(super) fn kinds(effects: &[Instance]) -> Vec<&'static str> {
    let mut kinds: Vec<&'static str> = effects.iter().filter(|e| e.is_named()).map(|e| e.kind).collect();
    kinds.sort_unstable();
    kinds
}

/// Some `kinds`, each at most as often as `most` has it.
pub(super) fn limited(kinds: Vec<&'static str>, most: &BTreeMap<&'static str, usize>) -> Vec<&'static str> {
    let mut named: Vec<&'static str> = Vec::new();
    for kind in kinds {
        let n = named.iter().filter(|known| **known == kind).count();
        named.extend(most.get(kind).is_none_or(|most| n < *most).then_some(kind));
    }
    named
}

/// Whether `kind` is among `wanted`, from which it is taken.
pub(super) fn is_taken(wanted: &mut Vec<&'static str>, kind: &str) -> bool {
    let at = wanted.iter().position(|known| *known == kind);
    at.map(|at| wanted.remove(at)).is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_are_named_no_more_often_than_they_may_be() {
        let most = BTreeMap::from([("a", 1), ("b", 0)]);
        assert_eq!(limited(vec!["a", "a", "b", "c", "c"], &most), ["a", "c", "c"]);
    }

    #[test]
    fn known_is_what_is_probable_whatever_is_beside_it() {
        let mass = |sets: &[(&[&'static str], f64)]| sets.iter().map(|(set, p)| (set.to_vec(), *p)).collect();
        let open: BTreeMap<_, _> = mass(&[(&["a"], 0.05), (&["a", "b"], 0.5), (&["a", "c"], 0.45)]);
        assert_eq!(known_kinds(&open), ["a"]);
        let sentence = besides(&open, &["a"]).unwrap();
        assert!(sentence.contains("b (0.50), c (0.45)"), "{sentence}");
        assert!(besides(&mass(&[(&["a"], 0.97), (&["a", "b"], 0.03)]), &["a"]).is_none());
        assert_eq!(known_kinds(&mass(&[(&["a"], 0.04), (&["a", "a"], 0.96)])), ["a", "a"]);
        assert_eq!(known_kinds(&mass(&[(&["a", "a"], 0.5), (&["a", "b"], 0.5)])), ["a"]);
        assert!(known_kinds(&mass(&[(&["a"], 0.6), (&["b"], 0.4)])).is_empty());
        assert_eq!(alternatives(&mass(&[(&["a", "b"], 0.5), (&["a", "c"], 0.47), (&["a"], 0.03)]), &["a"]), ["b", "c"]);
        assert!(has_all(&["a", "b", "a"], &["a", "a"]) && !has_all(&["a", "b"], &["a", "a"]));
    }
}
