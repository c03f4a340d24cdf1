//! The JSON index of a dataset: which trajectory is in which file and split, and which runs failed and why.

use crate::atomic;
use crate::error::{Context, Error, Result};
use crate::records::Split;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Index of all trajectories of a site.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Index {
    /// Site name.
    pub site: String,
    /// Output step of the trajectories, s.
    pub dt_s: f64,
    /// Depth of the element centres, surface down, m.
    pub depth_m: Vec<f64>,
    /// Sensors in the order of the manifest.
    pub sensors: Vec<IndexSensor>,
    /// Cases in ascending order.
    pub cases: Vec<IndexCase>,
}

/// A sensor of the index.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IndexSensor {
    /// Name as in the manifest.
    pub name: String,
    /// Depth, m.
    pub depth_m: f64,
}

/// One case of the index.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IndexCase {
    /// Case number with leading zeros.
    pub id: String,
    /// What the case is used for.
    pub split: Split,
    /// Peak base acceleration, g.
    pub pga_g: f64,
    /// What came of it.
    #[serde(flatten)]
    pub outcome: Outcome,
}

/// What came of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The trajectory's file, relative to the index.
    File(PathBuf),
    /// Why there is none.
    Failed(String),
}

impl Index {
    /// Files of the cases of one split that did not fail, relative to `dir`.
    pub fn files<'a>(&'a self, dir: &'a Path, split: Split) -> impl Iterator<Item = (&'a str, PathBuf)> {
        self.cases.iter().filter(move |c| c.split == split).filter_map(move |c| match &c.outcome {
            Outcome::File(file) => Some((c.id.as_str(), dir.join(file))),
            Outcome::Failed(_) => None,
        })
    }

    /// Cases that failed, with the reason.
    pub fn failures(&self) -> impl Iterator<Item = (&str, &str)> {
        self.cases.iter().filter_map(|c| match &c.outcome {
            Outcome::File(_) => None,
            Outcome::Failed(why) => Some((c.id.as_str(), why.as_str())),
        })
    }

    /// Writes the index as JSON, whole or not at all.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let text = serde_json::to_string_pretty(self).context(|| "the index cannot be written as JSON".into())?;
        atomic::write(path, |out| writeln!(out, "{text}"))
    }

    /// Reads an index.
    ///
    /// # Errors
    /// When the file is missing or not an index.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).context(|| format!("cannot read `{}`", path.display()))?;
        serde_json::from_str(&text).map_err(|e| {
            Error::new("the file is not an index of trajectories").at(format!("`{}`", path.display())).cause(e)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_index_comes_back_as_written_with_failures_and_splits() {
        let dir = tempfile::tempdir().unwrap();
        let case = |id: &str, split, outcome| IndexCase { id: id.into(), split, pga_g: 0.1, outcome };
        let index = Index {
            site: "lotung".into(),
            dt_s: 0.005,
            depth_m: vec![0.0425, 0.1275],
            sensors: vec![IndexSensor { name: "FA1-5".into(), depth_m: 0.0 }],
            cases: vec![
                case("001", Split::Train, Outcome::File("001.mcap".into())),
                case("002", Split::Train, Outcome::Failed("no convergence at 3.2 s".into())),
                case("003", Split::Validation, Outcome::File("003.mcap".into())),
            ],
        };
        let path = dir.path().join("index.json");
        index.write(&path).unwrap();
        assert_eq!(Index::read(&path).unwrap(), index);
        let train: Vec<_> = index.files(dir.path(), Split::Train).collect();
        assert_eq!(train, [("001", dir.path().join("001.mcap"))]);
        assert_eq!(index.failures().collect::<Vec<_>>(), [("002", "no convergence at 3.2 s")]);
        std::fs::write(&path, "{}").unwrap();
        assert!(Index::read(&path).unwrap_err().what().contains("not an index"));
    }
}
