//! Why two keys of the same stage differ, part by part: what `plan` tells.

use super::Parts;
use super::parameters::Leaves;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt;

impl Parts {
    /// What is other than in `previous`: kind and version, then parameters, inputs and files.
    pub fn changes_from(&self, previous: &Self) -> Vec<Change> {
        let mut changes = Vec::new();
        if self.kind != previous.kind {
            changes.push(Change::Kind { from: previous.kind.clone(), to: self.kind.clone() });
        } else if self.version != previous.version {
            changes.push(Change::Version { from: previous.version, to: self.version });
        }
        let names: BTreeSet<&String> = previous.parameters.keys().chain(self.parameters.keys()).collect();
        for name in names {
            let text = |leaves: &Leaves| leaves.get(name).map(ToString::to_string);
            let (from, to) = (text(&previous.parameters), text(&self.parameters));
            if from != to {
                changes.push(Change::Parameter { name: name.clone(), from, to });
            }
        }
        let roles: BTreeSet<&String> = previous.inputs.keys().chain(self.inputs.keys()).collect();
        for role in roles {
            match (previous.inputs.get(role), self.inputs.get(role)) {
                (Some(_), None) => changes.push(Change::InputGone { role: role.clone() }),
                (None, Some(_)) => changes.push(Change::InputNew { role: role.clone() }),
                (from, to) if from != to => changes.push(Change::Input { role: role.clone() }),
                _ => {}
            }
        }
        let hashes = |parts: &Self| parts.files.iter().map(|f| f.blake3.clone()).collect::<Vec<_>>();
        let (before, now) = (hashes(previous), hashes(self));
        if before != now {
            let names: Vec<String> =
                self.files.iter().filter(|f| !before.contains(&f.blake3)).map(|f| f.name.clone()).collect();
            changes.push(Change::Files { names, from: before.len(), to: now.len() });
        }
        changes
    }
}

/// One difference between two keys of the same stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "change", rename_all = "snake_case")]
pub enum Change {
    /// The stage is of another kind.
    Kind {
        /// Before.
        from: String,
        /// Now.
        to: String,
    },
    /// The stage gives other numbers than it used to.
    Version {
        /// Before.
        from: u32,
        /// Now.
        to: u32,
    },
    /// A manifest leaf; absent is `None`.
    Parameter {
        /// Dotted name.
        name: String,
        /// TOML text before.
        from: Option<String>,
        /// TOML text now.
        to: Option<String>,
    },
    /// An input has another key.
    Input {
        /// Role, or `role.instance`.
        role: String,
    },
    /// An input that was not there before.
    InputNew {
        /// Role, or `role.instance`.
        role: String,
    },
    /// An input that is not there any more.
    InputGone {
        /// Role, or `role.instance`.
        role: String,
    },
    /// Outside files have other content, or there are more or fewer of them.
    Files {
        /// Those with content not seen before.
        names: Vec<String>,
        /// How many before.
        from: usize,
        /// How many now.
        to: usize,
    },
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Kind { from, to } => write!(f, "stage kind `{from}` → `{to}`"),
            Self::Version { from, to } => write!(f, "stage version {from} → {to}"),
            Self::Parameter { name, from, to } => match (from.as_deref().map(brief), to.as_deref().map(brief)) {
                (Some(from), Some(to)) => write!(f, "`{name}`: {from} → {to}"),
                (None, to) => write!(f, "`{name}` is new: {}", to.unwrap_or_default()),
                (Some(from), None) => write!(f, "`{name}` is gone (was {from})"),
            },
            Self::Input { role } => write!(f, "input `{role}` changed"),
            Self::InputNew { role } => write!(f, "input `{role}` is new"),
            Self::InputGone { role } => write!(f, "input `{role}` is gone"),
            Self::Files { from, to, names } => {
                if from == to {
                    f.write_str("outside files changed")?;
                } else {
                    write!(f, "outside files: {from} → {to}")?;
                }
                match names.as_slice() {
                    [] => Ok(()),
                    [one] => write!(f, " (`{one}`)"),
                    [one, rest @ ..] => write!(f, " (`{one}` and {} more)", rest.len()),
                }
            }
        }
    }
}

/// The beginning of a long value.
fn brief(text: &str) -> String {
    const MOST: usize = 60;
    match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_string(),
    }
}
