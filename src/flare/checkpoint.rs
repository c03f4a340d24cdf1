//! Models on disk: tensors as safetensors, everything a person asks about them as a TOML card beside.

use super::calibrate::Calibration;
use super::equations::equations;
use super::history::History;
use super::mlp::{Mlp, Tensor};
use super::model::{Shape, SourceModel, SparseEncoder};
use super::observation::Observation;
use super::snapshot::{bytes_f32, bytes_mask, floats};
use crate::error::{Context, Error, Result};
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::io::Write;
use std::path::Path;

const TENSORS: &str = "model.safetensors";
const CARD: &str = "model.toml";

/// What physical units one normalised unit stands for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Normalisation {
    /// Standard deviation of the base acceleration over the training motions.
    pub input_std_m_s2: f64,
    /// Depths of the dense channels (m).
    pub channel_depth_m: Vec<f64>,
    /// Standard deviation of each dense channel over the training motions.
    pub dense_std_m_s2: Vec<f64>,
}

#[derive(Serialize, Deserialize)]
struct SourceCard {
    kind: String,
    terms: Vec<String>,
    terms_kept: usize,
    /// Coefficients are stored per sample; divide by `shape.step_s` for 1/s.
    equations_per_s: Vec<String>,
    shape: Shape,
    normalisation: Normalisation,
}

#[derive(Serialize, Deserialize)]
struct SparseCard {
    kind: String,
    window: usize,
    widths: Vec<usize>,
    has_linear_path: bool,
    observation: Observation,
}

#[derive(Serialize, Deserialize)]
struct CalibrationCard {
    kind: String,
    terms: Vec<String>,
    terms_kept: usize,
    cosine_similarity: f64,
    validation_error: f64,
    step_s: f64,
    equations_per_s: Vec<String>,
}

impl SourceModel {
    /// Latent equations in 1/s, one line each.
    pub fn equations(&self) -> Vec<String> {
        equations(self.shape.library(), &self.coefficients_per_s())
    }

    /// Writes `model.safetensors` and `model.toml` into `dir`.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn save(&self, dir: &Path, normalisation: &Normalisation) -> Result<()> {
        let mut file = Tensors::default();
        let library = self.shape.library();
        let shape = vec![library.n_term(), library.latent];
        file.floats("xi", shape.clone(), self.coefficients());
        file.mask("mask", shape, &self.mask);
        file.network("encoder", &self.shape.encoder(), self.encoder_parameters());
        file.network("decoder", &self.shape.decoder(), self.decoder_parameters());
        file.write(&dir.join(TENSORS))?;
        let card = SourceCard {
            kind: "source model".into(),
            terms: library.names(),
            terms_kept: self.mask.iter().filter(|k| **k).count(),
            equations_per_s: self.equations(),
            shape: self.shape.clone(),
            normalisation: normalisation.clone(),
        };
        write_card(&dir.join(CARD), &card)
    }

    /// Reads what [`SourceModel::save`] wrote.
    ///
    /// # Errors
    /// When a file is missing or does not fit the card.
    pub fn load(dir: &Path) -> Result<(Self, Normalisation)> {
        let card: SourceCard = read_card(&dir.join(CARD))?;
        let bytes = read(&dir.join(TENSORS))?;
        let file = Reader::new(&dir.join(TENSORS), &bytes)?;
        let n = card.shape.library().n_coefficient();
        let mut parameters = file.floats("xi", n)?;
        let mask = file.mask("mask", n)?;
        parameters.extend(file.network("encoder", &card.shape.encoder())?);
        parameters.extend(file.network("decoder", &card.shape.decoder())?);
        Ok((Self { shape: card.shape, parameters, mask }, card.normalisation))
    }
}

impl SparseEncoder {
    /// Writes `model.safetensors` and `model.toml` into `dir`.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn save(&self, dir: &Path, observation: &Observation) -> Result<()> {
        let mut file = Tensors::default();
        file.network("encoder", &self.network, &self.parameters);
        file.write(&dir.join(TENSORS))?;
        let card = SparseCard {
            kind: "sparse encoder".into(),
            window: self.window,
            widths: self.network.widths.clone(),
            has_linear_path: self.network.is_skipped,
            observation: observation.clone(),
        };
        write_card(&dir.join(CARD), &card)
    }

    /// Reads what [`SparseEncoder::save`] wrote.
    ///
    /// # Errors
    /// When a file is missing or does not fit the card.
    pub fn load(dir: &Path) -> Result<(Self, Observation)> {
        let card: SparseCard = read_card(&dir.join(CARD))?;
        let network = Mlp { widths: card.widths, is_skipped: card.has_linear_path };
        let bytes = read(&dir.join(TENSORS))?;
        let parameters = Reader::new(&dir.join(TENSORS), &bytes)?.network("encoder", &network)?;
        let n_sensor = card.observation.n_sensor();
        Ok((Self { window: card.window, n_sensor, network, parameters }, card.observation))
    }
}

impl Calibration {
    /// Latent equations in 1/s, one line each, for a model sampled every `step_s`.
    pub fn equations(&self, shape: &Shape) -> Vec<String> {
        let per_s: Vec<f64> = self.coefficients.iter().map(|c| f64::from(*c) / shape.step_s).collect();
        equations(shape.library(), &per_s)
    }

    /// Writes `model.safetensors`, `model.toml` and `history.csv` into `dir`.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn save(&self, dir: &Path, shape: &Shape) -> Result<()> {
        let mut file = Tensors::default();
        let sizes = vec![shape.library().n_term(), shape.library().latent];
        file.floats("xi", sizes.clone(), &self.coefficients);
        file.mask("mask", sizes, &self.mask);
        file.write(&dir.join(TENSORS))?;
        self.history.save(&dir.join("history.csv"))?;
        let card = CalibrationCard {
            kind: "calibrated coefficients".into(),
            terms: shape.library().names(),
            terms_kept: self.terms_kept(),
            cosine_similarity: self.cosine_similarity,
            validation_error: self.validation_error,
            step_s: shape.step_s,
            equations_per_s: self.equations(shape),
        };
        write_card(&dir.join(CARD), &card)
    }

    /// Reads what [`Calibration::save`] wrote, without the loss history.
    ///
    /// # Errors
    /// When a file is missing or does not fit the source model's shape.
    pub fn load(dir: &Path, shape: &Shape) -> Result<Self> {
        let card: CalibrationCard = read_card(&dir.join(CARD))?;
        let bytes = read(&dir.join(TENSORS))?;
        let file = Reader::new(&dir.join(TENSORS), &bytes)?;
        let n = shape.library().n_coefficient();
        Ok(Self {
            coefficients: file.floats("xi", n)?,
            mask: file.mask("mask", n)?,
            cosine_similarity: card.cosine_similarity,
            validation_error: card.validation_error,
            history: History::default(),
        })
    }
}

impl History {
    /// Writes the table as CSV.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        publish(path, self.to_csv().as_bytes())
    }
}

/// Tensors on their way to a file.
#[derive(Default)]
struct Tensors(Vec<(String, Dtype, Vec<usize>, Vec<u8>)>);

impl Tensors {
    fn floats(&mut self, name: &str, shape: Vec<usize>, values: &[f32]) {
        self.0.push((name.to_string(), Dtype::F32, shape, bytes_f32(values)));
    }

    fn mask(&mut self, name: &str, shape: Vec<usize>, mask: &[bool]) {
        self.0.push((name.to_string(), Dtype::U8, shape, bytes_mask(mask)));
    }

    fn network(&mut self, prefix: &str, network: &Mlp, parameters: &[f32]) {
        for Tensor { name, shape, range } in network.tensors() {
            self.floats(&format!("{prefix}.{name}"), shape, &parameters[range]);
        }
    }

    fn write(&self, path: &Path) -> Result<()> {
        let describe = || format!("cannot write `{}`", path.display());
        let views: Vec<(&str, TensorView<'_>)> = self
            .0
            .iter()
            .map(|(name, dtype, shape, data)| {
                TensorView::new(*dtype, shape.clone(), data).map(|view| (name.as_str(), view))
            })
            .collect::<std::result::Result<_, _>>()
            .context(describe)?;
        publish(path, &serialize(views, None).context(describe)?)
    }
}

struct Reader<'a> {
    name: String,
    tensors: SafeTensors<'a>,
}

impl<'a> Reader<'a> {
    fn new(path: &Path, bytes: &'a [u8]) -> Result<Self> {
        let name = path.display().to_string();
        let tensors = SafeTensors::deserialize(bytes).context(|| format!("cannot read `{name}`"))?;
        Ok(Self { name, tensors })
    }

    fn data(&self, name: &str, dtype: Dtype, n: usize) -> Result<&[u8]> {
        let tensor = self.tensors.tensor(name).context(|| format!("no tensor `{name}` in `{}`", self.name))?;
        let size = n * dtype.bitsize() / 8;
        if tensor.dtype() != dtype || tensor.data().len() != size {
            let found = tensor.data().len();
            return Err(Error::new(format!("tensor `{name}` of `{}`: expected {size} bytes, got {found}", self.name)));
        }
        Ok(tensor.data())
    }

    fn floats(&self, name: &str, n: usize) -> Result<Vec<f32>> {
        let values = floats(self.data(name, Dtype::F32, n)?);
        match values.iter().position(|v| !v.is_finite()) {
            Some(i) => Err(Error::new(format!("value {i} of tensor `{name}` of `{}` is not finite", self.name))),
            None => Ok(values),
        }
    }

    fn mask(&self, name: &str, n: usize) -> Result<Vec<bool>> {
        Ok(self.data(name, Dtype::U8, n)?.iter().map(|b| *b != 0).collect())
    }

    fn network(&self, prefix: &str, network: &Mlp) -> Result<Vec<f32>> {
        let mut parameters = Vec::new();
        for Tensor { name, range, .. } in network.tensors() {
            parameters.extend(self.floats(&format!("{prefix}.{name}"), range.len())?);
        }
        Ok(parameters)
    }
}

/// Writes a file beside and renames it into place, so that a reader sees the whole of it or nothing.
pub(super) fn publish(path: &Path, bytes: &[u8]) -> Result<()> {
    let describe = || format!("cannot write `{}`", path.display());
    let dir = path.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(dir).context(describe)?;
    let mut file = tempfile::NamedTempFile::new_in(dir).context(describe)?;
    file.write_all(bytes).context(describe)?;
    file.as_file().sync_all().context(describe)?;
    file.persist(path).context(describe)?;
    Ok(())
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).context(|| format!("cannot read `{}`", path.display()))
}

fn write_card(path: &Path, card: &impl Serialize) -> Result<()> {
    let text = toml::to_string(card).context(|| format!("cannot describe `{}`", path.display()))?;
    publish(path, text.as_bytes())
}

fn read_card<C: DeserializeOwned>(path: &Path) -> Result<C> {
    let text = std::fs::read_to_string(path).context(|| format!("cannot read `{}`", path.display()))?;
    toml::from_str(&text).context(|| format!("cannot understand `{}`", path.display()))
}
