//! The compact learning set: trajectories at the step of the latent model, normalised, in one file.

use super::artifact::{read_json, write_json};
use crate::dataset::{Coarse, Index, Normalisation, pick_channels, read_trajectory};
use crate::error::{Context, Error, Result};
use crate::flare::{self, Case, Observation};
use crate::pipeline::{Stage, Task};
use crate::records::Split;
use rayon::prelude::*;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;

/// Decimates and normalises the trajectories.
pub struct Dataset;

const CARD: &str = "dataset.json";
const TENSORS: &str = "dataset.safetensors";

/// What the numbers of the learning set mean.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Card {
    /// Step of the latent model, s.
    pub step_s: f64,
    /// Training cases, in order.
    pub train: Vec<String>,
    /// Validation cases, in order.
    pub validation: Vec<String>,
    /// Depths of the dense channels, m.
    pub channel_depth_m: Vec<f64>,
    /// Sensors, in the order of the manifest.
    pub sensors: Vec<String>,
    /// Their depths, m.
    pub sensor_depth_m: Vec<f64>,
    /// Scales, from the training cases alone.
    pub normalisation: Normalisation,
}

impl Card {
    /// The observation matrix with both normalisations, as the latent model wants it.
    pub fn observation(&self) -> Observation {
        Observation {
            sensors: self.sensors.clone(),
            channel_depth_m: self.channel_depth_m.clone(),
            sensor_depth_m: self.sensor_depth_m.clone(),
            dense_std_m_s2: self.normalisation.dense_m_s2.clone(),
            sparse_std_m_s2: self.normalisation.sparse_m_s2.clone(),
        }
    }

    /// The normalisation that belongs to a source model.
    pub fn source_normalisation(&self) -> flare::Normalisation {
        flare::Normalisation {
            input_std_m_s2: self.normalisation.base_m_s2,
            channel_depth_m: self.channel_depth_m.clone(),
            dense_std_m_s2: self.normalisation.dense_m_s2.clone(),
        }
    }
}

impl Stage for Dataset {
    fn kind(&self) -> &'static str {
        "dataset"
    }

    fn about(&self) -> &'static str {
        "trajectories decimated without aliasing and normalised by the training cases"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        &["pretrain.channels", "pretrain.step_s"]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let step_s: f64 = task.section("pretrain.step_s")?;
        let folder = task.input("simulate")?;
        let index = Index::read(&folder.join("index.json"))?;
        let channels = pick_channels(index.depth_m.len(), task.section("pretrain.channels")?);
        let files: Vec<_> =
            [Split::Train, Split::Validation].into_iter().flat_map(|s| index.files(folder, s)).collect();
        task.progress().start("trajectories", files.len() as u64);
        let cases: Vec<Coarse> = files
            .par_iter()
            .map(|(_, file)| {
                let coarse = Coarse::of_trajectory(&read_trajectory(file)?, step_s, &channels);
                task.progress().advance(1);
                Ok(coarse)
            })
            .collect::<Result<_>>()?;
        let ids = |split| index.files(folder, split).map(|(id, _)| id.to_string()).collect::<Vec<_>>();
        let train = ids(Split::Train);
        let card = Card {
            step_s,
            validation: ids(Split::Validation),
            channel_depth_m: channels.iter().map(|c| index.depth_m[*c]).collect(),
            sensors: index.sensors.iter().map(|s| s.name.clone()).collect(),
            sensor_depth_m: index.sensors.iter().map(|s| s.depth_m).collect(),
            normalisation: Normalisation::of(&cases[..train.len()])?,
            train,
        };
        write_tensors(&task.output_dir().join(TENSORS), &cases, &card.normalisation)?;
        write_json(&task.output_dir().join(CARD), &card)
    }
}

fn write_tensors(path: &Path, cases: &[Coarse], normalisation: &Normalisation) -> Result<()> {
    let mut tensors: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
    for case in cases {
        let n = case.n_step();
        let mut add = |name: &str, shape: Vec<usize>, values: Vec<f32>| {
            let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            tensors.push((format!("{}.{name}", case.id), shape, bytes));
        };
        add("u", vec![n], normalisation.base(&case.base_m_s2));
        add("u_half", vec![case.base_half_m_s2.len()], normalisation.base(&case.base_half_m_s2));
        add("dense", vec![n, case.n_dense], normalisation.dense(&case.dense_m_s2));
        add("sparse", vec![n, case.n_sparse], normalisation.sparse(&case.sparse_m_s2));
    }
    let what = || format!("cannot write `{}`", path.display());
    let views = tensors
        .iter()
        .map(|(name, shape, bytes)| {
            Ok((name.as_str(), TensorView::new(Dtype::F32, shape.clone(), bytes).context(what)?))
        })
        .collect::<Result<Vec<_>>>()?;
    let bytes = safetensors::serialize(views, None).context(what)?;
    fs::write(path, bytes).context(what)
}

/// The card of a learning set.
///
/// # Errors
/// When `folder` holds none.
pub fn card(folder: &Path) -> Result<Card> {
    read_json(&folder.join(CARD))
}

/// The cases `ids` of the learning set in `folder`.
///
/// # Errors
/// When the file is absent, damaged, or lacks a case.
pub fn cases(folder: &Path, ids: &[String]) -> Result<Vec<Case>> {
    let path = folder.join(TENSORS);
    let what = || format!("cannot read `{}`", path.display());
    let bytes = fs::read(&path).context(what)?;
    let tensors = SafeTensors::deserialize(&bytes).context(what)?;
    let floats = |name: String| -> Result<Vec<f32>> {
        let view = tensors.tensor(&name).map_err(|e| Error::new(what()).cause(e))?;
        Ok(view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
    };
    let case = |id: &String| {
        Ok(Case {
            id: id.clone(),
            u: floats(format!("{id}.u"))?,
            u_half: floats(format!("{id}.u_half"))?,
            dense: floats(format!("{id}.dense"))?,
            sparse: floats(format!("{id}.sparse"))?,
        })
    };
    ids.iter().map(case).collect()
}
