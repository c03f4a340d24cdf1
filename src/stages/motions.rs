//! Base motions for the simulations.

use super::artifact::{write_json, write_table};
use crate::error::Result;
use crate::motion::{self, Motion, MotionSettings};
use crate::pipeline::{Stage, Task};
use crate::units::G_M_S2;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Generates the seeded suite of base motions.
pub struct Motions;

/// What `motions.json` says of one motion.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct MotionSummary {
    /// Case number as text: `001`.
    pub id: String,
    /// Peak acceleration, g.
    pub pga_g: f64,
}

impl Stage for Motions {
    fn kind(&self) -> &'static str {
        "motions"
    }

    fn about(&self) -> &'static str {
        "seeded nonstationary base motions, baseline-corrected and scaled to their target PGA"
    }

    fn version(&self) -> u32 {
        1
    }

    fn reads(&self) -> &'static [&'static str] {
        &["motions"]
    }

    fn run(&self, task: &Task<'_>) -> Result<()> {
        let suite = motion::suite(&task.section::<MotionSettings>("motions")?)?;
        let columns: Vec<(&str, &[f64])> =
            suite.iter().map(|m| (m.id.as_str(), m.acceleration_m_s2.as_slice())).collect();
        let dt_s = suite.first().map_or(0.0, |m| m.dt_s);
        write_table(&task.output_dir().join("motions_m_s2.csv"), dt_s, &columns)?;
        let pga = |m: &Motion| m.acceleration_m_s2.iter().fold(0.0f64, |a, b| a.max(b.abs())) / G_M_S2;
        let summaries: Vec<_> = suite.iter().map(|m| MotionSummary { id: m.id.clone(), pga_g: pga(m) }).collect();
        write_json(&task.output_dir().join("motions.json"), &summaries)
    }
}

/// The motions that stage wrote into `folder`, `dt_s` apart.
///
/// # Errors
/// When the table cannot be read.
pub fn read(folder: &Path, dt_s: f64) -> Result<Vec<Motion>> {
    let columns = super::artifact::read_table(&folder.join("motions_m_s2.csv"))?;
    Ok(columns.into_iter().map(|(id, acceleration_m_s2)| Motion { id, dt_s, acceleration_m_s2 }).collect())
}
