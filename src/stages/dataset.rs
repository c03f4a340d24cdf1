//! The compact learning set: trajectories at the step of the latent model, normalised, in one file.

use super::artifact::{read_json, write_json};
use super::budget;
use crate::dataset::{Accumulator, Coarse, Index, Normalisation, pick_channels, read_trajectory};
use crate::error::{Context, Error, Result};
use crate::flare::{self, Case, Observation};
use crate::numerics::spill::{Spill, Values, mapped};
use crate::pipeline::{Stage, Task};
use crate::records::Split;
use rayon::prelude::*;
use safetensors::tensor::{Dtype, Metadata, SafeTensors, TensorInfo};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Decimates and normalises the trajectories.
pub struct Dataset;

const CARD: &str = "dataset.json";
const TENSORS: &str = "dataset.safetensors";
/// Trajectories that are decoded together.
const AT_ONCE: usize = 64;

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

    fn unkeyed(&self) -> &'static [&'static str] {
        budget::UNKEYED
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let step_s: f64 = task.section("pretrain.step_s")?;
        let folder = task.input("simulate")?;
        let index = Index::read(&folder.join("index.json"))?;
        let channels = pick_channels(index.depth_m.len(), task.section("pretrain.channels")?);
        let files: Vec<_> =
            [Split::Train, Split::Validation].into_iter().flat_map(|s| index.files(folder, s)).collect();
        task.progress().start("trajectories", files.len() as u64);
        let ids = |split| index.files(folder, split).map(|(id, _)| id.to_string()).collect::<Vec<_>>();
        let train = ids(Split::Train);
        let spill = budget::spill(task)?;
        let (mut scales, mut series) = (Accumulator::default(), Vec::with_capacity(files.len()));
        for some in files.chunks(AT_ONCE) {
            let decoded = |(_, file): &(&str, PathBuf)| {
                let coarse = Coarse::of_trajectory(&read_trajectory(file)?, step_s, &channels);
                task.progress().advance(1);
                Ok(coarse)
            };
            for coarse in some.par_iter().map(decoded).collect::<Result<Vec<Coarse>>>()? {
                if series.len() < train.len() {
                    scales.add(&coarse)?;
                }
                series.push(Series::of(coarse, &spill)?);
            }
        }
        let card = Card {
            step_s,
            validation: ids(Split::Validation),
            channel_depth_m: channels.iter().map(|c| index.depth_m[*c]).collect(),
            sensors: index.sensors.iter().map(|s| s.name.clone()).collect(),
            sensor_depth_m: index.sensors.iter().map(|s| s.depth_m).collect(),
            normalisation: scales.finish()?,
            train,
        };
        write_tensors(&task.output_dir().join(TENSORS), &series, &card.normalisation)?;
        write_json(&task.output_dir().join(CARD), &card)
    }
}

/// A trajectory at the step of the latent model, m/s².
struct Series {
    id: String,
    base: Values<f64>,
    base_half: Values<f64>,
    n_dense: usize,
    dense: Values<f64>,
    n_sparse: usize,
    sparse: Values<f64>,
}

impl Series {
    fn of(coarse: Coarse, spill: &Spill) -> Result<Self> {
        Ok(Self {
            id: coarse.id,
            base: spill.keep(coarse.base_m_s2)?,
            base_half: spill.keep(coarse.base_half_m_s2)?,
            n_dense: coarse.n_dense,
            dense: spill.keep(coarse.dense_m_s2)?,
            n_sparse: coarse.n_sparse,
            sparse: spill.keep(coarse.sparse_m_s2)?,
        })
    }
}

/// A series in units of the scales of its columns, made when it is written.
struct Normalised<'a> {
    name: String,
    values_m_s2: &'a [f64],
    shape: Vec<usize>,
    normalise: &'a dyn Fn(&[f64]) -> Vec<f32>,
}

/// Writes the series one by one: all of them need not fit into memory.
fn write_tensors(path: &Path, series: &[Series], normalisation: &Normalisation) -> Result<()> {
    let base = |x: &[f64]| normalisation.base(x);
    let dense = |x: &[f64]| normalisation.dense(x);
    let sparse = |x: &[f64]| normalisation.sparse(x);
    let mut tensors: Vec<Normalised<'_>> = Vec::with_capacity(4 * series.len());
    for case in series {
        let n = case.base.len();
        let mut add = |name: &str, shape: Vec<usize>, values_m_s2, normalise| {
            tensors.push(Normalised { name: format!("{}.{name}", case.id), values_m_s2, shape, normalise });
        };
        add("u", vec![n], &case.base, &base);
        add("u_half", vec![case.base_half.len()], &case.base_half, &base);
        add("dense", vec![n, case.n_dense], &case.dense, &dense);
        add("sparse", vec![n, case.n_sparse], &case.sparse, &sparse);
    }
    tensors.sort_by(|a, b| a.name.cmp(&b.name));
    let what = || format!("cannot write `{}`", path.display());
    let mut end = 0;
    let mut info = |tensor: &Normalised<'_>| {
        let start = end;
        end += size_of::<f32>() * tensor.values_m_s2.len();
        let info = TensorInfo { dtype: Dtype::F32, shape: tensor.shape.clone(), data_offsets: (start, end) };
        (tensor.name.clone(), info)
    };
    let metadata = Metadata::new(None, tensors.iter().map(&mut info).collect()).context(what)?;
    let mut header = serde_json::to_vec(&metadata).context(what)?;
    // Values begin at a multiple of the length's own size.
    header.resize(header.len().next_multiple_of(size_of::<u64>()), b' ');
    let mut file = BufWriter::new(fs::File::create(path).context(what)?);
    file.write_all(&(header.len() as u64).to_le_bytes()).and_then(|()| file.write_all(&header)).context(what)?;
    for tensor in &tensors {
        let bytes: Vec<u8> = (tensor.normalise)(tensor.values_m_s2).iter().flat_map(|v| v.to_le_bytes()).collect();
        file.write_all(&bytes).context(what)?;
    }
    file.flush().context(what)
}

/// The card of a learning set.
///
/// # Errors
/// When `folder` holds none.
pub fn card(folder: &Path) -> Result<Card> {
    read_json(&folder.join(CARD))
}

/// The cases `ids` of the learning set in `folder`, in the memory of `spill` where it has room for all of the set, else read from the
/// file as they are needed.
///
/// # Errors
/// When the file is absent, damaged, or lacks a case.
pub fn cases(folder: &Path, ids: &[String], spill: &Spill) -> Result<Vec<Case>> {
    let path = folder.join(TENSORS);
    let what = || format!("cannot read `{}`", path.display());
    let file = fs::File::open(&path).context(what)?;
    let map = Arc::new(mapped(&file).context(what)?);
    let tensors = SafeTensors::deserialize(&map).context(what)?;
    // What is mapped is taken as it lies, which is little-endian.
    let is_held = spill.has_room(map.len()) || cfg!(target_endian = "big");
    let floats = |name: String| -> Result<Values<f32>> {
        let data = tensors.tensor(&name).map_err(|e| Error::new(what()).cause(e))?.data();
        if is_held {
            return spill.keep(data.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect());
        }
        let start = data.as_ptr() as usize - map.as_ptr() as usize;
        Values::mapped(&map, start..start + data.len()).map_err(|e| Error::new(what()).cause(e))
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
