//! The manifest as text: where each key stands, `--set` overrides, and problems rendered with file, line and caret.

use crate::error::{Error, Result};
use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};
use std::ops::Range;
use std::path::{Path, PathBuf};
use toml::de::{DeTable, DeValue};

/// One thing wrong with a manifest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// Dotted key with indices: `site.layer[3].vs_m_s`; the first is 1.
    pub key: String,
    /// What is wrong, with value, unit and admissible range.
    pub what: String,
    /// What to do about it.
    pub hint: Option<String>,
}

impl Problem {
    /// A problem at `key`.
    pub fn new(key: impl Into<String>, what: impl Into<String>) -> Self {
        Self { key: key.into(), what: what.into(), hint: None }
    }

    /// Adds what to do about it.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }
}

/// A parsed TOML text that knows where each key stands.
pub struct Document {
    path: PathBuf,
    text: String,
    table: toml::Table,
}

impl Document {
    /// Parses `text`.
    ///
    /// # Errors
    /// When it is no TOML; the error shows the place.
    pub fn parse(path: &Path, text: &str) -> Result<Self> {
        match toml::from_str::<toml::Table>(text) {
            Ok(table) => Ok(Self { path: path.to_path_buf(), text: text.to_string(), table }),
            Err(error) => {
                let document = Self { path: path.to_path_buf(), text: text.to_string(), table: toml::Table::new() };
                let rendered = document.render(error.message(), error.span(), None);
                Err(Error::new(error.message().to_string()).usage().rendered(without_level(&rendered)))
            }
        }
    }

    /// The values.
    pub fn table(&self) -> &toml::Table {
        &self.table
    }

    /// All `problems` as one usage error, in the order of the text.
    pub fn error(&self, mut problems: Vec<Problem>, overridden: &[String]) -> Error {
        let spanned = DeTable::parse(&self.text).ok();
        let is_overridden = |p: &Problem| overridden.iter().any(|key| is_within(&p.key, key));
        let span_of = |p: &Problem| {
            if is_overridden(p) {
                return None;
            }
            spanned.as_ref().and_then(|t| locate(t.get_ref(), &p.key))
        };
        problems.sort_by_key(|p| span_of(p).map_or(usize::MAX, |s| s.start));
        let mut seen = Vec::new();
        problems.retain(|p| {
            let is_new = !seen.contains(p);
            seen.push(p.clone());
            is_new
        });
        let mut blocks: Vec<String> = problems
            .iter()
            .map(|p| match span_of(p) {
                Some(span) => self.render(&p.what, Some(span), p.hint.as_deref()),
                None => {
                    let origin = if is_overridden(p) { "`--set`".into() } else { format!("`{}`", self.path.display()) };
                    let mut error = Error::new(&p.what).at(format!("`{}` of {origin}", p.key));
                    if let Some(hint) = &p.hint {
                        error = error.hint(hint);
                    }
                    format!("error: {error}")
                }
            })
            .collect();
        let count = problems.len();
        let plural = if count == 1 { "problem" } else { "problems" };
        blocks.push(format!("{count} {plural} in `{}`", self.path.display()));
        let text = blocks.join("\n\n");
        Error::new(format!("{count} {plural} in `{}`", self.path.display())).usage().rendered(without_level(&text))
    }

    fn render(&self, what: &str, span: Option<Range<usize>>, hint: Option<&str>) -> String {
        let span = span.unwrap_or(0..0);
        let path = self.path.display().to_string();
        let what = what.trim();
        let mut group = Level::ERROR
            .primary_title(what)
            .element(Snippet::source(&self.text).path(&path).fold(true).annotation(AnnotationKind::Primary.span(span)));
        if let Some(hint) = hint {
            group = group.element(Level::HELP.with_name("hint").message(hint));
        }
        Renderer::plain().render(&[group]).to_string()
    }
}

/// What comes behind the word `error:`, which is said where errors are shown.
fn without_level(rendered: &str) -> &str {
    rendered.strip_prefix("error: ").unwrap_or(rendered)
}

/// Whether `key` is `place` or stands in it.
fn is_within(key: &str, place: &str) -> bool {
    key.strip_prefix(place).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
}

/// Whether `table` says something at `key`.
pub fn is_said(table: &toml::Table, key: &str) -> bool {
    let mut steps = steps_of(key).into_iter();
    let Some(Step::Key(first)) = steps.next() else { return false };
    let value = steps.try_fold(table.get(&first), |value, step| match (step, value?) {
        (Step::Key(key), toml::Value::Table(table)) => Some(table.get(&key)),
        (Step::Index(i), toml::Value::Array(items)) => Some(i.checked_sub(1).and_then(|i| items.get(i))),
        _ => None,
    });
    value.flatten().is_some()
}

/// Sets one dotted `key=value` in `table`; the value is TOML where it parses as such, a string where it does not.
///
/// Returns the key. `layer[2].vs_m_s`-style indices are understood; the first is 1.
///
/// # Errors
/// When there is no `=` or the path runs through something that is no table.
pub fn apply_override(table: &mut toml::Table, assignment: &str) -> Result<String> {
    let Some((key, value)) = assignment.split_once('=') else {
        return Err(Error::new(format!("`--set {assignment}` has no `=`"))
            .hint("write `--set section.key=value`")
            .usage());
    };
    let (key, value) = (key.trim(), value.trim());
    let parsed = toml::from_str::<toml::Table>(&format!("v = {value}"))
        .ok()
        .and_then(|mut t| t.remove("v"))
        .unwrap_or_else(|| toml::Value::String(value.to_string()));
    let mut steps = steps_of(key).into_iter().peekable();
    let wrong = || {
        Error::new(format!("`--set {key}`: no such place in the manifest"))
            .hint("keys are dotted, and lists count from 1: `pretrain.latent`, `site.layer[1].vs_m_s`")
            .usage()
    };
    let mut place = match steps.next() {
        Some(Step::Key(first)) if steps.peek().is_none() => {
            table.insert(first, parsed);
            return Ok(key.to_string());
        }
        Some(Step::Key(first)) => table.entry(first).or_insert_with(|| toml::Value::Table(toml::Table::new())),
        _ => return Err(wrong()),
    };
    while let Some(step) = steps.next() {
        let last = steps.peek().is_none();
        place = match (step, place) {
            (Step::Key(k), toml::Value::Table(t)) if last => {
                t.insert(k, parsed);
                return Ok(key.to_string());
            }
            (Step::Key(k), toml::Value::Table(t)) => {
                t.entry(k).or_insert_with(|| toml::Value::Table(toml::Table::new()))
            }
            (Step::Index(i), toml::Value::Array(a)) => {
                let count = a.len();
                let beyond = || {
                    Error::new(format!("`--set {key}`: there are {count} of these, counted from 1, and no number {i}"))
                        .usage()
                };
                let slot = i.checked_sub(1).and_then(|i| a.get_mut(i)).ok_or_else(beyond)?;
                if last {
                    *slot = parsed;
                    return Ok(key.to_string());
                }
                slot
            }
            _ => return Err(wrong()),
        };
    }
    Err(wrong())
}

enum Step {
    Key(String),
    Index(usize),
}

fn steps_of(key: &str) -> Vec<Step> {
    let mut steps = Vec::new();
    for part in key.split('.') {
        let mut pieces = part.split('[');
        steps.push(Step::Key(pieces.next().unwrap_or_default().to_string()));
        steps.extend(pieces.filter_map(|p| p.trim_end_matches(']').parse().ok()).map(Step::Index));
    }
    steps
}

/// Byte range of the value at `key`, or of the deepest ancestor that exists.
fn locate(root: &DeTable<'_>, key: &str) -> Option<Range<usize>> {
    let mut found = None;
    let mut table = Some(root);
    let mut array: Option<&[toml::Spanned<DeValue<'_>>]> = None;
    for step in steps_of(key) {
        let (span, value) = match step {
            Step::Key(k) => {
                let Some((name, value)) = table.and_then(|t| t.iter().find(|(n, _)| n.get_ref().as_ref() == k)) else {
                    break;
                };
                let is_container = matches!(value.get_ref(), DeValue::Table(_) | DeValue::Array(_));
                (if is_container { name.span() } else { name.span().start..value.span().end }, value)
            }
            Step::Index(i) => {
                let Some(value) = i.checked_sub(1).and_then(|i| array?.get(i)) else { break };
                (value.span(), value)
            }
        };
        found = Some(span);
        (table, array) = match value.get_ref() {
            DeValue::Table(t) => (Some(t), None),
            DeValue::Array(a) => (None, Some(a.as_ref())),
            _ => (None, None),
        };
    }
    found
}
