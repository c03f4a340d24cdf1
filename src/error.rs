//! The one error type of the program: what is wrong, where, why, and what to do about it.
//!
//! Messages flow in lower case without a final period, put backticks round what the user typed, and name the offending
//! value, its unit and the admissible range. Places are listed innermost first. Rendered once, in `main`.

use serde::ser::{Serialize, SerializeStruct, Serializer};
use std::fmt;

/// Result with the program's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What is wrong, where (innermost place first), the underlying cause, and a one-line hint that is an action.
#[derive(Debug)]
pub struct Error {
    what: String,
    at: Vec<String>,
    cause: Option<Box<dyn std::error::Error + Send + Sync>>,
    hint: Option<String>,
    is_usage: bool,
    is_of_model: bool,
    rendered: Option<String>,
    is_told: bool,
}

impl Error {
    /// An error that says `what` is wrong, value and admissible range included.
    pub fn new(what: impl Into<String>) -> Self {
        Self {
            what: what.into(),
            at: Vec::new(),
            cause: None,
            hint: None,
            is_usage: false,
            is_of_model: false,
            rendered: None,
            is_told: false,
        }
    }

    /// Adds a place around those already named: "layer 3 of `configs/site.toml`".
    #[must_use]
    pub fn at(mut self, place: impl Into<String>) -> Self {
        self.at.push(place.into());
        self
    }

    /// Adds the action that mends it.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Adds the error underneath.
    #[must_use]
    pub fn cause(mut self, cause: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        self.cause = Some(cause.into());
        self
    }

    /// Marks a mistake in the manifest or on the command line (exit status 2 instead of 1).
    #[must_use]
    pub fn usage(mut self) -> Self {
        self.is_usage = true;
        self
    }

    /// Marks an outcome of the model itself, such as equations without a solution: it is the same on every machine and at every time,
    /// so that an ensemble records it as what became of an item. Whatever else goes wrong is of the machine or a defect.
    #[must_use]
    pub fn of_model(mut self) -> Self {
        self.is_of_model = true;
        self
    }

    /// Whether the model itself has no result.
    pub fn is_of_model(&self) -> bool {
        self.is_of_model
    }

    /// Replaces the rendering by a prepared text (manifest problems with carets, several at once).
    #[must_use]
    pub fn rendered(mut self, text: impl Into<String>) -> Self {
        self.rendered = Some(text.into());
        self
    }

    /// Nothing where there are no `errors`, that one where there is one, and otherwise all of them in one.
    ///
    /// # Errors
    /// When there are some.
    pub fn all(mut errors: Vec<Self>) -> Result<()> {
        if errors.len() < 2 {
            return errors.pop().map_or(Ok(()), Err);
        }
        let summary = format!("{} problems", errors.len());
        let is_one = |a: &Self, b: &Self| a.rendered.is_none() && a.what == b.what && a.hint == b.hint;
        let mut texts: Vec<String> = Vec::new();
        for (i, error) in errors.iter().enumerate() {
            if errors[..i].iter().any(|known| is_one(known, error)) {
                continue;
            }
            let others = errors[i + 1..].iter().filter(|other| is_one(error, other));
            let places: Vec<&str> = others.filter_map(|other| other.at.first().map(String::as_str)).collect();
            let places = if places.is_empty() { String::new() } else { format!("\n\nand in {}", places.join(", ")) };
            texts.push(format!("{error}{places}"));
        }
        let all = Self::new(summary.clone()).rendered(format!("{}\n\n{summary}", texts.join("\n\nerror: ")));
        Err(Self { is_usage: errors.iter().all(|e| e.is_usage), ..all })
    }

    /// The same, known to whoever asked: nothing is said of it again.
    #[must_use]
    pub fn told(mut self) -> Self {
        self.is_told = true;
        self
    }

    /// Whether it was said already.
    pub fn is_told(&self) -> bool {
        self.is_told
    }

    /// What is wrong, without place, cause and hint.
    pub fn what(&self) -> &str {
        &self.what
    }

    /// The hint, if there is one.
    pub fn hint_text(&self) -> Option<&str> {
        self.hint.as_deref()
    }

    /// Exit status of the process: 2 for usage or manifest, 1 for everything else.
    pub fn exit_status(&self) -> u8 {
        if self.is_usage { 2 } else { 1 }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(text) = &self.rendered {
            return f.write_str(text);
        }
        f.write_str(&self.what)?;
        for place in &self.at {
            write!(f, "\n  in {place}")?;
        }
        let mut cause = self.cause.as_deref().map(|c| c as &dyn std::error::Error);
        while let Some(error) = cause {
            write!(f, "\n  because {error}")?;
            cause = error.source();
        }
        if let Some(hint) = &self.hint {
            write!(f, "\n\nhint: {hint}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Error {}

/// `what`, places (innermost first), causes (outermost first), `hint`, exit status, and the text that people read.
impl Serialize for Error {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let first = self.cause.as_deref().map(|c| c as &dyn std::error::Error);
        let causes: Vec<String> = std::iter::successors(first, |e| e.source()).map(ToString::to_string).collect();
        let mut fields = serializer.serialize_struct("Error", 6)?;
        fields.serialize_field("what", &self.what)?;
        fields.serialize_field("at", &self.at)?;
        fields.serialize_field("causes", &causes)?;
        fields.serialize_field("hint", &self.hint)?;
        fields.serialize_field("exit_status", &self.exit_status())?;
        fields.serialize_field("text", &self.to_string())?;
        fields.end()
    }
}

/// Turns a foreign error into ours with a sentence of context: `fs::read(p).context(|| format!("cannot read `{p}`"))`.
pub trait Context<T> {
    /// Wraps the error with what was being attempted.
    fn context(self, what: impl FnOnce() -> String) -> Result<T>;
}

impl<T, E: Into<Box<dyn std::error::Error + Send + Sync>>> Context<T> for std::result::Result<T, E> {
    fn context(self, what: impl FnOnce() -> String) -> Result<T> {
        self.map_err(|e| Error::new(what()).cause(e))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_problems_are_told_at_once() {
        assert!(Error::all(Vec::new()).is_ok());
        assert_eq!(Error::all(vec![Error::new("one")]).unwrap_err().to_string(), "one");
        let alike = |place: &str| Error::new("no unit").at(place);
        let three = Error::all(vec![alike("a"), Error::new("else"), alike("b")]).unwrap_err().to_string();
        assert_eq!(three, "no unit\n  in a\n\nand in b\n\nerror: else\n\n3 problems");
        let two = Error::all(vec![Error::new("one").hint("do"), Error::new("two").usage()]).unwrap_err();
        assert_eq!(two.to_string(), "one\n\nhint: do\n\nerror: two\n\n2 problems");
        assert_eq!(two.exit_status(), 1);
    }

    #[test]
    fn renders_places_cause_and_hint_in_order() {
        let error = Error::new("`vs_m_s` must be in 50…5000 m/s, got -240")
            .at("layer 3 of `site.toml`")
            .at("stage `simulate`")
            .cause("disk full")
            .hint("check the sign");
        assert_eq!(
            error.to_string(),
            "`vs_m_s` must be in 50…5000 m/s, got -240\n  in layer 3 of `site.toml`\n  in stage `simulate`\n  because disk full\n\nhint: check the sign"
        );
        assert_eq!(error.exit_status(), 1);
        let json = serde_json::to_value(&error).unwrap();
        assert_eq!(json["at"], serde_json::json!(["layer 3 of `site.toml`", "stage `simulate`"]));
        assert_eq!((&json["causes"][0], &json["exit_status"]), (&"disk full".into(), &1.into()));
        assert_eq!(Error::new("x").usage().exit_status(), 2);
    }
}
