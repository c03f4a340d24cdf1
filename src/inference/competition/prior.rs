//! Which effects may be missing, and how probable each is before any data.

use super::proposals::{NODES, away};
use crate::effects::{self, Array, Instance};
use crate::inference::forward::Forward;
use std::collections::BTreeMap;

/// Prior probability of one effect more.
const ONE_MORE: f64 = 0.25;

/// Effects of the catalogue at every place of `array` where they have something to act on.
pub fn acting(array: &Array) -> Vec<Instance> {
    effects::instances(array).into_iter().filter(|i| acts(array, i)).collect()
}

/// Whether an effect has something to act on.
pub fn acts(array: &Array, instance: &Instance) -> bool {
    let zero = instance.zero();
    let at = zero.map_or_else(Vec::new, |zero| away(instance, &zero, NODES[0], 1.0).unwrap_or(instance.start()));
    instance.acts_on(&array.profile, &at)
}

/// ln of the prior of an effect at one of its places among `all` of them, by kind: kinds are as probable as each other, and so are the
/// places of each. Each number that an effect takes from a record is one more that is fitted to it.
///
/// Source: Schwarz (1978), doi 10.1214/aos/1176344136, for ½ ln n a fitted number.
pub fn ln_prior<'i>(forward: &Forward<'_>, all: impl Iterator<Item = &'i Instance>) -> BTreeMap<&'static str, f64> {
    let mut places: BTreeMap<&'static str, (f64, f64)> = BTreeMap::new();
    for instance in all {
        places.entry(instance.kind).or_insert((0.0, instance.hidden() as f64)).0 += 1.0;
    }
    let values = forward.records.iter().map(|at| 2.0 * forward.frequencies_hz(*at).len() as f64);
    let by_number: f64 = values.map(|n| 0.5 * n.ln()).sum();
    let kinds = places.len() as f64;
    places
        .into_iter()
        .map(|(kind, (n, hidden))| (kind, -(kinds * n).ln() - hidden * by_number + ONE_MORE.ln()))
        .collect()
}
