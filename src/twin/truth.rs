//! The truth file: what really holds at a twin site.

use super::{OwnDamping, Processing, outside};
use crate::effects;
use crate::error::{Context, Error, Result};
use crate::motion::{Band, MotionSettings};
use crate::ranges::Ranged as _;
use crate::records::Noise;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use toml::Table;

/// A truth file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// A sentence about this truth.
    #[serde(default)]
    pub about: String,
    /// A truth file in the same folder from which comes what this one does not say; its effects do not count.
    #[serde(default)]
    pub like: Option<String>,
    /// The site manifest it belongs to, relative to the truth file; `flare-pipe twin` starts from it.
    pub site: String,
    /// Seed of the draws, the event motions and the noise.
    pub seed: u64,
    /// Elements of the truth column per declared element.
    #[serde(default = "default_mesh_factor")]
    pub mesh_factor: usize,
    /// Largest time step of the truth column, s.
    #[serde(default = "default_max_step")]
    pub max_step_s: f64,
    /// Sensor noise, on the input sensor too.
    #[serde(default)]
    pub noise: Noise,
    /// Range of the dominant frequency of the event motions, Hz.
    #[serde(default = "default_dominant")]
    pub dominant_hz: [f64; 2],
    /// What is done to the noisy records.
    #[serde(default, skip_serializing_if = "Processing::is_none")]
    pub processing: Processing,
    /// Damping of its own in place of what the laws ask for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping: Option<OwnDamping>,
    /// Law parameters that differ from the declared ones, by law name; a table with a `kind` stands in place of the declared one.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, serde_json::Map<String, serde_json::Value>>")]
    pub law: BTreeMap<String, Table>,
    /// Events of the array; none where the truth alters measured records.
    #[serde(default)]
    pub event: Vec<EventSection>,
    /// Effects that hold and are not declared.
    #[serde(default)]
    #[schemars(with = "Vec<serde_json::Map<String, serde_json::Value>>")]
    pub effects: Vec<Table>,
    /// What holds and no effect of the catalogue describes.
    #[serde(default)]
    #[schemars(with = "Vec<serde_json::Map<String, serde_json::Value>>")]
    pub outside: Vec<Table>,
}

fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).context(|| format!("cannot read the truth file `{}`", path.display()))
}

/// The value of the key `like`.
fn like(text: &str) -> Option<String> {
    let table: Table = toml::from_str(text).ok()?;
    table.get("like")?.as_str().map(String::from)
}

fn beside(path: &Path, name: &str) -> PathBuf {
    path.parent().unwrap_or(Path::new(".")).join(name)
}

fn default_mesh_factor() -> usize {
    2
}

fn default_dominant() -> [f64; 2] {
    [1.0, 5.0]
}

fn default_max_step() -> f64 {
    0.0025
}

/// One event: peak base acceleration by component, and how long it lasts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EventSection {
    /// Name, as in the manifest's lists.
    pub name: String,
    /// Peak base acceleration in g, by component.
    pub pga_g: BTreeMap<String, f64>,
    /// Duration in s.
    pub duration_s: f64,
}

impl Truth {
    /// Reads and checks a truth file.
    ///
    /// # Errors
    /// When it cannot be read, is no TOML, or a value is out of range.
    pub fn load(path: &Path) -> Result<Self> {
        let place = || format!("`{}`", path.display());
        let text = read(path)?;
        let usage = |e: &toml::de::Error| Error::new(e.to_string().trim().to_string()).at(place()).usage();
        let truth: Self = match like(&text) {
            None => toml::from_str(&text).map_err(|e| usage(&e))?,
            Some(like) => {
                let own: Table = toml::from_str(&text).map_err(|e| usage(&e))?;
                let other = read(&beside(path, &like)).map_err(|e| e.at(place()))?;
                let mut table: Table = toml::from_str(&other).map_err(|e| usage(&e).at(format!("`{like}`")))?;
                for key in ["about", "effects", "outside"] {
                    table.remove(key);
                }
                table.extend(own);
                table.try_into().map_err(|e| usage(&e))?
            }
        };
        truth.check().map_err(|e| e.at(place()))?;
        Ok(truth)
    }

    /// The files that [`Truth::load`] reads for `path`.
    pub fn files(path: &Path) -> Vec<PathBuf> {
        let like = read(path).ok().and_then(|text| like(&text));
        std::iter::once(path.to_path_buf()).chain(like.map(|name| beside(path, &name))).collect()
    }

    /// Components of the events, in alphabetical order.
    pub fn components(&self) -> Vec<String> {
        let names: std::collections::BTreeSet<&String> = self.event.iter().flat_map(|e| e.pga_g.keys()).collect();
        names.into_iter().cloned().collect()
    }

    /// Whether this truth can be put on measured records: nothing but effects of sensors on what they record.
    ///
    /// # Errors
    /// When it holds something that only a computed motion could show.
    pub fn check_alters(&self) -> Result<()> {
        let of_soil = |table: &&Table| {
            // A measured motion cannot be read at another depth.
            effects::changes_motion(table)
        };
        let what = match self.effects.iter().find(of_soil) {
            Some(table) => format!("effect {} changes the motion of the ground, which was measured", table["kind"]),
            None if !self.event.is_empty() => "there are events of its own, but the records are measured".to_string(),
            None if !self.law.is_empty() || !self.outside.is_empty() || self.damping.is_some() => {
                "`law`, `damping` and `outside` change the motion of the ground, which was measured".to_string()
            }
            None if !self.processing.is_none() => "`processing` is of twin records alone".to_string(),
            None => return Ok(()),
        };
        Err(Error::new(what).hint("only effects of sensors can be put on measured records").usage())
    }

    /// Settings of one event motion of peak `pga_g`; seed and duration are the event's own.
    pub(super) fn motions(&self, pga_g: f64) -> MotionSettings {
        MotionSettings {
            // A suite has a training and a validation case; the first is the event.
            count: 2,
            seed: self.seed,
            duration_s: 1.0,
            step_s: 0.005,
            // A band must rise; the width is below the precision of the records.
            bands: vec![Band { count: 2, min_pga_g: pga_g * (1.0 - 1e-9), max_pga_g: pga_g }],
            train: "1".into(),
            validation: "2".into(),
            low_hz: 0.3,
            high_hz: 9.0,
            dominant_hz: self.dominant_hz,
            strong_share: [0.25, 0.5],
        }
    }

    pub(super) fn check(&self) -> Result<()> {
        let range = |name: &str, value: f64, lowest: f64, highest: f64, unit: &str| {
            if (lowest..=highest).contains(&value) {
                return Ok(());
            }
            Err(Error::new(format!("`{name}` must be in {lowest}…{highest}{unit}, got {value}")).usage())
        };
        range("mesh_factor", self.mesh_factor as f64, 1.0, 8.0, "")?;
        range("max_step_s", self.max_step_s, 1e-4, 0.005, " s")?;
        if let Some((key, what)) = self.noise.beyond().into_iter().next() {
            return Err(Error::new(format!("`{key}` {what}")).usage());
        }
        for event in &self.event {
            let place = |e: Error| e.at(format!("event `{}`", event.name));
            range("duration_s", event.duration_s, 1.0, 600.0, " s").map_err(place)?;
            for pga in event.pga_g.values() {
                range("pga_g", *pga, 1e-4, 3.0, " g").map_err(place)?;
            }
        }
        self.processing.check()?;
        self.damping.map_or(Ok(()), |own| own.check())?;
        effects::build_all(&self.effects)?;
        outside::build_all(&self.outside).map(|_| ())
    }

    /// Kinds that hold in its own column: a damping with frequencies of its own depends on frequency.
    pub fn kinds_besides(&self) -> Vec<String> {
        self.damping.iter().map(|_| effects::FREQUENCY_DEPENDENT_DAMPING.to_string()).collect()
    }

    /// Whether part of what holds outside the catalogue is the same in all events.
    ///
    /// # Errors
    /// When `kind` is missing or unknown, or a parameter is missing, unknown or out of range.
    pub fn outside_repeats(&self) -> Result<bool> {
        Ok(outside::build_all(&self.outside)?.iter().any(|one| one.repeats()))
    }
}
