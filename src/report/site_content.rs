//! What the sections on the site and its events show, as plain data.

use super::content::Series;
use serde::{Deserialize, Serialize};

/// The column and its array.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SiteView {
    /// Depth of the base, m.
    pub depth_m: f64,
    /// Declared layers, surface down.
    pub layers: Vec<LayerView>,
    /// Shear-wave velocity over depth, as declared first.
    pub profiles: Vec<ProfileView>,
    /// Sensors, the input first.
    pub sensors: Vec<SensorPlace>,
    /// Depth of the water table, m, where it is in the column.
    pub water_table_m: Option<f64>,
    /// What the profile says in a number, by name.
    pub facts: Vec<(String, String)>,
    /// All events with what they were used for.
    pub events: Vec<EventRow>,
}

/// One declared layer.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LayerView {
    /// Depth of its top, m.
    pub top_m: f64,
    /// Depth of its bottom, m.
    pub bottom_m: f64,
    /// Kind of its law.
    pub law: String,
}

/// Shear-wave velocity over depth of one model.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ProfileView {
    /// Model, a key of the report's models.
    pub model: String,
    /// Depth of the top of each layer, m, and its velocity, m/s.
    pub tops: Vec<[f64; 2]>,
    /// 95 % intervals, surface down; empty where there are none.
    pub bands: Vec<VelocityBand>,
}

/// 95 % interval of the velocity between two depths.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VelocityBand {
    /// Depth of its top, m.
    pub top_m: f64,
    /// Depth of its bottom, m.
    pub bottom_m: f64,
    /// Ends of the interval, m/s.
    pub vs_m_s: [f64; 2],
}

/// Where a sensor sits.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorPlace {
    /// Name.
    pub name: String,
    /// Depth, m.
    pub depth_m: f64,
    /// Whether its motion shakes the column.
    pub is_input: bool,
}

/// One component of one event.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EventRow {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// What it was used for.
    pub split: String,
    /// Peak acceleration at each sensor in the order of [`SiteView::sensors`], g.
    pub pga_g: Vec<f64>,
    /// Length, s.
    pub duration_s: f64,
}

/// One component of one held-out event, with all models.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EventView {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// Motion of the input sensor, m/s².
    pub input: Series,
    /// Output sensors.
    pub sensors: Vec<SensorView>,
}

/// One sensor of it.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorView {
    /// Name.
    pub sensor: String,
    /// Depth, m.
    pub depth_m: Option<f64>,
    /// Periods of the spectra, s.
    pub period_s: Vec<f64>,
    /// Record first, then the models.
    pub models: Vec<ModelView>,
}

/// The record or a model at one sensor.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ModelView {
    /// Key of the model; `record` for the record.
    pub model: String,
    /// Acceleration, m/s².
    pub history: Series,
    /// 5 % damped pseudo-acceleration, m/s².
    pub psa_m_s2: Vec<f64>,
    /// Peak velocity, m/s.
    pub pgv_m_s: f64,
    /// Arias intensity, m/s.
    pub arias_m_s: f64,
    /// Normalised root-mean-square error, %, where there is one.
    pub nrmse_percent: Option<f64>,
}

/// Transfer function of one sensor over the input in one component.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TransferView {
    /// Component.
    pub component: String,
    /// Sensor.
    pub sensor: String,
    /// Frequencies, Hz.
    pub frequencies_hz: Vec<f64>,
    /// Mean of the recorded ln amplitude.
    pub recorded_ln: Vec<f64>,
    /// Its standard deviation between events; empty where there is one event.
    pub sigma_ln: Vec<f64>,
    /// Mean ln amplitude by model.
    pub predicted_ln: Vec<(String, Vec<f64>)>,
    /// Events behind it.
    pub n_event: usize,
}

/// ln ratio of predicted and recorded response spectra over period, all held-out events together.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ResidualView {
    /// Sensor.
    pub sensor: String,
    /// Periods, s.
    pub period_s: Vec<f64>,
    /// Model, mean and standard deviation by period.
    pub models: Vec<(String, Vec<f64>, Vec<f64>)>,
    /// Events and components behind it.
    pub n: usize,
}

/// What the strongest held-out motion does over depth.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthView {
    /// Event.
    pub event: String,
    /// Component.
    pub component: String,
    /// Peak of the input, g.
    pub pga_g: f64,
    /// Models of the column.
    pub models: Vec<DepthModel>,
}

/// Modulus reduction and damping of the soil at one depth, as the column has them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SoilCurve {
    /// Key of the model.
    pub model: String,
    /// Kind of the law.
    pub law: String,
    /// Depth, m.
    pub depth_m: f64,
    /// Shear strain amplitudes, %.
    pub strain_percent: Vec<f64>,
    /// Secant shear modulus over the small-strain one.
    pub modulus_ratio: Vec<f64>,
    /// Damping ratio, %.
    pub damping_percent: Vec<f64>,
}

/// Largest absolute values in the elements of one model, surface down, and the loop of the one with the largest strain.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DepthModel {
    /// Key of the model.
    pub model: String,
    /// Depths of the element centres, m.
    pub depth_m: Vec<f64>,
    /// Acceleration, g.
    pub pga_g: Vec<f64>,
    /// Shear strain, %.
    pub strain_percent: Vec<f64>,
    /// Shear stress, kPa.
    pub stress_kpa: Vec<f64>,
    /// Excess pore pressure over initial vertical effective stress.
    pub pore_ratio: Vec<f64>,
    /// Depth of the element with the largest strain, m.
    pub loop_depth_m: f64,
    /// Its strain (%) and stress (kPa), output step after output step.
    pub stress_strain: Vec<(f64, f64)>,
}
