//! The ensemble of finite-element columns: one trajectory a base motion, each cached on its own.

use super::instrument::{Concern, narrow};
use super::motions;
use crate::column::Column;
use crate::dataset::{Header, Index, IndexCase, IndexSensor, Outcome, Sample, Sampler, TrajectoryWriter};
use crate::effects;
use crate::error::{Error, Result};
use crate::manifest::ColumnSections;
use crate::motion::{Motion, MotionSettings, parse_cases};
use crate::pipeline::{Item, ItemKind, Stage, Task, content_hash};
use crate::records::Split;
use crate::units::G_M_S2;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Runs the column under every base motion.
pub struct Simulate;

/// Kind and version of the cache entries of single trajectories.
const TRAJECTORY: ItemKind = ItemKind::of_output("trajectory", 5);
/// File of a trajectory in its entry.
pub const TRAJECTORY_FILE: &str = "trajectory.mcap";
/// Share of the ensemble that may fail before the stage does.
const MAX_FAILED_SHARE: f64 = 0.1;

impl Stage for Simulate {
    fn kind(&self) -> &'static str {
        "simulate"
    }

    fn about(&self) -> &'static str {
        "finite-element columns under every base motion, one MCAP file each"
    }

    fn version(&self) -> u32 {
        8
    }

    fn reads(&self) -> &'static [&'static str] {
        &["name", "site", "law", "effects", "sensors", "analysis", "motions"]
    }

    fn narrow(&self, parameters: &mut Table) {
        narrow(parameters, Concern::Column);
    }

    fn hands_on_items(&self) -> bool {
        true
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let mut sections = super::records::column(task)?;
        let depths_m = sections.sensor_depths_m(&effects::build_all(&sections.effects)?);
        sections.sensors.output.iter_mut().zip(depths_m).for_each(|(sensor, depth_m)| sensor.depth_m = depth_m);
        let settings: MotionSettings = task.section("motions")?;
        let site: String = task.section("name")?;
        let column = Column::new(&sections.profile()?, &sections.analysis)?;
        let suite = motions::read(task.input("motions")?, settings.step_s)?;
        let items: Vec<Item> = suite.iter().map(|m| item(task, m)).collect();
        let outcomes = task.items(&TRAJECTORY, &items, |i, folder| {
            simulate(&site, &sections, &column, &suite[i], &settings, &items[i].parameters, folder)
        })?;
        let train = parse_cases(&settings.train)?;
        let validation = parse_cases(&settings.validation)?;
        let mut cases = Vec::new();
        for (number, (motion, outcome)) in suite.iter().zip(outcomes).enumerate() {
            let split = match number + 1 {
                n if train.contains(&n) => Split::Train,
                n if validation.contains(&n) => Split::Validation,
                _ => continue,
            };
            let outcome = match outcome.output {
                Ok(folder) => Outcome::File(relative(&folder)?),
                Err(reason) => Outcome::Failed(reason),
            };
            cases.push(IndexCase { id: motion.id.clone(), split, pga_g: motion.pga_m_s2() / G_M_S2, outcome });
        }
        let sensors = sections.sensors.output.iter().map(|s| IndexSensor { name: s.name.clone(), depth_m: s.depth_m });
        let index = Index {
            site,
            dt_s: sections.analysis.output_step_s,
            depth_m: column.channel_depths_m(),
            sensors: sensors.collect(),
            cases,
        };
        judge(task, &index)?;
        index.write(&task.output_dir().join("index.json"))
    }
}

/// Everything a trajectory depends on: the column and the very samples of its motion.
fn item(task: &Task<'_>, motion: &Motion) -> Item {
    let mut parameters = task.parameters().clone();
    parameters.remove("motions");
    let mut bytes = motion.dt_s.to_le_bytes().to_vec();
    bytes.extend(motion.acceleration_m_s2.iter().flat_map(|a| a.to_le_bytes()));
    parameters.insert("motion".into(), Value::String(content_hash(&bytes)));
    parameters.insert("motion_id".into(), Value::String(motion.id.clone()));
    Item { id: motion.id.clone(), parameters }
}

fn simulate(
    site: &str,
    sections: &ColumnSections,
    column: &Column,
    motion: &Motion,
    settings: &MotionSettings,
    parameters: &Table,
    folder: &Path,
) -> Result<()> {
    let kinds: std::collections::BTreeSet<&str> =
        sections.law.values().filter_map(|t| t.get("kind").and_then(Value::as_str)).collect();
    let metadata = BTreeMap::from([
        ("site".to_string(), site.to_string()),
        ("law".to_string(), kinds.into_iter().collect::<Vec<_>>().join(",")),
        ("motion".to_string(), motion.id.clone()),
        ("seed".to_string(), settings.seed.to_string()),
        ("key".to_string(), content_hash(parameters.to_string().as_bytes())),
    ]);
    let header = Header {
        id: motion.id.clone(),
        dt_s: sections.analysis.output_step_s,
        depth_m: column.channel_depths_m(),
        sensors: sections.sensors.names(),
        metadata,
    };
    let mut writer = TrajectoryWriter::create(&folder.join(TRAJECTORY_FILE), header)?;
    let sampler = Sampler::new(column, &sections.sensors.depths_m());
    let mut sensors_m_s2 = vec![0.0; sections.sensors.output.len()];
    let run = column.run(motion.dt_s, &motion.acceleration_m_s2, &mut |frame| {
        sampler.read(frame, &mut sensors_m_s2);
        writer.push(&Sample {
            time_s: frame.time_s,
            base_m_s2: frame.base_m_s2,
            response_m_s2: frame.elements_m_s2,
            surface_m_s2: frame.surface_m_s2(),
            sensors_m_s2: &sensors_m_s2,
        })
    });
    let summary = run.map_err(|failure| Error::from(failure).at(format!("motion `{}`", motion.id)))?;
    writer.note("steps", summary.steps);
    writer.note("cuts", summary.cuts);
    writer.note("fronts", summary.fronts);
    writer.note("newton_iterations", summary.newton_iterations);
    writer.finish()
}

/// Path of a trajectory as seen from the folder of the index.
fn relative(folder: &Path) -> Result<PathBuf> {
    match (folder.file_name(), folder.parent().and_then(Path::file_name)) {
        (Some(key), Some(kind)) => Ok(Path::new("../..").join(kind).join(key).join(TRAJECTORY_FILE)),
        _ => Err(Error::new(format!("`{}` is no entry of the cache", folder.display()))),
    }
}

/// Tells of failed motions; too many of them fail the stage.
fn judge(task: &Task<'_>, index: &Index) -> Result<()> {
    let failures: Vec<(&str, &str)> = index.failures().collect();
    for (id, reason) in &failures {
        task.progress().warn(&format!("motion {id} did not finish: {}", reason.lines().next().unwrap_or_default()));
    }
    let share = failures.len() as f64 / index.cases.len().max(1) as f64;
    if share > MAX_FAILED_SHARE {
        let (id, reason) = failures[0];
        let what = format!("{} of {} motions did not finish", failures.len(), index.cases.len());
        return Err(Error::new(what)
            .cause(format!("motion {id}: {reason}"))
            .hint("the first reason is shown; see log.txt"));
    }
    Ok(())
}
