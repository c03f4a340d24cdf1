//! The typed sections of a site manifest.

use super::{Problem, Randomisation};
use crate::column::{self, Analysis, Rayleigh, Vertical};
use crate::diagnosis::DiagnoseSettings;
use crate::effects::Tolerances;
use crate::flare::{CalibrateSettings, DistillSettings, PretrainSettings, Recipe};
use crate::motion::MotionSettings;
use crate::pipeline::SlurmSettings;
use crate::ranges::{Range, Ranged, range};
use crate::records::RecordSettings;
use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// `[executor]`: what computes ensembles beside this machine.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ExecutorSection {
    /// A cluster that runs Slurm.
    pub slurm: SlurmSettings,
}

/// `[training]`: what a training may take of this machine.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrainingSection {
    /// Memory for learning data, GiB; what is more is read from disk as it is needed. 0 is half of what the machine has.
    pub memory_gib: f64,
}

impl TrainingSection {
    /// Budget where the machine has `machine_bytes`, bytes; none where neither is said.
    pub fn memory_bytes(&self, machine_bytes: Option<f64>) -> f64 {
        match self.memory_gib {
            gib if gib > 0.0 => gib * f64::from(1 << 30),
            _ => 0.5 * machine_bytes.unwrap_or(f64::INFINITY),
        }
    }
}

impl Ranged for TrainingSection {
    const RANGES: &'static [Range<Self>] = &[range!(memory_gib, "GiB", 0.0, 1e6)];
}

/// A site manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Site {
    /// Names the run folder: lower-case letters, digits and hyphens.
    pub name: String,
    /// A sentence about the site and where its records come from, shown at the top of the report.
    #[serde(default)]
    pub about: String,
    /// A file of `pipelines/`, without `.toml`.
    #[serde(default = "default_pipeline")]
    pub pipeline: String,
    /// How the three stages are trained: `tuned`, as their sections say, or `published`, without what was added since.
    #[serde(default)]
    pub recipe: Recipe,
    /// Profile, mesh and boundary of the soil column.
    pub site: SiteSection,
    /// Constitutive laws by name, each with its `kind` and parameters.
    #[schemars(with = "BTreeMap<String, serde_json::Map<String, serde_json::Value>>")]
    pub law: BTreeMap<String, toml::Table>,
    /// Input sensor and output sensors.
    pub sensors: SensorsSection,
    /// A realisation of the declared site instead of that itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub randomisation: Option<Randomisation>,
    /// Prior standard deviations of what is declared.
    #[serde(default)]
    pub tolerances: Tolerances,
    /// Measured (or twin) records and their split.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub records: Option<RecordSettings>,
    /// Synthetic base motions.
    #[serde(default)]
    pub motions: MotionSettings,
    /// Time stepping of the column.
    #[serde(default)]
    pub analysis: Analysis,
    /// Stage 1: encoder, latent equations and decoder from the simulations.
    #[serde(default)]
    pub pretrain: PretrainSettings,
    /// Stage 2: the sparse-sensor encoder.
    #[serde(default)]
    pub distill: DistillSettings,
    /// Stage 3: latent coefficients from the measured events.
    #[serde(default)]
    pub calibrate: CalibrateSettings,
    /// Search and decision of the diagnosis.
    #[serde(default)]
    pub diagnose: DiagnoseSettings,
    /// What a training may take of this machine; its result does not depend on it.
    #[serde(default)]
    pub training: TrainingSection,
    /// Where ensembles are computed with `--executor`.
    #[serde(default)]
    pub executor: ExecutorSection,
    /// What a study of two source models compares this one with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub study: Option<StudySection>,
    /// Effects added to the declared model: none in a declared manifest, some in a corrected one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(with = "Vec<serde_json::Map<String, serde_json::Value>>")]
    pub effects: Vec<toml::Table>,
}

/// A second source model of the same site.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct StudySection {
    /// Manifest whose column it has; relative to this manifest.
    pub other: String,
}

/// The sections that make a column and its sensors: what a stage that runs columns reads.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ColumnSections {
    /// `[site]`
    pub site: SiteSection,
    /// `[law]`
    pub law: BTreeMap<String, toml::Table>,
    /// `[[effects]]`
    #[serde(default)]
    pub effects: Vec<toml::Table>,
    /// `[sensors]`
    pub sensors: SensorsSection,
    /// `[analysis]`
    #[serde(default)]
    pub analysis: Analysis,
}

/// Where keys stand that [`Site::completed`] fills in.
pub(super) const FILLED_IN: [&str; 2] = ["motions.", "pretrain."];

impl Site {
    /// The same site with what follows from other sections where `table`, which it was read from, does not say it.
    #[must_use]
    pub(super) fn completed(mut self, table: &toml::Table) -> Self {
        self.motions = self.motions.completed();
        let has_channels = table.get("pretrain").and_then(|t| t.get("channels")).is_some();
        if !has_channels {
            self.pretrain.channels = self.pretrain.channels.min(self.site.elements);
        }
        self
    }

    /// The same site with the training sections as its recipe has them.
    #[must_use]
    pub fn with_recipe(mut self) -> Self {
        if self.recipe == Recipe::Published {
            self.pretrain = self.pretrain.as_published();
            self.distill = self.distill.as_published();
            self.calibrate = self.calibrate.as_published();
        }
        self
    }

    /// The sections that make the column.
    pub fn column(&self) -> ColumnSections {
        ColumnSections {
            site: self.site.clone(),
            law: self.law.clone(),
            effects: self.effects.clone(),
            sensors: self.sensors.clone(),
            analysis: self.analysis.clone(),
        }
    }
}

fn default_pipeline() -> String {
    "flare-t".into()
}

/// Profile, mesh and boundary of the soil column.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SiteSection {
    /// Depth of the input sensor, which is the base of the column, in m.
    pub depth_m: f64,
    /// Finite elements over the depth; layers have theirs by thickness and fineness.
    #[serde(default = "default_elements")]
    pub elements: usize,
    /// Depth of the water table in m; absent for a dry column.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub water_table_m: Option<f64>,
    /// Vertical displacement above the base: `free` or `restrained`.
    #[serde(default = "default_vertical")]
    pub vertical: Vertical,
    /// Rayleigh damping α M + β K.
    #[serde(default)]
    pub rayleigh: Rayleigh,
    /// Layers from the surface down.
    pub layer: Vec<LayerSection>,
}

fn default_elements() -> usize {
    200
}

fn default_vertical() -> Vertical {
    Vertical::Free
}

/// One layer; keys beyond those named here are parameters of its law.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LayerSection {
    /// Thickness in m.
    pub thickness_m: f64,
    /// Total (saturated or moist) mass density in kg/m³.
    pub density_kg_m3: f64,
    /// Small-strain shear-wave velocity in m/s.
    pub vs_m_s: f64,
    /// Coefficient of earth pressure at rest.
    #[serde(default = "default_k0")]
    pub k0: f64,
    /// Elements in a metre of this layer over those in a metre of a layer with 1: less than 1 where waves are longer.
    #[serde(default = "column::uniform", skip_serializing_if = "column::is_uniform")]
    pub fineness: f64,
    /// A name under `[law]`.
    pub law: String,
    /// Parameters of the law that differ in this layer.
    #[serde(flatten)]
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub parameters: toml::Table,
}

fn default_k0() -> f64 {
    0.5
}

/// Input sensor and output sensors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorsSection {
    /// Name of the input sensor, at the base of the column.
    pub input: String,
    /// Sensors above it.
    pub output: Vec<OutputSection>,
}

impl SensorsSection {
    /// Names of the output sensors.
    pub fn names(&self) -> Vec<String> {
        self.output.iter().map(|s| s.name.clone()).collect()
    }

    /// Depths of the output sensors, m.
    pub fn depths_m(&self) -> Vec<f64> {
        self.output.iter().map(|s| s.depth_m).collect()
    }
}

/// One output sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct OutputSection {
    /// Name, as in the header of the record files.
    pub name: String,
    /// Depth in m; 0 is the surface.
    pub depth_m: f64,
}

/// Builds the typed sections; `None` when a section whose structure looked right cannot be read.
///
/// With problems already found, the keys they name are taken out first, so that the remaining sections are still
/// read and range-checked.
pub fn build(table: &toml::Table, problems: &mut Vec<Problem>) -> Option<Site> {
    if problems.is_empty() {
        return match Site::deserialize(table.clone()) {
            Ok(site) => Some(site),
            Err(error) => {
                problems.push(Problem::new("", error.message().trim()));
                None
            }
        };
    }
    ranges::<MotionSettings>(table, "motions", problems, |m| m.clone().completed().problems());
    ranges::<Analysis>(table, "analysis", problems, Analysis::problems);
    ranges::<PretrainSettings>(table, "pretrain", problems, PretrainSettings::problems);
    ranges::<DistillSettings>(table, "distill", problems, DistillSettings::beyond);
    ranges::<CalibrateSettings>(table, "calibrate", problems, CalibrateSettings::problems);
    ranges::<DiagnoseSettings>(table, "diagnose", problems, DiagnoseSettings::problems);
    ranges::<RecordSettings>(table, "records", problems, RecordSettings::problems);
    if let Some(site) = section::<SiteSection>(table, "site") {
        super::check::profile_ranges(&site, problems);
    }
    None
}

fn section<T: DeserializeOwned>(table: &toml::Table, name: &str) -> Option<T> {
    T::deserialize(table.get(name)?.clone()).ok()
}

fn ranges<T: DeserializeOwned>(
    table: &toml::Table,
    name: &str,
    problems: &mut Vec<Problem>,
    check: fn(&T) -> Vec<(String, String)>,
) {
    if let Some(section) = section::<T>(table, name) {
        let named = |(key, what): (String, String)| super::check::named_problem(format!("{name}.{key}"), &what);
        problems.extend(check(&section).into_iter().map(named));
    }
}
