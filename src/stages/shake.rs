//! The nonlinear column under true base motions. In a stage all motions that are asked for together have one cache entry, named by
//! the columns that are shaken, how they are stepped, and the motions: replays of different stages and manifests share them. A diagnosis has
//! some ten thousand; they are part of no output.

use crate::column::{self, Column, Profile};
use crate::dataset::all_sensor_histories;
use crate::effects::{Effect, Situation};
use crate::error::{Context, Error, Result};
use crate::manifest::ColumnSections;
use crate::numerics::lanes::Width;
use crate::numerics::resample::resample_band_limited;
use crate::numerics::threads::{self, on_threads};
use crate::pipeline::{Item, ItemKind, Task, content_hash};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;
use toml::{Table, Value};

/// Kind and version of the cache entries.
const REPLAY: ItemKind = ItemKind::passing("replayed", 11);
const FILE: &str = "response_m_s2.f32";
const CONTENTS: &str = "contents.toml";

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

/// Shakes the column of `sections`, edited by `effects` alone and not by those of the manifest, with every motion; cached where there
/// is a `task`.
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
    let mut profiles: Vec<Profile> = Vec::new();
    let mut shaken: Vec<usize> = Vec::with_capacity(motions.len());
    for motion in motions {
        let mut profile = declared.clone();
        effects.iter().for_each(|e| e.edit(&mut profile, &motion.situation));
        let known = profiles.iter().position(|p| *p == profile);
        shaken.push(known.unwrap_or(profiles.len()));
        if known.is_none() {
            profiles.push(profile);
        }
    }
    let columns = profiles.iter().map(|p| Column::new(p, &sections.analysis)).collect::<Result<Vec<_>>>()?;
    let hands = hands(&columns, &shaken, motions);
    let run = |hand: usize| -> Vec<(usize, Response)> {
        let own = &hands[hand];
        let base = |i: &usize| {
            let motion = &motions[*i];
            // Between the samples of a coarser record lies a band-limited motion, not a straight line; of a finer one only what steps
            // can follow is to be seen.
            let analysis = &sections.analysis;
            let dt_s = motion.dt_s.max(analysis.max_step_s).min(analysis.output_step_s);
            (dt_s, resample_band_limited(motion.acceleration_m_s2, motion.dt_s, dt_s))
        };
        let bases: Vec<(f64, Vec<f64>)> = own.iter().map(base).collect();
        let bases: Vec<column::BaseMotion> =
            bases.iter().map(|(dt_s, base)| column::BaseMotion { dt_s: *dt_s, acceleration_m_s2: base }).collect();
        let found = all_sensor_histories(&columns[shaken[own[0]]], &bases, &depths_m);
        let outputs = |found: Result<Vec<Vec<f64>>>| match found {
            Ok(histories) => Ok(histories.into_iter().skip(1).collect()),
            Err(error) => Err(error.to_string()),
        };
        own.iter().copied().zip(found.into_iter().map(outputs)).collect()
    };
    let run_all = || {
        let mut found: Vec<(usize, Response)> = on_threads(hands.len(), run).into_iter().flatten().collect();
        found.sort_by_key(|(i, _)| *i);
        found.into_iter().map(|(_, response)| response).collect::<Vec<_>>()
    };
    let Some(task) = task else { return Ok(run_all()) };
    let item = item(&profiles, &shaken, (sections, &depths_m), motions)?;
    let outcome = task.items(&REPLAY, &[item], |_, folder| write(folder, &run_all()))?;
    let folder = outcome.into_iter().map(|o| o.output).next().unwrap_or_else(|| Err("nothing was computed".into()));
    read(&folder.map_err(|reason| Error::new("the column cannot be shaken").cause(reason))?)
}

/// Motions that are run together: of those of a column that takes them side by side as many as it takes, or for every thread its part of
/// more; else one by one.
fn hands(columns: &[Column], shaken: &[usize], motions: &[BaseMotion<'_>]) -> Vec<Vec<usize>> {
    let mut hands: Vec<Vec<usize>> = Vec::new();
    for (number, column) in columns.iter().enumerate() {
        let mut own: Vec<usize> = (0..motions.len()).filter(|i| shaken[*i] == number).collect();
        let duration_s = |i: &usize| motions[*i].acceleration_m_s2.len() as f64 * motions[*i].dt_s;
        own.sort_by(|a, b| duration_s(b).total_cmp(&duration_s(a)));
        // A motion alone takes as long as all that it has company for.
        let filled = own.len().div_ceil(Width::widest().lanes());
        let count = if column.is_batched() { threads::available().min(filled) } else { own.len() };
        let dealt = |hand: usize| own.iter().skip(hand).step_by(count.max(1)).copied().collect();
        hands.extend((0..count).map(dealt));
    }
    hands
}

/// Everything that a run of all `motions` depends on, each motion shaking the column of the profile that `shaken` names.
fn item(
    profiles: &[Profile],
    shaken: &[usize],
    (sections, depths_m): (&ColumnSections, &[f64]),
    motions: &[BaseMotion<'_>],
) -> Result<Item> {
    let value = |value: std::result::Result<Value, toml::ser::Error>| {
        value.map_err(|e| Error::new("the column cannot be written as TOML").cause(e))
    };
    let motion = |(motion, profile): (&BaseMotion<'_>, &usize)| {
        let mut bytes = motion.dt_s.to_le_bytes().to_vec();
        bytes.extend(motion.acceleration_m_s2.iter().flat_map(|a| a.to_le_bytes()));
        format!("{} on profile {profile}", content_hash(&bytes))
    };
    let parameters = Table::from_iter([
        ("profile".to_string(), value(Value::try_from(profiles))?),
        ("analysis".to_string(), value(Value::try_from(&sections.analysis))?),
        ("depth_m".to_string(), Value::from(depths_m.to_vec())),
        ("motion".to_string(), Value::from(motions.iter().zip(shaken).map(motion).collect::<Vec<_>>())),
    ]);
    let id = motions.first().map_or(String::new(), |m| format!("{} and {} more", m.id, motions.len() - 1));
    Ok(Item { id, parameters })
}

/// What a run left: how long each response is, or why there is none.
#[derive(Serialize, Deserialize)]
struct Contents {
    response: Vec<Shape>,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Shape {
    SensorsAndSteps(usize, usize),
    Failure(String),
}

/// Response after response, sensor after sensor in single precision, little end first.
fn write(folder: &Path, responses: &[Response]) -> Result<()> {
    let shape = |response: &Response| match response {
        Ok(histories) => Shape::SensorsAndSteps(histories.len(), histories.first().map_or(0, Vec::len)),
        Err(reason) => Shape::Failure(reason.clone()),
    };
    let contents = Contents { response: responses.iter().map(shape).collect() };
    let values = responses.iter().flatten().flatten().flatten();
    let bytes: Vec<u8> = values.flat_map(|a| (*a as f32).to_le_bytes()).collect();
    let save = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        fs::write(&path, bytes).context(|| format!("cannot write `{}`", path.display()))
    };
    let text = toml::to_string(&contents).context(|| "the contents cannot be written as TOML".into())?;
    save(CONTENTS, text.as_bytes())?;
    save(FILE, &bytes)
}

fn read(folder: &Path) -> Result<Vec<Response>> {
    let load = |name: &str| {
        let path = folder.join(name);
        fs::read(&path).context(|| format!("cannot read `{}`", path.display()))
    };
    let text = String::from_utf8(load(CONTENTS)?).context(|| format!("cannot read `{CONTENTS}`"))?;
    let contents: Contents = toml::from_str(&text).context(|| format!("cannot read `{CONTENTS}`"))?;
    let bytes = load(FILE)?;
    let mut values = bytes.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])));
    let response = |shape: Shape| match shape {
        Shape::SensorsAndSteps(sensors, steps) => {
            Ok((0..sensors).map(|_| values.by_ref().take(steps).collect()).collect())
        }
        Shape::Failure(reason) => Err(reason),
    };
    Ok(contents.response.into_iter().map(response).collect())
}
