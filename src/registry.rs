//! One way to extend the program: laws, effects, record formats and stages are entries of a static table.
//!
//! Adding one is a file and one line of registration beside its `mod` line; forgetting the line leaves an unused
//! constant, which the build refuses.

use crate::error::{Error, Result};
use serde::de::DeserializeOwned;

/// A named, buildable extension.
pub struct Entry<T: ?Sized + 'static> {
    /// Name as typed in manifests and printed by `flare-pipe list`.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// Builds the extension from its table; unknown keys are refused.
    pub build: fn(toml::Table) -> Result<Box<T>>,
    /// JSON Schema of that table.
    pub schema: fn() -> schemars::Schema,
}

/// What has a name by which it is looked up.
pub trait Named {
    /// The name.
    fn name(&self) -> &'static str;
}

impl<T: ?Sized> Named for Entry<T> {
    fn name(&self) -> &'static str {
        self.name
    }
}

/// Deserialises a table into typed parameters (use `deny_unknown_fields` on `P`).
///
/// # Errors
/// When a key is unknown, missing or of the wrong type.
pub fn params<P: DeserializeOwned>(table: toml::Table) -> Result<P> {
    P::deserialize(table).map_err(|e: toml::de::Error| {
        let message = e.message().trim();
        // What was typed and what could have been stand between backticks.
        let mut names = message.split('`').skip(1).step_by(2);
        match (message.starts_with("unknown field"), names.next()) {
            (true, Some(typed)) => {
                Error::new(format!("unknown key `{typed}`")).hint(known(&names.collect::<Vec<_>>(), typed))
            }
            _ => Error::new(message.to_string()),
        }
        .usage()
    })
}

/// Looks `name` up in `entries`.
///
/// # Errors
/// When there is no such entry; the hint lists the known names and the nearest one.
pub fn find<'a, E: Named>(what: &str, entries: &'a [E], name: &str) -> Result<&'a E> {
    entries.iter().find(|e| e.name() == name).ok_or_else(|| {
        let names: Vec<&str> = entries.iter().map(E::name).collect();
        Error::new(format!("unknown {what} `{name}`")).hint(known(&names, name)).usage()
    })
}

/// "known: `a`, `b` (nearest: `a`)" for hints.
pub fn known(names: &[&str], typed: &str) -> String {
    if names.is_empty() {
        return "there is nothing to say here".into();
    }
    let list = names.iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
    match nearest(names, typed) {
        Some(name) => format!("known: {list} (nearest: `{name}`)"),
        None => format!("known: {list}"),
    }
}

/// The name within edit distance 3 (and less than its own length) of what was typed.
pub fn nearest<'a>(names: &[&'a str], typed: &str) -> Option<&'a str> {
    names
        .iter()
        .map(|n| (edit_distance(n, typed), *n))
        .filter(|(d, n)| *d <= 3 && *d < n.chars().count())
        .min_by_key(|(d, _)| *d)
        .map(|(_, n)| n)
}

fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_name_is_found_and_far_ones_are_not() {
        assert_eq!(nearest(&["elastic", "hyperbolic"], "hyperbollic"), Some("hyperbolic"));
        assert_eq!(nearest(&["elastic", "hyperbolic"], "sanisand"), None);
        assert_eq!(edit_distance("kitten", "sitting"), 3);
    }
}
