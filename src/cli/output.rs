//! Lines for stdout, which is data, and for stderr, which is for people: a reader who goes away ends no work and is no failure.

use crate::error::{Context, Error, Result};
use serde::Serialize;
use serde_json::json;
use std::fmt;
use std::io::{ErrorKind, Write};

/// Writes a line of data: `data!("{name}  {about}")?`.
macro_rules! data {
    ($($part:tt)*) => { $crate::cli::output::write_line(format_args!($($part)*)) };
}

/// Says a line to people: `say!("{count} entries removed")`.
macro_rules! say {
    ($($part:tt)*) => { $crate::cli::output::say_line(format_args!($($part)*)) };
}

pub(super) use {data, say};

/// Writes `text` and the end of a line to stdout.
///
/// # Errors
/// When stdout cannot be written, but for a reader who has had enough.
pub(super) fn write_line(text: fmt::Arguments<'_>) -> Result<()> {
    match writeln!(std::io::stdout().lock(), "{text}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(error).context(|| "cannot write to stdout".into()),
        _ => Ok(()),
    }
}

/// Writes `value` to stdout as JSON.
///
/// # Errors
/// As [`write_line`]; when it is no JSON.
pub(super) fn write_json(value: &impl Serialize) -> Result<()> {
    let text = serde_json::to_string_pretty(value).context(|| "cannot write the result as JSON".into())?;
    write_line(format_args!("{text}"))
}

/// Writes `text` and the end of a line to stderr; what cannot be said is not.
pub(super) fn say_line(text: fmt::Arguments<'_>) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Says what went wrong: to people, or on stdout as JSON.
pub fn tell(error: &Error, json: bool) {
    if error.is_told() {
        return;
    }
    let is_written = json && write_json(&json!({ "error": error })).is_ok();
    if !is_written {
        say!("error: {error}");
    }
}
