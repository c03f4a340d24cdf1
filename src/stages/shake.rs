//! The nonlinear column under true base motions. In a stage every run has a cache entry of its own, named by the column
//! that is shaken, how it is stepped, and the motion: replays of different stages and manifests share them.

use crate::column::{Column, Profile};
use crate::dataset::sensor_histories;
use crate::effects::{Effect, Situation};
use crate::error::{Context, Error, Result};
use crate::manifest::ColumnSections;
use crate::numerics::resample::resample_band_limited;
use crate::pipeline::{Item, Task, content_hash};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use toml::{Table, Value};

/// Kind and version of the cache entries of single runs.
const REPLAY: (&str, u32) = ("replayed", 3);
const FILE: &str = "response_m_s2.f32";

/// A true motion of the base.
pub struct BaseMotion<'a> {
    /// For people: `LSST07.EW`.
    pub id: String,
    /// Component and place in the history of the array.
    pub situation: Situation,
    /// Time step, s.
    pub dt_s: f64,
    /// Acceleration, m/s².
    pub acceleration_m_s2: &'a [f64],
}

/// True motions at the output sensors, `[sensor][step]` at the output step of the analysis, m/s²; or why there are none.
pub type Response = Result<Vec<Vec<f64>>, String>;

/// Shakes the column of `sections`, edited by `effects` alone and not by those of the manifest, with every motion; runs are
/// cached where there is a `task`.
///
/// # Errors
/// When the column cannot be built or the cache cannot be read or written.
pub fn shake(
    task: Option<&Task<'_>>,
    sections: &ColumnSections,
    effects: &[Box<dyn Effect>],
    motions: &[BaseMotion<'_>],
) -> Result<Vec<Response>> {
    let depths_m = sections.sensor_depths_m(effects);
    let declared = sections.declared_profile()?;
    let mut columns: BTreeMap<String, Column> = BTreeMap::new();
    let mut items = Vec::with_capacity(motions.len());
    let mut keys = Vec::with_capacity(motions.len());
    for motion in motions {
        let mut profile = declared.clone();
        effects.iter().for_each(|e| e.edit(&mut profile, &motion.situation));
        let parameters = parameters(&profile, sections, &depths_m)?;
        let key = parameters.to_string();
        if !columns.contains_key(&key) {
            columns.insert(key.clone(), Column::new(&profile, &sections.analysis)?);
        }
        items.push(item(motion, parameters));
        keys.push(key);
    }
    let run = |i: usize| -> Result<Vec<Vec<f64>>> {
        let motion = &motions[i];
        // Between the samples of a coarser record lies a band-limited motion, not a straight line.
        let dt_s = motion.dt_s.min(sections.analysis.output_step_s);
        let base_m_s2 = resample_band_limited(motion.acceleration_m_s2, motion.dt_s, dt_s);
        let histories = sensor_histories(&columns[&keys[i]], dt_s, &base_m_s2, &depths_m)?;
        Ok(histories.into_iter().skip(1).collect())
    };
    let Some(task) = task else {
        return Ok((0..motions.len()).into_par_iter().map(|i| run(i).map_err(|e| e.to_string())).collect());
    };
    let outcomes = task.items(REPLAY.0, REPLAY.1, &items, |i, folder| write(&folder.join(FILE), &run(i)?))?;
    outcomes
        .into_iter()
        .map(|outcome| match outcome.output {
            Ok(folder) => Ok(Ok(read(&folder.join(FILE), depths_m.len())?)),
            Err(reason) => Ok(Err(reason)),
        })
        .collect()
}

fn parameters(profile: &Profile, sections: &ColumnSections, depths_m: &[f64]) -> Result<Table> {
    let table = |value: std::result::Result<Value, toml::ser::Error>| {
        value.map_err(|e| Error::new("the column cannot be written as TOML").cause(e))
    };
    Ok(Table::from_iter([
        ("profile".to_string(), table(Value::try_from(profile))?),
        ("analysis".to_string(), table(Value::try_from(&sections.analysis))?),
        ("depth_m".to_string(), Value::from(depths_m.to_vec())),
    ]))
}

fn item(motion: &BaseMotion<'_>, mut parameters: Table) -> Item {
    let mut bytes = motion.dt_s.to_le_bytes().to_vec();
    bytes.extend(motion.acceleration_m_s2.iter().flat_map(|a| a.to_le_bytes()));
    parameters.insert("motion".into(), Value::String(content_hash(&bytes)));
    Item { id: motion.id.clone(), parameters }
}

/// Row after row in single precision, little end first.
fn write(path: &Path, histories: &[Vec<f64>]) -> Result<()> {
    let bytes: Vec<u8> = histories.iter().flatten().flat_map(|a| (*a as f32).to_le_bytes()).collect();
    fs::write(path, bytes).context(|| format!("cannot write `{}`", path.display()))
}

fn read(path: &Path, n_sensor: usize) -> Result<Vec<Vec<f64>>> {
    let bytes = fs::read(path).context(|| format!("cannot read `{}`", path.display()))?;
    let values: Vec<f64> =
        bytes.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))).collect();
    let n_step = values.len() / n_sensor.max(1);
    Ok(values.chunks_exact(n_step.max(1)).map(<[f64]>::to_vec).collect())
}
