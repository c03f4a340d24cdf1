//! The CSV contract: `<dir>/<event>.<component>.csv`, header `time_s,<input sensor>,<sensor>,…`, uniform step.
//!
//! Columns are found by name, in any order; further columns are left alone; lines that start with `#` are comments. One of those above the
//! header may say the unit: `# unit: gal`.

use super::channel::Channel;
use super::record::Record;
use super::{Format, Reading, Role, Source, Usual};
use crate::atomic;
use crate::error::{Context, Error, Result};
use crate::registry::{self, Entry, params};
use crate::units::AccelerationUnit;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};

pub(super) const ENTRY: Entry<dyn Format> = Entry {
    name: "csv",
    about: "one CSV a component: time_s, input sensor, output sensors",
    build: |table| Ok(Box::new(params::<Csv>(table)?)),
    schema: || schemars::schema_for!(Csv),
};

/// The CSV format has no parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Csv {}

impl Format for Csv {
    fn recognises(&self, name: &str, _: &[u8]) -> bool {
        name.to_lowercase().ends_with(".csv")
    }

    fn usual(&self, role: &Role) -> Result<Option<Usual>> {
        let file = format!("{}.{}.csv", role.event, role.component);
        Ok(Some(Usual { file, channel: role.sensor.into() }))
    }

    fn read(&self, source: &Source, bytes: &[u8], reading: &Reading) -> Result<Vec<Channel>> {
        let header = channels_in(bytes)?;
        let unit = reading.unit(stated_unit(bytes)?)?;
        let mut names: Vec<&str> = header.iter().map(String::as_str).filter(|name| (reading.is_wanted)(name)).collect();
        names.sort_unstable();
        names.dedup();
        let table = columns(bytes, &names, unit.m_s2())?;
        let channel = |(name, values): (&&str, Vec<f64>)| Channel {
            name: (*name).into(),
            ..Channel::alone(&source.name, table.dt_s, values)
        };
        // Columns that no sensor is named by are told of by name alone.
        let others = header.iter().filter(|name| !names.contains(&name.as_str()));
        let unread =
            others.map(|name| Channel { name: name.clone(), ..Channel::alone(&source.name, table.dt_s, vec![]) });
        Ok(names.iter().zip(table.channels).map(channel).chain(unread).collect())
    }
}

/// The contract's file of one component of one event.
pub fn path(dir: &Path, event: &str, component: &str) -> PathBuf {
    dir.join(format!("{event}.{component}.csv"))
}

/// A uniform table of named channels.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Time step, s.
    pub dt_s: f64,
    /// One history a name, in the order asked, scaled.
    pub channels: Vec<Vec<f64>>,
}

/// Reads the columns `names` of the contract CSV at `path`, values of the `unit` that is declared or that the file says, to m/s².
///
/// # Errors
/// As [`columns`]; when neither says the unit, or the two differ.
pub fn read(path: &Path, names: &[&str], unit: Option<AccelerationUnit>) -> Result<Table> {
    let place = |e: Error| e.at(format!("`{}`", path.display()));
    let unit = super::unit(unit, unit_in(path)?).map_err(place)?;
    columns(opened(path)?, names, unit.m_s2()).map_err(place)
}

/// Names of the columns of the contract CSV at `path` beside the time.
///
/// # Errors
/// When it cannot be read or has no column `time_s`.
pub fn channel_names(path: &Path) -> Result<Vec<String>> {
    channels_in(opened(path)?).map_err(|e| e.at(format!("`{}`", path.display())).usage())
}

fn channels_in(source: impl Read) -> Result<Vec<String>> {
    let mut reader = reader(source);
    let header = reader.headers().map_err(unreadable)?;
    let time = find_column(header, "time_s")?;
    Ok(header.iter().enumerate().filter(|(i, _)| *i != time).map(|(_, name)| name.to_string()).collect())
}

/// The unit that the file at `path` says, if it does.
///
/// # Errors
/// When it cannot be read, or the unit is not known.
pub fn unit_in(path: &Path) -> Result<Option<AccelerationUnit>> {
    stated_unit(opened(path)?).map_err(|e| e.at(format!("`{}`", path.display())))
}

fn opened(path: &Path) -> Result<BufReader<File>> {
    atomic::open(path).map(BufReader::new).context(|| format!("cannot read `{}`", path.display()))
}

fn reader<R: Read>(source: R) -> ::csv::Reader<R> {
    ::csv::ReaderBuilder::new().comment(Some(b'#')).trim(::csv::Trim::All).flexible(true).from_reader(source)
}

/// The unit that a comment above the header says.
fn stated_unit(source: impl BufRead) -> Result<Option<AccelerationUnit>> {
    let lines = source.split(b'\n').map_while(std::io::Result::ok);
    let text = lines.map(|line| String::from_utf8_lossy(&line).trim_start_matches('\u{feff}').trim().to_string());
    for line in text.filter(|line| !line.is_empty()).take_while(|line| line.starts_with('#')) {
        let Some((key, name)) = line.trim_start_matches('#').split_once(':') else { continue };
        if !key.trim().eq_ignore_ascii_case("unit") {
            continue;
        }
        return AccelerationUnit::named(name.trim()).map(Some);
    }
    Ok(None)
}

/// Reads the columns `names` of a contract CSV, each value times `scale`.
///
/// # Errors
/// When a column is missing, a value is not a finite number, or the time does not rise in equal steps; the line is named.
pub fn columns(source: impl Read, names: &[&str], scale: f64) -> Result<Table> {
    let mut reader = reader(source);
    let header = reader.headers().map_err(unreadable)?.clone();
    let time = find_column(&header, "time_s")?;
    let places = names.iter().map(|name| find_column(&header, name)).collect::<Result<Vec<_>>>()?;
    let mut axis = Axis::default();
    let mut channels = vec![Vec::new(); names.len()];
    for row in reader.records() {
        let row = row.map_err(unreadable)?;
        let line = row.position().map_or(0, ::csv::Position::line);
        if row.len() != header.len() {
            return Err(Error::new(format!("line {line} has {} values, the header has {}", row.len(), header.len()))
                .hint("every line needs one value a column; was the file cut off?"));
        }
        axis.push(&row[time], line)?;
        for ((channel, &place), name) in channels.iter_mut().zip(&places).zip(names) {
            channel.push(number(&row[place], name, line)? * scale);
        }
    }
    Ok(Table { dt_s: axis.step_s()?, channels })
}

/// Writes a record in the contract's form, values in `unit`; `comments` go on top, one `#` line each.
///
/// # Errors
/// When the file cannot be written.
pub fn write(dir: &Path, record: &Record, unit: AccelerationUnit, comments: &[&str]) -> Result<PathBuf> {
    let path = path(dir, &record.event, &record.component);
    atomic::write(&path, |out| {
        for comment in comments.iter().flat_map(|c| c.lines()) {
            writeln!(out, "# {comment}")?;
        }
        let names: Vec<String> = record.sensors().map(|s| quoted(&s.name)).collect();
        writeln!(out, "time_s,{}", names.join(","))?;
        for i in 0..record.n_step() {
            write!(out, "{}", time_text(i as f64 * record.dt_s))?;
            for sensor in record.sensors() {
                write!(out, ",{}", sensor.acceleration_m_s2[i] / unit.m_s2())?;
            }
            writeln!(out)?;
        }
        Ok(())
    })?;
    Ok(path)
}

/// Nanosecond resolution without trailing zeros: `0.005`, not `0.005000000000000001`.
fn time_text(t_s: f64) -> String {
    let text = format!("{t_s:.9}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

fn quoted(name: &str) -> String {
    if name.contains([',', '"', '\n', '\r', '#']) { format!("\"{}\"", name.replace('"', "\"\"")) } else { name.into() }
}

fn unreadable(error: ::csv::Error) -> Error {
    let line = error.position().map_or(1, ::csv::Position::line);
    Error::new(format!("line {line} is not text in CSV form")).cause(error).hint("save the file as UTF-8 CSV")
}

fn find_column(header: &::csv::StringRecord, name: &str) -> Result<usize> {
    let mut matches = header.iter().enumerate().filter(|(_, h)| *h == name).map(|(i, _)| i);
    match (matches.next(), matches.next()) {
        (Some(place), None) => Ok(place),
        (Some(_), Some(_)) => {
            Err(Error::new(format!("column `{name}` comes twice in the header")).hint("rename one of the two"))
        }
        (None, _) if header.iter().all(str::is_empty) => {
            Err(Error::new("the file is empty").hint("the first line is the header `time_s,<input sensor>,<sensor>,…`"))
        }
        (None, _) if header.len() == 1 && header.iter().any(|h| h.contains([';', '\t'])) => {
            Err(Error::new("the columns are separated by semicolons or tabs, not by commas")
                .hint("save the file with commas between columns and points in numbers"))
        }
        (None, _) => {
            let present: Vec<&str> = header.iter().collect();
            Err(Error::new(format!("there is no column `{name}` in the header"))
                .hint(format!("columns are named as the sensors of the manifest; {}", registry::known(&present, name))))
        }
    }
}

fn number(text: &str, column: &str, line: u64) -> Result<f64> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        read => {
            // `NaN`, `inf` and nothing stand for samples that are not there; anything else is no sample at all.
            let is_gap = read.is_ok() || text.trim().is_empty();
            let hint = if is_gap {
                "cut the record before the gap, or fill it and say so in a comment"
            } else {
                "a column holds numbers such as `-0.0123` or `1.2e-3`, with a point and without units"
            };
            Err(Error::new(format!("`{column}` is `{text}` on line {line}, a finite number is needed")).hint(hint))
        }
    }
}

/// Checks that times rise in equal steps, allowing for their rounding in print.
#[derive(Default)]
struct Axis {
    times_s: Vec<f64>,
    lines: Vec<u64>,
    rounding_s: f64,
}

impl Axis {
    fn push(&mut self, text: &str, line: u64) -> Result<()> {
        let time_s = number(text, "time_s", line)?;
        if let Some(&previous) = self.times_s.last()
            && time_s <= previous
        {
            return Err(Error::new(format!("time falls from {previous} s to {time_s} s on line {line}"))
                .hint("sort the lines by time and drop repeated ones"));
        }
        let decimals = text.split_once('.').map_or(0, |(_, d)| d.chars().take_while(char::is_ascii_digit).count());
        self.rounding_s = self.rounding_s.max(0.1f64.powi(decimals.min(12) as i32));
        self.times_s.push(time_s);
        self.lines.push(line);
        Ok(())
    }

    fn step_s(&self) -> Result<f64> {
        let n = self.times_s.len();
        if n < 3 {
            return Err(Error::new(format!("the record has {n} samples, at least 3 are needed"))
                .hint("the header is followed by one line a sample; was the file cut off?"));
        }
        let mean_s = (self.times_s[n - 1] - self.times_s[0]) / (n - 1) as f64;
        // The usual step, robust against a few gaps, names the offending line rather than the first one.
        let mut steps: Vec<f64> = self.times_s.windows(2).map(|w| w[1] - w[0]).collect();
        steps.sort_by(f64::total_cmp);
        let usual_s = steps[(steps.len() - 1) / 2];
        let tolerance_s = self.rounding_s.max(0.01 * usual_s).min(0.3 * usual_s);
        for i in 1..n {
            let step_s = self.times_s[i] - self.times_s[i - 1];
            if (step_s - usual_s).abs() > tolerance_s * (1.0 + 1e-6) {
                return Err(Error::new(format!(
                    "the time step is {step_s:.6} s on line {}, but {usual_s:.6} s elsewhere",
                    self.lines[i]
                ))
                .hint("records need a uniform step: resample the record, or cut it at the gap"));
            }
        }
        // Steps are multiples of a nanosecond; what is left is rounding of the division.
        let rounded_s = (mean_s * 1e9).round() * 1e-9;
        let snapped_s = if (rounded_s - mean_s).abs() < 1e-9 * mean_s { (mean_s * 1e9).round() / 1e9 } else { mean_s };
        if !(1e-5..=1.0).contains(&snapped_s) {
            return Err(Error::new(format!("the time step is {snapped_s} s, it must be in 0.00001…1 s"))
                .hint("is the column `time_s` in seconds?"));
        }
        Ok(snapped_s)
    }
}
