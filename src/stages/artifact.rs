//! Small files that stages hand to one another: JSON and TOML documents and tables of histories.

use crate::error::{Context, Error, Result};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs;
use std::path::Path;

/// Writes `value` as indented JSON.
///
/// # Errors
/// When the file cannot be written.
pub fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<()> {
    let mut text = serde_json::to_string_pretty(value).context(|| format!("cannot write `{}`", path.display()))?;
    text.push('\n');
    fs::write(path, text).context(|| format!("cannot write `{}`", path.display()))
}

/// Reads JSON.
///
/// # Errors
/// When the file is absent or holds something else.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let bytes = fs::read(path).context(|| format!("cannot read `{}`", path.display()))?;
    serde_json::from_slice(&bytes).context(|| format!("`{}` does not hold what it should", path.display()))
}

/// Writes `value` as TOML, which unlike JSON knows infinite numbers.
///
/// # Errors
/// When the file cannot be written.
pub fn write_toml<T: Serialize>(path: &Path, value: &T) -> Result<()> {
    let text = toml::to_string(value).context(|| format!("cannot write `{}`", path.display()))?;
    fs::write(path, text).context(|| format!("cannot write `{}`", path.display()))
}

/// Reads TOML.
///
/// # Errors
/// When the file is absent or holds something else.
pub fn read_toml<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = fs::read_to_string(path).context(|| format!("cannot read `{}`", path.display()))?;
    toml::from_str(&text).context(|| format!("`{}` does not hold what it should", path.display()))
}

/// Writes histories with a common step as CSV: `time_s` and one column each, shortest exact numbers.
///
/// # Errors
/// When the file cannot be written.
pub fn write_table(path: &Path, dt_s: f64, columns: &[(&str, &[f64])]) -> Result<()> {
    let what = || format!("cannot write `{}`", path.display());
    let mut writer = csv::Writer::from_path(path).context(what)?;
    writer.write_record(std::iter::once("time_s").chain(columns.iter().map(|(name, _)| *name))).context(what)?;
    let n_step = columns.iter().map(|(_, c)| c.len()).max().unwrap_or(0);
    for step in 0..n_step {
        let time = format!("{:.6}", step as f64 * dt_s);
        let values = columns.iter().map(|(_, c)| c.get(step).map(f64::to_string).unwrap_or_default());
        writer.write_record(std::iter::once(time).chain(values)).context(what)?;
    }
    writer.flush().context(what)
}

/// Reads the columns of a table written by [`write_table`] (time left out), by name; empty cells end a column.
///
/// # Errors
/// When the file is absent or a cell is no number.
pub fn read_table(path: &Path) -> Result<Vec<(String, Vec<f64>)>> {
    let what = || format!("cannot read `{}`", path.display());
    let mut reader = csv::Reader::from_path(path).context(what)?;
    let names: Vec<String> = reader.headers().context(what)?.iter().skip(1).map(str::to_string).collect();
    let mut columns: Vec<(String, Vec<f64>)> = names.into_iter().map(|n| (n, Vec::new())).collect();
    for row in reader.records() {
        let row = row.context(what)?;
        for ((name, column), cell) in columns.iter_mut().zip(row.iter().skip(1)) {
            if !cell.is_empty() {
                let value =
                    cell.parse().map_err(|_| Error::new(format!("`{cell}` in column `{name}` is no number")))?;
                column.push(value);
            }
        }
    }
    Ok(columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[test]
    fn what_is_open_upwards_comes_back_from_toml() {
        #[derive(Debug, PartialEq, Serialize, Deserialize)]
        struct Bound {
            table: toml::Table,
            explained: Option<f64>,
            ci95: [f64; 2],
        }
        let dir = tempfile::tempdir().expect("a folder");
        let table = toml::Table::from_iter([("corner_hz".to_string(), toml::Value::Float(f64::INFINITY))]);
        let bound = Bound { table, explained: None, ci95: [0.1 + 0.2, f64::INFINITY] };
        write_toml(&dir.path().join("b.toml"), &bound).expect("written");
        assert_eq!(read_toml::<Bound>(&dir.path().join("b.toml")).expect("read"), bound);
    }
}
